//! End of a host on its links: its identity, key, setups and open transports, from which its Network is started.

use std::cell::RefCell;
use std::rc::Rc;

use tracing::info_span;

use super::event::Event;
use super::inputs::Input;
use super::sockets::{self, Take, Tell};
use crate::actors::network::{self, Identity, Network};
use crate::messages::ids::LinkId;
use crate::messages::wire::Wire;
use crate::net::protocol::key::Key;
use crate::net::protocol::parts::Settings;
use crate::net::protocol::reliability::Setup;
use crate::net::protocol::router::Router;
use crate::net::transport::{self, Transmit, Transport};
use crate::random::Seed;
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::runtime::shell::{Mailbox, start};

/// Function that writes a roster to disk.
pub type Keep = Rc<dyn Fn(&[u8])>;

/// End of a host on the links of its team. The host is one of the deployment, or an operator, which is outside of it.
pub struct HostEnd {
    /// Identity of the host on its links. At each start of the Network, the number of starts so far is added to the
    /// incarnation in it.
    pub me: Identity,
    /// Key that authenticates the host's datagrams; `None` for datagrams without authentication.
    pub key: Option<Key>,
    /// Seed of the random streams of the Network. That of a real host is drawn from the operating system.
    pub seed: Seed,
    /// Setup of each link, in the order of the deployment; `None` for a link in which the host does not take part.
    pub links: Vec<Option<Setup>>,
    /// Function that writes a roster to disk at once, for operators. It is in force even if it cannot be written: no
    /// order waits for a disk. Rosters of a host are written beside its control thread ([`Event::Roster`]), and none
    /// is in force before.
    pub keep: Option<Keep>,
    /// Open transports, each with its link; a link that is used on several network interfaces has several. Empty where
    /// links are emulated.
    pub transports: Vec<(LinkId, Box<dyn Transport>)>,
}

impl HostEnd {
    /// Starts the Network of this host with the mailbox `network`, and with its routing table, its settings for
    /// messages in parts, and the span of its log lines. Messages for actors of the host are passed to `deliver`,
    /// inputs for transports to `transmit`, and all events to `report`, a message before it is delivered.
    pub(crate) fn start(
        &self,
        clock: &Clock,
        network: &Mailbox<network::In>,
        (router, parts, span): (Router, Option<Settings>, tracing::Span),
        (mut deliver, mut transmit): (impl FnMut(Wire) + 'static, impl FnMut(LinkId, transport::In) + 'static),
        report: impl Fn(Event) + 'static,
    ) {
        let HostEnd { me, seed, .. } = *self;
        let config = network::Config { me, key: None, links: self.links.clone(), router, parts };
        // A Network that is started again goes on with the keys of the last roster.
        let (key, present) = (Rc::new(RefCell::new(self.key.clone())), network.clone());
        let (changed, keeps) = (Rc::clone(&key), self.keep.clone());
        let host = me.host;
        let stream = if host.is_operator() { "operator".to_owned() } else { format!("network/{}", host.0) };
        let make = move |restarts: u32| {
            let me = Identity { incarnation: me.incarnation.wrapping_add(restarts), ..me };
            let key = key.borrow().clone();
            Network::new(network::Config { me, key, ..config.clone() }, seed.stream(&format!("{stream}/{restarts}")))
        };
        start(clock, network, span, make, move |out| match out {
            network::Out::Deliver(message) => {
                report(Event::Message(&message));
                deliver(message);
            }
            network::Out::Tap(frame) => report(Event::Published(&frame)),
            network::Out::Counts(counts) => report(Event::Counts(&counts)),
            network::Out::Peers(peers, ways) => report(Event::Peers(&peers, &ways)),
            network::Out::Duplicate(duplicate) => report(Event::Duplicate(duplicate)),
            network::Out::Refused(link, cause, frame) => report(Event::Refused(link, cause, &frame)),
            network::Out::Keep(number, sealed) => {
                report(Event::Roster(number, &sealed));
                if let Some(keep) = &keeps {
                    keep(&sealed);
                    present.send(network::In::Kept(number));
                }
            }
            network::Out::Keys(key) => drop(changed.replace(Some(*key))),
            network::Out::Roster(roster) => report(Event::Members(&roster)),
            network::Out::Admit(link, guest) => transmit(link, transport::In::Admit(guest)),
            network::Out::Transmit(link, audience, frame) => {
                report(Event::Sent(link, &frame));
                transmit(link, transport::In::Transmit(Transmit { from: host, audience, frame }));
            }
        });
    }

    /// Starts the Network and the open transports of this host in real time, without other actors, and returns the
    /// Network's mailbox. `report` is called with each event, such as a message that `router` makes local.
    pub fn open(
        mut self,
        (clock, readers): (&Clock, &mut Readers),
        router: Router,
        report: impl Fn(Event) + 'static,
    ) -> Mailbox<network::In> {
        let network = Mailbox::new("network");
        let transports: Rc<[_]> = (0..self.links.len()).map(|link| Mailbox::new(format!("transport {link}"))).collect();
        let arrived = network.clone();
        let take: Take = Rc::new(move |input| match input {
            Input::Frame(link, frame, from) => arrived.send(network::In::Frame(link, frame, from)),
            Input::Dropped(link, count) => arrived.send(network::In::Dropped(link, count)),
            Input::Refused(..) | Input::Packet(..) | Input::Ended(_) | Input::Leave | Input::Stop | Input::Kept(_) => {}
        });
        // The transport logs the change; nobody else needs it here.
        let tell: Tell = Rc::new(|_, _| {});
        let open = std::mem::take(&mut self.transports);
        sockets::wire_all((clock, readers), open, &transports, (&take, &tell));
        let transmit = to(transports);
        self.start(clock, &network, (router, None, info_span!("network")), (|_| {}, transmit), report);
        network
    }
}

/// Returns a function that passes an input to the transport of its link. `transports` are in the order of the links.
pub(super) fn to(transports: Rc<[Mailbox<transport::In>]>) -> impl Fn(LinkId, transport::In) {
    move |link, input| transports[usize::from(link.0)].send(input)
}
