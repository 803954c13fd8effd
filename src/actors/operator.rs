//! An operator: a host that is in no deployment. It hears a team's heartbeats and modes, and may stop it. It has a
//! Network and its links, and no robot; what it shows a person never lives here.

use tracing::info_span;

use super::clock::Clock;
use super::network::{self, Identity, Network};
use super::process::Heard;
use super::real::Readers;
use super::shell::{Mailbox, start};
use super::sockets;
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::Kind;
use crate::net::key::Key;
use crate::net::reliability::Setup;
use crate::net::router::{Audience, Route, Router};
use crate::net::transport::udp::Udp;
use crate::net::transport::{self, Transmit};
use crate::random::Seed;

/// The number of an operator: no deployment has so many hosts.
pub const OPERATOR: HostId = HostId(u16::MAX - 1);

/// An operator and its links.
pub struct Operator {
    /// Its number, from `OPERATOR` downward.
    pub id: HostId,
    /// The team's number.
    pub team: u16,
    /// How many robots the team has.
    pub robots: usize,
    /// Which of its lives this is.
    pub incarnation: u32,
    /// The team's key.
    pub key: Option<Key>,
    /// How the links are set up, in the order of the deployment.
    pub links: Vec<Setup>,
    /// The sockets by link.
    pub sockets: Vec<(LinkId, Udp)>,
    /// The link that carries the emergency stop, if any does.
    pub stop: Option<LinkId>,
}

/// Starts an operator's Network and links; the way to its Network.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    operator: Operator,
    heard: impl Fn(Heard) + 'static,
) -> Mailbox<network::In> {
    let Operator { id, team, robots, incarnation, key, links, sockets: open, stop } = operator;
    let router = Router::new(robots, |kind, _| match kind {
        Kind::Stop => Route { local: true, leaves: stop.map(|link| (link, Audience::All)) },
        Kind::Heartbeat | Kind::Mode => Route { local: true, leaves: None },
        _ => Route::default(),
    });
    let transports: Vec<Mailbox<transport::In>> = links.iter().map(|_| Mailbox::new("udp of the operator")).collect();
    let config = network::Config { me: Identity { host: id, team, epoch: incarnation }, key, links, router };
    let make = move |life: u32| {
        let me = Identity { epoch: incarnation + life, ..config.me };
        let stream = Seed::of_run(u64::from(incarnation)).stream(&format!("operator/{}/{life}", id.0));
        Network::new(network::Config { me, ..config.clone() }, stream)
    };
    let network = Mailbox::new("network of the operator");
    let outward = transports.clone();
    start(clock, &network, info_span!("network"), make, move |out| match out {
        network::Out::Deliver(message) => heard(Heard::Message(&message)),
        network::Out::Counts(counts) => heard(Heard::Counts(&counts)),
        network::Out::Peers(peers) => heard(Heard::Peers(&peers)),
        network::Out::Tap(_) => heard(Heard::Published),
        network::Out::Transmit(link, audience, frame) => {
            let transmit = Transmit { from: id, audience, frame };
            outward[usize::from(link.0)].send(transport::In::Transmit(transmit));
        }
    });
    let mailbox_of = |link: LinkId| transports[usize::from(link.0)].clone();
    sockets::wire_all((clock, readers), open, mailbox_of, &network);
    network
}
