//! Update of policy and critic from the data of a rollout: epochs of minibatches with clipped gradients, and an early
//! stop at a limit of the KL divergence.
//!
//! A minibatch is of windows of decisions: single ones, or successive ones of a recurrent policy.

use rand::seq::SliceRandom;

use super::batch::Batch;
use super::learner::{Learner, SHARDS};
use super::loss::{self, Sample, Terms};
use super::network::{Space, TeamNetwork, TeamSpace};
use super::parallel::in_parallel;
use super::record::Experience;
use super::rollout::{CHUNK, RolloutSettings};
use murmurate::random::Stream;

/// Statistics of one update of policy and critic.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Number of epochs; fractional if the update stopped within an epoch.
    pub epochs: f32,
    /// KL divergence of the policy from the policy before the update, the mean over the last epoch.
    pub divergence: f32,
    /// Mean entropy of the policy's action distribution.
    pub entropy: f32,
    /// Mean loss of the critic over the update.
    pub value_loss: f32,
    /// Mean norm of the policy's gradient before clipping.
    pub gradient: f32,
    /// Mean squared difference of the policy's mean velocities from those of its expert \[m²/s²\]; `None` without one.
    pub disagreement: Option<f32>,
}

/// Error of an update in which a value became NaN or infinite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotFinite {
    /// Name of the first quantity that was not finite.
    pub what: &'static str,
}

/// Buffers and sums of one shard of a minibatch.
#[derive(Debug, Default)]
struct Shard {
    /// Windows of decisions of the shard, each as (index of its record, index of the window in the record).
    windows: Vec<(u32, u32)>,
    actor: Vec<f32>,
    critic: Vec<f32>,
    batch: Batch<f32>,
    actor_space: TeamSpace<f32>,
    critic_space: Space<f32>,
    d_outputs: Vec<f32>,
    /// Number of samples: decisions of robots.
    samples: usize,
    divergence: f32,
    entropy: f32,
    disagreement: f32,
    value_loss: f32,
}

/// Buffers of an update, reused from one update to the next.
#[derive(Debug, Default)]
pub struct Workspace {
    shards: Vec<Shard>,
    order: Vec<(u32, u32)>,
}

impl Workspace {
    /// Lists the windows of `length` decisions of all records.
    fn begin(&mut self, records: &[&Experience], length: usize) {
        self.shards.resize_with(SHARDS, Shard::default);
        self.order.clear();
        for (index, record) in records.iter().enumerate() {
            self.order.extend((0..record.windows(length) as u32).map(|window| (index as u32, window)));
        }
    }
}

/// Updates `actor`, the policy, and `critic` by proximal policy optimisation from the decisions of all records, on up
/// to `threads` threads. The pair of floats is (learning rate, weight of the entropy); `stream` shuffles the decisions.
///
/// # Errors
/// If a value is NaN or infinite; the error names the first one.
#[expect(clippy::too_many_arguments, reason = "they are unrelated; a struct of them would serve this call only")]
pub fn update(
    settings: &RolloutSettings,
    records: &[&Experience],
    actor: &mut Learner<TeamNetwork>,
    critic: &mut Learner,
    (learning_rate, entropy): (f32, f32),
    threads: usize,
    workspace: &mut Workspace,
    stream: &mut Stream,
) -> Result<Outcome, NotFinite> {
    let ppo = &settings.config.ppo;
    let (mean, scale) = advantage_statistics(records);
    if !mean.is_finite() || !scale.is_finite() {
        return Err(NotFinite { what: "the advantages" });
    }
    let extent = settings.window();
    workspace.begin(records, extent.0);
    let terms = terms(settings, entropy);
    let mut outcome = Outcome { disagreement: settings.expert.map(|_| 0.0), ..Outcome::default() };
    let mut minibatches = 0.0;
    for _ in 0..ppo.epochs {
        workspace.order.shuffle(stream);
        let (mut divergence, mut epoch_minibatches) = (0.0, 0.0);
        for minibatch in workspace.order.chunks((ppo.minibatch / extent.0).max(1)) {
            for (at, shard) in workspace.shards.iter_mut().enumerate() {
                let start = |at: usize| minibatch.len() * at / SHARDS;
                shard.windows.clear();
                shard.windows.extend_from_slice(&minibatch[start(at)..start(at + 1)]);
            }
            let (a, c) = (&*actor, &*critic);
            in_parallel(threads, workspace.shards.iter_mut(), |shard| {
                shard.compute_gradients(records, extent, (a, c), &terms, (mean, scale));
            });
            let robots = workspace.shards.iter().map(|shard| shard.samples).sum::<usize>() as f32;
            let gradients = workspace.shards.iter_mut().map(|shard| &mut shard.actor);
            let norm = actor.step(gradients, robots, ppo.gradient_clip, learning_rate);
            let norm = norm.ok_or(NotFinite { what: "the policy's gradient" })?;
            let gradients = workspace.shards.iter_mut().map(|shard| &mut shard.critic);
            let stepped = critic.step(gradients, robots, ppo.gradient_clip, learning_rate);
            stepped.ok_or(NotFinite { what: "the critic's gradient" })?;
            let sum = |pick: fn(&Shard) -> f32| workspace.shards.iter().map(pick).sum::<f32>() / robots;
            divergence += sum(|shard| shard.divergence);
            outcome.entropy += sum(|shard| shard.entropy);
            outcome.disagreement.iter_mut().for_each(|disagreement| *disagreement += sum(|shard| shard.disagreement));
            outcome.value_loss += sum(|shard| shard.value_loss);
            outcome.gradient += norm;
            minibatches += 1.0;
            epoch_minibatches += 1.0;
            outcome.epochs += minibatch.len() as f32 / workspace.order.len() as f32;
            if divergence / epoch_minibatches > ppo.kl_stop {
                break;
            }
        }
        outcome.divergence = divergence / epoch_minibatches;
        if outcome.divergence > ppo.kl_stop {
            break;
        }
    }
    outcome.entropy /= minibatches;
    outcome.disagreement.iter_mut().for_each(|disagreement| *disagreement /= minibatches);
    outcome.value_loss /= minibatches;
    outcome.gradient /= minibatches;
    Ok(outcome)
}

/// Returns the coefficients of the policy's loss, with this weight of the entropy.
fn terms(settings: &RolloutSettings, entropy: f32) -> Terms<f32> {
    Terms {
        clip: settings.config.ppo.clip,
        entropy,
        log_std_max: settings.log_std_max,
        overshoot: settings.config.ppo.overshoot,
        limit_m_s: settings.config.policy.limit_m_s,
        imitation: settings.expert.map_or(0.0, |taught| taught.weight),
    }
}

/// Returns the mean and standard deviation of the advantages in all records.
fn advantage_statistics(records: &[&Experience]) -> (f32, f32) {
    let all = || records.iter().flat_map(|record| &record.advantage).map(|&advantage| f64::from(advantage));
    let count = all().count() as f64;
    let mean = all().sum::<f64>() / count;
    let variance = all().map(|advantage| (advantage - mean).powi(2)).sum::<f64>() / count;
    (mean as f32, (variance.sqrt() + 1e-8) as f32)
}

impl Shard {
    /// Computes the gradients of the losses of policy and critic over the shard's windows, each of up to so many
    /// decisions and decisions before them as `extent` says.
    fn compute_gradients(
        &mut self,
        records: &[&Experience],
        extent: (usize, usize),
        (actor, critic): (&Learner<TeamNetwork>, &Learner),
        terms: &Terms<f32>,
        (mean, scale): (f32, f32),
    ) {
        for (gradient, parameters) in [(&mut self.actor, &actor.parameters), (&mut self.critic, &critic.parameters)] {
            gradient.clear();
            gradient.resize(parameters.len(), 0.0);
        }
        (self.samples, self.divergence, self.entropy, self.disagreement, self.value_loss) = (0, 0.0, 0.0, 0.0, 0.0);
        let robots = records[0].actor.robots;
        for windows in self.windows.chunks((CHUNK / extent.0).max(1)) {
            let windows = || windows.iter().map(|&(record, window)| (records[record as usize], window as usize));
            let decisions = || {
                windows().flat_map(|(record, window)| {
                    record.decisions_of(window, extent.0).map(move |decision| (record, decision))
                })
            };
            let samples = || {
                decisions().flat_map(|(record, decision)| {
                    (decision * robots..(decision + 1) * robots).map(move |at| (record, at))
                })
            };
            self.batch.gather(windows().map(|(record, window)| record.window(window, extent)));
            actor.network.forward(&actor.parameters, &self.batch, &mut self.actor_space);
            self.d_outputs.clear();
            for (outputs, (record, at)) in self.actor_space.outputs().chunks_exact(4).zip(samples()) {
                let sample = Sample {
                    action: record.action[at],
                    log_density: record.log_density[at],
                    taught: record.taught.get(at).copied(),
                    advantage: (record.advantage[at] - mean) / scale,
                };
                let policy = loss::policy(outputs, &sample, terms);
                self.samples += 1;
                self.d_outputs.extend_from_slice(&policy.d_outputs);
                self.divergence += policy.divergence;
                self.entropy += policy.entropy;
                self.disagreement += policy.disagreement;
            }
            let (batch, space) = (&self.batch, &mut self.actor_space);
            actor.network.backward(&actor.parameters, batch, &self.d_outputs, space, &mut self.actor);

            self.batch.gather(decisions().map(|(record, decision)| record.critic.window(decision, 1)));
            critic.network.forward(&critic.parameters, &self.batch, &mut self.critic_space);
            self.d_outputs.clear();
            for (estimate, (record, at)) in self.critic_space.outputs().iter().zip(samples()) {
                let (loss, d_estimate) = loss::value(*estimate, record.target[at]);
                self.value_loss += loss;
                self.d_outputs.push(d_estimate);
            }
            let (batch, space) = (&self.batch, &mut self.critic_space);
            critic.network.backward(&critic.parameters, batch, &self.d_outputs, space, &mut self.critic);
        }
    }
}
