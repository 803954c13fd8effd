//! Decisions of many teams: observed, drawn from the policy, carried out, recorded.
//!
//! A chunk of teams goes through all its decisions by itself, so chunks run on as many threads as there are, and
//! the record is the same on any number: every chunk draws from its own stream.

use std::sync::Arc;

use super::batch::{Batch, Graphs};
use super::config::{Config, Reward};
use super::crowd::Crowd;
use super::network::{Network, Space};
use super::observe::{self, Privileged};
use super::radio::MEMORY;
use super::record::{After, Ended, HALF_LOG_TWO_PI, Record};
use crate::messages::geometry::{Motion, Vec2};
use crate::policy::Draw;
use crate::policy::manifest::EdgeField;
use crate::random;
use crate::random::Stream;
use crate::scenario::Scenario;

/// Rows that go through a network at once: their activations stay in a core's own cache.
pub const CHUNK: usize = 32;

/// What is the same for all chunks.
#[derive(Debug)]
pub struct Rules<'a> {
    /// The configuration.
    pub config: &'a Config,
    /// The policy's network.
    pub actor: &'a Network,
    /// The critic's.
    pub critic: &'a Network,
    /// What a robot earns.
    pub reward: Reward,
    /// World steps that an action is held.
    pub repeat: u32,
    /// Cap on the log standard deviation.
    pub log_std_max: f32,
}

/// Some rows of teams.
#[derive(Debug)]
pub struct Chunk {
    /// The teams.
    pub crowd: Crowd,
    /// How many rows.
    pub rows: usize,
    /// Robots of a row.
    pub robots: usize,
    /// What they did.
    pub record: Record,
    batch: Batch<f32>,
    space: Space<f32>,
    steered: Vec<Vec2>,
    earned: Vec<f32>,
    /// By sender and step of the past: its source in the graph being made.
    sources: Vec<Option<u16>>,
}

impl Chunk {
    /// Rows of teams, none of them started.
    pub fn new(rows: usize, groups: &[Vec<usize>], scenarios: &[Arc<dyn Scenario>], rules: &Rules) -> Chunk {
        let crowd = Crowd::new(rows, groups, scenarios);
        let robots = crowd.position.len() / rows;
        let (actor, critic) = (rules.actor, rules.critic);
        let record = Record {
            actor: Graphs::new(robots, actor.inputs(), actor.shape().edge),
            critic: Graphs::new(robots, critic.inputs(), critic.shape().edge),
            ..Record::default()
        };
        Chunk {
            steered: vec![Vec2::zeros(); rows * robots],
            earned: vec![0.0; rows * robots],
            crowd,
            rows,
            robots,
            record,
            batch: Batch::default(),
            space: Space::default(),
            sources: Vec::new(),
        }
    }

    /// Starts an episode of every team.
    pub fn start(&mut self, rules: &Rules, stream: &mut Stream) {
        (0..self.crowd.teams.len()).for_each(|team| self.crowd.start(team, &rules.config.conditions, stream));
    }

    /// Makes and records so many decisions of every row, then estimates all values.
    pub fn collect(&mut self, rules: &Rules, actor: &[f32], critic: &[f32], decisions: usize, stream: &mut Stream) {
        self.record.clear();
        let mut beyond = Graphs::new(self.robots, rules.critic.inputs(), rules.critic.shape().edge);
        let gamma = rules.config.ppo.gamma;
        for decision in 0..decisions {
            for team in 0..self.crowd.teams.len() {
                self.observe(rules, team, stream);
            }
            for row in 0..self.rows {
                self.observe_all(rules, row, None);
            }
            self.decide(rules, actor, decision * self.rows..(decision + 1) * self.rows);
            self.draw(rules, stream);
            self.earned.fill(0.0);
            for team in 0..self.crowd.teams.len() {
                let mut worth = 1.0;
                for _ in 0..rules.repeat {
                    self.step(rules, team, stream);
                    for robot in self.crowd.teams[team].range() {
                        self.earned[robot] += worth * self.crowd.earned[robot];
                    }
                    worth *= gamma;
                    if self.crowd.all_arrived(team) {
                        break;
                    }
                }
            }
            self.record.reward.extend_from_slice(&self.earned);
            self.end_episodes(rules, &mut beyond, stream);
        }
        for row in 0..self.rows {
            self.observe_all(rules, row, None);
        }
        // The last states come behind the decisions, and what cut episodes ended in behind those.
        self.record.critic.append(&beyond);
        self.estimate(rules, critic);
    }

    /// A decision of every row outside of any record: for one that only runs the policy.
    pub fn decide_alone(&mut self, rules: &Rules, actor: &[f32], draw: Draw, stream: &mut Stream) {
        self.record.clear();
        for team in 0..self.crowd.teams.len() {
            self.observe(rules, team, stream);
        }
        self.decide(rules, actor, 0..self.rows);
        match draw {
            Draw::Sample => self.draw(rules, stream),
            Draw::Mean => {
                for (steered, out) in self.steered.iter_mut().zip(self.space.outputs().chunks_exact(4)) {
                    *steered = Vec2::new(out[0], out[1]);
                }
                self.steer();
            }
        }
    }

    /// Carries out a team's decision for one step.
    pub fn step(&mut self, rules: &Rules, team: usize, stream: &mut Stream) {
        let limit = rules.config.policy.limit_m_s;
        self.crowd.step(team, &self.steered, &rules.reward, limit, stream);
    }

    /// One team's observation, into its row's graph of the policy. Teams come in order, so rows fill up.
    fn observe(&mut self, rules: &Rules, team: usize, stream: &mut Stream) {
        let Chunk { crowd, record, robots, .. } = self;
        let fields = &rules.config.policy.observation;
        let (range, step) = (crowd.teams[team].range(), crowd.teams[team].step);
        if range.start.is_multiple_of(*robots) {
            // All own observations of a row come before everything else.
            let row = range.start..range.start + *robots;
            let mut at = team;
            for robot in row {
                while !crowd.teams[at].range().contains(&robot) {
                    at += 1;
                }
                if robot == crowd.teams[at].first && crowd.teams[at].episode.lockstep {
                    crowd.measure(at, stream);
                }
                let estimate = crowd.estimate(at, robot);
                let (_, to) = record.actor.source();
                observe::own(fields, crowd.scenario(at), &crowd.tasks[robot], &estimate, to);
            }
        }
        let offset = range.start % *robots;
        let mut radio = std::mem::take(&mut crowd.teams[team].radio);
        self.sources.clear();
        self.sources.resize(range.len() * MEMORY, None);
        for receiver in 0..range.len() {
            let (tasks, graphs, sources) = (&crowd.tasks, &mut record.actor, &mut self.sources);
            let episode = &crowd.teams[team].episode;
            radio.hear(episode, rules.config.policy.radius_m, step, receiver, stream, |radio, heard| {
                let spoken = radio.estimate(heard.step, heard.sender);
                let source = if heard.step == step {
                    (offset + heard.sender) as u16
                } else {
                    let at = heard.sender * MEMORY + heard.step as usize % MEMORY;
                    *sources[at].get_or_insert_with(|| {
                        let (source, to) = graphs.source();
                        let task = &tasks[range.start + heard.sender];
                        observe::own(fields, crowd.scenario(team), task, &spoken, to);
                        source
                    })
                };
                let own = radio.estimate(step, receiver);
                let frame = crowd.scenario(team).frame(&tasks[range.start + receiver]);
                let away = frame.turn(spoken.position - own.position);
                let mut to = graphs.edge(offset + receiver, source);
                for field in &rules.config.policy.edge {
                    let (here, rest) = to.split_at_mut(field.floats());
                    match field {
                        EdgeField::Age => here[0] = heard.age_s,
                        EdgeField::RelativePosition => here.copy_from_slice(&away.to_array()),
                    }
                    to = rest;
                }
            });
        }
        crowd.teams[team].radio = radio;
        if range.end.is_multiple_of(*robots) {
            record.actor.end();
        }
    }

    /// A row's true state, into a graph of the critic: of the record, or `beyond` it.
    fn observe_all(&mut self, rules: &Rules, row: usize, beyond: Option<&mut Graphs>) {
        let Chunk { crowd, record, robots, .. } = self;
        let graphs = beyond.unwrap_or(&mut record.critic);
        let fields = &rules.config.policy.observation;
        let range = row * *robots..(row + 1) * *robots;
        let first = crowd.teams.partition_point(|team| team.first < range.start);
        let teams = first..crowd.teams.partition_point(|team| team.first < range.end);
        for team in teams.clone() {
            let (delay_s, loss) = crowd.teams[team].episode.mean_edge();
            for robot in crowd.teams[team].range() {
                let truth = Motion { position: crowd.position[robot], velocity: crowd.velocity[robot] };
                let (_, to) = graphs.source();
                let (own, more) = to.split_at_mut(2 * fields.len());
                observe::own(fields, crowd.scenario(team), &crowd.tasks[robot], &truth, own);
                let privileged = Privileged {
                    stage: crowd.stage[robot],
                    arrived: crowd.arrived[robot],
                    passed: crowd.elapsed_s(team) / rules.config.episode_s,
                    to_go_m: crowd.to_go_m[robot],
                    lag_s: crowd.teams[team].episode.lag_s.unwrap_or(0.0),
                    delay_s,
                    loss,
                    judged: crowd.is_judged(team),
                };
                privileged.write(more);
            }
        }
        for team in teams {
            let members = crowd.teams[team].range();
            for robot in members.clone() {
                let frame = crowd.scenario(team).frame(&crowd.tasks[robot]);
                for other in members.clone().filter(|&other| other != robot) {
                    let away = frame.turn(crowd.position[other] - crowd.position[robot]);
                    let to = graphs.edge(robot - range.start, (other - range.start) as u16);
                    to.copy_from_slice(&away.to_array());
                }
            }
        }
        graphs.end();
    }

    /// Runs the policy's network over these graphs.
    fn decide(&mut self, rules: &Rules, actor: &[f32], graphs: std::ops::Range<usize>) {
        self.batch.gather(graphs.map(|graph| (&self.record.actor, graph)));
        rules.actor.forward(actor, &self.batch, &mut self.space);
    }

    /// Draws every robot's action and turns it into the world frame.
    fn draw(&mut self, rules: &Rules, stream: &mut Stream) {
        for (robot, out) in self.space.outputs().chunks_exact(4).enumerate() {
            let mut action = [0.0; 2];
            let mut log_density = 0.0;
            let units = random::normals(stream);
            for axis in 0..2 {
                let log_std = out[2 + axis].min(rules.log_std_max);
                let unit = units[axis] as f32;
                action[axis] = out[axis] + unit * libm::expf(log_std);
                log_density -= 0.5 * unit * unit + log_std + HALF_LOG_TWO_PI;
            }
            self.record.action.push(action);
            self.record.log_density.push(log_density);
            self.steered[robot] = Vec2::from(action);
        }
        self.steer();
    }

    /// Turns `steered` from the policies' frames into the world's.
    fn steer(&mut self) {
        for team in 0..self.crowd.teams.len() {
            for robot in self.crowd.teams[team].range() {
                let velocity = self.steered[robot];
                self.steered[robot] = self.crowd.scenario(team).steer(&self.crowd.tasks[robot], velocity);
            }
        }
    }

    /// Notes what came after the decisions, and starts the next episode of teams that are through.
    fn end_episodes(&mut self, rules: &Rules, beyond: &mut Graphs, stream: &mut Stream) {
        let base = self.record.after.len();
        self.record.after.resize(base + self.rows * self.robots, After::On);
        for team in 0..self.crowd.teams.len() {
            let (done, range) = (self.crowd.all_arrived(team), self.crowd.teams[team].range());
            let cut = !done && self.crowd.elapsed_s(team) >= rules.config.episode_s;
            if !done && !cut {
                continue;
            }
            let mut after = After::Done;
            if cut {
                after = After::Cut(beyond.len() as u32);
                self.observe_all(rules, range.start / self.robots, Some(beyond));
            }
            for robot in range {
                self.record.after[base + robot] = after;
            }
            let team_of = &self.crowd.teams[team];
            self.record.ended.add(&Ended {
                episodes: 1,
                clean: u32::from(done && !team_of.touched),
                arrived: u32::from(done),
                length_s: self.crowd.elapsed_s(team),
                earned: team_of.earned,
            });
            self.crowd.start(team, &rules.config.conditions, stream);
        }
    }

    /// Every value of the record.
    fn estimate(&mut self, rules: &Rules, critic: &[f32]) {
        self.record.value.clear();
        let graphs = self.record.critic.len();
        for from in (0..graphs).step_by(CHUNK) {
            let chunk = from..graphs.min(from + CHUNK);
            self.batch.gather(chunk.map(|graph| (&self.record.critic, graph)));
            rules.critic.forward(critic, &self.batch, &mut self.space);
            self.record.value.extend_from_slice(self.space.outputs());
        }
        let gamma = rules.config.ppo.gamma.powi(rules.repeat as i32);
        self.record.weigh(self.rows * self.robots, gamma, gamma * rules.config.ppo.lambda);
    }
}
