//! Checkpoints: the state of a training as bytes, from which it resumes bit for bit.

use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::environments::Snapshot;
use super::network::Shape;
use super::trainer::{Plan, SetupError, Trainer};
use super::update::Learner;
use crate::registry::Registry;

/// Version of the checkpoint format.
const FORMAT: u32 = 1;

#[derive(Serialize, Deserialize)]
struct State {
    format: u32,
    plan: Plan,
    actor: (Vec<f32>, Adam),
    critic: (Vec<f32>, Adam),
    chunks: Vec<Snapshot>,
    stage: usize,
    iteration: u64,
    decisions: u64,
    env_steps: u64,
    progress: f64,
    rate_factor: f32,
}

impl Trainer {
    /// Returns the complete state as bytes, from which [`Trainer::resume`] continues with identical results.
    pub fn checkpoint(&self) -> Vec<u8> {
        let of = |learner: &Learner| (learner.parameters.clone(), learner.adam.clone());
        let state = State {
            format: FORMAT,
            plan: self.plan.clone(),
            actor: of(&self.actor),
            critic: of(&self.critic),
            chunks: self.chunks.iter().map(|chunk| chunk.environments.snapshot()).collect(),
            stage: self.stage,
            iteration: self.iteration,
            decisions: self.decisions,
            env_steps: self.env_steps,
            progress: self.progress,
            rate_factor: self.rate_factor,
        };
        // Fields are written with their names, because fields with a default are left out if they are empty.
        rmp_serde::to_vec_named(&state).expect("a state is plain data")
    }

    /// Replaces the weights of policy and critic by those of another training's checkpoint, to continue under other
    /// conditions. Both networks must have the same shape as there. The optimiser's state is not taken over.
    pub fn initialize_from(&mut self, bytes: &[u8]) -> Result<(), SetupError> {
        let state = read_state(bytes)?;
        let config = &self.plan.config;
        let layers = |what: &'static str, theirs: &Shape, ours: &Shape| {
            let other = || SetupError::Other { what, theirs: theirs.to_string(), ours: ours.to_string() };
            if theirs == ours { Ok(()) } else { Err(other()) }
        };
        layers("the policy's network", &state.plan.config.actor(), &config.actor())?;
        layers("the critic's network", &state.plan.config.critic(), &config.critic())?;
        for (learner, (parameters, _)) in [(&mut self.actor, state.actor), (&mut self.critic, state.critic)] {
            if parameters.len() != learner.parameters.len() {
                return Err(SetupError::Format("its weights do not match its configuration".to_owned()));
            }
            learner.parameters = parameters;
        }
        Ok(())
    }

    /// Restores a trainer from a checkpoint. The registry must have the checkpoint's scenario.
    ///
    /// # Errors
    /// If the bytes are not a checkpoint of this version, or the scenario is not in the registry.
    pub fn resume(bytes: &[u8], registry: &Registry) -> Result<Trainer, SetupError> {
        let state = read_state(bytes)?;
        let mut trainer = Trainer::new(state.plan, registry)?;
        let broken = |part: &str| SetupError::Format(format!("its {part} do not match its configuration"));
        if state.stage >= trainer.plan.config.curriculum.len() {
            return Err(broken("stages"));
        }
        for (learner, (parameters, adam)) in [(&mut trainer.actor, state.actor), (&mut trainer.critic, state.critic)] {
            let length = learner.network.parameters();
            if parameters.len() != length || !adam.fits(length) {
                return Err(broken("weights"));
            }
            (learner.parameters, learner.adam) = (parameters, adam);
        }
        trainer.stage = state.stage;
        trainer.chunks = trainer.make_chunks()?;
        if state.chunks.len() != trainer.chunks.len() {
            return Err(broken("environments"));
        }
        for (chunk, snapshot) in trainer.chunks.iter_mut().zip(state.chunks) {
            if !chunk.environments.restore(snapshot) {
                return Err(broken("environments"));
            }
        }
        (trainer.iteration, trainer.decisions) = (state.iteration, state.decisions);
        (trainer.env_steps, trainer.progress, trainer.rate_factor) =
            (state.env_steps, state.progress, state.rate_factor);
        Ok(trainer)
    }
}

fn read_state(bytes: &[u8]) -> Result<State, SetupError> {
    let state: State = rmp_serde::from_slice(bytes).map_err(|error| SetupError::Format(error.to_string()))?;
    if state.format != FORMAT {
        let reason = format!("its format is {}; this program reads {FORMAT}", state.format);
        return Err(SetupError::Format(reason));
    }
    state.plan.config.check().map_err(|error| SetupError::Format(error.to_string()))?;
    Ok(state)
}
