//! Messages that the robots of a team hold at each decision. Delay, loss and age of messages are as in the actor graph,
//! but computed without actors.
//!
//! Each robot sends at its own time in every step. A message arrives after a delay or is lost. The receiver keeps it if
//! the sender is in range at its arrival, in place of an older message from that sender. The receiver uses it for the
//! hold time, counted from the arrival.

use std::ops::Range;

use rand::RngExt;

use super::conditions::{Connectivity, EpisodeConditions};
use murmurate::hearing::CommRange;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::random::Stream;
use murmurate::world::kinematic::PERIOD;

/// Number of past steps of 50 ms of which estimates are stored: enough for the longest delay plus the longest hold
/// time.
pub const HISTORY_STEPS: usize = 24;

/// Messages of one team in training: the robots' estimates of their own motions in the last steps, and the newest
/// message that each robot holds from each other robot.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct MessageBuffer {
    robots: usize,
    /// Number of steps with stored estimates.
    history: usize,
    /// Estimates \[x, y, vx, vy\] in m and m/s, world frame: by step modulo `history`, then by robot.
    estimates: Vec<[f32; 4]>,
    /// Observations of the policy, by step modulo `history`, then by robot; empty where they follow from the estimates.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    observations: Vec<f32>,
    /// Step in which the newest held message was sent: by receiver, then by sender.
    held: Vec<Option<u32>>,
    /// First step whose message is not drawn yet: by receiver, then by sender. Each message is drawn once, so one that
    /// is lost stays lost. Shorter in the checkpoints of older programs, where nothing counts as drawn.
    #[serde(default)]
    undrawn: Vec<u32>,
}

/// Message that a robot uses in a decision: its sender, the step of its sending, and its age.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldMessage {
    /// Index of the sending robot in the team.
    pub sender: usize,
    /// Number of the step of the episode in which the message was sent.
    pub step: u32,
    /// Time since the message arrived at the robot \[s\].
    pub age_s: f32,
}

impl MessageBuffer {
    /// Removes all messages and estimates, for an episode of a team of `robots` robots. If they act in lock step, only
    /// the current step's estimates are stored from then on.
    pub fn restart(&mut self, robots: usize, lockstep: bool) {
        self.robots = robots;
        self.history = if lockstep { 1 } else { HISTORY_STEPS };
        self.estimates.clear();
        self.estimates.resize(robots * self.history, [0.0; 4]);
        self.observations.clear();
        self.held.clear();
        self.held.resize(robots * robots, None);
        self.undrawn.clear();
        self.undrawn.resize(robots * robots, 0);
    }

    /// Returns whether a buffer that was read is that of a team of `robots` robots in `step`, which act in lock step or
    /// do not, with `stored` floats of each stored observation. (It has a shorter list of undrawn messages in the
    /// checkpoints of older programs.)
    pub(super) fn is_sound(&self, (robots, stored): (usize, usize), step: u32, lockstep: bool) -> bool {
        let history = if lockstep { 1 } else { HISTORY_STEPS };
        let pairs = robots * robots;
        (self.robots, self.history) == (robots, history)
            && self.estimates.len() == robots * history
            && self.estimates.as_flattened().iter().all(|number| number.is_finite())
            && self.observations.len() == robots * history * stored
            && self.observations.iter().all(|number| number.is_finite())
            && self.held.len() == pairs
            && self.held.iter().flatten().all(|held| *held <= step)
            && self.undrawn.len() <= pairs
            && self.undrawn.iter().all(|undrawn| *undrawn <= step + 1)
    }

    /// Returns the stored numbers of a step: those of one robot after the other.
    fn row(&self, step: u32) -> Range<usize> {
        // Most teams store one step alone, and a division takes as long as all else.
        let row = if self.history == 1 { 0 } else { step as usize % self.history * self.robots };
        row..row + self.robots
    }

    /// Stores the estimates of their own motions, world frame, that the robots of the team have in `step`.
    pub fn store(&mut self, step: u32, estimates: impl Iterator<Item = Motion>) {
        let row = self.row(step);
        for (to, Motion { position, velocity }) in self.estimates[row].iter_mut().zip(estimates) {
            *to = [position.x, position.y, velocity.x, velocity.y];
        }
    }

    /// Returns the estimates of their own motions, world frame, that the robots of the team had in `step`, which must
    /// be among the stored steps.
    pub fn estimates(&self, step: u32) -> impl Iterator<Item = Motion> + '_ {
        self.estimates[self.row(step)].iter().map(motion)
    }

    /// Returns the estimate of its own motion, world frame, that the robot with index `robot` in the team had in
    /// `step`, which must be among the stored steps.
    pub fn estimate(&self, step: u32, robot: usize) -> Motion {
        motion(&self.estimates[self.row(step)][robot])
    }

    /// Stores the policy's observation that the robot with index `robot` in the team has in `step`.
    pub fn store_observation(&mut self, (step, robot): (u32, usize), observation: &[f32]) {
        let width = observation.len();
        self.observations.resize(self.robots * self.history * width, 0.0);
        let at = self.row(step).start + robot;
        self.observations[at * width..][..width].copy_from_slice(observation);
    }

    /// Returns the stored observation, of `width` floats, that the robot with index `robot` in the team had in `step`,
    /// which must be among the stored steps.
    pub fn observation(&self, step: u32, robot: usize, width: usize) -> &[f32] {
        let at = self.row(step).start + robot;
        &self.observations[at * width..][..width]
    }

    /// Returns the last known motions of the other robots, world frame, each with the time since its message arrived
    /// \[s\], at the action of robot `receiver` in `step`. Only messages that `receive` has found to arrive are known.
    pub fn known<'a>(
        &'a self,
        episode: &'a EpisodeConditions,
        step: u32,
        receiver: usize,
    ) -> impl Iterator<Item = (Motion, f32)> + 'a {
        (0..self.robots).filter_map(move |sender| {
            let edge = receiver * self.robots + sender;
            let sent = self.held[edge].filter(|sent| (step - sent) < self.history as u32)?;
            let arrival_s = episode.phase_s[sender] + episode.edges[edge].0;
            let age_s = (step - sent) as f32 * PERIOD.as_secs() as f32 + episode.phase_s[receiver] - arrival_s;
            Some((self.estimate(sent, sender), age_s.max(0.0)))
        })
    }

    /// Draws which messages arrive at robot `receiver` up to its action in `step`. Then calls `each` with every message
    /// that the robot uses, in the order of the senders. `radius_m` is the communication radius \[m\]. The newest
    /// message that may be used was sent `behind` steps before: 0 if messages are made from observations, 1 if policies
    /// put them out with their actions.
    pub fn receive(
        &mut self,
        (episode, radius_m): (&EpisodeConditions, f32),
        (step, behind): (u32, u32),
        receiver: usize,
        stream: &mut Stream,
        mut each: impl FnMut(&MessageBuffer, HeldMessage),
    ) {
        let period = PERIOD.as_secs() as f32;
        let range = match episode.connectivity {
            Connectivity::Radius => CommRange { mean_m: radius_m, std_m: episode.range_std_m },
            Connectivity::Everyone => CommRange::fixed(f32::INFINITY),
        };
        for sender in (0..self.robots).filter(|&sender| sender != receiver) {
            if episode.lockstep {
                let Some(sent) = step.checked_sub(behind) else { continue };
                if self.in_range(&range, (step, receiver), (step, sender), stream) {
                    each(self, HeldMessage { sender, step: sent, age_s: behind as f32 * period });
                }
                continue;
            }
            let edge = receiver * self.robots + sender;
            let (delay_s, loss) = episode.edges[edge];
            // Times \[s\] of the message's arrival and of the receiver's action, each from the start of the step in
            // which it was sent or acts.
            let (arrival_s, now_s) = (episode.phase_s[sender] + delay_s, episode.phase_s[receiver]);
            let newest = i64::from(step) - (((arrival_s - now_s) / period).ceil() as i64).max(behind.into());
            let oldest = i64::from(step) - ((episode.hold_s + arrival_s - now_s) / period).floor() as i64;
            let undrawn = self.undrawn.get(edge).copied().unwrap_or(0);
            let undrawn = undrawn.max(self.held[edge].map_or(0, |held| held + 1));
            for sent in (oldest.max(undrawn.into())..=newest).rev() {
                let lost = loss > 0.0 && stream.random::<f32>() < loss;
                let sent = sent as u32;
                let arrived = sent + (arrival_s / period) as u32;
                if !lost && self.in_range(&range, (arrived.min(step), receiver), (sent, sender), stream) {
                    self.held[edge] = Some(sent);
                    break;
                }
            }
            if let Some(next) = self.undrawn.get_mut(edge) {
                *next = undrawn.max((newest + 1).max(0) as u32);
            }
            if let Some(sent) = self.held[edge] {
                let age_s = (step - sent) as f32 * period + now_s - arrival_s;
                if age_s <= episode.hold_s {
                    each(self, HeldMessage { sender, step: sent, age_s });
                }
            }
        }
    }

    /// Whether the sender in one step is in range of the receiver in another step; each robot is given as (step,
    /// robot).
    fn in_range(&self, range: &CommRange, receiver: (u32, usize), sender: (u32, usize), stream: &mut Stream) -> bool {
        let at = |(step, robot): (u32, usize)| self.estimate(step, robot).position;
        range.admits(at(receiver), at(sender), stream)
    }
}

fn motion(&[x, y, vx, vy]: &[f32; 4]) -> Motion {
    Motion { position: Vec2::new(x, y), velocity: Vec2::new(vx, vy) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::random::Seed;

    /// Returns how often, of `steps` decisions, the message in use was sent each number of steps before; the last
    /// entry counts decisions without a message. A robot decides every `repeat` steps.
    fn ages(episode: &EpisodeConditions, steps: u32, repeat: u32) -> Vec<u32> {
        let mut stream = Seed::of_run(5).stream("ages");
        let mut messages = MessageBuffer::default();
        messages.restart(2, false);
        let mut counts = vec![0; HISTORY_STEPS + 1];
        for step in 0..steps {
            messages.store(step, (0..2).map(|robot| Motion::at_rest(Vec2::new(robot as f32, 0.0))));
            if !step.is_multiple_of(repeat) {
                continue;
            }
            let mut sent = HISTORY_STEPS;
            messages.receive((episode, 2.0), (step, 0), 0, &mut stream, |_, message| {
                sent = (step - message.step) as usize;
            });
            counts[sent] += 1;
        }
        counts
    }

    #[test]
    fn a_lost_message_stays_lost_however_often_a_robot_decides() {
        let (loss, steps) = (0.5, 40_000);
        let mut episode = EpisodeConditions { lockstep: false, hold_s: 0.22, ..EpisodeConditions::perfect(2) };
        episode.edges.fill((0.0, loss));
        for repeat in [1, 2, 4] {
            let counts = ages(&episode, steps, repeat);
            // The newest message of k steps before is in use if it has arrived and all later ones were lost.
            let decisions = f64::from(steps / repeat);
            for (age, count) in counts[..5].iter().enumerate() {
                let (share, expected) = (f64::from(*count) / decisions, f64::from(loss).powi(age as i32 + 1));
                assert!((share - expected).abs() < 0.02, "every {repeat} steps: age {age}: {share}, not {expected}");
            }
            assert_eq!(counts[5..HISTORY_STEPS], [0; HISTORY_STEPS - 5], "nothing is used beyond the hold time");
            let none = f64::from(counts[HISTORY_STEPS]) / decisions;
            assert!((none - f64::from(loss).powi(5)).abs() < 0.02, "every {repeat} steps: {none} without a message");
        }
    }
}
