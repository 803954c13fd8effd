//! Team files: a deployment, its scenario and policy, and the sockets of each link, resolved for one host.
//!
//! Pure data and checks: no file, socket or environment variable is accessed. `fields` has the permitted fields,
//! `layers` the origins of values, `names` the check of names, `places` the host's place on each link, `show` the
//! listing of values, `size` the scenario with its size.

mod fields;
mod layers;
mod names;
mod places;
mod show;
mod size;

pub use layers::{Flag, Origin};
pub use places::OperatorAccess;
pub use show::Shown;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;

use self::fields::EVERY_INTERFACE;
use self::layers::{LayerValue, Layers, place};
use self::size::{about_hulls, build, knowing_task};
use super::roles::placed;
use super::{Deployment, Host, Link, MODES, Roles, Routes, Senses};
use crate::config::{self, ConfigError};
use crate::estimation;
use crate::hearing::Handling;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::{KINDS, Kind};
use crate::net::transport::Place;
use crate::registry::Registry;
use crate::safety::{Clamp, Safety};
use crate::scenario::{Scenario, Settings, TaskFile};
use crate::time::Span;
use crate::world::{ContactRule, Overrides, Physics, Sensor};

/// Configuration of one host of a team, with the values that apply to this host.
#[derive(Clone, Debug)]
pub struct Team {
    /// Id of the host that this configuration is for.
    pub host: HostId,
    /// Hosts and links of the team.
    pub deployment: Deployment,
    /// Team number in every datagram, which keeps teams on one network apart.
    pub number: u16,
    /// Path of the team's key file; `None` for a team on one machine, which needs no authentication.
    pub key_file: Option<PathBuf>,
    /// Whether the team's datagrams are encrypted; only with a key.
    pub confidential: bool,
    /// Name of the team's scenario.
    pub scenario: String,
    /// Task file of the team's scenario, with its path; `None` for a scenario of the registry.
    pub task: Option<(PathBuf, TaskFile)>,
    /// Policy of the team: path of a file, or a name; `None` for the scenario's default.
    pub policy: Option<PathBuf>,
    /// Number of episodes of the trial.
    pub episodes: u32,
    /// Seed of the random numbers of the trial.
    pub seed: u64,
    /// Properties of simulated robots, and settings of how policies' messages and velocities are treated.
    pub simulated: SimulationSettings,
    /// Estimator that computes robots' states from readings on this host.
    pub estimator: estimation::Entry,
    /// Known delay from a measurement to the arrival of its reading; `None` for the latency of the simulated sensor.
    pub(crate) sensor_delay: Option<Span>,
    /// Conditions in which robots are stopped or slowed, and the limits of their motion.
    pub safety: Safety,
    /// Folder for the host's records; `None` if nothing is recorded.
    pub record: Option<PathBuf>,
    /// Time before and after an event, such as an emergency stop or an aborted episode, that is recorded \[s\]; `None`
    /// to record the whole run.
    pub record_last_s: Option<f64>,
    /// Size of a record's file at which the next file begins \[MB\]; `None` for a single file.
    pub record_size_mb: Option<f64>,
    /// Endpoint and reliability modes of this host on each link of the deployment; `None` for a link on which it
    /// neither sends nor receives.
    pub links: Vec<Option<Place>>,
}

/// Properties of simulated robots, and settings of how policies' messages and velocities are treated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationSettings {
    /// Properties of simulated robots and their sensors.
    pub(crate) physics: Physics,
    /// Limit on the policy's velocities: that of training, where the simulator limits acceleration, or that of the
    /// paper's robots.
    pub clamp: Clamp,
    /// Whether a neighbour's message is used in every control step within the hold time, or only once.
    pub(crate) handling: Handling,
}

/// Tables of a team file that are read as a whole, not field by field.
const WHOLE_TABLES: [&str; 4] = ["deployment", "safety", "senses", "roles"];

/// Content of a team file, with the environment variables and flags that override its fields. Settings common to all
/// hosts were checked when it was read.
#[derive(Clone, Debug)]
pub struct TeamFile {
    registry: Registry,
    layers: Layers,
    deployment: Deployment,
    safety: Safety,
    folder: PathBuf,
    /// Task file that the field `scenario` names, with its path.
    task: Option<(PathBuf, TaskFile)>,
}

#[derive(Deserialize)]
struct Inline {
    deployment: Option<Deployment>,
    #[serde(default)]
    safety: Safety,
    #[serde(default)]
    senses: Senses,
    #[serde(default)]
    roles: Roles,
}

impl TeamFile {
    /// Reads a team file with the content `text`. Relative paths in it start from `folder`. `registry` has the
    /// scenarios, policies, drivers and so on that the file may name. `variables` are names and values of environment
    /// variables, which override fields of the file; `flags` override both.
    ///
    /// # Errors
    /// If a field is wrong. The error names the field and the origin of its value: file, environment variable or flag.
    pub fn read(
        registry: &Registry,
        text: &str,
        folder: &Path,
        variables: &[(String, String)],
        flags: &[Flag],
    ) -> Result<TeamFile, ConfigError> {
        let mut layers = Layers::read(text, flags, &WHOLE_TABLES, registry.transports())?;
        layers.read_environment(variables)?;
        let (registry, task) = &knowing_task(registry, &layers, |entry| path(folder, entry))?;
        let inline: Inline = config::from_toml(text)?;
        inline.safety.check().map_err(|error| error.within("safety"))?;
        let deployment = deployment(registry, inline.deployment, &layers)?;
        let deployment = deployment.from_folder(registry, folder).perceiving(registry, inline.senses)?;
        let deployment = deployment.in_roles(registry, placed(registry, inline.roles, folder))?;
        let file = task.as_ref().map(|(_, file)| file);
        let deployment = deployment.for_task(file);
        let safety = about_hulls(inline.safety, &layers, (file, &deployment))?;
        let mut fields = vec![EVERY_INTERFACE.to_owned()];
        for link in &deployment.links {
            fields.extend(layers.fields().of_link().map(|field| format!("link.{}.{field}", link.name)));
            for table in layers.fields().by_host() {
                let of = |host: &Host| format!("link.{}.{table}.{}", link.name, host.name);
                fields.extend(deployment.hosts.iter().map(of));
            }
            fields.extend(KINDS.map(|kind| format!("link.{}.reliability.{}", link.name, kebab(kind))));
        }
        layers.read_link_environment(variables, &fields)?;
        let (registry, folder, task) = (registry.clone(), folder.to_owned(), task.clone());
        let file = TeamFile { registry, layers, deployment, safety, folder, task };
        file.check_names()?;
        Ok(file)
    }

    /// Returns the deployment of the team.
    pub fn deployment(&self) -> &Deployment {
        &self.deployment
    }

    /// Returns the ids of all hosts of the team, from 0.
    pub fn hosts(&self) -> impl Iterator<Item = HostId> + use<> {
        (0..self.deployment.hosts.len()).map(|index| HostId(index as u16))
    }

    /// Returns the id of the host with the name `name`. An error lists the names of all hosts.
    pub fn host_named(&self, name: &str) -> Result<HostId, ConfigError> {
        let names: Vec<&str> = self.deployment.hosts.iter().map(|host| host.name.as_str()).collect();
        let found = names.iter().position(|host| *host == name);
        let unknown =
            || ConfigError::field("host", format!("there is no host '{name}'; there are {}", names.join(", ")));
        found.map(|index| HostId(index as u16)).ok_or_else(unknown)
    }

    /// Returns the host that runs the robot's Agent. Fails if there is no such robot.
    pub fn host_of(&self, robot: RobotId) -> Result<HostId, ConfigError> {
        if robot.index() < self.deployment.robots {
            return Ok(Routes::of(&self.deployment).agent_host(robot));
        }
        Err(ConfigError::field("robot", format!("there is no {robot}; they are 0 to {}", self.deployment.robots - 1)))
    }

    /// Checks the configuration of every host of the team. An error names the field.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.hosts().try_for_each(|host| self.for_host(host).map(drop))
    }

    /// Returns the configuration of the host `host`, with the values that apply to it. An error names the field.
    pub fn for_host(&self, host: HostId) -> Result<Team, ConfigError> {
        let scopes = self.scopes(Some(host));
        let find = |key: &str| self.layers.find(&scopes, key);
        let number = find("team").ok_or_else(|| ConfigError::field("team", "missing; give the team a number"))?;
        let scenario = self.scenario()?;
        let whole = |key: &str| whole(&find(key).expect("it has a default"));
        let routes = Routes::of(&self.deployment);
        let links = self.deployment.links.iter().enumerate().map(|(at, link)| {
            let used = link.carries.iter().any(|&kind| routes.exchanges(host, kind));
            used.then(|| self.place(host, at)).transpose()
        });
        let links: Vec<Option<Place>> = links.collect::<Result<_, _>>()?;
        self.check_apart(host, &links)?;
        let key_file = find("key_file").map(|entry| self.path(&entry));
        let confidential = self.is_confidential(key_file.as_deref())?;
        let outside = links.iter().position(|link| link.as_ref().is_some_and(|place| !place.endpoint.is_local()));
        if let (None, Some(at)) = (&key_file, outside) {
            let (host, link) = (&self.deployment.hosts[usize::from(host.0)].name, &self.deployment.links[at].name);
            let why = format!(
                "missing; link '{link}' of host '{host}' leaves this machine, and a team without a key may not: make \
                 one with the command 'key new'"
            );
            return Err(ConfigError::field("key_file", why));
        }
        let policy = find("policy").map(|entry| match text(&entry) {
            name if self.registry.policy(name).is_some() => PathBuf::from(name),
            _ => self.path(&entry),
        });
        Ok(Team {
            host,
            deployment: self.deployment.clone(),
            number: whole_u16(&number),
            key_file,
            confidential,
            scenario: scenario.name().to_owned(),
            task: self.task.clone(),
            policy,
            episodes: u32::try_from(whole("episodes")).expect("its range is smaller"),
            seed: whole("seed"),
            simulated: self.simulated(&scopes, &*scenario)?,
            estimator: self.estimator(&scopes)?,
            sensor_delay: find("sensor_delay_s").map(|entry| Span::from_secs(entry.value.number())),
            safety: self.safety,
            record: find("record").map(|entry| self.path(&entry)),
            record_last_s: find("record_last_s").map(|entry| entry.value.number()),
            record_size_mb: find("record_size_mb").map(|entry| entry.value.number()),
            links,
        })
    }

    /// Returns whether the team's datagrams are encrypted. Fails if they are to be and there is no key.
    fn is_confidential(&self, key_file: Option<&Path>) -> Result<bool, ConfigError> {
        let entry = self.layers.find(&self.scopes(None), "confidential").expect("it has a default");
        if entry.value.truth() && key_file.is_none() {
            let why = "true, and there is no key_file to encrypt with: make one with the command 'key new'";
            return Err(ConfigError::field(place("confidential", &entry.origin), why));
        }
        Ok(entry.value.truth())
    }

    fn scenario(&self) -> Result<Arc<dyn Scenario>, ConfigError> {
        let entry = self.layers.find(&self.scopes(None), "scenario").expect("it has a default");
        build(&self.registry, &self.layers, &entry, &self.deployment.settings())
    }

    fn simulated(&self, scopes: &[String], scenario: &dyn Scenario) -> Result<SimulationSettings, ConfigError> {
        let find = |key: &str| self.layers.find(scopes, key);
        let name = |key: &str| find(key).map(|entry| text(&entry).to_owned());
        let is = |key: &str, word: &str| name(key).is_some_and(|name| name == word);
        let number = |key: &str| find(key).map(|entry| number(&entry));
        let sensor = |name: String| Sensor::NAMED.into_iter().find(|(other, _)| *other == name);
        let overrides = Overrides {
            lag_s: number("lag_s"),
            contacts: name("contacts")
                .map(|name| if name == "judge" { ContactRule::Judge } else { ContactRule::Block }),
            wall_radius_m: number("wall_radius_m"),
            sensor: name("sensor").and_then(sensor).map(|(_, sensor)| sensor),
        };
        let entry = self.registry.plant(&self.deployment.plant).expect("its name was checked when the file was read");
        let physics = overrides.physics(entry, scenario.arena()).map_err(|error| {
            let origin = find(error.field).expect("it was given").origin;
            ConfigError::field(place(error.field, &origin), error.to_string())
        })?;
        Ok(SimulationSettings {
            physics,
            clamp: if is("clamp", "deployed") { Clamp::Deployed } else { Clamp::Training },
            handling: if is("handling", "as-published") { Handling::AsPublished } else { Handling::Hold },
        })
    }

    /// Returns the estimator that the file chooses for a host, whose prefixes of keys are `scopes`.
    fn estimator(&self, scopes: &[String]) -> Result<estimation::Entry, ConfigError> {
        let entry = self.layers.find(scopes, "estimator").expect("it has a default");
        let found = self.registry.estimator(text(&entry)).copied();
        found.map_err(|error| ConfigError::field(place("estimator", &entry.origin), error.to_string()))
    }

    /// Returns the prefixes of keys under which a host's values are looked up, such as `robot.2.` and `host.pc.`, the
    /// narrowest first; for the whole team (`None`), only the empty prefix.
    fn scopes(&self, host: Option<HostId>) -> Vec<String> {
        let host = host.map(|host| &self.deployment.hosts[usize::from(host.0)]);
        let robot = host.and_then(|host| only_robot(&host.agents)).map(|robot| format!("robot.{robot}."));
        let host = host.map(|host| format!("host.{}.", host.name));
        robot.into_iter().chain(host).chain([String::new()]).collect()
    }

    /// Returns the path that a field contains: relative to the folder of the team file if the value is from the file,
    /// otherwise as it is (relative to the working directory).
    fn path(&self, entry: &LayerValue) -> PathBuf {
        path(&self.folder, entry)
    }
}

/// Returns the path that a field of a team file in the folder `folder` contains.
fn path(folder: &Path, entry: &LayerValue) -> PathBuf {
    let path = Path::new(text(entry));
    if matches!(entry.origin, Origin::File(_)) { folder.join(path) } else { path.to_owned() }
}

/// Returns the deployment of a team file: the preset of its field `mode`, or the table `deployment` (`inline`).
fn deployment(registry: &Registry, inline: Option<Deployment>, layers: &Layers) -> Result<Deployment, ConfigError> {
    let find = |key: &str| layers.find(&[String::new()], key);
    let (mode, robots, plant) = (find("mode"), find("robots"), find("plant"));
    if let Some(deployment) = inline {
        if let Some(entry) = mode {
            let why = "there is a [deployment] too; leave one of the two out";
            return Err(ConfigError::field(place("mode", &entry.origin), why));
        }
        if let Some(entry) = plant {
            let why = "there is a [deployment] too, which has a plant of its own; leave one of the two out";
            return Err(ConfigError::field(place("plant", &entry.origin), why));
        }
        for field in ["gap_m", "scale", "hull_m", "latent_rate_hz"] {
            if let Some(entry) = find(field) {
                let why = "there is a [deployment] too, which may have one of its own; write it there";
                return Err(ConfigError::field(place(field, &entry.origin), why));
            }
        }
        deployment.check().map_err(|error| error.within("deployment"))?;
        let plant = registry.plant(&deployment.plant);
        plant.map_err(|error| ConfigError::field("deployment.plant", error.to_string()))?;
        check_devices(registry, &deployment).map_err(|error| error.within("deployment.host"))?;
        let worse = |link: &&Link| link.delay_s > 0.0 || link.loss > 0.0 || link.range_m.is_some();
        if let Some(link) = deployment.links.iter().find(worse) {
            let why = format!("link '{}' has a delay, loss or range, which only the command 'sim' emulates", link.name);
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
    let size = |key: &str| find(key).map(|entry| number(&entry));
    let settings = Settings { robots: None, gap_m: size("gap_m"), scale: size("scale"), hull_m: size("hull_m") };
    let robots = match &robots {
        Some(entry) => whole_u16(entry).into(),
        None => build(registry, layers, &scenario, &settings)?.robots(),
    };
    let preset = Deployment::preset(text(&mode), robots).expect("the fields let only modes through").sized(&settings);
    let preset = Deployment { latent_rate_hz: find("latent_rate_hz").map(|entry| number(&entry).into()), ..preset };
    let Some(entry) = plant else { return Ok(preset) };
    match registry.plant(text(&entry)) {
        Ok(plant) => Ok(Deployment { plant: plant.name.to_owned(), ..preset }),
        Err(error) => Err(ConfigError::field(place("plant", &entry.origin), error.to_string())),
    }
}

/// Checks the settings of all drivers, sources of readings and observers by creating them; no worker is started.
fn check_devices(registry: &Registry, deployment: &Deployment) -> Result<(), ConfigError> {
    let ids = |robots: &[u16]| robots.iter().copied().map(RobotId).collect::<Vec<_>>();
    for host in &deployment.hosts {
        let mut claims: BTreeMap<String, RobotId> = BTreeMap::new();
        for (robot, settings) in ids(&host.actuates).into_iter().zip(host.driver.iter().cycle()) {
            let parts = registry.driver(settings, robot)?;
            deployment.check_flight(robot, ((parts.driver)().flies(), &settings.name))?;
            let Some(claim) = parts.worker.and_then(|worker| worker.claim()) else { continue };
            if let Some(other) = claims.insert(claim.clone(), robot) {
                let why = format!("{robot} and {other} of host '{}' have one {claim}: give each its own", host.name);
                return Err(ConfigError::field(format!("driver.robot.{}", robot.0), why));
            }
        }
        host.source.iter().try_for_each(|settings| registry.source(settings, &ids(&host.localizes)).map(drop))?;
        let team: Vec<RobotId> = RobotId::team(deployment.robots).collect();
        host.observe.iter().try_for_each(|settings| registry.observer(settings, &team).map(drop))?;
    }
    Ok(())
}

/// Returns the robot of a host whose Agents have exactly one robot together; `None` for any other number. `agents` has
/// the robots of each Agent.
fn only_robot(agents: &[Vec<u16>]) -> Option<u16> {
    let robots = agents.concat();
    if let [only] = robots[..] { Some(only) } else { None }
}

/// Returns the name of a kind of message as it is written in files.
fn kebab(kind: Kind) -> String {
    let name = serde_json::to_value(kind).expect("a kind has a name");
    name.as_str().expect("it is a text").to_owned()
}

fn text(entry: &LayerValue) -> &str {
    entry.value.text()
}

fn whole(entry: &LayerValue) -> u64 {
    entry.value.whole()
}

fn whole_u16(entry: &LayerValue) -> u16 {
    u16::try_from(whole(entry)).expect("its range is smaller")
}

fn number(entry: &LayerValue) -> f32 {
    entry.value.number() as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const ADHOC: &str = r#"
team = 3
key_file = "keys/team.key"
mode = "onboard-adhoc"
robots = 3
seed = 4

[link.ad-hoc]
interface = "wlan1"
group = "[ff02::4d75]:7700"
reliability = { latent = "repeat" }

[link.infra]
interface = "wlan0"
group = "239.255.77.1:7700"
receive_buffer_bytes = 65536

[link.wires]
transport = "unicast"
interface = "lo"
peers = { robot-0 = "127.0.0.1:1", robot-1 = "127.0.0.1:2", robot-2 = "127.0.0.1:3", world = "127.0.0.1:4" }

[robot.2.link.infra]
interface = "wlan7"

[host.robot-2]
policy = "orca"
key_file = "own.key"

[host.robot-2.link.infra]
interface = "wlan8"
"#;

    fn read(text: &str, variables: &[(&str, &str)], flags: &[(&'static str, &str, &str)]) -> Result<TeamFile, String> {
        let variables: Vec<(String, String)> =
            variables.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        let flags: Vec<Flag> = flags
            .iter()
            .map(|(flag, key, value)| Flag { flag, key: (*key).to_owned(), value: (*value).to_owned() })
            .collect();
        let file = TeamFile::read(&Registry::builtin(), text, Path::new("teams"), &variables, &flags)
            .map_err(|e| e.to_string())?;
        file.check().map_err(|e| e.to_string())?;
        Ok(file)
    }

    fn team(file: &TeamFile, host: &str) -> Team {
        file.for_host(file.host_named(host).unwrap()).unwrap()
    }

    fn interface(team: &Team, link: usize) -> &str {
        team.links[link].as_ref().unwrap().endpoint.interface().unwrap()
    }

    fn claim(team: &Team, link: usize) -> String {
        team.links[link].as_ref().unwrap().endpoint.claim().what
    }

    #[test]
    fn a_host_sees_its_own_values() {
        let file = read(ADHOC, &[], &[]).unwrap();
        let (first, third) = (team(&file, "robot-0"), team(&file, "robot-2"));
        assert_eq!((first.number, first.seed, first.episodes), (3, 4, 16));
        assert_eq!(first.key_file.as_deref(), Some(Path::new("teams/keys/team.key")), "from the file's folder");
        assert_eq!(third.key_file.as_deref(), Some(Path::new("teams/own.key")));
        assert_eq!((first.policy.as_deref(), third.policy.as_deref()), (None, Some(Path::new("orca"))));
        let buffer = |key: &str| {
            let values = file.values(Some(HostId(0)));
            values.into_iter().find(|shown| shown.key == key).map(|shown| shown.value)
        };
        assert_eq!(interface(&first, 1), "wlan0");
        assert_eq!(buffer("link.infra.receive_buffer_bytes").as_deref(), Some("65536"));
        assert_eq!(claim(&first, 0), "[ff02::4d75]:7700");
        assert_eq!(buffer("link.ad-hoc.receive_buffer_bytes").as_deref(), Some("4194304"));
        assert_eq!(
            first.links[0].as_ref().unwrap().reliability.get(&Kind::Latent),
            Some(&crate::net::protocol::reliability::Reliability::Repeat)
        );
        assert_eq!(interface(&third, 1), "wlan7", "a robot's override is narrower than its host's");
        assert_eq!(claim(&third, 2), "127.0.0.1:3", "where it listens");
        let guest = third.links[2].as_ref().unwrap().for_guest(third.host);
        assert_eq!(guest.endpoint.claim().what, "127.0.0.1:1, 127.0.0.1:2, 127.0.0.1:3, 127.0.0.1:4");
        assert_eq!(file.host_of(RobotId(2)), Ok(HostId(2)));
        assert!(file.host_of(RobotId(3)).is_err() && file.host_named("pc").is_err());
    }

    #[test]
    fn a_host_needs_no_socket_on_a_link_that_it_has_no_part_in() {
        let file = read(ADHOC, &[], &[]).unwrap();
        assert!(team(&file, "world").links[0].is_none(), "the world hears no latents");
        assert!(team(&file, "world").links[1].is_some());
    }

    #[test]
    fn a_flag_counts_before_the_environment_and_that_before_the_file() {
        let variables = [("MURMURATE_SEED", "5"), ("MURMURATE_LINK_INFRA_INTERFACE", "env0"), ("OTHER", "x")];
        let file = read(ADHOC, &variables, &[]).unwrap();
        let third = team(&file, "robot-2");
        assert_eq!((third.seed, interface(&third, 1)), (5, "env0"), "even before a robot's own");
        let flags = [("--set", "seed", "6"), ("--interface", "interface", "flag0"), ("--key-file", "key_file", "k")];
        let file = read(ADHOC, &variables, &flags).unwrap();
        let third = team(&file, "robot-2");
        assert_eq!((third.seed, interface(&third, 0), interface(&third, 1)), (6, "flag0", "flag0"));
        assert_eq!(third.key_file.as_deref(), Some(Path::new("k")), "from where the user is");
        let origin = |key: &str| {
            let values = file.values(Some(HostId(2)));
            values.into_iter().find(|shown| shown.key == key).unwrap_or_else(|| panic!("{key} is shown")).origin
        };
        assert_eq!(origin("seed"), Origin::Flag("--set"));
        assert_eq!(origin("team"), Origin::File(2));
        assert_eq!(origin("policy"), Origin::File(27));
        assert_eq!(origin("episodes"), Origin::Default);
        let file = read(ADHOC, &variables, &[("--set", "link.infra.interface", "set0"), flags[1]]).unwrap();
        assert_eq!(interface(&team(&file, "robot-0"), 1), "set0", "the link's own before that of all");
    }

    #[test]
    fn a_team_without_a_key_stays_on_its_machine() {
        let bare = "team = 1\nmode = \"centralized\"\n[link.infra]\ninterface = \"lo\"\n[link.wires]\n";
        let lo = format!("{bare}interface = \"lo\"");
        let file = read(&lo, &[], &[]).unwrap();
        assert_eq!(team(&file, "pc").key_file, None);
        let error = read(&lo, &[], &[("--interface", "interface", "wlan0")]).unwrap_err();
        assert!(error.starts_with("key_file: missing") && error.contains("'infra'"), "{error}");
        let peers = |pc: &str| {
            format!(
                "{bare}interface = \"lo\"\ntransport = \"unicast\"\npeers = {{ pc = \"{pc}\", world = \"[::1]:2\" }}"
            )
        };
        assert!(read(&peers("[::1]:1"), &[], &[]).is_ok());
        assert!(read(&peers("[fd00::7]:1"), &[], &[]).unwrap_err().starts_with("key_file: missing"));
        assert!(read(&peers("[::1]:2"), &[], &[]).unwrap_err().contains("is where host 'pc' listens"));
        assert!(read(&peers("127.0.0.1:1"), &[], &[]).unwrap_err().contains("families"));
    }

    #[test]
    fn a_team_is_confidential_only_with_a_key_and_only_as_a_whole() {
        let bare = "team = 1\nmode = \"centralized\"\nconfidential = true\n[link.infra]\ninterface = \"lo\"\n\
                    [link.wires]\ninterface = \"lo\"\n";
        let error = read(bare, &[], &[]).unwrap_err();
        assert!(error.starts_with("confidential (line 3): true, and there is no key_file"), "{error}");
        assert!(error.contains("key new"), "{error}");
        let key = [("--key-file", "key_file", "k")];
        let file = read(bare, &[], &key).unwrap();
        assert!(team(&file, "pc").confidential && file.operator_access().unwrap().confidential);
        let file = read(&bare.replace("true", "false"), &[], &[]).unwrap();
        assert!(!team(&file, "pc").confidential && !file.operator_access().unwrap().confidential);
        let file = read(&bare.replace("true", "false"), &[], &[key[0], ("--set", "confidential", "true")]).unwrap();
        assert!(team(&file, "pc").confidential, "by a flag");
        assert!(read(&bare.replace("true", "\"true\""), &[], &key).unwrap_err().contains("true or false"));
        let of_one = format!("{bare}[host.pc]\nconfidential = true\n");
        assert!(read(&of_one, &[], &key).unwrap_err().starts_with("host.pc.confidential"));
    }

    #[test]
    fn a_deployment_may_be_written_out() {
        let inline = |deployment: &Deployment, head: &str| {
            let table = std::collections::BTreeMap::from([("deployment", deployment)]);
            let links = "[link.infra]\ninterface = \"lo\"\n[link.wires]\ninterface = \"lo\"\n";
            read(&format!("team = 1\n{head}\n{}{links}", toml::to_string(&table).unwrap()), &[], &[])
        };
        let preset = Deployment::preset("onboard-infra", 3).unwrap();
        assert_eq!(inline(&preset, "").unwrap().deployment(), &preset);
        assert!(inline(&preset, "robots = 3").is_ok());
        assert!(inline(&preset, "robots = 4").unwrap_err().starts_with("robots (line 2): 4, but"));
        assert!(inline(&preset, "mode = \"sim\"").unwrap_err().starts_with("mode (line 2): there is a [deployment]"));
        let wrong = |change: fn(&mut Deployment)| {
            let mut deployment = preset.clone();
            change(&mut deployment);
            inline(&deployment, "").unwrap_err()
        };
        let twice = wrong(|deployment| deployment.hosts[1].agents = vec![vec![0]]);
        assert!(twice.contains("deployment.host.agents: robot 0 has a second agent on host 'robot-1'"), "{twice}");
        let twins = wrong(|deployment| deployment.hosts[1].name = "robot-0".to_owned());
        assert!(twins.contains("deployment.host.name: 'robot-0'"), "{twins}");
        assert!(wrong(|deployment| deployment.links[0].delay_s = 0.1).contains("'infra'"));
        assert!(wrong(|deployment| deployment.hosts[0].name = "a.b".to_owned()).contains("dot"));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let error = |from: &str, to: &str| {
            assert!(ADHOC.contains(from), "{from}");
            read(&ADHOC.replacen(from, to, 1), &[], &[]).unwrap_err()
        };
        let cases = [
            ("team = 3", "teem = 3", "teem (line 2): there is no such field; there are team, key_file, confidential"),
            ("team = 3\n", "\n", "team: missing"),
            ("team = 3", "team = 65536", "team (line 2): '65536'"),
            ("team = 3", "team = \"3\"", "team (line 2): a string where a whole number belongs"),
            ("team = 3", "team = 3\nteam = 3", "line 3"),
            ("seed = 4", "seed = -4", "seed (line 6): '-4'"),
            ("seed = 4", "lag_s = 11", "lag_s (line 6): '11'"),
            ("seed = 4", "lag_s = nan", "lag_s (line 6): 'nan'"),
            ("seed = 4", "wall_radius_m = 0", "wall_radius_m (line 6)"),
            ("seed = 4", "clamp = \"none\"", "clamp (line 6): 'none' is not one of training, deployed"),
            ("seed = 4", "scenario = \"maze\"", "scenario (line 6): "),
            ("mode = \"onboard-adhoc\"\n", "", "mode: missing"),
            ("robots = 3", "robots = 20", "scenario: "),
            ("onboard-adhoc", "telepathy", "mode (line 4): 'telepathy' is not one of"),
            ("interface = \"wlan1\"\n", "", "link.ad-hoc.interface: missing"),
            (
                "interface = \"wlan1\"",
                "interfase = \"wlan1\"",
                "link.ad-hoc.interfase (line 9): there is no such field",
            ),
            ("interface = \"wlan1\"", "interface = \"wlan 1\"", "link.ad-hoc.interface (line 9): "),
            ("interface = \"wlan1\"", "interface = \"lo\"", "link.ad-hoc.group (line 10): an IPv6 group never"),
            ("239.255.77.1:7700", "239.255.77.1", "link.infra.group (line 15): "),
            ("239.255.77.1:7700", "239.255.77.1:0", "link.infra.group (line 15): "),
            ("239.255.77.1:7700", "10.0.0.1:7700", "link.infra.group (line 15): 10.0.0.1 is no multicast"),
            ("latent = \"repeat\"", "latent = \"hope\"", "link.ad-hoc.reliability.latent (line 11): 'hope'"),
            ("latent = \"repeat\"", "mode = \"repeat\"", "link.ad-hoc.reliability.mode (line 11): link 'ad-hoc' does"),
            ("65536", "1", "link.infra.receive_buffer_bytes (line 16)"),
            ("\"unicast\"", "\"pigeon\"", "link.wires.transport (line 19)"),
            ("robot-1 = \"127.0.0.1:2\", ", "", "link.wires.peers.robot-1: missing"),
            (
                "peers = {",
                "group = \"239.1.1.1:7\"\npeers = {",
                "link.wires.group (line 21): transport 'unicast' has no",
            ),
            ("65536", "65536\npeers.world = \"10.0.0.1:1\"", "link.infra.peers.world (line 17): transport 'multicast'"),
            ("robot-1 = \"127", "robot-9 = \"127", "link.wires.peers.robot-9 (line 21): there is no host 'robot-9'"),
            ("[robot.2.link", "[robot.3.link", "robot.3.link.infra.interface (line 24): there is no robot '3'"),
            ("[robot.2.link", "[robot.02.link", "robot.02.link.infra.interface (line 24): there is no robot '02'"),
            ("[host.robot-2]", "[host.pc]", "host.pc"),
            ("policy = \"orca\"", "episodes = 2", "host.robot-2.episodes (line 27): there is no such field"),
            ("[link.infra]", "[link.infra2]", "link.infra2"),
            ("[link.infra]", "[link.\"in.fra\"]", "link.in.fra (line 13): a name"),
        ];
        for (from, to, start) in cases {
            let error = error(from, to);
            assert!(error.starts_with(start) && !error.contains('\n'), "{to}: {error}");
        }
        let flag = |flag: (&'static str, &str, &str)| read(ADHOC, &[], &[flag]).unwrap_err();
        assert!(flag(("--set", "sed", "1")).starts_with("sed (--set): there is no such field"));
        assert!(flag(("--set", "seed", "x")).starts_with("seed (--set): 'x'"));
        assert!(flag(("--interface", "interface", "")).starts_with("--interface: ''"));
        let variable = |name: &str| read(ADHOC, &[(name, "x")], &[]).unwrap_err();
        assert!(variable("MURMURATE_SED").starts_with("MURMURATE_SED: no such variable"));
        assert!(variable("MURMURATE_SEED").starts_with("seed (MURMURATE_SEED): 'x'"));
        assert!(read(ADHOC, &[("MURMURATE_LOG", "info")], &[]).is_ok());
    }

    #[test]
    fn a_flag_may_choose_another_transport_than_the_file_has_fields_of() {
        let peers = ["robot-0", "robot-1", "robot-2", "world"].map(|host| format!("link.infra.peers.{host}"));
        let addresses = ["127.0.0.1:11", "127.0.0.1:12", "127.0.0.1:13", "127.0.0.1:14"];
        let mut flags = vec![("--set", "link.infra.transport", "unicast")];
        flags.extend(peers.iter().zip(addresses).map(|(peer, address)| ("--set", peer.as_str(), address)));
        read(ADHOC, &[], &flags).expect("the file's group has no effect");
        flags.push(("--set", "link.infra.group", "239.1.1.1:7"));
        let error = read(ADHOC, &[], &flags).unwrap_err();
        assert!(error.starts_with("link.infra.group (--set): transport 'unicast' has no"), "{error}");
    }

    #[test]
    fn two_links_do_not_share_a_group() {
        let text = "team = 1\nmode = \"centralized\"\n[link.infra]\ninterface = \"lo\"\ngroup = \"239.1.1.1:7\"\n\
                    [link.wires]\ninterface = \"lo\"\ngroup = \"239.1.1.1:7\"\n";
        let error = read(text, &[], &[]).unwrap_err();
        assert!(error.starts_with("link.wires.group (line 8): 239.1.1.1:7 is link 'infra' already"), "{error}");
        assert!(read(&text.replace("group = \"239.1.1.1:7\"\n", ""), &[], &[]).is_ok(), "by default they do not");
        let robot = format!("{text}[robot.0]\npolicy = \"orca\"\n").replace("1.1:7\"\n[link.w", "1.2:7\"\n[link.w");
        assert!(read(&robot, &[], &[]).unwrap_err().contains("host 'pc' runs more robots than this"));
    }
}
