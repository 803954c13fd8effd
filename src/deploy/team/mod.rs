//! A team file: a deployment, what the team is to do, and how each link's sockets are set up, resolved for one host.
//!
//! Pure data and its checks: no file, socket or environment is touched here. `layers` holds the fields and where each
//! value comes from, `names` whether what they name is there, `sockets` what a host needs on each link, `show` all of
//! it for a person.

pub mod layers;
mod names;
mod show;
mod sockets;

pub use layers::{Flag, Origin};
pub use show::Shown;
pub use sockets::{SocketConfig, Transport};

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;

use self::layers::{Entry, Layers, Value, place};
use super::{Deployment, MODES, Routes};
use crate::actors::cache::Handling;
use crate::config::{self, ConfigError};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::{KINDS, Kind};
use crate::scenario::{self, Scenario, Settings};
use crate::world::{Clamp, ContactRule, Physics};

/// What a host needs to know of its team.
#[derive(Clone, Debug, PartialEq)]
pub struct Team {
    /// The host.
    pub host: HostId,
    /// Which host runs what, and which link carries what.
    pub deployment: Deployment,
    /// The team's number on the wire.
    pub number: u16,
    /// Where its key is; `None` for a team that talks to nothing but its own machine, without authentication.
    pub key_file: Option<PathBuf>,
    /// What it is to do.
    pub scenario: String,
    /// What drives it: a policy file or `orca`; `None` for the scenario's shipped policy.
    pub policy: Option<PathBuf>,
    /// Episodes, one after the other with resets between.
    pub episodes: u32,
    /// The root of all randomness.
    pub seed: u64,
    /// What simulated robots are like.
    pub simulated: Simulated,
    /// The sockets, by link.
    pub links: Vec<SocketConfig>,
}

/// What simulated robots are like, and how messages and commands are handled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Simulated {
    /// Time constant of their drivetrains \[s\].
    pub lag_s: f32,
    /// What comes of a contact.
    pub contacts: ContactRule,
    /// How near to a wall is a contact \[m\].
    pub wall_radius_m: f32,
    /// How Controllers limit what the policy wants; the world's own limit goes with it.
    pub clamp: Clamp,
    /// What becomes of neighbours' messages once a robot's agent has seen them.
    pub handling: Handling,
}

/// The tables of a team file that are read as a whole, not field by field.
const WHOLE_TABLES: [&str; 1] = ["deployment"];

/// A team file with what the environment and the flags say, checked as far as it concerns all hosts.
#[derive(Clone, Debug)]
pub struct TeamFile {
    layers: Layers,
    deployment: Deployment,
    folder: PathBuf,
}

#[derive(Deserialize)]
struct Inline {
    deployment: Option<Deployment>,
}

impl TeamFile {
    /// Reads a team file that lies in `folder`. `variables` is the environment.
    pub fn read(
        text: &str,
        folder: &Path,
        variables: &[(String, String)],
        flags: &[Flag],
    ) -> Result<TeamFile, ConfigError> {
        let mut layers = Layers::read(text, flags, &WHOLE_TABLES)?;
        layers.read_environment(variables)?;
        let deployment = deployment(text, &layers)?;
        let mut fields = vec![layers::EVERY_INTERFACE.to_owned()];
        for link in &deployment.links {
            fields.extend(layers::link_fields().map(|field| format!("link.{}.{field}", link.name)));
            fields.extend(deployment.hosts.iter().map(|host| format!("link.{}.peers.{}", link.name, host.name)));
            fields.extend(KINDS.map(|kind| format!("link.{}.reliability.{}", link.name, kebab(kind))));
        }
        layers.read_link_environment(variables, &fields)?;
        let file = TeamFile { layers, deployment, folder: folder.to_owned() };
        file.check_names()?;
        Ok(file)
    }

    /// The deployment.
    pub fn deployment(&self) -> &Deployment {
        &self.deployment
    }

    /// All hosts.
    pub fn hosts(&self) -> impl Iterator<Item = HostId> + use<> {
        (0..self.deployment.hosts.len()).map(|index| HostId(index as u16))
    }

    /// The host of that name.
    pub fn host_named(&self, name: &str) -> Result<HostId, ConfigError> {
        let names: Vec<&str> = self.deployment.hosts.iter().map(|host| host.name.as_str()).collect();
        let found = names.iter().position(|host| *host == name);
        let unknown =
            || ConfigError::field("host", format!("there is no host '{name}'; there are {}", names.join(", ")));
        found.map(|index| HostId(index as u16)).ok_or_else(unknown)
    }

    /// The host that runs the robot's agent.
    pub fn host_of(&self, robot: RobotId) -> Result<HostId, ConfigError> {
        if robot.index() < self.deployment.robots {
            return Ok(Routes::of(&self.deployment).agent_host(robot));
        }
        Err(ConfigError::field("robot", format!("there is no {robot}; they are 0 to {}", self.deployment.robots - 1)))
    }

    /// Checks what concerns each host.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.hosts().try_for_each(|host| self.for_host(host).map(drop))
    }

    /// The team as this host is to see it.
    pub fn for_host(&self, host: HostId) -> Result<Team, ConfigError> {
        let scopes = self.scopes(Some(host));
        let find = |key: &str| self.layers.find(&scopes, key);
        let number = find("team").ok_or_else(|| ConfigError::field("team", "missing; give the team a number"))?;
        let name = find("scenario").expect("it has a default");
        let scenario = self.scenario()?;
        let whole = |key: &str| whole(&find(key).expect("it has a default"));
        let links: Vec<SocketConfig> =
            self.deployment.links.iter().enumerate().map(|(at, _)| self.socket(host, at)).collect::<Result<_, _>>()?;
        self.check_apart(host, &links)?;
        let key_file = find("key_file").map(|entry| self.path(&entry));
        let outside = links.iter().position(|link| !link.stays_on_loopback());
        if let (None, Some(at)) = (&key_file, outside) {
            let (host, link) = (&self.deployment.hosts[usize::from(host.0)].name, &self.deployment.links[at].name);
            let why = format!(
                "missing; link '{link}' of host '{host}' leaves this machine, and a team without a key may not: make \
                 one with 'murmurate key new'"
            );
            return Err(ConfigError::field("key_file", why));
        }
        let policy = find("policy").map(|entry| match text(&entry) {
            "orca" => PathBuf::from("orca"),
            _ => self.path(&entry),
        });
        Ok(Team {
            host,
            deployment: self.deployment.clone(),
            number: whole_u16(&number),
            key_file,
            scenario: text(&name).to_owned(),
            policy,
            episodes: u32::try_from(whole("episodes")).expect("its range is smaller"),
            seed: whole("seed"),
            simulated: self.simulated(&scopes, &*scenario),
            links,
        })
    }

    fn scenario(&self) -> Result<Arc<dyn Scenario>, ConfigError> {
        let entry = self.layers.find(&self.scopes(None), "scenario").expect("it has a default");
        build(&entry, Some(self.deployment.robots))
    }

    fn simulated(&self, scopes: &[String], scenario: &dyn Scenario) -> Simulated {
        let find = |key: &str| self.layers.find(scopes, key);
        let is = |key: &str, name: &str| find(key).is_some_and(|entry| text(&entry) == name);
        let number = |key: &str| find(key).map(|entry| number(&entry));
        Simulated {
            lag_s: number("lag_s").unwrap_or(0.0),
            contacts: if is("contacts", "judge") { ContactRule::Judge } else { ContactRule::Block },
            wall_radius_m: number("wall_radius_m")
                .unwrap_or_else(|| Physics::published(scenario.arena()).wall_radius_m),
            clamp: if is("clamp", "deployed") { Clamp::Deployed } else { Clamp::Training },
            handling: if is("handling", "as-published") { Handling::AsPublished } else { Handling::Hold },
        }
    }

    /// The prefixes under which a host finds its values, the narrowest first.
    fn scopes(&self, host: Option<HostId>) -> Vec<String> {
        let host = host.map(|host| &self.deployment.hosts[usize::from(host.0)]);
        let robot = host.and_then(|host| only_robot(&host.agents)).map(|robot| format!("robot.{robot}."));
        let host = host.map(|host| format!("host.{}.", host.name));
        robot.into_iter().chain(host).chain([String::new()]).collect()
    }

    /// A path as the file means it: from its own folder; as flags and environment mean it: from where the user is.
    fn path(&self, entry: &Entry) -> PathBuf {
        let path = Path::new(text(entry));
        if matches!(entry.origin, Origin::File(_)) { self.folder.join(path) } else { path.to_owned() }
    }
}

/// The deployment of the file: a preset, or written out.
fn deployment(text_of_file: &str, layers: &Layers) -> Result<Deployment, ConfigError> {
    let find = |key: &str| layers.find(&[String::new()], key);
    let (mode, robots) = (find("mode"), find("robots"));
    if layers.table("deployment").is_some() {
        if let Some(entry) = mode {
            let why = "there is a [deployment] too; leave one of the two out";
            return Err(ConfigError::field(place("mode", &entry.origin), why));
        }
        let inline: Inline = config::from_toml(text_of_file)?;
        let deployment = inline.deployment.expect("the table is there");
        deployment.check().map_err(|error| match error {
            ConfigError::Field { field, reason } => ConfigError::field(format!("deployment.{field}"), reason),
            syntax => syntax,
        })?;
        if let Some(link) = deployment.links.iter().find(|link| link.delay_s > 0.0 || link.loss > 0.0) {
            let why = format!("link '{}' is to be made slow or lossy, which only 'murmurate sim' can", link.name);
            return Err(ConfigError::field("deployment.link", why));
        }
        return match robots.filter(|entry| whole(entry) != deployment.robots as u64) {
            None => Ok(deployment),
            Some(entry) => {
                let why = format!("{}, but the [deployment] has {}", entry.value, deployment.robots);
                Err(ConfigError::field(place("robots", &entry.origin), why))
            }
        };
    }
    let modes = MODES.join(", ");
    let missing = || ConfigError::field("mode", format!("missing; take one of {modes}, or write a [deployment]"));
    let mode = mode.ok_or_else(missing)?;
    let scenario = find("scenario").expect("it has a default");
    let robots = match &robots {
        Some(entry) => whole_u16(entry).into(),
        None => build(&scenario, None)?.robots(),
    };
    Ok(Deployment::preset(text(&mode), robots).expect("the fields let only modes through"))
}

/// The scenario, for a team of this size or of its own.
fn build(entry: &Entry, robots: Option<usize>) -> Result<Arc<dyn Scenario>, ConfigError> {
    scenario::build(text(entry), &Settings { robots, gap_m: None })
        .map_err(|error| ConfigError::field(place("scenario", &entry.origin), error.to_string()))
}

/// The robot of a host that runs exactly one.
fn only_robot(agents: &[Vec<u16>]) -> Option<u16> {
    let robots = agents.concat();
    if let [only] = robots[..] { Some(only) } else { None }
}

/// A kind's name in files.
fn kebab(kind: Kind) -> String {
    match kind {
        Kind::Reading => "reading",
        Kind::Latent => "latent",
        Kind::MotorCommand => "motor-command",
        Kind::Heartbeat => "heartbeat",
        Kind::Mode => "mode",
    }
    .to_owned()
}

fn text(entry: &Entry) -> &str {
    let Value::Text(text) = &entry.value else { panic!("the fields let only texts through") };
    text
}

fn whole(entry: &Entry) -> u64 {
    let Value::Whole(whole) = entry.value else { panic!("the fields let only whole numbers through") };
    whole
}

fn whole_u16(entry: &Entry) -> u16 {
    u16::try_from(whole(entry)).expect("its range is smaller")
}

fn number(entry: &Entry) -> f32 {
    let Value::Number(number) = entry.value else { panic!("the fields let only numbers through") };
    number as f32
}

fn address(entry: &Entry) -> SocketAddr {
    let Value::Address(address) = entry.value else { panic!("the fields let only addresses through") };
    address
}
