//! How sure a kind of message is to arrive, as data, and how a link is set up. No state.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::bucket::Rate;
use crate::messages::wire::Kind;
use crate::time::Span;

/// Measures that make a message arrive. Nothing here makes a fresh message wait for an old one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reliability {
    /// It is sent once.
    #[default]
    BestEffort,
    /// It is sent again a little later, as long as receivers report loss.
    Repeat,
    /// A receiver that misses it asks for it (RFC 5401).
    Nack,
    /// It is sent again until it is acknowledged, a few times at most.
    Ack,
}

impl Reliability {
    /// Every reliability by its name in files.
    pub const NAMED: [(&'static str, Reliability); 4] = [
        ("best-effort", Reliability::BestEffort),
        ("repeat", Reliability::Repeat),
        ("nack", Reliability::Nack),
        ("ack", Reliability::Ack),
    ];
}

/// The reliability of each kind that has another than the default.
pub type Reliabilities = BTreeMap<Kind, Reliability>;

/// Whether soft state may wait for a datagram to ride on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ride {
    /// It goes at once and alone: on the emulated ether, which treats kinds apart.
    Never,
    /// On one that goes to the same hosts: where a datagram is addressed.
    SameAudience,
    /// On any: where every datagram reaches everyone. Then every message goes to all.
    Any,
}

/// Whether hosts tell each other what they hear.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reports {
    /// Nothing is told.
    Off,
    /// Several times a second.
    On,
}

/// A report rides as soon as the last one is this old.
pub const REPORT_RIDES: Span = Span::from_millis(150);

/// How a link is set up; but for `report_rides`, the same on all hosts.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The reliability of what travels on it.
    pub reliability: Reliabilities,
    /// Whether soft state rides.
    pub ride: Ride,
    /// Whether there are link reports.
    pub reports: Reports,
    /// How old the last report is when the next one rides. Zero for an operator, which is to be believed at once: a
    /// report goes with every datagram, the first one at time zero, and a host that waits for one is answered at once.
    pub report_rides: Span,
    /// How much one sender may say; none for no limit.
    pub rate: Option<Rate>,
    /// How many hosts the team has: those with lower numbers. None where that is not known, and every number that is no
    /// operator's may be one.
    pub hosts: Option<u16>,
}

/// More than a robot has to say: 5000 messages a second and soft state; a second of it at once.
pub const RATE: Rate = Rate { per_s: 8000.0, burst: 8000.0 };

impl Setup {
    /// A link of the emulated ether. There are reports only if any reliability needs them.
    pub fn emulated(reliability: Reliabilities) -> Setup {
        let plain = reliability.values().all(|one| *one == Reliability::BestEffort);
        let reports = if plain { Reports::Off } else { Reports::On };
        Setup { reliability, ride: Ride::Never, reports, report_rides: REPORT_RIDES, rate: None, hosts: None }
    }

    /// A link on which every datagram reaches everyone.
    pub fn multicast(reliability: Reliabilities) -> Setup {
        let (ride, reports, report_rides) = (Ride::Any, Reports::On, REPORT_RIDES);
        Setup { reliability, ride, reports, report_rides, rate: Some(RATE), hosts: None }
    }

    /// A link on which a datagram reaches whom it is addressed to.
    pub fn unicast(reliability: Reliabilities) -> Setup {
        Setup { ride: Ride::SameAudience, ..Setup::multicast(reliability) }
    }

    /// Whether some datagrams go to one host alone.
    pub fn is_addressed(&self) -> bool {
        self.ride != Ride::Any
    }

    /// The reliability of a kind.
    pub fn of(&self, kind: Kind) -> Reliability {
        self.reliability.get(&kind).copied().unwrap_or_default()
    }
}
