//! Metrics of a process in the text format of Prometheus: counts of messages and refusals, ages of messages, late
//! ticks, activations of guards, verdicts, and the emergency stop. The code is pure.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::prometheus_text;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

use super::snapshot::Snapshot;
use super::team_view::TeamView;
use murmurate::graph::event::Event;
use murmurate::messages::ids::HostId;
use murmurate::messages::wire::Kind;
use murmurate::net::protocol::codec::{self, Content};
use murmurate::net::protocol::counts::LinkCounts;
use murmurate::net::protocol::sender::Peer;
use murmurate::net::protocol::ways::{LastHop, Sending, Ways};
use murmurate::time::Span;

/// Upper edges of the bins in the histogram of message ages \[s\].
const EDGES_S: [f64; 11] = [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0];

/// Labels of one value of a metric.
type Labels = Vec<(&'static str, String)>;

/// Metrics of a process since its start: counts of its messages and events, and a histogram of message ages.
#[derive(Debug)]
pub struct Metrics {
    /// Names of the hosts, in the order of host ids.
    hosts: Vec<String>,
    /// Number of messages that actors of this process have published, by kind.
    published: BTreeMap<Kind, u64>,
    /// Number of messages that have arrived at hosts of this process, by kind.
    received: BTreeMap<Kind, u64>,
    links: BTreeMap<HostId, LinkCounts>,
    peers: BTreeMap<HostId, Vec<Peer>>,
    ways: BTreeMap<HostId, Ways>,
    ages: Histogram,
    /// Number of events missing in this process's record; `None` without a record.
    recording_dropped: Option<u64>,
}

impl Metrics {
    /// Returns the metrics of a process with all counts at zero. `hosts` are the names of the team's hosts, in the
    /// order of their ids.
    pub fn new(hosts: Vec<String>) -> Metrics {
        let (published, received, links, peers, ways) = Default::default();
        let ages = Histogram::new(EDGES_S);
        Metrics { hosts, published, received, links, peers, ways, ages, recording_dropped: None }
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
            Event::Peers(peers, ways) => {
                self.peers.insert(host, peers.to_vec());
                self.ways.insert(host, ways.clone());
            }
            _ => {}
        }
    }

    /// Adds the ages of messages that a snapshot shows to the histogram: one age for each link, or, if the snapshot has
    /// no links, one for each robot.
    pub fn sample(&mut self, picture: &Snapshot) {
        let links = picture.links.iter().filter_map(|link| link.age);
        let robots = picture.robots.iter().filter(|_| picture.links.is_empty()).filter_map(|robot| robot.age);
        for age_s in links.chain(robots).map(Span::as_secs) {
            self.ages.observe(age_s);
        }
    }

    /// Sets the number of events that are missing in the process's record, because they could not be written in time.
    pub fn dropped(&mut self, events: u64) {
        self.recording_dropped = Some(events);
    }

    /// Returns all metrics in the text format of Prometheus. `view` is the team's state as known to the process.
    pub fn text(&self, view: &TeamView) -> String {
        let mut all = Registry::with_prefix("murmurate");
        let version = vec![("version", env!("CARGO_PKG_VERSION").to_owned())];
        gauges(&mut all, "build_info", "1, with the version of the program", [(version, 1.0)]);
        self.messages(&mut all);
        let help = "Share of a host's newest 64 datagrams that did not arrive at first";
        gauges(&mut all, "link_loss_ratio", help, self.losses());
        self.ways(&mut all);
        let help =
            "Ages of the newest messages, sampled 20 times a second: of a simulation's links, else of the robots";
        all.register("message_age_seconds", help, self.ages.clone());
        let late = view.safety().map(|(robot, counts)| (vec![("robot", robot.0.to_string())], counts.late_tick));
        counters(&mut all, "ticks_late", "Times that control ticks of a robot began to be late or missing", late);
        let stops = view.safety().flat_map(|(robot, counts)| {
            let labels = move |trigger: &str| vec![("robot", robot.0.to_string()), ("trigger", trigger.to_owned())];
            counts.reasons().map(|(times, trigger)| (labels(trigger), times)).collect::<Vec<_>>()
        });
        counters(&mut all, "guard_stops", "Times that a robot's guard has begun to stop or slow it", stops);
        let verdicts = view.verdicts().iter();
        let verdicts = verdicts.map(|(verdict, episodes)| (vec![("verdict", verdict.to_string())], *episodes));
        counters(&mut all, "episodes", "Episodes that have ended, where their results are known", verdicts);
        let engaged = f64::from(u8::from(view.latch().is_engaged()));
        gauges(&mut all, "emergency_stop_engaged", "1 while the team's emergency stop is engaged", [(vec![], engaged)]);
        let confirmed = [(vec![], view.confirmed() as f64)];
        gauges(&mut all, "robots_confirmed", "Robots that follow the state of the emergency stop", confirmed);
        if let Some(dropped) = self.recording_dropped {
            let help = "Events that the record of this process lacks";
            counters(&mut all, "recording_dropped", help, [(vec![], dropped)]);
        }
        let mut text = String::new();
        prometheus_text::encode(&mut text, &all).expect("a text takes all");
        text
    }

    fn messages(&self, all: &mut Registry) {
        let name = |kind: &Kind| serde_json::to_value(kind).ok().and_then(|value| value.as_str().map(str::to_owned));
        let by_kind = |(kind, count): (&Kind, &u64)| (vec![("kind", name(kind).unwrap_or_default())], *count);
        let help = "Messages that have arrived at the hosts of this process, by kind";
        counters(all, "messages", help, self.received.iter().map(by_kind));
        let help = "Messages that actors of this process have sent, by kind";
        counters(all, "messages_published", help, self.published.iter().map(by_kind));
        let sum: LinkCounts = self.links.values().copied().sum();
        let refusals = sum.refusals().into_iter().map(|(cause, count)| (vec![("cause", cause.to_owned())], count));
        counters(all, "datagrams_refused", "Datagrams and messages refused or dropped on arrival, by cause", refusals);
    }

    /// Adds by which ways hosts hear others over hops, and send on links that choose.
    fn ways(&self, all: &mut Registry) {
        let hops = |of: fn(&LastHop) -> f64| {
            let all = self.ways.iter().flat_map(|(host, ways)| ways.hops.iter().flatten().map(move |hop| (host, hop)));
            let labels =
                |host: &HostId, hop: &LastHop| vec![("host", self.name(*host)), ("peer", self.name(HostId(hop.host)))];
            all.map(|(host, hop)| (labels(host, hop), of(hop))).collect::<Vec<_>>()
        };
        let help = "Time since the newest soft state of another host of a mesh has come";
        gauges(all, "soft_state_age_seconds", help, hops(|hop| hop.age_s));
        let help = "1 if the newest soft state of another host of a mesh has come from itself, 0 if by others";
        gauges(all, "soft_state_direct", help, hops(|hop| f64::from(u8::from(hop.by == hop.host))));
        let sends = |of: fn(&Sending) -> f64| {
            let all = self.ways.iter().flat_map(|(host, ways)| ways.sends.iter().map(move |sends| (host, sends)));
            let labels = |host: &HostId, sends: &Sending| {
                vec![("host", self.name(*host)), ("link", sends.link.to_string()), ("way", sends.way.clone())]
            };
            all.map(|(host, sends)| (labels(host, sends), of(sends))).collect::<Vec<_>>()
        };
        let help = "Transmissions of each state on a link that chooses, by the way that it has chosen";
        gauges(all, "link_transmissions", help, sends(|sends| sends.copies));
        let help = "Rate at which states leave on a link that chooses";
        gauges(all, "link_states_hertz", help, sends(|sends| sends.sent_hz));
        let help = "Share of the time in which the team's states would occupy the medium of a link that chooses";
        gauges(all, "link_load_ratio", help, sends(|sends| sends.load));
    }

    fn losses(&self) -> impl Iterator<Item = (Labels, f64)> {
        let pairs = self.peers.iter().flat_map(|(host, peers)| peers.iter().map(move |peer| (host, peer)));
        pairs.filter(|(_, peer)| peer.accepted).map(|(host, peer)| {
            let [host, other] = [*host, HostId(peer.host)].map(|host| self.name(host));
            (vec![("host", host), ("peer", other), ("link", peer.link.to_string())], peer.loss)
        })
    }

    /// Returns the name of a host; `operator` for an operator, who has none.
    fn name(&self, host: HostId) -> String {
        self.hosts.get(usize::from(host.0)).cloned().unwrap_or_else(|| "operator".to_owned())
    }
}

/// Adds a metric that only grows, with its value for each set of labels.
fn counters(all: &mut Registry, name: &str, help: &str, values: impl IntoIterator<Item = (Labels, impl Into<u64>)>) {
    let family = Family::<Labels, Counter>::default();
    for (labels, value) in values {
        family.get_or_create(&labels).inc_by(value.into());
    }
    all.register(name, help, family);
}

/// Adds a metric that goes up and down, with its value for each set of labels.
fn gauges(all: &mut Registry, name: &str, help: &str, values: impl IntoIterator<Item = (Labels, f64)>) {
    let family = Family::<Labels, Gauge<f64, AtomicU64>>::default();
    for (labels, value) in values {
        family.get_or_create(&labels).set(value);
    }
    all.register(name, help, family);
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
            "murmurate_emergency_stop_engaged 0.0",
            "murmurate_recording_dropped_total 7",
        ] {
            assert!(text.lines().any(|other| other == line), "{line} is missing in\n{text}");
        }
        let types = text.lines().filter(|line| line.starts_with("# TYPE")).count();
        assert_eq!(types, text.lines().filter(|line| line.starts_with("# HELP")).count());
    }
}
