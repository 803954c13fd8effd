//! One update of both networks from all records: epochs of minibatches, clipped, watched, cut short.
//!
//! A minibatch is split into a fixed number of shards, each with its own gradient; these are added in the order of
//! the shards, so the sum does not depend on which thread computed which.

use rand::seq::SliceRandom;

use super::adam::{Adam, cut};
use super::batch::Batch;
use super::config::Ppo;
use super::loss::{self, Sample, Terms};
use super::network::{Network, Space};
use super::parallel::in_parallel;
use super::record::Record;
use super::rollout::{CHUNK, Rules};
use crate::random;
use crate::random::{Seed, Stream};

/// Shards of a minibatch: more than threads that are of use, few enough to add up.
const SHARDS: usize = 8;

/// A network with its parameters and what its optimiser remembers.
#[derive(Clone, Debug)]
pub struct Learner {
    /// The layout.
    pub network: Network,
    /// All weights and biases.
    pub parameters: Vec<f32>,
    /// Moments of their gradients.
    pub adam: Adam,
}

/// What an update found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Passes over the decisions, counted in parts.
    pub epochs: f32,
    /// Divergence from the policy before, mean over the last pass.
    pub divergence: f32,
    /// Entropy of the policy, mean.
    pub entropy: f32,
    /// The critic's loss, mean.
    pub value_loss: f32,
    /// Norm of the policy's gradient, mean.
    pub gradient: f32,
}

/// Something came out as no number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotFinite {
    /// Where it was seen first.
    pub what: &'static str,
}

/// What one shard needs and finds.
#[derive(Debug, Default)]
struct Shard {
    /// Records and decisions in them.
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

/// The room that updates need, kept from one to the next.
#[derive(Debug, Default)]
pub struct Room {
    shards: Vec<Shard>,
    order: Vec<(u32, u32)>,
}

/// Learns from all records.
#[expect(clippy::too_many_arguments, reason = "each is another thing; a struct of them would be made for this call")]
pub fn update(
    rules: &Rules,
    records: &[&Record],
    actor: &mut Learner,
    critic: &mut Learner,
    (learning_rate, entropy): (f32, f32),
    threads: usize,
    room: &mut Room,
    stream: &mut Stream,
) -> Result<Outcome, NotFinite> {
    let ppo = &rules.config.ppo;
    let (mean, scale) = spread(records);
    if !mean.is_finite() || !scale.is_finite() {
        return Err(NotFinite { what: "the advantages" });
    }
    room.shards.resize_with(SHARDS, Shard::default);
    room.order.clear();
    for (index, record) in records.iter().enumerate() {
        room.order.extend((0..record.actor.len() as u32).map(|decision| (index as u32, decision)));
    }
    let terms = Terms { clip: ppo.clip, entropy, log_std_max: rules.log_std_max };
    let mut outcome = Outcome::default();
    let mut minibatches = 0.0;
    for _ in 0..ppo.epochs {
        room.order.shuffle(stream);
        let (mut divergence, mut seen) = (0.0, 0.0);
        for minibatch in room.order.chunks(ppo.minibatch) {
            for (at, shard) in room.shards.iter_mut().enumerate() {
                let share = |at: usize| minibatch.len() * at / SHARDS;
                shard.decisions.clear();
                shard.decisions.extend_from_slice(&minibatch[share(at)..share(at + 1)]);
            }
            let (a, c) = (&*actor, &*critic);
            in_parallel(threads, room.shards.iter_mut(), |shard| {
                shard.learn(records, (a, c), &terms, (mean, scale));
            });
            let robots = records[0].actor.robots as f32 * minibatch.len() as f32;
            let norm = descend(actor, &mut room.shards, |shard| &mut shard.actor, robots, learning_rate, ppo)
                .ok_or(NotFinite { what: "the policy's gradient" })?;
            descend(critic, &mut room.shards, |shard| &mut shard.critic, robots, learning_rate, ppo)
                .ok_or(NotFinite { what: "the critic's gradient" })?;
            let sum = |pick: fn(&Shard) -> f32| room.shards.iter().map(pick).sum::<f32>() / robots;
            divergence += sum(|shard| shard.divergence);
            outcome.entropy += sum(|shard| shard.entropy);
            outcome.value_loss += sum(|shard| shard.value_loss);
            outcome.gradient += norm;
            minibatches += 1.0;
            seen += 1.0;
            outcome.epochs += minibatch.len() as f32 / room.order.len() as f32;
            if divergence / seen > ppo.kl_stop {
                break;
            }
        }
        outcome.divergence = divergence / seen;
        if outcome.divergence > ppo.kl_stop {
            break;
        }
    }
    outcome.entropy /= minibatches;
    outcome.value_loss /= minibatches;
    outcome.gradient /= minibatches;
    Ok(outcome)
}

/// Mean and standard deviation of all advantages.
fn spread(records: &[&Record]) -> (f32, f32) {
    let all = || records.iter().flat_map(|record| &record.advantage).map(|&advantage| f64::from(advantage));
    let count = all().count() as f64;
    let mean = all().sum::<f64>() / count;
    let variance = all().map(|advantage| (advantage - mean).powi(2)).sum::<f64>() / count;
    (mean as f32, (variance.sqrt() + 1e-8) as f32)
}

/// Adds the shards' gradients up and goes one step; the gradient's norm, unless it is no number.
fn descend(
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
    let norm = cut(sum, ppo.gradient_clip);
    if !norm.is_finite() {
        return None;
    }
    learner.adam.step(&mut learner.parameters, sum, learning_rate);
    Some(norm)
}

impl Shard {
    /// The gradients of both losses over the shard's decisions.
    fn learn(
        &mut self,
        records: &[&Record],
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
                let found = loss::policy(outputs, &sample, terms);
                self.d_outputs.extend_from_slice(&found.d_outputs);
                self.divergence += found.divergence;
                self.entropy += found.entropy;
            }
            let (batch, space) = (&self.batch, &mut self.actor_space);
            actor.network.backward(&actor.parameters, batch, &self.d_outputs, space, &mut self.actor);

            self.batch.gather(decisions.iter().map(|&(r, d)| (&records[r as usize].critic, d as usize)));
            critic.network.forward(&critic.parameters, &self.batch, &mut self.critic_space);
            self.d_outputs.clear();
            for (estimate, (record, at)) in self.critic_space.outputs().iter().zip(samples()) {
                let (lost, d_estimate) = loss::value(*estimate, record.target[at]);
                self.value_loss += lost;
                self.d_outputs.push(d_estimate);
            }
            let (batch, space) = (&self.batch, &mut self.critic_space);
            critic.network.backward(&critic.parameters, batch, &self.d_outputs, space, &mut self.critic);
        }
    }
}

/// Initial parameters: normal, of a width that keeps activations as large as they were (He et al., arXiv
/// 1502.01852); the last layer is near zero, so that a policy begins at rest.
pub fn initial(network: &Network, seed: Seed, bias: &[f32]) -> Vec<f32> {
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
