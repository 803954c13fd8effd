//! What a process of a team tells whoever started it: one JSON object a line.

use serde::{Deserialize, Serialize};

use super::episode::Episode;
use crate::net::link::LinkCounts;

/// Something that a host tells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum HostEvent {
    /// Its sockets are open and its actors run.
    Ready {
        /// Its name.
        host: String,
    },
    /// An episode is over; told by the host with the World.
    Episode(Episode),
    /// The team has finished its episodes.
    Finished(Counted),
}

/// What one host counted from its start to its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Counted {
    /// Messages published.
    pub messages: u64,
    /// Messages that a full mailbox refused.
    pub refused: u64,
    /// Messages that were lost in crashes.
    pub lost: u64,
    /// Frames sent, let in, and refused by cause, on all links together.
    pub links: LinkCounts,
    /// The oldest command that a robot of this host was driven by \[s\].
    pub oldest_command_s: f64,
}

impl HostEvent {
    /// As a line, without its end.
    pub fn to_line(&self) -> String {
        serde_json::to_string(self).expect("an event is JSON")
    }

    /// From a line; `None` if it is none.
    pub fn from_line(line: &str) -> Option<HostEvent> {
        serde_json::from_str(line).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::judge::Verdict;

    #[test]
    fn an_event_survives_its_line() {
        let episode = |min_separation_m| Episode {
            repeat: 0,
            episode: 3,
            verdict: Verdict::RobotCollision,
            makespan_s: None,
            reset_s: 1.5,
            min_separation_m,
        };
        let counted = Counted { messages: 7, oldest_command_s: 0.05, ..Counted::default() };
        let all = [
            HostEvent::Ready { host: "robot-2".to_owned() },
            HostEvent::Episode(episode(0.25)),
            HostEvent::Episode(episode(f32::INFINITY)),
            HostEvent::Finished(counted),
        ];
        for event in all {
            assert_eq!(HostEvent::from_line(&event.to_line()), Some(event.clone()), "{}", event.to_line());
        }
        assert_eq!(HostEvent::from_line("ready"), None);
    }
}
