//! Reliability of each kind of message, as data, and the setup of a link. No state.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::bucket::Rate;
use crate::messages::wire::Kind;
use crate::time::Span;

/// Reliability mode of a kind of message. In no mode does a fresh message wait for an old one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reliability {
    /// Sent once.
    #[default]
    BestEffort,
    /// Repeated after a short delay, as long as receivers report loss.
    Repeat,
    /// Requested by a receiver that misses it (RFC 5401).
    Nack,
    /// Retransmitted until it is acknowledged, a few times at most.
    Ack,
}

impl Reliability {
    /// Reliability modes by their names in files.
    pub const NAMED: [(&'static str, Reliability); 4] = [
        ("best-effort", Reliability::BestEffort),
        ("repeat", Reliability::Repeat),
        ("nack", Reliability::Nack),
        ("ack", Reliability::Ack),
    ];
}

/// Reliability modes by kind; kinds that are left out have the default.
pub type Reliabilities = BTreeMap<Kind, Reliability>;

/// Datagrams on which soft state may be piggybacked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Piggyback {
    /// None: it is sent at once and alone, on emulated links, which treat kinds apart.
    Never,
    /// Datagrams to the same hosts: where datagrams are addressed.
    SameAudience,
    /// All: where every datagram reaches every host. Then every message is sent to all.
    Any,
}

/// Whether hosts send link reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reports {
    /// No reports.
    Off,
    /// Reports several times a second.
    On,
}

/// Age of the last report from which the next one may be piggybacked.
pub const REPORT_PIGGYBACK_AGE: Span = Span::from_millis(150);

/// Setup of a link; except for `report_piggyback_age`, the same on all hosts.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Reliability modes of its messages.
    pub reliability: Reliabilities,
    /// Piggybacking of soft state.
    pub piggyback: Piggyback,
    /// Whether there are link reports.
    pub reports: Reports,
    /// Age of the last report from which the next one may be piggybacked. It is zero for an operator: each of its
    /// datagrams has a report, so that hosts accept it at once.
    pub report_piggyback_age: Span,
    /// Rate limit of a sender; `None` for no limit.
    pub rate: Option<Rate>,
    /// Number of hosts in the team, whose numbers are below it. `None` if unknown; then every number that is not an
    /// operator's may be a host of the team.
    pub hosts: Option<u16>,
}

/// Rate limit of a sender on real links, with a second of it at once. A robot sends less: up to 5000 messages a second
/// and soft state.
pub const RATE: Rate = Rate { per_s: 8000.0, burst: 8000.0 };

impl Setup {
    /// Setup of an emulated link. There are reports only if a reliability mode needs them.
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

    /// Setup of a link on which every datagram reaches every host.
    pub fn multicast(reliability: Reliabilities) -> Setup {
        let (piggyback, reports, report_piggyback_age) = (Piggyback::Any, Reports::On, REPORT_PIGGYBACK_AGE);
        Setup { reliability, piggyback, reports, report_piggyback_age, rate: Some(RATE), hosts: None }
    }

    /// Setup of a link on which a datagram reaches only the host to which it is addressed.
    pub fn unicast(reliability: Reliabilities) -> Setup {
        Setup { piggyback: Piggyback::SameAudience, ..Setup::multicast(reliability) }
    }

    /// Whether the link has datagrams that are addressed to one host.
    pub fn is_addressed(&self) -> bool {
        self.piggyback != Piggyback::Any
    }

    /// Reliability mode of a kind.
    pub fn of(&self, kind: Kind) -> Reliability {
        self.reliability.get(&kind).copied().unwrap_or_default()
    }
}
