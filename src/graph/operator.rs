//! Operator: a host outside the deployment, with a Network on one or more links of a team and without robots. It may
//! give orders (`order`) or only receive. Every operator process has an id of its own, so several can act at once.
//! Contains no output for people.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;

use tracing::info_span;

use super::end::HostEnd;
use super::event::Event;
use super::sockets::Shared;
use crate::actors::network;
use crate::actors::order::Order;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{Cut, Flight, Observe, Place, Placed, Status, Wire};
use crate::net::protocol::router::{Audience, Publishers, Route, Router};
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::runtime::shell::{Mailbox, start};
use crate::time::Span;

/// Operator: a process outside the deployment that gives orders to a team or observes it.
pub struct Operator {
    /// End of the operator on the team's links.
    pub end: HostEnd,
    /// Number of robots in the team.
    pub robots: usize,
    /// Kinds of messages that each host of the team may publish; the operator refuses all others.
    pub publishers: Arc<Publishers>,
    /// Link that carries the emergency stop, if the operator gives orders on it; `None` for one that only receives.
    pub stop: Option<LinkId>,
}

/// Starts the Network and the links of an operator in real time, and returns the Network's mailbox. `report` is called
/// with received messages and other events.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    operator: Operator,
    report: impl Fn(Event) + 'static,
) -> Mailbox<network::In> {
    let Operator { end, robots, publishers, stop } = operator;
    // Besides what it is for, a link may carry latents and readings, which the live page shows.
    let router = Router::new(robots, |kind, _| Route {
        local: kind.interests_operators(),
        leaves: stop.filter(|_| kind.is_of_operators()).map(|link| (link, Audience::All)),
    });
    end.open((clock, readers), router.with_publishers(publishers), report)
}

/// Period at which an observer asks all hosts for telemetry (an `Observe` message).
const OBSERVE_PERIOD: Span = Span::from_millis(1000);

/// Makes the operator `by` an observer: from now on it asks all hosts for telemetry once a second, through `network`.
pub fn observe(clock: &Clock, network: &Mailbox<network::In>, by: HostId) {
    repeat(clock, network, OBSERVE_PERIOD, [Wire::Observe(Observe { by })].into());
}

/// Publishes messages now and in every period from now on, until the process ends.
fn repeat(clock: &Clock, network: &Mailbox<network::In>, period: Span, messages: Rc<[Wire]>) {
    messages.iter().for_each(|message| network.send(network::In::Publish(message.clone())));
    let (again, network) = (clock.clone(), network.clone());
    clock.call(clock.now() + period, Box::new(move || repeat(&again, &network, period, messages)));
}

/// Period at which an operator repeats where a robot stands until the robot's host has answered.
const PLACE_PERIOD: Span = Span::from_millis(50);

/// Starts an operator that says where a robot stands, and puts the answer of the robot's host into `answer`. The
/// statement is repeated until the process ends.
pub fn place(
    (clock, readers): (&Clock, &mut Readers),
    operator: Operator,
    place: Place,
    answer: &Rc<Cell<Option<Placed>>>,
) {
    let heard = Rc::clone(answer);
    let network = wire((clock, readers), operator, move |event| {
        let Event::Message(Wire::Located(located)) = event else { return };
        let own = located.answer.filter(|answer| (answer.by, answer.number) == (place.by, place.number));
        heard.set(own.or(heard.get()));
    });
    repeat(clock, &network, PLACE_PERIOD, [Wire::Place(place)].into());
}

/// Period at which an operator repeats its order to switch motors off.
const CUT_PERIOD: Span = Span::from_millis(50);

/// Starts an operator that orders the motors of `robots` off until the process ends, and puts into `flights` what these
/// robots say of their flights.
pub fn cut(
    (clock, readers): (&Clock, &mut Readers),
    operator: Operator,
    robots: Vec<RobotId>,
    flights: Rc<RefCell<BTreeMap<RobotId, Option<Flight>>>>,
) {
    let by = operator.end.me.host;
    let network = wire((clock, readers), operator, move |event| {
        let Event::Message(Wire::Aloft(aloft)) = event else { return };
        if let Some(known) = flights.borrow_mut().get_mut(&aloft.robot) {
            *known = Some(aloft.flight);
        }
    });
    let orders = robots.into_iter().map(|robot| Wire::Cut(Cut { by, robot }));
    repeat(clock, &network, CUT_PERIOD, orders.collect());
}

/// Starts an operator that carries out the order `order`, such as an emergency stop. The caller can read the progress
/// from `order` meanwhile.
pub fn command((clock, readers): (&Clock, &mut Readers), operator: Operator, order: &Rc<RefCell<Order>>) {
    let answers: Mailbox<Status> = Mailbox::new("order");
    let (to_order, counted) = (answers.clone(), Rc::clone(order));
    let network = wire((clock, readers), operator, move |event| match event {
        Event::Message(Wire::Status(status)) => to_order.send(status.clone()),
        Event::Counts(counts) => counted.borrow_mut().note_links(*counts),
        _ => {}
    });
    let order = Rc::clone(order);
    start(
        clock,
        &answers,
        info_span!("order"),
        move |_| Shared(Rc::clone(&order)),
        move |stop| {
            network.send(network::In::Publish(Wire::Stop(stop)));
        },
    );
}
