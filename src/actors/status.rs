//! Status: the voice of one host. It tells operators how far the host's robots follow the emergency stop, and the state
//! server that the host leaves or is back.
//!
//! It answers every message of an operator, so that a confirmation reaches an operator in every deployment, also where
//! heartbeats cross no link.

use std::collections::{BTreeMap, BTreeSet};

use crate::actor::Core;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::wire::{self, Following, Health, Leading, MAX_BLOCK, Phase, Stop};
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

/// Everything that a Status accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// An operator asks, or engages or takes back the stop.
    Stop(Stop),
    /// The latch that a robot's controller follows.
    Controller(RobotId, Latch),
    /// The latch that a robot's body follows.
    Body(RobotId, Latch),
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
}

impl Status {
    /// The voice of a host of which nothing is known yet.
    pub fn new(config: &Config) -> Status {
        let robots: BTreeSet<RobotId> = config.controllers.iter().chain(&config.bodies).copied().collect();
        Status {
            host: config.host,
            robots: robots.into_iter().collect(),
            controllers: BTreeMap::new(),
            bodies: BTreeMap::new(),
            leading: None,
            leaves: false,
            waits: false,
            said: None,
            due: None,
        }
    }

    /// Speaks after `wait`, or as soon after the last time as `period` allows.
    fn plan(&mut self, now: Time, wait: Span, period: Span) {
        let due = self.said.map_or(now + wait, |said| (said + period).max(now + wait));
        self.due = Some(self.due.map_or(due, |before| before.min(due)));
    }

    fn say(&self, now: Time, out: &mut Vec<wire::Status>) {
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
            out.push(wire::Status {
                host: self.host,
                leaves: self.leaves,
                robots: block.iter().map(following).collect(),
                leading: leading.clone(),
            });
        }
    }
}

impl Core for Status {
    type In = In;
    type Out = wire::Status;

    fn handle(&mut self, now: Time, input: In, _: &mut Vec<wire::Status>) {
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
            In::Condition(..) | In::Observe => {}
            In::Leave => {
                self.leaves = true;
                self.due = Some(now);
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        self.due
    }

    fn wake(&mut self, now: Time, out: &mut Vec<wire::Status>) {
        self.say(now, out);
        self.said = Some(now);
        self.due = self.leaves.then_some(now + LEAVE_PERIOD);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn handle(status: &mut Status, ms: u64, input: In) {
        status.handle(at_ms(ms), input, &mut Vec::new());
    }

    fn said(status: &mut Status) -> (Time, Vec<wire::Status>) {
        let (due, mut out) = (status.wake_at().expect("it has something to say"), Vec::new());
        status.wake(due, &mut out);
        (due, out)
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
