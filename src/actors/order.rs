//! Order: one operator's stop, re-arm, hold or resume, from its first message to the last confirmation.
//!
//! It repeats its message, handles the answers of hosts, and tracks which robots have confirmed. Before a re-arm or a
//! resume it asks for the state of the emergency stop latch. A stop is sent at once. A hold is sent with the latch that
//! the caller gives.

use std::collections::BTreeMap;

use crate::actor::Core;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::{self, Latch};
use crate::messages::wire::{Following, Hindrance, Leading, Status, Stop};
use crate::net::protocol::link::LinkCounts;
use crate::time::{Span, Time};

/// Period at which an operator's order, such as a stop, repeats its message until the process ends.
pub const PERIOD: Span = Span::from_millis(20);

/// Time that an order waits after the first host's answer for the answers of other hosts. Then it fixes which stop or
/// hold it refers to.
const SETTLING: Span = Span::from_millis(200);

/// Kind of an operator's order to the team about the emergency stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OrderKind {
    /// Stop: all robots stop.
    Stop,
    /// Re-arm: the stop ends, and the team stays held.
    Rearm,
    /// Hold: the team is held without a stop before it. A hold during an episode aborts the episode.
    Hold,
    /// Resume: the hold ends, and the next episode begins.
    Resume,
}

impl OrderKind {
    /// Whether an actor with this latch has carried out the order.
    fn is_done_by(self, latch: Latch) -> bool {
        match self {
            OrderKind::Stop => latch.is_engaged(),
            OrderKind::Rearm => !latch.is_engaged(),
            OrderKind::Hold => latch.is_held(),
            OrderKind::Resume => latch.is_clear(),
        }
    }
}

/// Actors of one robot, its Controller or its Body or both, that have not carried out an operator's order or have not
/// answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unconfirmed {
    /// Neither the robot's Controller nor its Body has answered.
    Silent,
    /// The Body has carried out the order; the Controller has not, or has not answered.
    Controller,
    /// The Controller has carried out the order; the Body has not, or has not answered.
    Body,
    /// Controller and Body have answered, but neither has carried out the order.
    Both,
}

/// One order of an operator (stop, re-arm, hold or resume), with its message and the confirmations so far.
#[derive(Debug)]
pub struct Order {
    me: HostId,
    kind: OrderKind,
    robots: usize,
    controllers: BTreeMap<RobotId, Latch>,
    bodies: BTreeMap<RobotId, Latch>,
    leading: Option<Leading>,
    /// The stop to re-arm, or the hold to end. Fixed once, so that the order does not apply to a later stop.
    target: Option<Latch>,
    /// Time at which the first answer of a host arrived; `None` before it.
    first_answer: Option<Time>,
    next: Time,
    confirmed_at: Option<Time>,
    /// Counts of the operator's links, which tell whether the team has another key.
    links: LinkCounts,
}

impl Order {
    /// Creates an order of the given kind, of which nothing was sent yet. `me` is the operator's host id, `robots` the
    /// number of robots in the team.
    pub fn new(me: HostId, kind: OrderKind, robots: usize) -> Order {
        let (controllers, bodies) = (BTreeMap::new(), BTreeMap::new());
        Order {
            me,
            kind,
            robots,
            controllers,
            bodies,
            leading: None,
            target: None,
            first_answer: None,
            next: Time::ZERO,
            confirmed_at: None,
            links: LinkCounts::default(),
        }
    }

    /// Sets the counts of the operator's links so far.
    pub(crate) fn note_links(&mut self, links: LinkCounts) {
        self.links = links;
    }

    /// Returns the counts of the operator's links, as far as they were told.
    pub fn links(&self) -> &LinkCounts {
        &self.links
    }

    /// Creates an order that refers to the known emergency stop state `target`: the stop to re-arm, the hold to end, or
    /// the clear state to hold. It is sent at once, without first asking the team for its state. `me` is the operator's
    /// host id, `robots` the number of robots in the team.
    pub fn meaning(me: HostId, kind: OrderKind, robots: usize, target: Latch) -> Order {
        Order { target: Some(target), ..Order::new(me, kind, robots) }
    }

    /// Returns the time at which all robots had confirmed the order; `None` before that. An order other than a stop
    /// also needs the state server's confirmation.
    pub fn confirmed_at(&self) -> Option<Time> {
        self.confirmed_at
    }

    /// Returns the state server's last answer: its emergency stop state, and the robots that prevent a resume. `None`
    /// before the first answer.
    pub fn leading(&self) -> Option<&Leading> {
        self.leading.as_ref()
    }

    /// Returns the newest emergency stop state that the state server or a robot has reported; `None` before an answer.
    /// A state whose number is implausibly far ahead of the others is ignored.
    pub fn latch(&self) -> Option<Latch> {
        let latches = self.controllers.values().chain(self.bodies.values()).copied();
        let known = match &self.leading {
            Some(leading) => leading.latch,
            None => latches.clone().min()?,
        };
        Some(latch::latest(known, latches))
    }

    /// Whether a later stop, re-arm, hold or resume of someone else has replaced this order, which so has no effect any
    /// more.
    pub fn is_superseded(&self) -> bool {
        let meant = self.target.map(|target| target.number() + 1);
        meant.zip(self.latch()).is_some_and(|(meant, latch)| latch.number() > meant)
    }

    /// Returns the robots that have not carried out the order as far as is known, each with those of its actors
    /// (Controller, Body) that have not.
    pub fn unconfirmed(&self) -> Vec<(RobotId, Unconfirmed)> {
        let reason = |robot: RobotId| {
            let done = |parts: &BTreeMap<RobotId, Latch>| parts.get(&robot).map(|latch| self.kind.is_done_by(*latch));
            match (done(&self.controllers), done(&self.bodies)) {
                (Some(true), Some(true)) => None,
                (None, None) => Some(Unconfirmed::Silent),
                (_, Some(true)) => Some(Unconfirmed::Controller),
                (Some(true), _) => Some(Unconfirmed::Body),
                _ => Some(Unconfirmed::Both),
            }
        };
        RobotId::team(self.robots).filter_map(|robot| Some((robot, reason(robot)?))).collect()
    }

    /// Returns the robots that prevent a resume according to the state server, each with the reason.
    pub fn hindrances(&self) -> &[(RobotId, Hindrance)] {
        self.leading.as_ref().map_or(&[], |leading| &leading.hindrances)
    }

    fn take(&mut self, now: Time, status: Status) {
        for Following { robot, controller, body } in status.robots {
            self.controllers.extend(controller.map(|latch| (robot, latch)));
            self.bodies.extend(body.map(|latch| (robot, latch)));
        }
        self.leading = status.leading.or(self.leading.take());
        self.first_answer = self.first_answer.or(Some(now));
        // A stop needs no confirmation by the state server; a re-arm or a resume does.
        let led = self.kind == OrderKind::Stop || self.leading.as_ref().is_some_and(|l| self.kind.is_done_by(l.latch));
        if self.confirmed_at.is_none() && led && self.unconfirmed().is_empty() {
            self.confirmed_at = Some(now);
        }
    }

    /// Fixes the stop or hold that the order refers to, once all robots have answered or have had the time to.
    fn fix_target(&mut self, now: Time) {
        let silent = || self.unconfirmed().iter().any(|(_, reason)| *reason == Unconfirmed::Silent);
        let waited = self.first_answer.is_some_and(|heard| now.since(heard) >= SETTLING);
        if self.target.is_none() && self.leading.is_some() && (waited || !silent()) {
            self.target = self.latch();
        }
    }

    /// Whether the state server is still stopped: a re-arm has reached the robots and not it, and it takes none from
    /// their hosts.
    fn leads_stop(&self) -> bool {
        self.leading.as_ref().is_some_and(|leading| leading.latch.is_engaged())
    }

    /// Returns the message that the order sends now: its stop, re-arm, hold or resume, or a question for the latch
    /// until the latch to refer to is known.
    fn message(&self) -> Stop {
        let me = self.me;
        match (self.kind, self.target) {
            (OrderKind::Stop, _) => match self.latch() {
                // The stop is already engaged. A new number would only increase with every repetition.
                Some(latch) if latch.is_engaged() => Stop { by: me, latch },
                known => Stop::engage(me, known.unwrap_or_default()),
            },
            (OrderKind::Rearm, Some(stop)) if stop.is_engaged() || self.leads_stop() => Stop::rearm(me, stop),
            (OrderKind::Hold, Some(clear)) if clear.is_clear() => Stop::rearm(me, clear),
            (OrderKind::Resume, Some(hold)) if hold.is_held() => Stop::resume(me, hold),
            _ => Stop::ask(me),
        }
    }
}

impl Core for Order {
    type In = Status;
    type Out = Stop;

    fn handle(&mut self, now: Time, status: Status, _: &mut Vec<Stop>) {
        self.take(now, status);
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Stop>) {
        self.fix_target(now);
        out.push(self.message());
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
        let status = Status::of(HostId(0), false, robots, leading);
        order.handle(order.next, status, &mut Vec::new());
    }

    fn leading(latch: Latch) -> Option<Leading> {
        Some(Leading { latch, hindrances: Vec::new() })
    }

    #[test]
    fn a_stop_is_said_at_once_and_met_when_controllers_and_bodies_say_so() {
        let mut order = Order::new(ME, OrderKind::Stop, 2);
        assert!(word(&mut order).latch.is_engaged());
        let (stopped, free) = (Some(Latch::engaged(1)), Some(Latch::clear(0)));
        assert_eq!(order.unconfirmed(), [(RobotId(0), Unconfirmed::Silent), (RobotId(1), Unconfirmed::Silent)]);
        hear(&mut order, &[(0, stopped, None), (1, stopped, stopped)], None);
        assert_eq!((order.confirmed_at(), order.unconfirmed()), (None, vec![(RobotId(0), Unconfirmed::Body)]));
        hear(&mut order, &[(0, None, free)], None);
        assert_eq!(order.unconfirmed(), [(RobotId(0), Unconfirmed::Body)]);
        hear(&mut order, &[(0, None, stopped)], None);
        assert!(order.confirmed_at().is_some(), "no state server is needed for a stop");
    }

    #[test]
    fn a_stop_that_is_repeated_makes_no_number_grow() {
        let mut order = Order::new(ME, OrderKind::Stop, 1);
        let stopped = Some(Latch::engaged(7));
        hear(&mut order, &[(0, stopped, stopped)], leading(Latch::engaged(7)));
        let said: Vec<Latch> = (0..150).map(|_| word(&mut order).latch).collect();
        assert!(said.iter().all(|latch| *latch == Latch::engaged(7)));
    }

    #[test]
    fn a_re_arm_asks_first_and_takes_back_that_very_stop() {
        let mut order = Order::new(ME, OrderKind::Rearm, 1);
        assert_eq!(word(&mut order), Stop::ask(ME));
        let far = Some(Latch::engaged(1 << 50));
        hear(&mut order, &[(0, far, Some(Latch::engaged(5)))], leading(Latch::engaged(5)));
        assert_eq!(word(&mut order), Stop::rearm(ME, Latch::engaged(5)), "whatever one robot claims");
        let held = Some(Latch::held(6));
        hear(&mut order, &[(0, held, held)], None);
        assert_eq!(order.confirmed_at(), None, "the state server has not confirmed");
        let again = Some(Latch::engaged(7));
        hear(&mut order, &[(0, again, again)], leading(Latch::engaged(7)));
        assert_eq!(word(&mut order), Stop::rearm(ME, Latch::engaged(5)), "a later stop is not meant");
        assert!(order.is_superseded() && order.confirmed_at().is_none());
    }

    #[test]
    fn a_re_arm_that_has_missed_the_state_server_is_said_again_with_a_later_number() {
        let mut order = Order::new(ME, OrderKind::Rearm, 1);
        let held = Some(Latch::held(6));
        hear(&mut order, &[(0, held, held)], leading(Latch::engaged(5)));
        assert_eq!(word(&mut order), Stop { by: ME, latch: Latch::held(7) });
        assert_eq!(order.confirmed_at(), None);
        let later = Some(Latch::held(7));
        hear(&mut order, &[(0, later, later)], leading(Latch::held(7)));
        assert!(order.confirmed_at().is_some());
    }

    #[test]
    fn a_resume_is_said_to_the_hold_that_was_there_and_to_no_stop_or_later_hold() {
        let mut refused = Order::new(ME, OrderKind::Resume, 1);
        let (stopped, held) = (Some(Latch::engaged(5)), Some(Latch::held(6)));
        hear(&mut refused, &[(0, stopped, stopped)], leading(Latch::engaged(5)));
        assert_eq!(word(&mut refused), Stop::ask(ME), "a stop has to be taken back first");
        hear(&mut refused, &[(0, held, held)], leading(Latch::held(6)));
        assert_eq!(word(&mut refused), Stop::ask(ME), "that was not so when it was asked for");

        let mut order = Order::new(ME, OrderKind::Resume, 1);
        assert_eq!(word(&mut order), Stop::ask(ME));
        hear(&mut order, &[(0, held, held)], leading(Latch::held(6)));
        assert_eq!(word(&mut order), Stop::resume(ME, Latch::held(6)));
        hear(&mut order, &[], leading(Latch::held(8)));
        assert_eq!(word(&mut order), Stop::resume(ME, Latch::held(6)), "another hold, after another stop");
        assert!(order.is_superseded());
        let clear = Latch::clear(7);
        let mut order = Order::new(ME, OrderKind::Resume, 1);
        hear(&mut order, &[(0, Some(clear), Some(clear))], leading(clear));
        assert!(order.confirmed_at().is_some());
    }
}
