//! Time limits of a session of the RoboMaster driver: for the robot, the driver's worker and the network.

use murmurate::time::Span;

/// Time without a state datagram (push) after which the robot counts as silent: a dead link has to be noticed within
/// 300 ms. At 20 Hz, four datagrams in a row are missing then.
pub const SILENCE: Span = Span::from_millis(250);
/// Time without an answer to a line after which the robot counts as silent. The line may be sent up to 60 ms after the
/// link died; so a dead link is noticed within 290 ms.
pub(crate) const UNANSWERED: Span = Span::from_millis(230);
/// Time without an answer to a line after which the connection is given up, even if state datagrams (pushes) arrive.
/// TCP may have to retransmit a segment, which takes at least 200 ms (RFC 6298, Linux).
pub const PATIENCE: Span = Span::from_millis(600);
/// Time without an answer to the line that enters SDK mode after which the connection is given up. The robot may first
/// have to end an old session, which takes up to a second (DJI's script).
pub(crate) const ENTRY_PATIENCE: Span = Span::from_millis(1500);
/// Time without an answer to a later line of the set-up after which the connection is given up: the robot starts its
/// SDK before it answers them.
pub(crate) const SETUP_PATIENCE: Span = Span::from_millis(3000);
/// Time from the opening of a connection until its first line is sent. The TCP reset of the former connection ends SDK
/// mode and has to arrive before that line.
pub const PAUSE: Span = Span::from_millis(50);
/// Longest time from the end of the set-up to the first state datagram that the robot pushes.
pub(crate) const FIRST_PUSH: Span = Span::from_millis(1000);
/// Longest wait of the driver for the worker's report that a connection was opened or failed; then the driver asks it
/// again. The worker itself stops trying after 0.4 s.
pub const OPENING: Span = Span::from_millis(2000);
/// Time from the end of a connection, or a failed attempt to open one, to the next attempt.
pub const RETRY: Span = Span::from_millis(200);
/// Period at which a stand command is repeated to a standing robot. The answers show that the connection is alive.
pub(crate) const STAND_PERIOD: Span = Span::from_millis(60);
