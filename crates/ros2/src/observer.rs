//! Observer `ros2`: forwards poses and latents that a host receives to a DDS process, which publishes them as ROS
//! messages for other programs.

use std::collections::BTreeMap;

use murmurate::config::ConfigError;
use murmurate::edge::{Packet, Settings};
use murmurate::messages::geometry::Motion;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Features, Wire};
use murmurate::observers::{self, Parts};
use murmurate::time::{Span, Time};

use crate::observe::{self, Observation};

/// Shortest time between two publications of the team's positions, velocities and latents. Single poses are published
/// with each reading.
const PERIOD: Span = Span::from_millis(100);

/// Registry entry of the observer `ros2`.
pub const ENTRY: observers::Entry =
    observers::Entry { name: "ros2", about: "the team's state as ROS 2 messages, for rviz2 and rosbag2", make };

fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let (observation, worker) = observe::make(settings, robots)?;
    Ok(Parts { observer: Box::new(Observer::new(observation)), worker: Box::new(worker) })
}

/// Passes the readings and latents that one host receives to the worker that publishes them as ROS messages.
struct Observer {
    observation: Observation,
    team: BTreeMap<RobotId, Motion>,
    latents: BTreeMap<RobotId, Features>,
    /// Earliest time of the next publication of the team's positions, velocities and latents.
    next: Time,
}

impl Observer {
    /// Creates an observer that has received nothing, from the encoder of ROS messages.
    fn new(observation: Observation) -> Observer {
        Observer { observation, team: BTreeMap::new(), latents: BTreeMap::new(), next: Time::ZERO }
    }
}

impl observers::Observer for Observer {
    fn receive(&mut self, now: Time, message: &Wire, out: &mut Vec<Packet>) {
        match message {
            Wire::Reading(reading) => {
                let motion = Motion { position: reading.pose.position, velocity: reading.twist.velocity };
                self.team.insert(reading.robot, motion);
                out.extend(self.observation.pose(reading).map(Packet::from));
            }
            Wire::Latent(latent) => drop(self.latents.insert(latent.robot, latent.features.clone())),
            _ => return,
        }
        if now < self.next {
            return;
        }
        self.next = now + PERIOD;
        let team: Vec<(RobotId, Motion)> = self.team.iter().map(|(&robot, &motion)| (robot, motion)).collect();
        out.extend(self.observation.state(&team).map(Packet::from));
        let rows: Vec<(RobotId, &[f32])> =
            self.latents.iter().map(|(robot, features)| (*robot, &features.0[..])).collect();
        out.extend(self.observation.latents(&rows).map(Packet::from));
    }
}
