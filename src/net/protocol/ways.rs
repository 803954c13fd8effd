//! Ways by which a host hears the others of a mesh, and in which it sends on links that choose: data for reports,
//! records and pages. Pure.

use serde::{Deserialize, Serialize};

use super::window::LOSS_SPAN;
use crate::messages::ids::HostId;
use crate::time::Span;

/// Neighbour from which the newest soft state of another host of a mesh has come first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LastHop {
    /// Id of the host that has made the soft state.
    pub host: u16,
    /// Id of the neighbour that has said it; `host` itself if that is heard directly.
    pub by: u16,
    /// Time since it has arrived \[s\].
    pub age_s: f64,
}

/// Host that a neighbour hears directly, as the neighbour's newest link reports say.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Overheard {
    /// Id of the neighbour that hears.
    pub at: u16,
    /// Id of the host that it hears.
    pub host: u16,
    /// Share (0 to 1) of the newest 64 datagrams of `host` that the neighbour has lost.
    pub loss: f64,
    /// Time since the neighbour has said so \[s\].
    pub age_s: f64,
}

impl Overheard {
    /// Returns that `at` hears `host`, and has lost so many of its newest 64 datagrams, as it has said `age` ago.
    pub(crate) fn new((at, host): (HostId, HostId), lost: u8, age: Span) -> Overheard {
        Overheard { at: at.0, host: host.0, loss: f64::from(lost) / f64::from(LOSS_SPAN), age_s: age.as_secs() }
    }
}

/// Place of a host among those that share the time of a radio.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Slot {
    /// Index of the host's slot, from 0.
    pub place: usize,
    /// Number of slots.
    pub of: usize,
    /// Time that the host's states wait for it \[s\].
    pub wait_s: f64,
}

/// Decision of a link that chooses: the way in which a host's states leave, with the figures behind it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sending {
    /// Id of the link.
    pub link: u16,
    /// Way of the states: `multicast` or `unicast`.
    pub way: String,
    /// Transmissions of each state by multicast, on average; 1 by unicast, where the medium repeats.
    pub copies: f64,
    /// Rate at which the host has states \[1/s\].
    pub states_hz: f64,
    /// Rate at which they leave \[1/s\]; less than `states_hz` on an overloaded link.
    pub sent_hz: f64,
    /// Number of hosts that were heard in the last two seconds, and the host itself.
    pub hosts: usize,
    /// Mean share (0 to 1) of its multicast frames that another host does not receive.
    pub loss: f64,
    /// Share of the time, 0 and more, in which the team's states would occupy the medium; 0 if it is unknown.
    pub load: f64,
    /// Time on the air of a multicast frame \[s\]; `None` while it is unknown.
    pub multicast_s: Option<f64>,
    /// Time on the air of a unicast frame with its acknowledgement \[s\]; `None` while it is unknown.
    pub unicast_s: Option<f64>,
    /// Whether round trips show that queues are full.
    pub congested: bool,
    /// Slot of the host's states; `None` if states are not spread.
    pub slot: Option<Slot>,
    /// Time since the decision was another one \[s\]; `None` if it has never been.
    pub age_s: Option<f64>,
    /// Reason of the decision, as a sentence.
    pub why: String,
}

/// Ways of one host: by whom it hears the others of a mesh, and how it sends on links that choose.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Ways {
    /// Last hop of the soft state of each other host that has come; `None` if no link of the host is a mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hops: Option<Vec<LastHop>>,
    /// Hosts that the neighbours hear directly. Only an operator asks for it; hosts report for themselves.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub overheard: Vec<Overheard>,
    /// Decisions of the links that choose.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sends: Vec<Sending>,
}

impl Ways {
    /// Whether the host has neither a mesh nor a link that chooses.
    pub fn are_plain(&self) -> bool {
        self.hops.is_none() && self.sends.is_empty()
    }
}

impl Sending {
    /// Returns the decision and its figures as a line, such as `2.9 transmissions by multicast, 20.0 Hz, load 6 %`.
    pub fn in_words(&self) -> String {
        let way = match &*self.way {
            "unicast" => "unicast to each host".to_owned(),
            _ if self.copies > 1.0 => format!("{:.1} transmissions by multicast", self.copies),
            _ => "multicast once".to_owned(),
        };
        let rate = match self.sent_hz < self.states_hz {
            true => format!("{:.1} of {:.1} Hz", self.sent_hz, self.states_hz),
            false => format!("{:.1} Hz", self.states_hz),
        };
        let slot = self.slot.map_or(String::new(), |slot| format!(", slot {} of {}", slot.place + 1, slot.of));
        // It is 0 while the time of a frame is unknown.
        let load = if self.load > 0.0 { format!(", load {:.0} %", 100.0 * self.load) } else { String::new() };
        format!("{way}, {rate}{slot}{load}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decision_is_one_line_of_words() {
        let slot = Some(Slot { place: 2, of: 20, wait_s: 0.001 });
        let sending = Sending {
            link: 0,
            way: "multicast".to_owned(),
            copies: 2.875,
            states_hz: 20.0,
            sent_hz: 10.0,
            hosts: 20,
            loss: 0.16,
            load: 0.474,
            multicast_s: Some(0.0023),
            unicast_s: None,
            congested: false,
            slot,
            age_s: None,
            why: String::new(),
        };
        assert_eq!(sending.in_words(), "2.9 transmissions by multicast, 10.0 of 20.0 Hz, slot 3 of 20, load 47 %");
        let unicast = Sending { way: "unicast".to_owned(), copies: 1.0, sent_hz: 20.0, slot: None, ..sending };
        assert_eq!(unicast.in_words(), "unicast to each host, 20.0 Hz, load 47 %");
        assert_eq!(Sending { load: 0.0, ..unicast }.in_words(), "unicast to each host, 20.0 Hz", "that is unknown");
    }

    #[test]
    fn a_host_without_a_mesh_says_none_and_one_that_hears_no_host_an_empty_list() {
        let text = |ways: &Ways| serde_json::to_string(ways).expect("ways are JSON");
        assert_eq!(text(&Ways::default()), "{}");
        let alone = Ways { hops: Some(Vec::new()), ..Ways::default() };
        assert_eq!(text(&alone), r#"{"hops":[]}"#);
        assert!(Ways::default().are_plain() && !alone.are_plain());
    }
}
