//! Metrics of a process in the text format of Prometheus: counts of messages and refusals, ages of messages, late
//! ticks, activations of guards, verdicts, and the emergency stop. The code is pure.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::snapshot::Snapshot;
use super::team_view::TeamView;
use murmurate::graph::event::Event;
use murmurate::messages::ids::HostId;
use murmurate::messages::wire::Kind;
use murmurate::net::protocol::codec::{self, Content};
use murmurate::net::protocol::counts::LinkCounts;
use murmurate::net::protocol::sender::Peer;
use murmurate::time::Span;

/// Upper edges of the bins in the histogram of message ages \[s\].
const EDGES_S: [f64; 11] = [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0];

/// Metrics of a process since its start: counts of its messages and events, and a histogram of message ages.
#[derive(Clone, Debug, Default)]
pub struct Metrics {
    /// Names of the hosts, in the order of host ids.
    hosts: Vec<String>,
    /// Number of messages that actors of this process have published, by kind.
    published: BTreeMap<Kind, u64>,
    /// Number of messages that have arrived at hosts of this process, by kind.
    received: BTreeMap<Kind, u64>,
    links: BTreeMap<HostId, LinkCounts>,
    peers: BTreeMap<HostId, Vec<Peer>>,
    /// Number of ages in each bin of the histogram; the last bin is above all edges.
    ages: [u64; EDGES_S.len() + 1],
    age_sum_s: f64,
    /// Number of events missing in this process's record; `None` without a record.
    recording_dropped: Option<u64>,
}

impl Metrics {
    /// Returns the metrics of a process with all counts at zero. `hosts` are the names of the team's hosts, in the
    /// order of their ids.
    pub fn new(hosts: Vec<String>) -> Metrics {
        Metrics { hosts, ..Metrics::default() }
    }

    /// Updates the counts with an event of the host `host`.
    pub fn take(&mut self, host: HostId, event: Event) {
        match event {
            Event::Published(frame) => {
                if let Ok(Content::Message(kind)) = codec::first(frame) {
                    *self.published.entry(kind).or_default() += 1;
                }
            }
            Event::Message(message) => *self.received.entry(message.kind()).or_default() += 1,
            Event::Counts(counts) => drop(self.links.insert(host, *counts)),
            Event::Peers(peers) => drop(self.peers.insert(host, peers.to_vec())),
            _ => {}
        }
    }

    /// Adds the ages of messages that a snapshot shows to the histogram: one age for each link, or, if the snapshot has
    /// no links, one for each robot.
    pub fn sample(&mut self, picture: &Snapshot) {
        let links = picture.links.iter().filter_map(|link| link.age);
        let robots = picture.robots.iter().filter(|_| picture.links.is_empty()).filter_map(|robot| robot.age);
        for age_s in links.chain(robots).map(Span::as_secs) {
            self.ages[EDGES_S.partition_point(|edge| *edge < age_s)] += 1;
            self.age_sum_s += age_s;
        }
    }

    /// Sets the number of events that are missing in the process's record, because they could not be written in time.
    pub fn dropped(&mut self, events: u64) {
        self.recording_dropped = Some(events);
    }

    /// Returns all metrics in the text format of Prometheus. `view` is the team's state as known to the process.
    pub fn text(&self, view: &TeamView) -> String {
        let mut out = Text(String::new());
        out.about("build_info", "gauge", "1, with the version of the program");
        out.one("build_info", &[("version", env!("CARGO_PKG_VERSION"))], 1.0);
        self.messages(&mut out);
        self.peers(&mut out);
        self.histogram(&mut out);
        out.about("ticks_late_total", "counter", "Times that control ticks of a robot began to be late or missing");
        for (robot, counts) in view.safety() {
            out.one("ticks_late_total", &[("robot", &robot.0.to_string())], counts.late_tick as f64);
        }
        out.about("guard_stops_total", "counter", "Times that a robot's guard has begun to stop or slow it");
        for (robot, counts) in view.safety() {
            for (times, trigger) in counts.reasons() {
                out.one("guard_stops_total", &[("robot", &robot.0.to_string()), ("trigger", trigger)], times as f64);
            }
        }
        out.about("episodes_total", "counter", "Episodes that have ended, where their results are known");
        for (verdict, episodes) in view.verdicts() {
            out.one("episodes_total", &[("verdict", verdict)], f64::from(*episodes));
        }
        out.about("emergency_stop_engaged", "gauge", "1 while the team's emergency stop is engaged");
        out.one("emergency_stop_engaged", &[], f64::from(u8::from(view.latch().is_engaged())));
        out.about("robots_confirmed", "gauge", "Robots that follow the state of the emergency stop");
        out.one("robots_confirmed", &[], view.confirmed() as f64);
        if let Some(dropped) = self.recording_dropped {
            out.about("recording_dropped_total", "counter", "Events that the record of this process lacks");
            out.one("recording_dropped_total", &[], dropped as f64);
        }
        out.0
    }

    fn messages(&self, out: &mut Text) {
        let name = |kind: Kind| serde_json::to_value(kind).ok().and_then(|value| value.as_str().map(str::to_owned));
        out.about("messages_total", "counter", "Messages that have arrived at the hosts of this process, by kind");
        for (kind, count) in &self.received {
            out.one("messages_total", &[("kind", &name(*kind).unwrap_or_default())], *count as f64);
        }
        out.about("messages_published_total", "counter", "Messages that actors of this process have sent, by kind");
        for (kind, count) in &self.published {
            out.one("messages_published_total", &[("kind", &name(*kind).unwrap_or_default())], *count as f64);
        }
        out.about(
            "datagrams_refused_total",
            "counter",
            "Datagrams and messages refused or dropped on arrival, by cause",
        );
        let sum: LinkCounts = self.links.values().copied().sum();
        for (cause, count) in sum.refusals() {
            out.one("datagrams_refused_total", &[("cause", cause)], count as f64);
        }
    }

    fn peers(&self, out: &mut Text) {
        out.about("link_loss_ratio", "gauge", "Share of a host's newest 64 datagrams that did not arrive at first");
        for (host, peers) in &self.peers {
            for peer in peers.iter().filter(|peer| peer.accepted) {
                let (host, link) = (self.name(*host), peer.link.to_string());
                let labels = [("host", &*host), ("peer", &*self.name(HostId(peer.host))), ("link", &*link)];
                out.one("link_loss_ratio", &labels, peer.loss);
            }
        }
    }

    fn histogram(&self, out: &mut Text) {
        let help =
            "Ages of the newest messages, sampled 20 times a second: of a simulation's links, else of the robots";
        out.about("message_age_seconds", "histogram", help);
        let mut total = 0;
        for (edge, count) in EDGES_S.iter().map(f64::to_string).chain(["+Inf".to_owned()]).zip(self.ages) {
            total += count;
            out.one("message_age_seconds_bucket", &[("le", &edge)], total as f64);
        }
        out.one("message_age_seconds_sum", &[], self.age_sum_s);
        out.one("message_age_seconds_count", &[], total as f64);
    }

    /// Returns the name of a host; `operator` for an operator, who has none.
    fn name(&self, host: HostId) -> String {
        self.hosts.get(usize::from(host.0)).cloned().unwrap_or_else(|| "operator".to_owned())
    }
}

/// Text of the metrics under construction.
struct Text(String);

impl Text {
    fn about(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP murmurate_{name} {help}\n# TYPE murmurate_{name} {kind}");
    }

    fn one(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let quoted = |value: &str| value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
        let labels: Vec<String> = labels.iter().map(|(name, value)| format!("{name}=\"{}\"", quoted(value))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        let _ = writeln!(self.0, "murmurate_{name}{labels} {value}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::snapshot::LinkState;
    use crate::status::Scene;
    use murmurate::messages::ids::RobotId;
    use murmurate::safety::guard::SafetyCounts;
    use murmurate::time::Time;

    #[test]
    fn every_metric_has_its_type_and_labels() {
        let mut metrics = Metrics::new(vec!["pc \"1\"".to_owned()]);
        let counts = LinkCounts { auth: 3, stale: 2, ..LinkCounts::default() };
        metrics.take(HostId(0), Event::Counts(&counts));
        metrics.take(HostId(1), Event::Counts(&LinkCounts { auth: 1, ..LinkCounts::default() }));
        let link = |ms| LinkState { one: 0, other: 1, age: Some(Span::from_millis(ms)), loss: None };
        metrics.sample(&Snapshot { links: vec![link(20), link(21), link(9000)], ..Snapshot::default() });
        metrics.dropped(7);
        let mut view = TeamView::new(Scene { robots: 2, ..Scene::default() }, vec![HostId(0); 2], 1);
        view.guarded(Time::ZERO, RobotId(1), SafetyCounts { late_tick: 4, fence: 1, ..SafetyCounts::default() });
        let text = metrics.text(&view);
        for line in [
            "murmurate_datagrams_refused_total{cause=\"auth\"} 4",
            "murmurate_datagrams_refused_total{cause=\"stale\"} 2",
            "murmurate_message_age_seconds_bucket{le=\"0.02\"} 1",
            "murmurate_message_age_seconds_bucket{le=\"0.05\"} 2",
            "murmurate_message_age_seconds_bucket{le=\"5\"} 2",
            "murmurate_message_age_seconds_bucket{le=\"+Inf\"} 3",
            "murmurate_message_age_seconds_sum 9.041",
            "murmurate_ticks_late_total{robot=\"0\"} 0",
            "murmurate_ticks_late_total{robot=\"1\"} 4",
            "murmurate_guard_stops_total{robot=\"1\",trigger=\"geofence\"} 1",
            "murmurate_emergency_stop_engaged 0",
            "murmurate_recording_dropped_total 7",
        ] {
            assert!(text.lines().any(|other| other == line), "{line} is missing in\n{text}");
        }
        let types = text.lines().filter(|line| line.starts_with("# TYPE")).count();
        assert_eq!(types, text.lines().filter(|line| line.starts_with("# HELP")).count());
    }
}
