//! Orders from the live page, one at a time: stop, re-arm, resume or hold. They use the same state machine as
//! `murmurate stop`.

use murmurate::actor::Core;
use murmurate::actors::order::{Order, OrderKind};
use murmurate::messages::ids::HostId;
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Status, Stop};
use murmurate::time::{Span, Time};

/// Longest time that an order waits for the robots' confirmations.
const PATIENCE: Span = Span::from_millis(3000);
/// Shortest time for which an order is repeated, so that hosts that missed it receive it.
const AT_LEAST: Span = Span::from_millis(500);

/// Orders that a process gives to its team for the live page (stop, re-arm, resume, hold): the one in progress, and the
/// result of the last one.
#[derive(Debug)]
pub struct Orders {
    me: HostId,
    robots: usize,
    running: Option<(Order, OrderKind, Time)>,
    /// Result of the last order as text, until it is taken.
    result: Option<String>,
}

impl Orders {
    /// Returns orders of which none is in progress. `me` is the host id of this process as an operator, `robots` the
    /// number of robots.
    pub fn new(me: HostId, robots: usize) -> Orders {
        Orders { me, robots, running: None, result: None }
    }

    /// Starts an order of this kind, in place of the order in progress. A stop in progress continues if a stop is given
    /// again. Until it is confirmed, other orders are refused with an error text.
    pub fn give(&mut self, now: Time, kind: OrderKind) -> Result<(), &'static str> {
        match &self.running {
            Some((order, OrderKind::Stop, _)) if kind != OrderKind::Stop && order.confirmed_at().is_none() => {
                Err("the stop is not confirmed yet")
            }
            Some((_, OrderKind::Stop, _)) if kind == OrderKind::Stop => Ok(()),
            _ => {
                self.running = Some((Order::new(self.me, kind, self.robots), kind, now));
                Ok(())
            }
        }
    }

    /// Starts an order to hold the team (robots stand until it is resumed), unless a stop is in progress. `latch` is
    /// the team's present state of the emergency stop.
    pub fn hold(&mut self, now: Time, latch: Latch) {
        if !matches!(self.running, Some((_, OrderKind::Stop, _))) {
            let order = Order::meaning(self.me, OrderKind::Hold, self.robots, latch);
            self.running = Some((order, OrderKind::Hold, now));
        }
    }

    /// Handles the status of a host, by which it confirms the order in progress for its robots.
    pub fn receive(&mut self, now: Time, status: &Status) {
        let Some((order, kind, began)) = &mut self.running else { return };
        let before = order.confirmed_at();
        order.handle(now, status.clone(), &mut Vec::new());
        if before.is_none() && order.confirmed_at().is_some() {
            let took = now.since(*began).as_secs();
            self.result = Some(format!("{}: confirmed by all {} after {took:.3} s", word(*kind), self.robots));
        }
    }

    /// Returns the message that is to be sent to the team now; `None` if there is none. It must be called at least
    /// every 20 ms while an order is in progress.
    pub fn turn(&mut self, now: Time) -> Option<Stop> {
        let (order, kind, began) = self.running.as_mut()?;
        let lasted = now.since(*began);
        let confirmed = order.confirmed_at().is_some();
        if confirmed && lasted >= AT_LEAST || lasted >= PATIENCE {
            if !confirmed {
                let robots: Vec<String> =
                    order.unconfirmed().iter().take(8).map(|(robot, _)| robot.0.to_string()).collect();
                let missing = match robots.len() {
                    _ if order.is_superseded() => "overtaken by a later stop, re-arm or resume".to_owned(),
                    0 => "no answer from the state server".to_owned(),
                    _ => format!("robots {} have not confirmed", robots.join(", ")),
                };
                self.result = Some(format!("{}: {missing}; try again, or look at the robots", word(*kind)));
            }
            self.running = None;
            return None;
        }
        let mut out = Vec::new();
        if order.wake_at().is_some_and(|at| at <= now) {
            order.wake(now, &mut out);
        }
        out.pop()
    }

    /// Returns whether an order is in progress: it is still being repeated, or waits for confirmations.
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Returns the result of the last order as text, and clears it.
    pub fn take_result(&mut self) -> Option<String> {
        self.result.take()
    }
}

fn word(kind: OrderKind) -> &'static str {
    match kind {
        OrderKind::Stop => "stop",
        OrderKind::Rearm => "re-arm",
        OrderKind::Hold => "hold",
        OrderKind::Resume => "resume",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::messages::ids::RobotId;
    use murmurate::messages::wire::Following;

    #[test]
    fn a_stop_is_sent_until_all_have_confirmed_and_no_re_arm_overtakes_it() {
        let mut orders = Orders::new(HostId::operator(1), 1);
        let at = |ms| Time::ZERO + Span::from_millis(ms);
        assert_eq!(orders.turn(at(0)), None);
        orders.give(at(0), OrderKind::Stop).unwrap();
        assert!(orders.turn(at(0)).is_some_and(|stop| stop.latch.is_engaged()));
        assert_eq!(orders.turn(at(10)), None, "every 20 ms");
        assert!(orders.turn(at(20)).is_some() && orders.give(at(21), OrderKind::Rearm).is_err());
        let latch = Some(Latch::engaged(1));
        let robots = vec![Following { robot: RobotId(0), controller: latch, body: latch }];
        orders.receive(at(30), &Status::of(HostId(0), false, robots, None));
        assert_eq!(orders.take_result().as_deref(), Some("stop: confirmed by all 1 after 0.030 s"));
        assert!(orders.turn(at(499)).is_some() && orders.turn(at(501)).is_none() && !orders.is_running());
        orders.give(at(600), OrderKind::Rearm).unwrap();
        for turn in 0..200 {
            orders.turn(at(600 + 20 * turn));
        }
        assert!(orders.take_result().unwrap().contains("robots 0 have not confirmed"));
    }
}
