//! Saved states of training environments, for checkpoints and for the states of vectorised environments.

use serde::{Deserialize, Serialize};

use super::environments::{Environments, TrainingTeam};
use super::filters;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::safety::yielding::Yielding;
use murmurate::scenario::Progress;

/// Largest number of steps of an episode in a snapshot: far beyond the longest, and far from overflows.
const LATEST: u32 = 1 << 30;

/// Saved state of training environments, from which [`Environments::restore`] continues exactly.
#[derive(Debug, Serialize, Deserialize)]
pub struct Snapshot {
    teams: Vec<TrainingTeam>,
    pub(super) position: Vec<[f32; 2]>,
    velocity: Vec<[f32; 2]>,
    stage: Vec<u8>,
    arrived: Vec<bool>,
    to_go_m: Vec<f32>,
    /// Heading \[rad\] and yaw rate \[rad/s\] of each robot; empty for robots with the default chassis.
    #[serde(default)]
    turned: Vec<[f32; 2]>,
    /// State of the safety filter of each robot; empty in snapshots of older programs.
    #[serde(default)]
    yielding: Vec<Yielding>,
    /// Memories of channels of the robots' episodes; empty for observations without such channels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    remembered: Vec<f32>,
    /// Steps after which each robot has passed its waypoints; empty if none has passed any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    passed: Vec<Vec<u32>>,
}

impl Snapshot {
    /// Returns the seed and the episode number of each team's layout.
    pub(super) fn layouts(&self) -> impl Iterator<Item = (u64, u32)> + use<'_> {
        self.teams.iter().map(|team| team.layout)
    }
}

impl TrainingTeam {
    /// Returns whether a team that was read has conditions and messages that an episode can have, with `stored` floats
    /// of each stored observation.
    fn is_sound(&self, stored: usize) -> bool {
        let TrainingTeam { robots, step, episode, messages, .. } = self;
        *step <= LATEST && episode.is_sound(*robots) && messages.is_sound((*robots, stored), *step, episode.lockstep)
    }
}

impl Environments {
    /// Returns the state of the environments, from which `restore` continues exactly.
    pub fn snapshot(&self) -> Snapshot {
        let pairs = |vectors: &[Vec2]| vectors.iter().map(|v| [v.x, v.y]).collect();
        Snapshot {
            teams: self.teams.clone(),
            position: pairs(&self.position),
            velocity: pairs(&self.velocity),
            stage: self.stage.iter().map(|stage| stage.0).collect(),
            arrived: self.arrived.clone(),
            to_go_m: self.to_go_m.clone(),
            turned: self.rolling.iter().flat_map(|r| &r.wheels).map(|w| [w.heading(), w.yaw_rate()]).collect(),
            yielding: filters::yielding(&self.filters),
            remembered: self.observing.iter().flat_map(|observing| &observing.memory).copied().collect(),
            passed: self.courses.passed(),
        }
    }

    /// Returns whether a snapshot is of such environments: of the same teams and robots, with values that episodes of
    /// theirs can have.
    pub fn fits(&self, snapshot: &Snapshot) -> bool {
        let shape = |teams: &[TrainingTeam]| teams.iter().map(|team| (team.first, team.robots)).collect::<Vec<_>>();
        let robots = self.position.len();
        let lengths = [
            snapshot.position.len(),
            snapshot.velocity.len(),
            snapshot.stage.len(),
            snapshot.arrived.len(),
            snapshot.to_go_m.len(),
        ];
        let turned = self.rolling.as_ref().map_or(0, |rolling| rolling.wheels.len());
        let mut motions = snapshot.position.iter().chain(&snapshot.velocity).chain(&snapshot.turned).flatten();
        shape(&snapshot.teams) == shape(&self.teams)
            && lengths == [robots; 5]
            && snapshot.turned.len() == turned
            && [0, robots].contains(&snapshot.passed.len())
            && motions.all(|number| number.is_finite())
            && snapshot.remembered.len() == self.observing.iter().map(|observing| observing.memory.len()).sum::<usize>()
            && snapshot.remembered.iter().all(|number| number.is_finite())
            && snapshot.teams.iter().all(|team| team.is_sound(self.stored()))
    }

    /// Restores a snapshot. Returns `false` and changes nothing if the snapshot is not of such environments.
    pub fn restore(&mut self, snapshot: Snapshot) -> bool {
        if !self.fits(&snapshot) {
            return false;
        }
        self.teams = snapshot.teams;
        self.position = snapshot.position.into_iter().map(Vec2::from).collect();
        self.velocity = snapshot.velocity.into_iter().map(Vec2::from).collect();
        self.stage = snapshot.stage.into_iter().map(Progress).collect();
        self.arrived = snapshot.arrived;
        self.to_go_m = snapshot.to_go_m;
        if let Some(rolling) = &mut self.rolling {
            for (robot, [heading, yaw_rate]) in snapshot.turned.into_iter().enumerate() {
                rolling.wheels[robot].restore(heading, yaw_rate);
                rolling.update(robot, &Motion { position: self.position[robot], velocity: self.velocity[robot] });
            }
        }
        for team in 0..self.teams.len() {
            let TrainingTeam { layout, episode, .. } = self.teams[team].clone();
            let tasks = self.scenario(team).tasks(layout.0, layout.1);
            self.set_episode(team, (layout, &tasks), &snapshot.passed, episode);
        }
        filters::restore(&mut self.filters, &snapshot.yielding);
        let mut remembered = snapshot.remembered.into_iter();
        let memories = self.observing.iter_mut().flat_map(|observing| &mut observing.memory);
        memories.zip(&mut remembered).for_each(|(memory, remembered)| *memory = remembered);
        true
    }
}
