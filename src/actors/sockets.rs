//! A process's sockets as actors: one transport a link, between the Network and the driver of real time. What travels
//! on them never lives here.

use std::cell::RefCell;
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
use crate::time::Time;

/// Starts the transport of a link behind its mailbox; what arrives goes to the Network.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    (link, udp): (LinkId, Udp),
    mailbox: &Mailbox<transport::In>,
    network: &Mailbox<network::In>,
) {
    let (bell, network) = (mailbox.clone(), network.clone());
    readers.watch(udp.ears(), move || bell.send(transport::In::Readable));
    // A socket outlives its actor: what waits in it would be lost with it.
    let udp = Rc::new(RefCell::new(udp));
    let make = move |_| Shared(Rc::clone(&udp));
    start(clock, mailbox, info_span!("udp", link = link.0), make, move |Arrive { frame, .. }| {
        network.send(network::In::Frame(link, frame));
    });
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

    fn wake(&mut self, now: Time, out: &mut Vec<C::Out>) {
        self.0.borrow_mut().wake(now, out);
    }
}
