//! Fault plans as TOML.
//!
//! ```toml
//! [[actor]]
//! actor = "controller"     # cache, agent, controller, body, world, state-server, network
//! robot = 2                # robot of the actor; for an agent, a robot whose policy it runs; state-server has none
//! fault = "crash"          # crash, stall, mute, slow; for the body of a robot that flies: flat (battery)
//! at_s = 3.0               # start, from the start of the trial, or from the start of:
//! episode = 5              # an episode, counted from 0; may be left out
//! for_s = 1.5              # duration
//!
//! [[link]]
//! link = "ad-hoc"
//! fault = "drop"           # drop, delay, duplicate, reorder, corrupt, partition, misplace
//! share = 0.5              # fraction of the frames that are affected
//! from_s = 2.0             # times as at_s
//! until_s = 6.0
//! ```

use serde::{Deserialize, Serialize};

use crate::config::{self, ConfigError};
use crate::faults::{ActorFault, ActorFaultKind, FaultPlan, LinkFault, LinkFaultKind, Role};
use crate::messages::geometry::{Planar, Vec2, is_sound};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// Latest time that a fault plan may contain \[s\]. `LONGEST_DELAY_S` is its longest additional delay \[s\].
const LATEST_S: f64 = 1e6;
const LONGEST_DELAY_S: f64 = 10.0;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlanFile {
    #[serde(default)]
    actor: Vec<ActorEntry>,
    #[serde(default)]
    link: Vec<LinkEntry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ActorEntry {
    actor: Role,
    #[serde(default)]
    robot: u16,
    fault: ActorFaultKind,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    episode: Option<u32>,
    at_s: f64,
    for_s: f64,
    #[serde(default)]
    by_s: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LinkEntry {
    link: String,
    fault: LinkFaultKind,
    #[serde(default)]
    kinds: Vec<Kind>,
    #[serde(default)]
    hosts: Vec<u16>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    off_m: Option<[f32; 2]>,
    #[serde(default = "all_frames")]
    share: f64,
    #[serde(default)]
    by_s: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    episode: Option<u32>,
    from_s: f64,
    until_s: f64,
}

fn all_frames() -> f64 {
    1.0
}

impl FaultPlan {
    /// Reads a fault plan from TOML. An error names the wrong field. Whether the team has the robots, hosts and links
    /// of the plan is checked by `check`, not here.
    pub fn from_toml(text: &str) -> Result<FaultPlan, ConfigError> {
        let file: PlanFile = config::from_toml(text)?;
        let actors = file.actor.into_iter().enumerate().map(|(i, entry)| entry.checked(i));
        let links = file.link.into_iter().enumerate().map(|(i, entry)| entry.checked(i));
        Ok(FaultPlan { actors: actors.collect::<Result<_, _>>()?, links: links.collect::<Result<_, _>>()? })
    }

    /// Returns the plan as TOML text that `from_toml` can read.
    pub fn to_toml(&self) -> String {
        let actor = |fault: &ActorFault| ActorEntry {
            actor: fault.role,
            robot: fault.robot.0,
            fault: fault.kind,
            episode: fault.episode,
            at_s: fault.at.as_secs(),
            for_s: fault.lasts.as_secs(),
            by_s: fault.by.as_secs(),
        };
        let link = |fault: &LinkFault| LinkEntry {
            link: fault.link.clone(),
            fault: fault.kind,
            kinds: fault.kinds.clone(),
            hosts: fault.hosts.iter().map(|host| host.0).collect(),
            off_m: (fault.kind == LinkFaultKind::Misplace).then(|| fault.off_m.to_array()),
            share: fault.share,
            by_s: fault.by.as_secs(),
            episode: fault.episode,
            from_s: fault.from.as_secs(),
            until_s: fault.until.as_secs().min(LATEST_S),
        };
        let actors = self.actors.iter().map(actor).collect();
        let file = PlanFile { actor: actors, link: self.links.iter().map(link).collect() };
        toml::to_string(&file).expect("a plan is TOML")
    }
}

fn seconds(field: String, value: f64) -> Result<Span, ConfigError> {
    duration(field, value, LATEST_S)
}

fn duration(field: String, value: f64, most_s: f64) -> Result<Span, ConfigError> {
    if (0.0..=most_s).contains(&value) {
        return Ok(Span::from_secs(value));
    }
    Err(ConfigError::field(field, format!("{value} is not a time of 0 to {most_s} s")))
}

impl ActorEntry {
    fn checked(self, index: usize) -> Result<ActorFault, ConfigError> {
        let field = |name: &str| format!("actor[{index}].{name}");
        if self.fault == ActorFaultKind::Slow && self.by_s <= 0.0 {
            let reason = "a slow actor needs a delay; give seconds above 0".to_owned();
            return Err(ConfigError::field(field("by_s"), reason));
        }
        if self.fault == ActorFaultKind::Flat && self.actor != Role::Body {
            let reason = "only a body has a battery; write actor = \"body\"".to_owned();
            return Err(ConfigError::field(field("actor"), reason));
        }
        Ok(ActorFault {
            role: self.actor,
            robot: RobotId(self.robot),
            kind: self.fault,
            at: Time::ZERO + seconds(field("at_s"), self.at_s)?,
            lasts: seconds(field("for_s"), self.for_s)?,
            by: duration(field("by_s"), self.by_s, LONGEST_DELAY_S)?,
            episode: self.episode,
        })
    }
}

impl LinkEntry {
    fn checked(self, index: usize) -> Result<LinkFault, ConfigError> {
        let field = |name: &str| format!("link[{index}].{name}");
        if !(0.0..=1.0).contains(&self.share) {
            let reason = format!("{} is not a share of 0 to 1", self.share);
            return Err(ConfigError::field(field("share"), reason));
        }
        if self.fault == LinkFaultKind::Partition && self.hosts.is_empty() {
            let reason = "a partition needs the hosts on one side of it".to_owned();
            return Err(ConfigError::field(field("hosts"), reason));
        }
        if matches!(self.fault, LinkFaultKind::Delay | LinkFaultKind::Reorder) && self.by_s <= 0.0 {
            let reason = "delayed or reordered frames need a delay; give seconds above 0".to_owned();
            return Err(ConfigError::field(field("by_s"), reason));
        }
        let off_m = Vec2::from(self.off_m.unwrap_or_default());
        if self.fault == LinkFaultKind::Misplace && (!is_sound(off_m) || off_m == Vec2::zeros()) {
            let reason = "misplaced latents need a distance along x and y; give metres, such as [2.0, 0.0]".to_owned();
            return Err(ConfigError::field(field("off_m"), reason));
        }
        let (from, until) = (seconds(field("from_s"), self.from_s)?, seconds(field("until_s"), self.until_s)?);
        if until <= from {
            let reason = "the fault ends before it begins".to_owned();
            return Err(ConfigError::field(field("until_s"), reason));
        }
        Ok(LinkFault {
            link: self.link,
            kind: self.fault,
            kinds: self.kinds,
            hosts: self.hosts.into_iter().map(HostId).collect(),
            off_m,
            share: self.share,
            by: duration(field("by_s"), self.by_s, LONGEST_DELAY_S)?,
            from: Time::ZERO + from,
            until: Time::ZERO + until,
            episode: self.episode,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::Targets;

    fn targets() -> Targets<'static> {
        Targets { robots: 5, hosts: 2, flying: vec![RobotId(3)], links: vec![("infra", &[Kind::Mode])] }
    }

    #[test]
    fn a_fault_can_be_timed_from_an_episode() {
        let text = "[[actor]]\nactor = \"cache\"\nrobot = 2\nfault = \"crash\"\nepisode = 5\nat_s = 2.0\nfor_s = 1.0\n";
        let plan = FaultPlan::from_toml(text).unwrap();
        assert_eq!(plan.actors[0].episode, Some(5));
        assert_eq!(FaultPlan::from_toml(&plan.to_toml()).unwrap(), plan);
        assert_eq!(plan.describe(), ["cache of robot 2: crash 2.0 s into episode 6, for 1.0 s"]);
        assert!(plan.check_episodes(6).is_ok());
        assert!(plan.check_episodes(5).unwrap_err().to_string().contains("actor[0].episode"));
    }

    #[test]
    fn a_plan_with_liars_survives_toml() {
        let text = "[[link]]\nlink = \"infra\"\nfault = \"misplace\"\nhosts = [1]\noff_m = [2.0, -0.5]\nfrom_s = 0.0\n\
                    until_s = 9.0\n";
        let plan = FaultPlan::from_toml(text).unwrap();
        assert_eq!((plan.links[0].off_m, &plan.links[0].hosts[..]), (Vec2::new(2.0, -0.5), &[HostId(1)][..]));
        assert_eq!(FaultPlan::from_toml(&plan.to_toml()).unwrap(), plan);
    }

    #[test]
    fn an_error_in_a_plan_names_its_field() {
        let read = |text: &str| FaultPlan::from_toml(text).and_then(|plan| plan.check(&targets()).map(|()| plan));
        let error = |text: &str| read(text).unwrap_err().to_string();
        let actor = "[[actor]]\nactor = \"cache\"\nfault = \"crash\"\nat_s = 1.0\nfor_s = 1.0\n";
        assert!(read(actor).is_ok());
        assert!(error(&format!("{actor}robot = 9\n")).contains("actor[0].robot"));
        assert!(read(&format!("{}robot = 9\n", actor.replace("cache", "state-server"))).is_ok(), "it is of no robot");
        assert!(error(&format!("{actor}color = 9\n")).contains("color"));
        assert!(error(&actor.replace("1.0", "-1.0")).contains("actor[0].at_s"));
        assert!(error(&actor.replace("crash", "slow")).contains("actor[0].by_s"));
        let flat = actor.replace("cache", "body").replace("crash", "flat");
        assert!(read(&format!("{flat}robot = 3\n")).is_ok());
        assert!(error(&format!("{flat}robot = 2\n")).contains("actor[0].fault"), "it does not fly");
        let link = "[[link]]\nlink = \"infra\"\nfault = \"drop\"\nfrom_s = 1.0\nuntil_s = 2.0\n";
        assert!(read(link).is_ok());
        assert!(error(&link.replace("infra", "ether")).contains("link[0].link"));
        assert!(error(&format!("{link}kinds = [\"latent\"]\n")).contains("link[0].kinds"));
        assert!(error(&format!("{link}hosts = [2]\n")).contains("link[0].hosts"));
        assert!(error(&link.replace("drop", "delay")).contains("link[0].by_s"));
        assert!(error(&format!("{link}share = 2.0\n")).contains("link[0].share"));
        assert!(error(&link.replace("drop", "partition")).contains("link[0].hosts"));
        assert!(error(&link.replace("2.0", "0.5")).contains("link[0].until_s"));
        assert!(error(&link.replace("drop", "misplace")).contains("link[0].off_m"));
        assert!(error(&format!("{}off_m = [0.0, nan]\n", link.replace("drop", "misplace"))).contains("link[0].off_m"));
    }
}
