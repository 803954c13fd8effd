//! Rollouts of training by imitation: a team drives an episode, by the policy or by the expert, and the expert says
//! what it would do in each step.
//!
//! The dynamics are those of `world::kinematic`, and messages are as old as in a run: of the same step if robots step
//! together, otherwise of the step before or, where messages were lost, of an earlier one.

use std::collections::VecDeque;

use rand::RngExt;

use crate::batch::Batch;
use crate::graphs::Graphs;
use crate::network::{Network, Space};
use murmurate::messages::geometry::{Motion, Planar, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::observation::Observation;
use murmurate::policy::flock::MAX_ACCELERATION_M_S2;
use murmurate::policy::hops::entry;
use murmurate::policy::hops::hop::write_edge;
use murmurate::policy::hops::manifest::Manifest;
use murmurate::policy::{Model, Neighbour, Policy};
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
    pub expert: &'a Model,
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
    /// Acceleration \[m/s²\] of the expert for each robot in each step; empty if the steps were not to be learnt.
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
    tasks: Vec<Task>,
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

impl TaughtTeam<'_> {
    fn observation(&self, robot: usize) -> Observation<'static> {
        self.setting.scenario.observe(&self.tasks[robot], &self.motion[robot])
    }

    /// Records the graph of this step: the robots' observations, and the messages that they receive.
    fn observe(&mut self, stream: &mut Stream) {
        let Setting { manifest, .. } = self.setting;
        let (robots, most) = (self.motion.len(), most_age(manifest));
        for robot in 0..robots {
            let seen = self.observation(robot);
            let (_, to) = self.graphs.source();
            entry::write(&manifest.observation, &seen, to);
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
                }
            }
        }
        self.graphs.end();
    }

    /// Computes the policy's accelerations \[m/s²\] in this step, and records the robots' latents.
    fn act(&mut self) -> Vec<[f32; 2]> {
        let Setting { network, parameters, .. } = self.setting;
        let TaughtTeam { graphs, batch, space, .. } = self;
        let graph = graphs.len() - 1;
        batch.gather(std::iter::once(graphs.window(graph, 1)));
        network.forward(parameters, batch, space);
        graphs.store_latents(graphs.robots, |hop| space.hop_inputs(hop));
        space.outputs().chunks_exact(network.outputs()).map(|output| [output[0], output[1]]).collect()
    }

    /// Returns the expert's accelerations \[m/s²\]: robots step together, and messages of this step are received within
    /// the expert's radius.
    fn ask(&self, expert: &mut dyn Policy, stream: &mut Stream) -> Vec<[f32; 2]> {
        let (interface, robots) = (expert.interface(), self.motion.len());
        let latents: Vec<Vec<f32>> = (0..robots)
            .map(|robot| {
                let mut features = vec![0.0; interface.features];
                expert.encode(&self.observation(robot), &mut features);
                features
            })
            .collect();
        let radius = interface.radius_m;
        let acceleration = |robot: usize| {
            let own = self.motion[robot];
            let near = |other: &usize| {
                let square = (self.motion[*other].position - own.position).norm_squared();
                *other != robot && square <= radius * radius
            };
            let neighbour =
                |other: usize| Neighbour { motion: self.motion[other], features: &latents[other], age: Span::ZERO };
            let neighbours: Vec<Neighbour> = (0..robots).filter(near).map(neighbour).collect();
            let velocity = expert.act(&self.observation(robot), &latents[robot], &neighbours, stream);
            ((velocity - own.velocity) / PERIOD.as_secs() as f32).to_array().map(limited)
        };
        (0..robots).map(acceleration).collect()
    }
}

/// Limits an acceleration along one axis \[m/s²\].
pub fn limited(axis: f32) -> f32 {
    axis.clamp(-MAX_ACCELERATION_M_S2, MAX_ACCELERATION_M_S2)
}

/// Writes the features of the edge to a robot with the state `own` from one that had the state `sent` when it sent its
/// message, `steps` steps before.
pub fn write_features(manifest: &Manifest, own: &Motion, (sent, steps): (&Motion, u8), row: &mut [f32]) {
    let age_s = (PERIOD * u64::from(steps)).as_secs() as f32;
    write_edge(&manifest.edge, own, (sent, age_s), row);
}

/// Runs the episode with this layout, seed and episode number. With `expert` given, the steps are recorded with its
/// actions.
pub fn run(
    setting: Setting,
    layout: (u64, u32),
    (driver, messages): (Driver, Messages),
    mut expert: Option<Box<dyn Policy>>,
    stream: &mut Stream,
) -> TaughtEpisode {
    let scenario = setting.scenario;
    let tasks = scenario.tasks(layout.0, layout.1);
    let robots = tasks.len();
    let placed = |task: &Task| Motion { position: task.start, velocity: scenario.start_velocity(task) };
    let motion: Vec<Motion> = tasks.iter().map(placed).collect();
    let goals = tasks.iter().map(|task| task.goal).collect();
    let mut judge = Judge::new(scenario.rules(), goals).with_cost(scenario.cost());
    let drawn = scenario.drawn_arena(layout.0, layout.1);
    if let (Some(arena), Some(expert)) = (&drawn, &mut expert) {
        expert.enter(arena);
    }
    let arena = drawn.as_ref().unwrap_or(scenario.arena());
    let physics = Physics::published(arena);
    let mut world = World::new(&motion);
    let most = usize::from(most_age(setting.manifest));
    let Setting { network, .. } = setting;
    let graphs = Graphs::new(robots, network.inputs(), network.shape().edge);
    let mut team = TaughtTeam {
        setting,
        tasks,
        motion,
        messages,
        silence: vec![u8::MAX; robots * robots],
        sent: VecDeque::new(),
        graphs: graphs.recurrent(1, network.hop_inputs(), network.shape().memory.is_some(), 0),
        batch: Batch::default(),
        space: Space::default(),
    };
    let (mut taught_all, mut after) = (Vec::new(), Span::ZERO);
    loop {
        team.sent.truncate(most);
        team.sent.push_front(team.motion.clone());
        team.observe(stream);
        let own = team.act();
        let taught = expert.as_mut().map(|expert| team.ask(&mut **expert, stream));
        let accelerations = match (driver, &taught) {
            (Driver::Expert, Some(taught)) => taught,
            _ => &own,
        };
        let limit = setting.manifest.limit_m_s;
        let command = |(motion, acceleration): (&Motion, &[f32; 2])| {
            let change = Vec2::from(acceleration.map(limited)) * PERIOD.as_secs() as f32;
            (motion.velocity + change).map(|axis| axis.clamp(-limit, limit))
        };
        let commands: Vec<Vec2> = team.motion.iter().zip(accelerations).map(command).collect();
        taught_all.extend(taught.into_iter().flatten());
        world.step(arena, &physics, &commands, &mut team.motion);
        after = after + PERIOD;
        if let Some(finding) = judge.update(after, &world.judged(&team.motion)) {
            return TaughtEpisode { graphs: team.graphs, expert: taught_all, finding };
        }
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
    use crate::imitation::config::Config;
    use murmurate::policy::hops::manifest::EdgeFeature;

    #[test]
    fn an_edge_has_the_age_of_its_message() {
        let mut manifest = Config::preset().manifest("flocking");
        manifest.edge = vec![EdgeFeature::Age, EdgeFeature::Distance];
        let (own, sent) = (Motion::default(), Motion::at_rest(Vec2::new(3.0, 4.0)));
        let mut row = [f32::NAN; 2];
        write_features(&manifest, &own, (&sent, 3), &mut row);
        assert_eq!(row, [3.0 * PERIOD.as_secs() as f32, 5.0]);
    }
}
