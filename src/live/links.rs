//! A process's links, from what the team file says to open transports, and who the process is on them. What is said on
//! them never matters here.

use std::sync::Arc;

use crate::actors::network::Identity;
use crate::deploy::team::{OperatorAccess, Team};
use crate::deploy::{Deployment, Link};
use crate::messages::ids::{HostId, LinkId};
use crate::net::protocol::reliability::Setup;
use crate::net::transport::{Filter, OpenError, Place, Transport, Way};
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

/// A link and what is open of it.
pub type Open = (LinkId, Box<dyn Transport>);

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
pub fn setups<'a>(deployment: &Deployment, places: impl IntoIterator<Item = Option<&'a Place>>) -> Vec<Option<Setup>> {
    let setup = |(link, place): (&Link, Option<&Place>)| place.map(|place| place.setup(&link.reliability));
    deployment.links.iter().zip(places).map(setup).collect()
}

/// How they are set up for an operator, which is to be believed at once: a report goes with every datagram.
pub fn of_operator<'a>(
    deployment: &Deployment,
    places: impl IntoIterator<Item = Option<&'a Place>>,
) -> Vec<Option<Setup>> {
    let setups = setups(deployment, places).into_iter();
    setups.map(|setup| setup.map(|setup| Setup { report_rides: Span::ZERO, ..setup })).collect()
}

/// The place of an operator that has a part in the link of the stop alone.
pub fn places_of<'a>(access: &'a OperatorAccess, deployment: &Deployment) -> impl Iterator<Item = Option<&'a Place>> {
    let at = usize::from(access.link.0);
    (0..deployment.links.len()).map(move |link| (link == at).then(|| &access.places[0]))
}

/// What a host of the team has to hear.
pub fn filter(team: &Team) -> Filter {
    Filter::Team { number: team.number, tagged: team.key_file.is_some() }
}

/// Opens the links that the team's host uses, for `me`.
pub fn open(team: &Team, me: HostId) -> Result<Vec<Open>, LinkError> {
    let mut open = Vec::new();
    for (at, (link, place)) in team.deployment.links.iter().zip(&team.links).enumerate() {
        let Some(place) = place else { continue };
        let transport = place.way.open(me, filter(team)).map_err(|error| failed(&link.name, error))?;
        tracing::info!(link = link.name, "open");
        open.push((LinkId(u16::try_from(at).expect("links are counted in u16")), transport));
    }
    Ok(open)
}

fn failed(link: &str, error: OpenError) -> LinkError {
    match error {
        OpenError::Wrong(why) => LinkError::Wrong(format!("link '{link}': {why}")),
        OpenError::NotNow(why) => LinkError::NotNow(format!("link '{link}': {why}")),
    }
}

/// Opens the link of the stop for an operator: by every way of the team file that this machine has; or, where it has
/// none of those, by all that it has. Where a flag has `named` the interface, by that one or none.
pub fn join(access: &OperatorAccess, link: &Link, me: HostId, named: bool) -> Result<Vec<Open>, LinkError> {
    let all = || access.places.iter().map(|place| &place.way);
    let mut ways: Vec<Arc<dyn Way>> = all().filter(|way| way.is_here()).cloned().collect();
    if ways.is_empty() {
        let first = &access.places[0].way;
        // Of a flag nothing else is meant.
        ways = if named { vec![Arc::clone(first)] } else { first.everywhere() };
    }
    let filter = Filter::Team { number: access.number, tagged: access.key_file.is_some() };
    let mut open = Vec::new();
    let mut refused = None;
    for way in &ways {
        match way.open(me, filter) {
            Ok(transport) => open.push((access.link, transport)),
            Err(error) => refused = Some(error),
        }
    }
    match refused {
        Some(error) if open.is_empty() => Err(failed(&link.name, error)),
        _ if open.is_empty() => {
            let named: Vec<&str> = all().filter_map(|way| way.interface()).collect();
            let why = format!("link '{}': no interface of this machine is up; the file names {named:?}", link.name);
            Err(LinkError::NotNow(why))
        }
        _ => Ok(open),
    }
}
