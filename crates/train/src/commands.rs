//! Commands of the robots of training environments: the actions of a policy, as far as limits and safety filters allow.

use super::conditions::EpisodeConditions;
use super::environments::{Environments, TrainingTeam};
use murmurate::messages::geometry::Vec2;
use murmurate::safety::Clamp;

impl Environments {
    /// Makes the commands of a team's robots of `actions`, as far as limits and safety filter allow them.
    pub(super) fn command(&mut self, team: usize, actions: &[Vec2], limit_m_s: f32) {
        let range = self.teams[team].range();
        let EpisodeConditions { filtered, clamp, lockstep, .. } = self.teams[team].episode;
        let exact = lockstep || clamp == Clamp::Training;
        for (robot, action) in range.clone().zip(&actions[range]) {
            let measured = if exact { self.point(robot).velocity } else { self.estimate(team, robot).velocity };
            let wanted = clamp.limit(*action, measured, limit_m_s);
            self.command[robot] = if filtered { self.filtered(team, robot, wanted) } else { wanted };
        }
    }

    /// Returns the velocity after the robot's safety filter, which knows what the robot itself knows.
    fn filtered(&mut self, team: usize, robot: usize, wanted: Vec2) -> Vec2 {
        let Some(mut filter) = self.filters[robot].take() else { return wanted };
        filter.elapse(Some(self.teams[team].elapsed()));
        let TrainingTeam { first, step, episode, messages, .. } = &self.teams[team];
        let filtered = if episode.lockstep {
            let others = self.teams[team].range().filter(|other| *other != robot);
            filter.apply(&self.point(robot), others.map(|other| (self.point(other), 0.0)), wanted)
        } else {
            filter.apply(&self.estimate(team, robot), messages.known(episode, *step, robot - first), wanted)
        };
        self.filters[robot] = Some(filter);
        filtered.velocity
    }
}
