//! The way in which a link's states leave: by multicast with copies, or to each host by itself. Pure.
//!
//! [`Chooser`] decides by what `pairs` and the link reports measure; `leaving` has the state of a link, `sending` acts
//! on it, and `told` reports it.

mod cost;
mod leaving;
mod pairs;
mod sending;
mod told;

use std::fmt;

use crate::time::{Span, Time};

pub(super) use self::leaving::{Choice, Said};
pub(super) use self::pairs::Pair;

/// Smallest time between two decisions that differ.
pub const HOLD: Span = Span::from_millis(5000);
/// Share of its cost that another way must save at least before a link takes it.
const HYSTERESIS: f64 = 0.2;
/// Amount by which the expected share may fall below the goal before the copies change.
const SLACK: f64 = 0.004;

/// Rule by which a link decides in which way data for all hosts leaves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Choosing {
    /// It has one way, that of its transport.
    #[default]
    Fixed,
    /// By what it measures, on a transport that has both ways.
    Measured,
    /// Always in this way, on a transport that has both, for comparisons.
    Pinned(Way),
}

/// Way in which a datagram with data for all hosts leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// To all at once, this many eighths of a transmission for each datagram on average, 8 to 32.
    Multicast(u8),
    /// To each host by itself, acknowledged by the medium.
    Unicast,
}

/// Figures of a link by which it decides.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// Number of hosts that were heard in the last two seconds, and this one.
    pub hosts: usize,
    /// Rate of this host's states \[1/s\].
    pub states_hz: f64,
    /// Share of the multicast frames of this host, 0 to 1, that each other host does not receive.
    pub loss: Vec<f64>,
    /// Time on the air of a multicast frame \[s\]; `None` while it is unknown.
    pub multicast_s: Option<f64>,
    /// Time on the air of a unicast frame with its acknowledgement \[s\]; `None` while it is unknown.
    pub unicast_s: Option<f64>,
    /// Whether round trips show that queues are full.
    pub congested: bool,
}

/// Decision of a link, with the figures that it was made from.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    /// Way in which data leaves.
    pub way: Way,
    /// One of this many states leaves; 1 unless the link is overloaded.
    pub divisor: u8,
    /// Share of the time, 0 and more, in which the team's states would occupy the medium; 0 if it is unknown.
    pub load: f64,
    /// Figures of the link when it was made.
    pub measured: Measured,
}

impl fmt::Display for Decision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.way {
            Way::Unicast => write!(f, "unicast")?,
            Way::Multicast(8) => write!(f, "multicast")?,
            Way::Multicast(eighths) => write!(f, "multicast, {:.3} copies", f64::from(eighths) / 8.0)?,
        }
        if self.divisor > 1 {
            write!(f, ", {:.3} Hz of {:.3}", self.hz(), self.measured.states_hz)?;
        }
        let ms = |time_s: Option<f64>| time_s.map_or("unknown".to_owned(), |time_s| format!("{:.2} ms", 1e3 * time_s));
        let Measured { hosts, multicast_s, unicast_s, congested, .. } = &self.measured;
        let (loss, load) = (100.0 * self.measured.mean_loss(), 100.0 * self.load);
        write!(f, ": {hosts} hosts, loss {loss:.0} %, frames of {} by multicast", ms(*multicast_s))?;
        write!(f, " and {} by unicast, load {load:.0} %", ms(*unicast_s))?;
        if *congested { write!(f, ", congested") } else { Ok(()) }
    }
}

impl Decision {
    /// Returns the rate at which states leave \[1/s\].
    pub fn hz(&self) -> f64 {
        self.measured.states_hz / f64::from(self.divisor)
    }
}

/// Decides how a link sends, and keeps to it: no decision changes before 5 s ([`HOLD`]), nor for a gain below 20 %.
#[derive(Clone, Debug)]
pub struct Chooser {
    decision: Decision,
    /// Time of the last change; `None` before the first decision from measured frames.
    changed: Option<Time>,
}

impl Default for Chooser {
    fn default() -> Chooser {
        Chooser::starting_with(Way::Multicast(8))
    }
}

impl Chooser {
    /// Returns a chooser before any measurement, which has decided for this way.
    pub fn starting_with(way: Way) -> Chooser {
        let decision = Decision { way, divisor: 1, load: 0.0, measured: Measured::default() };
        Chooser { decision, changed: None }
    }

    /// Returns the decision that holds.
    pub fn decision(&self) -> &Decision {
        &self.decision
    }

    /// Returns the time since the last change of the decision; `None` if it has never changed.
    pub fn age(&self, now: Time) -> Option<Span> {
        self.changed.map(|changed| now.since(changed))
    }

    /// Takes new measurements, and keeps to its way.
    pub(super) fn keep(&mut self, measured: Measured) {
        let Decision { way, divisor, .. } = self.decision;
        self.decision = Decision { way, divisor, load: measured.load(way, divisor), measured };
    }

    /// Takes new measurements. Returns whether the decision is another one now.
    pub fn update(&mut self, now: Time, measured: Measured) -> bool {
        let (way, divisor) = measured.best();
        let differs = (way, divisor) != (self.decision.way, self.decision.divisor);
        let held = self.changed.is_some_and(|changed| now.since(changed) < HOLD);
        let changes = differs && !held && self.is_worth(&measured, (way, divisor));
        let (way, divisor) = if changes { (way, divisor) } else { (self.decision.way, self.decision.divisor) };
        let load = measured.load(way, divisor);
        self.decision = Decision { way, divisor, load, measured };
        if changes {
            self.changed = Some(now);
        }
        changes
    }

    /// Returns whether a better way is so much better that the link takes it.
    fn is_worth(&self, measured: &Measured, (way, divisor): (Way, u8)) -> bool {
        let Decision { way: now, divisor: by, .. } = self.decision;
        if divisor != by {
            // Lowered at once; raised where there is room to spare.
            return divisor > by || measured.load(way, divisor) < (1.0 - HYSTERESIS) * cost::limit(way);
        }
        let gains = measured.share(way) - measured.share(now);
        let overloaded = measured.load(now, by) > cost::limit(now);
        let is_short = measured.share(now) < cost::GOAL - SLACK && gains > SLACK;
        let cheaper = measured.cost_s(way) < (1.0 - HYSTERESIS) * measured.cost_s(now);
        overloaded || is_short || cheaper && gains > -SLACK || cheaper && measured.share(way) >= cost::GOAL
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Figures of a team with 16 % loss whose multicast frames take `multicast_ms`.
    fn team(hosts: usize, multicast_ms: f64) -> Measured {
        Measured {
            hosts,
            states_hz: 20.0,
            loss: vec![0.16; hosts - 1],
            multicast_s: Some(1e-3 * multicast_ms),
            unicast_s: Some(0.11e-3),
            congested: false,
        }
    }

    #[test]
    fn multicast_wins_where_its_frames_are_short_or_the_team_is_large() {
        let way = |hosts, multicast_ms| team(hosts, multicast_ms).best().0;
        let many = Way::Multicast(23);
        assert_eq!([3, 4, 5, 10, 20].map(|n| way(n, 0.118)), [Way::Unicast, many, many, many, many], "24 Mbit/s");
        assert_eq!([3, 5, 6, 7, 8].map(|n| way(n, 0.386) == many), [false, false, false, true, true], "6 Mbit/s");
        assert_eq!([3, 5, 10].map(|n| way(n, 2.32)), [Way::Unicast; 3], "1 Mbit/s");
        assert_eq!(team(20, 2.32).best(), (Way::Multicast(8), 2), "an overloaded link says less, and once");
    }

    #[test]
    fn copies_are_as_many_as_the_loss_needs() {
        let copies = |loss: f64| match (Measured { loss: vec![loss; 9], ..team(10, 0.118) }).best().0 {
            Way::Multicast(eighths) => eighths,
            Way::Unicast => 0,
        };
        assert_eq!([0.0, 0.005, 0.05, 0.16].map(copies), [8, 8, 16, 23]);
        let unknown = Measured { multicast_s: None, unicast_s: None, ..team(10, 0.0) };
        assert_eq!(unknown.best().0, Way::Multicast(16), "two while their cost is unknown");
        let congested = Measured { congested: true, ..unknown };
        assert_eq!(congested.best().0, Way::Multicast(8));
    }

    #[test]
    fn a_decision_stays_for_five_seconds_and_for_small_gains() {
        let mut chooser = Chooser::default();
        assert!(chooser.update(at(0), team(10, 0.118)), "the first one comes at once");
        assert!(!chooser.update(at(4999), team(10, 2.32)));
        assert!(chooser.update(at(5000), team(10, 2.32)));
        assert_eq!(chooser.decision().way, Way::Unicast);
        assert!(!chooser.update(at(20_000), team(10, 0.55)), "a seventh would be gained");
        assert!(chooser.update(at(30_000), team(10, 0.3)));
        assert_eq!(chooser.age(at(30_500)), Some(Span::from_millis(500)));
    }

    #[test]
    fn a_decision_says_why() {
        let mut chooser = Chooser::default();
        chooser.update(at(0), team(20, 2.3));
        let said = "multicast, 10.000 Hz of 20.000: 20 hosts, loss 16 %, frames of 2.30 ms by multicast and 0.11 ms by \
                    unicast, load 47 %";
        assert_eq!(chooser.decision().to_string(), said);
    }
}
