//! Observations of the robots of training environments: fields of the robots' states, and channels and senses for
//! policies that take them.
//!
//! An observation of fields follows from an estimate, so it is made when it is asked for. One with channels is made
//! when the robot measures its state, and stored: a message is encoded from the observation that its sender had then.

use std::borrow::Cow;

use super::channels::{Channels, Observing, Place};
use super::environments::{Environments, TrainingTeam};
use super::message_buffer::MessageBuffer;
use murmurate::messages::geometry::{Motion, Task};
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
    pub fn observing(mut self, entries: &[Entry], channels: Option<Channels>) -> Environments {
        let memory = channels.as_ref().map_or(0, Channels::memory) * self.position.len();
        self.observing = Observing { entries: entries.into(), channels, memory: vec![0.0; memory] };
        self
    }

    /// Makes the channels forget the episodes of the robots of a team.
    pub(super) fn forget(&mut self, team: usize) {
        let (memory, robots) = (&mut self.observing.memory, self.position.len());
        let each = memory.len() / robots;
        let range = self.teams[team].range();
        memory[range.start * each..range.end * each].fill(0.0);
    }

    /// Returns the number of floats of the observation of a robot that is stored for each step; 0 if none is.
    pub(super) fn stored(&self) -> usize {
        self.observing.channels.as_ref().map_or(0, |_| entry::floats(&self.observing.entries))
    }

    /// Makes and stores the observations of the robots of a team for the current step, if the policy takes channels.
    /// Noise of senses is drawn from `stream`.
    pub(super) fn perceive(&mut self, team: usize, stream: &mut Stream) {
        if self.observing.channels.is_none() {
            return;
        }
        let mut observing = std::mem::take(&mut self.observing);
        let each = observing.memory.len() / self.position.len();
        let Observing { entries, channels: Some(channels), memory } = &mut observing else { return };
        for robot in self.teams[team].range() {
            let estimate = self.estimate(team, robot);
            let memory = &mut memory[robot * each..][..each];
            let observation = self.seen((entries, channels, memory), (team, robot), &estimate, Some(stream));
            let TrainingTeam { first, step, messages, .. } = &mut self.teams[team];
            messages.store_observation((*step, robot - *first), &observation);
        }
        self.observing = observing;
    }

    /// Writes the observation that the robot with index `robot` in the team with index `team` had in `step` into `to`.
    /// `messages` are those of its team, where that step is among the stored ones.
    pub fn observation(&self, team: usize, messages: &MessageBuffer, (step, robot): (u32, usize), to: &mut [f32]) {
        match self.observing.channels {
            Some(_) => to.copy_from_slice(messages.observation(step, robot, to.len())),
            None => {
                let robot_of_all = self.teams[team].first + robot;
                let leg = self.courses.leg_in(robot_of_all, step);
                let own = self.own((team, robot_of_all), &leg, &messages.estimate(step, robot));
                entry::write(&self.observing.entries, &own, to);
            }
        }
    }

    /// Writes the observation of the robot with index `robot` among all robots that follows from the true state,
    /// without any noise, into `to`. Its team has the index `team`.
    pub fn true_observation(&mut self, team: usize, robot: usize, to: &mut [f32]) {
        let truth = self.point(robot);
        let mut observing = std::mem::take(&mut self.observing);
        let Observing { entries, channels, memory } = &mut observing;
        match channels {
            None => entry::write(entries, &self.own((team, robot), &self.tasks[robot], &truth), to),
            Some(channels) => {
                let each = memory.len() / self.position.len();
                // What the policy's channels remember does not change by it.
                let mut memory = memory[robot * each..][..each].to_vec();
                to.copy_from_slice(&self.seen((entries, channels, &mut memory), (team, robot), &truth, None));
            }
        }
        self.observing = observing;
    }

    /// Returns the true state of the robot with index `robot` among all robots, without values of channels. Its team
    /// has the index `team`.
    pub(super) fn true_state(&self, team: usize, robot: usize) -> Observation<'static> {
        self.own((team, robot), &self.tasks[robot], &self.point(robot))
    }

    /// Returns the state of a robot with this task and the motion `estimate`, world frame, as the policy observes it,
    /// without values of channels.
    fn own(&self, (team, robot): (usize, usize), task: &Task, estimate: &Motion) -> Observation<'static> {
        let (scenario, of_team) = (self.scenario(team), &self.teams[team]);
        let frame = scenario.frame(task);
        let yaw_rate = self.rolling.as_ref().map_or(0.0, |rolling| rolling.wheels[robot].yaw_rate());
        Observation {
            dynamics: of_team.episode.dynamics(),
            frame,
            heading: Some(frame.turn_angle(self.heading(robot))),
            yaw_rate: Some(yaw_rate),
            elapsed: of_team.elapsed(),
            ..scenario.observe(task, estimate)
        }
    }

    /// Returns the observation of a robot with the motion `estimate`, world frame, and changes the `memory` that its
    /// channels have of it. Noise of senses is drawn from `stream`; without it there is none.
    fn seen(
        &self,
        (entries, channels, memory): (&[Entry], &mut Channels, &mut [f32]),
        (team, robot): (usize, usize),
        estimate: &Motion,
        stream: Option<&mut Stream>,
    ) -> Vec<f32> {
        let range = self.teams[team].range();
        let place = Place {
            arena: &self.arena_now(team),
            centre: self.position[robot],
            heading: self.heading(robot),
            team: &self.position[range.clone()],
            robot: robot - range.start,
        };
        channels.sense(place, stream);
        let own = self.own((team, robot), &self.tasks[robot], estimate);
        let tasks: Vec<Option<Task>> = self.tasks[range].iter().copied().map(Some).collect();
        let values = channels.values(memory, &own, (&self.tasks[robot], &tasks));
        let mut observation = Vec::new();
        entry::append(entries, &Observation { values, ..own }, &mut observation);
        observation
    }
}
