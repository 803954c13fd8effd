//! A process's sockets as actors: one transport a link, between the Network and the driver of real time. What travels
//! on them never lives here.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use tracing::info_span;

use super::Core;
use super::clock::Clock;
use super::network;
use super::real::Readers;
use super::shell::{Mailbox, start};
use crate::messages::ids::LinkId;
use crate::net::transport::udp::Udp;
use crate::net::transport::{self, Arrive};
use crate::time::{Span, Time};

/// Starts the transports of a host behind the mailboxes of their links; what arrives goes to the Network. A link may
/// have several, one an interface: what is said on it leaves through each.
pub fn wire_all(
    (clock, readers): (&Clock, &mut Readers),
    sockets: Vec<(LinkId, Udp)>,
    mailbox_of: impl Fn(LinkId) -> Mailbox<transport::In>,
    network: &Mailbox<network::In>,
) {
    let mut links: BTreeMap<LinkId, Vec<Udp>> = BTreeMap::new();
    for (link, udp) in sockets {
        links.entry(link).or_default().push(udp);
    }
    for (link, mut transports) in links {
        let mailbox = mailbox_of(link);
        if transports.len() == 1
            && let Some(udp) = transports.pop()
        {
            wire((clock, readers), (link, udp), &mailbox, network);
            continue;
        }
        let all: Vec<Mailbox<transport::In>> = (0..transports.len())
            .map(|index| Mailbox::new(format!("{} by interface {index}", mailbox.name())))
            .collect();
        for (udp, mailbox) in transports.into_iter().zip(&all) {
            wire((clock, readers), (link, udp), mailbox, network);
        }
        start(
            clock,
            &mailbox,
            info_span!("interfaces", link = link.0),
            |_| Fan,
            move |said: transport::In| {
                all.iter().for_each(|transport| transport.send(said.clone()));
            },
        );
    }
}

/// Starts the one transport of a link behind its mailbox; what arrives goes to the Network.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    (link, udp): (LinkId, Udp),
    mailbox: &Mailbox<transport::In>,
    network: &Mailbox<network::In>,
) {
    let (bell, network, ears) = (mailbox.clone(), network.clone(), udp.ears());
    // A socket outlives its actor: what waits in it would be lost with it.
    let udp = Rc::new(RefCell::new(udp));
    let flooded = Rc::clone(&udp);
    readers.watch_link(ears, move || flooded.borrow().rests_until(), move || bell.send(transport::In::Readable));
    let make = move |_| Shared(Rc::clone(&udp));
    start(clock, mailbox, info_span!("udp", link = link.0), make, move |Arrive { frame, from, .. }| {
        network.send(network::In::Frame(link, frame, from));
    });
}

/// Passes on what it is told, to each of a link's transports.
struct Fan;

impl Core for Fan {
    type In = transport::In;
    type Out = transport::In;

    fn handle(&mut self, _: Time, input: transport::In, out: &mut Vec<transport::In>) {
        out.push(input);
    }

    fn wake_at(&self) -> Option<Time> {
        None
    }

    fn wake(&mut self, _: Time, _: &mut Vec<transport::In>) {}
}

/// A core whose state outlives it, and which others may look at.
pub struct Shared<C>(pub Rc<RefCell<C>>);

impl<C: Core> Core for Shared<C> {
    type In = C::In;
    type Out = C::Out;

    fn handle(&mut self, now: Time, input: C::In, out: &mut Vec<C::Out>) {
        self.0.borrow_mut().handle(now, input, out);
    }

    fn wake_at(&self) -> Option<Time> {
        self.0.borrow().wake_at()
    }

    fn tolerance(&self, ahead: Span) -> Span {
        self.0.borrow().tolerance(ahead)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<C::Out>) {
        self.0.borrow_mut().wake(now, out);
    }
}
