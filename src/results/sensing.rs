//! Newest values of robots' senses, with the true poses of the robots when they were published, for pictures of a run.

use std::collections::BTreeMap;

use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::local::Sample;
use crate::messages::wire::{Sensed, Wire};

/// Values of a robot's sense with the true pose of the robot when they were published.
#[derive(Clone, Debug)]
pub struct Sensing {
    /// Values of the sense.
    pub sensed: Sensed,
    /// Position of the robot's centre \[m\], world frame.
    pub position: Vec2,
    /// Heading of the robot \[rad\], counter-clockwise from the x axis of the world frame.
    pub heading: f32,
}

/// Newest values of each sense of each robot.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sensings(BTreeMap<(RobotId, u8), Sensing>);

impl Sensings {
    /// Takes a published message if it has values of a sense. `team` are the true states of the robots, in the order of
    /// their ids.
    pub(crate) fn take(&mut self, message: Wire, team: &[Option<Sample>]) {
        let Wire::Sensed(sensed) = message else { return };
        if let Some(Some(sample)) = team.get(sensed.robot.index()) {
            let (position, heading) = (sample.motion.position, sample.heading);
            self.0.insert((sensed.robot, sensed.sense), Sensing { sensed, position, heading });
        }
    }

    /// Returns the newest values of all senses, in the order of robots and senses.
    pub(crate) fn all(&self) -> Vec<Sensing> {
        self.0.values().cloned().collect()
    }
}
