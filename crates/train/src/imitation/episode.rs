//! Rollouts of training by imitation: a team drives an episode, by the policy or by the expert, and the expert says
//! what it would do in each step.
//!
//! The dynamics are those of `world::kinematic`, and messages are as old as in a run: of the same step if robots step
//! together, otherwise of the step before or, where messages were lost, of an earlier one.

use std::collections::VecDeque;

use rand::RngExt;

use super::units::{Units, scale};
use crate::batch::Batch;
use crate::channels::Channels;
use crate::experts::{Expert, ExpertTeam, TeamState};
use crate::graphs::Graphs;
use crate::network::{Network, Space};
use crate::sight::Sight;
use murmurate::messages::geometry::{Motion, Planar, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::observation::Observation;
use murmurate::policy::flock::MAX_ACCELERATION_M_S2;
use murmurate::policy::hops::action::Action;
use murmurate::policy::hops::entry;
use murmurate::policy::hops::hop::write_edge;
use murmurate::policy::hops::manifest::Manifest;
use murmurate::random::Stream;
use murmurate::scenario::judge::{Judge, JudgedRobot, Judgement};
use murmurate::scenario::{Arena, Scenario};
use murmurate::time::Span;
use murmurate::world::Physics;
use murmurate::world::kinematic::{self, PERIOD};

/// Setting that all episodes of an iteration share.
#[derive(Clone, Copy, Debug)]
pub struct Setting<'a> {
    /// Task of the team.
    pub scenario: &'a dyn Scenario,
    /// Policy whose actions are learnt.
    pub expert: &'a Expert,
    /// Channels that the trained policy takes; `None` if it takes none.
    pub channels: Option<&'a Channels>,
    /// Units of the network.
    pub units: &'a Units,
    /// Number of steps of 50 ms for which a decision is held.
    pub repeat: usize,
    /// Metadata of the trained policy.
    pub manifest: &'a Manifest,
    /// Network of the trained policy.
    pub network: &'a Network,
    /// Weights and biases of the trained policy.
    pub parameters: &'a [f32],
}

/// Policy that drives an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driver {
    /// The trained policy.
    Policy,
    /// The expert.
    Expert,
}

/// Whether the steps of an episode are recorded for learning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taught {
    /// They are, with the actions of the expert.
    Yes,
    /// Only the finding counts.
    No,
}

/// Conditions of messages in an episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Messages {
    /// Robots step together and exchange all hops within a step.
    Lockstep,
    /// Every message is a step old, and lost with this probability, 0 to 1.
    Late(f32),
}

/// Episode of one team.
#[derive(Clone, Debug)]
pub struct TaughtEpisode {
    /// Observations, messages and latents of the robots, one graph for each step; empty if they were not to be learnt.
    pub graphs: Graphs,
    /// Action of the expert for each robot in each step, in the units of the network; empty if the steps were not to be
    /// learnt.
    pub expert: Vec<[f32; 2]>,
    /// Verdict, cost and smallest distance of robots.
    pub finding: Judgement,
}

impl TaughtEpisode {
    /// Returns the number of steps that were recorded.
    pub fn steps(&self) -> usize {
        self.expert.len() / self.graphs.robots
    }
}

/// Team in an episode.
struct TaughtTeam<'a> {
    setting: Setting<'a>,
    /// Tasks of the robots, all of which they are told.
    tasks: Vec<Option<Task>>,
    /// Time since the start of the episode.
    after: Span,
    sight: Sight,
    motion: Vec<Motion>,
    messages: Messages,
    /// For each receiver and sender, the number of steps since a message was received; `u8::MAX` for none.
    silence: Vec<u8>,
    /// States in this step and in those before it, the newest first.
    sent: VecDeque<Vec<Motion>>,
    graphs: Graphs,
    batch: Batch<f32>,
    space: Space<f32>,
}

/// Largest number of steps for which a message is used.
pub fn most_age(manifest: &Manifest) -> u8 {
    (manifest.hold_s / PERIOD.as_secs() + 1e-6).floor().clamp(1.0, 100.0) as u8
}

impl<'a> TaughtTeam<'a> {
    /// Makes the team at its start.
    fn new(setting: Setting<'a>, tasks: Vec<Task>, messages: Messages) -> TaughtTeam<'a> {
        let Setting { scenario, network, channels, .. } = setting;
        let robots = tasks.len();
        let placed = |task: &Task| Motion { position: task.start, velocity: scenario.start_velocity(task) };
        let graphs = Graphs::new(robots, network.inputs(), network.shape().edge);
        TaughtTeam {
            setting,
            motion: tasks.iter().map(placed).collect(),
            tasks: tasks.into_iter().map(Some).collect(),
            after: Span::ZERO,
            sight: Sight::new(channels, robots),
            messages,
            silence: vec![u8::MAX; robots * robots],
            sent: VecDeque::new(),
            graphs: graphs.recurrent(1, network.hop_inputs(), network.shape().memory.is_some(), 0),
            batch: Batch::default(),
            space: Space::default(),
        }
    }

    /// Returns the observation of a robot without values of channels.
    fn own(&self, robot: usize) -> Observation<'static> {
        let task = self.tasks[robot].as_ref().expect("in training every task is known");
        let own = Observation::in_frame(self.setting.scenario.frame(task), task.goal, &self.motion[robot]);
        Observation { elapsed: self.after, ..own }
    }

    /// Records the graph of this step: the robots' observations, and the messages that they receive.
    fn observe(&mut self, stream: &mut Stream) {
        let Setting { manifest, units, .. } = self.setting;
        let (robots, most) = (self.motion.len(), most_age(manifest));
        for robot in 0..robots {
            let own = self.own(robot);
            let (_, to) = self.graphs.source(0);
            entry::write(&manifest.observation, &self.sight.see(own, robot, &self.tasks), to);
            scale(to, &units.observation);
            self.graphs.begins(self.sent.len() == 1);
        }
        for receiver in 0..robots {
            let own = self.motion[receiver];
            for sender in (0..robots).filter(|sender| *sender != receiver) {
                let silence = &mut self.silence[receiver * robots + sender];
                *silence = match self.messages {
                    Messages::Lockstep => 0,
                    Messages::Late(loss) if stream.random_range(0.0..1.0) >= loss => 1,
                    Messages::Late(_) => silence.saturating_add(1),
                };
                let age = *silence;
                if age > most || usize::from(age) >= self.sent.len() {
                    continue;
                }
                let sent = &self.sent[usize::from(age)][sender];
                if (sent.position - own.position).norm_squared() <= manifest.radius_m * manifest.radius_m {
                    let to = self.graphs.edge_of_age(receiver, sender as u16, age);
                    write_features(manifest, &own, (sent, age), to);
                    scale(to, &units.edge);
                }
            }
        }
        self.graphs.end();
    }

    /// Computes the policy's actions in this step, in the units of the network, and records the robots' latents.
    fn act(&mut self) -> Vec<[f32; 2]> {
        let Setting { network, parameters, .. } = self.setting;
        let TaughtTeam { graphs, batch, space, .. } = self;
        let graph = graphs.len() - 1;
        batch.gather(std::iter::once(graphs.window(graph, 1)));
        network.forward(parameters, batch, space);
        graphs.store_latents(graphs.robots, |hop| space.hop_inputs(hop));
        space.outputs().chunks_exact(network.outputs()).map(|output| [output[0], output[1]]).collect()
    }

    /// Returns the expert's actions in the units of the network.
    fn ask(&self, experts: &mut ExpertTeam, stream: &mut Stream) -> Vec<[f32; 2]> {
        let Setting { manifest, units, .. } = self.setting;
        let own: Vec<Observation<'static>> = (0..self.motion.len()).map(|robot| self.own(robot)).collect();
        let state = TeamState { own: &own, motion: &self.motion, tasks: &self.tasks };
        let action = |(velocity, own): (Vec2, &Motion)| {
            let action = match manifest.action {
                Action::Velocity => velocity,
                Action::Acceleration => (velocity - own.velocity) / PERIOD.as_secs() as f32,
            };
            action.to_array().map(|axis| limited(axis, largest(manifest)) / units.action)
        };
        experts.ask(&state, stream).into_iter().zip(&self.motion).map(action).collect()
    }
}

/// Returns the largest component of an action along an axis: a velocity \[m/s\] or an acceleration \[m/s²\].
pub fn largest(manifest: &Manifest) -> f32 {
    match manifest.action {
        Action::Velocity => manifest.limit_m_s,
        Action::Acceleration => MAX_ACCELERATION_M_S2,
    }
}

/// Limits a component of an action to what is `largest`.
pub fn limited(axis: f32, largest: f32) -> f32 {
    axis.clamp(-largest, largest)
}

/// Writes the features of the edge to a robot with the state `own` from one that had the state `sent` when it sent its
/// message, `steps` steps before.
pub fn write_features(manifest: &Manifest, own: &Motion, (sent, steps): (&Motion, u8), row: &mut [f32]) {
    let age_s = (PERIOD * u64::from(steps)).as_secs() as f32;
    write_edge(&manifest.edge, own, (sent, age_s), row);
}

/// Runs the episode with this layout, seed and episode number. If it is to be `taught`, the steps are recorded with the
/// actions of the expert, which may drive then.
pub fn run(
    setting: Setting,
    layout: (u64, u32),
    (driver, messages): (Driver, Messages),
    taught: Taught,
    stream: &mut Stream,
) -> TaughtEpisode {
    let scenario = setting.scenario;
    let tasks = scenario.tasks(layout.0, layout.1);
    let goals = tasks.iter().map(|task| task.goal).collect();
    let mut judge = Judge::new(scenario.rules(), goals).with_cost(scenario.cost());
    let drawn = scenario.drawn_arena(layout.0, layout.1);
    let arena = drawn.as_ref().unwrap_or(scenario.arena());
    let mut experts = (taught == Taught::Yes).then(|| setting.expert.team(scenario, drawn.as_ref()));
    let physics = Physics::published(arena);
    let mut team = TaughtTeam::new(setting, tasks, messages);
    let mut world = World::new(&team.motion);
    let most = usize::from(most_age(setting.manifest));
    let mut taught_all = Vec::new();
    loop {
        team.sent.truncate(most);
        team.sent.push_front(team.motion.clone());
        team.observe(stream);
        let own = team.act();
        let taught = experts.as_mut().map(|experts| team.ask(experts, stream));
        let actions = match (driver, &taught) {
            (Driver::Expert, Some(taught)) => taught,
            _ => &own,
        };
        for _ in 0..setting.repeat {
            let commands: Vec<Vec2> =
                team.motion.iter().zip(actions).map(|(motion, action)| setting.command(motion, *action)).collect();
            team.after = team.after + PERIOD;
            world.step(&arena.at(Some(team.after)), &physics, &commands, &mut team.motion);
        }
        taught_all.extend(taught.into_iter().flatten());
        if let Some(finding) = judge.update(team.after, &world.judged(&team.motion)) {
            return TaughtEpisode { graphs: team.graphs, expert: taught_all, finding };
        }
    }
}

impl Setting<'_> {
    /// Returns the velocity to command \[m/s\] for a robot that moves with `motion`, for an `action` in the units of
    /// the network.
    fn command(&self, motion: &Motion, action: [f32; 2]) -> Vec2 {
        let Manifest { limit_m_s, action: quantity, .. } = *self.manifest;
        let action = Vec2::from(action.map(|axis| limited(axis * self.units.action, largest(self.manifest))));
        let velocity = match quantity {
            Action::Velocity => action,
            Action::Acceleration => motion.velocity + action * PERIOD.as_secs() as f32,
        };
        velocity.map(|axis| axis.clamp(-limit_m_s, limit_m_s))
    }
}

/// True states of a team as the training world keeps them.
struct World {
    position: Vec<Vec2>,
    velocity: Vec<Vec2>,
    contacts: Vec<Contacts>,
    before: Vec<Vec2>,
}

impl World {
    fn new(motion: &[Motion]) -> World {
        let position: Vec<Vec2> = motion.iter().map(|motion| motion.position).collect();
        let velocity = motion.iter().map(|motion| motion.velocity).collect();
        World { before: position.clone(), contacts: vec![Contacts::default(); motion.len()], position, velocity }
    }

    fn step(&mut self, arena: &Arena, physics: &Physics, commands: &[Vec2], motion: &mut [Motion]) {
        let mut team = kinematic::TeamMotion {
            position: &mut self.position,
            velocity: &mut self.velocity,
            wheels: &mut [],
            contacts: &mut self.contacts,
            before: &mut self.before,
        };
        kinematic::step(arena, physics, commands, &mut team);
        for (robot, motion) in motion.iter_mut().enumerate() {
            *motion = Motion { position: self.position[robot], velocity: self.velocity[robot] };
        }
    }

    fn judged(&self, motion: &[Motion]) -> Vec<JudgedRobot> {
        let robot = |(motion, contacts): (&Motion, &Contacts)| JudgedRobot {
            position: motion.position,
            point: motion.position,
            velocity: motion.velocity,
            contacts: *contacts,
        };
        motion.iter().zip(&self.contacts).map(robot).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imitation::config::{Config, PRESET};
    use murmurate::policy::hops::manifest::EdgeFeature;

    #[test]
    fn an_edge_has_the_age_of_its_message() {
        let mut manifest = Config::preset(PRESET).expect("it is a preset").manifest("flocking");
        manifest.edge = vec![EdgeFeature::Age, EdgeFeature::Distance];
        let (own, sent) = (Motion::default(), Motion::at_rest(Vec2::new(3.0, 4.0)));
        let mut row = [f32::NAN; 2];
        write_features(&manifest, &own, (&sent, 3), &mut row);
        assert_eq!(row, [3.0 * PERIOD.as_secs() as f32, 5.0]);
    }
}
