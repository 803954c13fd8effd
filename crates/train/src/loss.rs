//! Losses of proximal policy optimisation and their derivatives, for one robot and one decision.

use super::matrix::Real;
use super::record::HALF_LOG_TWO_PI;

/// Recorded action of one robot with its advantage, from which the policy's loss is computed.
#[derive(Clone, Copy, Debug)]
pub struct Sample<T> {
    /// The action as drawn \[m/s\], policy frame.
    pub action: [T; 2],
    /// Natural logarithm of the action's probability density under the policy that drew it.
    pub log_density: T,
    /// Velocity of the expert in the same state \[m/s\], policy frame; `None` without an expert.
    pub taught: Option<[T; 2]>,
    /// Advantage of the action, normalised to mean 0 and standard deviation 1 over the rollout.
    pub advantage: T,
}

/// Coefficients of the policy's loss in one update.
#[derive(Clone, Copy, Debug)]
pub struct Terms<T> {
    /// Half width of the interval around 1 to which the probability ratio is clipped.
    pub clip: T,
    /// Weight of the entropy of the action's distribution in the loss.
    pub entropy: T,
    /// Upper limit of the log standard deviations that the network puts out.
    pub log_std_max: T,
    /// Weight in the loss of the squares of the parts of the means beyond `limit_m_s` \[s²/m²\].
    pub overshoot: T,
    /// Largest speed along each axis that robots are commanded \[m/s\].
    pub limit_m_s: T,
    /// Weight in the loss of the squared difference of the means from what was taught \[s²/m²\].
    pub imitation: T,
}

/// The policy's loss for one recorded action of one robot, with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct PolicyLoss<T> {
    /// Value of the loss, which the training minimises.
    pub loss: T,
    /// Derivatives of the loss with respect to the outputs \[mean_x, mean_y, log_std_x, log_std_y\].
    pub d_outputs: [T; 4],
    /// Estimate, from this action, of the KL divergence from the policy that drew the action (Schulman, "Approximating
    /// KL divergence", k3).
    pub divergence: T,
    /// Entropy of the action's distribution under the current policy.
    pub entropy: T,
    /// Squared difference of the means from what was taught \[m²/s²\]; 0 without an expert.
    pub disagreement: T,
}

/// Computes the policy's loss for one recorded action: the clipped surrogate loss (Schulman et al., arXiv 1707.06347,
/// equation 7) minus the weighted entropy of a diagonal normal distribution, plus the prices of means beyond the speed
/// limit, and of means other than an expert's velocity. `outputs` are those of the policy's network now: mean_x,
/// mean_y, log_std_x and log_std_y.
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
        // Derivatives of the log density.
        d_mean[axis] = unit * (-log_std).exponential();
        d_log_std[axis] = unit * unit - T::one();
    }
    let log_ratio = log_density - sample.log_density;
    let ratio = log_ratio.exponential();
    let clipped = ratio.max(T::one() - terms.clip).min(T::one() + terms.clip);
    let (surrogate, clipped) = (ratio * sample.advantage, clipped * sample.advantage);
    // If the clipped term is the smaller one, the loss does not depend on the ratio.
    let d_log_density = if surrogate <= clipped { -surrogate } else { T::zero() };
    let mut loss = -surrogate.min(clipped) - terms.entropy * entropy;
    let (mut d_outputs, mut disagreement) = ([T::zero(); 4], T::zero());
    for axis in 0..2 {
        d_outputs[axis] = d_log_density * d_mean[axis];
        // The part beyond the limit, with the mean's sign.
        let beyond = outputs[axis] - outputs[axis].max(-terms.limit_m_s).min(terms.limit_m_s);
        loss += terms.overshoot * beyond * beyond;
        d_outputs[axis] += T::of(2.0) * terms.overshoot * beyond;
        if let Some(taught) = &sample.taught {
            let difference = outputs[axis] - taught[axis];
            disagreement += difference * difference;
            d_outputs[axis] += T::of(2.0) * terms.imitation * difference;
        }
        if free[axis] {
            d_outputs[2 + axis] = d_log_density * d_log_std[axis] - terms.entropy;
        }
    }
    loss += terms.imitation * disagreement;
    PolicyLoss { loss, d_outputs, divergence: ratio - T::one() - log_ratio, entropy, disagreement }
}

/// Returns the critic's loss for one estimate, half its squared error from `target`, and the derivative of the loss
/// with respect to the estimate.
pub fn value<T: Real>(estimate: T, target: T) -> (T, T) {
    let error = estimate - target;
    (T::of(0.5) * error * error, error)
}
