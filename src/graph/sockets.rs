//! Runs the open transports (sockets) of a process as actors: they send the datagrams of the host's Network, and the
//! real-time event loop passes received datagrams on. Does not interpret the messages in the datagrams.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::rc::Rc;

use tracing::info_span;

use crate::actor::Core;
use crate::graph::inputs::Input;
use crate::messages::ids::LinkId;
use crate::net::transport::{self, Renewed, Transport};
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::runtime::shell::{Mailbox, start};
use crate::time::{Span, Time};

/// Function that is called with each input from outside the actor graph, such as a received datagram ([`Input`]).
pub(crate) type Take = Rc<dyn Fn(Input)>;

/// Function that is called when the sockets of a link were closed or opened again. This is no input of the actors.
pub(crate) type Tell = Rc<dyn Fn(LinkId, &Renewed)>;

/// Starts an actor for each link that sends the datagrams in its mailbox through the link's open transports, one for
/// each network interface. `mailboxes` are in the order of the deployment's links. Received datagrams are passed to
/// `take`; `tell` is called when a link was closed or opened again.
pub(crate) fn wire_all(
    (clock, readers): (&Clock, &mut Readers),
    open: Vec<(LinkId, Box<dyn Transport>)>,
    mailboxes: &[Mailbox<transport::In>],
    (take, tell): (&Take, &Tell),
) {
    let mut links: BTreeMap<LinkId, Vec<Box<dyn Transport>>> = BTreeMap::new();
    for (link, transport) in open {
        links.entry(link).or_default().push(transport);
    }
    for (link, mut transports) in links {
        let mailbox = &mailboxes[usize::from(link.0)];
        if transports.len() == 1
            && let Some(transport) = transports.pop()
        {
            wire((clock, readers), (link, transport), mailbox, (take, tell));
            continue;
        }
        let all: Vec<Mailbox<transport::In>> = (0..transports.len())
            .map(|index| Mailbox::new(format!("{} by interface {index}", mailbox.name())))
            .collect();
        for (transport, mailbox) in transports.into_iter().zip(&all) {
            wire((clock, readers), (link, transport), mailbox, (take, tell));
        }
        start(
            clock,
            mailbox,
            info_span!("interfaces", link = link.0),
            |_| Fan,
            move |input: transport::In| {
                all.iter().for_each(|transport| transport.send(input.clone()));
            },
        );
    }
}

/// Starts an actor that sends the datagrams in `mailbox` through the open transport `transport` of `link`. Received
/// datagrams are passed to `take`, and changes of the sockets to `tell`.
fn wire(
    (clock, readers): (&Clock, &mut Readers),
    (link, transport): (LinkId, Box<dyn Transport>),
    mailbox: &Mailbox<transport::In>,
    (take, tell): (&Take, &Tell),
) {
    let (time, take, descriptor) = (clock.clone(), Rc::clone(take), transport.descriptor());
    let changes = transport.changes();
    let span = info_span!("transport", link = link.0);
    // The transport outlives its actor, so that a crash does not lose frames in a socket.
    let transport = Rc::new(RefCell::new(transport));
    let (flooded, receiver, inside) = (Rc::clone(&transport), Rc::clone(&transport), span.clone());
    let reported = Cell::new(0);
    // Frames are read in the notification: an additional turn of the actor would add a tenth to the cost of a delivery.
    let ring = move || {
        let _inside = inside.enter();
        let mut receiver = receiver.borrow_mut();
        receiver.receive(time.now(), &mut |from, frame| take(Input::Frame(link, frame.into(), from)));
        let dropped = receiver.counts().dropped;
        if dropped > reported.get() {
            take(Input::Dropped(link, dropped - reported.replace(dropped)));
        }
    };
    let watched = readers.watch_link(descriptor, move || flooded.borrow().paused_until(), ring);
    if let Some(changes) = changes {
        let (renewed, tell, inside) = (Rc::clone(&transport), Rc::clone(tell), span.clone());
        readers.watch(changes, move || {
            let _inside = inside.enter();
            let mut all = Vec::new();
            renewed.borrow_mut().renew(&mut |one| all.push(one));
            for one in all {
                match &one {
                    Renewed::Closed(why) => tracing::warn!("the link is closed until it is fit again: {why}"),
                    Renewed::Open(at) => tracing::warn!("the link is open again: {at}"),
                }
                let open = matches!(one, Renewed::Open(_));
                watched.replace(open.then(|| renewed.borrow().descriptor()));
                tell(link, &one);
            }
        });
    }
    start(clock, mailbox, span, move |_| Transmitter(Rc::clone(&transport)), |never| match never {});
}

/// Actor that sends each datagram that it gets through one open transport.
struct Transmitter(Rc<RefCell<Box<dyn Transport>>>);

impl Core for Transmitter {
    type In = transport::In;
    type Out = Infallible;

    fn handle(&mut self, now: Time, input: transport::In, _: &mut Vec<Infallible>) {
        self.0.borrow_mut().handle(now, input);
    }

    fn wake_at(&self) -> Option<Time> {
        None
    }

    fn wake(&mut self, _: Time, _: &mut Vec<Infallible>) {}
}

/// Actor that puts out each input once; its caller sends that output to every transport of a link.
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

/// Actor's state machine ([`Core`]) that its owner can read while the actor runs and after it has ended.
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

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
    use std::time::Instant;

    use super::*;
    use crate::actors::network;
    use crate::config::fields::Value;
    use crate::messages::ids::HostId;
    use crate::net::protocol::router::Audience;
    use crate::net::transport::settings::FieldValue;
    use crate::net::transport::{Filter, LinkSettings, Transmit, udp};
    use crate::runtime::real::run_real;

    /// Test core that counts the frames that arrive.
    struct Count(Rc<Cell<usize>>);

    impl Core for Count {
        type In = network::In;
        type Out = ();

        fn handle(&mut self, _: Time, input: network::In, _: &mut Vec<()>) {
            if let network::In::Frame(LinkId(3), _, Some(_)) = input {
                self.0.set(self.0.get() + 1);
            }
        }

        fn wake_at(&self) -> Option<Time> {
            None
        }

        fn wake(&mut self, _: Time, _: &mut Vec<()>) {}
    }

    #[test]
    fn a_link_of_two_transports_leaves_by_both_and_hears_both() {
        let at = |port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let peer = UdpSocket::bind(at(47_751)).unwrap();
        peer.set_nonblocking(true).unwrap();
        let open = |port: u16| {
            let said = |value| FieldValue { value, place: String::new() };
            let values = [
                ("interface".to_owned(), said(Value::Text("lo".to_owned()))),
                ("receive_buffer_bytes".to_owned(), said(Value::Whole(1 << 16))),
                ("peers.here".to_owned(), said(Value::Address(at(port)))),
                ("peers.there".to_owned(), said(Value::Address(at(47_751)))),
            ];
            let settings = LinkSettings {
                link: "test",
                team: None,
                host: HostId(0),
                hosts: vec!["here", "there"],
                values: values.into(),
            };
            let endpoint = (udp::unicast::ENTRY.read)(&settings).unwrap();
            (LinkId(3), endpoint.open(HostId(0), Filter::All).unwrap())
        };
        let sockets = vec![open(47_752), open(47_753)];
        for port in [47_752, 47_753] {
            peer.send_to(b"to the team", at(port)).unwrap();
        }
        let links: Vec<Mailbox<transport::In>> = (0..4).map(|link| Mailbox::new(format!("link {link}"))).collect();
        let network = Mailbox::new("network");
        let arrived = Rc::new(Cell::new(0));
        let frame: crate::net::protocol::codec::Frame = b"to the peer"[..].into();
        links[3].send(transport::In::Transmit(Transmit { from: HostId(0), audience: Audience::All, frame }));
        let (count, begun) = (Rc::clone(&arrived), Instant::now());
        run_real(
            begun,
            |clock, readers| {
                let arrived = network.clone();
                let take: Take = Rc::new(move |input| {
                    if let Input::Frame(link, frame, from) = input {
                        arrived.send(network::In::Frame(link, frame, from));
                    }
                });
                wire_all((clock, readers), sockets, &links, (&take, &(Rc::new(|_, _: &Renewed| {}) as Tell)));
                start(clock, &network, info_span!("network"), move |_| Count(Rc::clone(&count)), |()| {});
            },
            |(), now| arrived.get() == 2 || now.as_secs() > 5.0,
        );
        assert_eq!(arrived.get(), 2);
        let from = || peer.recv_from(&mut [0; 64]).map(|(_, from)| from.port());
        assert_eq!([from().unwrap(), from().unwrap()], [47_752, 47_753], "in the order of its transports");
    }
}
