//! Reception of neighbours' messages by a robot: the communication range R_COM of the paper (section III), and how
//! long a message is used.

use serde::{Deserialize, Serialize};

use crate::messages::geometry::Vec2;
use crate::random;
use crate::random::Stream;

/// Largest number of other robots that one robot keeps messages or readings of; far more than fit within any
/// communication range.
pub(crate) const MAX_NEIGHBOURS: usize = 256;

/// Rule for how long a robot uses a received message of a neighbour: until it is too old, or for one control step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handling {
    /// The newest message of each neighbour is used at every control step until it is older than the policy's hold
    /// time.
    Hold,
    /// Each message is used for one control step and then dropped, as in the published system of the paper.
    AsPublished,
}

/// Radius within which a robot receives its neighbours' messages. It is fixed, or drawn from a normal distribution for
/// every received message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommRange {
    /// Mean of the communication range \[m\].
    pub mean_m: f32,
    /// Standard deviation of the communication range \[m\]; zero for a fixed range. A negative draw counts as range
    /// zero.
    #[serde(default)]
    pub std_m: f32,
}

impl CommRange {
    /// Makes a communication range of exactly `mean_m` \[m\].
    pub fn fixed(mean_m: f32) -> CommRange {
        CommRange { mean_m, std_m: 0.0 }
    }

    /// Returns whether a robot at `receiver` receives one message from a robot at `sender` (positions \[m\] in the same
    /// frame). A random range is drawn from `stream`. A distance equal to the range is within range, as in the paper's
    /// published system.
    pub fn admits(&self, receiver: Vec2, sender: Vec2, stream: &mut Stream) -> bool {
        let square = (receiver - sender).norm_squared();
        if self.std_m > 0.0 {
            let beyond_m = f64::from(square.sqrt()) - f64::from(self.mean_m);
            return random::normal_reaches(beyond_m / f64::from(self.std_m), stream);
        }
        square <= self.mean_m * self.mean_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;

    #[test]
    fn a_random_range_is_drawn_per_message() {
        let mut stream = Seed::of_run(1).stream("range");
        let range = CommRange { mean_m: 2.0, std_m: 0.5 };
        let at = |x| Vec2::new(x, 0.0);
        let heard = (0..1000).filter(|_| range.admits(at(0.0), at(2.0), &mut stream)).count();
        assert!((450..550).contains(&heard), "half of the ranges exceed the mean, not {heard} of 1000");
        assert!(!CommRange::fixed(2.0).admits(at(0.0), at(2.001), &mut stream));
        assert!(CommRange::fixed(f32::INFINITY).admits(at(0.0), at(1e9), &mut stream));
    }
}
