//! Buffers of vectorised environments, and the parts that each environment has of them.

use crate::parallel::cut;

/// Buffers that a step fills, in row-major order. N is the number of environments, R that of robots in each, F that of
/// floats of an observation, and M that of floats of a message.
#[derive(Debug)]
pub struct Buffers<'a> {
    /// Observations \[N, R, F\]: pairs of floats \[m\] in the policy frame, after a reset where there was one.
    pub observation: &'a mut [f32],
    /// Observations \[N, R, F\] before a reset: where an episode has ended, its last ones.
    pub last_observation: &'a mut [f32],
    /// Rewards of the robots for the step \[N, R\].
    pub reward: &'a mut [f32],
    /// Whether the episode has ended because all robots have arrived \[N\].
    pub terminated: &'a mut [bool],
    /// Whether the episode has ended because its time is over before all robots have arrived \[N\].
    pub truncated: &'a mut [bool],
    /// Whether each robot has arrived \[N, R\], before a reset.
    pub arrived: &'a mut [bool],
    /// Whether a receiver uses a message of a sender \[N, R, R\], by receiver and then by sender; empty without
    /// messages.
    pub heard: &'a mut [bool],
    /// Time \[s\] since the arrival of the message in use, \[N, R, R\], by receiver and then by sender, 0 where there
    /// is none; empty without messages.
    pub age_s: &'a mut [f32],
    /// Content of the message in use, \[N, R, R, M\], by receiver and then by sender, zeros where there is none; empty
    /// without messages.
    pub message: &'a mut [f32],
    /// Distances along the rays of each robot's lidar \[m\], \[N, R, K\], the range for no echo, after a reset where
    /// there was one. Rays all around are numbered in the policy frame, others in the robot's own frame. Empty without
    /// a lidar.
    pub scan: &'a mut [f32],
    /// Distances before a reset \[m\], \[N, R, K\]: where an episode has ended, its last ones.
    pub last_scan: &'a mut [f32],
}

/// Numbers of robots and floats that give the lengths of one environment's part of each buffer.
#[derive(Clone, Copy, Debug)]
pub struct Lengths {
    /// Number R of robots in an environment.
    pub robots: usize,
    /// Number F of floats of an observation.
    pub observation: usize,
    /// Number M of floats of a message; 0 without messages.
    pub message: usize,
    /// Number K of rays of a lidar; 0 without one.
    pub rays: usize,
}

impl Lengths {
    pub(super) fn edges(self) -> usize {
        if self.message > 0 { self.robots * self.robots } else { 0 }
    }
}

impl<'a> Buffers<'a> {
    /// Returns the parts of the environment with index `row`.
    #[inline]
    pub(super) fn row(&mut self, row: usize, lengths: Lengths) -> Buffers<'_> {
        fn part<T>(all: &mut [T], row: usize, length: usize) -> &mut [T] {
            &mut all[row * length..][..length]
        }
        let Lengths { robots, observation, message, rays } = lengths;
        let edges = lengths.edges();
        Buffers {
            observation: part(self.observation, row, robots * observation),
            last_observation: part(self.last_observation, row, robots * observation),
            reward: part(self.reward, row, robots),
            terminated: part(self.terminated, row, 1),
            truncated: part(self.truncated, row, 1),
            arrived: part(self.arrived, row, robots),
            heard: part(self.heard, row, edges),
            age_s: part(self.age_s, row, edges),
            message: part(self.message, row, edges * message),
            scan: part(self.scan, row, robots * rays),
            last_scan: part(self.last_scan, row, robots * rays),
        }
    }

    /// Splits off the parts of the first `environments`.
    pub(super) fn take(&mut self, environments: usize, lengths: Lengths) -> Buffers<'a> {
        let Lengths { robots, observation, message, rays } = lengths;
        let (rows, edges) = (environments * robots, environments * lengths.edges());
        Buffers {
            observation: cut(&mut self.observation, rows * observation),
            last_observation: cut(&mut self.last_observation, rows * observation),
            reward: cut(&mut self.reward, rows),
            terminated: cut(&mut self.terminated, environments),
            truncated: cut(&mut self.truncated, environments),
            arrived: cut(&mut self.arrived, rows),
            heard: cut(&mut self.heard, edges),
            age_s: cut(&mut self.age_s, edges),
            message: cut(&mut self.message, edges * message),
            scan: cut(&mut self.scan, rows * rays),
            last_scan: cut(&mut self.last_scan, rows * rays),
        }
    }
}
