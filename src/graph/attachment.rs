//! Attachment: the Network of one host on its links. The one place that starts a Network and connects it with its
//! transports. The owner handles the Network's other output.

use std::rc::Rc;

use super::sockets;
use crate::actors::network::{self, Identity, Network};
use crate::messages::ids::LinkId;
use crate::messages::wire::Wire;
use crate::net::protocol::codec::Frame;
use crate::net::protocol::key::Key;
use crate::net::protocol::link::{DuplicateId, LinkCounts};
use crate::net::protocol::reliability::Setup;
use crate::net::protocol::router::Router;
use crate::net::protocol::sender::Peer;
use crate::net::transport::{self, Transmit, Transport};
use crate::random::Seed;
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::runtime::shell::{Mailbox, start};

/// Configuration of the Network of a host.
pub struct Attachment {
    /// Its identity in the first incarnation; each restart is an incarnation of its own.
    pub me: Identity,
    /// Key that authenticates its datagrams, if any.
    pub key: Option<Key>,
    /// Setup of its links, in the order of the deployment; none where it does not take part.
    pub links: Vec<Option<Setup>>,
    /// Routing table.
    pub router: Router,
    /// Root of its link layer's random streams.
    pub seed: Seed,
    /// Prefix of its random stream's name; the number of restarts follows.
    pub stream: String,
    /// Span of `tracing` in which the log lines of this Network are written.
    pub span: tracing::Span,
}

/// Output of a Network for the process that it runs in.
#[derive(Debug)]
pub enum Out {
    /// Message for this host.
    Deliver(Wire),
    /// Copy of a published message, one per datagram, without a tag.
    Tap(Frame),
    /// Counts of all links together.
    Counts(Box<LinkCounts>),
    /// Summaries of the other hosts, on links with reports.
    Peers(Vec<Peer>),
    /// Another live host has the id of this one and was started before it.
    Duplicate(DuplicateId),
}

impl Attachment {
    /// Starts the Network behind its mailbox. Frames go to the transport of their link in `transports`, which are in
    /// the order of the links; `output` takes all other output.
    pub fn start(
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
            network::Out::Admit(link, guest) => send(link, transport::In::Admit(guest)),
            network::Out::Transmit(link, audience, frame) => {
                send(link, transport::In::Transmit(Transmit { from: me.host, audience, frame }));
            }
        });
    }

    /// Starts the Network and its open transports, in real time; returns the Network's mailbox. A link may have several
    /// transports, one per interface.
    pub fn open(
        self,
        (clock, readers): (&Clock, &mut Readers),
        open: Vec<(LinkId, Box<dyn Transport>)>,
        output: impl FnMut(Out) + 'static,
    ) -> Mailbox<network::In> {
        let network = Mailbox::new("network");
        let transports: Rc<[_]> = (0..self.links.len()).map(|link| Mailbox::new(format!("transport {link}"))).collect();
        sockets::wire_all((clock, readers), open, &transports, &network);
        self.start(clock, &network, transports, output);
        network
    }
}
