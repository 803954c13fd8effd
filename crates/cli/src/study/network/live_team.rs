//! Team whose hosts measure a network, from its team file: the participants, their link, and the cases that can be
//! measured on it.

use std::path::Path;

use anyhow::Result;
use murmurate::deploy::LinkMedium;
use murmurate::deploy::team::TeamFile;
use murmurate::messages::ids::HostId;
use murmurate::messages::wire::Kind;
use murmurate::registry::Registry;
use murmurate_study::network::{Addressing, Medium, NetworkKind, ReliabilityMode, Sweep};

use super::Args;
use super::live::Participation;
use murmurate_robot::BadInput;
use murmurate_robot::bad;
use murmurate_robot::team::{self, TeamArgs};

/// Team whose hosts measure a network: the delivery and delay of messages on the link between them.
pub struct LiveTeam {
    args: TeamArgs,
    file: TeamFile,
    /// Ids of the hosts that take part: those that run Agents, in the order of their ids. The index is the station
    /// number.
    stations: Vec<HostId>,
    /// Index in the deployment of the link that carries latents, which is measured.
    link: usize,
}

impl LiveTeam {
    /// Reads the team of a measurement from the team file `path`. Fails if no latents cross a link between its hosts.
    /// An error names the flag or the field.
    pub fn of(path: &Path, args: &Args, registry: &Registry) -> Result<LiveTeam> {
        let args = TeamArgs::of(path.to_owned(), args.set.clone());
        let file = args.read(registry)?;
        let deployment = file.deployment();
        let agents = |host: &HostId| !deployment.hosts[usize::from(host.0)].agents.is_empty();
        let stations: Vec<HostId> = file.hosts().filter(agents).collect();
        let link = deployment.links.iter().position(|link| link.carries.contains(&Kind::Latent));
        match link {
            Some(link) if stations.len() > 1 => Ok(LiveTeam { args, file, stations, link }),
            _ => bad(format!(
                "--live: in mode '{}' no latents cross a link between hosts; take an onboard mode",
                deployment.mode
            )),
        }
    }

    /// Returns the path of the team file.
    pub fn file(&self) -> &Path {
        self.args.path()
    }

    /// Returns the names of the participating hosts; the index is the station number.
    pub fn names(&self) -> Vec<String> {
        let hosts = &self.file.deployment().hosts;
        self.stations.iter().map(|host| hosts[usize::from(host.0)].name.clone()).collect()
    }

    /// Returns a text that identifies the measured link: the names of the participating hosts, and a digest of the
    /// link's settings at the first one.
    pub fn link(&self) -> Result<String> {
        let team = self.args.for_host(&self.file, self.stations[0])?;
        let place = format!("{:?}", team.links[self.link]);
        Ok(format!("{}: {}", self.names().join(", "), blake3::hash(place.as_bytes()).to_hex()))
    }

    /// Reads the key of the team; `None` if it has no key.
    pub fn key(&self) -> Result<Option<[u8; 32]>> {
        Ok(team::key(&self.args.for_host(&self.file, self.stations[0])?)?.map(|file| file.shared()))
    }

    /// Returns the configuration of the participant with the host name `name`. Fails if the team has no such host, or
    /// if it runs no agent or is not on the measured link; the error names the flag (`--host` or `--live`).
    pub fn participation(&self, name: &str) -> Result<Participation> {
        let host = self.file.host_named(name).map_err(|e| BadInput(format!("--{e}")))?;
        if !self.stations.contains(&host) {
            return bad(format!("--host: '{name}' runs no agent; these do: {}", self.names().join(", ")));
        }
        let team = self.args.for_host(&self.file, host)?;
        let key = team::key(&team)?.map(|file| file.shared());
        let Some(place) = team.links[self.link].clone() else {
            return bad(format!(
                "--live: host '{name}' has no place on link '{}'",
                team.deployment.links[self.link].name
            ));
        };
        Ok(Participation { team, key, place, stations: self.stations.clone() })
    }

    /// Restricts the parameters of a network study to cases that can be measured on this team's link, so that
    /// measurement and emulation have the same cases. An error names the flag.
    pub fn restrict(&self, sweep: &mut Sweep, args: &Args) -> Result<()> {
        let team = self.args.for_host(&self.file, self.stations[0])?;
        let link = &team.deployment.links[self.link];
        let name = &link.name;
        let setup = team.links[self.link].as_ref().map(|place| place.setup(&link.reliability));
        let addressed = setup.is_some_and(|setup| setup.is_addressed());
        let addressing = if addressed { Addressing::Unicast } else { Addressing::Multicast };
        if !sweep.addressings.contains(&addressing) {
            return bad(format!("--addressing: link '{name}' of the team file is {addressing}"));
        }
        sweep.addressings = vec![addressing];
        sweep.stations = u16::try_from(self.stations.len()).expect("hosts are counted in u16");
        if args.stations.is_some_and(|stations| stations != sweep.stations) {
            return bad(format!("--stations: {} hosts of the team file take part; leave it out", sweep.stations));
        }
        sweep.reliabilities.retain(|one| !matches!(one, ReliabilityMode::Ack | ReliabilityMode::AckOff));
        if sweep.reliabilities.is_empty() {
            return bad(
                "--reliability: RTPS can only be emulated; best-effort, repeat and nack can be measured".to_owned()
            );
        }
        match &sweep.medium {
            Medium::Shaped(_) => {}
            Medium::Radio(radio) => {
                let network = match link.medium {
                    LinkMedium::AdHoc => NetworkKind::AdHoc,
                    _ => NetworkKind::Infrastructure,
                };
                if !args.retries.is_empty() && args.retries != [radio.retries] {
                    return bad(format!(
                        "--retries: a measurement has the retry limit of its hardware; that of the medium is {}",
                        radio.retries
                    ));
                }
                if !sweep.networks.contains(&network) {
                    return bad(format!("--networks: link '{name}' of the team file is {network}"));
                }
                (sweep.retries, sweep.networks) = (vec![radio.retries], vec![network]);
            }
        }
        sweep.check().map_err(|e| BadInput(format!("--{e}")).into())
    }
}
