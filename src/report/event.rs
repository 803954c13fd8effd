//! Events that a process of a team prints for its starter: one JSON object a line.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

use super::episode::Episode;
use crate::messages::ids::RobotId;
use crate::net::protocol::link::LinkCounts;
use crate::safety::guard::SafetyCounts;

/// Something that a host tells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum HostEvent {
    /// Its sockets are open and its actors run.
    Ready {
        /// Its name.
        host: String,
    },
    /// An episode is over; told by the host that judges: the one whose World simulates the whole team, or else that of
    /// the state server.
    Episode(Episode),
    /// All counts so far: once a second, and as its last word where the team has not finished.
    Counted(Counted),
    /// The team has finished its episodes.
    Finished(Counted),
}

/// Counts of one host since its start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Counted {
    /// Messages published.
    pub messages: u64,
    /// Messages that a full mailbox refused.
    pub refused: u64,
    /// Messages that were lost in crashes.
    pub lost: u64,
    /// Frames sent, let in, and refused by cause, on all links together, up to the last full second.
    pub links: Box<LinkCounts>,
    /// The oldest command that a robot of the team was driven by \[s\]; null where that cannot be known, as on all
    /// hosts but one whose World simulates the whole team.
    pub oldest_command_s: Option<f64>,
    /// How often robots of this host were stopped or slowed, up to their last heartbeats; robots that never were are
    /// left out.
    pub safety: Vec<RobotSafety>,
    /// Output that was dropped.
    pub unwritten: Unwritten,
}

/// How often one robot was stopped or slowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotSafety {
    /// The robot.
    pub robot: RobotId,
    /// By reason.
    #[serde(flatten)]
    pub counts: SafetyCounts,
}

/// Output that was dropped because nothing on the control thread waits for a disk, a terminal or a pipe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Unwritten {
    /// Lines of the log.
    pub log_lines: u64,
    /// Events of `--json`.
    pub events: u64,
    /// Steps of `--trajectories`, each of the whole team.
    pub steps: u64,
}

impl Unwritten {
    /// All kinds together.
    pub fn total(&self) -> u64 {
        self.log_lines + self.events + self.steps
    }
}

impl Sum for Unwritten {
    fn sum<I: Iterator<Item = Unwritten>>(all: I) -> Unwritten {
        all.fold(Unwritten::default(), |sum, one| Unwritten {
            log_lines: sum.log_lines + one.log_lines,
            events: sum.events + one.events,
            steps: sum.steps + one.steps,
        })
    }
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
    use crate::report::episode::Judged;
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
            judged: Judged::Readings,
        };
        let counts = SafetyCounts { late_tick: 2, ..SafetyCounts::default() };
        let counted = Counted {
            messages: 7,
            oldest_command_s: Some(0.05),
            safety: vec![RobotSafety { robot: RobotId(3), counts }],
            unwritten: Unwritten { events: 1, ..Unwritten::default() },
            ..Counted::default()
        };
        let all = [
            HostEvent::Ready { host: "robot-2".to_owned() },
            HostEvent::Episode(episode(0.25)),
            HostEvent::Episode(episode(f32::INFINITY)),
            HostEvent::Counted(counted.clone()),
            HostEvent::Finished(counted),
        ];
        for event in all {
            assert_eq!(HostEvent::from_line(&event.to_line()), Some(event.clone()), "{}", event.to_line());
        }
        assert_eq!(HostEvent::from_line("ready"), None);
    }
}
