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

/// What there is to strike.
#[derive(Clone, Debug)]
pub struct Targets<'a> {
    /// The size of the team.
    pub robots: usize,
    /// How many hosts there are.
    pub hosts: usize,
    /// The links by name, and what each carries.
    pub links: Vec<(&'a str, &'a [Kind])>,
}

/// Everything that is to go wrong in a trial.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaultPlan {
    /// Faults of actors.
    pub actors: Vec<ActorFault>,
    /// Faults of links.
    pub links: Vec<LinkFault>,
}

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
    #[serde(default = "whole")]
    share: f64,
    #[serde(default)]
    by_s: f64,
    from_s: f64,
    until_s: f64,
}

/// Whom a drawn plan strikes, and how.
const STRUCK: [Role; 5] = [Role::Cache, Role::Agent, Role::Controller, Role::Body, Role::StateServer];
const ACTOR_FAULTS: [ActorFaultKind; 4] =
    [ActorFaultKind::Crash, ActorFaultKind::Stall, ActorFaultKind::Mute, ActorFaultKind::Slow];
const LINK_FAULTS: [LinkFaultKind; 6] = [
    LinkFaultKind::Drop,
    LinkFaultKind::Delay,
    LinkFaultKind::Duplicate,
    LinkFaultKind::Reorder,
    LinkFaultKind::Corrupt,
    LinkFaultKind::Partition,
];
/// The latest instant and the longest delay that a plan may name \[s\].
const LATEST_S: f64 = 1e6;
const LONGEST_DELAY_S: f64 = 10.0;

fn whole() -> f64 {
    1.0
}

impl FaultPlan {
    /// Reads a plan from TOML; `check` holds it against a team.
    pub fn from_toml(text: &str) -> Result<FaultPlan, ConfigError> {
        let file: PlanFile = config::from_toml(text)?;
        let actors = file.actor.into_iter().enumerate().map(|(i, entry)| entry.checked(i));
        let links = file.link.into_iter().enumerate().map(|(i, entry)| entry.checked(i));
        Ok(FaultPlan { actors: actors.collect::<Result<_, _>>()?, links: links.collect::<Result<_, _>>()? })
    }

    /// Draws a plan from a seed: about one fault in ten seconds until `horizon`, one at least, each over within
    /// three seconds. Two of three strike an actor, the others a link.
    pub fn random(seed: u64, targets: &Targets, horizon: Span) -> FaultPlan {
        let mut stream = Seed::of_run(seed).stream("fault-plan");
        let count = (horizon.as_secs() / 10.0).round().max(1.0) as usize;
        let mut plan = FaultPlan::default();
        for _ in 0..count {
            let at = Time::ZERO + Span::from_secs(stream.random_range(1.0..horizon.as_secs().max(2.0)));
            let lasts = Span::from_secs(stream.random_range(0.1..3.0));
            let by = Span::from_secs(stream.random_range(0.01..0.3));
            let mut one_of = |count: usize| u16::try_from(stream.random_range(0..count.max(1))).expect("16 bits");
            let (robot, host) = (RobotId(one_of(targets.robots)), HostId(one_of(targets.hosts)));
            if stream.random_bool(1.0 / 3.0) && !targets.links.is_empty() {
                let (link, _) = targets.links[stream.random_range(0..targets.links.len())];
                plan.links.push(LinkFault {
                    kind: LINK_FAULTS[stream.random_range(0..LINK_FAULTS.len())],
                    hosts: vec![host],
                    share: stream.random_range(0.1..1.0),
                    from: at,
                    until: at + lasts,
                    ..LinkFault::always(link, by)
                });
            } else {
                let kind = ACTOR_FAULTS[stream.random_range(0..ACTOR_FAULTS.len())];
                let role = STRUCK[stream.random_range(0..STRUCK.len())];
                plan.actors.push(ActorFault { role, robot, kind, at, lasts, by });
            }
        }
        plan
    }

    /// Checks that the faults are of this team, its hosts and its links with what they carry.
    pub fn check(&self, targets: &Targets) -> Result<(), ConfigError> {
        let Targets { robots, hosts, ref links } = *targets;
        if let Some(index) = self.actors.iter().position(|fault| fault.robot.index() >= robots) {
            let fault = &self.actors[index];
            let reason = format!("there is no {}; the team has {robots}, counted from 0", fault.robot);
            return Err(ConfigError::field(format!("actor[{index}].robot"), reason));
        }
        for (index, fault) in self.links.iter().enumerate() {
            let wrong = |field: &str, reason: String| Err(ConfigError::field(format!("link[{index}].{field}"), reason));
            let Some((_, carried)) = links.iter().find(|(name, _)| *name == fault.link) else {
                let known: Vec<&str> = links.iter().map(|(name, _)| *name).collect();
                let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
                return wrong("link", format!("no link '{}' in this mode; there are: {known}", fault.link));
            };
            if let Some(kind) = fault.kinds.iter().find(|kind| !carried.contains(kind)) {
                return wrong("kinds", format!("'{}' does not carry {kind:?}", fault.link));
            }
            if let Some(host) = fault.hosts.iter().find(|host| usize::from(host.0) >= hosts) {
                return wrong("hosts", format!("there is no host {}; there are {hosts}, counted from 0", host.0));
            }
        }
        Ok(())
    }

    /// Writes the plan as TOML, which `from_toml` reads.
    pub fn to_toml(&self) -> String {
        let actor = |fault: &ActorFault| ActorEntry {
            actor: fault.role,
            robot: fault.robot.0,
            fault: fault.kind,
            at_s: fault.at.as_secs(),
            for_s: fault.lasts.as_secs(),
            by_s: fault.by.as_secs(),
        };
        let link = |fault: &LinkFault| LinkEntry {
            link: fault.link.clone(),
            fault: fault.kind,
            kinds: fault.kinds.clone(),
            hosts: fault.hosts.iter().map(|host| host.0).collect(),
            share: fault.share,
            by_s: fault.by.as_secs(),
            from_s: fault.from.as_secs(),
            until_s: fault.until.as_secs().min(LATEST_S),
        };
        let actors = self.actors.iter().map(actor).collect();
        let file = PlanFile { actor: actors, link: self.links.iter().map(link).collect() };
        toml::to_string(&file).expect("a plan is TOML")
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
    within(field, value, LATEST_S)
}

fn within(field: String, value: f64, most_s: f64) -> Result<Span, ConfigError> {
    if (0.0..=most_s).contains(&value) {
        return Ok(Span::from_secs(value));
    }
    Err(ConfigError::field(field, format!("{value} is not a time of 0 to {most_s} s")))
}

impl ActorEntry {
    fn checked(self, index: usize) -> Result<ActorFault, ConfigError> {
        let field = |name: &str| format!("actor[{index}].{name}");
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
            by: within(field("by_s"), self.by_s, LONGEST_DELAY_S)?,
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
            let reason = "frames that come late need to know by how much; give seconds above 0".to_owned();
            return Err(ConfigError::field(field("by_s"), reason));
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
            by: within(field("by_s"), self.by_s, LONGEST_DELAY_S)?,
            from: Time::ZERO + from,
            until: Time::ZERO + until,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn targets() -> Targets<'static> {
        Targets { robots: 5, hosts: 2, links: vec![("infra", &[Kind::Mode])] }
    }

    #[test]
    fn a_bad_plan_is_refused_by_its_field() {
        let read = |text: &str| FaultPlan::from_toml(text).and_then(|plan| plan.check(&targets()).map(|()| plan));
        let error = |text: &str| read(text).unwrap_err().to_string();
        let actor = "[[actor]]\nactor = \"cache\"\nfault = \"crash\"\nat_s = 1.0\nfor_s = 1.0\n";
        assert!(read(actor).is_ok());
        assert!(error(&format!("{actor}robot = 9\n")).contains("actor[0].robot"));
        assert!(error(&format!("{actor}color = 9\n")).contains("color"));
        assert!(error(&actor.replace("1.0", "-1.0")).contains("actor[0].at_s"));
        assert!(error(&actor.replace("crash", "slow")).contains("actor[0].by_s"));
        let link = "[[link]]\nlink = \"infra\"\nfault = \"drop\"\nfrom_s = 1.0\nuntil_s = 2.0\n";
        assert!(read(link).is_ok());
        assert!(error(&link.replace("infra", "ether")).contains("link[0].link"));
        assert!(error(&format!("{link}kinds = [\"latent\"]\n")).contains("link[0].kinds"));
        assert!(error(&format!("{link}hosts = [2]\n")).contains("link[0].hosts"));
        assert!(error(&link.replace("drop", "delay")).contains("link[0].by_s"));
        assert!(error(&format!("{link}share = 2.0\n")).contains("link[0].share"));
        assert!(error(&link.replace("drop", "partition")).contains("link[0].hosts"));
        assert!(error(&link.replace("2.0", "0.5")).contains("link[0].until_s"));
    }

    #[test]
    fn a_seed_draws_the_same_plan_twice_and_it_survives_toml() {
        let draw = |seed| FaultPlan::random(seed, &targets(), Span::from_secs(200.0));
        assert_eq!(draw(3), draw(3));
        assert_ne!(draw(3), draw(4));
        assert!(draw(3).actors.len() > 5 && draw(3).links.len() > 1);
        let no_links = Targets { links: Vec::new(), ..targets() };
        assert_eq!(FaultPlan::random(1, &no_links, Span::from_secs(1.0)).actors.len(), 1, "one at least");
        assert!((0..50).all(|seed| draw(seed).check(&targets()).is_ok()), "what is drawn is there");
        let again = FaultPlan::from_toml(&draw(3).to_toml()).unwrap();
        assert_eq!(again.actors, draw(3).actors);
    }
}
