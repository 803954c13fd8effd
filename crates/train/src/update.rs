//! Update of policy and critic from the data of a rollout: epochs of minibatches with clipped gradients, and an early
//! stop at a limit of the KL divergence.
//!
//! A minibatch is split into a fixed number of shards, each with its own gradient. The gradients are added in the order
//! of the shards, so the sum does not depend on the number of threads.

use rand::seq::SliceRandom;

use super::adam::{Adam, clip};
use super::batch::Batch;
use super::config::Ppo;
use super::loss::{self, Sample, Terms};
use super::network::{Space, TrainableGnn};
use super::parallel::in_parallel;
use super::record::Experience;
use super::rollout::{CHUNK, RolloutSettings};
use murmurate::random;
use murmurate::random::{Seed, Stream};

/// Number of shards of a minibatch: more than the useful number of threads, and few enough that adding them is cheap.
const SHARDS: usize = 8;

/// A network with its parameters and its optimiser's state.
#[derive(Clone, Debug)]
pub struct Learner {
    /// Layer widths of the network, and the places of its layers in `parameters`.
    pub network: TrainableGnn,
    /// All weights and biases of the network, in one vector.
    pub parameters: Vec<f32>,
    /// State of the network's optimiser.
    pub adam: Adam,
}

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
    /// Decisions of the shard, each as (index of its record, index of the decision in the record).
    decisions: Vec<(u32, u32)>,
    actor: Vec<f32>,
    critic: Vec<f32>,
    batch: Batch<f32>,
    actor_space: Space<f32>,
    critic_space: Space<f32>,
    d_outputs: Vec<f32>,
    divergence: f32,
    entropy: f32,
    value_loss: f32,
}

/// Buffers of an update, reused from one update to the next.
#[derive(Debug, Default)]
pub struct Workspace {
    shards: Vec<Shard>,
    order: Vec<(u32, u32)>,
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
    actor: &mut Learner,
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
    workspace.shards.resize_with(SHARDS, Shard::default);
    workspace.order.clear();
    for (index, record) in records.iter().enumerate() {
        workspace.order.extend((0..record.actor.len() as u32).map(|decision| (index as u32, decision)));
    }
    let terms = Terms {
        clip: ppo.clip,
        entropy,
        log_std_max: settings.log_std_max,
        overshoot: ppo.overshoot,
        limit_m_s: settings.config.policy.limit_m_s,
    };
    let mut outcome = Outcome::default();
    let mut minibatches = 0.0;
    for _ in 0..ppo.epochs {
        workspace.order.shuffle(stream);
        let (mut divergence, mut epoch_minibatches) = (0.0, 0.0);
        for minibatch in workspace.order.chunks(ppo.minibatch) {
            for (at, shard) in workspace.shards.iter_mut().enumerate() {
                let start = |at: usize| minibatch.len() * at / SHARDS;
                shard.decisions.clear();
                shard.decisions.extend_from_slice(&minibatch[start(at)..start(at + 1)]);
            }
            let (a, c) = (&*actor, &*critic);
            in_parallel(threads, workspace.shards.iter_mut(), |shard| {
                shard.compute_gradients(records, (a, c), &terms, (mean, scale));
            });
            let robots = records[0].actor.robots as f32 * minibatch.len() as f32;
            let norm =
                gradient_step(actor, &mut workspace.shards, |shard| &mut shard.actor, robots, learning_rate, ppo)
                    .ok_or(NotFinite { what: "the policy's gradient" })?;
            gradient_step(critic, &mut workspace.shards, |shard| &mut shard.critic, robots, learning_rate, ppo)
                .ok_or(NotFinite { what: "the critic's gradient" })?;
            let sum = |pick: fn(&Shard) -> f32| workspace.shards.iter().map(pick).sum::<f32>() / robots;
            divergence += sum(|shard| shard.divergence);
            outcome.entropy += sum(|shard| shard.entropy);
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
    outcome.value_loss /= minibatches;
    outcome.gradient /= minibatches;
    Ok(outcome)
}

/// Returns the mean and standard deviation of the advantages in all records.
fn advantage_statistics(records: &[&Experience]) -> (f32, f32) {
    let all = || records.iter().flat_map(|record| &record.advantage).map(|&advantage| f64::from(advantage));
    let count = all().count() as f64;
    let mean = all().sum::<f64>() / count;
    let variance = all().map(|advantage| (advantage - mean).powi(2)).sum::<f64>() / count;
    (mean as f32, (variance.sqrt() + 1e-8) as f32)
}

/// Adds the shards' gradients, divides the sum by the number of samples `robots`, and takes one step of the optimiser.
/// Returns the gradient's norm before clipping; `None` if the norm is not finite.
fn gradient_step(
    learner: &mut Learner,
    shards: &mut [Shard],
    of: fn(&mut Shard) -> &mut Vec<f32>,
    robots: f32,
    learning_rate: f32,
    ppo: &Ppo,
) -> Option<f32> {
    let (first, rest) = shards.split_first_mut().expect("there are shards");
    let sum = of(first);
    for shard in rest {
        sum.iter_mut().zip(of(shard)).for_each(|(sum, gradient)| *sum += *gradient);
    }
    sum.iter_mut().for_each(|gradient| *gradient /= robots);
    let norm = clip(sum, ppo.gradient_clip);
    if !norm.is_finite() {
        return None;
    }
    learner.adam.step(&mut learner.parameters, sum, learning_rate);
    Some(norm)
}

impl Shard {
    /// Computes the gradients of the losses of policy and critic over the shard's decisions.
    fn compute_gradients(
        &mut self,
        records: &[&Experience],
        (actor, critic): (&Learner, &Learner),
        terms: &Terms<f32>,
        (mean, scale): (f32, f32),
    ) {
        for (gradient, learner) in [(&mut self.actor, actor), (&mut self.critic, critic)] {
            gradient.clear();
            gradient.resize(learner.parameters.len(), 0.0);
        }
        (self.divergence, self.entropy, self.value_loss) = (0.0, 0.0, 0.0);
        let robots = records[0].actor.robots;
        for decisions in self.decisions.chunks(CHUNK) {
            let samples = || {
                decisions.iter().flat_map(|&(record, decision)| {
                    let first = decision as usize * robots;
                    (first..first + robots).map(move |at| (records[record as usize], at))
                })
            };
            self.batch.gather(decisions.iter().map(|&(r, d)| (&records[r as usize].actor, d as usize)));
            actor.network.forward(&actor.parameters, &self.batch, &mut self.actor_space);
            self.d_outputs.clear();
            for (outputs, (record, at)) in self.actor_space.outputs().chunks_exact(4).zip(samples()) {
                let sample = Sample {
                    action: record.action[at],
                    log_density: record.log_density[at],
                    advantage: (record.advantage[at] - mean) / scale,
                };
                let policy = loss::policy(outputs, &sample, terms);
                self.d_outputs.extend_from_slice(&policy.d_outputs);
                self.divergence += policy.divergence;
                self.entropy += policy.entropy;
            }
            let (batch, space) = (&self.batch, &mut self.actor_space);
            actor.network.backward(&actor.parameters, batch, &self.d_outputs, space, &mut self.actor);

            self.batch.gather(decisions.iter().map(|&(r, d)| (&records[r as usize].critic, d as usize)));
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

/// Returns initial parameters of `network`, drawn from normal distributions whose variance preserves the size of
/// activations (He et al., arXiv 1502.01852). The weights of the output layer are near zero, so that an untrained
/// policy stands still; `bias` is the bias of that layer, and all other biases are zero.
pub fn initial(network: &TrainableGnn, seed: Seed, bias: &[f32]) -> Vec<f32> {
    let mut stream = seed.stream("train/initial");
    let mut parameters = vec![0.0; network.parameters()];
    for (index, layers) in network.layers().into_iter().enumerate() {
        let depth = layers.len();
        for (at, (inputs, weight, biases, end)) in layers.into_iter().enumerate() {
            let last = at + 1 == depth;
            let gain = if last { 1.0 } else { 2.0f32 };
            let std = if last && index == 2 { 0.01 } else { (gain / inputs as f32).sqrt() };
            for parameter in &mut parameters[weight..biases] {
                *parameter = std * random::normals(&mut stream)[0] as f32;
            }
            if last && index == 2 {
                parameters[biases..end].copy_from_slice(bias);
            }
        }
    }
    parameters
}
