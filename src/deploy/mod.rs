//! Deployments: hosts with the actors that each runs, and links with the kinds of messages that each carries. The modes
//! of the paper are presets of this data. No other module refers to a mode or link by name.
//!
//! Deployments are read from and written as TOML. `presets` has the paper's modes, `routes` the route of every message.

mod bodies;
pub mod conditions;
mod judging;
mod links;
mod presets;
mod rates;
mod roles;
mod routes;
mod senses;
mod size;
pub mod team;
mod ticks;

pub use presets::MODES;
pub use roles::{Role, Roles, roles_of};
pub use routes::Routes;
pub use senses::{check_name, senses_of};

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::chassis;
use crate::config::{self, ConfigError};
use crate::edge::Settings;
use crate::faults::Targets;
use crate::messages::ids::RobotId;
use crate::messages::wire::{KINDS, Kind};
use crate::net::media::radio::{Radio, Topology};
use crate::net::protocol::reliability::Reliabilities;
use crate::safety::Switch;
use crate::senses::Settings as SenseSettings;
use crate::world::{self, Placement};

/// Rule for the times, within the control period, at which Agents run their policies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stepping {
    /// All Agents run at the same time, halfway between two steps of the World, as in training.
    Lockstep,
    /// Each Agent runs with an offset of its own within the period, which the deployment sets or which is drawn from
    /// the seed.
    Seeded,
}

/// Host of a team: a process, with the actors that run in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Host {
    /// Name of the host, by which team files and logs refer to it.
    pub name: String,
    /// Agents (actors that run the policy) of this host, each given by the ids of its robots. The Caches and
    /// Controllers of these robots also run on this host.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub agents: Vec<Vec<u16>>,
    /// Ids of the robots that the World of this host moves; empty for none. Their Bodies and Localizers also run on
    /// this host.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub simulates: Vec<u16>,
    /// Ids of the real robots whose motors this host drives. Their Bodies run on this host.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub actuates: Vec<u16>,
    /// Ids of the real robots whose poses this host measures.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub localizes: Vec<u16>,
    /// Settings of the driver that moves the robots in `actuates`; `None` if that is empty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub driver: Option<Settings>,
    /// Settings of the source of readings of the robots in `localizes`; `None` if that is empty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<Settings>,
    /// Settings with which the host publishes received messages for other programs, such as ROS tools; `None` if it
    /// publishes none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub observe: Option<Settings>,
    /// Whether this host runs the team's state server.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub state_server: bool,
    /// For each agent, in the order of `agents`: time of its ticks within their period \[s\]. Used only with
    /// `Stepping::Seeded`. If empty, the times are drawn from the seed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tick_offsets_s: Vec<f64>,
}

/// Medium of a link: cable, loopback or kind of radio. It determines which effects are simulated on the link; the
/// sockets of real hosts are set in the team file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkMedium {
    /// Radio through an access point (infrastructure mode).
    #[default]
    AccessPoint,
    /// Radio between robots, without an access point (ad hoc mode).
    AdHoc,
    /// Cable, such as to a simulated World: no delay, loss or radio is ever emulated on it.
    Cable,
    /// Loopback interface between processes of one machine: delay and loss can be emulated on it, a radio cannot.
    Loopback,
}

impl LinkMedium {
    /// Returns the topology of the medium's radio channel; `None` if the medium is not a radio.
    pub fn topology(self) -> Option<Topology> {
        match self {
            LinkMedium::AccessPoint => Some(Topology::Infrastructure),
            LinkMedium::AdHoc => Some(Topology::AdHoc),
            LinkMedium::Cable | LinkMedium::Loopback => None,
        }
    }
}

/// Link between hosts, with its kinds of messages and its emulated properties.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Link {
    /// Name of the link, by which team files and fault plans refer to it.
    pub name: String,
    /// Medium of the link, such as an access point or a cable.
    #[serde(default)]
    pub medium: LinkMedium,
    /// Kinds of messages that the link carries. A kind is carried by at most one link of a deployment.
    pub carries: Vec<Kind>,
    /// Emulated delay of frames of the kinds in `impairs` \[s\].
    #[serde(default)]
    pub delay_s: f64,
    /// Probability that a receiver loses a frame of the kinds in `impairs`, 0 to 1.
    #[serde(default)]
    pub loss: f64,
    /// Kinds of messages to which `delay_s` and `loss` apply.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub impairs: Vec<Kind>,
    /// Reliability mode of each kind of message on the link; kinds that are not listed are best effort.
    #[serde(default, skip_serializing_if = "Reliabilities::is_empty")]
    pub reliability: Reliabilities,
    /// Transmission range of a robot's frames under emulation \[m\]; `None` for unlimited. A link with a radio uses the
    /// radio's range instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) range_m: Option<f32>,
    /// Radio channel that the link's frames share under emulation; `None` for a link without contention.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radio: Option<Radio>,
    /// Whether not all hosts hear each other on the link, so that they say emergency stops on, whichever link carries
    /// these.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub mesh: bool,
    /// Whether the emulated link chooses how it sends by what it measures, as a link with `transport = "auto"` does.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub auto: bool,
}

/// Configuration of a team: hosts with their actors, and links with their kinds of messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deployment {
    /// Name of the deployment's mode in reports, such as `offboard`.
    pub mode: String,
    /// Number of robots in the team.
    pub robots: usize,
    /// Whether robots are placed exactly at their starts before an episode, or drive there.
    pub placement: Placement,
    /// Rule for the times, within the control period, at which the team's Agents run their policies.
    pub stepping: Stepping,
    /// Name of the plant that moves the simulated robots.
    #[serde(default = "kinematic")]
    pub plant: String,
    /// Width of the bottleneck of the team's scenario \[m\]; `None` for the scenario's default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) gap_m: Option<f32>,
    /// Factor on the lengths of the team's scenario; `None` for 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f32>,
    /// Radius of the hull of all robots \[m\]; `None` for that of the paper's robots, 0.16 m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hull_m: Option<f32>,
    /// Rate at which a robot broadcasts latents \[Hz\], on average and at most once in a control step; `None` for one
    /// in every step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latent_rate_hz: Option<f64>,
    /// Whether readings of every robot go to all hosts with Agents, which hold what the robot says of itself against
    /// them and avoid it where it is measured. Of a robot that the host of its own Agent measures they do not.
    #[serde(default = "off", skip_serializing_if = "is_off")]
    pub witness: Switch,
    /// Chassis and hardware limits of all robots, unless `bodies` overrides them.
    #[serde(default, skip_serializing_if = "chassis::Settings::is_empty")]
    pub body: chassis::Settings,
    /// Chassis and hardware limits of single robots that differ from `body`, by robot id.
    #[serde(default, skip_serializing_if = "chassis::ByRobot::is_empty")]
    pub bodies: chassis::ByRobot,
    /// Senses of all robots, by their names; empty for robots that perceive nothing of their surroundings.
    #[serde(default, skip_serializing_if = "Senses::is_empty")]
    pub senses: Senses,
    /// Roles of robots that have a policy, a radius, a drive or senses of their own, by their names.
    #[serde(default, skip_serializing_if = "Roles::is_empty")]
    pub roles: Roles,
    /// Hosts of the team; the index of a host is its id.
    #[serde(rename = "host")]
    pub hosts: Vec<Host>,
    /// Links between the hosts; the index of a link is its id.
    #[serde(default, rename = "link", skip_serializing_if = "Vec::is_empty")]
    pub links: Vec<Link>,
}

/// Settings of the senses of a team's robots, by the names of the senses.
pub type Senses = BTreeMap<String, SenseSettings>;

fn off() -> Switch {
    Switch::Off
}

fn is_off(switch: &Switch) -> bool {
    *switch == Switch::Off
}

fn kinematic() -> String {
    world::KINEMATIC.to_owned()
}

/// Largest number of hosts of a deployment, and of its links. Their ids have 16 bits.
const MAX_NAMES: usize = 10_000;

/// Error when links are given a delay, loss or range.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImpairError {
    /// No message would be affected, because no message of the kinds in question crosses a link.
    #[error("nothing to act on in mode '{mode}': no {kinds} message crosses a link there")]
    NothingCrosses {
        /// Name of the deployment's mode.
        mode: String,
        /// Word for the kinds of messages to be impaired, for the error text.
        kinds: &'static str,
    },
    /// A delay, probability or range is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// Selection of the messages that emulated delay and loss apply to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Impair {
    /// Delay and loss apply to latents, the messages between robots.
    Latent,
    /// Delay and loss apply to all messages on every link except cables.
    All,
}

impl Deployment {
    /// Reads and checks a deployment from TOML. An error names the line or the field.
    pub fn from_toml(text: &str) -> Result<Deployment, ConfigError> {
        let deployment: Deployment = config::from_toml(text)?;
        deployment.check()?;
        Ok(deployment)
    }

    /// Writes the deployment as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a deployment is TOML")
    }

    /// Checks that every robot has one Agent, one Body and one source of readings, that every message has a route, and
    /// that all settings are valid. An error names the field. The plant's name is not checked.
    pub fn check(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        if self.robots == 0 || self.robots > usize::from(u16::MAX) {
            return wrong("robots", format!("{} is not 1 to {}", self.robots, u16::MAX));
        }
        self.check_names()?;
        let agents = |host: &Host| host.agents.concat();
        self.once("host.agents", agents, "agent")?;
        let bodies = |host: &Host| [&host.simulates[..], &host.actuates].concat();
        self.once("host.simulates and host.actuates", bodies, "body")?;
        let measured = |host: &Host| [&host.simulates[..], &host.localizes].concat();
        self.once("host.simulates and host.localizes", measured, "measurement")?;
        if let Some(host) = self.hosts.iter().find(|host| host.agents.iter().any(|robots| robots.is_empty())) {
            return wrong("host.agents", format!("host '{}' has an agent without robots", host.name));
        }
        self.hosts.iter().try_for_each(Host::check_devices)?;
        self.hosts.iter().try_for_each(Host::check_offsets)?;
        self.check_bodies()?;
        self.check_placement()?;
        let servers = self.hosts.iter().filter(|host| host.state_server).count();
        if servers != 1 {
            return wrong("host.state_server", format!("{servers} hosts run a state server; exactly one must"));
        }
        self.check_latent_rate()?;
        self.check_witness()?;
        self.check_roles()?;
        self.check_senses()?;
        self.links.iter().try_for_each(Link::check)?;
        self.links.iter().try_for_each(Link::check_radio)?;
        self.check_ways()
    }

    /// Checks that names of hosts and links are unique and not empty.
    fn check_names(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        for (field, names) in [
            ("host", self.hosts.iter().map(|host| &host.name).collect::<Vec<_>>()),
            ("link", self.links.iter().map(|link| &link.name).collect()),
        ] {
            if names.len() > MAX_NAMES {
                return wrong(field, format!("{} of them; the limit is {MAX_NAMES}", names.len()));
            }
            let mut unique = BTreeSet::new();
            if let Some(name) = names.iter().find(|name| name.is_empty() || !unique.insert(**name)) {
                let why = format!("'{name}' is there twice, or empty; every {field} needs a name of its own");
                return wrong(&format!("{field}.name"), why);
            }
        }
        Ok(())
    }

    /// Checks that every kind of message that must cross hosts is carried by exactly one link.
    fn check_ways(&self) -> Result<(), ConfigError> {
        let wrong = |reason: String| Err(ConfigError::field("link.carries", reason));
        let routes = Routes::of(self);
        for kind in KINDS {
            if kind.follows_the_stop() {
                if let Some(link) = self.links.iter().find(|link| link.carries.contains(&kind)) {
                    let why = format!("'{}' carries {kind:?}: leave it out, it goes where 'stop' goes", link.name);
                    return wrong(why);
                }
                continue;
            }
            let carriers = self.links.iter().flat_map(|link| &link.carries).filter(|carried| **carried == kind).count();
            if carriers > 1 {
                return wrong(format!("{kind:?} is carried {carriers} times; it may be carried once"));
            }
            if carriers == 0 && routes.crosses(kind) {
                let judge = self.needed_by_judge(kind);
                return wrong(format!("{kind:?} must cross hosts, and no link carries it{judge}"));
            }
        }
        Ok(())
    }

    fn once(&self, field: &str, robots: impl Fn(&Host) -> Vec<u16>, what: &str) -> Result<(), ConfigError> {
        let mut seen = BTreeSet::new();
        for host in &self.hosts {
            for robot in robots(host) {
                let reason = if usize::from(robot) >= self.robots {
                    format!("host '{}' names robot {robot}; the team has {}", host.name, self.robots)
                } else if !seen.insert(robot) {
                    format!("robot {robot} has a second {what} on host '{}'", host.name)
                } else {
                    continue;
                };
                return Err(ConfigError::field(field, reason));
            }
        }
        match RobotId::team(self.robots).find(|robot| !seen.contains(&robot.0)) {
            None => Ok(()),
            Some(robot) => Err(ConfigError::field(field, format!("{robot} has no {what} on any host"))),
        }
    }

    /// Returns the robots, hosts and links of the deployment into which a fault plan can inject faults.
    pub fn targets(&self) -> Targets<'_> {
        let links = self.links.iter().map(|link| (link.name.as_str(), link.carries.as_slice())).collect();
        Targets { robots: self.robots, hosts: self.hosts.len(), flying: self.flying(), links }
    }

    /// Returns the deployment with the emulated channel `radio` on every link whose medium is a radio; each link has a
    /// channel of its own, as far as its topology allows ([`Radio::on`]).
    pub fn with_radio(mut self, radio: &Radio) -> Deployment {
        for link in &mut self.links {
            link.radio = link.medium.topology().map(|channel| radio.on(channel)).or(link.radio.take());
        }
        self
    }

    /// Limits the transmission range of every link that carries latents to `range_m` \[m\]. Fails if no latent crosses
    /// a link, or if the range is invalid.
    pub fn ranged(mut self, range_m: f32) -> Result<Deployment, ImpairError> {
        let crosses = Routes::of(&self).crosses(Kind::Latent);
        let links = self.links.iter_mut().filter(|link| crosses && link.carries.contains(&Kind::Latent));
        if links.map(|link| link.range_m = Some(range_m)).count() == 0 {
            return Err(ImpairError::NothingCrosses { mode: self.mode, kinds: "latent" });
        }
        self.check()?;
        Ok(self)
    }

    /// Sets delay \[s\] and loss (0 to 1) of all links that carry messages of the kinds in `impair`, except cables.
    /// `None` leaves a value unchanged. Fails if no such message crosses a link, or if a value is out of range.
    pub fn impaired(
        mut self,
        delay_s: Option<f64>,
        loss: Option<f64>,
        impair: Impair,
    ) -> Result<Deployment, ImpairError> {
        let (kinds, what) = match impair {
            Impair::Latent => (&[Kind::Latent][..], "latent"),
            Impair::All => (&KINDS[..], "impaired"),
        };
        let mut any_impaired = false;
        let routes = Routes::of(&self);
        let crosses: Vec<Kind> = kinds.iter().copied().filter(|&kind| routes.crosses(kind)).collect();
        for link in self.links.iter_mut().filter(|link| link.medium != LinkMedium::Cable) {
            let affected: Vec<Kind> = link.carries.iter().copied().filter(|kind| crosses.contains(kind)).collect();
            if !affected.is_empty() {
                link.delay_s = delay_s.unwrap_or(link.delay_s);
                link.loss = loss.unwrap_or(link.loss);
                link.impairs = affected;
                any_impaired = true;
            }
        }
        if !any_impaired {
            return Err(ImpairError::NothingCrosses { mode: self.mode, kinds: what });
        }
        self.check()?;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::ids::HostId;

    #[test]
    fn every_preset_is_sound_and_survives_toml() {
        for mode in MODES {
            let preset = Deployment::preset(mode, 5).unwrap();
            assert_eq!(preset.check(), Ok(()), "{mode}");
            assert_eq!(Deployment::from_toml(&preset.to_toml()), Ok(preset), "{mode}");
        }
    }

    #[test]
    fn what_crosses_a_link_is_what_the_design_says() {
        let crossing = |mode: &str| -> Vec<Kind> {
            let preset = Deployment::preset(mode, 3).unwrap();
            let said = KINDS.into_iter().filter(|kind| !kind.follows_the_stop());
            said.filter(|&kind| Routes::of(&preset).crosses(kind)).collect()
        };
        assert_eq!(crossing("sim"), []);
        assert_eq!(crossing("centralized"), [Kind::Reading, Kind::MotorCommand, Kind::Mode, Kind::Stop]);
        for mode in ["offboard", "onboard-infra", "onboard-adhoc"] {
            assert_eq!(crossing(mode), KINDS[..6], "{mode}");
        }
    }

    #[test]
    fn a_broken_deployment_is_refused_by_its_field() {
        let error = |change: fn(&mut Deployment)| {
            let mut deployment = Deployment::preset("onboard-adhoc", 3).unwrap();
            change(&mut deployment);
            deployment.check().unwrap_err().to_string()
        };
        assert!(error(|d| d.robots = 0).starts_with("robots"));
        assert!(error(|d| d.robots = 4).starts_with("host.agents: robot 3 has no agent"));
        assert!(error(|d| d.hosts[0].agents[0][0] = 1).starts_with("host.agents: robot 1 has a second agent"));
        assert!(error(|d| d.hosts[0].state_server = true).starts_with("host.state_server"));
        assert!(error(|d| d.links[0].carries.clear()).starts_with("link.carries: Latent must cross"));
        assert!(
            error(|d| d.links[1].carries.push(Kind::Latent)).starts_with("link.carries: Latent is carried 2 times")
        );
        assert!(error(|d| d.links[0].range_m = Some(-1.0)).starts_with("link.range_m"));
        assert!(error(|d| d.links[0].range_m = Some(f32::INFINITY)).starts_with("link.range_m"));
        assert!(error(|d| d.links[0].loss = 2.0).starts_with("link.loss"));
        assert!(error(|d| d.hosts[1].name.clear()).starts_with("host.name"));
        assert!(error(|d| d.links[1].carries.push(Kind::Status)).contains("goes where 'stop' goes"));
        assert!(error(|d| d.links[0].impairs.push(Kind::Mode)).starts_with("link.impairs"));
        assert!(error(|d| d.links[1].mesh = true).starts_with("link.mesh: 'infra' is no link"));
    }

    #[test]
    fn readings_go_to_all_agents_only_with_a_witness_and_only_of_robots_that_another_host_measures() {
        let mut deployment = Deployment::preset("onboard-infra", 3).unwrap();
        let readers = |deployment: &Deployment, robot: u16| -> Vec<u16> {
            let routes = Routes::of(deployment);
            (0..4).filter(|host| routes.router(HostId(*host)).route(Kind::Reading, RobotId(robot)).local).collect()
        };
        assert_eq!(readers(&deployment, 1), [1]);
        assert!(!deployment.to_toml().contains("witness"));
        deployment.witness = Switch::On;
        assert_eq!((deployment.check(), readers(&deployment, 1)), (Ok(()), vec![0, 1, 2]));
        assert_eq!(Deployment::from_toml(&deployment.to_toml()), Ok(deployment.clone()));
        deployment.hosts[3].simulates = vec![0, 2];
        deployment.hosts[1].simulates = vec![1];
        // The World of the others needs its readings, and so does the judge.
        assert_eq!(readers(&deployment, 1), [1, 3], "a host is no witness of a robot that it measures itself");
        assert_eq!(readers(&deployment, 2), [0, 1, 2, 3]);
        let mut alone = Deployment::preset("sim", 3).unwrap();
        alone.witness = Switch::On;
        assert!(alone.check().unwrap_err().to_string().starts_with("witness: no robot is measured"));
    }

    #[test]
    fn an_impairment_needs_something_to_act_on() {
        let impaired =
            |mode: &str, impair| Deployment::preset(mode, 3).unwrap().impaired(Some(0.02), Some(0.1), impair);
        assert!(impaired("sim", Impair::All).is_err());
        assert!(impaired("centralized", Impair::Latent).is_err());
        assert!(impaired("centralized", Impair::All).is_ok());
        let adhoc = impaired("onboard-adhoc", Impair::All).unwrap();
        let cable = adhoc.links.iter().find(|link| link.medium == LinkMedium::Cable).unwrap();
        assert!(cable.impairs.is_empty(), "cables are never impaired");
        let mut renamed = Deployment::preset("onboard-adhoc", 3).unwrap();
        renamed.links.iter_mut().zip(["wires", "loopback", "ad-hoc"]).for_each(|(link, name)| link.name = name.into());
        let renamed = renamed.impaired(Some(0.02), Some(0.1), Impair::All).unwrap();
        let what =
            |deployment: &Deployment| deployment.links.iter().map(|link| link.impairs.clone()).collect::<Vec<_>>();
        assert_eq!(what(&renamed), what(&adhoc), "names mean nothing");
        let ranges = |mode: &str| -> Vec<Option<f32>> {
            let ranged = Deployment::preset(mode, 3).unwrap().ranged(4.5).unwrap();
            ranged.links.iter().map(|link| link.range_m).collect()
        };
        assert_eq!(ranges("onboard-adhoc"), [Some(4.5), None, None]);
        assert!(Deployment::preset("sim", 3).unwrap().ranged(4.5).is_err());
    }
}
