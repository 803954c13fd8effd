//! Decision of a link as data for reports, with its reason as a sentence.

use super::cost;
use super::leaving::Choice;
use super::{Decision, Measured, Way};
use crate::messages::ids::LinkId;
use crate::net::protocol::ways::{Sending, Slot};
use crate::time::{Span, Time};

impl Decision {
    /// Returns the reason of the decision, from its figures.
    pub fn why(&self) -> String {
        let measured = &self.measured;
        if measured.multicast_s.is_none() {
            return match measured.congested {
                true => "no time of a frame is known, and round trips show full queues".to_owned(),
                false => "no time of a frame is known, so the loss alone decides".to_owned(),
            };
        }
        let once = Way::Multicast(8);
        if self.divisor > 1 {
            let load = 100.0 * measured.load(once, 1);
            return format!("overloaded: all states once would take {load:.0} % of the time");
        }
        let Some(other) = measured.other(self.way) else {
            return "no time of a unicast frame is known".to_owned();
        };
        let name = if other == Way::Unicast { "unicast" } else { "multicast" };
        if self.way == once && measured.load(other, 1) > cost::limit(other) {
            let load = 100.0 * measured.load(other, 1);
            return format!("{name} would take {load:.0} % of the time");
        }
        let ratio = measured.cost_s(other) / measured.cost_s(self.way);
        match ratio {
            1.0.. => format!("{name} would take {ratio:.1} times the time of the medium"),
            _ => format!("kept: {name} would save {:.0} % of the time of the medium", 100.0 * (1.0 - ratio)),
        }
    }
}

impl Choice {
    /// Returns the decision that holds, as data about the link `link`.
    pub(in crate::net::protocol) fn told(&self, now: Time, link: LinkId) -> Sending {
        let mut sending = self.decision().told(link);
        if !self.has_decided() {
            // Without states of its own, as an operator, it has measured all the same.
            (sending.multicast_s, sending.unicast_s) = (self.pairs.frame_s(false), self.pairs.frame_s(true));
        }
        Sending { slot: self.slot_told(), age_s: self.chooser.age(now).map(Span::as_secs), ..sending }
    }

    fn slot_told(&self) -> Option<Slot> {
        let (place, of) = self.place();
        self.wait().map(|wait| Slot { place, of, wait_s: wait.as_secs() })
    }
}

impl Decision {
    /// Returns what a link would decide first from these figures.
    pub fn first(measured: Measured) -> Decision {
        let (way, divisor) = measured.best();
        Decision { way, divisor, load: measured.load(way, divisor), measured }
    }

    /// Returns the decision as data about the link `link`, without a slot.
    pub fn told(&self, link: LinkId) -> Sending {
        let measured = &self.measured;
        let (way, copies) = match self.way {
            Way::Unicast => ("unicast", 1.0),
            Way::Multicast(eighths) => ("multicast", f64::from(eighths) / 8.0),
        };
        Sending {
            link: link.0,
            way: way.to_owned(),
            copies,
            states_hz: measured.states_hz,
            sent_hz: self.hz(),
            hosts: measured.hosts,
            loss: measured.mean_loss(),
            load: self.load,
            multicast_s: measured.multicast_s,
            unicast_s: measured.unicast_s,
            congested: measured.congested,
            slot: None,
            age_s: None,
            why: self.why(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Decision from figures of a team with 16 % loss whose multicast frames take `multicast_ms`.
    fn decided(hosts: usize, multicast_ms: Option<f64>) -> Decision {
        Decision::first(Measured {
            hosts,
            states_hz: 20.0,
            loss: vec![0.16; hosts - 1],
            multicast_s: multicast_ms.map(|ms| 1e-3 * ms),
            unicast_s: Some(0.11e-3),
            congested: false,
        })
    }

    #[test]
    fn a_decision_says_what_another_way_would_cost() {
        assert_eq!(decided(3, Some(2.32)).why(), "multicast would take 13.6 times the time of the medium");
        assert_eq!(decided(10, Some(0.118)).why(), "unicast would take 3.6 times the time of the medium");
        assert_eq!(decided(20, Some(2.3)).why(), "overloaded: all states once would take 94 % of the time");
        assert_eq!(decided(5, None).why(), "no time of a frame is known, so the loss alone decides");
        let kept = Decision { way: Way::Unicast, ..decided(5, Some(0.118)) };
        assert_eq!(kept.why(), "kept: multicast would save 37 % of the time of the medium");
    }

    #[test]
    fn a_decision_is_told_with_its_figures() {
        let told = decided(20, Some(2.3)).told(LinkId(3));
        assert_eq!((told.link, &*told.way, told.copies, told.hosts), (3, "multicast", 1.0, 20));
        assert_eq!((told.states_hz, told.sent_hz), (20.0, 10.0));
    }
}
