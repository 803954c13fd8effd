//! Status: the voice of one host. It tells operators how far the host's robots follow the emergency stop, and the state
//! server that the host leaves or is back.
//!
//! It answers every message of an operator, so that a confirmation reaches an operator in every deployment, also where
//! heartbeats cross no link. While an observer is there, it tells where the host's robots are and how they do.

use std::collections::{BTreeMap, BTreeSet};

use crate::actor::Core;
use crate::messages::geometry::Pose;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::wire::{self, Condition, Following, Health, Leading, MAX_BLOCK, Phase, Seen, Stop, Telemetry};
use crate::time::{Span, Time};

/// How long it waits for what the host's actors make of an operator's message.
const GATHER: Span = Span::from_millis(1);
/// How often it answers operators at the most: as often as one of them speaks.
const ANSWER_PERIOD: Span = Span::from_millis(20);
/// How often a host that leaves says so until it ends.
const LEAVE_PERIOD: Span = Span::from_millis(30);
/// How often a host says that it is here while the team waits for another.
const HERE_PERIOD: Span = Span::from_millis(200);
/// How long after an actor has told its latch that is worth telling: two of a controller's heartbeats and some.
const STALE: Span = Span::from_millis(500);

/// How long after an observer was last heard it counts as there: one of its words may be lost.
const OBSERVED: Span = Span::from_millis(2500);
/// How often telemetry is told of one robot, and of several. With it a host says less than 330 bytes a second, tag
/// included: what the budget of soft state has left in a team of 50 (docs/wire.md).
const TELEMETRY_PERIODS: [Span; 2] = [Span::from_millis(200), Span::from_millis(300)];
/// Robots in one telling; of more, some are told each time, in turn.
const TOLD_AT_ONCE: usize = 2;

/// Everything that a Status accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// An operator asks, or engages or takes back the stop.
    Stop(Stop),
    /// The latch that a robot's controller follows.
    Controller(RobotId, Latch),
    /// The latch that a robot's body follows.
    Body(RobotId, Latch),
    /// Where a robot was measured, for the host that runs its agent.
    Seen(RobotId, Pose),
    /// How far a robot of an agent of this host has come.
    Phase(RobotId, Phase),
    /// The state server, which runs here, answers.
    Leading(Leading),
    /// The phase that the team is in.
    Mode(Phase),
    /// How a robot of this host is, and what is left of its battery \[%\].
    Condition(RobotId, Health, Option<u8>),
    /// Somebody looks at the team.
    Observe,
    /// The host is told to end.
    Leave,
}

/// The parts of robots that a host runs.
#[derive(Clone, Debug)]
pub struct Config {
    /// The host.
    pub host: HostId,
    /// The robots whose controllers run here.
    pub controllers: Vec<RobotId>,
    /// The robots whose bodies run here.
    pub bodies: Vec<RobotId>,
}

/// Something that was told, and when.
type Told<T> = (Time, T);

/// What is known of one robot for those who look at the team.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    seen: Option<Told<Pose>>,
    phase: Option<Phase>,
    condition: Option<(Health, Option<u8>)>,
}

/// What a Status says.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// To operators and the state server.
    Status(wire::Status),
    /// To observers.
    Telemetry(Telemetry),
}

/// One host's voice.
#[derive(Debug)]
pub struct Status {
    host: HostId,
    robots: Vec<RobotId>,
    controllers: BTreeMap<RobotId, Told<Latch>>,
    bodies: BTreeMap<RobotId, Told<Latch>>,
    leading: Option<Told<Leading>>,
    leaves: bool,
    /// Whether the team waits for a host.
    waits: bool,
    said: Option<Time>,
    due: Option<Time>,
    /// By place in `robots`.
    known: Vec<Known>,
    /// Until when an observer is there.
    observed: Option<Time>,
    /// When telemetry is told next, and of which robot first.
    telemetry: Time,
    first: usize,
}

impl Status {
    /// The voice of a host of which nothing is known yet.
    pub fn new(config: &Config) -> Status {
        let robots: BTreeSet<RobotId> = config.controllers.iter().chain(&config.bodies).copied().collect();
        Status {
            host: config.host,
            known: vec![Known::default(); robots.len()],
            robots: robots.into_iter().collect(),
            controllers: BTreeMap::new(),
            bodies: BTreeMap::new(),
            leading: None,
            leaves: false,
            waits: false,
            said: None,
            due: None,
            observed: None,
            telemetry: Time::ZERO,
            first: 0,
        }
    }

    /// What is known of a robot of this host.
    fn know(&mut self, robot: RobotId, note: impl FnOnce(&mut Known)) {
        if let Ok(place) = self.robots.binary_search(&robot) {
            note(&mut self.known[place]);
        }
    }

    /// Tells of the next robots in turn.
    fn tell(&mut self, now: Time, out: &mut Vec<Out>) {
        let count = self.robots.len();
        let places = (0..count.min(TOLD_AT_ONCE)).map(|nth| (self.first + nth) % count);
        let condition = |place: usize| {
            let Known { seen, phase, condition } = self.known[place];
            let age_ms = |at: Time| u32::try_from(now.since(at).as_nanos() / 1_000_000).unwrap_or(u32::MAX);
            Condition {
                robot: self.robots[place],
                phase,
                seen: seen.map(|(at, pose)| Seen { pose, age_ms: age_ms(at) }),
                health: condition.map(|(health, _)| health),
                battery: condition.and_then(|(_, battery)| battery),
            }
        };
        let robots: Vec<Condition> = places.map(condition).collect();
        if !robots.is_empty() {
            out.push(Out::Telemetry(Telemetry { host: self.host, robots }));
        }
        self.first = (self.first + TOLD_AT_ONCE.min(count)) % count.max(1);
        self.telemetry = now + TELEMETRY_PERIODS[usize::from(count > 1)];
    }

    /// Speaks after `wait`, or as soon after the last time as `period` allows.
    fn plan(&mut self, now: Time, wait: Span, period: Span) {
        let due = self.said.map_or(now + wait, |said| (said + period).max(now + wait));
        self.due = Some(self.due.map_or(due, |before| before.min(due)));
    }

    fn say(&self, now: Time, out: &mut Vec<Out>) {
        let fresh = |told: Option<&Told<Latch>>| told.filter(|(at, _)| now.since(*at) < STALE).map(|(_, latch)| *latch);
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
            out.push(Out::Status(wire::Status {
                host: self.host,
                leaves: self.leaves,
                robots: block.iter().map(following).collect(),
                leading: leading.clone(),
            }));
        }
    }
}

impl Core for Status {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, _: &mut Vec<Out>) {
        match input {
            In::Stop(stop) if stop.by.is_operator() => self.plan(now, GATHER, ANSWER_PERIOD),
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
                    self.plan(now, GATHER, HERE_PERIOD);
                }
            }
            In::Seen(robot, pose) => self.know(robot, |known| known.seen = Some((now, pose))),
            In::Phase(robot, phase) => self.know(robot, |known| known.phase = Some(phase)),
            In::Condition(robot, health, battery) => {
                self.know(robot, |known| known.condition = Some((health, battery)));
            }
            In::Observe => {
                if self.observed.is_none() {
                    self.telemetry = now.max(self.telemetry);
                }
                self.observed = Some(now + OBSERVED);
            }
            In::Leave => {
                self.leaves = true;
                self.due = Some(now);
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let telemetry = self.observed.map(|_| self.telemetry);
        [self.due, telemetry].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.due.is_some_and(|due| due <= now) {
            self.say(now, out);
            self.said = Some(now);
            self.due = self.leaves.then_some(now + LEAVE_PERIOD);
        }
        if self.observed.is_some() && self.telemetry <= now {
            self.tell(now, out);
            self.observed = self.observed.filter(|until| *until > now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::wire::Wire;
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
    fn an_observer_is_told_of_all_robots_in_turn_as_long_as_it_is_there() {
        let mut status = host(3);
        let pose = |x: f32| Pose { position: crate::messages::geometry::Vec2::new(x, 0.0), heading: Some(0.5) };
        handle(&mut status, 900, In::Seen(RobotId(1), pose(7.0)));
        handle(&mut status, 900, In::Phase(RobotId(1), Phase::Running));
        handle(&mut status, 900, In::Condition(RobotId(2), Health::Faulty, Some(12)));
        handle(&mut status, 900, In::Seen(RobotId(9), pose(1.0)));
        assert_eq!(status.wake_at(), None, "nobody looks");
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
        assert_eq!((told[0].0, told[1].0, *last), (at_ms(1000), at_ms(1300), at_ms(3700)));
        let header = Header { flags: Flags(0), team: 7, sender: HostId(4), incarnation: u32::MAX, sequence: u32::MAX };
        let message = Wire::Telemetry(Telemetry { host: HostId(4), robots: told[0].1.clone() });
        let bytes = codec::encode(&header, &message).unwrap().len() + codec::TAG_BYTES;
        assert!(bytes * 10 / 3 < 330, "{bytes} bytes a telling");
        let one = told[0].1[1];
        assert_eq!((one.phase, one.seen), (Some(Phase::Running), Some(Seen { pose: pose(7.0), age_ms: 100 })));
        let unknown = told[0].1[0];
        assert_eq!(
            (unknown.phase, unknown.seen, unknown.health),
            (None, None, None),
            "what is not known is not made up"
        );
        assert_eq!((told[1].1[0].health, told[1].1[0].battery), (Some(Health::Faulty), Some(12)));
    }

    fn host(robots: u16) -> Status {
        let robots: Vec<RobotId> = (0..robots).map(RobotId).collect();
        Status::new(&Config { host: HostId(4), controllers: robots.clone(), bodies: robots })
    }

    const OPERATOR: HostId = HostId::operator(7);

    #[test]
    fn every_operator_is_answered_with_what_is_known_of_late_and_not_too_often() {
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
    fn many_robots_are_told_in_blocks_and_a_host_without_any_speaks_too() {
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
    fn a_host_that_leaves_says_so_until_it_ends_and_one_that_is_here_while_others_are_waited_for() {
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
