//! Order: one operator's stop, re-arm or resume, from its first message to the last confirmation.
//!
//! It repeats its message, takes the answers of hosts, and tracks which robots have confirmed. A re-arm or a resume
//! first asks for the state of the latch; a stop does not wait.

use std::collections::BTreeMap;

use crate::actor::Core;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::{self, Latch};
use crate::messages::wire::{Following, Hindrance, Leading, Status, Stop};
use crate::time::{Span, Time};

/// Period of repetition.
pub const PERIOD: Span = Span::from_millis(20);

/// Wait for further answers after the first one, before the operator fixes which stop or hold it means.
const SETTLING: Span = Span::from_millis(200);

/// Kind of an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
    /// All robots stop.
    Stop,
    /// The stop is taken back; the team stays held.
    Rearm,
    /// The hold ends and the next episode begins.
    Resume,
}

impl Wish {
    /// Whether an actor that follows this latch has carried out the order.
    fn is_met_by(self, latch: Latch) -> bool {
        match self {
            Wish::Stop => latch.is_engaged(),
            Wish::Rearm => !latch.is_engaged(),
            Wish::Resume => latch.is_clear(),
        }
    }
}

/// Reason why a robot has not confirmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lack {
    /// Neither its controller nor its body has answered.
    Silent,
    /// Its body has confirmed; its controller has not.
    Controller,
    /// Its controller has confirmed; its body has not.
    Body,
    /// Both have answered, and neither has confirmed.
    Unmet,
}

/// One order of one operator.
#[derive(Debug)]
pub struct Order {
    me: HostId,
    wish: Wish,
    robots: usize,
    controllers: BTreeMap<RobotId, Latch>,
    bodies: BTreeMap<RobotId, Latch>,
    leading: Option<Leading>,
    /// The stop to take back or the hold to end. Fixed once, so that a later stop is not meant.
    target: Option<Latch>,
    /// Time of the first answer of a host.
    heard: Option<Time>,
    next: Time,
    met: Option<Time>,
}

impl Order {
    /// Makes an order of which nothing was sent yet.
    pub fn new(me: HostId, wish: Wish, robots: usize) -> Order {
        let (controllers, bodies) = (BTreeMap::new(), BTreeMap::new());
        Order {
            me,
            wish,
            robots,
            controllers,
            bodies,
            leading: None,
            target: None,
            heard: None,
            next: Time::ZERO,
            met: None,
        }
    }

    /// Time at which all robots had confirmed.
    pub fn met(&self) -> Option<Time> {
        self.met
    }

    /// Latch and hindrances from the state server's last answer.
    pub fn leading(&self) -> Option<&Leading> {
        self.leading.as_ref()
    }

    /// The team's latch: the latest that is known, without one that a single robot claims and that is out of reach.
    pub fn latch(&self) -> Option<Latch> {
        let latches = self.controllers.values().chain(self.bodies.values()).copied();
        let known = match &self.leading {
            Some(leading) => leading.latch,
            None => latches.clone().min()?,
        };
        Some(latch::latest(known, latches))
    }

    /// Whether others have stopped, re-armed or resumed the team since this order was given.
    pub fn is_overtaken(&self) -> bool {
        let meant = self.target.map(|target| target.number() + 1);
        meant.zip(self.latch()).is_some_and(|(meant, latch)| latch.number() > meant)
    }

    /// The robots that have not confirmed, with the reasons.
    pub fn lacking(&self) -> Vec<(RobotId, Lack)> {
        let lack = |robot: RobotId| {
            let met = |parts: &BTreeMap<RobotId, Latch>| parts.get(&robot).map(|latch| self.wish.is_met_by(*latch));
            match (met(&self.controllers), met(&self.bodies)) {
                (Some(true), Some(true)) => None,
                (None, None) => Some(Lack::Silent),
                (_, Some(true)) => Some(Lack::Controller),
                (Some(true), _) => Some(Lack::Body),
                _ => Some(Lack::Unmet),
            }
        };
        RobotId::team(self.robots).filter_map(|robot| Some((robot, lack(robot)?))).collect()
    }

    /// The robots for which the state server refuses a resume.
    pub fn hindrances(&self) -> &[(RobotId, Hindrance)] {
        self.leading.as_ref().map_or(&[], |leading| &leading.hindrances)
    }

    fn hear(&mut self, now: Time, status: Status) {
        for Following { robot, controller, body } in status.robots {
            self.controllers.extend(controller.map(|latch| (robot, latch)));
            self.bodies.extend(body.map(|latch| (robot, latch)));
        }
        self.leading = status.leading.or(self.leading.take());
        self.heard = self.heard.or(Some(now));
        // A stop holds without a state server; only the state server can confirm that a team goes on.
        let led = self.wish == Wish::Stop || self.leading.as_ref().is_some_and(|l| self.wish.is_met_by(l.latch));
        if self.met.is_none() && led && self.lacking().is_empty() {
            self.met = Some(now);
        }
    }

    /// Fixes the target once all robots have answered, or should have.
    fn aim(&mut self, now: Time) {
        let silent = || self.lacking().iter().any(|(_, lack)| *lack == Lack::Silent);
        let waited = self.heard.is_some_and(|heard| now.since(heard) >= SETTLING);
        if self.target.is_none() && self.leading.is_some() && (waited || !silent()) {
            self.target = self.latch();
        }
    }

    /// The message to repeat now.
    fn word(&self) -> Stop {
        let me = self.me;
        match (self.wish, self.target) {
            (Wish::Stop, _) => match self.latch() {
                // It is engaged: a later number would only make it grow.
                Some(latch) if latch.is_engaged() => Stop { by: me, latch },
                known => Stop::engage(me, known.unwrap_or_default()),
            },
            (Wish::Rearm, Some(stop)) if stop.is_engaged() => Stop::rearm(me, stop),
            (Wish::Resume, Some(hold)) if hold.is_held() => Stop::resume(me, hold),
            _ => Stop::ask(me),
        }
    }
}

impl Core for Order {
    type In = Status;
    type Out = Stop;

    fn handle(&mut self, now: Time, status: Status, _: &mut Vec<Stop>) {
        self.hear(now, status);
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Stop>) {
        self.aim(now);
        out.push(self.word());
        self.next = now + PERIOD;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ME: HostId = HostId::operator(3);

    fn word(order: &mut Order) -> Stop {
        let (now, mut out) = (order.wake_at().unwrap(), Vec::new());
        order.wake(now, &mut out);
        out[0]
    }

    fn hear(order: &mut Order, robots: &[(u16, Option<Latch>, Option<Latch>)], leading: Option<Leading>) {
        let following = |&(robot, controller, body)| Following { robot: RobotId(robot), controller, body };
        let robots = robots.iter().map(following).collect();
        let status = Status { host: HostId(0), leaves: false, robots, leading };
        order.handle(order.next, status, &mut Vec::new());
    }

    fn leading(latch: Latch) -> Option<Leading> {
        Some(Leading { latch, hindrances: Vec::new() })
    }

    #[test]
    fn a_stop_is_said_at_once_and_met_when_controllers_and_bodies_say_so() {
        let mut order = Order::new(ME, Wish::Stop, 2);
        assert!(word(&mut order).latch.is_engaged());
        let (stopped, free) = (Some(Latch::engaged(1)), Some(Latch::clear(0)));
        assert_eq!(order.lacking(), [(RobotId(0), Lack::Silent), (RobotId(1), Lack::Silent)]);
        hear(&mut order, &[(0, stopped, None), (1, stopped, stopped)], None);
        assert_eq!((order.met(), order.lacking()), (None, vec![(RobotId(0), Lack::Body)]));
        hear(&mut order, &[(0, None, free)], None);
        assert_eq!(order.lacking(), [(RobotId(0), Lack::Body)]);
        hear(&mut order, &[(0, None, stopped)], None);
        assert!(order.met().is_some(), "no state server is needed for a stop");
    }

    #[test]
    fn a_stop_that_is_repeated_makes_no_number_grow() {
        let mut order = Order::new(ME, Wish::Stop, 1);
        let stopped = Some(Latch::engaged(7));
        hear(&mut order, &[(0, stopped, stopped)], leading(Latch::engaged(7)));
        let said: Vec<Latch> = (0..150).map(|_| word(&mut order).latch).collect();
        assert!(said.iter().all(|latch| *latch == Latch::engaged(7)));
    }

    #[test]
    fn a_re_arm_asks_first_and_takes_back_that_very_stop() {
        let mut order = Order::new(ME, Wish::Rearm, 1);
        assert_eq!(word(&mut order), Stop::ask(ME));
        let far = Some(Latch::engaged(1 << 50));
        hear(&mut order, &[(0, far, Some(Latch::engaged(5)))], leading(Latch::engaged(5)));
        assert_eq!(word(&mut order), Stop::rearm(ME, Latch::engaged(5)), "whatever one robot claims");
        let held = Some(Latch::held(6));
        hear(&mut order, &[(0, held, held)], None);
        assert_eq!(order.met(), None, "the state server has not confirmed");
        let again = Some(Latch::engaged(7));
        hear(&mut order, &[(0, again, again)], leading(Latch::engaged(7)));
        assert_eq!(word(&mut order), Stop::rearm(ME, Latch::engaged(5)), "a later stop is not meant");
        assert!(order.is_overtaken() && order.met().is_none());
    }

    #[test]
    fn a_resume_is_said_to_the_hold_that_was_there_and_to_no_stop_or_later_hold() {
        let mut refused = Order::new(ME, Wish::Resume, 1);
        let (stopped, held) = (Some(Latch::engaged(5)), Some(Latch::held(6)));
        hear(&mut refused, &[(0, stopped, stopped)], leading(Latch::engaged(5)));
        assert_eq!(word(&mut refused), Stop::ask(ME), "a stop has to be taken back first");
        hear(&mut refused, &[(0, held, held)], leading(Latch::held(6)));
        assert_eq!(word(&mut refused), Stop::ask(ME), "that was not so when it was asked for");

        let mut order = Order::new(ME, Wish::Resume, 1);
        assert_eq!(word(&mut order), Stop::ask(ME));
        hear(&mut order, &[(0, held, held)], leading(Latch::held(6)));
        assert_eq!(word(&mut order), Stop::resume(ME, Latch::held(6)));
        hear(&mut order, &[], leading(Latch::held(8)));
        assert_eq!(word(&mut order), Stop::resume(ME, Latch::held(6)), "another hold, after another stop");
        assert!(order.is_overtaken());
        let clear = Latch::clear(7);
        let mut order = Order::new(ME, Wish::Resume, 1);
        hear(&mut order, &[(0, Some(clear), Some(clear))], leading(clear));
        assert!(order.met().is_some());
    }
}
