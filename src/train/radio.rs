//! What a robot has heard at the moment of a decision, for many robots at once: the message timing of the actor
//! graph, without its actors.
//!
//! Robot j speaks at its own phase in every step; its message takes a delay, may be lost, is kept if it was within
//! range when it arrived, replaces an older one, and is of use for the hold window from its arrival.

use rand::RngExt;

use super::conditions::{Episode, Reach};
use crate::hearing::CommRange;
use crate::messages::geometry::{Motion, Vec2};
use crate::random::Stream;
use crate::world::kinematic::PERIOD;

/// How many steps of the past are remembered: the longest delay and the longest hold, and a step to spare.
pub const MEMORY: usize = 24;

/// The estimates of a team over its last steps, and what each robot holds of each other.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct Radio {
    robots: usize,
    /// How many steps are remembered.
    memory: usize,
    /// By step modulo `memory`, then by robot.
    past: Vec<[f32; 4]>,
    /// By receiver, then by sender: the step of the newest message that is held.
    held: Vec<Option<u32>>,
}

/// A message that a robot acts on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heard {
    /// Who spoke.
    pub sender: usize,
    /// In which step.
    pub step: u32,
    /// How long ago it arrived \[s\].
    pub age_s: f32,
}

impl Radio {
    /// Nothing heard yet. In lock step only the present matters.
    pub fn restart(&mut self, robots: usize, lockstep: bool) {
        self.robots = robots;
        self.memory = if lockstep { 1 } else { MEMORY };
        self.past.clear();
        self.past.resize(robots * self.memory, [0.0; 4]);
        self.held.clear();
        self.held.resize(robots * robots, None);
    }

    /// Remembers a robot's estimate in a step.
    pub fn remember(&mut self, step: u32, robot: usize, estimate: &Motion) {
        let (p, v) = (estimate.position, estimate.velocity);
        self.past[step as usize % self.memory * self.robots + robot] = [p.x, p.y, v.x, v.y];
    }

    /// A robot's estimate in a step that is still remembered.
    pub fn estimate(&self, step: u32, robot: usize) -> Motion {
        let [x, y, vx, vy] = self.past[step as usize % self.memory * self.robots + robot];
        Motion { position: Vec2::new(x, y), velocity: Vec2::new(vx, vy) }
    }

    /// What robot `receiver` acts on in `step`, by sender.
    pub fn hear(
        &mut self,
        episode: &Episode,
        radius_m: f32,
        step: u32,
        receiver: usize,
        stream: &mut Stream,
        mut each: impl FnMut(&Radio, Heard),
    ) {
        let period = PERIOD.as_secs() as f32;
        let range = match episode.reach {
            Reach::Radius => CommRange { mean_m: radius_m, std_m: episode.range_std_m },
            Reach::Everyone => CommRange::fixed(f32::INFINITY),
        };
        for sender in (0..self.robots).filter(|&sender| sender != receiver) {
            if episode.lockstep {
                if self.near(&range, (step, receiver), (step, sender), stream) {
                    each(self, Heard { sender, step, age_s: 0.0 });
                }
                continue;
            }
            let edge = receiver * self.robots + sender;
            let (delay_s, loss) = episode.edges[edge];
            // From the beginning of the sender's step to the message's arrival, and to the receiver's own moment.
            let (arrival_s, now_s) = (episode.phase_s[sender] + delay_s, episode.phase_s[receiver]);
            let newest = i64::from(step) - ((arrival_s - now_s) / period).ceil() as i64;
            let oldest = i64::from(step) - ((episode.hold_s + arrival_s - now_s) / period).floor() as i64;
            let known = self.held[edge].map_or(-1, i64::from);
            for spoken in (oldest.max(known + 1).max(0)..=newest).rev() {
                let lost = loss > 0.0 && stream.random::<f32>() < loss;
                let spoken = spoken as u32;
                let arrived = spoken + (arrival_s / period) as u32;
                if !lost && self.near(&range, (arrived.min(step), receiver), (spoken, sender), stream) {
                    self.held[edge] = Some(spoken);
                    break;
                }
            }
            if let Some(spoken) = self.held[edge] {
                let age_s = (step - spoken) as f32 * period + now_s - arrival_s;
                if age_s <= episode.hold_s {
                    each(self, Heard { sender, step: spoken, age_s });
                }
            }
        }
    }

    /// Whether a robot in one step was within range of another in a step.
    fn near(&self, range: &CommRange, receiver: (u32, usize), sender: (u32, usize), stream: &mut Stream) -> bool {
        let at = |(step, robot): (u32, usize)| self.estimate(step, robot).position;
        range.admits(at(receiver), at(sender), stream)
    }
}
