//! Channels that a policy takes besides those of the one that is trained, with what they remember of the robots of a
//! team.

use crate::channels::Channels;
use murmurate::messages::geometry::Task;
use murmurate::observation::Observation;

/// Channels of a policy for the robots of a team in an episode; without channels it has no values.
#[derive(Debug)]
pub struct Sight {
    channels: Option<Channels>,
    /// Memories of the channels, one robot after the other.
    memory: Vec<f32>,
}

impl Sight {
    /// Returns the channels at the beginning of an episode of `robots` robots.
    pub fn new(channels: Option<&Channels>, robots: usize) -> Sight {
        let floats = channels.map_or(0, Channels::memory);
        Sight { channels: channels.cloned(), memory: vec![0.0; floats * robots] }
    }

    /// Returns the observation `own` of the robot with the index `robot` with the values of the channels. `team` are
    /// the tasks of all robots.
    ///
    /// # Panics
    /// If the task of the robot is missing.
    pub fn see(&mut self, own: Observation<'static>, robot: usize, team: &[Option<Task>]) -> Observation<'_> {
        let Sight { channels: Some(channels), memory } = self else { return own };
        let floats = memory.len() / team.len();
        let task = team[robot].as_ref().expect("in trainings every task is known");
        let values = channels.values(&mut memory[robot * floats..][..floats], &own, (task, team));
        Observation { values, ..own }
    }
}
