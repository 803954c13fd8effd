//! A participant of a measurement: Network actor, link and transport of `murmurate host`, with a talker in place of
//! a robot.

use std::cell::RefCell;
use std::net::{SocketAddr, TcpStream};
use std::rc::Rc;
use std::time::{Duration, Instant};

use crate::actors::network;
use crate::deploy::team::Team;
use crate::graph::sockets::Shared;
use crate::graph::station::{self, Station};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{Kind, Latent, Wire};
use crate::net::protocol::key::Key;
use crate::net::protocol::router::{Audience, Route, Router};
use crate::net::transport::{Place, Transport};
use crate::runtime::clock::Clock;
use crate::runtime::real::{Readers, run_real};
use crate::runtime::shell::{Mailbox, start};
use crate::study::network::linked;
use crate::study::network::peer::{Notes, Peer, Task};
use crate::time::Time;
use anyhow::{Context, Result, anyhow};
use nix::poll::poll;
use tracing::info_span;

use super::line::{End, Line};
use super::{Answer, Instruction};
use crate::live::links;
use crate::program::BadInput;
use crate::program::Ended;
use crate::program::output::talk;

const LINK: LinkId = LinkId(0);
/// How long the coordinator is waited for, and how often it is tried \[ms\].
const PATIENCE: Duration = Duration::from_secs(120);
const TRY_EVERY: u16 = 250;

/// The part of a host in a measurement.
pub struct Part {
    /// The host and its team.
    pub team: Team,
    /// Its key.
    pub key: Option<[u8; 32]>,
    /// Its place on the link that carries latents.
    pub place: Place,
    /// The hosts that take part, in the order of their stations.
    pub stations: Vec<HostId>,
}

/// Measures what the coordinator says, until it says that that was all.
pub fn participate(mut part: Part, name: &str, address: SocketAddr, quiet: bool) -> Result<Ended> {
    part.place.way = part.place.way.among(&part.stations);
    let origin = Instant::now();
    let mut line = Line::open(connect(address)?, End::Participant, part.key.as_ref())?;
    line.say(&Answer::Host(name.to_owned()))?;
    loop {
        match line.hear(None)? {
            Instruction::Clock => line.say(&Answer::Clock(origin.elapsed().as_nanos() as u64))?,
            Instruction::Measure(task, begin) => {
                if !quiet {
                    talk(&format!("case {}: {}, {} messages/s", task.number, task.case.combination(), task.case.rate));
                }
                let found = measure(&part, task, Time::from_nanos(begin), origin)?;
                line.say(&Answer::Found(found))?;
            }
            Instruction::Done => return Ok(Ended::Done),
        }
    }
}

fn connect(address: SocketAddr) -> Result<TcpStream> {
    let began = Instant::now();
    loop {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(stream) => return Ok(stream),
            Err(error) if began.elapsed() > PATIENCE => {
                let why = format!("--coordinator: nobody answers at {address}: {error}; start the coordinator there");
                return Err(BadInput(why).into());
            }
            // Waits on nothing at all.
            Err(_) => drop(poll(&mut [], TRY_EVERY)),
        }
    }
}

/// One case.
fn measure(part: &Part, task: Task, begin: Time, origin: Instant) -> Result<Notes> {
    let at = part.stations.iter().position(|host| *host == part.team.host);
    let station = at.and_then(|at| u16::try_from(at).ok()).context("this host runs no agent")?;
    let open = part.place.way.open(part.team.host, links::filter(&part.team)).map_err(|error| anyhow!("{error}"))?;
    let peer = Rc::new(RefCell::new(Peer::new(task, station, begin)));
    run_real(
        origin,
        |clock, readers| wire(clock, readers, (open, station), &peer, (part, &task)),
        |_, now| peer.borrow().is_over(now),
    );
    let notes = peer.borrow().notes().clone();
    Ok(notes)
}

/// Starts Network, transport and talker.
fn wire(
    clock: &Clock,
    readers: &mut Readers,
    (open, station): (Box<dyn Transport>, u16),
    peer: &Rc<RefCell<Peer>>,
    (part, task): (&Part, &Task),
) -> Mailbox<Latent> {
    let to_peer = Mailbox::<Latent>::new("peer");
    let router = Router::new(usize::from(task.stations), |kind, robot| {
        let own = robot == RobotId(station);
        let latent = kind == Kind::Latent;
        Route { local: latent && !own, leaves: (latent && own).then_some((LINK, Audience::All)) }
    });
    let host = part.team.host;
    let fresh = links::Fresh::draw().expect("the operating system gives random bytes");
    let station = Station {
        me: network::Identity { host, team: part.team.number, epoch: fresh.incarnation },
        key: part.key.map(Key::new),
        links: vec![Some(linked::setup(task.case.addressing, task.case.reliability))],
        router,
        seed: fresh.seed,
        stream: format!("network/{}", host.0),
        span: info_span!("network"),
    };
    let inward = to_peer.clone();
    let network = station.open((clock, readers), vec![(LINK, open)], move |said| {
        if let station::Out::Deliver(Wire::Latent(latent)) = said {
            inward.send(latent);
        }
    });
    let peer = Rc::clone(peer);
    let make = move |_| Shared(Rc::clone(&peer));
    start(clock, &to_peer, info_span!("talker"), make, move |message| network.send(network::In::Publish(message)));
    to_peer
}
