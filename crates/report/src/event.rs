//! Events that a process of a team prints for the process that started it: one JSON object per line.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

use murmurate::messages::ids::RobotId;
use murmurate::net::protocol::link::LinkCounts;
use murmurate::report::TrialReport;
use murmurate::results::episode::{AbortReason, Episode};
use murmurate::results::hardware::RobotHardware;
use murmurate::results::totals::Totals;
use murmurate::safety::guard::SafetyCounts;
use murmurate::time::Span;

use crate::heard::Heard;

/// Event that a host prints as a line of JSON for the program that started it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum HostEvent {
    /// The host's sockets are open and its actors run.
    Ready {
        /// Name of the host in the deployment.
        host: String,
    },
    /// The sockets of a link were closed because its network interface or its address has gone, or are open again.
    Link {
        /// Name of the link in the deployment.
        link: String,
        /// Whether the sockets are open again.
        open: bool,
        /// Why they were closed, or at which address and interface they are open again.
        what: String,
    },
    /// An episode has ended. The host that judges reports it: the one that simulates the whole team, or otherwise the
    /// host of the state server.
    Episode(Episode),
    /// The state server, on this host, has aborted an episode. The host that judges may be another one.
    Aborted {
        /// Index of the episode, from 0.
        episode: u32,
        /// Reason of the end.
        reason: AbortReason,
    },
    /// Hosts that the host hears, their last hops, and its way of sending: once a second from a host with a mesh or a
    /// link that chooses.
    Heard(Heard),
    /// All counts of the host so far. They are reported once a second, and as the last event if the team has not
    /// finished.
    Counted(Counted),
    /// The team has finished all episodes; with the final counts of the host.
    Finished(Counted),
}

/// Counts of one host since its start: messages, datagrams, stops of robots and dropped output.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Counted {
    /// Number of messages published by the host's actors.
    pub messages: u64,
    /// Number of messages that were dropped because the mailbox of the receiving actor was full.
    pub refused: u64,
    /// Number of messages that were lost in crashes of actors.
    pub lost: u64,
    /// Datagrams of the host on all links together: sent, accepted, and refused by cause, up to the last full second.
    pub links: Box<LinkCounts>,
    /// Largest age that a velocity command had while it still moved a robot \[s\]; null if it is unknown. Only a host
    /// that simulates the whole team knows it.
    pub oldest_command_s: Option<f64>,
    /// Numbers of stops and reduced velocities of each robot of this host, up to its last heartbeat. Robots without any
    /// are left out.
    pub safety: Vec<RobotSafety>,
    /// Hardware of the real robots that this host drives, as their drivers reported it: battery, temperature, faults.
    pub hardware: Vec<RobotHardware>,
    /// Output that was dropped instead of written: log lines, events and steps.
    pub unwritten: Unwritten,
}

/// Numbers of stops and reduced velocities of one robot by its guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotSafety {
    /// Id of the robot.
    pub robot: RobotId,
    /// Numbers of stops and reduced velocities, by cause.
    #[serde(flatten)]
    pub counts: SafetyCounts,
}

/// Output of a host that was dropped, because the control thread never waits for a disk, a terminal or a pipe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Unwritten {
    /// Number of dropped lines of the log.
    pub log_lines: u64,
    /// Number of dropped events of `--json`.
    pub events: u64,
    /// Number of dropped steps of `--trajectories`, each of the whole team.
    pub steps: u64,
    /// Number of dropped events of `--record`.
    pub record_events: u64,
}

impl Unwritten {
    /// Returns the number of all dropped lines, events and steps.
    pub(crate) fn total(&self) -> u64 {
        self.log_lines + self.events + self.steps + self.record_events
    }
}

impl Sum for Unwritten {
    fn sum<I: Iterator<Item = Unwritten>>(all: I) -> Unwritten {
        all.fold(Unwritten::default(), |sum, one| Unwritten {
            log_lines: sum.log_lines + one.log_lines,
            events: sum.events + one.events,
            steps: sum.steps + one.steps,
            record_events: sum.record_events + one.record_events,
        })
    }
}

impl HostEvent {
    /// Returns the event as one line of JSON, without the newline.
    pub fn to_line(&self) -> String {
        serde_json::to_string(self).expect("an event is JSON")
    }

    /// Parses a line of JSON; `None` if it is not an event.
    pub fn from_line(line: &str) -> Option<HostEvent> {
        serde_json::from_str(line).ok()
    }
}

/// Returns the report `report`, whose counts cover only the host whose Recorder made it, with the sums over all
/// processes of the team in their place. `incarnations` has the counts of each process; a restarted host has several.
pub fn counted<'a>(report: TrialReport, incarnations: impl Iterator<Item = &'a Counted> + Clone) -> TrialReport {
    let sum = |of: fn(&Counted) -> u64| incarnations.clone().map(of).sum();
    let oldest = incarnations.clone().filter_map(|counted| counted.oldest_command_s).reduce(f64::max);
    TrialReport {
        totals: Totals {
            messages: sum(|counted| counted.messages),
            oldest_command: oldest.map(Span::from_secs),
            links: incarnations.clone().map(|counted| *counted.links).sum(),
            safety: incarnations.clone().flat_map(|counted| &counted.safety).map(|robot| robot.counts).sum(),
            ..report.totals
        },
        refused: sum(|counted| counted.refused),
        lost: sum(|counted| counted.lost),
        hardware: RobotHardware::joined(incarnations.flat_map(|counted| &counted.hardware)),
        ..report
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::results::episode::{AbortCause, Judged};
    use murmurate::scenario::judge::Verdict;

    #[test]
    fn an_event_is_read_from_its_line_unchanged() {
        let episode = |min_separation_m| Episode {
            repeat: 0,
            episode: 3,
            verdict: Verdict::RobotCollision,
            makespan_s: None,
            reset_s: 1.5,
            min_separation_m,
            judged: Judged::Readings,
            cost: Some(0.25),
            reason: Some(AbortReason { cause: AbortCause::Missing, robot: Some(RobotId(3)), others: 1 }),
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
            HostEvent::Link { link: "infra".to_owned(), open: true, what: "10.0.0.1 on 'wlan0'".to_owned() },
            HostEvent::Episode(episode(0.25)),
            HostEvent::Episode(episode(f32::INFINITY)),
            HostEvent::Aborted {
                episode: 3,
                reason: AbortReason { cause: AbortCause::Stopped, robot: None, others: 0 },
            },
            HostEvent::Heard(Heard::default()),
            HostEvent::Counted(counted.clone()),
            HostEvent::Finished(counted),
        ];
        for event in all {
            assert_eq!(HostEvent::from_line(&event.to_line()), Some(event.clone()), "{}", event.to_line());
        }
        assert_eq!(HostEvent::from_line("ready"), None);
    }
}
