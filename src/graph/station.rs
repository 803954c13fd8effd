//! A station: the Network of one host on its links. The one place that starts a Network and joins it with the
//! transports that it speaks through; what it says to the rest of the process is its owner's.

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

/// How the Network of a host is set up.
pub struct Station {
    /// Its identity in its first life; each further life is an incarnation of its own.
    pub me: Identity,
    /// What its datagrams are sealed with, if they are.
    pub key: Option<Key>,
    /// How its links are set up, in the order of the deployment; none where it has no part in one.
    pub links: Vec<Option<Setup>>,
    /// The way of every message.
    pub router: Router,
    /// The root of what its link layer draws.
    pub seed: Seed,
    /// The name of its random stream; the number of its life follows.
    pub stream: String,
    /// What its log lines are marked with.
    pub span: tracing::Span,
}

/// What a Network says to the process that it is in.
#[derive(Debug)]
pub enum Out {
    /// A message for this host.
    Deliver(Wire),
    /// Something was published here: one message as a datagram, without a tag.
    Tap(Frame),
    /// What has happened on all links together.
    Counts(Box<LinkCounts>),
    /// What is known of the other hosts, on links with reports.
    Peers(Vec<Peer>),
    /// Another live host has the id of this one and was started before it.
    Duplicate(DuplicateId),
}

impl Station {
    /// Starts the Network behind its mailbox. What leaves goes to the transport of its link, one of `transports`, which
    /// are in the order of the links; `said` takes all else.
    pub fn start(
        self,
        clock: &Clock,
        network: &Mailbox<network::In>,
        transports: Rc<[Mailbox<transport::In>]>,
        mut said: impl FnMut(Out) + 'static,
    ) {
        let Station { me, key, links, router, seed, stream, span } = self;
        let config = network::Config { me, key, links, router };
        let make = move |life: u32| {
            let me = Identity { incarnation: me.incarnation.wrapping_add(life), ..me };
            Network::new(network::Config { me, ..config.clone() }, seed.stream(&format!("{stream}/{life}")))
        };
        let tell = move |link: LinkId, told| transports[usize::from(link.0)].send(told);
        start(clock, network, span, make, move |out| match out {
            network::Out::Deliver(message) => said(Out::Deliver(message)),
            network::Out::Tap(frame) => said(Out::Tap(frame)),
            network::Out::Counts(counts) => said(Out::Counts(counts)),
            network::Out::Peers(peers) => said(Out::Peers(peers)),
            network::Out::Duplicate(duplicate) => said(Out::Duplicate(duplicate)),
            network::Out::Admit(link, guest) => tell(link, transport::In::Admit(guest)),
            network::Out::Transmit(link, audience, frame) => {
                tell(link, transport::In::Transmit(Transmit { from: me.host, audience, frame }));
            }
        });
    }

    /// Starts the Network and the transports that are open for it, in real time; the way to the Network. A link may
    /// have several, one an interface.
    pub fn open(
        self,
        (clock, readers): (&Clock, &mut Readers),
        open: Vec<(LinkId, Box<dyn Transport>)>,
        said: impl FnMut(Out) + 'static,
    ) -> Mailbox<network::In> {
        let network = Mailbox::new("network");
        let transports: Rc<[_]> = (0..self.links.len()).map(|link| Mailbox::new(format!("transport {link}"))).collect();
        sockets::wire_all((clock, readers), open, &transports, &network);
        self.start(clock, &network, transports, said);
        network
    }
}
