//! Status: reports of one host to operators and to the state server: which latch the host's robots follow, and whether
//! the host shuts down or is present.
//!
//! It answers every message of an operator, so that operators get confirmations in every deployment, even if heartbeats
//! cross no link. While an observer is present, it sends telemetry: positions and conditions of the host's robots.

use std::collections::{BTreeMap, BTreeSet};

use super::witness::Finding;
use crate::actor::Core;
use crate::messages::geometry::Pose;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::trigger::Trigger;
use crate::messages::wire::{self, Condition, Following, GuardReport, Hardware, Leading};
use crate::messages::wire::{MAX_BLOCK, Phase, Seen, Stop, Telemetry};
use crate::safety::counts::SafetyCounts;
use crate::time::{Span, Time};

/// Wait before an answer, so that the host's actors have handled the operator's message.
const GATHER_TIME: Span = Span::from_millis(1);
/// Shortest interval between two answers to operators: the period at which one operator repeats its message.
const ANSWER_PERIOD: Span = Span::from_millis(20);
/// Period at which a host that shuts down repeats the message that it leaves, until its process ends.
const LEAVE_PERIOD: Span = Span::from_millis(30);
/// Period at which a host reports its presence while the team waits for another host.
const PRESENCE_PERIOD: Span = Span::from_millis(200);
/// Age after which a Status no longer reports the latch of a Controller or Body: over two heartbeat periods.
const STALE: Span = Span::from_millis(500);

/// Time after an observer's last message for which it counts as present. One message may be lost.
const OBSERVER_TIMEOUT: Span = Span::from_millis(2500);
/// Period of telemetry messages: first of a host with one robot, then of a host with several. The messages take less
/// than 330 bytes a second with tags: what the budget of soft state leaves in a team of 50 (docs/wire.md).
const TELEMETRY_PERIODS: [Span; 2] = [Span::from_millis(250), Span::from_millis(330)];
/// Time without a latent from a robot after which telemetry ignores that robot in `link_age_ms`, the largest age of the
/// other robots' newest latents.
const LINK_TIMEOUT: Span = Span::from_millis(1500);
/// Largest number of robots in one telemetry message. If a host has more, they take turns.
const ROBOTS_PER_MESSAGE: usize = 2;
/// Shortest interval between two telemetry messages of a host that contain the reason (text) of a robot's fault. After
/// such a message the host waits two telemetry periods, which keeps it within its budget of bytes.
const REASON_PERIOD: Span = Span::from_millis(1000);

/// Input message of a Status, the actor that reports the state of one host to operators, observers and the state
/// server.
#[derive(Clone, Debug)]
pub enum In {
    /// Emergency stop message; one of an operator (question, stop, re-arm or resume) is answered.
    Stop(Stop),
    /// Emergency stop latch that a robot's Controller follows.
    Controller(RobotId, Latch),
    /// Emergency stop latch that a robot's Body follows.
    Body(RobotId, Latch),
    /// Measured pose of a robot whose agent runs on this host.
    Seen(RobotId, Pose),
    /// Phase of the episode that a robot reports, if its agent runs on this host.
    Phase(RobotId, Phase),
    /// Answer of the state server to an operator, to be passed on; received only on the state server's host.
    Leading(Leading),
    /// Phase of the team in an instruction of the state server.
    Mode(Phase),
    /// Condition of the hardware of a robot whose Body runs on this host.
    Condition(RobotId, Hardware),
    /// Numbers of times that the guard of a robot whose agent runs on this host has stopped or slowed it.
    Guard(RobotId, SafetyCounts),
    /// Finding of a robot whose agent runs on this host about another robot, by a tracker.
    Found(RobotId, (RobotId, Finding)),
    /// A latent of this robot has arrived for the agents of this host.
    Latent(RobotId),
    /// Message of an observer, which asks for telemetry.
    Observe,
    /// The host is shutting down, which the Status tells the team until the process ends.
    Leave,
}

/// Configuration of a Status, the actor that reports the state of one host to operators, observers and the state
/// server.
#[derive(Clone, Debug)]
pub struct Config {
    /// Host whose state the actor reports.
    pub host: HostId,
    /// Robots whose Controllers run on this host.
    pub controllers: Vec<RobotId>,
    /// Robots whose Bodies run on this host.
    pub bodies: Vec<RobotId>,
}

/// Value that a Status has received, with its arrival time.
type Stamped<T> = (Time, T);

/// Newest pose, phase, hardware condition and guard counts of one robot, from which telemetry is made.
#[derive(Clone, Debug, Default)]
struct RobotTelemetry {
    seen: Option<Stamped<Pose>>,
    phase: Option<Phase>,
    hardware: Option<Hardware>,
    guard: Option<(SafetyCounts, Option<Trigger>)>,
    /// Other robots whose latents contradict the tracker.
    suspects: BTreeSet<RobotId>,
    /// Time at which the reason of its fault was last sent; `None` if never.
    reason_sent: Option<Time>,
}

/// Output message of a Status, the actor that reports the state of one host to operators, observers and the state
/// server.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Status message for operators and the state server.
    Status(wire::Status),
    /// Telemetry (condition of the host's robots) for observers.
    Telemetry(Telemetry),
}

/// Status: the actor of one host that answers operators, reports the host's presence to the state server, and sends
/// telemetry to observers.
#[derive(Debug)]
pub struct Status {
    host: HostId,
    robots: Vec<RobotId>,
    controllers: BTreeMap<RobotId, Stamped<Latch>>,
    bodies: BTreeMap<RobotId, Stamped<Latch>>,
    leading: Option<Stamped<Leading>>,
    leaves: bool,
    /// Whether the team waits for a host that shut down.
    waits: bool,
    sent_at: Option<Time>,
    due: Option<Time>,
    /// Telemetry by index in `robots`.
    telemetry: Vec<RobotTelemetry>,
    /// Arrival time of each robot's newest latent.
    latents: BTreeMap<RobotId, Time>,
    /// Time until which an observer counts as present.
    observed_until: Option<Time>,
    /// Time of the next telemetry message. `next_robot` is the index in `robots` of its first robot.
    next_telemetry: Time,
    next_robot: usize,
    /// Earliest time at which telemetry may again contain the reason of a robot's fault. Reasons are at least
    /// `REASON_PERIOD` apart, over all robots of the host.
    next_reason: Time,
}

impl Status {
    /// Creates a Status that has received nothing yet.
    pub fn new(config: &Config) -> Status {
        let robots: BTreeSet<RobotId> = config.controllers.iter().chain(&config.bodies).copied().collect();
        Status {
            host: config.host,
            telemetry: vec![RobotTelemetry::default(); robots.len()],
            robots: robots.into_iter().collect(),
            controllers: BTreeMap::new(),
            bodies: BTreeMap::new(),
            leading: None,
            leaves: false,
            waits: false,
            sent_at: None,
            due: None,
            latents: BTreeMap::new(),
            observed_until: None,
            next_telemetry: Time::ZERO,
            next_robot: 0,
            next_reason: Time::ZERO,
        }
    }

    /// Applies `change` to the stored telemetry of `robot`. Does nothing if the robot is not on this host.
    fn update(&mut self, robot: RobotId, change: impl FnOnce(&mut RobotTelemetry)) {
        if let Ok(place) = self.robots.binary_search(&robot) {
            change(&mut self.telemetry[place]);
        }
    }

    /// Sends one telemetry message about the next one or two robots of the host; the robots take turns.
    fn send_telemetry(&mut self, now: Time, out: &mut Vec<Out>) {
        let count = self.robots.len();
        let first = self.next_robot;
        let places = (0..count.min(ROBOTS_PER_MESSAGE)).map(move |nth| (first + nth) % count);
        let explained = self.explain(now, places.clone());
        let condition = |place: usize| {
            let RobotTelemetry { seen, phase, ref hardware, guard, ref suspects, .. } = self.telemetry[place];
            let (robot, hardware) = (self.robots[place], hardware.as_ref());
            let (decides, (counts, last)) = (self.controllers.contains_key(&robot), guard.unwrap_or_default());
            let age_ms = |at: Time| u32::try_from(now.since(at).as_nanos() / 1_000_000).unwrap_or(u32::MAX);
            Condition {
                robot,
                phase,
                seen: seen.map(|(at, pose)| Seen { pose, age_ms: age_ms(at) }),
                health: hardware.map(|hardware| hardware.health),
                battery: hardware.and_then(|hardware| hardware.battery),
                temperature: hardware.and_then(|hardware| hardware.temperature),
                reason: hardware.filter(|_| explained == Some(place)).and_then(|hardware| hardware.reason.clone()),
                guard: decides.then(|| GuardReport {
                    acted: u16::try_from(counts.total()).unwrap_or(u16::MAX),
                    late_ticks: u16::try_from(counts.late_tick).unwrap_or(u16::MAX),
                    last,
                }),
                link_age_ms: self.link_age_ms(now, robot).filter(|_| decides),
                suspect: suspects.first().copied(),
            }
        };
        let robots: Vec<Condition> = places.map(condition).collect();
        if !robots.is_empty() {
            out.push(Out::Telemetry(Telemetry::of(self.host, robots)));
        }
        self.next_robot = (self.next_robot + ROBOTS_PER_MESSAGE.min(count)) % count.max(1);
        let period = TELEMETRY_PERIODS[usize::from(count > 1)];
        self.next_telemetry = if explained.is_some() { now + period + period } else { now + period };
    }

    /// Returns the largest age \[ms\] among the newest latents of all robots except `robot`, those older than 1.5 s
    /// ignored; `None` if none is left.
    fn link_age_ms(&self, now: Time, robot: RobotId) -> Option<u16> {
        let ages = self.latents.iter().filter(|(from, _)| **from != robot).map(|(_, at)| now.since(*at));
        let oldest = ages.filter(|age| *age < LINK_TIMEOUT).max()?;
        u16::try_from(oldest.as_nanos() / 1_000_000).ok()
    }

    /// Returns the index in `self.robots` of the robot whose fault reason this telemetry message contains: of the
    /// faulty robots at the indices `places`, the one that has waited longest. `None` if none is faulty or it is too
    /// early.
    fn explain(&mut self, now: Time, places: impl Iterator<Item = usize>) -> Option<usize> {
        let faulty = |place: &usize| self.telemetry[*place].hardware.as_ref().is_some_and(|h| h.reason.is_some());
        let next = places.filter(faulty).min_by_key(|place| self.telemetry[*place].reason_sent);
        let next = next.filter(|_| self.next_reason <= now)?;
        self.telemetry[next].reason_sent = Some(now);
        self.next_reason = now + REASON_PERIOD;
        Some(next)
    }

    /// Schedules a status message after `wait`, and no earlier than one `period` after the last one. A message that is
    /// already scheduled earlier stays.
    fn plan(&mut self, now: Time, wait: Span, period: Span) {
        let due = self.sent_at.map_or(now + wait, |at| (at + period).max(now + wait));
        self.due = Some(self.due.map_or(due, |before| before.min(due)));
    }

    fn send_status(&self, now: Time, out: &mut Vec<Out>) {
        let fresh = |stamped: Option<&Stamped<Latch>>| {
            stamped.filter(|(at, _)| now.since(*at) < STALE).map(|(_, latch)| *latch)
        };
        let leading =
            self.leading.as_ref().filter(|(at, _)| now.since(*at) < STALE).map(|(_, leading)| leading.clone());
        let mut blocks: Vec<&[RobotId]> = self.robots.chunks(MAX_BLOCK).collect();
        if blocks.is_empty() {
            blocks.push(&[]);
        }
        for block in blocks {
            let following = |&robot: &RobotId| Following {
                robot,
                controller: fresh(self.controllers.get(&robot)),
                body: fresh(self.bodies.get(&robot)),
            };
            let robots = block.iter().map(following).collect();
            out.push(Out::Status(wire::Status::of(self.host, self.leaves, robots, leading.clone())));
        }
    }
}

impl Core for Status {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, _: &mut Vec<Out>) {
        match input {
            In::Stop(stop) if stop.by.is_operator() => self.plan(now, GATHER_TIME, ANSWER_PERIOD),
            In::Stop(_) => {}
            In::Controller(robot, latch) => {
                self.controllers.insert(robot, (now, latch));
            }
            In::Body(robot, latch) => {
                self.bodies.insert(robot, (now, latch));
            }
            In::Leading(leading) => self.leading = Some((now, leading)),
            In::Mode(phase) => {
                self.waits = phase == Phase::Waiting;
                if self.waits {
                    self.plan(now, GATHER_TIME, PRESENCE_PERIOD);
                }
            }
            In::Seen(robot, pose) => self.update(robot, |telemetry| telemetry.seen = Some((now, pose))),
            In::Phase(robot, phase) => self.update(robot, |telemetry| telemetry.phase = Some(phase)),
            In::Condition(robot, hardware) => self.update(robot, |telemetry| telemetry.hardware = Some(hardware)),
            In::Guard(robot, counts) => self.update(robot, |telemetry| {
                let (before, last) = telemetry.guard.unwrap_or_default();
                telemetry.guard = Some((counts, counts.begun_since(&before).last().or(last)));
            }),
            In::Found(robot, (other, found)) => self.update(robot, |telemetry| {
                match found {
                    Finding::Suspect => telemetry.suspects.insert(other),
                    Finding::Cleared => telemetry.suspects.remove(&other),
                };
            }),
            In::Latent(robot) => {
                self.latents.insert(robot, now);
            }
            In::Observe => {
                if self.observed_until.is_none() {
                    self.next_telemetry = now.max(self.next_telemetry);
                }
                self.observed_until = Some(now + OBSERVER_TIMEOUT);
            }
            In::Leave => {
                self.leaves = true;
                self.due = Some(now);
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let telemetry = self.observed_until.map(|_| self.next_telemetry);
        [self.due, telemetry].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.due.is_some_and(|due| due <= now) {
            self.send_status(now, out);
            self.sent_at = Some(now);
            self.due = self.leaves.then_some(now + LEAVE_PERIOD);
        }
        if self.observed_until.is_some() && self.next_telemetry <= now {
            self.send_telemetry(now, out);
            self.observed_until = self.observed_until.filter(|until| *until > now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::wire::{Health, Wire};
    use crate::net::protocol::codec::{self, Flags, Header};

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn handle(status: &mut Status, ms: u64, input: In) {
        status.handle(at_ms(ms), input, &mut Vec::new());
    }

    fn woken(status: &mut Status) -> (Time, Vec<Out>) {
        let (due, mut out) = (status.wake_at().expect("it has something to say"), Vec::new());
        status.wake(due, &mut out);
        (due, out)
    }

    fn said(status: &mut Status) -> (Time, Vec<wire::Status>) {
        let (due, out) = woken(status);
        let said = |out| if let Out::Status(status) = out { status } else { panic!("{out:?}") };
        (due, out.into_iter().map(said).collect())
    }

    #[test]
    fn an_observer_gets_telemetry_of_all_robots_in_turn_while_it_is_present() {
        let mut status = host(3);
        let pose = |x: f32| Pose { position: crate::messages::geometry::Vec2::new(x, 0.0), heading: Some(0.5) };
        handle(&mut status, 900, In::Seen(RobotId(1), pose(7.0)));
        handle(&mut status, 900, In::Phase(RobotId(1), Phase::Running));
        let faulty = Hardware { battery: Some(12), ..Hardware::of(Health::Faulty) };
        handle(&mut status, 900, In::Condition(RobotId(2), faulty));
        handle(&mut status, 900, In::Seen(RobotId(9), pose(1.0)));
        (0..2).for_each(|robot| handle(&mut status, 900, In::Controller(RobotId(robot), Latch::default())));
        let counts = SafetyCounts { late_tick: 60_000, stop: 9000, ..SafetyCounts::default() };
        handle(&mut status, 900, In::Guard(RobotId(1), counts));
        handle(&mut status, 900, In::Guard(RobotId(1), SafetyCounts { fence: 1, ..counts }));
        for (ms, robot) in [(600, 7), (700, 0), (900, 1)] {
            handle(&mut status, ms, In::Latent(RobotId(robot)));
        }
        assert_eq!(status.wake_at(), None, "there is no observer");
        handle(&mut status, 1000, In::Observe);
        let mut told = Vec::new();
        while status.wake_at().is_some() {
            let (due, out) = woken(&mut status);
            for out in out {
                let Out::Telemetry(telemetry) = out else { panic!("{out:?}") };
                told.push((due, telemetry.robots));
            }
        }
        let order: Vec<u16> = told.iter().take(3).flat_map(|(_, robots)| robots.iter().map(|r| r.robot.0)).collect();
        assert_eq!(order, [0, 1, 2, 0, 1, 2]);
        let (last, _) = told.last().unwrap();
        assert_eq!((told[0].0, told[1].0, *last), (at_ms(1000), at_ms(1330), at_ms(3640)));
        let header = Header { flags: Flags(0), team: 7, sender: HostId(4), incarnation: u32::MAX, sequence: u32::MAX };
        let message = Wire::Telemetry(Telemetry::of(HostId(4), told[0].1.clone()));
        let bytes = codec::encode(&header, &message).unwrap().len() + codec::TAG_BYTES;
        assert!(bytes * 100 / 33 < 330, "{bytes} bytes a message");
        let one = &told[0].1[1];
        assert_eq!((one.phase, one.seen), (Some(Phase::Running), Some(Seen { pose: pose(7.0), age_ms: 100 })));
        let acted = GuardReport { acted: u16::MAX, late_ticks: 60_000, last: Some(Trigger::Fence) };
        assert_eq!((one.guard, one.link_age_ms), (Some(acted), Some(400)), "not its own message");
        assert_eq!((told[1].1[0].guard, told[1].1[0].link_age_ms), (None, None), "its agent runs elsewhere");
        let later = told.iter().find(|(due, _)| *due > at_ms(2400)).map(|(_, robots)| robots[0].link_age_ms);
        assert_eq!(later, Some(None), "nobody was heard for a while");
        let unknown = &told[0].1[0];
        assert_eq!((unknown.phase, unknown.seen, unknown.health), (None, None, None), "unknown values stay unknown");
        assert_eq!((told[1].1[0].health, told[1].1[0].battery), (Some(Health::Faulty), Some(12)));
    }

    #[test]
    fn telemetry_names_a_robot_that_is_suspected_until_it_is_cleared() {
        let mut status = host(1);
        handle(&mut status, 0, In::Controller(RobotId(0), Latch::default()));
        handle(&mut status, 0, In::Observe);
        let mut told = |found: Option<(u16, Finding)>| {
            let (due, out) = woken(&mut status);
            let Some(Out::Telemetry(telemetry)) = out.first() else { panic!("{out:?}") };
            let suspect = telemetry.robots[0].suspect;
            if let Some((robot, found)) = found {
                status.handle(due, In::Found(RobotId(0), (RobotId(robot), found)), &mut Vec::new());
            }
            suspect.map(|robot| robot.0)
        };
        assert_eq!(told(Some((4, Finding::Suspect))), None);
        assert_eq!(told(Some((3, Finding::Suspect))), Some(4));
        assert_eq!(told(Some((3, Finding::Cleared))), Some(3), "the first of two");
        assert_eq!((told(Some((4, Finding::Cleared))), told(None)), (Some(4), None));
    }

    #[test]
    fn reasons_of_faults_take_turns_within_the_budget() {
        for robots in [1, 4] {
            let mut status = host(robots);
            for robot in 0..robots {
                let why = format!("{robot}{}", "x".repeat(79));
                let hardware = Hardware { battery: Some(100), ..Hardware::of(Health::Faulty).because(&why) };
                let hardware = Hardware { temperature: wire::Celsius::of(99.0), ..hardware };
                handle(&mut status, 0, In::Condition(RobotId(robot), hardware));
                handle(&mut status, 0, In::Seen(RobotId(robot), Pose { heading: Some(1.0), ..Pose::default() }));
                handle(&mut status, 0, In::Controller(RobotId(robot), Latch::default()));
                let counts = SafetyCounts { late_tick: 70_000, stop: 70_000, ..SafetyCounts::default() };
                handle(&mut status, 0, In::Guard(RobotId(robot), counts));
            }
            let header = Header { flags: Flags(0), team: 7, sender: HostId(4), incarnation: 1, sequence: u32::MAX };
            let (mut bytes, mut reasons) = (0, std::collections::BTreeMap::new());
            for second in 0..10 {
                handle(&mut status, 1000 * second, In::Observe);
                handle(&mut status, 1000 * second, In::Latent(RobotId(9)));
                while let Some(due) = status.wake_at().filter(|due| *due < at_ms(1000 * second + 1000)) {
                    let mut out = Vec::new();
                    status.wake(due, &mut out);
                    for out in out {
                        let Out::Telemetry(telemetry) = out else { panic!("{out:?}") };
                        for robot in telemetry.robots.iter().filter(|robot| robot.reason.is_some()) {
                            *reasons.entry(robot.robot).or_insert(0) += 1;
                        }
                        bytes += codec::encode(&header, &Wire::Telemetry(telemetry)).unwrap().len() + codec::TAG_BYTES;
                    }
                }
            }
            assert!(bytes < 3300, "{robots} robots: {bytes} bytes in 10 s");
            let all: u64 = reasons.values().sum();
            assert!(reasons.len() == usize::from(robots) && (8..=10).contains(&all), "{robots} robots: {reasons:?}");
        }
    }

    fn host(robots: u16) -> Status {
        let robots: Vec<RobotId> = (0..robots).map(RobotId).collect();
        Status::new(&Config { host: HostId(4), controllers: robots.clone(), bodies: robots })
    }

    const OPERATOR: HostId = HostId::operator(7);

    #[test]
    fn every_operator_is_answered_with_recent_latches_and_not_too_often() {
        let mut status = host(2);
        handle(&mut status, 0, In::Stop(Stop::engage(HostId(1), Latch::default())));
        assert_eq!(status.wake_at(), None, "a host wants no answer");
        handle(&mut status, 0, In::Controller(RobotId(0), Latch::engaged(1)));
        handle(&mut status, 450, In::Body(RobotId(0), Latch::engaged(1)));
        for at in [499, 500, 510] {
            handle(&mut status, at, In::Stop(Stop::ask(OPERATOR)));
        }
        let (due, out) = said(&mut status);
        assert_eq!((due, out[0].host, out[0].robots.len()), (at_ms(500), HostId(4), 2));
        assert_eq!((out[0].robots[0].controller, out[0].robots[0].body), (None, Some(Latch::engaged(1))), "one is old");
        assert_eq!(out[0].robots[1].body, None, "robot 1 has said nothing");
        handle(&mut status, 505, In::Stop(Stop::ask(OPERATOR)));
        assert_eq!(status.wake_at(), Some(at_ms(520)));
    }

    #[test]
    fn many_robots_are_reported_in_blocks_and_a_host_without_any_answers_too() {
        let mut status = host(65);
        handle(&mut status, 0, In::Stop(Stop::ask(OPERATOR)));
        let blocks: Vec<usize> = said(&mut status).1.iter().map(|said| said.robots.len()).collect();
        assert_eq!(blocks, [64, 1]);
        let mut server = host(0);
        handle(&mut server, 0, In::Leading(Leading { latch: Latch::held(2), hindrances: Vec::new() }));
        handle(&mut server, 0, In::Stop(Stop::ask(OPERATOR)));
        assert!(matches!(&said(&mut server).1[..], [only] if only.leading.is_some()));
    }

    #[test]
    fn a_leaving_host_repeats_that_until_it_ends_and_a_present_one_reports_while_the_team_waits() {
        let mut status = host(1);
        handle(&mut status, 0, In::Mode(Phase::Running));
        assert_eq!(status.wake_at(), None);
        handle(&mut status, 100, In::Mode(Phase::Waiting));
        let (_, here) = said(&mut status);
        assert!(!here[0].leaves && here[0].robots.len() == 1);
        handle(&mut status, 150, In::Mode(Phase::Waiting));
        assert_eq!(status.wake_at(), Some(at_ms(301)), "not with every instruction");
        handle(&mut status, 160, In::Leave);
        assert_eq!(said(&mut status).0, at_ms(160));
        assert!(said(&mut status).1[0].leaves);
        assert_eq!(status.wake_at(), Some(at_ms(220)));
    }
}
