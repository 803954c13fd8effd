//! Observations of the robots of training environments: fields of the robots' states, and channels and senses for
//! policies that take them.
//!
//! An observation of fields follows from an estimate, so it is made when it is asked for. One with channels is made
//! when the robot measures its state, and stored: a message is encoded from the observation that its sender had then.

use std::borrow::Cow;

use super::channels::{Channels, Observing, Perception, Place};
use super::environments::{Environments, TrainingTeam};
use super::message_buffer::MessageBuffer;
use murmurate::messages::geometry::{Motion, Planar, Task};
use murmurate::observation::Observation;
use murmurate::policy::hops::entry::{self, Entry};
use murmurate::random::Stream;
use murmurate::scenario::Arena;

impl Environments {
    /// Returns the arena of the current episode of the team with index `team` at the team's current step.
    pub fn arena_now(&self, team: usize) -> Cow<'_, Arena> {
        self.arena(team).at(Some(self.teams[team].elapsed()))
    }

    /// Returns the environments with these entries of an observation. `channels` are those among the entries, `None` if
    /// all are fields. All episodes must be started afterwards.
    pub fn observing(self, entries: &[Entry], channels: Option<Channels>) -> Environments {
        self.in_roles(vec![Perception { entries: entries.into(), channels }], Vec::new())
    }

    /// Returns the environments with these observations of the roles, and of the critic last, if it has one of its own.
    /// `role_of` has the index of the role of each robot, by its id in its team; it is empty if all have the first one.
    /// All episodes must be started afterwards.
    pub fn in_roles(mut self, perceptions: Vec<Perception>, role_of: Vec<u8>) -> Environments {
        let robots = self.position.len();
        let observing = |perception: Perception| {
            let memory = perception.channels.as_ref().map_or(0, Channels::memory) * robots;
            Observing { perception, memory: vec![0.0; memory] }
        };
        (self.observing, self.role_of) = (perceptions.into_iter().map(observing).collect(), role_of.into());
        self
    }

    /// Returns the index of the role of the robot with the index `robot` in its team.
    pub(super) fn role(&self, robot: usize) -> u8 {
        self.role_of.get(robot).copied().unwrap_or(0)
    }

    /// Makes the channels forget the episodes of the robots of a team.
    pub(super) fn forget(&mut self, team: usize) {
        let (range, robots) = (self.teams[team].range(), self.position.len());
        for Observing { memory, .. } in &mut self.observing {
            let each = memory.len() / robots;
            memory[range.start * each..range.end * each].fill(0.0);
        }
    }

    /// Returns the number of floats of the observation of a robot that is stored for each step; 0 if none is.
    pub(super) fn stored(&self) -> usize {
        let perceptions = self.observing.iter().map(|observing| &observing.perception);
        let stored = perceptions
            .filter(|perception| perception.channels.is_some())
            .map(|perception| entry::floats(&perception.entries));
        stored.max().unwrap_or(0)
    }

    /// Makes and stores the observations of the robots of a team for the current step, if the policy takes channels.
    /// Noise of senses is drawn from `stream`.
    pub(super) fn perceive(&mut self, team: usize, stream: &mut Stream) {
        let stored = self.stored();
        if stored == 0 {
            return;
        }
        let mut observing = std::mem::take(&mut self.observing);
        for robot in self.teams[team].range() {
            let estimate = self.estimate(team, robot);
            let TrainingTeam { first, step, .. } = self.teams[team];
            let role = usize::from(self.role(robot - first));
            if let Some(mut observation) = self.seen(&mut observing[role], (team, robot), &estimate, Some(stream)) {
                // All have one length in the buffer.
                observation.resize(stored, 0.0);
                self.teams[team].messages.store_observation((step, robot - first), &observation);
            }
            // What the critic's own channels remember follows the episode, too.
            let critic = observing.len() - 1;
            if !self.role_of.is_empty() && !observing[critic].memory.is_empty() {
                self.seen(&mut observing[critic], (team, robot), &estimate, None);
            }
        }
        self.observing = observing;
    }

    /// Writes the observation that the robot with index `robot` in the team with index `team` had in `step` into `to`.
    /// `messages` are those of its team, where that step is among the stored ones.
    pub fn observation(&self, team: usize, messages: &MessageBuffer, (step, robot): (u32, usize), to: &mut [f32]) {
        let Perception { entries, channels } = &self.observing[usize::from(self.role(robot))].perception;
        let to = &mut to[..entry::floats(entries)];
        match channels {
            Some(_) => to.copy_from_slice(&messages.observation(step, robot, self.stored())[..to.len()]),
            None => {
                let bound = self.bound_in(team, self.teams[team].first + robot, step);
                let own = Observation::in_frame(bound.0, bound.1, &messages.estimate(step, robot));
                entry::write(entries, &Observation { dynamics: self.teams[team].episode.dynamics(), ..own }, to);
            }
        }
    }

    /// Writes the observations that the robots of a team have in its current step into `to`, `floats` of each.
    pub fn observations(&self, team: usize, floats: usize, to: &mut [f32]) {
        let TrainingTeam { step, messages, episode, .. } = &self.teams[team];
        let Perception { entries, channels } = &self.observing[0].perception;
        if channels.is_some() || !self.role_of.is_empty() {
            for (robot, to) in to.chunks_exact_mut(floats).enumerate() {
                self.observation(team, messages, (*step, robot), to);
            }
            return;
        }
        let (range, dynamics) = (self.teams[team].range(), episode.dynamics());
        let seen = messages.estimates(*step).zip(self.frame[range.clone()].iter().zip(&self.tasks[range]));
        for ((estimate, (frame, task)), to) in seen.zip(to.chunks_exact_mut(floats)) {
            let own = Observation { dynamics, ..Observation::in_frame(*frame, task.goal, &estimate) };
            for (to, field) in to.as_chunks_mut().0.iter_mut().zip(entries.iter().filter_map(Entry::field)) {
                *to = field.of(&own).to_array();
            }
        }
    }

    /// Writes what the critic observes of the robot with index `robot` among all robots, which follows from the true
    /// state without any noise, into `to`. Its team has the index `team`.
    pub fn true_observation(&mut self, team: usize, robot: usize, to: &mut [f32]) {
        let truth = self.point(robot);
        let mut observing = std::mem::take(&mut self.observing);
        let of_critic = observing.last_mut().expect("there is an observation");
        let each = of_critic.memory.len() / self.position.len();
        // What channels remember does not change by it.
        let remembered = of_critic.memory[robot * each..][..each].to_vec();
        match self.seen(of_critic, (team, robot), &truth, None) {
            None => entry::write(&of_critic.perception.entries, &self.own((team, robot), &truth), to),
            Some(observation) => to.copy_from_slice(&observation),
        }
        of_critic.memory[robot * each..][..each].copy_from_slice(&remembered);
        self.observing = observing;
    }

    /// Returns the true state of the robot with index `robot` among all robots, without values of channels. Its team
    /// has the index `team`.
    pub(super) fn true_state(&self, team: usize, robot: usize) -> Observation<'static> {
        self.own((team, robot), &self.point(robot))
    }

    /// Returns the state of a robot with the motion `estimate`, world frame, as the policy observes it, without values
    /// of channels.
    fn own(&self, (team, robot): (usize, usize), estimate: &Motion) -> Observation<'static> {
        let (of_team, frame) = (&self.teams[team], self.frame[robot]);
        let yaw_rate = self.rolling.as_ref().map_or(0.0, |rolling| rolling.wheels[robot].yaw_rate());
        Observation {
            dynamics: of_team.episode.dynamics(),
            heading: Some(frame.turn_angle(self.heading(robot))),
            yaw_rate: Some(yaw_rate),
            elapsed: of_team.elapsed(),
            ..Observation::in_frame(frame, self.tasks[robot].goal, estimate)
        }
    }

    /// Returns the observation of a robot with the motion `estimate`, world frame, and changes the memory that its
    /// channels have of it; `None` if it has no channels. Noise of senses is drawn from `stream`; without it there is
    /// none.
    fn seen(
        &self,
        Observing { perception: Perception { entries, channels }, memory }: &mut Observing,
        (team, robot): (usize, usize),
        estimate: &Motion,
        stream: Option<&mut Stream>,
    ) -> Option<Vec<f32>> {
        let channels = channels.as_mut()?;
        let each = memory.len() / self.position.len();
        let memory = &mut memory[robot * each..][..each];
        let range = self.teams[team].range();
        let place = Place {
            arena: &self.arena_now(team),
            centre: self.position[robot],
            heading: self.heading(robot),
            team: &self.position[range.clone()],
            robot: robot - range.start,
        };
        channels.sense(place, stream);
        let own = self.own((team, robot), estimate);
        let tasks: Vec<Option<Task>> = self.tasks[range].iter().copied().map(Some).collect();
        let values = channels.values(memory, &own, (&self.tasks[robot], &tasks));
        let mut observation = Vec::new();
        entry::append(entries, &Observation { values, ..own }, &mut observation);
        Some(observation)
    }
}
