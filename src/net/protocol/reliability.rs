//! Reliability modes of kinds of messages, and the setup of a link: its modes, piggybacking, link reports and rate
//! limit. Data only; the `link` module acts on it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::bucket::Rate;
use super::choice::Choosing;
use crate::messages::wire::Kind;
use crate::time::Span;

/// Reliability mode of a kind of message: what hosts do about lost messages. In every mode, new messages are sent
/// without waiting for old ones, and a newer message replaces an older one of its stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reliability {
    /// Each message is sent once.
    #[default]
    BestEffort,
    /// While a receiver reports that it loses 3 % or more of the datagrams, each message is sent again after 4 ms; from
    /// 40 % on, once more after another 4 ms. None is sent again while the link is congested.
    Repeat,
    /// Receivers detect missing datagrams by their sequence numbers and request them again (RFC 5401).
    Nack,
    /// Each message is retransmitted until the receivers have acknowledged it, at most 5 times.
    Ack,
}

impl Reliability {
    /// Reliability modes by their names in team files.
    pub(crate) const NAMED: [(&'static str, Reliability); 4] = [
        ("best-effort", Reliability::BestEffort),
        ("repeat", Reliability::Repeat),
        ("nack", Reliability::Nack),
        ("ack", Reliability::Ack),
    ];
}

/// Reliability modes by kind of message; kinds that are left out are best effort.
pub type Reliabilities = BTreeMap<Kind, Reliability>;

/// To which datagrams soft state (repeated messages such as heartbeats) may be appended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Piggyback {
    /// To none: soft state is sent at once in a datagram of its own. Used for emulated links, which impair only some
    /// kinds of messages.
    Never,
    /// To datagrams for the same hosts as the soft state. Used for links with unicast.
    SameAudience,
    /// To all datagrams. Used for links on which every datagram reaches every host; every message is then sent to all.
    Any,
}

/// Whether hosts send link reports, with stamp, echo, delay and loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reports {
    /// Hosts send no link reports.
    Off,
    /// Hosts send link reports several times a second.
    On,
}

/// When each heartbeat is sent twice, the second time 40 to 100 ms after the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heartbeats {
    /// Never.
    Once,
    /// While a receiver reports a loss of 3 % or more (`LOSS_TO_REPEAT`) and the link is not congested.
    TwiceWhileLossy,
    /// Always.
    Twice,
}

/// Age of a host's last link report from which on the next report may be appended to a datagram that is sent anyway
/// (piggybacking). It holds for all hosts but operators, which use zero.
pub(crate) const REPORT_PIGGYBACK_AGE: Span = Span::from_millis(150);

/// Setup of a link: reliability modes, piggybacking, link reports and rate limit. Equal on all hosts, except
/// `report_piggyback_age`.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Reliability mode of each kind of message on the link; a kind that is left out is best effort.
    pub reliability: Reliabilities,
    /// To which datagrams soft state (repeated messages such as heartbeats) may be appended.
    pub piggyback: Piggyback,
    /// When each heartbeat is sent twice. A robot of which none arrives for a second counts as missing, and the episode
    /// is aborted.
    pub heartbeats: Heartbeats,
    /// Whether hosts send link reports.
    pub reports: Reports,
    /// Age of this host's last link report from which on the next one may be appended to a datagram that is sent anyway
    /// (piggybacking). Zero for an operator: each of its datagrams has a report, so that hosts accept it at once.
    pub report_piggyback_age: Span,
    /// Limit on the datagrams that a host accepts from each other host; it refuses those beyond the limit. `None` for
    /// no limit.
    pub rate: Option<Rate>,
    /// Number of hosts in the team: ids below it are hosts of the team, all others guests. `None` if unknown: then
    /// every id that is not an operator's may be a host of the team.
    pub hosts: Option<u16>,
    /// Whether hosts say emergency stops on, so that these cross hops.
    pub mesh: bool,
    /// Rule by which the link decides in which way data for all hosts leaves.
    pub choosing: Choosing,
    /// Whether hosts act at the same instants and share a radio, so that a link that chooses spreads their states.
    pub spread: bool,
}

/// Limit on the datagrams that a host accepts from each other host on real links: 8000 a second, and as many in a
/// burst. A robot sends at most 5000 messages a second and soft state.
pub(crate) const RATE: Rate = Rate { per_s: 8000.0, burst: 8000.0 };

impl Setup {
    /// Returns the setup of an emulated link: without piggybacking and rate limit. Hosts send link reports only if a
    /// reliability mode other than best effort is used.
    pub(crate) fn emulated(reliability: Reliabilities) -> Setup {
        let plain = reliability.values().all(|one| *one == Reliability::BestEffort);
        let reports = if plain { Reports::Off } else { Reports::On };
        Setup {
            reliability,
            piggyback: Piggyback::Never,
            heartbeats: Heartbeats::Once,
            reports,
            report_piggyback_age: REPORT_PIGGYBACK_AGE,
            rate: None,
            hosts: None,
            mesh: false,
            choosing: Choosing::Fixed,
            spread: false,
        }
    }

    /// Returns the setup of a link on which every datagram reaches every host, such as UDP multicast: with link
    /// reports, the rate limit `RATE`, soft state in any datagram, and heartbeats twice while datagrams are lost.
    pub fn multicast(reliability: Reliabilities) -> Setup {
        let (piggyback, reports, report_piggyback_age) = (Piggyback::Any, Reports::On, REPORT_PIGGYBACK_AGE);
        let (heartbeats, rate) = (Heartbeats::TwiceWhileLossy, Some(RATE));
        Setup { piggyback, reports, report_piggyback_age, heartbeats, rate, ..Setup::emulated(reliability) }
    }

    /// Returns the setup of a link that sends by multicast or to each host by itself, as it chooses by what it
    /// measures.
    pub fn choosing(reliability: Reliabilities) -> Setup {
        Setup { choosing: Choosing::Measured, ..Setup::multicast(reliability) }
    }

    /// Returns the setup of a link on which a datagram reaches only the host to which it is addressed: with link
    /// reports, the rate limit `RATE`, and soft state appended only to datagrams with the same receivers.
    pub fn unicast(reliability: Reliabilities) -> Setup {
        Setup { piggyback: Piggyback::SameAudience, ..Setup::multicast(reliability) }
    }

    /// Returns the setup of a link with a relay that passes datagrams on, each to one host or to all. One that is lost
    /// before the relay is lost for all hosts at once, so each heartbeat is sent twice.
    pub fn relayed(reliability: Reliabilities) -> Setup {
        Setup { heartbeats: Heartbeats::Twice, ..Setup::unicast(reliability) }
    }

    /// Returns whether the link can send a datagram to one host alone; on other links every datagram goes to all hosts.
    pub fn is_addressed(&self) -> bool {
        self.piggyback != Piggyback::Any
    }

    /// Returns whether hosts of a larger team report less often. A link that chooses has a budget of its own for
    /// reports, and an emulated one reports as it always has.
    pub(crate) fn slows_reports(&self) -> bool {
        self.piggyback != Piggyback::Never && self.choosing == Choosing::Fixed
    }

    /// Returns the reliability mode of messages of kind `kind` on this link.
    pub(crate) fn of(&self, kind: Kind) -> Reliability {
        self.reliability.get(&kind).copied().unwrap_or_default()
    }
}
