//! Rollouts of training by imitation: a team drives an episode, by the policy or by the expert, and the expert says
//! what it would do in each step.
//!
//! The dynamics are those of `world::kinematic`, and messages are as old as in a run: of the same step if robots step
//! together, otherwise of the step before or, where messages were lost, of an earlier one.

use std::collections::VecDeque;

use rand::RngExt;

use super::graph::Graph;
use super::network::{Space, TrainableHops};
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
    pub network: &'a TrainableHops,
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

/// States, messages and the expert's actions at one step of a team.
#[derive(Clone, Debug, Default)]
pub struct Step {
    /// State of each robot, world frame.
    pub motion: Vec<Motion>,
    /// Index of each robot's first message, and last the number of messages.
    pub first: Vec<u32>,
    /// Sender of each message, and its age in steps, grouped by receivers in the order of their ids.
    pub heard: Vec<(u16, u8)>,
    /// Acceleration \[m/s²\] of the expert for each robot.
    pub expert: Vec<[f32; 2]>,
}

/// Episode of one team.
#[derive(Clone, Debug)]
pub struct TaughtEpisode {
    /// Steps of the episode in their order; empty if they were not to be learnt.
    pub steps: Vec<Step>,
    /// Verdict, cost and smallest distance of robots.
    pub finding: Judgement,
}

/// Messages of all robots at one step: their states, and their inputs of every hop.
#[derive(Debug, Default)]
struct Sent {
    motion: Vec<Motion>,
    inputs: Vec<Vec<f32>>,
}

/// Team in an episode.
struct TaughtTeam<'a> {
    setting: Setting<'a>,
    tasks: Vec<Task>,
    motion: Vec<Motion>,
    messages: Messages,
    /// For each receiver and sender, the number of steps since a message was received; `u8::MAX` for none.
    silence: Vec<u8>,
    /// Messages of this step and of those before it, the newest first.
    sent: VecDeque<Sent>,
    graph: Graph<f32>,
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

    /// Receives the messages of this step: who heard whom, and how old it is. Returns index and messages by receivers.
    fn receive(&mut self, stream: &mut Stream) -> (Vec<u32>, Vec<(u16, u8)>) {
        let (robots, most) = (self.motion.len(), most_age(self.setting.manifest));
        let radius = self.setting.manifest.radius_m;
        let (mut first, mut heard) = (vec![0], Vec::new());
        for receiver in 0..robots {
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
                let from = self.sent[usize::from(age)].motion[sender].position;
                if (from - self.motion[receiver].position).norm_squared() <= radius * radius {
                    heard.push((sender as u16, age));
                }
            }
            first.push(heard.len() as u32);
        }
        (first, heard)
    }

    /// Computes the policy's accelerations \[m/s²\] from the messages that were received.
    fn act(&mut self, first: &[u32], heard: &[(u16, u8)]) -> Vec<[f32; 2]> {
        let Setting { manifest, network, parameters, .. } = self.setting;
        let (robots, mut observations) = (self.motion.len(), Vec::new());
        for robot in 0..robots {
            let seen = self.observation(robot);
            entry::append(&manifest.observation, &seen, &mut observations);
        }
        let mut hidden = network.encode(parameters, &observations, &mut self.space).to_vec();
        self.graph.clear();
        let mut edge = vec![0.0; network.edge()];
        for receiver in 0..robots {
            for (sender, age) in &heard[first[receiver] as usize..first[receiver + 1] as usize] {
                let sent = &self.sent[usize::from(*age)];
                let motion = &sent.motion[usize::from(*sender)];
                write_features(manifest, &self.motion[receiver], (motion, *age), &mut edge);
                self.graph.edges.extend_from_slice(&edge);
                self.graph.sender.push(u32::from(*age) * robots as u32 + u32::from(*sender));
            }
            self.graph.end_node();
        }
        for hop in 0..network.hops() {
            self.sent[0].inputs.push(hidden);
            let (sent, width) = (&self.sent, self.sent[0].inputs[hop].len() / robots);
            let input = |at: usize| &sent[at / robots].inputs[hop][at % robots * width..][..width];
            let own = &sent[0].inputs[hop];
            hidden = network.hop(hop, parameters, own, input, &self.graph, &mut self.space).to_vec();
        }
        let outputs = network.decode(parameters, &hidden, &mut self.space);
        outputs.chunks_exact(network.outputs()).map(|output| [output[0], output[1]]).collect()
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
    let age = PERIOD * u64::from(steps);
    write_edge(&manifest.edge, own, &Neighbour { motion: *sent, features: &[], age }, row);
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
    let (mut graph, silence) = (Graph::default(), vec![u8::MAX; robots * robots]);
    graph.clear();
    let (sent, space) = (VecDeque::new(), Space::default());
    let mut team = TaughtTeam { setting, tasks, motion, messages, silence, sent, graph, space };
    let (mut steps, mut after) = (Vec::new(), Span::ZERO);
    loop {
        team.sent.truncate(most);
        team.sent.push_front(Sent { motion: team.motion.clone(), inputs: Vec::new() });
        let (first, heard) = team.receive(stream);
        let own = (driver == Driver::Policy).then(|| team.act(&first, &heard));
        let taught = expert.as_mut().map(|expert| team.ask(&mut **expert, stream));
        let accelerations = own.as_ref().or(taught.as_ref()).expect("an episode that an expert drives has one");
        let limit = setting.manifest.limit_m_s;
        let command = |(motion, acceleration): (&Motion, &[f32; 2])| {
            let change = Vec2::from(acceleration.map(limited)) * PERIOD.as_secs() as f32;
            (motion.velocity + change).map(|axis| axis.clamp(-limit, limit))
        };
        let commands: Vec<Vec2> = team.motion.iter().zip(accelerations).map(command).collect();
        if let Some(expert) = taught {
            steps.push(Step { motion: team.motion.clone(), first, heard, expert });
        }
        world.step(arena, &physics, &commands, &mut team.motion);
        after = after + PERIOD;
        if let Some(finding) = judge.update(after, &world.judged(&team.motion)) {
            return TaughtEpisode { steps, finding };
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
