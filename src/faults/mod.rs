//! Fault plans: faults of actors and of links to inject in a trial, with their times.
//!
//! A plan is read from TOML (`file`) or drawn from a seed. The plan is data only. The Shell, which runs the actors,
//! injects the faults of actors, and the link emulator injects the faults of links.

mod file;

use std::collections::BTreeMap;

use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::config::ConfigError;
use crate::messages::geometry::Vec2;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Kind;
use crate::random::Seed;
use crate::time::{Span, Time};

/// Role of the actor (a part of the system with its own message queue) into which a fault is injected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// The Cache of a robot, the actor that holds the robot's readings and its neighbours' messages.
    Cache,
    /// Agent that runs a robot's policy; one Agent may run the policies of several robots.
    Agent,
    /// Controller of a robot: the actor that approves the motor commands.
    Controller,
    /// Body of a robot: the actor of its motors and sensors.
    Body,
    /// World in which a robot moves: the actor that simulates it.
    World,
    /// The StateServer, the actor that starts and ends a team's episodes; there is one per team.
    StateServer,
    /// Network actor, which sends and receives messages, of the host that runs a robot's Agent.
    Network,
}

/// Kind of fault of an actor, a part of the system with its own message queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActorFaultKind {
    /// The actor stops and loses all its state and all messages sent to it. After the fault it restarts with its
    /// initial state.
    Crash,
    /// The actor does nothing; messages to it wait in its mailbox.
    Stall,
    /// The actor runs, but all its output is dropped.
    Mute,
    /// The actor handles messages and timers with an additional delay.
    Slow,
    /// The battery of a simulated robot that flies is empty; after the fault it is full. Only for the role Body.
    Flat,
}

/// One planned fault of one actor, with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct ActorFault {
    /// Role of the actor that is affected.
    pub role: Role,
    /// Robot of the affected actor: of an Agent or World any robot that it runs, of a Network any robot whose Agent is
    /// on its host. Without effect for the StateServer, of which a team has only one.
    pub robot: RobotId,
    /// Kind of fault, such as a crash.
    pub kind: ActorFaultKind,
    /// Start of the fault, counted from the start of the trial or of the episode `episode`.
    pub at: Time,
    /// Duration of the fault.
    pub lasts: Span,
    /// Additional delay with which the actor handles messages and timers; used only by faults of kind `Slow`.
    pub by: Span,
    /// Index, from 0, of the episode from whose start `at` counts; `None` if `at` counts from the start of the trial.
    pub episode: Option<u32>,
}

/// Kind of fault of the frames (packets) that a link carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkFaultKind {
    /// Frames on the link are lost.
    Drop,
    /// Frames on the link are delayed by a fixed time.
    Delay,
    /// Frames on the link arrive twice.
    Duplicate,
    /// Each frame is delayed by a random time, so that frames are reordered.
    Reorder,
    /// One bit in the body of each affected frame is flipped; headers stay intact.
    Corrupt,
    /// Frames between the hosts that the fault names and all other hosts are lost.
    Partition,
    /// The positions that senders of latents say are moved by `off_m`, as captured hosts might move them.
    Misplace,
}

/// One planned fault of one link between hosts, such as loss of frames, with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkFault {
    /// Name of the affected link.
    pub link: String,
    /// Kind of fault, such as loss of frames.
    pub kind: LinkFaultKind,
    /// Kinds of messages of which the frames are affected; an empty list means all kinds.
    pub kinds: Vec<Kind>,
    /// Hosts on one side of a partition, or senders of misplaced latents, for which an empty list means all; used only
    /// by faults of kind `Partition` and `Misplace`.
    pub hosts: Vec<HostId>,
    /// Vector by which faults of kind `Misplace` move positions \[m\]; unused otherwise.
    pub off_m: Vec2,
    /// Probability, 0 to 1, that a frame sent during the fault is affected.
    pub share: f64,
    /// Additional delay of affected frames: the exact delay for kind `Delay`, the maximum for `Reorder`, unused
    /// otherwise.
    pub by: Span,
    /// Start of the fault, counted from the start of the trial or of the episode `episode`.
    pub from: Time,
    /// End of the fault, exclusive, counted from the start of the trial or of the episode `episode`.
    pub until: Time,
    /// Index, from 0, of the episode from whose start `from` and `until` count; `None` if they count from the start of
    /// the trial.
    pub episode: Option<u32>,
}

impl LinkFault {
    /// Returns a fault that drops every frame on the link named `link` for the whole trial. It serves as the base for
    /// struct update syntax.
    pub fn always(link: &str) -> LinkFault {
        LinkFault {
            link: link.to_owned(),
            kind: LinkFaultKind::Drop,
            kinds: Vec::new(),
            hosts: Vec::new(),
            off_m: Vec2::zeros(),
            share: 1.0,
            by: Span::ZERO,
            from: Time::ZERO,
            until: Time::MAX,
            episode: None,
        }
    }

    /// Returns true if a frame sent at time `now` is subject to this fault; the caller then applies the probability
    /// `share`. `began` has the start time of each episode that has begun, by its index. `kind` is the kind of the
    /// frame's message, and `ends` are its sender and its receiver.
    pub fn hits(&self, now: Time, began: &BTreeMap<u32, Time>, kind: Kind, ends: (HostId, HostId)) -> bool {
        let Some(origin) = self.episode.map_or(Some(Time::ZERO), |episode| began.get(&episode).copied()) else {
            return false;
        };
        let elapsed = Time::ZERO + now.since(origin);
        let divides = self.hosts.contains(&ends.0) != self.hosts.contains(&ends.1);
        let says = kind == Kind::Latent && (self.hosts.is_empty() || self.hosts.contains(&ends.0));
        (self.from <= elapsed && elapsed < self.until)
            && (self.kinds.is_empty() || self.kinds.contains(&kind))
            && match self.kind {
                LinkFaultKind::Partition => divides,
                LinkFaultKind::Misplace => says,
                _ => true,
            }
    }
}

/// Actors and links of a team into which faults can be injected.
#[derive(Clone, Debug)]
pub struct Targets<'a> {
    /// Number of robots in the team.
    pub robots: usize,
    /// Number of hosts (processes that run parts of the system) in the team.
    pub hosts: usize,
    /// Simulated robots that fly, which alone have a battery.
    pub flying: Vec<RobotId>,
    /// Links of the team: pairs of a link's name and the kinds of messages that it carries.
    pub links: Vec<(&'a str, &'a [Kind])>,
}

/// Fault of one link that a person sets while a simulation runs. It acts on every frame, until it is changed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ManualLinkFault {
    /// Whether the link loses every frame, as if it were cut.
    pub cut: bool,
    /// Delay of every frame on the link, in addition to other delays.
    pub delay: Span,
    /// Probability, 0 to 1, that a receiver loses a frame, in addition to other losses.
    pub loss: f64,
}

/// All faults of actors and links to inject in a trial (a run of several episodes), with their times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaultPlan {
    /// Planned faults of actors; empty for none.
    pub actors: Vec<ActorFault>,
    /// Planned faults of links; empty for none.
    pub links: Vec<LinkFault>,
}

/// Returns the name of an enum's variant as it is written in a fault plan's file.
fn word(value: &impl Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Roles of actors from which random fault plans are drawn. `ACTOR_FAULTS` and `LINK_FAULTS` are the kinds of faults.
const ROLES: [Role; 5] = [Role::Cache, Role::Agent, Role::Controller, Role::Body, Role::StateServer];
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
impl FaultPlan {
    /// Draws a plan from `seed` for a team with `targets`: about one fault per ten seconds of a trial that lasts
    /// `horizon`, and at least one. Each fault lasts at most three seconds. On average, two of three faults are of
    /// actors and the others of links; without links, all are of actors.
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
                    by,
                    ..LinkFault::always(link)
                });
            } else {
                let kind = ACTOR_FAULTS[stream.random_range(0..ACTOR_FAULTS.len())];
                let role = ROLES[stream.random_range(0..ROLES.len())];
                plan.actors.push(ActorFault { role, robot, kind, at, lasts, by, episode: None });
            }
        }
        plan
    }

    /// Checks that the robots, hosts, links and kinds of messages that the plan names exist in a team with `targets`.
    /// An error names the wrong field.
    pub fn check(&self, targets: &Targets) -> Result<(), ConfigError> {
        let Targets { robots, hosts, ref flying, ref links } = *targets;
        // The one state server is of no robot.
        let missing = |fault: &ActorFault| fault.role != Role::StateServer && fault.robot.index() >= robots;
        if let Some(index) = self.actors.iter().position(missing) {
            let fault = &self.actors[index];
            let reason = format!("there is no {}; the team has {robots}, counted from 0", fault.robot);
            return Err(ConfigError::field(format!("actor[{index}].robot"), reason));
        }
        let idle = |fault: &ActorFault| fault.kind == ActorFaultKind::Flat && !flying.contains(&fault.robot);
        if let Some(index) = self.actors.iter().position(idle) {
            let robot = self.actors[index].robot;
            let reason =
                format!("{robot} is no simulated robot that flies, and only they have a battery (body.height_m)");
            return Err(ConfigError::field(format!("actor[{index}].fault"), reason));
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

    /// Checks that every fault that is timed from the start of an episode names one of the `episodes` episodes of the
    /// trial. An error names the wrong field.
    pub fn check_episodes(&self, episodes: u32) -> Result<(), ConfigError> {
        let actors = self.actors.iter().enumerate().map(|(index, fault)| (format!("actor[{index}]"), fault.episode));
        let links = self.links.iter().enumerate().map(|(index, fault)| (format!("link[{index}]"), fault.episode));
        match actors.chain(links).find(|(_, episode)| episode.is_some_and(|episode| episode >= episodes)) {
            None => Ok(()),
            Some((entry, _)) => {
                let reason = format!("the trial has {episodes}, counted from 0");
                Err(ConfigError::field(format!("{entry}.episode"), reason))
            }
        }
    }

    /// Returns a description of each fault in words, for a report.
    pub fn describe(&self) -> Vec<String> {
        let when = |episode: Option<u32>, at: Time| match episode {
            // A plan counts episodes from 0, and what people read from 1.
            Some(episode) => format!("{:.1} s into episode {}", at.as_secs(), episode.saturating_add(1)),
            None => format!("at {:.1} s of the trial", at.as_secs()),
        };
        let actor = |fault: &ActorFault| {
            let whose = if fault.role == Role::StateServer { String::new() } else { format!(" of {}", fault.robot) };
            let (role, kind) = (word(&fault.role), word(&fault.kind));
            format!("{role}{whose}: {kind} {}, for {:.1} s", when(fault.episode, fault.at), fault.lasts.as_secs())
        };
        let link = |fault: &LinkFault| {
            let share = 100.0 * fault.share;
            let (begins, kind) = (when(fault.episode, fault.from), word(&fault.kind));
            let ends = if fault.until == Time::MAX {
                "to the end".to_owned()
            } else {
                format!("for {:.1} s", fault.until.since(fault.from).as_secs())
            };
            format!("link {}: {kind} of {share:.0} % of frames {begins}, {ends}", fault.link)
        };
        self.actors.iter().map(actor).chain(self.links.iter().map(link)).collect()
    }

    /// Returns the planned faults of the link named `name`; empty if there are none.
    pub fn of_link(&self, name: &str) -> Vec<LinkFault> {
        self.links.iter().filter(|fault| fault.link == name).cloned().collect()
    }

    /// Returns the end of the last fault, or the start of the trial if there are no faults. Times that count from the
    /// start of an episode are treated as if they counted from the start of the trial.
    pub fn over(&self) -> Time {
        let actors = self.actors.iter().map(|fault| fault.at + fault.lasts);
        actors.chain(self.links.iter().map(|fault| fault.until)).max().unwrap_or(Time::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn targets() -> Targets<'static> {
        Targets { robots: 5, hosts: 2, flying: vec![RobotId(3)], links: vec![("infra", &[Kind::Mode])] }
    }

    #[test]
    fn a_seed_draws_the_same_plan_twice_and_it_survives_toml() {
        let draw = |seed| FaultPlan::random(seed, &targets(), Span::from_secs(200.0));
        assert_eq!(draw(3), draw(3));
        assert_ne!(draw(3), draw(4));
        assert!(draw(3).actors.len() > 5 && draw(3).links.len() > 1);
        let no_links = Targets { links: Vec::new(), ..targets() };
        assert_eq!(FaultPlan::random(1, &no_links, Span::from_secs(1.0)).actors.len(), 1, "one at least");
        assert!((0..50).all(|seed| draw(seed).check(&targets()).is_ok()), "drawn plans pass the check");
        let again = FaultPlan::from_toml(&draw(3).to_toml()).unwrap();
        assert_eq!(again.actors, draw(3).actors);
    }
}
