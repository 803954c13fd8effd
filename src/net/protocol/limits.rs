//! The times and shares by which a link believes, repeats and forgets.

use crate::time::Span;

/// How old an echo may be and still show that its sender is alive; and how long a stamp is echoed.
pub const FRESH: Span = Span::from_millis(2000);
/// How long after showing that it is alive a sender is believed: in a team of 200 reports list each host every 3 s, and
/// with a loss of 30 % some of those that list this one do not arrive.
pub const PROOF_HOLDS: Span = Span::from_millis(15_000);
/// How long after its last report a sender is believed: what was held back for longer is worth nothing. Reports leave
/// every 250 ms.
pub const REPORT_HOLDS: Span = Span::from_millis(3000);
/// A host without a report for so long is silent: another incarnation of it may take its place.
pub const SILENT: Span = Span::from_millis(400);
/// Without a key: a host of which nothing has come for so long is silent.
pub const UNHEARD: Span = Span::from_millis(300);
/// Reported loss from which a message is repeated: 2 of 64, about 3 %.
pub const LOSS_TO_REPEAT: u8 = 2;
/// Reported loss from which it is repeated twice: 40 %.
pub const LOSS_TO_REPEAT_TWICE: u8 = 26;
