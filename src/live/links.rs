//! A process's links, from what the team file says to open sockets, and who the process is on them. What is said on
//! them never matters here.

use crate::actors::network::Identity;
use crate::deploy::team::{Post, Team};
use crate::deploy::{Deployment, Link};
use crate::messages::ids::{HostId, LinkId};
use crate::net::protocol::reliability::Setup;
use crate::net::transport::interface::{self, Interface, InterfaceError};
use crate::net::transport::socket::{SocketConfig, Transport};
use crate::net::transport::udp::{Filter, OpenError, Udp};
use crate::random::Seed;
use crate::time::Span;

/// Why a process has no part in its links.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The team file says what cannot be on this machine.
    #[error("{0}")]
    Wrong(String),
    /// It may go well later, as where an interface is down.
    #[error("{0}")]
    NotNow(String),
}

/// Random numbers of the operating system that make a process itself and no other.
pub struct Fresh {
    /// Its incarnation on every link. No clock is asked: many robots have none that survives a restart.
    pub incarnation: u32,
    /// The root of what its link layer draws; nobody else can know it.
    pub seed: Seed,
    /// The number that it has as an operator.
    pub operator: HostId,
}

impl Fresh {
    /// Draws them.
    pub fn draw() -> Result<Fresh, LinkError> {
        let no_random = |e| LinkError::NotNow(format!("the operating system gives no random bytes: {e}"));
        let (mut seed, mut numbers) = ([0; 32], [0; 8]);
        getrandom::fill(&mut seed).and_then(|()| getrandom::fill(&mut numbers)).map_err(no_random)?;
        let [a, b, c, d, e, f, ..] = numbers;
        Ok(Fresh {
            incarnation: u32::from_le_bytes([a, b, c, d]),
            seed: Seed::of_bytes(seed),
            operator: HostId::operator(u16::from_le_bytes([e, f])),
        })
    }

    /// An operator of this team.
    pub fn operator_of(&self, team: u16) -> Identity {
        Identity { host: self.operator, team, epoch: self.incarnation }
    }
}

/// How the links are set up that have a place here: as the deployment has them, and as the team file has it otherwise.
pub fn setups<'a>(
    deployment: &Deployment,
    places: impl IntoIterator<Item = Option<&'a SocketConfig>>,
) -> Vec<Option<Setup>> {
    let setup = |(link, place): (&Link, Option<&SocketConfig>)| {
        let config = place?;
        let mut reliability = link.reliability.clone();
        reliability.extend(config.reliability.clone());
        Some(match config.transport {
            Transport::Unicast { .. } => Setup::unicast(reliability),
            Transport::Multicast { .. } => Setup::multicast(reliability),
        })
    };
    deployment.links.iter().zip(places).map(setup).collect()
}

/// How they are set up for an operator, which is to be believed at once: a report goes with every datagram.
pub fn of_operator<'a>(
    deployment: &Deployment,
    places: impl IntoIterator<Item = Option<&'a SocketConfig>>,
) -> Vec<Option<Setup>> {
    let setups = setups(deployment, places).into_iter();
    setups.map(|setup| setup.map(|setup| Setup { report_rides: Span::ZERO, ..setup })).collect()
}

/// The place of an operator that has a part in the link of the stop alone.
pub fn at_post<'a>(post: &'a Post, deployment: &Deployment) -> impl Iterator<Item = Option<&'a SocketConfig>> {
    let at = usize::from(post.link.0);
    (0..deployment.links.len()).map(move |link| (link == at).then(|| &post.sockets[0]))
}

/// The filter in the kernel for a host of the team.
pub fn filter(team: &Team) -> Filter {
    Filter::Team { number: team.number, tagged: team.key_file.is_some() }
}

/// The sockets of the links that the team's host uses, opened for `me`.
pub fn open(team: &Team, me: HostId) -> Result<Vec<(LinkId, Udp)>, LinkError> {
    let mut sockets = Vec::new();
    for (at, (link, config)) in team.deployment.links.iter().zip(&team.links).enumerate() {
        let Some(config) = config else { continue };
        let udp = Udp::open(me, config, filter(team)).map_err(|error| failed(&link.name, error))?;
        tracing::info!(link = link.name, receive_buffer_bytes = udp.granted_bytes(), "open");
        sockets.push((LinkId(u16::try_from(at).expect("links are counted in u16")), udp));
    }
    Ok(sockets)
}

fn failed(link: &str, error: OpenError) -> LinkError {
    let what = format!("link '{link}': {error}");
    match error {
        // It may come up yet; a wrong name stays wrong.
        OpenError::Interface(InterfaceError::Down { .. }) => LinkError::NotNow(what),
        _ => LinkError::Wrong(what),
    }
}

/// The sockets of an operator: on every interface of this machine that the team file names for the link of the stop;
/// or, where it has none of those, on all that are up. Where a flag has `named` the interface, that one or none.
pub fn join(post: &Post, link: &Link, me: HostId, named: bool) -> Result<Vec<(LinkId, Udp)>, LinkError> {
    let interfaces = interface::interfaces().map_err(|error| failed(&link.name, error.into()))?;
    let here = |config: &&SocketConfig| interfaces.iter().any(|i| i.up && i.name == config.interface);
    let addressed = |config: &&SocketConfig| matches!(config.transport, Transport::Unicast { .. });
    let mut ways: Vec<SocketConfig> = post.sockets.iter().filter(|c| addressed(c) || here(c)).cloned().collect();
    if ways.is_empty() && named {
        // Of a flag nothing else is meant.
        ways = post.sockets[..1].to_vec();
    } else if ways.is_empty() {
        ways = everywhere(&interfaces, &post.sockets[0]);
    }
    let mut sockets = Vec::new();
    let mut refused = None;
    for way in &ways {
        let filter = Filter::Team { number: post.number, tagged: post.key_file.is_some() };
        match Udp::open_guest(me, way, filter) {
            Ok(udp) => sockets.push((post.link, udp)),
            Err(error) => refused = Some(error),
        }
    }
    match refused {
        Some(error) if sockets.is_empty() => Err(failed(&link.name, error)),
        _ if sockets.is_empty() => {
            let named: Vec<&str> = post.sockets.iter().map(|config| config.interface.as_str()).collect();
            let why = format!("link '{}': no interface of this machine is up; the file names {named:?}", link.name);
            Err(LinkError::NotNow(why))
        }
        _ => Ok(sockets),
    }
}

/// The same way on every interface that is up and leads out of this machine.
fn everywhere(interfaces: &[Interface], config: &SocketConfig) -> Vec<SocketConfig> {
    let outward = interfaces.iter().filter(|interface| interface.up && !interface.loopback);
    outward.map(|interface| SocketConfig { interface: interface.name.clone(), ..config.clone() }).collect()
}
