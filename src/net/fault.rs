//! What is to go wrong in a trial, and when: faults of actors and of links, in one plan.
//!
//! A plan is read from TOML or drawn from a seed. It is data: the Shell acts out the actors' faults, the
//! medium those of the links.
//!
//! ```toml
//! [[actor]]
//! actor = "controller"     # cache, agent, controller, body, world, state-server, network
//! robot = 2                # whose; a robot's agent is the one that hosts it
//! fault = "crash"          # crash, stall, mute, slow
//! at_s = 3.0
//! for_s = 1.5
//!
//! [[link]]
//! link = "ad-hoc"
//! fault = "drop"           # drop, delay, duplicate, reorder, corrupt, partition
//! share = 0.5              # of the frames
//! from_s = 2.0
//! until_s = 6.0
//! ```

use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::config::{self, ConfigError};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Kind;
use crate::random::Seed;
use crate::time::{Span, Time};

/// Which actor a fault strikes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// A robot's Cache.
    Cache,
    /// The Agent that hosts a robot.
    Agent,
    /// A robot's Controller.
    Controller,
    /// A robot's Body.
    Body,
    /// The World that holds a robot.
    World,
    /// The team's one StateServer.
    StateServer,
    /// The Network of the host that runs a robot's Agent.
    Network,
}

/// What happens to an actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActorFaultKind {
    /// It stops, loses all state and everything sent to it, and starts afresh after the fault.
    Crash,
    /// It does nothing; what is sent to it waits in its mailbox.
    Stall,
    /// It works, and nothing that it says gets out.
    Mute,
    /// It takes everything up late.
    Slow,
}

/// One fault of one actor.
#[derive(Clone, Debug, PartialEq)]
pub struct ActorFault {
    /// The actor's role.
    pub role: Role,
    /// The robot that it belongs to; of no account for the StateServer.
    pub robot: RobotId,
    /// What happens.
    pub kind: ActorFaultKind,
    /// When it begins.
    pub at: Time,
    /// How long it lasts.
    pub lasts: Span,
    /// How much later everything is taken up; only for `Slow`.
    pub by: Span,
}

/// What happens to the frames of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkFaultKind {
    /// They are lost.
    Drop,
    /// They take longer.
    Delay,
    /// They arrive twice.
    Duplicate,
    /// Each takes a random while longer, so that they overtake each other.
    Reorder,
    /// A bit of the body is turned over.
    Corrupt,
    /// Those between the named hosts and all others are lost.
    Partition,
}

/// One fault of one link.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkFault {
    /// The link's name.
    pub link: String,
    /// What happens.
    pub kind: LinkFaultKind,
    /// The kinds of messages that it happens to; empty for all.
    pub kinds: Vec<Kind>,
    /// The hosts on one side of a partition.
    pub hosts: Vec<HostId>,
    /// The share of frames that it happens to, 0 to 1.
    pub share: f64,
    /// How much longer frames take: exactly (`Delay`) or at most (`Reorder`).
    pub by: Span,
    /// When it begins.
    pub from: Time,
    /// When it ends.
    pub until: Time,
}

impl LinkFault {
    /// A drop of every frame on `link`, for the whole run: the base to change fields of.
    pub fn always(link: &str, by: Span) -> LinkFault {
        LinkFault {
            link: link.to_owned(),
            kind: LinkFaultKind::Drop,
            kinds: Vec::new(),
            hosts: Vec::new(),
            share: 1.0,
            by,
            from: Time::ZERO,
            until: Time::MAX,
        }
    }

    /// Whether a frame sent now falls under this fault, the share aside.
    pub fn hits(&self, now: Time, kind: Kind, from: HostId, to: HostId) -> bool {
        let divides = self.hosts.contains(&from) != self.hosts.contains(&to);
        (self.from <= now && now < self.until)
            && (self.kinds.is_empty() || self.kinds.contains(&kind))
            && (self.kind != LinkFaultKind::Partition || divides)
    }
}

/// Everything that is to go wrong in a trial.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaultPlan {
    /// Faults of actors.
    pub actors: Vec<ActorFault>,
    /// Faults of links.
    pub links: Vec<LinkFault>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlanFile {
    #[serde(default)]
    actor: Vec<ActorEntry>,
    #[serde(default)]
    link: Vec<LinkEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ActorEntry {
    actor: Role,
    #[serde(default)]
    robot: u16,
    fault: ActorFaultKind,
    at_s: f64,
    for_s: f64,
    #[serde(default)]
    by_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LinkEntry {
    link: String,
    fault: LinkFaultKind,
    #[serde(default)]
    kinds: Vec<Kind>,
    #[serde(default)]
    hosts: Vec<u16>,
    #[serde(default = "whole")]
    share: f64,
    #[serde(default)]
    by_s: f64,
    from_s: f64,
    until_s: f64,
}

fn whole() -> f64 {
    1.0
}

impl FaultPlan {
    /// Reads a plan for a team of `robots` from TOML.
    pub fn from_toml(text: &str, robots: usize) -> Result<FaultPlan, ConfigError> {
        let file: PlanFile = config::from_toml(text)?;
        let actors = file.actor.into_iter().enumerate().map(|(i, entry)| entry.checked(i, robots));
        let links = file.link.into_iter().enumerate().map(|(i, entry)| entry.checked(i));
        Ok(FaultPlan { actors: actors.collect::<Result<_, _>>()?, links: links.collect::<Result<_, _>>()? })
    }

    /// Draws a plan from a seed: a fault of some actor about every ten seconds until `horizon`, each over
    /// within three seconds.
    pub fn random(seed: u64, robots: usize, horizon: Span) -> FaultPlan {
        let mut stream = Seed::of_run(seed).stream("fault-plan");
        let roles = [Role::Cache, Role::Agent, Role::Controller, Role::Body, Role::StateServer];
        let kinds = [ActorFaultKind::Crash, ActorFaultKind::Stall, ActorFaultKind::Mute, ActorFaultKind::Slow];
        let mut at = Time::ZERO;
        let mut actors = Vec::new();
        loop {
            at += Span::from_secs(stream.random_range(3.0..17.0));
            if at >= Time::ZERO + horizon {
                return FaultPlan { actors, links: Vec::new() };
            }
            actors.push(ActorFault {
                role: roles[stream.random_range(0..roles.len())],
                robot: RobotId(u16::try_from(stream.random_range(0..robots.max(1))).expect("a team fits u16")),
                kind: kinds[stream.random_range(0..kinds.len())],
                at,
                lasts: Span::from_secs(stream.random_range(0.1..3.0)),
                by: Span::from_secs(stream.random_range(0.01..0.3)),
            });
        }
    }

    /// The faults planned for one link.
    pub fn of_link(&self, name: &str) -> Vec<LinkFault> {
        self.links.iter().filter(|fault| fault.link == name).cloned().collect()
    }

    /// When the last fault is over; the start of the run if there is none.
    pub fn over(&self) -> Time {
        let actors = self.actors.iter().map(|fault| fault.at + fault.lasts);
        actors.chain(self.links.iter().map(|fault| fault.until)).max().unwrap_or(Time::ZERO)
    }
}

fn seconds(field: String, value: f64) -> Result<Span, ConfigError> {
    if value.is_finite() && (0.0..=1e6).contains(&value) {
        return Ok(Span::from_secs(value));
    }
    Err(ConfigError::field(field, format!("{value} is not a time of 0 to 1e6 s")))
}

impl ActorEntry {
    fn checked(self, index: usize, robots: usize) -> Result<ActorFault, ConfigError> {
        let field = |name: &str| format!("actor[{index}].{name}");
        if usize::from(self.robot) >= robots {
            let reason = format!("there is no robot {}; the team has {robots}, counted from 0", self.robot);
            return Err(ConfigError::field(field("robot"), reason));
        }
        if self.fault == ActorFaultKind::Slow && self.by_s <= 0.0 {
            let reason = "a slow actor needs to know by how much; give seconds above 0".to_owned();
            return Err(ConfigError::field(field("by_s"), reason));
        }
        Ok(ActorFault {
            role: self.actor,
            robot: RobotId(self.robot),
            kind: self.fault,
            at: Time::ZERO + seconds(field("at_s"), self.at_s)?,
            lasts: seconds(field("for_s"), self.for_s)?,
            by: seconds(field("by_s"), self.by_s)?,
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
            share: self.share,
            by: seconds(field("by_s"), self.by_s)?,
            from: Time::ZERO + from,
            until: Time::ZERO + until,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_plan_is_refused_by_its_field() {
        let error = |text: &str| FaultPlan::from_toml(text, 5).unwrap_err().to_string();
        let actor = "[[actor]]\nactor = \"cache\"\nfault = \"crash\"\nat_s = 1.0\nfor_s = 1.0\n";
        assert!(FaultPlan::from_toml(actor, 5).is_ok());
        assert!(error(&format!("{actor}robot = 9\n")).contains("actor[0].robot"));
        assert!(error(&format!("{actor}color = 9\n")).contains("color"));
        assert!(error(&actor.replace("1.0", "-1.0")).contains("actor[0].at_s"));
        assert!(error(&actor.replace("crash", "slow")).contains("actor[0].by_s"));
        let link = "[[link]]\nlink = \"infra\"\nfault = \"drop\"\nfrom_s = 1.0\nuntil_s = 2.0\n";
        assert!(FaultPlan::from_toml(link, 5).is_ok());
        assert!(error(&format!("{link}share = 2.0\n")).contains("link[0].share"));
        assert!(error(&link.replace("drop", "partition")).contains("link[0].hosts"));
        assert!(error(&link.replace("2.0", "0.5")).contains("link[0].until_s"));
    }

    #[test]
    fn a_seed_draws_the_same_plan_twice() {
        let draw = |seed| FaultPlan::random(seed, 5, Span::from_secs(200.0));
        assert_eq!(draw(3), draw(3));
        assert_ne!(draw(3), draw(4));
        assert!(draw(3).actors.len() > 5);
    }
}
