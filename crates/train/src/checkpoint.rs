//! Checkpoints: the state of a training as bytes, from which it resumes bit for bit.

use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::network::{Network, Shape, TeamNetwork};
use super::rollout::CHUNK;
use super::snapshot::Snapshot;
use super::trainer::{Plan, SetupError, Trainer};
use murmurate::config::kinds::FileKind;
use murmurate::registry::Registry;

/// Version of the checkpoint format.
const FORMAT: u32 = 1;

#[derive(Serialize, Deserialize)]
struct State {
    format: u32,
    /// Vector instructions of the processor that the state comes from; empty in checkpoints that do not say it.
    #[serde(default)]
    vector: String,
    plan: Plan,
    actor: (Vec<f32>, Adam),
    critic: (Vec<f32>, Adam),
    chunks: Vec<Snapshot>,
    /// Latents of the last steps of each chunk's robots, for a recurrent policy.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    latents: Vec<Vec<f32>>,
    stage: usize,
    iteration: u64,
    decisions: u64,
    env_steps: u64,
    progress: f64,
    rate_factor: f32,
}

impl Trainer {
    /// Returns the complete state of the training as bytes, from which [`Trainer::resume`] continues with identical
    /// results.
    pub fn checkpoint(&self) -> Vec<u8> {
        let state = State {
            format: FORMAT,
            vector: vector_instructions(),
            plan: self.plan.clone(),
            actor: (self.actor.parameters.clone(), self.actor.adam.clone()),
            critic: (self.critic.parameters.clone(), self.critic.adam.clone()),
            chunks: self.chunks.iter().map(|chunk| chunk.environments.snapshot()).collect(),
            latents: match self.actor.network.is_recurrent() {
                true => self.chunks.iter().map(|chunk| chunk.record.actor.last_latents().to_vec()).collect(),
                false => Vec::new(),
            },
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

    /// Replaces the weights of policy and critic by those of another training's checkpoint, of which `bytes` is the
    /// content, to continue under other conditions. The optimiser's state is not taken over. It is an error if the
    /// bytes are not a checkpoint, or if the networks have other shapes there.
    pub fn initialize_from(&mut self, bytes: &[u8]) -> Result<(), SetupError> {
        let state = read_state(bytes)?;
        let config = &self.plan.config;
        let layers = |what: &'static str, theirs: &[Shape], ours: &[Shape]| {
            let text = |shapes: &[Shape]| shapes.iter().map(Shape::to_string).collect::<Vec<_>>().join(", and ");
            let other = || SetupError::Other { what, theirs: text(theirs), ours: text(ours) };
            if theirs == ours { Ok(()) } else { Err(other()) }
        };
        layers("the policy's network", &state.plan.config.actors(), &config.actors())?;
        layers("the critic's network", &[state.plan.config.critic()], &[config.critic()])?;
        let ours = [(&mut self.actor.parameters, state.actor), (&mut self.critic.parameters, state.critic)];
        for (ours, (parameters, _)) in ours {
            if parameters.len() != ours.len() {
                return Err(SetupError::Format("its weights do not match its configuration".to_owned()));
            }
            *ours = parameters;
        }
        Ok(())
    }

    /// Restores a trainer from the content `bytes` of a checkpoint. `registry` must have the checkpoint's scenario.
    ///
    /// # Errors
    /// If the bytes are not a checkpoint of this version, the scenario is not in the registry, or the checkpoint is of
    /// a processor with other vector instructions, with which the last bits of results would differ.
    pub fn resume(bytes: &[u8], registry: &Registry) -> Result<Trainer, SetupError> {
        let state = read_state(bytes)?;
        let ours = vector_instructions();
        if !state.vector.is_empty() && state.vector != ours {
            let what = "the set of the processor's vector instructions";
            return Err(SetupError::Other { what, theirs: state.vector, ours });
        }
        let broken = |part: &str| SetupError::Format(format!("its {part} do not match its configuration"));
        // Before anything is made of the configuration, which could ask for any amount of memory.
        let (config, team) = (&state.plan.config, state.plan.config.robots);
        let (actor, critic) = (TeamNetwork::new(config.actors()), Network::new(config.critic()));
        let weights = [(actor.parameters(), &state.actor), (critic.parameters(), &state.critic)];
        if weights.into_iter().any(|(expected, (parameters, _))| expected != parameters.len()) {
            return Err(broken("weights"));
        }
        let robots: usize = state.chunks.iter().map(|chunk| chunk.position.len()).sum();
        let teams = config.ppo.environments;
        if state.chunks.len() != teams.div_ceil(CHUNK)
            || team.is_some_and(|team| team.checked_mul(teams) != Some(robots))
        {
            return Err(broken("environments"));
        }
        let mut trainer = Trainer::new(state.plan, registry)?;
        if state.stage >= trainer.plan.config.curriculum.len() {
            return Err(broken("stages"));
        }
        let (actor, critic) = (&mut trainer.actor, &mut trainer.critic);
        let learners = [
            (&mut actor.parameters, &mut actor.adam, state.actor),
            (&mut critic.parameters, &mut critic.adam, state.critic),
        ];
        for (ours, our_adam, (parameters, adam)) in learners {
            if parameters.len() != ours.len() || !adam.fits(ours.len()) {
                return Err(broken("weights"));
            }
            (*ours, *our_adam) = (parameters, adam);
        }
        trainer.enter_stage(state.stage)?;
        if state.chunks.len() != trainer.chunks.len() {
            return Err(broken("environments"));
        }
        for (chunk, snapshot) in trainer.chunks.iter_mut().zip(state.chunks) {
            if !chunk.environments.restore(snapshot) {
                return Err(broken("environments"));
            }
        }
        let expected = if trainer.actor.network.is_recurrent() { trainer.chunks.len() } else { 0 };
        let fits = state.latents.len() == expected;
        let mut latents = trainer.chunks.iter_mut().zip(state.latents);
        if !fits || !latents.all(|(chunk, latents)| chunk.record.actor.restore_latents(latents)) {
            return Err(broken("latents"));
        }
        (trainer.iteration, trainer.decisions) = (state.iteration, state.decisions);
        (trainer.env_steps, trainer.progress, trainer.rate_factor) =
            (state.env_steps, state.progress, state.rate_factor);
        Ok(trainer)
    }
}

/// Returns the names of the vector instructions of this processor on which the last bits of a training depend: those by
/// which the matrix products and the system's mathematical functions choose their code.
pub(super) fn vector_instructions() -> String {
    #[cfg(target_arch = "x86_64")]
    let found = [
        ("avx", std::is_x86_feature_detected!("avx")),
        ("avx2", std::is_x86_feature_detected!("avx2")),
        ("fma", std::is_x86_feature_detected!("fma")),
        ("avx512f", std::is_x86_feature_detected!("avx512f")),
    ];
    #[cfg(not(target_arch = "x86_64"))]
    let found: [(&str, bool); 0] = [];
    let mut names = vec![if cfg!(target_arch = "x86_64") { "x86_64" } else { "other" }];
    names.extend(found.into_iter().filter(|(_, there)| *there).map(|(name, _)| name));
    names.join(" ")
}

fn read_state(bytes: &[u8]) -> Result<State, SetupError> {
    if let Some(other) = FileKind::no_checkpoint(bytes) {
        return Err(SetupError::Foreign(other));
    }
    let state: State = rmp_serde::from_slice(bytes).map_err(|error| SetupError::Format(error.to_string()))?;
    if state.format != FORMAT {
        let reason = format!("its format is {}; this program reads {FORMAT}", state.format);
        return Err(SetupError::Format(reason));
    }
    state.plan.config.check().map_err(|error| SetupError::Format(error.to_string()))?;
    Ok(state)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn a_checkpoint_of_another_processor_is_refused_and_one_that_does_not_say_is_taken() {
        let registry = Registry::builtin();
        let config = Config::preset("published").expect("it is a preset");
        let plan = Plan { scenario: "passage".to_owned(), task: None, preset: "published".to_owned(), config, seed: 0 };
        let trainer = Trainer::new(plan, &registry).expect("it is sound");
        let with = |vector: &str| {
            let mut state = read_state(&trainer.checkpoint()).expect("it was just written");
            state.vector = vector.to_owned();
            Trainer::resume(&rmp_serde::to_vec_named(&state).expect("it is plain data"), &registry)
        };
        let refused = with("x86_64 none").expect_err("it is of another").to_string();
        assert!(refused.contains("vector instructions is x86_64 none there"), "{refused}");
        assert!(with(&vector_instructions()).is_ok() && with("").is_ok());
    }
}
