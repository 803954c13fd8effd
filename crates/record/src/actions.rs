//! Compares two policies on the recorded inputs of one host: the motor commands in the record and those of the other
//! policy, step by step.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use serde::Serialize;

use super::reader::{Messages, ReadError};
use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::messages::wire::Wire;
use murmurate::net::protocol::codec;

/// Motor commands that one host published: for each robot, times of publication since the start of the run \[ns\] and
/// commanded velocities \[m/s\] in the world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Commands(BTreeMap<u16, Vec<(u64, Vec2)>>);

/// Motor commands of one robot at one control step: the one in a record, and the one of another policy on the same
/// inputs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepDifference {
    /// Time of the step since the start of the run \[s\].
    pub at_s: f64,
    /// Id of the robot.
    pub robot: u16,
    /// Commanded velocity in the record along x and y \[m/s\], world frame.
    pub recorded: [f32; 2],
    /// Velocity that the other policy commands on the same inputs, along x and y \[m/s\], world frame.
    pub replayed: [f32; 2],
}

impl StepDifference {
    /// Returns the norm of the difference of the two velocities \[m/s\].
    pub fn size(&self) -> f64 {
        let [x, y] = [0, 1].map(|axis| f64::from(self.recorded[axis] - self.replayed[axis]));
        (x * x + y * y).sqrt()
    }
}

/// Statistics of the differences between the motor commands in a record and those of another policy, for one robot.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotDifference {
    /// Id of the robot.
    pub robot: u16,
    /// Number of steps at which both policies gave a command.
    pub steps: usize,
    /// Number of steps at which only one of the policies gave a command.
    pub unpaired: usize,
    /// Time since the start of the run \[s\] of the first step at which the two policies gave different commands;
    /// `None` if there is none.
    pub first_s: Option<f64>,
    /// Mean norm of the velocity difference \[m/s\] over the steps at which both policies gave a command.
    pub mean_m_s: f64,
    /// Largest norm of the velocity difference \[m/s\] over the steps at which both policies gave a command.
    pub most_m_s: f64,
}

impl Commands {
    /// Adds the motor command of a datagram that was published `at_ns` \[ns\] after the start of the run. A datagram
    /// with another message is ignored.
    pub fn take(&mut self, at_ns: u64, datagram: &[u8]) {
        if let Ok((_, Wire::MotorCommand(command))) = codec::decode(datagram) {
            self.0.entry(command.robot.0).or_default().push((at_ns, command.velocity));
        }
    }

    /// Reads the motor commands from the messages of a record. `anchor_ns` is the wall clock at the start of the run
    /// \[ns\] since 1970, from which the commands' times are counted.
    pub fn read(mut messages: Messages, anchor_ns: u64) -> Result<Commands, ReadError> {
        let mut commands = Commands::default();
        // Behind a gap the replay has no inputs.
        while let Some(message) = messages.next_message()?.filter(|_| messages.gaps() == 0) {
            if message.channel.topic.starts_with("/wire/") {
                commands.take(message.at.saturating_sub(anchor_ns), &message.data);
            }
        }
        Ok(commands)
    }

    /// Pairs these recorded commands with those of the replay by equal time; those of one time, such as a step and the
    /// stop after it in one turn of a busy host, in their order. Returns each paired step, and the statistics of the
    /// differences for each robot that either of them commands.
    pub fn beside(&self, replayed: &Commands) -> (Vec<StepDifference>, Vec<RobotDifference>) {
        let (mut steps, mut robots, none) = (Vec::new(), Vec::new(), Vec::new());
        let commanded: BTreeSet<&u16> = self.0.keys().chain(replayed.0.keys()).collect();
        for robot in commanded {
            let recorded = self.0.get(robot).unwrap_or(&none);
            let other = replayed.0.get(robot).unwrap_or(&none);
            let mut by_time: BTreeMap<u64, VecDeque<Vec2>> = BTreeMap::new();
            other.iter().for_each(|(at, velocity)| by_time.entry(*at).or_default().push_back(*velocity));
            let mut of = |at: &u64| by_time.get_mut(at)?.pop_front();
            let pairs = recorded.iter().filter_map(|(at, velocity)| Some((*at, *velocity, of(at)?)));
            let pair = |(at, recorded, replayed): (u64, Vec2, Vec2)| StepDifference {
                at_s: at as f64 / 1e9,
                robot: *robot,
                recorded: recorded.to_array(),
                replayed: replayed.to_array(),
            };
            let all: Vec<StepDifference> = pairs.map(pair).collect();
            let sizes: Vec<f64> = all.iter().map(StepDifference::size).collect();
            robots.push(RobotDifference {
                robot: *robot,
                steps: all.len(),
                unpaired: recorded.len() + other.len() - 2 * all.len().min(other.len()),
                first_s: all.iter().find(|step| step.size() > 0.0).map(|step| step.at_s),
                mean_m_s: sizes.iter().sum::<f64>() / sizes.len().max(1) as f64,
                most_m_s: sizes.iter().copied().fold(0.0, f64::max),
            });
            steps.extend(all);
        }
        (steps, robots)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_of_equal_times_are_paired_and_the_first_difference_is_found() {
        let commands = |all: &[(u64, f32)]| {
            let of_robot = all.iter().map(|(at, speed)| (*at, Vec2::new(*speed, 0.0))).collect();
            Commands(BTreeMap::from([(3, of_robot)]))
        };
        let recorded = commands(&[(0, 1.0), (50, 1.0), (100, 0.5), (150, 0.0)]);
        let replayed = commands(&[(0, 1.0), (50, 0.75), (100, 0.5), (175, 9.0)]);
        let (steps, robots) = recorded.beside(&replayed);
        assert_eq!(steps.len(), 3);
        let one = &robots[0];
        assert_eq!((one.steps, one.unpaired, one.first_s), (3, 2, Some(50e-9)));
        assert!((one.most_m_s - 0.25).abs() < 1e-9 && (one.mean_m_s - 0.25 / 3.0).abs() < 1e-9);
        let twice = commands(&[(0, 1.0), (0, 0.0), (50, 1.0)]);
        let one = &twice.beside(&twice).1[0];
        assert_eq!((one.steps, one.unpaired, one.first_s), (3, 0, None), "two of one time");
    }

    #[test]
    fn a_robot_that_only_the_other_policy_commands_has_its_steps_counted() {
        let commands = |robot: u16| Commands(BTreeMap::from([(robot, vec![(0, Vec2::zeros()), (50, Vec2::zeros())])]));
        let (steps, robots) = commands(1).beside(&commands(4));
        assert!(steps.is_empty());
        let unpaired: Vec<(u16, usize)> = robots.iter().map(|one| (one.robot, one.unpaired)).collect();
        assert_eq!(unpaired, [(1, 2), (4, 2)]);
    }
}
