//! State of a vectorised environment as bytes, with the contents of its buffers, from which another one continues to
//! the bit: what it would have drawn, observed and heard next.
//!
//! The bytes are `MAGIC`, the number of the format, a digest of all that follows, the length of the metadata, the
//! metadata (MessagePack with names), and the numbers of the buffers. Integers and floats are little-endian.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{Autoreset, Buffers, Chunk, Content, LayoutKey, Lengths, Lidar, Options, VectorEnvironment};
use crate::config::{Conditions, Reward};
use crate::snapshot::Snapshot;
use murmurate::chassis;
use murmurate::policy::manifest::Field;
use murmurate::random::stored::StoredStream;
use murmurate::registry::Registry;
use murmurate::scenario::Settings;

/// First bytes of every state.
const MAGIC: &[u8; 16] = b"murmurate-state\n";
const FORMAT: u32 = 1;
/// Length of a digest \[bytes\].
const DIGEST: usize = 32;

/// Error: bytes are not a state that the environment can continue from.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The bytes are not what `VectorEnvironment::state` returns.
    #[error("these bytes are no state of an environment: {0}")]
    Foreign(&'static str),
    /// Bytes were changed or lost since the state was taken.
    #[error("the state is damaged: {0}; take a copy that is whole")]
    Damaged(String),
    /// The state is of another version of the program, whose next step may have other bits.
    #[error("the state is of {theirs}, and this is {ours}; states are for the version that took them")]
    Version {
        /// Version that took the state.
        theirs: String,
        /// Version that was to continue from it.
        ours: String,
    },
    /// The environments have other settings.
    #[error("the state is of other environments: '{name}' is {theirs} there and {ours} here")]
    Other {
        /// Name of the first setting that differs, as the Python package has it.
        name: String,
        /// Its value in the state.
        theirs: String,
        /// Its value here.
        ours: String,
    },
    /// The scenario of the state cannot be made.
    #[error("the scenario of the state: {0}")]
    Scenario(#[from] murmurate::scenario::ScenarioError),
}

/// Settings of the environments as a state has them, by the names of the Python package.
#[derive(Serialize, Deserialize)]
struct StoredOptions {
    scenario: String,
    /// Text of the task file; `None` for a scenario that is not from a file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    task: Option<String>,
    num_robots: usize,
    gap_m: Option<f32>,
    #[serde(default)]
    scale: Option<f32>,
    #[serde(default)]
    hull_m: Option<f32>,
    num_envs: usize,
    threads: usize,
    seed: u64,
    conditions: Conditions,
    reward: Reward,
    body: chassis::Settings,
    observation_fields: Vec<Field>,
    radius_m: f32,
    limit_m_s: f32,
    episode_s: f32,
    repeat: u32,
    hold_s: f64,
    message: Content,
    autoreset: Autoreset,
    #[serde(default, rename = "senses")]
    lidar: Option<Lidar>,
}

impl StoredOptions {
    fn of(options: &Options) -> StoredOptions {
        StoredOptions {
            scenario: options.scenario.name().to_owned(),
            task: options.scenario.task_file().map(|file| file.text().to_owned()),
            num_robots: options.scenario.robots(),
            gap_m: options.gap_m,
            scale: options.scale,
            hull_m: options.hull_m,
            num_envs: options.environments,
            threads: options.threads,
            seed: options.seed,
            conditions: options.conditions.clone(),
            reward: options.reward,
            body: options.body.clone(),
            observation_fields: options.observation.clone(),
            radius_m: options.radius_m,
            limit_m_s: options.limit_m_s,
            episode_s: options.episode_s,
            repeat: options.repeat,
            hold_s: options.hold_s,
            message: options.content,
            autoreset: options.autoreset,
            lidar: options.lidar.clone(),
        }
    }
}

/// Metadata of a state: all but numbers of the buffers and of messages.
#[derive(Serialize, Deserialize)]
struct Stored {
    version: String,
    options: StoredOptions,
    chunks: Vec<Snapshot>,
    streams: Vec<StoredStream>,
}

/// Numbers of buffers as bytes, read and written in one order.
struct Numbers<'a>(&'a [u8]);

impl Numbers<'_> {
    fn floats(&mut self, to: &mut [f32]) {
        let (mine, rest) = self.0.split_at(4 * to.len());
        for (float, bytes) in to.iter_mut().zip(mine.as_chunks::<4>().0) {
            *float = f32::from_le_bytes(*bytes);
        }
        self.0 = rest;
    }

    fn flags(&mut self, to: &mut [bool]) {
        let (mine, rest) = self.0.split_at(to.len());
        to.iter_mut().zip(mine).for_each(|(flag, byte)| *flag = *byte != 0);
        self.0 = rest;
    }
}

/// Returns the settings of the environments of which `bytes` is a state, to make such ones and continue with
/// `VectorEnvironment::set_state`. `registry` must have their scenario.
///
/// # Errors
/// If the bytes are no whole state of this version, or the scenario is not in the registry.
pub fn options_of(bytes: &[u8], registry: &Registry) -> Result<Options, StateError> {
    let (stored, _) = read(bytes)?;
    let StoredOptions { scenario, num_robots, gap_m, scale, hull_m, .. } = &stored.options;
    let settings = Settings { robots: Some(*num_robots), gap_m: *gap_m, scale: *scale, hull_m: *hull_m };
    let scenario = match &stored.options.task {
        Some(text) => registry.clone().with_task_text(scenario, text)?.scenario(scenario, &settings)?,
        None => registry.scenario(scenario, &settings)?,
    };
    let of = stored.options;
    let options = Options {
        scenario: Arc::clone(&scenario),
        gap_m: of.gap_m,
        scale: of.scale,
        hull_m: of.hull_m,
        environments: of.num_envs,
        threads: of.threads,
        conditions: of.conditions,
        reward: of.reward,
        body: of.body,
        observation: of.observation_fields,
        radius_m: of.radius_m,
        limit_m_s: of.limit_m_s,
        episode_s: of.episode_s,
        repeat: of.repeat,
        hold_s: of.hold_s,
        content: of.message,
        autoreset: of.autoreset,
        lidar: of.lidar,
        seed: of.seed,
    };
    options.check().map_err(|error| StateError::Damaged(error.to_string()))?;
    Ok(options)
}

/// Returns the layouts of the episodes in a state, one for each environment.
///
/// # Errors
/// If the bytes are no whole state of this version.
pub fn layouts_of(bytes: &[u8]) -> Result<Vec<LayoutKey>, StateError> {
    let (stored, _) = read(bytes)?;
    Ok(stored.chunks.iter().flat_map(Snapshot::layouts).collect())
}

/// Returns metadata and numbers of a state, if it is whole and of this version.
fn read(bytes: &[u8]) -> Result<(Stored, Numbers<'_>), StateError> {
    let rest = bytes.strip_prefix(MAGIC).ok_or(StateError::Foreign("they do not begin as one"))?;
    let (format, rest) = rest.split_first_chunk::<4>().ok_or(StateError::Foreign("they end within its beginning"))?;
    let format = u32::from_le_bytes(*format);
    if format != FORMAT {
        let of = |format: u32| format!("format {format}");
        return Err(StateError::Version { theirs: of(format), ours: of(FORMAT) });
    }
    let cut = || StateError::Damaged("it ends too early".to_owned());
    let (digest, rest) = rest.split_first_chunk::<DIGEST>().ok_or_else(cut)?;
    if blake3::hash(rest) != blake3::Hash::from_bytes(*digest) {
        return Err(StateError::Damaged("its digest does not match its content".to_owned()));
    }
    let (length, rest) = rest.split_first_chunk::<8>().ok_or_else(cut)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|length| *length <= rest.len());
    let (metadata, numbers) = rest.split_at(length.ok_or_else(cut)?);
    let stored: Stored =
        rmp_serde::from_slice(metadata).map_err(|error| StateError::Damaged(format!("its metadata: {error}")))?;
    check_version(&stored.version)?;
    Ok((stored, Numbers(numbers)))
}

/// Checks that a state is of this version of the program.
pub fn check_version(theirs: &str) -> Result<(), StateError> {
    let (ours, of) = (env!("CARGO_PKG_VERSION"), |version: &str| format!("version {version}"));
    if theirs == ours { Ok(()) } else { Err(StateError::Version { theirs: of(theirs), ours: of(ours) }) }
}

/// Checks that the settings of a state are these, as far as data depend on them.
pub fn same_settings<T: Serialize>(theirs: &T, ours: &T) -> Result<(), StateError> {
    let (theirs, ours) = (data(theirs), data(ours));
    let Some(name) = ours.keys().find(|name| theirs.get(*name) != ours.get(*name)) else { return Ok(()) };
    let of = |named: &Map<String, Value>| named.get(name).map_or_else(String::new, Value::to_string);
    Err(StateError::Other { name: name.clone(), theirs: of(&theirs), ours: of(&ours) })
}

/// Returns the settings on which the data depend, by name.
fn data<T: Serialize>(settings: &T) -> Map<String, Value> {
    let Ok(Value::Object(mut named)) = serde_json::to_value(settings) else { return Map::new() };
    for free in ["threads", "seed"] {
        named.remove(free);
    }
    named
}

impl VectorEnvironment {
    /// Returns the state of the environments as bytes: robots, random streams, held messages, filters and clocks of the
    /// episodes, and the contents of the buffers. `set_state` continues from it to the bit.
    pub fn state(&self, buffers: &Buffers) -> Vec<u8> {
        let stored = Stored {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            options: StoredOptions::of(&self.options),
            chunks: self.chunks.iter().map(|chunk| chunk.environments.snapshot()).collect(),
            streams: self.chunks.iter().flat_map(|chunk| &chunk.streams).map(StoredStream::of).collect(),
        };
        let metadata = rmp_serde::to_vec_named(&stored).expect("a state is plain data");
        let mut bytes = Vec::with_capacity(MAGIC.len() + 4 + DIGEST + 8 + metadata.len() + self.numbers());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&FORMAT.to_le_bytes());
        let digest = bytes.len();
        bytes.resize(digest + DIGEST, 0);
        bytes.extend_from_slice(&(metadata.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&metadata);
        let Buffers { observation, last_observation, reward, terminated, truncated, arrived, .. } = buffers;
        let Buffers { heard, age_s, message, scan, last_scan, .. } = buffers;
        let outputs = self.chunks.iter().map(|chunk| &chunk.outputs[..]);
        let floats = [&**observation, last_observation, reward, age_s, message, scan, last_scan];
        for floats in floats.into_iter().chain(outputs) {
            floats.iter().for_each(|float| bytes.extend_from_slice(&float.to_le_bytes()));
        }
        for flags in [&**terminated, truncated, arrived, heard] {
            bytes.extend(flags.iter().map(|flag| u8::from(*flag)));
        }
        let whole = blake3::hash(&bytes[digest + DIGEST..]);
        bytes[digest..digest + DIGEST].copy_from_slice(whole.as_bytes());
        bytes
    }

    /// Replaces the state of the environments and the contents of the buffers by those of `bytes`, which `state` has
    /// returned for environments with the same settings; the number of threads may differ.
    ///
    /// # Errors
    /// If the bytes are no whole state of this version, or of environments with other settings. Nothing changes then.
    pub fn set_state(&mut self, bytes: &[u8], buffers: Buffers) -> Result<(), StateError> {
        let (stored, mut numbers) = read(bytes)?;
        same_settings(&stored.options, &StoredOptions::of(&self.options))?;
        let damaged = |part: &str| StateError::Damaged(format!("its {part} do not fit its settings"));
        let fit = |(chunk, snapshot): (&Chunk, &Snapshot)| chunk.environments.fits(snapshot);
        if stored.chunks.len() != self.chunks.len() || !self.chunks.iter().zip(&stored.chunks).all(fit) {
            return Err(damaged("episodes"));
        }
        if stored.streams.len() != self.options.environments || numbers.0.len() != self.numbers() {
            return Err(damaged("numbers"));
        }
        self.options.seed = stored.options.seed;
        let mut streams = stored.streams.iter().map(StoredStream::stream);
        for (chunk, snapshot) in self.chunks.iter_mut().zip(stored.chunks) {
            assert!(chunk.environments.restore(snapshot), "it was found to fit");
            chunk.streams.iter_mut().zip(&mut streams).for_each(|(stream, stored)| *stream = stored);
        }
        let Buffers { observation, last_observation, reward, terminated, truncated, arrived, .. } = buffers;
        let Buffers { heard, age_s, message, scan, last_scan, .. } = buffers;
        let outputs = self.chunks.iter_mut().map(|chunk| &mut chunk.outputs[..]);
        let floats = [observation, last_observation, reward, age_s, message, scan, last_scan];
        for floats in floats.into_iter().chain(outputs) {
            numbers.floats(floats);
        }
        for flags in [terminated, truncated, arrived, heard] {
            numbers.flags(flags);
        }
        Ok(())
    }

    /// Returns the length of the numbers of a state \[bytes\].
    fn numbers(&self) -> usize {
        let Lengths { robots, observation, message, rays } = self.lengths;
        let (edges, outputs) = (self.lengths.edges(), self.options.outputs());
        let floats = 2 * robots * (observation + rays) + robots + edges * (1 + message) + outputs;
        self.options.environments * (4 * floats + 2 + robots + edges)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Memory, options};
    use super::*;
    use murmurate::chassis::DriveKind;
    use murmurate::random::{RngExt, Seed};

    /// Options of three kinds of environments: with messages and filters, with floats of policies on wheels and held
    /// actions, and without messages.
    fn kinds() -> [Options; 3] {
        let mut filtered = options(34, 2, Content::Observations);
        filtered.conditions = Conditions { clean: 0.2, deployed: 0.8, filtered: 0.7, ..filtered.conditions };
        let mut spoken = Options { repeat: 3, ..options(3, 1, Content::Actions(2)) };
        spoken.conditions.clean = 0.0;
        spoken.body = chassis::Settings {
            drive: Some(DriveKind::Differential),
            point_ahead_m: Some(0.1),
            ..chassis::Settings::default()
        };
        let mut silent = Options { autoreset: Autoreset::Disabled, ..options(2, 1, Content::Nothing) };
        silent.conditions = Conditions { clean: 0.0, deployed: 1.0, filtered: 1.0, ..silent.conditions };
        [filtered, spoken, silent]
    }

    /// Environments with their buffers.
    #[derive(Clone)]
    struct Running {
        environments: VectorEnvironment,
        memory: Memory,
    }

    impl Running {
        fn new(options: Options) -> Running {
            let mut environments = VectorEnvironment::new(options);
            let mut memory = Memory::of(environments.options().environments, environments.lengths());
            environments.begin(memory.buffers());
            Running { environments, memory }
        }

        fn state(&mut self) -> Vec<u8> {
            self.environments.state(&self.memory.buffers())
        }

        fn set_state(&mut self, bytes: &[u8]) -> Result<(), StateError> {
            self.environments.set_state(bytes, self.memory.buffers())
        }

        /// Steps by actions that depend on the observations, and resets an environment at times; returns all that the
        /// buffers held.
        fn rolled(&mut self, steps: usize) -> Vec<u32> {
            let (lengths, mut seen) = (self.environments.lengths(), Vec::new());
            let said = matches!(self.environments.options().content, Content::Actions(_));
            for step in 0..steps {
                let observed = self.memory.floats[0].chunks_exact(lengths.observation);
                let actions: Vec<f32> =
                    observed.flat_map(|of| [0.7, 0.3].map(|most| of[0].clamp(-most, most))).collect();
                let words = actions.len() / 2 * lengths.message * usize::from(said);
                let words: Vec<f32> = (0..words).map(|word| actions[word % actions.len()]).collect();
                self.environments.step(&actions, &words, self.memory.buffers());
                if step % 7 == 5 {
                    self.environments.reset(|environment| environment == 1, self.memory.buffers());
                }
                seen.extend(self.memory.floats.iter().flatten().map(|float| float.to_bits()));
                seen.extend(self.memory.flags.iter().flatten().map(|flag| u32::from(*flag)));
            }
            seen
        }
    }

    #[test]
    fn environments_continue_from_a_state_to_the_bit() {
        for options in kinds() {
            let mut one = Running::new(options.clone());
            one.rolled(13);
            let (state, mut clone) = (one.state(), one.clone());
            let expected = one.rolled(40);
            let mut other = Running::new(Options { seed: 99, ..options.clone() });
            other.rolled(5);
            other.set_state(&state).expect("it was just taken");
            assert!(other.state() == state, "what was set is what is taken");
            assert!(other.rolled(40) == expected, "another one");
            assert!(clone.rolled(40) == expected, "a clone");
            let mut threaded = Running::new(Options { threads: 3, ..options });
            threaded.set_state(&state).expect("the data do not depend on threads");
            assert!(threaded.rolled(40) == expected, "one with other threads");
            one.set_state(&state).expect("it is its own");
            assert!(one.rolled(40) == expected, "itself, again");
            assert!(one.rolled(40) != expected, "it does go on");
        }
    }

    #[test]
    fn environments_that_begin_anew_are_as_new_ones() {
        for options in kinds() {
            let mut old = Running::new(options.clone());
            old.rolled(9);
            old.environments.reseed(5, old.memory.buffers());
            assert!(old.state() == Running::new(Options { seed: 5, ..options }).state());
        }
    }

    #[test]
    fn environments_are_made_from_a_state_alone() {
        let options = kinds()[1].clone();
        let mut one = Running::new(options);
        one.rolled(8);
        let state = one.state();
        let mut made = Running::new(options_of(&state, &Registry::builtin()).expect("it is whole"));
        made.set_state(&state).expect("it is of the same settings");
        assert!(made.rolled(20) == one.rolled(20));
    }

    #[test]
    fn a_state_of_others_is_refused_by_the_name_of_what_differs() {
        let mut one = Running::new(options(3, 1, Content::Observations));
        let before = one.state();
        let mut refused = |options: Options, words: &str| {
            let error = one.set_state(&Running::new(options).state()).expect_err("it differs").to_string();
            assert!(error.contains(words), "{error}");
            assert!(one.state() == before, "nothing has changed");
        };
        refused(options(4, 1, Content::Observations), "'num_envs' is 4 there and 3 here");
        refused(options(3, 1, Content::Nothing), "'message' is \"nothing\" there and \"observations\" here");
        refused(Options { radius_m: 3.0, ..options(3, 1, Content::Observations) }, "'radius_m' is 3.0 there and 2.0");
        let mut later = options(3, 1, Content::Observations);
        later.conditions.delay_s = [0.0, 0.2];
        refused(later, "'conditions' is");
    }

    #[test]
    fn a_damaged_state_is_refused_wherever_it_is_damaged() {
        let mut one = Running::new(options(2, 1, Content::Observations));
        let whole = one.state();
        for at in (0..whole.len()).step_by(whole.len() / 300) {
            let mut flipped = whole.clone();
            flipped[at] ^= 1 << (at % 8);
            assert!(one.set_state(&flipped).is_err(), "byte {at}");
            assert!(options_of(&flipped, &Registry::builtin()).is_err(), "byte {at}");
            assert!(one.set_state(&whole[..at]).is_err(), "cut at {at}");
        }
        let error = |bytes: &[u8]| one.environments.clone().set_state(bytes, one.memory.clone().buffers());
        let said = |bytes: &[u8]| error(bytes).expect_err("it is no state").to_string();
        assert!(said(b"junk").contains("no state of an environment"));
        assert!(said(&whole[..100]).contains("its digest does not match"));
        let mut newer = whole.clone();
        newer[MAGIC.len()] = 2;
        assert!(said(&newer).contains("of format 2, and this is format 1"));
    }

    #[test]
    fn a_state_that_somebody_has_made_up_neither_panics_nor_makes_a_later_step_panic() {
        let mut one = Running::new(kinds()[0].clone());
        one.rolled(6);
        let (whole, mut stream) = (one.state(), Seed::of_run(3).stream("mutations"));
        let (from, mut taken) = (MAGIC.len() + 4 + DIGEST, 0);
        for _ in 0..400 {
            let mut bytes = whole.clone();
            for _ in 0..stream.random_range(1..4) {
                let at = stream.random_range(from..bytes.len());
                bytes[at] = stream.random();
            }
            let digest = blake3::hash(&bytes[from..]);
            bytes[from - DIGEST..from].copy_from_slice(digest.as_bytes());
            let mut other = one.clone();
            if other.set_state(&bytes).is_ok() {
                taken += 1;
                other.environments.step(&[0.1; 34 * 3 * 2], &[], other.memory.buffers());
            }
            let _ = options_of(&bytes, &Registry::builtin());
        }
        assert!(taken > 40, "numbers of buffers may be any: {taken}");
    }
}
