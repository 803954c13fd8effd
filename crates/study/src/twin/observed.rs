//! Reads the records of a run for its twin: what each host sent, and when it arrived at which host; how robots moved;
//! how episodes ended.

mod imported;
mod places;

use std::collections::BTreeMap;
use std::path::Path;

use super::ages::{Decisions, Follower, Rules};
use super::lag::{Moved, Series};
use super::links::Crossing;
use murmurate::deploy::Routes;
use murmurate::graph::inputs::Input;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::phase::Phase;
use murmurate::messages::wire::{Kind, Latent, Wire};
use murmurate::net::protocol::codec::{self, Content, Flags};
use murmurate::net::protocol::router::Audience;
use murmurate::results::episode::Episode;
use murmurate_record::clocks::{self, Alignment, ClockDifference, DatagramKey, Traffic};
use murmurate_record::reader::{self, ReadError};
use murmurate_record::receipt::Receipt;
use murmurate_record::tape;
use murmurate_record::topics::{self, RECEIPTS};
use murmurate_record::truth;
use places::Places;

/// Kinds of messages that a host sends as soon as they are published, each in a datagram of its own.
const PROMPT: [Kind; 3] = [Kind::Latent, Kind::Reading, Kind::MotorCommand];
/// Time before the end of a record in which messages for its host no longer count: they may be under way \[ns\].
const MARGIN_NS: i64 = 1_000_000_000;
/// Longest time between two states of a series (consecutive steps of a robot), in periods of the states. A longer gap
/// ends the series.
const GAP: f64 = 1.5;

/// Message that a host published.
#[derive(Clone, Debug)]
struct Sent {
    at_ns: i64,
    key: DatagramKey,
    kind: Kind,
    robot: RobotId,
    /// Content of the message if it is a latent; otherwise `None`.
    latent: Option<Latent>,
    /// Commanded velocity \[m/s\] if the message is a motor command; otherwise `None`.
    command: Option<[f64; 2]>,
}

/// True state of a robot, as recorded by the host that simulates it.
#[derive(Clone, Copy, Debug)]
struct State {
    at_ns: i64,
    robot: usize,
    /// Position \[m\], world frame.
    place: [f64; 2],
    moved: Moved,
    touches: bool,
}

/// Record of one incarnation (run) of a host, on its own clock.
pub struct Log {
    /// Host that wrote the record.
    pub host: HostId,
    /// Datagrams that the host sent and received, from which the offsets to the clocks of the other hosts are computed.
    pub traffic: Traffic,
    sent: Vec<Sent>,
    arrived: Vec<(i64, DatagramKey)>,
    states: Vec<State>,
    results: Vec<(i64, Episode)>,
    /// Times at which episodes begin \[ns\].
    begins: Vec<i64>,
    receipts: Vec<Receipt>,
    /// Times of the host's first and last recorded turn \[ns\] on its own clock; `None` if there is none.
    span: Option<[i64; 2]>,
    /// Whether the record is whole: it was not cut by a crash of its host, and is not damaged.
    pub complete: bool,
    /// Whether messages in the middle of the record are lost to damage.
    pub has_gaps: bool,
}

impl Log {
    /// Reads the record of the host `host` from a file. An error says why the file cannot be read.
    pub fn read(path: &Path, host: HostId) -> Result<Log, ReadError> {
        let (_, mut messages) = reader::messages(path)?;
        let (sent, arrived, states, results) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (traffic, span, complete) = (Traffic::default(), None, false);
        let (begins, receipts) = (Vec::new(), Vec::new());
        let mut log =
            Log { host, traffic, sent, arrived, states, results, begins, receipts, span, complete, has_gaps: false };
        while let Some(message) = messages.next_message()? {
            let at_ns = message.at as i64;
            match &*message.channel.topic {
                "/tape/turn" => log.turn(at_ns, &message.data),
                "/truth" => log.truth(at_ns, &message.data),
                "/episode" => log.episode(at_ns, &message.data),
                RECEIPTS => log.receipts.extend(serde_json::from_slice::<Receipt>(&message.data).ok()),
                topic if topic.starts_with("/wire/") => log.publish(at_ns, &message.data),
                _ => {}
            }
        }
        log.complete = messages.health().is_whole();
        log.has_gaps = messages.gaps() > 0;
        Ok(log)
    }

    /// Returns whether the record contains the result of any episode.
    pub fn has_results(&self) -> bool {
        !self.results.is_empty()
    }

    fn episode(&mut self, at_ns: i64, json: &[u8]) {
        match serde_json::from_slice(json) {
            Ok(episode) => self.results.push((at_ns, episode)),
            Err(_) => {
                let said: serde_json::Value = serde_json::from_slice(json).unwrap_or_default();
                self.begins.extend((said["phase"] == topics::name_of(Phase::Running)).then_some(at_ns));
            }
        }
    }

    fn publish(&mut self, at_ns: i64, datagram: &[u8]) {
        self.traffic.publish(at_ns, datagram);
        let Ok(Content::Message(kind)) = codec::first(datagram) else { return };
        let Some(key) = clocks::key(datagram).filter(|_| PROMPT.contains(&kind)) else { return };
        let Ok((_, message)) = codec::decode(datagram) else { return };
        let robot = message.robot();
        let (mut latent, mut command) = (None, None);
        match message {
            Wire::Latent(message) => latent = Some(message),
            Wire::MotorCommand(message) => command = Some([message.velocity.x, message.velocity.y].map(f64::from)),
            _ => {}
        }
        self.sent.push(Sent { at_ns, key, kind, robot, latent, command });
    }

    fn turn(&mut self, at_ns: i64, bytes: &[u8]) {
        let [first, _] = self.span.unwrap_or([at_ns; 2]);
        self.span = Some([first, at_ns]);
        for input in tape::read(bytes).into_iter().flat_map(|turn| turn.inputs) {
            let Input::Frame(_, frame, _) = input else { continue };
            self.traffic.arrive(at_ns, &frame);
            let first = codec::peek(&frame).is_ok_and(|header| !header.flags.has(Flags::COPY));
            if first && matches!(codec::first(&frame), Ok(Content::Message(kind)) if PROMPT.contains(&kind)) {
                self.arrived.extend(clocks::key(&frame).map(|key| (at_ns, key)));
            }
        }
    }

    fn truth(&mut self, at_ns: i64, bytes: &[u8]) {
        for of in truth::robots(bytes) {
            let moved = Moved { velocity: [of.velocity_x, of.velocity_y], command: [of.command_x, of.command_y] };
            let touches = of.touches_robot || of.touches_wall;
            self.states.push(State { at_ns, robot: of.robot as usize, place: [of.x, of.y], moved, touches });
        }
    }
}

/// Properties of a team that are needed, beside its records, to reconstruct its run.
pub struct ObservedTeam<'a> {
    /// Routes of the team's messages: the hosts that receive each kind.
    pub routes: &'a Routes,
    /// Number of the team's hosts.
    pub hosts: usize,
    /// Number of the team's robots.
    pub robots: usize,
    /// Rules by which robots use neighbours' messages.
    pub rules: Rules,
    /// Period of the steps after which states of robots are recorded \[ns\].
    pub period_ns: i64,
}

/// Recorded run of a team, joined from the records of its hosts on a common clock.
#[derive(Debug, Default)]
pub struct Run {
    /// Results by the number of the episode, from the first episode up to the first one without a result; none in an
    /// imported run.
    pub episodes: Vec<Episode>,
    /// Outcome of each datagram at each host that should have received it.
    pub crossings: Vec<Crossing>,
    /// Robots' decisions in each episode, with the ages of the messages that they used.
    pub decisions: Vec<Decisions>,
    /// True motion of the robots: for each episode, with the reset before it, one series for each stretch of
    /// consecutive steps of one robot.
    pub motion: Vec<Vec<Series>>,
    /// Motion of the robots by their own estimates, in each episode: velocities that they estimated at control ticks,
    /// with those that they then commanded. An episode's entry is empty if the records have the robots' true states.
    pub estimates: Vec<Vec<Series>>,
    /// Times of the steps of the simulated World \[ns\], by episode.
    pub steps_ns: Vec<Vec<i64>>,
    /// Decisions of each robot, in the order of robot ids: for each decision its episode and its time \[ns\].
    pub ticks_ns: Vec<Vec<(u32, i64)>>,
    /// Number of receipts of an imported run that are left out: of messages that were sent while no robot was seen.
    pub left_out: usize,
}

impl Run {
    /// Joins the records of a team's hosts to one run. `alignment` has the offsets of the hosts' clocks; records
    /// without an offset are left out.
    pub fn of(logs: &[Log], alignment: &Alignment, team: &ObservedTeam) -> Run {
        let clocks: Vec<Option<&ClockDifference>> = alignment.clocks.iter().map(Option::as_ref).collect();
        let common = |at: usize, ns: i64| clocks[at].map(|clock| ns - clock.ahead_ns(ns));
        let mut ends: BTreeMap<u32, (i64, Episode)> = BTreeMap::new();
        for (at, log) in logs.iter().enumerate() {
            for (ns, episode) in &log.results {
                let Some(ns) = common(at, *ns) else { continue };
                // A restarted host reports earlier episodes as aborted, so the first result of an episode counts.
                ends.entry(episode.episode).or_insert((ns, *episode));
            }
        }
        let complete = ends.iter().zip(0..).take_while(|((episode, _), at)| **episode == *at);
        let (ends_ns, episodes): (Vec<i64>, Vec<Episode>) = complete.map(|((_, end), _)| *end).unzip();
        let episode_at = |ns: i64| ends_ns.partition_point(|end| *end < ns) as u32;
        let mut run = Run::empty(team.robots, episodes.len());
        (run.crossings, run.episodes) = (crossings(logs, &common, &episode_at, team), episodes);
        run.follow(logs, &common, &episode_at, team);
        run.move_robots(logs, &common, &episode_at, team.period_ns);
        if logs.iter().all(|log| log.states.is_empty()) {
            run.estimate(logs, &common, &episode_at, team);
        }
        run
    }

    /// Returns a run of this many episodes of which nothing is known yet.
    fn empty(robots: usize, episodes: usize) -> Run {
        Run {
            ticks_ns: vec![Vec::new(); robots],
            steps_ns: vec![Vec::new(); episodes],
            motion: vec![Vec::new(); episodes],
            estimates: vec![Vec::new(); episodes],
            ..Run::default()
        }
    }

    /// Returns the number of its episodes.
    pub fn count(&self) -> usize {
        self.motion.len()
    }

    /// Follows latents from publication to the decisions that used them, and stores these decisions with the messages'
    /// ages.
    fn follow(
        &mut self,
        logs: &[Log],
        common: &impl Fn(usize, i64) -> Option<i64>,
        episode_at: &impl Fn(i64) -> u32,
        team: &ObservedTeam,
    ) {
        // Ticks of one instant come before arrivals, as on a host.
        let mut events: Vec<(i64, bool, usize, usize)> = Vec::new();
        for (at, log) in logs.iter().enumerate() {
            let sent = log.sent.iter().enumerate().filter(|(_, sent)| sent.latent.is_some());
            events.extend(sent.filter_map(|(place, sent)| Some((common(at, sent.at_ns)?, false, at, place))));
            let arrived = log.arrived.iter().enumerate();
            events.extend(arrived.filter_map(|(place, (ns, _))| Some((common(at, *ns)?, true, at, place))));
        }
        events.sort_unstable();
        let hosts = RobotId::team(team.robots).map(|robot| team.routes.agent_host(robot)).collect();
        let mut follower = Follower::new(team.rules, hosts);
        for (ns, arrives, at, place) in events {
            let log = &logs[at];
            if arrives {
                follower.arrive(ns, log.host, &log.arrived[place].1);
            } else if let Sent { key, latent: Some(latent), .. } = &log.sent[place] {
                follower.publish(ns, *key, latent);
                if let Some(ticks) = self.ticks_ns.get_mut(latent.robot.index()) {
                    ticks.push((episode_at(ns), ns));
                }
            }
        }
        let mut decisions = follower.into_decisions();
        self.decisions =
            (0..self.episodes.len() as u32).map(|episode| decisions.remove(&episode).unwrap_or_default()).collect();
    }

    /// Stores the robots' motion by their own velocity estimates, which their latents contain.
    fn estimate(
        &mut self,
        logs: &[Log],
        common: &impl Fn(usize, i64) -> Option<i64>,
        episode_at: &impl Fn(i64) -> u32,
        team: &ObservedTeam,
    ) {
        let gap_ns = (GAP * team.period_ns as f64) as i64;
        // By robot: episode and time of its last step, and its series.
        let mut open: BTreeMap<RobotId, (usize, i64, Series)> = BTreeMap::new();
        for (at, log) in logs.iter().enumerate() {
            let commands = log.sent.iter().filter_map(|sent| Some((sent, sent.command?)));
            let latents = log.sent.iter().filter_map(|sent| Some((sent, sent.latent.as_ref()?)));
            let told: BTreeMap<(RobotId, i64), [f64; 2]> = latents
                .map(|(sent, latent)| {
                    let velocity = latent.motion.velocity;
                    ((sent.robot, sent.at_ns), [velocity.x, velocity.y].map(f64::from))
                })
                .collect();
            for (sent, command) in commands {
                let Some(ns) = common(at, sent.at_ns) else { break };
                let (episode, robot) = (episode_at(ns) as usize, sent.robot);
                let Some(velocity) = told.get(&(robot, sent.at_ns)).filter(|_| episode < self.episodes.len()) else {
                    continue;
                };
                let step = Moved { velocity: *velocity, command };
                match open.get_mut(&robot) {
                    Some((of, last, series)) if *of == episode && ns - *last < gap_ns => {
                        *last = ns;
                        series.push(step);
                    }
                    _ => {
                        let ended = open.insert(robot, (episode, ns, vec![step]));
                        ended.into_iter().for_each(|(of, _, series)| self.estimates[of].push(series));
                    }
                }
            }
        }
        open.into_values().for_each(|(of, _, series)| self.estimates[of].push(series));
    }

    /// Stores the robots' true motion, as series of states in consecutive steps without a gap and without contact.
    fn move_robots(
        &mut self,
        logs: &[Log],
        common: &impl Fn(usize, i64) -> Option<i64>,
        episode_at: &impl Fn(i64) -> u32,
        period_ns: i64,
    ) {
        let gap_ns = (GAP * period_ns as f64) as i64;
        for (at, log) in logs.iter().enumerate() {
            // By robot: time and episode of its last state.
            let mut last: BTreeMap<usize, (i64, usize)> = BTreeMap::new();
            let mut open: BTreeMap<usize, Series> = BTreeMap::new();
            for state in &log.states {
                let Some(ns) = common(at, state.at_ns) else { break };
                let episode = episode_at(ns) as usize;
                if episode >= self.count() {
                    break;
                }
                if self.steps_ns[episode].last() != Some(&ns) {
                    self.steps_ns[episode].push(ns);
                }
                let goes_on = last.get(&state.robot).is_some_and(|(before, of)| ns - before < gap_ns && *of == episode);
                if !goes_on || state.touches {
                    let ended = open.remove(&state.robot).unwrap_or_default();
                    let of = last.get(&state.robot).map_or(episode, |(_, of)| *of);
                    self.motion[of].push(ended);
                }
                last.insert(state.robot, (ns, episode));
                if !state.touches {
                    open.entry(state.robot).or_default().push(state.moved);
                }
            }
            for (robot, series) in open {
                self.motion[last[&robot].1].push(series);
            }
        }
        self.motion.iter_mut().for_each(|series| series.retain(|series| series.len() > 1));
    }
}

/// Returns, for every datagram and every host that should have received it, its delay or that it was lost.
fn crossings(
    logs: &[Log],
    common: &impl Fn(usize, i64) -> Option<i64>,
    episode_at: &impl Fn(i64) -> u32,
    team: &ObservedTeam,
) -> Vec<Crossing> {
    let arrivals = |at: usize| -> BTreeMap<DatagramKey, i64> {
        let mut first = BTreeMap::new();
        for (ns, key) in &logs[at].arrived {
            if let Some(ns) = common(at, *ns) {
                first.entry(*key).or_insert(ns);
            }
        }
        first
    };
    let listeners: Vec<Vec<HostId>> = PROMPT.iter().map(|kind| team.routes.listeners(*kind)).collect();
    let places = Places::of_team(logs, common, team);
    let routers: Vec<_> = (0..team.hosts as u16).map(|host| team.routes.router(HostId(host))).collect();
    let mut found = Vec::new();
    for (there, receiver) in logs.iter().enumerate() {
        let Some([begins, ends]) =
            receiver.span.and_then(|[first, last]| Some([common(there, first)?, common(there, last - MARGIN_NS)?]))
        else {
            continue;
        };
        let arrived = arrivals(there);
        for (here, sender) in logs.iter().enumerate().filter(|(_, sender)| sender.host != receiver.host) {
            for sent in &sender.sent {
                let route = routers[usize::from(sender.host.0)].route(sent.kind, sent.robot);
                let Some((link, audience)) = route.leaves else { continue };
                let kind = PROMPT.iter().position(|kind| *kind == sent.kind).expect("only these are kept");
                let due = match audience {
                    Audience::Host(only) => only == receiver.host,
                    Audience::All => listeners[kind].contains(&receiver.host),
                };
                let Some(at_ns) = common(here, sent.at_ns).filter(|at| due && (begins..ends).contains(at)) else {
                    continue;
                };
                let took_ns = arrived.get(&sent.key).map(|arrived| arrived - at_ns);
                let (from, to) = (sender.host, receiver.host);
                let distance_m = places.between(from, to, at_ns);
                found.push(Crossing { episode: episode_at(at_ns), link, from, to, took_ns, distance_m });
            }
        }
    }
    found
}
