//! Opens the network links of a process as its team file describes them, and draws the identity that it has on them.
//! Does not interpret frames.

use std::sync::Arc;

use crate::actors::network::Identity;
use crate::deploy::team::{OperatorAccess, Team};
use crate::deploy::{Deployment, Link};
use crate::messages::ids::{HostId, LinkId};
use crate::net::protocol::reliability::Setup;
use crate::net::transport::{Endpoint, Filter, OpenError, Place, Transport};
use crate::random::Seed;
use crate::time::Span;

/// Reason why a process cannot open its links.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// A setting of the link, in the team file or in a flag, does not fit this machine; the text says why.
    #[error("{0}")]
    Wrong(String),
    /// The link may be opened later, for example when an interface is up; the text says why it failed now.
    #[error("{0}")]
    NotNow(String),
}

/// Link, and an open transport that carries its datagrams.
pub(crate) type Open = (LinkId, Box<dyn Transport>);

/// Random numbers of the operating system that identify a process.
pub struct ProcessIdentity {
    /// Random number that distinguishes this process from others of the same host. It is not taken from a clock, since
    /// many robots have no clock that survives a restart.
    pub incarnation: u32,
    /// Seed of the random streams of the process's link layer, which others cannot predict.
    pub seed: Seed,
    /// Bytes from which `seed` was made, to be kept in a record of the process.
    pub bytes: [u8; 32],
    /// Host number of the process in case it is an operator, a process outside the deployment.
    pub operator: HostId,
}

impl ProcessIdentity {
    /// Draws all numbers from the random generator of the operating system. Fails if that gives none.
    pub fn draw() -> Result<ProcessIdentity, LinkError> {
        let no_random = |e| LinkError::NotNow(format!("the operating system gives no random bytes: {e}"));
        let (mut seed, mut numbers) = ([0; 32], [0; 8]);
        getrandom::fill(&mut seed).and_then(|()| getrandom::fill(&mut numbers)).map_err(no_random)?;
        let [a, b, c, d, e, f, ..] = numbers;
        Ok(ProcessIdentity {
            incarnation: u32::from_le_bytes([a, b, c, d]),
            seed: Seed::of_bytes(seed),
            bytes: seed,
            operator: HostId::operator(u16::from_le_bytes([e, f])),
        })
    }

    /// Returns the identity of this process as the host that `team` describes.
    pub(super) fn host_of(&self, team: &Team) -> Identity {
        Identity { host: team.host, team: team.number, incarnation: self.incarnation }
    }

    /// Returns the identity of this process as an operator of the team with the number `team`.
    pub fn operator_of(&self, team: u16) -> Identity {
        Identity { host: self.operator, team, incarnation: self.incarnation }
    }
}

/// Returns the setup of each link. `places` has one entry of the team file for each link of the deployment: its
/// reliability modes override the deployment's; for a `None` entry, a link in which the process does not take part, the
/// setup is `None`.
pub(crate) fn setups<'a>(
    deployment: &Deployment,
    places: impl IntoIterator<Item = Option<&'a Place>>,
) -> Vec<Option<Setup>> {
    let setup = |(link, place): (&Link, Option<&Place>)| {
        let (mesh, spread) = (link.mesh, link.spreads(deployment.stepping));
        place.map(|place| Setup { mesh, spread, ..place.setup(&link.reliability) })
    };
    deployment.links.iter().zip(places).map(setup).collect()
}

/// Returns the setup of each link for an operator. `places` has one entry for each link of the deployment; for a `None`
/// entry, a link in which the operator does not take part, the setup is `None`. Every datagram carries a link report,
/// so that hosts accept the operator at once.
pub fn of_operator<'a>(
    deployment: &Deployment,
    places: impl IntoIterator<Item = Option<&'a Place>>,
) -> Vec<Option<Setup>> {
    let setups = setups(deployment, places).into_iter();
    setups.map(|setup| setup.map(|setup| Setup { report_piggyback_age: Span::ZERO, ..setup })).collect()
}

/// Returns, for each link of the deployment, how an operator takes part: its endpoint and reliability modes on the link
/// that carries the emergency stop, and `None` on all others.
pub fn places_of<'a>(access: &'a OperatorAccess, deployment: &Deployment) -> impl Iterator<Item = Option<&'a Place>> {
    let at = usize::from(access.link.0);
    (0..deployment.links.len()).map(move |link| (link == at).then(|| &access.places[0]))
}

/// Returns the packet filter for the sockets of a team: it accepts only datagrams with the team's number, and only
/// those long enough for a tag if the team has a key.
pub fn filter(team: &Team) -> Filter {
    Filter::Team { number: team.number, tagged: team.key_file.is_some() }
}

/// Opens all network links in which this host takes part according to the team file. `me` is the id of this host. An
/// error names the link. Calls `wait` with an error that may be over in a moment: it may wait, and returns whether to
/// try again.
pub(crate) fn open(team: &Team, me: HostId, wait: &mut dyn FnMut(&LinkError) -> bool) -> Result<Vec<Open>, LinkError> {
    let mut open = Vec::new();
    for (at, (link, place)) in team.deployment.links.iter().zip(&team.links).enumerate() {
        let Some(place) = place else { continue };
        let transport = loop {
            match place.endpoint.open(me, filter(team)).map_err(|error| failed(&link.name, error)) {
                Ok(transport) => break transport,
                Err(error @ LinkError::NotNow(_)) if wait(&error) => {}
                Err(error) => return Err(error),
            }
        };
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

/// Opens the link that carries the emergency stop for the operator `me`, on every network interface of the team file
/// that this machine has, or on all of its interfaces if it has none of those. If `named`, the user has chosen the
/// interface by a flag, and the link is opened only there.
pub fn join(access: &OperatorAccess, link: &Link, me: HostId, named: bool) -> Result<Vec<Open>, LinkError> {
    let all = || access.places.iter().map(|place| &place.endpoint);
    let mut endpoints: Vec<Arc<dyn Endpoint>> = all().filter(|endpoint| endpoint.is_available()).cloned().collect();
    if endpoints.is_empty() {
        let first = &access.places[0].endpoint;
        // An interface that a flag names is not replaced by others.
        endpoints = if named { vec![Arc::clone(first)] } else { first.on_all_interfaces() };
    }
    let filter = Filter::Team { number: access.number, tagged: access.key_file.is_some() };
    let mut open = Vec::new();
    let mut refused = None;
    for endpoint in &endpoints {
        match endpoint.open(me, filter) {
            Ok(transport) => open.push((access.link, transport)),
            Err(error) => refused = Some(error),
        }
    }
    match refused {
        Some(error) if open.is_empty() => Err(failed(&link.name, error)),
        _ if open.is_empty() => {
            let named: Vec<&str> = all().filter_map(|endpoint| endpoint.interface()).collect();
            let why = format!("link '{}': no interface of this machine is up; the file names {named:?}", link.name);
            Err(LinkError::NotNow(why))
        }
        _ => Ok(open),
    }
}
