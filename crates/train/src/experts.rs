//! Experts: policies that say in each state of a team what they would do in the place of the policy that is trained.
//!
//! An expert knows the true state, and is heard and hears without delay and loss. It may know more than its pupil.

use std::sync::Arc;

use super::channels::Channels;
use super::environments::Environments;
use super::sight::Sight;
use murmurate::messages::geometry::{Motion, Planar, Task, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::observation::Observation;
use murmurate::policy::{Model, Neighbour, Policy};
use murmurate::random::Stream;
use murmurate::registry::Registry;
use murmurate::scenario::{Arena, Scenario};
use murmurate::time::Span;

/// Number of times that robots without memory of the steps before exchange their messages for one answer: what they say
/// in the second time follows from what they have heard in the first.
const EXCHANGES: usize = 2;

/// Expert for the teams of one size in a scenario.
#[derive(Debug)]
pub struct Expert {
    model: Model,
    /// Channels that it takes; `None` if it takes none.
    channels: Option<Channels>,
}

impl Expert {
    /// Makes the expert `name` of the registry for `scenario`. An error says why it is none.
    pub fn new(registry: &Registry, name: &str, scenario: &Arc<dyn Scenario>) -> Result<Expert, String> {
        let entry = registry.policy(name).ok_or_else(|| {
            let known: Vec<&str> = registry.policies().iter().map(|entry| entry.name).collect();
            format!("there is no policy of this name; there are: {}", known.join(", "))
        })?;
        let model = (entry.build)(&**scenario).map_err(|error| error.to_string())?;
        if model.instance(scenario.arena(), RobotId(0)).hops() > 1 {
            return Err("a policy of several hops is no expert".to_owned());
        }
        let channels = Channels::of_scenario(model.requests(), scenario).map_err(|error| error.to_string())?;
        if channels.is_some() && !known(channels.as_ref(), &**scenario) {
            return Err("it takes a channel that has no value in trainings".to_owned());
        }
        Ok(Expert { model, channels })
    }

    /// Makes the policy of each robot of a team of `scenario`. `drawn` is the arena of the episode, if it is not the
    /// scenario's.
    pub(crate) fn team(&self, scenario: &dyn Scenario, drawn: Option<&Arena>) -> ExpertTeam<'_> {
        let instance = |robot: RobotId| {
            let mut instance = self.model.instance(scenario.arena(), robot);
            drawn.into_iter().for_each(|arena| instance.enter(arena));
            instance
        };
        let robots = scenario.robots();
        ExpertTeam {
            expert: self,
            robots: RobotId::team(robots).map(instance).collect(),
            sight: Sight::new(self.channels.as_ref(), robots),
        }
    }
}

/// Returns whether the channels that a policy takes have values at the start of an episode of `scenario`, in a training
/// that knows no more of a robot than its scenario tells.
pub(crate) fn known(channels: Option<&Channels>, scenario: &dyn Scenario) -> bool {
    let team: Vec<Option<Task>> = scenario.tasks(0, 0).into_iter().map(Some).collect();
    let start = team.iter().flatten().next().expect("a team has a robot");
    let own = Observation::in_frame(scenario.frame(start), start.goal, &Motion::at_rest(start.start));
    Sight::new(channels, team.len()).see(own, 0, &team).values.iter().all(|value| value.is_finite())
}

/// Expert as the policy of each robot of a team.
pub(crate) struct ExpertTeam<'a> {
    expert: &'a Expert,
    robots: Vec<Box<dyn Policy>>,
    sight: Sight,
}

/// State of a team that an expert is told.
pub(crate) struct TeamState<'a> {
    /// Observation of each robot in its policy frame, without values of channels.
    pub own: &'a [Observation<'static>],
    /// Motion of each robot, world frame.
    pub motion: &'a [Motion],
    /// Task of each robot.
    pub tasks: &'a [Option<Task>],
}

impl ExpertTeam<'_> {
    /// Returns the velocity \[m/s\], policy frame, that each robot would take: robots step together, and messages of
    /// this step are received within the expert's radius.
    pub fn ask(&mut self, state: &TeamState, stream: &mut Stream) -> Vec<Vec2> {
        let TeamState { own, motion, tasks } = *state;
        let (interface, count) = (self.expert.model.interface(), motion.len());
        let (mut values, mut latents) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for (robot, expert) in self.robots.iter_mut().enumerate() {
            let seen = self.sight.see(own[robot], robot, tasks);
            let mut features = vec![0.0; interface.features];
            expert.encode(&seen, &mut features);
            values.push(seen.values.to_vec());
            latents.push(features);
        }
        let velocity = |(robot, expert): (usize, &mut Box<dyn Policy>)| {
            let near = |other: &usize| {
                let square = (motion[*other].position - motion[robot].position).norm_squared();
                *other != robot && square <= interface.radius_m * interface.radius_m
            };
            let frame = own[robot].frame;
            let neighbour = |other: usize| Neighbour {
                motion: frame.turn_motion(&motion[other]),
                features: &latents[other],
                age: Span::ZERO,
            };
            let neighbours: Vec<Neighbour> = (0..count).filter(near).map(neighbour).collect();
            let seen = Observation { values: &values[robot], ..own[robot] };
            expert.act(&seen, &latents[robot], &neighbours, stream)
        };
        self.robots.iter_mut().enumerate().map(velocity).collect()
    }

    /// Returns what `ask` does for robots that remember nothing of the steps before: their answer follows from the
    /// state alone, so a training that goes on from a checkpoint gets the same.
    pub fn ask_anew(&mut self, state: &TeamState, stream: &mut Stream) -> Vec<Vec2> {
        self.robots.iter_mut().for_each(|robot| robot.reset(0));
        self.sight = Sight::new(self.expert.channels.as_ref(), self.robots.len());
        (0..EXCHANGES).map(|_| self.ask(state, stream)).last().expect("there is one exchange or more")
    }
}

/// Experts of the teams of environments, for the time of a rollout.
pub(crate) struct Experts<'a> {
    /// Expert for each team size, indexed by it.
    experts: &'a [Option<Expert>],
    /// Experts of each team, with the layout of the episode for which they were made.
    teams: Vec<Option<((u64, u32), ExpertTeam<'a>)>>,
}

impl<'a> Experts<'a> {
    /// Returns the experts of `teams` teams.
    pub fn new(experts: &'a [Option<Expert>], teams: usize) -> Experts<'a> {
        Experts { experts, teams: (0..teams).map(|_| None).collect() }
    }

    /// Returns the velocity \[m/s\], policy frame, that the expert would command for each robot of all teams, along
    /// each axis at most `limit_m_s`.
    pub fn ask(&mut self, environments: &Environments, limit_m_s: f32, stream: &mut Stream) -> Vec<[f32; 2]> {
        let mut all = Vec::with_capacity(environments.position.len());
        for (team, kept) in self.teams.iter_mut().enumerate() {
            let of_team = &environments.teams[team];
            if kept.as_ref().is_none_or(|(layout, _)| *layout != of_team.layout) {
                let expert = self.experts[of_team.robots].as_ref().expect("there is one for every team size");
                let (scenario, layout) = (environments.scenario(team), of_team.layout);
                let drawn = scenario.drawn_arena(layout.0, layout.1);
                *kept = Some((layout, expert.team(scenario, drawn.as_ref())));
            }
            let (_, experts) = kept.as_mut().expect("they were just made");
            let range = of_team.range();
            let motion: Vec<Motion> = range.clone().map(|robot| environments.point(robot)).collect();
            let own: Vec<Observation<'static>> =
                range.clone().map(|robot| environments.true_state(team, robot)).collect();
            let tasks: Vec<Option<Task>> = environments.tasks[range].iter().copied().map(Some).collect();
            let state = TeamState { own: &own, motion: &motion, tasks: &tasks };
            let limited = |velocity: Vec2| velocity.to_array().map(|axis| axis.clamp(-limit_m_s, limit_m_s));
            all.extend(experts.ask_anew(&state, stream).into_iter().map(limited));
        }
        all
    }
}
