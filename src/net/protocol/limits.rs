//! Times and loss thresholds of a link.

use crate::time::Span;

/// Largest age of an echoed stamp that proves liveness; stamps are echoed for as long.
pub const FRESH: Span = Span::from_millis(2000);
/// Validity of a liveness proof: in a team of 200 reports list each host every 3 s, and with a loss of 30 % some of
/// those that list this host do not arrive.
pub const PROOF_VALIDITY: Span = Span::from_millis(15_000);
/// Time after a sender's last report during which its datagrams are accepted. Older ones would be useless. Reports are
/// sent every 250 ms.
pub const REPORT_VALIDITY: Span = Span::from_millis(3000);
/// Time without a report after which a host counts as silent, so that another incarnation may replace it.
pub const SILENT: Span = Span::from_millis(400);
/// The same without a key: time without any datagram after which a host is silent.
pub const SILENT_WITHOUT_KEY: Span = Span::from_millis(300);
/// Reported loss from which a message is repeated: 2 of 64, about 3 %.
pub const LOSS_TO_REPEAT: u8 = 2;
/// Reported loss from which a message is repeated twice: 26 of 64, about 40 %.
pub const LOSS_TO_REPEAT_TWICE: u8 = 26;
