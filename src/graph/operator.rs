//! An operator: a host that is in no deployment. It has a Network on one or more links of a team and no robot. It may
//! give orders (`order`) or only listen. Every process that acts as one has a number of its own, so that any number of
//! operators act at once; what a person is shown never lives here.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

use tracing::info_span;

use super::process::Heard;
use super::sockets::Shared;
use super::station::{self, Station};
use crate::actors::network::{self, Identity};
use crate::actors::order::Order;
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::{Kind, Observe, Status, Wire};
use crate::net::protocol::key::Key;
use crate::net::protocol::reliability::Setup;
use crate::net::protocol::router::{Audience, Publishers, Route, Router};
use crate::net::transport::Transport;
use crate::random::Seed;
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::runtime::shell::{Mailbox, start};
use crate::time::Span;

/// An operator and its links.
pub struct Operator {
    /// Its identity: a number drawn for this process, the team's number, a random incarnation.
    pub me: Identity,
    /// The root of its randomness, from the operating system.
    pub seed: Seed,
    /// How many robots the team has.
    pub robots: usize,
    /// The hosts of the team, and what each may say.
    pub publishers: Arc<Publishers>,
    /// The team's key.
    pub key: Option<Key>,
    /// How the links are set up, in the order of the deployment; none where it has no part in one.
    pub links: Vec<Option<Setup>>,
    /// What is open of its links; several for one link where it is joined on several interfaces.
    pub transports: Vec<(LinkId, Box<dyn Transport>)>,
    /// The link that carries the emergency stop, if it is to speak on it.
    pub stop: Option<LinkId>,
}

/// Starts an operator's Network and links; the way to its Network.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    operator: Operator,
    heard: impl Fn(Heard) + 'static,
) -> Mailbox<network::In> {
    let Operator { me, seed, robots, publishers, key, links, transports, stop } = operator;
    let router = Router::new(robots, |kind, _| match kind {
        Kind::Stop | Kind::Observe => Route { local: false, leaves: stop.map(|link| (link, Audience::All)) },
        Kind::Heartbeat | Kind::Mode | Kind::Status | Kind::Telemetry => Route { local: true, leaves: None },
        _ => Route::default(),
    });
    let router = router.with_publishers(publishers);
    let (stream, span) = ("operator".to_owned(), info_span!("network"));
    let station = Station { me, key, links, router, seed, stream, span };
    station.open((clock, readers), transports, move |out| match out {
        station::Out::Deliver(message) => heard(Heard::Message(&message)),
        station::Out::Counts(counts) => heard(Heard::Counts(&counts)),
        station::Out::Peers(peers) => heard(Heard::Peers(&peers)),
        station::Out::Duplicate(duplicate) => heard(Heard::Duplicate(duplicate)),
        station::Out::Tap(_) => heard(Heard::Published),
    })
}

/// How often an observer says that it is there.
const OBSERVE_PERIOD: Span = Span::from_millis(1000);

/// Makes an operator an observer, whose Network this is: as long as the process runs, hosts tell it of their robots.
pub fn observe(clock: &Clock, network: &Mailbox<network::In>, by: HostId) {
    network.send(network::In::Publish(Wire::Observe(Observe { by })));
    let (again, network) = (clock.clone(), network.clone());
    clock.call(clock.now() + OBSERVE_PERIOD, Box::new(move || observe(&again, &network, by)));
}

/// Starts an operator that gives an order, which can be looked at while it is carried out.
pub fn command((clock, readers): (&Clock, &mut Readers), operator: Operator, order: &Rc<RefCell<Order>>) {
    let answers: Mailbox<Status> = Mailbox::new("order");
    let hear = answers.clone();
    let network = wire((clock, readers), operator, move |heard| {
        if let Heard::Message(Wire::Status(status)) = heard {
            hear.send(status.clone());
        }
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
