//! Times and loss thresholds of a link.

use crate::time::Span;

/// Largest age at which a stamp of this host, echoed by another host, proves that the other host is live. Hosts echo
/// a received stamp for the same time.
pub const FRESH: Span = Span::from_millis(2000);
/// Time for which a host stays accepted after a liveness proof (echo of a recent stamp). In a team of 200, each round
/// of reports takes 3 s, and at a loss of 30 % some reports that list this host do not arrive.
pub const PROOF_VALIDITY: Span = Span::from_millis(15_000);
/// Time after a sender's last link report during which its datagrams are accepted. Reports are sent every 250 ms, and
/// in larger teams without loss at least every 1.5 s.
pub const REPORT_VALIDITY: Span = Span::from_millis(3000);
/// On a link with a key: time without a link report after which a host is silent, so that another incarnation of it
/// may be accepted.
pub const SILENT: Span = Span::from_millis(400);
/// On a link without a key: time without any datagram after which a host is silent, so that another incarnation of it
/// may be accepted.
pub const SILENT_WITHOUT_KEY: Span = Span::from_millis(300);
/// Smallest number of lost datagrams among a sender's newest 64, as a receiver reports it, with which the sender sends
/// messages in the reliability mode `repeat` twice: about 3 %.
pub const LOSS_TO_REPEAT: u8 = 2;
/// Smallest number of lost datagrams among a sender's newest 64, as a receiver reports it, with which the sender sends
/// messages in the reliability mode `repeat` three times: about 40 %.
pub const LOSS_TO_REPEAT_TWICE: u8 = 26;
