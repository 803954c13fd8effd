//! A host's links, from what the team file says to open sockets. What is said on them never matters here.

use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Result, anyhow};
use murmurate::deploy::Link;
use murmurate::deploy::team::{SocketConfig, Team, Transport};
use murmurate::messages::ids::{HostId, LinkId};
use murmurate::net::reliability::Setup;
use murmurate::net::transport::interface::InterfaceError;
use murmurate::net::transport::udp::{Filter, OpenError, Udp};

use crate::BadInput;

/// Lives of a process that can be told apart in a second.
const LIVES_PER_S: u128 = 8;

/// Which life of a process this is: later ones have later numbers, as far as the machine's clock goes forward. Eighths
/// of a second, so that one that is killed and started again at once is not taken for its former self. They begin anew
/// every 17 years, next in 2038; then a team that runs on is to be started again as a whole.
pub fn incarnation() -> u32 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (since.as_millis() * LIVES_PER_S / 1000) as u32
}

/// How the links are set up: as the deployment has them, and as the team file has it otherwise.
pub fn setups(team: &Team) -> Vec<Setup> {
    let setup = |(link, config): (&Link, &Option<SocketConfig>)| {
        let mut reliability = link.reliability.clone();
        reliability.extend(config.iter().flat_map(|config| config.reliability.clone()));
        match config.as_ref().map(|config| &config.transport) {
            Some(Transport::Unicast { .. }) => Setup::unicast(reliability),
            _ => Setup::multicast(reliability),
        }
    };
    team.deployment.links.iter().zip(&team.links).map(setup).collect()
}

/// What of all that arrives is let through to a host of the team.
pub fn filter(team: &Team) -> Filter {
    Filter::Team { number: team.number, tagged: team.key_file.is_some() }
}

/// The sockets of the links that the team's host uses, opened for `me`.
pub fn open(team: &Team, me: HostId) -> Result<Vec<(LinkId, Udp)>> {
    let mut sockets = Vec::new();
    for (at, (link, config)) in team.deployment.links.iter().zip(&team.links).enumerate() {
        let Some(config) = config else { continue };
        let udp = Udp::open(me, config, filter(team)).map_err(|error| {
            let what = format!("link '{}': {error}", link.name);
            match error {
                // It may come up yet; a wrong name stays wrong.
                OpenError::Interface(InterfaceError::Down { .. }) => anyhow!(what),
                _ => BadInput(what).into(),
            }
        })?;
        tracing::info!(link = link.name, receive_buffer_bytes = udp.granted_bytes(), "open");
        sockets.push((LinkId(u16::try_from(at).expect("links are counted in u16")), udp));
    }
    Ok(sockets)
}
