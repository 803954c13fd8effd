//! The losses of proximal policy optimisation and their derivatives, for one robot and one decision.

use super::matrix::Real;
use super::record::HALF_LOG_TWO_PI;

/// What was done, and what came of it.
#[derive(Clone, Copy, Debug)]
pub struct Sample<T> {
    /// The action as drawn \[m/s\].
    pub action: [T; 2],
    /// Its log density when it was drawn.
    pub log_density: T,
    /// How much better than expected it was.
    pub advantage: T,
}

/// The policy's settings of the moment.
#[derive(Clone, Copy, Debug)]
pub struct Terms<T> {
    /// How far the ratio may move.
    pub clip: T,
    /// Weight of the entropy.
    pub entropy: T,
    /// Cap on the log standard deviation.
    pub log_std_max: T,
}

/// The policy's loss of one sample.
#[derive(Clone, Copy, Debug)]
pub struct PolicyLoss<T> {
    /// The loss: to be made small.
    pub loss: T,
    /// Its derivatives by \[mean_x, mean_y, log_std_x, log_std_y\].
    pub d_outputs: [T; 4],
    /// Estimate of the divergence from the old policy (Schulman, "Approximating KL divergence", k3).
    pub divergence: T,
    /// Entropy of the distribution.
    pub entropy: T,
}

/// The clipped surrogate (arXiv 1707.06347, equation 7) less the weighed entropy of a diagonal normal.
pub fn policy<T: Real>(outputs: &[T], sample: &Sample<T>, terms: &Terms<T>) -> PolicyLoss<T> {
    let half = T::of(0.5);
    let (mut log_density, mut entropy) = (T::zero(), T::zero());
    let (mut d_mean, mut d_log_std, mut free) = ([T::zero(); 2], [T::zero(); 2], [false; 2]);
    for axis in 0..2 {
        free[axis] = outputs[2 + axis] < terms.log_std_max;
        let log_std = if free[axis] { outputs[2 + axis] } else { terms.log_std_max };
        let unit = (sample.action[axis] - outputs[axis]) * (-log_std).exponential();
        log_density = log_density - half * unit * unit - log_std - T::of(HALF_LOG_TWO_PI);
        entropy = entropy + log_std + half + T::of(HALF_LOG_TWO_PI);
        // Of the log density.
        d_mean[axis] = unit * (-log_std).exponential();
        d_log_std[axis] = unit * unit - T::one();
    }
    let log_ratio = log_density - sample.log_density;
    let ratio = log_ratio.exponential();
    let clipped = ratio.max(T::one() - terms.clip).min(T::one() + terms.clip);
    let (plain, cut) = (ratio * sample.advantage, clipped * sample.advantage);
    // Where the clipped one is the smaller, the ratio has no say.
    let d_log_density = if plain <= cut { -plain } else { T::zero() };
    let mut d_outputs = [T::zero(); 4];
    for axis in 0..2 {
        d_outputs[axis] = d_log_density * d_mean[axis];
        if free[axis] {
            d_outputs[2 + axis] = d_log_density * d_log_std[axis] - terms.entropy;
        }
    }
    PolicyLoss {
        loss: -plain.min(cut) - terms.entropy * entropy,
        d_outputs,
        divergence: ratio - T::one() - log_ratio,
        entropy,
    }
}

/// The critic's loss, half the square of its error, and its derivative by the estimate.
pub fn value<T: Real>(estimate: T, target: T) -> (T, T) {
    let error = estimate - target;
    (T::of(0.5) * error * error, error)
}
