//! Rollouts: decisions of many teams, from the observation to the recorded action and reward.
//!
//! A chunk of teams makes its decisions independently of other chunks and draws from its own random stream. So the
//! recorded data does not depend on the number of threads.

use std::sync::Arc;

use super::batch::Batch;
use super::channels::Perception;
use super::environments::{Environments, TrainingTeam};
use super::experts::Experts;
use super::graphs::{Graphs, Window};
use super::message_buffer::HISTORY_STEPS;
use super::network::{Space, TeamSpace};
use super::observe::{PRIVILEGED, Privileged};
use super::record::{EpisodeState, EpisodeTotals, Experience, HALF_LOG_TWO_PI};
pub use super::settings::{CHUNK, RolloutSettings};
use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::policy::Draw;
use murmurate::policy::hops::hop::write_edge;
use murmurate::random;
use murmurate::random::Stream;
use murmurate::scenario::Scenario;

/// Rows of teams that are simulated together, with their rollout data. A row has the robots of one environment.
#[derive(Debug)]
pub struct Chunk {
    /// Training environments of the chunk's teams.
    pub environments: Environments,
    /// Number of rows (environments) in the chunk.
    pub rows: usize,
    /// Number of robots in a row (environment).
    pub robots: usize,
    /// Decisions of the chunk's rows since the last update.
    pub record: Experience,
    batch: Batch<f32>,
    space: TeamSpace<f32>,
    critic_space: Space<f32>,
    /// Actions of the current decision \[m/s\], world frame.
    velocities: Vec<Vec2>,
    /// Rewards of all robots for the current decision.
    rewards: Vec<f32>,
    /// Discount of each team's next reward for the current decision.
    discounts: Vec<f32>,
    /// Source in the unfinished graph for each sender and past step; `None` if there is none yet.
    sources: Vec<Option<u16>>,
}

impl Chunk {
    /// Makes a chunk of `rows` rows whose episodes are not started. Each entry of `groups` lists the team sizes of one
    /// row; rows take the entries in turn. `scenarios` has a scenario for each of these sizes, and `perceptions` the
    /// observations of the configuration, joined with them.
    pub fn new(
        rows: usize,
        groups: &[Vec<usize>],
        (scenarios, perceptions): (&[Arc<dyn Scenario>], Vec<Perception>),
        settings: &RolloutSettings,
    ) -> Chunk {
        let environments = Environments::new(rows, groups, scenarios).equipped(&settings.config.chassis());
        let environments = environments.in_roles(perceptions, settings.config.role_of_robots());
        let robots = environments.position.len() / rows;
        let (actor, critic) = (settings.actor, settings.critic);
        let mut graphs = Graphs::new(robots, actor.inputs(), actor.edge_inputs());
        if actor.is_recurrent() {
            graphs = graphs.recurrent(rows, actor.hop_inputs(), actor.has_memory(), HISTORY_STEPS);
        }
        let record = Experience {
            rows,
            steps: settings.policy_steps() as usize,
            actor: graphs,
            critic: Graphs::new(robots, critic.inputs(), critic.shape().edge),
            ..Experience::default()
        };
        Chunk {
            velocities: vec![Vec2::zeros(); rows * robots],
            rewards: vec![0.0; rows * robots],
            discounts: Vec::new(),
            environments,
            rows,
            robots,
            record,
            batch: Batch::default(),
            space: TeamSpace::default(),
            critic_space: Space::default(),
            sources: Vec::new(),
        }
    }

    /// Starts an episode of every team with conditions and layout drawn from `stream`.
    pub fn start(&mut self, settings: &RolloutSettings, stream: &mut Stream) {
        (0..self.environments.teams.len())
            .for_each(|team| self.environments.start(team, &settings.config.conditions, stream));
    }

    /// Makes and records `decisions` decisions of every row, then computes the values and advantages of all. `actor`
    /// and `critic` are the weights and biases of both networks.
    pub fn collect(
        &mut self,
        settings: &RolloutSettings,
        actor: &[f32],
        critic: &[f32],
        decisions: usize,
        stream: &mut Stream,
    ) {
        self.record.clear();
        let teams = self.environments.teams.len();
        let mut experts = settings.expert.map(|taught| Experts::new(taught.experts, teams));
        let mut truncated = Graphs::new(self.robots, settings.critic.inputs(), settings.critic.shape().edge);
        for _ in 0..decisions {
            self.observe(settings, stream);
            for row in 0..self.rows {
                self.observe_critic(settings, row, None);
            }
            self.evaluate(settings, actor, true);
            self.draw(settings, stream);
            if let Some(experts) = &mut experts {
                let taught = experts.ask(&self.environments, settings.config.policy.limit_m_s, stream);
                self.record.taught.extend(taught);
            }
            self.act(settings, actor, stream);
            self.record.reward.extend_from_slice(&self.rewards);
            self.end_episodes(settings, &mut truncated, stream);
        }
        for row in 0..self.rows {
            self.observe_critic(settings, row, None);
        }
        // Each row's last state comes after the decisions, and the last states of truncated episodes come after those.
        self.record.critic.append(&truncated);
        self.compute_values(settings, critic);
    }

    /// Makes one decision of every row without recording it, for an evaluation. `actor` are the weights and biases of
    /// the policy's network, and `draw` is the method of drawing actions.
    pub fn decide_unrecorded(&mut self, settings: &RolloutSettings, actor: &[f32], draw: Draw, stream: &mut Stream) {
        self.record.clear();
        self.observe(settings, stream);
        self.evaluate(settings, actor, true);
        match draw {
            Draw::Sample => self.draw(settings, stream),
            Draw::Mean => {
                for (velocity, out) in self.velocities.iter_mut().zip(self.space.outputs().chunks_exact(4)) {
                    *velocity = Vec2::new(out[0], out[1]);
                }
                self.transform_to_world();
            }
        }
    }

    /// Performs the actions of the last decision, and sums up their rewards.
    fn act(&mut self, settings: &RolloutSettings, actor: &[f32], stream: &mut Stream) {
        let (steps, gamma) = (settings.policy_steps(), settings.config.ppo.gamma);
        self.rewards.fill(0.0);
        self.discounts.clear();
        self.discounts.resize(self.environments.teams.len(), 1.0);
        for policy_step in 0..steps {
            if policy_step > 0 {
                self.observe(settings, stream);
                self.evaluate(settings, actor, false);
            }
            for team in 0..self.environments.teams.len() {
                for _ in 0..settings.repeat / steps {
                    if policy_step > 0 && self.environments.all_arrived(team) {
                        break;
                    }
                    self.step(settings, team, stream);
                    for robot in self.environments.teams[team].range() {
                        self.rewards[robot] += self.discounts[team] * self.environments.reward[robot];
                    }
                    self.discounts[team] *= gamma;
                    if self.environments.all_arrived(team) {
                        break;
                    }
                }
            }
        }
    }

    /// Advances the team with index `team` by one step of 50 ms, with the actions of its last decision.
    pub fn step(&mut self, settings: &RolloutSettings, team: usize, stream: &mut Stream) {
        let limit = settings.config.policy.limit_m_s;
        self.environments.step(team, &self.velocities, &settings.reward, limit, stream);
    }

    /// Adds the observations and edges of all teams to the policy's graphs, one for each row.
    fn observe(&mut self, settings: &RolloutSettings, stream: &mut Stream) {
        (0..self.environments.teams.len()).for_each(|team| self.observe_team(settings, team, stream));
    }

    /// Adds a team's observations and edges to the policy's graph of the team's row. Must be called for all teams in
    /// order: the first team of a row begins the graph, and the last one completes it.
    fn observe_team(&mut self, settings: &RolloutSettings, team: usize, stream: &mut Stream) {
        let Chunk { environments, record, robots, .. } = self;
        let recurrent = settings.actor.is_recurrent();
        let (range, step) = (environments.teams[team].range(), environments.teams[team].step);
        if range.start.is_multiple_of(*robots) {
            // The current observations of all robots of a row are its first sources.
            let row = range.start..range.start + *robots;
            let mut at = team;
            for robot in row {
                while !environments.teams[at].range().contains(&robot) {
                    at += 1;
                }
                if robot == environments.teams[at].first && environments.teams[at].episode.lockstep {
                    environments.measure(at, stream);
                }
                let TrainingTeam { first, step, messages, .. } = &environments.teams[at];
                let (_, to) = record.actor.source(environments.role(robot - first));
                environments.observation(at, messages, (*step, robot - first), to);
                if recurrent {
                    record.actor.begins(*step == 0);
                }
            }
        }
        let offset = range.start % *robots;
        let mut messages = std::mem::take(&mut environments.teams[team].messages);
        self.sources.clear();
        self.sources.resize(range.len() * HISTORY_STEPS, None);
        for receiver in 0..range.len() {
            let (frames, graphs, sources) = (&environments.frame, &mut record.actor, &mut self.sources);
            let episode = &environments.teams[team].episode;
            let reach = (episode, settings.config.policy.radius_m);
            messages.receive(reach, (step, 0), receiver, stream, |messages, message| {
                let sent = messages.estimate(message.step, message.sender);
                let source = if message.step == step || recurrent {
                    (offset + message.sender) as u16
                } else {
                    let at = message.sender * HISTORY_STEPS + message.step as usize % HISTORY_STEPS;
                    *sources[at].get_or_insert_with(|| {
                        let (source, to) = graphs.source(environments.role(message.sender));
                        environments.observation(team, messages, (message.step, message.sender), to);
                        source
                    })
                };
                let frame = frames[range.start + receiver];
                let [own, sent] = [messages.estimate(step, receiver), sent].map(|motion| frame.turn_motion(&motion));
                let receiver = offset + receiver;
                let to = match recurrent {
                    true => graphs.edge_of_age(receiver, source, (step - message.step) as u8),
                    false => graphs.edge(receiver, source),
                };
                write_edge(&settings.config.policy.edge, &own, (&sent, message.age_s), to);
            });
        }
        environments.teams[team].messages = messages;
        if range.end.is_multiple_of(*robots) {
            record.actor.end();
        }
    }

    /// Adds the true state of a row as a graph of the critic: to `other` if given, else to the chunk's record.
    fn observe_critic(&mut self, settings: &RolloutSettings, row: usize, other: Option<&mut Graphs>) {
        let Chunk { environments, record, robots, .. } = self;
        let graphs = other.unwrap_or(&mut record.critic);
        let range = row * *robots..(row + 1) * *robots;
        let first = environments.teams.partition_point(|team| team.first < range.start);
        let teams = first..environments.teams.partition_point(|team| team.first < range.end);
        for team in teams.clone() {
            let (delay_s, loss) = environments.teams[team].episode.mean_edge();
            for robot in environments.teams[team].range() {
                let (_, to) = graphs.source(0);
                let (to, roles) = to.split_at_mut(to.len() - settings.config.roles.len());
                let role = environments.role(robot - environments.teams[team].first);
                roles.iter_mut().skip(role.into()).take(1).for_each(|role| *role = 1.0);
                let (own, more) = to.split_at_mut(to.len() - PRIVILEGED);
                environments.true_observation(team, robot, own);
                let privileged = Privileged {
                    stage: environments.stage[robot],
                    arrived: environments.arrived[robot],
                    passed: environments.elapsed_s(team) / settings.config.episode_s,
                    to_go_m: environments.to_go_m[robot],
                    lag_s: environments.teams[team].episode.lag_s.unwrap_or(0.0),
                    delay_s,
                    loss,
                    judged: environments.is_judged(team),
                };
                privileged.write(more);
            }
        }
        for team in teams {
            let members = environments.teams[team].range();
            for robot in members.clone() {
                let frame = environments.frame[robot];
                for other in members.clone().filter(|&other| other != robot) {
                    let relative = frame.turn(environments.position[other] - environments.position[robot]);
                    let to = graphs.edge(robot - range.start, (other - range.start) as u16);
                    to.copy_from_slice(&relative.to_array());
                }
            }
        }
        graphs.end();
    }

    /// Runs the policy's network on the last graph of each row; up to its outputs if these are needed, otherwise up to
    /// what robots send.
    fn evaluate(&mut self, settings: &RolloutSettings, actor: &[f32], outputs: bool) {
        let graphs = &mut self.record.actor;
        let last = graphs.len() - self.rows..graphs.len();
        let window = |graph| Window { lookback: usize::from(!outputs), ..graphs.window(graph, 1) };
        self.batch.gather(last.map(window));
        settings.actor.forward(actor, &self.batch, &mut self.space);
        if settings.actor.is_recurrent() {
            graphs.store_latents(self.rows * self.robots, |hop| self.space.hop_inputs(hop));
        }
    }

    /// Samples and records every robot's action, then transforms the actions to the world frame.
    fn draw(&mut self, settings: &RolloutSettings, stream: &mut Stream) {
        for (robot, out) in self.space.outputs().chunks_exact(4).enumerate() {
            let mut action = [0.0; 2];
            let mut log_density = 0.0;
            let units = random::normals(stream);
            for axis in 0..2 {
                let log_std = out[2 + axis].min(settings.log_std_max);
                let unit = units[axis] as f32;
                action[axis] = out[axis] + unit * libm::expf(log_std);
                log_density -= 0.5 * unit * unit + log_std + HALF_LOG_TWO_PI;
            }
            self.record.action.push(action);
            self.record.log_density.push(log_density);
            self.velocities[robot] = Vec2::from(action);
        }
        self.transform_to_world();
    }

    /// Transforms `velocities` from the policy frame to the world frame.
    fn transform_to_world(&mut self) {
        for (velocity, frame) in self.velocities.iter_mut().zip(&self.environments.frame) {
            *velocity = frame.turn(*velocity);
        }
    }

    /// Records the state of each episode after a decision, and starts the next episode of every team whose episode has
    /// ended. The last states of truncated episodes are added to `truncated`.
    fn end_episodes(&mut self, settings: &RolloutSettings, truncated: &mut Graphs, stream: &mut Stream) {
        let base = self.record.state.len();
        self.record.state.resize(base + self.rows * self.robots, EpisodeState::Continues);
        for team in 0..self.environments.teams.len() {
            let (done, range) = (self.environments.all_arrived(team), self.environments.teams[team].range());
            let timed_out = !done && self.environments.elapsed_s(team) >= settings.config.episode_s;
            if !done && !timed_out {
                continue;
            }
            let mut state = EpisodeState::Terminated;
            if timed_out {
                state = EpisodeState::Truncated(truncated.len() as u32);
                self.observe_critic(settings, range.start / self.robots, Some(truncated));
            }
            for robot in range {
                self.record.state[base + robot] = state;
            }
            let team_of = &self.environments.teams[team];
            self.record.ended.add(&EpisodeTotals {
                episodes: 1,
                clean: u32::from(done && !team_of.touched),
                arrived: u32::from(done),
                length_s: self.environments.elapsed_s(team),
                returns: team_of.episode_return,
            });
            self.environments.start(team, &settings.config.conditions, stream);
        }
    }

    /// Computes the critic's estimates and the advantages of the record.
    fn compute_values(&mut self, settings: &RolloutSettings, critic: &[f32]) {
        self.record.value.clear();
        let graphs = self.record.critic.len();
        for from in (0..graphs).step_by(CHUNK) {
            let chunk = from..graphs.min(from + CHUNK);
            self.batch.gather(chunk.map(|graph| self.record.critic.window(graph, 1)));
            settings.critic.forward(critic, &self.batch, &mut self.critic_space);
            self.record.value.extend_from_slice(self.critic_space.outputs());
        }
        let gamma = settings.config.ppo.gamma.powi(settings.repeat as i32);
        self.record.compute_advantages(self.rows * self.robots, gamma, gamma * settings.config.ppo.lambda);
    }
}
