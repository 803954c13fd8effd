//! Many teams side by side: their worlds, tasks, conditions and memories of what was said. The dynamics are those
//! of `world::kinematic`, the reward that of the scenario; nothing of either is written twice.
//!
//! A row is as many robots as the configured team; it is one team, or several that know nothing of each other.

use std::sync::Arc;

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::conditions::Episode;
use super::config::{Conditions, Reward};
use super::radio::Radio;
use super::reward::{Part, crowding, earn};
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::random;
use crate::random::Stream;
use crate::scenario::{Scenario, Stage, TeamAfterStep};
use crate::world::kinematic::{self, PERIOD};
use crate::world::{Clamp, Physics};

/// One team and its episode.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Team {
    /// Its first robot's place in the crowd.
    pub first: usize,
    /// How many robots it has.
    pub robots: usize,
    /// Steps of the episode so far.
    pub step: u32,
    /// What this episode is like.
    pub episode: Episode,
    /// What was said in it.
    pub radio: Radio,
    /// Whether anything was touched.
    pub touched: bool,
    /// What it has earned, mean over its robots.
    pub earned: f32,
    /// Which layout it drives: the scenario's seed and episode.
    layout: (u64, u32),
}

impl Team {
    /// The places of its robots.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.robots
    }
}

/// Teams side by side, everything of a robot in its place of each list.
#[derive(Clone, Debug)]
pub struct Crowd {
    /// The teams, by their first robot.
    pub teams: Vec<Team>,
    /// True positions \[m\].
    pub position: Vec<Vec2>,
    /// True velocities \[m/s\].
    pub velocity: Vec<Vec2>,
    /// What each touched in the last step.
    pub contacts: Vec<Contacts>,
    /// What each is to do.
    pub tasks: Vec<Task>,
    /// How far each has come.
    pub stage: Vec<Stage>,
    /// Who has arrived.
    pub arrived: Vec<bool>,
    /// How far each has to go \[m\], along its way.
    pub to_go_m: Vec<f32>,
    /// What each earned in the last step.
    pub earned: Vec<f32>,
    /// By team size: the scenario for so many robots.
    scenarios: Vec<Option<Arc<dyn Scenario>>>,
    /// By team.
    physics: Vec<Physics>,
    before: Vec<Vec2>,
    command: Vec<Vec2>,
    /// What the scenario says of each after the last step.
    reward: Vec<f32>,
    reached: Vec<bool>,
}

/// What of a crowd is to be remembered for going on exactly.
#[derive(Debug, Serialize, Deserialize)]
pub struct Snapshot {
    teams: Vec<Team>,
    position: Vec<[f32; 2]>,
    velocity: Vec<[f32; 2]>,
    stage: Vec<u8>,
    arrived: Vec<bool>,
    to_go_m: Vec<f32>,
}

impl Crowd {
    /// Rows of robots, split into teams by `groups`, which rows take in turn. Every team still has to `start`.
    pub fn new(rows: usize, groups: &[Vec<usize>], scenarios: &[Arc<dyn Scenario>]) -> Crowd {
        let most = scenarios.iter().map(|scenario| scenario.robots()).max().unwrap_or(0);
        let mut by_size = vec![None; most + 1];
        scenarios.iter().for_each(|scenario| by_size[scenario.robots()] = Some(Arc::clone(scenario)));
        let mut teams = Vec::new();
        let mut robots = 0;
        for row in 0..rows {
            for &size in &groups[row % groups.len()] {
                let (episode, mut radio) = (Episode::perfect(size), Radio::default());
                radio.restart(size, true);
                let (step, touched, earned, layout) = (0, false, 0.0, (0, 0));
                teams.push(Team { first: robots, robots: size, step, episode, radio, touched, earned, layout });
                robots += size;
            }
        }
        let nothing = Task { start: Vec2::zeros(), goal: Vec2::zeros() };
        let physics = |team: &Team| {
            let scenario = by_size[team.robots].as_ref().expect("there is a scenario for every team size");
            team.episode.physics(scenario.arena())
        };
        Crowd {
            physics: teams.iter().map(physics).collect(),
            teams,
            position: vec![Vec2::zeros(); robots],
            velocity: vec![Vec2::zeros(); robots],
            contacts: vec![Contacts::default(); robots],
            tasks: vec![nothing; robots],
            stage: vec![Stage(0); robots],
            arrived: vec![false; robots],
            to_go_m: vec![0.0; robots],
            earned: vec![0.0; robots],
            scenarios: by_size,
            before: vec![Vec2::zeros(); robots],
            command: vec![Vec2::zeros(); robots],
            reward: vec![0.0; robots],
            reached: vec![false; robots],
        }
    }

    /// The scenario of a team.
    pub fn scenario(&self, team: usize) -> &dyn Scenario {
        &**self.scenarios[self.teams[team].robots].as_ref().expect("every team has a scenario")
    }

    /// Begins an episode of a team, with a layout and conditions drawn from `stream`.
    pub fn start(&mut self, team: usize, conditions: &Conditions, stream: &mut Stream) {
        let episode = Episode::draw(conditions, self.teams[team].robots, stream);
        // Either side of the arena.
        let layout = (stream.next_u64(), stream.random_range(0..2));
        self.place(team, layout, episode, stream);
    }

    /// Begins an episode of a team: one of the scenario's layouts, under these conditions.
    pub fn place(&mut self, team: usize, layout: (u64, u32), episode: Episode, stream: &mut Stream) {
        let tasks = self.scenario(team).tasks(layout.0, layout.1);
        self.settle(team, layout, &tasks, episode);
        for (index, task) in tasks.iter().enumerate() {
            let robot = self.teams[team].first + index;
            self.position[robot] = task.start;
            self.velocity[robot] = Vec2::zeros();
            self.contacts[robot] = Contacts::default();
            self.stage[robot] = Stage(0);
            self.arrived[robot] = false;
            self.to_go_m[robot] = self.scenario(team).distance_to_go(task, task.start);
        }
        let team_of = &mut self.teams[team];
        (team_of.step, team_of.touched, team_of.earned) = (0, false, 0.0);
        team_of.radio.restart(tasks.len(), team_of.episode.lockstep);
        self.measure(team, stream);
    }

    fn settle(&mut self, team: usize, layout: (u64, u32), tasks: &[Task], episode: Episode) {
        self.physics[team] = episode.physics(self.scenario(team).arena());
        let range = self.teams[team].range();
        self.tasks[range].copy_from_slice(tasks);
        let team = &mut self.teams[team];
        (team.layout, team.episode) = (layout, episode);
    }

    /// Whether a robot's drivetrain lags and its contacts are judged.
    pub fn is_judged(&self, team: usize) -> bool {
        self.teams[team].episode.lag_s.is_some()
    }

    /// Moves a team on by one step toward `actions` \[m/s\], world frame, one a robot of the crowd.
    pub fn step(&mut self, team: usize, actions: &[Vec2], weights: &Reward, limit_m_s: f32, stream: &mut Stream) {
        let range = self.teams[team].range();
        let (judged, clamp) = (self.is_judged(team), self.teams[team].episode.clamp);
        for (robot, action) in range.clone().zip(&actions[range.clone()]) {
            let exact = self.teams[team].episode.lockstep || clamp == Clamp::Training;
            let measured = if exact { self.velocity[robot] } else { self.estimate(team, robot).velocity };
            self.command[robot] = clamp.limit(*action, measured, limit_m_s);
        }
        let scenario = &**self.scenarios[self.teams[team].robots].as_ref().expect("every team has a scenario");
        let mut world = kinematic::Team {
            position: &mut self.position[range.clone()],
            velocity: &mut self.velocity[range.clone()],
            contacts: &mut self.contacts[range.clone()],
            before: &mut self.before[range.clone()],
        };
        kinematic::step(scenario.arena(), &self.physics[team], &self.command[range.clone()], &mut world);
        let (position, contacts) = (&self.position[range.clone()], &self.contacts[range.clone()]);
        let tasks = &self.tasks[range.clone()];
        if weights.scenario > 0.0 {
            let (velocity, stage) = (&self.velocity[range.clone()], &mut self.stage[range.clone()]);
            let after = TeamAfterStep { tasks, position, velocity, contacts, stage };
            scenario.rewards(after, &mut self.reward[range.clone()]);
        }
        scenario.arrivals(tasks, position, &mut self.reached[range.clone()]);
        let found = self.reward[range.clone()].iter().zip(&self.reached[range.clone()]);
        let progress = self.to_go_m[range.clone()].iter_mut().zip(&mut self.arrived[range.clone()]);
        let progress = progress.zip(&mut self.earned[range.clone()]);
        let states = tasks.iter().zip(position).zip(contacts).zip(found).zip(progress).enumerate();
        let (mut sum, mut touched) = (0.0, false);
        for (robot, ((((task, &at), &contacts), (&reward, &reached)), ((to_go_m, arrived), earned))) in states {
            *earned = earn(weights, scenario, Part { task, position: at, contacts, reward, reached, to_go_m, arrived });
            if weights.proximity > 0.0 {
                *earned -= crowding(weights, robot, position);
            }
            sum += *earned;
            touched |= contacts.wall || (judged && contacts.robot);
        }
        let mean = sum / range.len() as f32;
        if weights.shared > 0.0 {
            for earned in &mut self.earned[range] {
                *earned += weights.shared * (mean - *earned);
            }
        }
        let team_of = &mut self.teams[team];
        team_of.touched |= touched;
        team_of.earned += mean;
        team_of.step += 1;
        if !team_of.episode.lockstep {
            self.measure(team, stream);
        }
    }

    /// Every robot measures where it is. Teams in lock step need it only when they decide; all others in every step.
    pub fn measure(&mut self, team: usize, stream: &mut Stream) {
        let Team { first, robots, step, episode, radio, .. } = &mut self.teams[team];
        for robot in 0..*robots {
            let mut motion =
                Motion { position: self.position[*first + robot], velocity: self.velocity[*first + robot] };
            let mut noise = |std: f32, to: &mut Vec2| {
                if std > 0.0 {
                    *to += Vec2::from(random::normals(stream).map(|unit| unit as f32)) * std;
                }
            };
            noise(episode.position_noise_m, &mut motion.position);
            noise(episode.velocity_noise_m_s, &mut motion.velocity);
            radio.remember(*step, robot, &motion);
        }
    }

    /// What a robot, by its place in the crowd, measures of itself.
    pub fn estimate(&self, team: usize, robot: usize) -> Motion {
        let team = &self.teams[team];
        team.radio.estimate(team.step, robot - team.first)
    }

    /// Whether all robots of a team have arrived.
    pub fn all_arrived(&self, team: usize) -> bool {
        self.arrived[self.teams[team].range()].iter().all(|&arrived| arrived)
    }

    /// Seconds since a team's episode began \[s\].
    pub fn elapsed_s(&self, team: usize) -> f32 {
        self.teams[team].step as f32 * PERIOD.as_secs() as f32
    }

    /// What is needed to go on exactly from here.
    pub fn snapshot(&self) -> Snapshot {
        let pairs = |vectors: &[Vec2]| vectors.iter().map(|v| [v.x, v.y]).collect();
        Snapshot {
            teams: self.teams.clone(),
            position: pairs(&self.position),
            velocity: pairs(&self.velocity),
            stage: self.stage.iter().map(|stage| stage.0).collect(),
            arrived: self.arrived.clone(),
            to_go_m: self.to_go_m.clone(),
        }
    }

    /// Goes on from a snapshot of a crowd of the same rows and groups; whether it is one.
    pub fn restore(&mut self, snapshot: Snapshot) -> bool {
        let shape = |teams: &[Team]| teams.iter().map(|team| (team.first, team.robots)).collect::<Vec<_>>();
        let robots = self.position.len();
        let lengths = [
            snapshot.position.len(),
            snapshot.velocity.len(),
            snapshot.stage.len(),
            snapshot.arrived.len(),
            snapshot.to_go_m.len(),
        ];
        if shape(&snapshot.teams) != shape(&self.teams) || lengths != [robots; 5] {
            return false;
        }
        self.teams = snapshot.teams;
        self.position = snapshot.position.into_iter().map(Vec2::from).collect();
        self.velocity = snapshot.velocity.into_iter().map(Vec2::from).collect();
        self.stage = snapshot.stage.into_iter().map(Stage).collect();
        self.arrived = snapshot.arrived;
        self.to_go_m = snapshot.to_go_m;
        for team in 0..self.teams.len() {
            let Team { layout, episode, .. } = self.teams[team].clone();
            let tasks = self.scenario(team).tasks(layout.0, layout.1);
            self.settle(team, layout, &tasks, episode);
        }
        true
    }
}
