//! Vectorised environments: the worlds, tasks, conditions and messages of many teams. The dynamics are those of
//! `world::kinematic`, and the rewards those of the scenario and the configuration.
//!
//! For a robot with a differential drive, observation, reward and arrival refer to the point that the policy commands;
//! contacts refer to the robot's centre, as in a run. The heading is drawn at the start of each episode.
//!
//! A row (environment) has as many robots as the configured team: one team, or several teams that do not interact.

use std::f32::consts::PI;
use std::sync::Arc;

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::channels::Observing;
use super::conditions::EpisodeConditions;
use super::config::{Conditions, Reward};
use super::courses::Courses;
use super::filters;
use super::message_buffer::MessageBuffer;
use super::reward::TeamStep;
use super::rolling::Rolling;
use murmurate::chassis::{Chassis, DriveKind};
use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::observation::PolicyFrame;
use murmurate::random;
use murmurate::random::Stream;
use murmurate::safety::filter::Filter;
use murmurate::scenario::{Arena, Progress, Scenario, TeamAfterStep};
use murmurate::time::Span;
use murmurate::world::Physics;
use murmurate::world::kinematic::{self, PERIOD};

/// One team in the training environments, with the state of its episode.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrainingTeam {
    /// Index of the team's first robot among all robots.
    pub first: usize,
    /// Number of robots in the team.
    pub robots: usize,
    /// Number of steps of 50 ms since the start of the team's episode.
    pub step: u32,
    /// Conditions of the team's current episode: messages, noise and physics.
    pub episode: EpisodeConditions,
    /// Estimates of the robots' motions in the last steps, and the messages that the robots hold.
    pub messages: MessageBuffer,
    /// Whether any robot of the team has touched a wall or, with deployed physics, another robot in the episode.
    pub touched: bool,
    /// Return of the episode so far, the mean over the team's robots.
    pub episode_return: f32,
    /// Seed and episode number from which the scenario makes the layout.
    pub(super) layout: (u64, u32),
}

impl TrainingTeam {
    /// Returns the indices of the team's robots among all robots.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.robots
    }

    /// Returns the time since the start of the team's episode.
    pub fn elapsed(&self) -> Span {
        PERIOD * u64::from(self.step)
    }
}

/// Training environments of many teams: the states of all their robots. Public lists of robots' states have one entry
/// per robot, by its index among all robots.
#[derive(Clone, Debug)]
pub struct Environments {
    /// Teams of all environments, in the order of their robots.
    pub teams: Vec<TrainingTeam>,
    /// True position of each robot's centre \[m\], world frame.
    pub position: Vec<Vec2>,
    /// True velocity of each robot's centre \[m/s\], world frame.
    pub velocity: Vec<Vec2>,
    /// Wheels and commanded points of all robots; `None` for holonomic robots with the default chassis.
    pub(super) rolling: Option<Rolling>,
    /// Contacts of each robot with walls and other robots in the last step.
    pub contacts: Vec<Contacts>,
    /// Start and goal of each robot in its current episode \[m\], world frame: of its present leg, if it has waypoints.
    pub tasks: Vec<Task>,
    /// Policy frame of each robot with that start and goal.
    pub(super) frame: Vec<PolicyFrame>,
    pub(super) courses: Courses,
    /// Stage of each robot's progress, which the scenario's reward uses.
    pub stage: Vec<Progress>,
    /// Whether each robot has arrived at its goal in its current episode.
    pub arrived: Vec<bool>,
    /// Length of each robot's remaining path \[m\].
    pub to_go_m: Vec<f32>,
    /// Reward of each robot for the last step, with all terms.
    pub reward: Vec<f32>,
    /// Scenario for each team size that occurs, indexed by the team size.
    scenarios: Vec<Option<Arc<dyn Scenario>>>,
    /// Arena of the current episode of each team, with the obstacles that are drawn for it; `None` where all episodes
    /// have the scenario's.
    arenas: Vec<Option<Arena>>,
    /// Physical parameters, one entry per team.
    physics: Vec<Physics>,
    before: Vec<Vec2>,
    pub(super) command: Vec<Vec2>,
    /// Safety filters; `None` in episodes without them.
    pub(super) filters: Vec<Option<Filter>>,
    /// Rewards of the scenario in the last step.
    scenario_reward: Vec<f32>,
    reached: Vec<bool>,
    /// Observations of the roles, and that of the critic last, if it is another.
    pub(super) observing: Vec<Observing>,
    /// Role of each robot, by its id in its team; empty if all have the first one.
    pub(super) role_of: Arc<[u8]>,
    /// Lengths of the remaining paths after the last step \[m\], where the reward uses them.
    left_m: Vec<f32>,
    /// Nearness of the other robots of each robot's team after the last step, where the reward uses it.
    near: Vec<f32>,
}

/// Number of layouts of a seed that trainings take: their numbers are below it. Episodes with even and odd numbers
/// start on different sides of the arena. Layouts with this and larger numbers are for judging what was trained.
pub const LAYOUT_NUMBERS: u32 = 2;

/// Draws the conditions of the next episode of a team of `robots` robots from `stream`, and then the seed and the
/// episode number of its layout.
pub(super) fn next_episode(
    conditions: &Conditions,
    robots: usize,
    stream: &mut Stream,
) -> (EpisodeConditions, (u64, u32)) {
    let episode = EpisodeConditions::draw(conditions, robots, stream);
    (episode, (stream.next_u64(), stream.random_range(0..LAYOUT_NUMBERS)))
}

impl Environments {
    /// Makes `rows` environments. Each entry of `groups` lists the team sizes of one of them; they take the entries in
    /// turn, and `scenarios` has a scenario for each size. Each team needs `start` or `place` before its first step.
    pub fn new(rows: usize, groups: &[Vec<usize>], scenarios: &[Arc<dyn Scenario>]) -> Environments {
        let largest = scenarios.iter().map(|scenario| scenario.robots()).max().unwrap_or(0);
        let mut by_size = vec![None; largest + 1];
        scenarios.iter().for_each(|scenario| by_size[scenario.robots()] = Some(Arc::clone(scenario)));
        let mut teams = Vec::new();
        let mut robots = 0;
        for row in 0..rows {
            for &size in &groups[row % groups.len()] {
                let (episode, mut messages) = (EpisodeConditions::perfect(size), MessageBuffer::default());
                messages.restart(size, true);
                teams.push(TrainingTeam {
                    first: robots,
                    robots: size,
                    step: 0,
                    episode,
                    messages,
                    touched: false,
                    episode_return: 0.0,
                    layout: (0, 0),
                });
                robots += size;
            }
        }
        let no_task = Task { start: Vec2::zeros(), goal: Vec2::zeros() };
        let physics = |team: &TrainingTeam| {
            let scenario = by_size[team.robots].as_ref().expect("there is a scenario for every team size");
            team.episode.physics(scenario.arena())
        };
        Environments {
            physics: teams.iter().map(physics).collect(),
            arenas: vec![None; teams.len()],
            teams,
            position: vec![Vec2::zeros(); robots],
            velocity: vec![Vec2::zeros(); robots],
            rolling: None,
            contacts: vec![Contacts::default(); robots],
            tasks: vec![no_task; robots],
            frame: vec![PolicyFrame::World; robots],
            courses: Courses::new(robots),
            stage: vec![Progress(0); robots],
            arrived: vec![false; robots],
            to_go_m: vec![0.0; robots],
            reward: vec![0.0; robots],
            scenarios: by_size,
            before: vec![Vec2::zeros(); robots],
            command: vec![Vec2::zeros(); robots],
            filters: vec![None; robots],
            scenario_reward: vec![0.0; robots],
            reached: vec![false; robots],
            observing: Vec::new(),
            role_of: Arc::new([]),
            left_m: vec![0.0; robots],
            near: vec![0.0; robots],
        }
    }

    /// Returns the environments with `chassis` for all robots. All episodes must be started afterwards.
    pub fn equipped(mut self, chassis: &Chassis) -> Environments {
        self.rolling = Rolling::new(chassis, self.position.len());
        self
    }

    /// Returns the true motion, world frame, of the commanded point of the robot with index `robot` among all robots.
    pub fn point(&self, robot: usize) -> Motion {
        match &self.rolling {
            None => Motion { position: self.position[robot], velocity: self.velocity[robot] },
            Some(rolling) => Motion { position: rolling.position[robot], velocity: rolling.velocity[robot] },
        }
    }

    /// Returns the heading \[rad\], counter-clockwise from the x axis of the world frame, of the robot with index
    /// `robot` among the robots of all teams.
    pub fn heading(&self, robot: usize) -> f32 {
        self.rolling.as_ref().map_or(0.0, |rolling| rolling.wheels[robot].heading())
    }

    /// Returns the scenario of the team with index `team`.
    pub fn scenario(&self, team: usize) -> &dyn Scenario {
        &**self.scenarios[self.teams[team].robots].as_ref().expect("every team has a scenario")
    }

    /// Returns the scenario of the team with index `team`, for use beside the team.
    pub(super) fn scenario_of(&self, team: usize) -> Arc<dyn Scenario> {
        Arc::clone(self.scenarios[self.teams[team].robots].as_ref().expect("every team has a scenario"))
    }

    /// Returns the arena of the current episode of the team with index `team`.
    #[inline]
    pub fn arena(&self, team: usize) -> &Arena {
        self.arenas[team].as_ref().unwrap_or_else(|| self.scenario(team).arena())
    }

    /// Starts an episode of the team with index `team`, with a layout and conditions drawn from `stream`.
    pub fn start(&mut self, team: usize, conditions: &Conditions, stream: &mut Stream) {
        let (episode, layout) = next_episode(conditions, self.teams[team].robots, stream);
        self.place(team, layout, episode, stream);
    }

    /// Starts an episode of a team under the conditions `episode`. `layout` has the seed and the episode number from
    /// which the scenario draws starts and goals; headings and noise are drawn from `stream`.
    pub fn place(&mut self, team: usize, layout: (u64, u32), episode: EpisodeConditions, stream: &mut Stream) {
        let tasks = self.scenario(team).tasks(layout.0, layout.1);
        self.set_episode(team, (layout, &tasks), &[], episode);
        for (index, task) in tasks.iter().enumerate() {
            let robot = self.teams[team].first + index;
            let velocity = self.scenario(team).start_velocity(task);
            self.position[robot] = task.start;
            self.velocity[robot] = velocity;
            if let Some(rolling) = &mut self.rolling {
                let turns = rolling.wheels[robot].chassis().drive == DriveKind::Differential;
                // A robot that starts in motion is placed as in a World: with its heading along its velocity.
                let heading = match turns {
                    true if velocity != Vec2::zeros() => task.heading(),
                    true => stream.random_range(-PI..PI),
                    false => 0.0,
                };
                rolling.wheels[robot].place(heading);
                rolling.update(robot, &Motion { position: task.start, velocity });
            }
            self.contacts[robot] = Contacts::default();
            self.stage[robot] = Progress(0);
            self.arrived[robot] = false;
        }
        let to_go_m = self.lengths_to_go_m(team);
        let range = self.teams[team].range();
        self.to_go_m[range].copy_from_slice(&to_go_m);
        let team_of = &mut self.teams[team];
        (team_of.step, team_of.touched, team_of.episode_return) = (0, false, 0.0);
        team_of.messages.restart(tasks.len(), team_of.episode.lockstep);
        self.forget(team);
        self.measure(team, stream);
    }

    /// Returns the lengths of the remaining paths of the robots of a team \[m\].
    pub(super) fn lengths_to_go_m(&self, team: usize) -> Vec<f32> {
        let range = self.teams[team].range();
        let points: Vec<Vec2> = range.clone().map(|robot| self.point(robot).position).collect();
        let mut to_go_m = vec![0.0; points.len()];
        self.scenario(team).distances_to_go(&self.tasks[range.clone()], &points, &mut to_go_m);
        self.courses.add_beyond(range, &mut to_go_m);
        to_go_m
    }

    /// Sets the episode of a team: its layout, tasks and conditions. Its robots have passed waypoints after the steps
    /// in `passed`, which is empty for an episode that begins.
    pub(super) fn set_episode(
        &mut self,
        team: usize,
        (layout, tasks): ((u64, u32), &[Task]),
        passed: &[Vec<u32>],
        episode: EpisodeConditions,
    ) {
        self.physics[team] = episode.physics(self.scenario(team).arena());
        self.arenas[team] = self.scenario(team).drawn_arena(layout.0, layout.1);
        let range = self.teams[team].range();
        self.set_out(team, tasks, layout, passed);
        (self.teams[team].layout, self.teams[team].episode) = (layout, episode);
        let ahead_m = self.rolling.as_ref().map_or(0.0, Rolling::ahead_m);
        let (episode, arena) = (&self.teams[team].episode, self.arena(team));
        let filter = filters::filter(episode, arena, &self.physics[team], ahead_m);
        self.filters[range].fill(filter);
    }

    /// Whether a team has deployed physics, where a contact makes the episode fail but does not block the move.
    pub fn is_judged(&self, team: usize) -> bool {
        self.teams[team].episode.lag_s.is_some()
    }

    /// Advances a team by one step of 50 ms. `actions` are commanded velocities \[m/s\], world frame, one for each
    /// robot of all teams, limited to `limit_m_s` along each axis. `weights` are those of the reward's terms.
    pub fn step(&mut self, team: usize, actions: &[Vec2], weights: &Reward, limit_m_s: f32, stream: &mut Stream) {
        self.command(team, actions, limit_m_s);
        let (range, judged) = (self.teams[team].range(), self.is_judged(team));
        let weights = weights.in_episode(self.teams[team].episode.filtered);
        let weights = &weights.about(self.scenario(team).arena());
        let scenario = &**self.scenarios[self.teams[team].robots].as_ref().expect("every team has a scenario");
        let mut world = kinematic::TeamMotion {
            position: &mut self.position[range.clone()],
            velocity: &mut self.velocity[range.clone()],
            wheels: self.rolling.as_mut().map_or(&mut [], |rolling| &mut rolling.wheels[range.clone()]),
            contacts: &mut self.contacts[range.clone()],
            before: &mut self.before[range.clone()],
        };
        let arena = self.arenas[team].as_ref().unwrap_or(scenario.arena());
        let arena = &arena.at(Some(self.teams[team].elapsed() + PERIOD));
        kinematic::step(arena, &self.physics[team], &self.command[range.clone()], &mut world);
        self.rolling.iter_mut().for_each(|rolling| rolling.follow(range.clone(), (&self.position, &self.velocity)));
        let (points, velocity) = match &self.rolling {
            None => (&self.position[range.clone()], &self.velocity[range.clone()]),
            Some(rolling) => (&rolling.position[range.clone()], &rolling.velocity[range.clone()]),
        };
        let (position, contacts) = (&self.position[range.clone()], &self.contacts[range.clone()]);
        let tasks = &self.tasks[range.clone()];
        if weights.scenario > 0.0 {
            let stage = &mut self.stage[range.clone()];
            let after = TeamAfterStep { tasks, position: points, velocity, contacts, stage };
            scenario.rewards(after, &mut self.scenario_reward[range.clone()]);
        }
        scenario.arrivals(tasks, points, &mut self.reached[range.clone()]);
        self.courses.keep_through(range.clone(), &mut self.reached[range.clone()]);
        if weights.progress > 0.0 {
            scenario.distances_to_go(tasks, points, &mut self.left_m[range.clone()]);
            self.courses.add_beyond(range.clone(), &mut self.left_m[range.clone()]);
        }
        let step = TeamStep {
            tasks,
            position,
            points,
            velocity,
            contacts,
            scenario_reward: &self.scenario_reward[range.clone()],
            reached: &self.reached[range.clone()],
            left_m: &self.left_m[range.clone()],
            to_go_m: &mut self.to_go_m[range.clone()],
            arrived: &mut self.arrived[range.clone()],
            reward: &mut self.reward[range.clone()],
            near: &mut self.near[range.clone()],
        };
        let team_of = &mut self.teams[team];
        team_of.episode_return += step.score(weights, arena);
        team_of.touched |= contacts.iter().any(|contacts| contacts.wall || (judged && contacts.robot));
        team_of.step += 1;
        self.turn(team);
        if !self.teams[team].episode.lockstep {
            self.measure(team, stream);
        }
    }

    /// Draws a noisy measurement of every robot of a team and stores it as the robot's estimate. A team whose robots
    /// act at the same time needs this only before a decision, any other team in every step.
    pub fn measure(&mut self, team: usize, stream: &mut Stream) {
        let (position, velocity) = match &self.rolling {
            None => (&self.position, &self.velocity),
            Some(rolling) => (&rolling.position, &rolling.velocity),
        };
        let range = self.teams[team].range();
        let TrainingTeam { step, episode, messages, .. } = &mut self.teams[team];
        let motions = position[range.clone()].iter().zip(&velocity[range]);
        messages.store(
            *step,
            motions.map(|(&position, &velocity)| {
                let mut noise = |std: f32, to: Vec2| match std > 0.0 {
                    true => to + Vec2::from(random::normals(stream).map(|unit| unit as f32)) * std,
                    false => to,
                };
                let position = noise(episode.position_noise_m, position);
                Motion { position, velocity: noise(episode.velocity_noise_m_s, velocity) }
            }),
        );
        self.perceive(team, stream);
    }

    /// Returns a robot's estimate of its own motion, world frame, by its team's index and its index among all robots.
    pub fn estimate(&self, team: usize, robot: usize) -> Motion {
        let team = &self.teams[team];
        team.messages.estimate(team.step, robot - team.first)
    }

    /// Returns the time since the start of a team's episode \[s\].
    pub fn elapsed_s(&self, team: usize) -> f32 {
        self.teams[team].step as f32 * PERIOD.as_secs() as f32
    }
}
