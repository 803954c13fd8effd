//! Participant of a measurement of the network study. It uses the Network actor, link and transport of `murmurate
//! host`, with a station that sends and counts messages instead of a robot.

use std::cell::RefCell;
use std::net::{SocketAddr, TcpStream};
use std::rc::Rc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use murmurate::actors::network;
use murmurate::deploy::team::Team;
use murmurate::graph::end::HostEnd;
use murmurate::graph::event::Event;
use murmurate::graph::sockets::Shared;
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::wire::{Kind, Latent, Wire};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::net::transport::{Place, Transport};
use murmurate::runtime::clock::Clock;
use murmurate::runtime::real::{Readers, run_real};
use murmurate::runtime::shell::{Mailbox, start};
use murmurate::time::Time;
use murmurate_study::network::linked;
use murmurate_study::network::peer::{Peer, StationResult, Task};
use nix::poll::poll;
use tracing::info_span;

use super::connection::{Connection, Side};
use super::{Request, Response};
use murmurate::live::links;
use murmurate_robot::BadInput;
use murmurate_robot::Ended;
use murmurate_robot::output::talk;

const LINK: LinkId = LinkId(0);
/// Longest time of attempts to connect to the coordinator (`PATIENCE`), and the interval between attempts in ms
/// (`TRY_EVERY`).
const PATIENCE: Duration = Duration::from_secs(120);
const TRY_EVERY: u16 = 250;

/// Configuration of one participant in a measurement between hosts.
pub struct Participation {
    /// Team file, as resolved for the participant's host.
    pub team: Team,
    /// Key of the team; `None` if it has no key.
    pub key: Option<[u8; 32]>,
    /// Address and settings of the participant's host on the measured link, which carries latents.
    pub place: Place,
    /// Ids of all participating hosts; the index is the station number.
    pub stations: Vec<HostId>,
}

/// Takes part in a measurement as the host `name`: connects to the coordinator at `address`, and measures the cases
/// that the coordinator requests, until that ends the measurement. Fails if the connection is lost.
pub fn participate(mut participation: Participation, name: &str, address: SocketAddr, quiet: bool) -> Result<Ended> {
    participation.place.endpoint = participation.place.endpoint.restricted_to(&participation.stations);
    let origin = Instant::now();
    let mut connection = Connection::open(connect(address)?, Side::Participant, participation.key.as_ref())?;
    connection.send(&Response::Host(name.to_owned()))?;
    loop {
        match connection.receive(None)? {
            Request::Clock => connection.send(&Response::Clock(origin.elapsed().as_nanos() as u64))?,
            Request::Measure(task, begin) => {
                if !quiet {
                    talk(&format!("case {}: {}, {} messages/s", task.number, task.case.combination(), task.case.rate));
                }
                let found = measure(&participation, task, Time::from_nanos(begin), origin)?;
                connection.send(&Response::Found(found))?;
            }
            Request::Done => return Ok(Ended::Done),
        }
    }
}

fn connect(address: SocketAddr) -> Result<TcpStream> {
    let began = Instant::now();
    loop {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(stream) => return Ok(stream),
            Err(error) if began.elapsed() > PATIENCE => {
                let why = format!("--coordinator: no answer at {address}: {error}; start the coordinator there");
                return Err(BadInput(why).into());
            }
            // This waits; there is no descriptor to poll.
            Err(_) => drop(poll(&mut [], TRY_EVERY)),
        }
    }
}

/// Measures one case at this host's station, and returns its result. `begin` is the start of the case, as a time since
/// `origin`.
fn measure(participation: &Participation, task: Task, begin: Time, origin: Instant) -> Result<StationResult> {
    let at = participation.stations.iter().position(|host| *host == participation.team.host);
    let station = at.and_then(|at| u16::try_from(at).ok()).context("this host runs no agent")?;
    let (me, filter) = (participation.team.host, links::filter(&participation.team));
    let open = participation.place.endpoint.open(me, filter).map_err(|error| anyhow!("{error}"))?;
    let peer = Rc::new(RefCell::new(Peer::new(task, station, begin)));
    run_real(
        origin,
        |clock, readers| wire(clock, readers, (open, station), &peer, (participation, &task)),
        |_, now| peer.borrow().is_over(now),
    );
    let result = peer.borrow().result().clone();
    Ok(result)
}

/// Starts the actors of a case: Network, transport and station. Returns the station's mailbox for messages from other
/// stations.
fn wire(
    clock: &Clock,
    readers: &mut Readers,
    (open, station): (Box<dyn Transport>, u16),
    peer: &Rc<RefCell<Peer>>,
    (participation, task): (&Participation, &Task),
) -> Mailbox<Latent> {
    let to_peer = Mailbox::<Latent>::new("peer");
    let router = Router::new(usize::from(task.stations), |kind, robot| {
        let own = robot == RobotId(station);
        let latent = kind == Kind::Latent;
        Route { local: latent && !own, leaves: (latent && own).then_some((LINK, Audience::All)) }
    });
    let host = participation.team.host;
    let identity = links::ProcessIdentity::draw().expect("the operating system gives random bytes");
    let end = HostEnd {
        me: network::Identity { host, team: participation.team.number, incarnation: identity.incarnation },
        key: participation.key.map(|key| Key::new(key).confidential_if(participation.team.confidential)),
        seed: identity.seed,
        links: vec![Some(linked::setup(task.case.addressing, task.case.reliability))],
        keep: None,
        transports: vec![(LINK, open)],
    };
    let inward = to_peer.clone();
    let network = end.open((clock, readers), router, move |event| {
        if let Event::Message(Wire::Latent(latent)) = event {
            inward.send(latent.clone());
        }
    });
    let peer = Rc::clone(peer);
    let make = move |_| Shared(Rc::clone(&peer));
    start(clock, &to_peer, info_span!("talker"), make, move |message| network.send(network::In::Publish(message)));
    to_peer
}
