//! Attachment: starts the Network of one host and connects it with the transports of its links. The caller handles the
//! Network's other output.

use std::rc::Rc;

use super::inputs::Input;
use super::sockets::{self, Take, Tell};
use crate::actors::network::{self, Identity, Network};
use crate::messages::ids::LinkId;
use crate::messages::wire::Wire;
use crate::net::protocol::codec::Frame;
use crate::net::protocol::key::Key;
use crate::net::protocol::link::{DuplicateId, LinkCounts, Refusal};
use crate::net::protocol::reliability::Setup;
use crate::net::protocol::router::Router;
use crate::net::protocol::sender::Peer;
use crate::net::transport::{self, Transmit, Transport};
use crate::random::Seed;
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::runtime::shell::{Mailbox, start};

/// Configuration of a Network, the actor that connects a host with its links, before it is started.
pub struct Attachment {
    /// Identity of the host on its links. At each start of the Network, the number of starts so far is added to the
    /// incarnation in it.
    pub me: Identity,
    /// Key that authenticates the host's datagrams; `None` for datagrams without authentication.
    pub key: Option<Key>,
    /// Setup of each link, in the order of the deployment; `None` for a link in which the host does not take part.
    pub links: Vec<Option<Setup>>,
    /// Routing table, which says where each kind of message goes.
    pub router: Router,
    /// Seed of the random streams of the Network.
    pub seed: Seed,
    /// Prefix of the name of the Network's random stream; the number of starts of the Network is appended.
    pub stream: String,
    /// Span of the crate `tracing` to which the log lines of the Network belong.
    pub span: tracing::Span,
}

/// Output of a host's Network (the actor that connects the host with its links) to the other actors of its process.
#[derive(Debug)]
pub enum Out {
    /// Message that has to be delivered to actors of this host.
    Deliver(Wire),
    /// Copy of a datagram that this host has published, without its authentication tag, for the Recorder.
    Tap(Frame),
    /// Copy of a datagram that is handed to the transport of this link.
    Sent(LinkId, Frame),
    /// Numbers of datagrams that were sent, received and refused since the start of the Network, on all links of this
    /// host together.
    Counts(Box<LinkCounts>),
    /// Other hosts on links with link reports, with incarnation, delay and loss of each.
    Peers(Vec<Peer>),
    /// Datagram that was refused on this link without any effect but its count.
    Refused(LinkId, Refusal, Frame),
    /// Another running host uses the id of this host and was started earlier.
    Duplicate(DuplicateId),
}

impl Attachment {
    /// Starts the Network with the mailbox `network`. Datagrams to send go to the transport of their link in
    /// `transports`, which has the order of the links. All other output is passed to the function `output`.
    pub(crate) fn start(
        self,
        clock: &Clock,
        network: &Mailbox<network::In>,
        transports: Rc<[Mailbox<transport::In>]>,
        mut output: impl FnMut(Out) + 'static,
    ) {
        let Attachment { me, key, links, router, seed, stream, span } = self;
        let config = network::Config { me, key, links, router };
        let make = move |restarts: u32| {
            let me = Identity { incarnation: me.incarnation.wrapping_add(restarts), ..me };
            Network::new(network::Config { me, ..config.clone() }, seed.stream(&format!("{stream}/{restarts}")))
        };
        let send = move |link: LinkId, input| transports[usize::from(link.0)].send(input);
        start(clock, network, span, make, move |out| match out {
            network::Out::Deliver(message) => output(Out::Deliver(message)),
            network::Out::Tap(frame) => output(Out::Tap(frame)),
            network::Out::Counts(counts) => output(Out::Counts(counts)),
            network::Out::Peers(peers) => output(Out::Peers(peers)),
            network::Out::Duplicate(duplicate) => output(Out::Duplicate(duplicate)),
            network::Out::Refused(link, cause, frame) => output(Out::Refused(link, cause, frame)),
            network::Out::Admit(link, guest) => send(link, transport::In::Admit(guest)),
            network::Out::Transmit(link, audience, frame) => {
                output(Out::Sent(link, Frame::clone(&frame)));
                send(link, transport::In::Transmit(Transmit { from: me.host, audience, frame }));
            }
        });
    }

    /// Starts the Network and the open transports of its links in real time, and returns the Network's mailbox. A link
    /// may have several transports in `open`, one for each network interface. All other output of the
    /// Network, such as received messages, is passed to the function `output`.
    pub fn open(
        self,
        (clock, readers): (&Clock, &mut Readers),
        open: Vec<(LinkId, Box<dyn Transport>)>,
        output: impl FnMut(Out) + 'static,
    ) -> Mailbox<network::In> {
        let network = Mailbox::new("network");
        let transports: Rc<[_]> = (0..self.links.len()).map(|link| Mailbox::new(format!("transport {link}"))).collect();
        let arrived = network.clone();
        let take: Take = Rc::new(move |input| match input {
            Input::Frame(link, frame, from) => arrived.send(network::In::Frame(link, frame, from)),
            Input::Dropped(link, count) => arrived.send(network::In::Dropped(link, count)),
            Input::Refused(..) | Input::Packet(..) | Input::Ended(_) | Input::Leave | Input::Stop => {}
        });
        // An operator's log says it.
        let tell: Tell = Rc::new(|_, _| {});
        sockets::wire_all((clock, readers), open, &transports, (&take, &tell));
        self.start(clock, &network, transports, output);
        network
    }
}
