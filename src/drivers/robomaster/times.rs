//! Times that a session gives the robot, its worker and the network.

use crate::time::Span;

/// Time without a push after which the robot counts as silent: a dead link has to be noticed within 300 ms. At 20 Hz,
/// four pushes in a row are missing.
pub const SILENCE: Span = Span::from_millis(250);
/// Time without an answer after which the robot counts as silent. The line was sent up to 60 ms after the link died.
pub const UNANSWERED: Span = Span::from_millis(230);
/// Time without an answer after which the connection is given up although pushes arrive. TCP may have to send a segment
/// again, after 200 ms at least (RFC 6298, Linux).
pub const PATIENCE: Span = Span::from_millis(600);
/// The same for entering SDK mode: first the robot may have to end an old session, for up to a second (DJI's script).
pub const ENTRY_PATIENCE: Span = Span::from_millis(1500);
/// The same limit for the later lines of the set-up: the robot starts its SDK before it answers them.
pub const SETUP_PATIENCE: Span = Span::from_millis(3000);
/// Time from the opening of a connection to its first line. The reset of the former connection ends SDK mode and has to
/// arrive before that line.
pub const PAUSE: Span = Span::from_millis(50);
/// Longest time from the end of the set-up to the first state datagram that the robot pushes.
pub const FIRST_PUSH: Span = Span::from_millis(1000);
/// Time within which the worker reports a new connection or its failure. The worker itself stops trying after 0.4 s.
pub const OPENING: Span = Span::from_millis(2000);
/// Time between a failure and the next connection.
pub const RETRY: Span = Span::from_millis(200);
/// Period at which standing is repeated. Its answers show that the connection is alive.
pub const STAND_PERIOD: Span = Span::from_millis(60);
