//! Reliability mode of each kind of message, and setup of a link, as data.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::bucket::Rate;
use crate::messages::wire::Kind;
use crate::time::Span;

/// Reliability mode of a kind of message. In every mode, new messages are sent without waiting for old ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reliability {
    /// Each message is sent once.
    #[default]
    BestEffort,
    /// Each message is repeated after a short delay, while receivers report loss.
    Repeat,
    /// Receivers request missing messages (RFC 5401).
    Nack,
    /// Each message is retransmitted until it is acknowledged, up to a limit.
    Ack,
}

impl Reliability {
    /// Reliability modes by their names in team files.
    pub const NAMED: [(&'static str, Reliability); 4] = [
        ("best-effort", Reliability::BestEffort),
        ("repeat", Reliability::Repeat),
        ("nack", Reliability::Nack),
        ("ack", Reliability::Ack),
    ];
}

/// Reliability modes by kind of message; kinds that are left out are best effort.
pub type Reliabilities = BTreeMap<Kind, Reliability>;

/// Which datagrams soft state may be piggybacked on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Piggyback {
    /// None: soft state is sent at once and alone. For emulated links, which impair only some kinds of messages.
    Never,
    /// Datagrams to the same hosts. For links with unicast.
    SameAudience,
    /// All datagrams. For links on which every datagram reaches every host; every message is then sent to all.
    Any,
}

/// Whether hosts send link reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reports {
    /// Hosts send no reports.
    Off,
    /// Hosts send reports several times a second.
    On,
}

/// Usual age of the last report from which on the next one may be piggybacked.
pub const REPORT_PIGGYBACK_AGE: Span = Span::from_millis(150);

/// Setup of a link. Equal on all hosts, except `report_piggyback_age`.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Reliability modes of messages on the link.
    pub reliability: Reliabilities,
    /// Which datagrams soft state may be piggybacked on.
    pub piggyback: Piggyback,
    /// Whether hosts send link reports.
    pub reports: Reports,
    /// Age of the last report from which on the next one may be piggybacked. Zero for an operator: each of its
    /// datagrams has a report, so that hosts accept it at once.
    pub report_piggyback_age: Span,
    /// Rate limit of a sender; `None` for no limit.
    pub rate: Option<Rate>,
    /// Number of hosts in the team; their ids are smaller. `None` if unknown: then every id that is not an operator's
    /// may be a host of the team.
    pub hosts: Option<u16>,
}

/// Rate limit of a sender on real links: 8000 datagrams a second, and as many in a burst. A robot sends at most 5000
/// messages a second and soft state.
pub const RATE: Rate = Rate { per_s: 8000.0, burst: 8000.0 };

impl Setup {
    /// Returns the setup of an emulated link. Hosts send reports only if a reliability mode needs them.
    pub fn emulated(reliability: Reliabilities) -> Setup {
        let plain = reliability.values().all(|one| *one == Reliability::BestEffort);
        let reports = if plain { Reports::Off } else { Reports::On };
        Setup {
            reliability,
            piggyback: Piggyback::Never,
            reports,
            report_piggyback_age: REPORT_PIGGYBACK_AGE,
            rate: None,
            hosts: None,
        }
    }

    /// Returns the setup of a link on which every datagram reaches every host.
    pub fn multicast(reliability: Reliabilities) -> Setup {
        let (piggyback, reports, report_piggyback_age) = (Piggyback::Any, Reports::On, REPORT_PIGGYBACK_AGE);
        Setup { reliability, piggyback, reports, report_piggyback_age, rate: Some(RATE), hosts: None }
    }

    /// Returns the setup of a link on which a datagram reaches only the host to which it is addressed.
    pub fn unicast(reliability: Reliabilities) -> Setup {
        Setup { piggyback: Piggyback::SameAudience, ..Setup::multicast(reliability) }
    }

    /// Whether the link has datagrams that are addressed to one host.
    pub fn is_addressed(&self) -> bool {
        self.piggyback != Piggyback::Any
    }

    /// Returns the reliability mode of a kind of message.
    pub fn of(&self, kind: Kind) -> Reliability {
        self.reliability.get(&kind).copied().unwrap_or_default()
    }
}
