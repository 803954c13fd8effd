//! Vectorised environment for trainings outside this crate: many teams behind flat buffers.
//!
//! An environment is one team with its own random stream. So its data depends neither on the number of threads, nor on
//! that of the environments, nor on resets of others.

mod buffers;
mod memory;
mod options;
mod phases;
mod scan;
mod state;

pub use buffers::{Buffers, Lengths};
pub use options::{Autoreset, Content, Lidar, Options};
pub use phases::{LayoutKey, TeamStates};
pub use state::{StateError, layouts_of, options_of};
pub(crate) use state::{check_version, same_settings};

use super::conditions::EpisodeConditions;
use super::environments::Environments;
use super::message_buffer::{HISTORY_STEPS, HeldMessage};
use super::parallel::in_parallel;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::local::Contacts;
use murmurate::policy::hops::entry::Entry;
use murmurate::random::{Seed, Stream};
use murmurate::senses::Scanner;

/// Number of environments that a thread takes at a time.
const CHUNK: usize = 32;

/// Environments that one thread advances.
#[derive(Clone, Debug)]
struct Chunk {
    environments: Environments,
    /// Random stream of each environment.
    streams: Vec<Stream>,
    /// Commanded velocities of the current step \[m/s\], world frame.
    velocities: Vec<Vec2>,
    /// Floats that policies have put out for messages: by environment, then by step modulo `HISTORY_STEPS`, then by
    /// robot. Empty unless `Content::Actions`.
    outputs: Vec<f32>,
    /// Lidar of the robot that is looked at; `None` without one.
    scanner: Option<Scanner>,
    /// Contacts of each robot in the last step of `VectorEnvironment::advance`, with all 50 ms for which its action was
    /// held, and the length of its remaining path before \[m\]; empty before the first one.
    before: Vec<(Contacts, f32)>,
}

/// Vectorised environment: N teams of R robots each, stepped together, with results in flat buffers of the caller.
#[derive(Clone, Debug)]
pub struct VectorEnvironment {
    options: Options,
    lengths: Lengths,
    chunks: Vec<Chunk>,
}

impl VectorEnvironment {
    /// Makes the environments and starts an episode in each of them.
    pub fn new(options: Options) -> VectorEnvironment {
        let lengths = options.lengths();
        let (robots, seed) = (lengths.robots, Seed::of_run(options.seed));
        let outputs = options.outputs();
        let chunk = |first: usize| {
            let rows = CHUNK.min(options.environments - first);
            let scenarios = std::slice::from_ref(&options.scenario);
            let environments = Environments::new(rows, &[vec![robots]], scenarios).equipped(&options.chassis());
            let entries: Vec<Entry> = options.observation.iter().copied().map(Entry::from).collect();
            let environments = environments.observing(&entries, None);
            let mut chunk = Chunk {
                environments,
                streams: (0..rows).map(|row| stream_of(seed, first + row)).collect(),
                velocities: vec![Vec2::zeros(); rows * robots],
                outputs: vec![0.0; rows * outputs],
                scanner: options.lidar.as_ref().map(|lidar| lidar.scanner().expect("checked settings are sound")),
                before: Vec::new(),
            };
            (0..rows).for_each(|row| chunk.start(&options, row));
            chunk
        };
        let chunks = (0..options.environments).step_by(CHUNK).map(chunk).collect();
        VectorEnvironment { options, lengths, chunks }
    }

    /// Returns the numbers of robots and floats that give the lengths of one environment's part of each buffer.
    pub fn lengths(&self) -> Lengths {
        self.lengths
    }

    /// Returns the settings of the environments, with the seed from which their random streams last began anew.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Begins all random streams anew from `seed`, starts a new episode in every environment, and fills all buffers.
    pub fn reseed(&mut self, seed: u64, buffers: Buffers) {
        self.options.seed = seed;
        let (root, mut environment) = (Seed::of_run(seed), 0);
        for chunk in &mut self.chunks {
            chunk.outputs.fill(0.0);
            for row in 0..chunk.streams.len() {
                chunk.streams[row] = stream_of(root, environment);
                chunk.start(&self.options, row);
                environment += 1;
            }
        }
        self.look(buffers, |_| true);
    }

    /// Fills all buffers with what the robots observe and hear at the start of the episodes that `new` has started. It
    /// is to be called once, before the first step.
    pub fn begin(&mut self, buffers: Buffers) {
        self.look(buffers, |_| true);
    }

    /// Advances every environment by `Options::repeat` steps of 50 ms and fills the buffers. `actions` are the robots'
    /// velocities \[m/s\], policy frame, \[N, R, 2\]; `outputs` the floats of their messages, \[N, R, M\], empty
    /// unless the content is `Content::Actions`. All must be finite.
    ///
    /// # Panics
    /// If `actions` or `outputs` has another length, or if a buffer is too short.
    pub fn step(&mut self, actions: &[f32], outputs: &[f32], buffers: Buffers) {
        self.in_chunks((actions, outputs), buffers, |chunk, (options, lengths), given, buffers| {
            chunk.step((options, lengths), given, buffers);
        });
    }

    /// Calls `work` for each chunk, on threads, with its parts of actions, outputs and buffers.
    fn in_chunks(
        &mut self,
        (actions, outputs): (&[f32], &[f32]),
        mut buffers: Buffers,
        work: impl Fn(&mut Chunk, (&Options, Lengths), (&[f32], &[f32]), Buffers) + Sync,
    ) {
        let VectorEnvironment { options, lengths, chunks } = self;
        let lengths = *lengths;
        let (width, floats) = (2 * lengths.robots, lengths.robots * lengths.message);
        let said = if matches!(options.content, Content::Actions(_)) { floats } else { 0 };
        assert_eq!((actions.len(), outputs.len()), (options.environments * width, options.environments * said));
        let mut first = 0;
        let jobs: Vec<_> = chunks
            .iter_mut()
            .map(|chunk| {
                let rows = first..first + chunk.streams.len();
                first = rows.end;
                let actions = &actions[rows.start * width..rows.end * width];
                let outputs = &outputs[rows.start * said..rows.end * said];
                (buffers.take(rows.len(), lengths), (actions, outputs), chunk)
            })
            .collect();
        in_parallel(options.threads, jobs.into_iter(), |(buffers, given, chunk)| {
            work(chunk, (options, lengths), given, buffers);
        });
    }

    /// Starts a new episode in each environment for whose index `mask` returns true, and fills its parts of the
    /// buffers. Other environments and their parts of the buffers do not change.
    pub fn reset(&mut self, mask: impl Fn(usize) -> bool, buffers: Buffers) {
        let mut first = 0;
        for chunk in &mut self.chunks {
            for row in (0..chunk.streams.len()).filter(|row| mask(first + row)) {
                chunk.start(&self.options, row);
            }
            first += chunk.streams.len();
        }
        self.look(buffers, mask);
    }

    /// Fills observations and messages of the environments that `mask` selects.
    fn look(&mut self, mut buffers: Buffers, mask: impl Fn(usize) -> bool) {
        let VectorEnvironment { options, lengths, chunks } = self;
        let mut environment = 0;
        for chunk in chunks {
            for row in 0..chunk.streams.len() {
                if mask(environment) {
                    let mut one = buffers.row(environment, *lengths);
                    chunk.observe(options, row, one.observation);
                    one.last_observation.copy_from_slice(one.observation);
                    chunk.scan(row, one.scan);
                    one.last_scan.copy_from_slice(one.scan);
                    one.reward.fill(0.0);
                    one.terminated.fill(false);
                    one.truncated.fill(false);
                    one.arrived.fill(false);
                    if chunk.hears(options, row) {
                        chunk.receive(options, *lengths, row, &mut one);
                    }
                }
                environment += 1;
            }
        }
    }

    /// Returns the conditions of the current episode of the environment with index `environment`.
    pub fn episode(&self, environment: usize) -> &EpisodeConditions {
        let (environments, row) = self.place(environment);
        &environments.teams[row].episode
    }

    /// Returns the training environments among which the environment with index `environment` is, and its index there.
    pub fn place(&self, environment: usize) -> (&Environments, usize) {
        (&self.chunks[environment / CHUNK].environments, environment % CHUNK)
    }
}

/// Returns the random stream with which the environment with index `environment` begins.
fn stream_of(seed: Seed, environment: usize) -> Stream {
    seed.stream(&format!("environment {environment}"))
}

impl Chunk {
    fn start(&mut self, options: &Options, row: usize) {
        self.environments.start(row, &options.conditions, &mut self.streams[row]);
        if !self.before.is_empty() {
            self.forget(options, row);
        }
    }

    fn step(&mut self, (options, lengths): (&Options, Lengths), given: (&[f32], &[f32]), mut buffers: Buffers) {
        let mut begins = [false; CHUNK];
        for (row, begins) in begins[..self.streams.len()].iter_mut().enumerate() {
            let ended = self.hold((options, lengths), (row, given), &mut buffers.row(row, lengths), |_| {});
            *begins = ended && options.autoreset == Autoreset::SameStep;
        }
        self.go_on((options, lengths), &begins[..self.streams.len()], buffers);
    }

    /// Advances an environment by the steps for which its action is held, and fills its parts of the buffers but for
    /// what `go_on` fills. Calls `after` after each step of 50 ms. Returns whether the episode has ended.
    fn hold(
        &mut self,
        (options, lengths): (&Options, Lengths),
        (row, (actions, outputs)): (usize, (&[f32], &[f32])),
        one: &mut Buffers,
        mut after: impl FnMut(&mut Chunk),
    ) -> bool {
        let range = self.environments.teams[row].range();
        let wanted = actions[2 * range.start..2 * range.end].as_chunks::<2>().0;
        let given = wanted.iter().zip(&self.environments.frame[range.clone()]);
        for (velocity, (wanted, frame)) in self.velocities[range].iter_mut().zip(given) {
            *velocity = frame.turn(Vec2::from(*wanted));
        }
        // The neutral element of addition, which zero is not: it would take the sign of a negative zero.
        one.reward.fill(-0.0);
        let mut ended = false;
        for held in 0..options.repeat {
            if held > 0 && self.hears(options, row) {
                // What arrives while an action is held is drawn as if it had been given anew.
                self.receive(options, lengths, row, one);
            }
            ended = self.advance(options, lengths, (row, outputs), one);
            after(self);
            if ended {
                break;
            }
        }
        self.scan(row, one.last_scan);
        ended
    }

    /// Advances an environment by 50 ms with the velocities of the current step, adds the rewards, and writes the last
    /// observations. Returns whether the episode has ended.
    fn advance(
        &mut self,
        options: &Options,
        lengths: Lengths,
        (row, outputs): (usize, &[f32]),
        one: &mut Buffers,
    ) -> bool {
        let Chunk { environments, streams, velocities, outputs: kept, .. } = self;
        if !kept.is_empty() {
            let (size, at) = (lengths.robots * lengths.message, environments.teams[row].step as usize);
            let to = (row * HISTORY_STEPS + at % HISTORY_STEPS) * size;
            kept[to..to + size].copy_from_slice(&outputs[row * size..][..size]);
        }
        environments.step(row, velocities, &options.reward, options.limit_m_s, &mut streams[row]);
        let range = environments.teams[row].range();
        for (sum, reward) in one.reward.iter_mut().zip(&environments.reward[range.clone()]) {
            *sum += reward;
        }
        one.arrived.copy_from_slice(&environments.arrived[range]);
        let (done, over) = (environments.all_arrived(row), environments.elapsed_s(row) >= options.episode_s);
        (one.terminated[0], one.truncated[0]) = (done, over && !done);
        self.observe(options, row, one.last_observation);
        done || over
    }

    /// Writes the observations of an environment's robots.
    fn observe(&mut self, options: &Options, row: usize, to: &mut [f32]) {
        let Chunk { environments, streams, .. } = self;
        if environments.teams[row].episode.lockstep {
            environments.measure(row, &mut streams[row]);
        }
        environments.observations(row, 2 * options.observation.len(), to);
    }

    /// Whether messages of an environment's robots matter. Safety filters know of other robots what messages say,
    /// whether or not there is a buffer for them.
    fn hears(&self, options: &Options, row: usize) -> bool {
        options.content != Content::Nothing || self.environments.teams[row].episode.filtered
    }

    /// Writes the messages that an environment's robots use in their next decision.
    fn receive(&mut self, options: &Options, lengths: Lengths, row: usize, to: &mut Buffers) {
        let Chunk { environments, streams, outputs, .. } = self;
        let silent = options.content == Content::Nothing;
        to.heard.fill(false);
        to.age_s.fill(0.0);
        to.message.fill(0.0);
        let (team, robots) = (&mut environments.teams[row], lengths.robots);
        let step = team.step;
        let mut messages = std::mem::take(&mut team.messages);
        // Floats that a policy puts out with its action are sent after the decision, so the newest are a step old.
        let behind = u32::from(matches!(options.content, Content::Actions(_)));
        for receiver in 0..robots {
            let episode = &environments.teams[row].episode;
            let each = |messages: &super::message_buffer::MessageBuffer, message: HeldMessage| {
                if silent {
                    return;
                }
                let HeldMessage { sender, step: sent, age_s } = message;
                let edge = receiver * robots + sender;
                (to.heard[edge], to.age_s[edge]) = (true, age_s);
                let content = &mut to.message[edge * lengths.message..][..lengths.message];
                if behind > 0 {
                    let at = (row * HISTORY_STEPS + sent as usize % HISTORY_STEPS) * robots + sender;
                    content.copy_from_slice(&outputs[at * lengths.message..][..lengths.message]);
                } else {
                    environments.observation(row, messages, (sent, sender), content);
                }
            };
            messages.receive((episode, options.radius_m), (step, behind), receiver, &mut streams[row], each);
        }
        environments.teams[row].messages = messages;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Conditions, Config};
    use murmurate::chassis;
    use murmurate::scenario::{self, Settings};

    pub(super) fn options(environments: usize, threads: usize, content: Content) -> Options {
        let config = Config::preset("robust").expect("it is there");
        Options {
            scenario: scenario::build("passage", &Settings::of(3)).expect("it is there"),
            environments,
            threads,
            gap_m: None,
            scale: None,
            hull_m: None,
            repeat: 1,
            hold_s: 0.2,
            conditions: config.conditions.clone(),
            reward: config.reward,
            body: chassis::Settings::default(),
            observation: config.policy.observation.iter().filter_map(Entry::field).collect(),
            radius_m: 2.0,
            limit_m_s: 1.5,
            episode_s: 1.0,
            content,
            autoreset: Autoreset::SameStep,
            lidar: None,
            seed: 7,
        }
    }

    /// Buffers of a vectorised environment.
    #[derive(Clone)]
    pub(super) struct Memory {
        pub(super) floats: Vec<Vec<f32>>,
        pub(super) flags: Vec<Vec<bool>>,
    }

    impl Memory {
        pub(super) fn of(environments: usize, lengths: Lengths) -> Memory {
            let Lengths { robots, observation, message, rays } = lengths;
            let (edges, scan) = (lengths.edges(), robots * rays);
            let floats = [robots * observation, robots * observation, robots, edges, edges * message, scan, scan];
            let flags = [1, 1, robots, edges];
            Memory {
                floats: floats.map(|length| vec![0.0; environments * length]).to_vec(),
                flags: flags.map(|length| vec![false; environments * length]).to_vec(),
            }
        }

        pub(super) fn buffers(&mut self) -> Buffers<'_> {
            let [observation, last_observation, reward, age_s, message, scan, last_scan] = &mut self.floats[..] else {
                unreachable!()
            };
            let [terminated, truncated, arrived, heard] = &mut self.flags[..] else { unreachable!() };
            Buffers {
                observation,
                last_observation,
                reward,
                terminated,
                truncated,
                arrived,
                heard,
                age_s,
                message,
                scan,
                last_scan,
            }
        }
    }

    /// Steps the environments by actions that depend on the observations; returns all that the buffers held, for the
    /// first `first` environments.
    fn rolled(options: Options, steps: u32, first: usize, reset: Option<(u32, usize)>) -> Vec<u32> {
        let (count, mut seen) = (options.environments, Vec::new());
        let mut environments = VectorEnvironment::new(options);
        let lengths = environments.lengths();
        let mut memory = Memory::of(count, lengths);
        environments.reset(|_| true, memory.buffers());
        for step in 0..steps {
            let observed = memory.floats[0].chunks_exact(lengths.observation);
            let actions: Vec<f32> = observed.flat_map(|of| [of[0].clamp(-1.0, 1.0), of[1].clamp(-1.0, 1.0)]).collect();
            environments.step(&actions, &[], memory.buffers());
            if let Some((_, which)) = reset.filter(|(at, _)| *at == step) {
                environments.reset(|environment| environment == which, memory.buffers());
            }
            for floats in &memory.floats {
                seen.extend(floats[..floats.len() / count * first].iter().map(|float| float.to_bits()));
            }
            for flags in &memory.flags {
                seen.extend(flags[..flags.len() / count * first].iter().map(|flag| u32::from(*flag)));
            }
        }
        seen
    }

    #[test]
    fn filtered_robots_keep_apart_with_and_without_messages_of_their_policies() {
        for content in [Content::Nothing, Content::Observations, Content::Actions(2)] {
            let mut options = options(8, 1, content);
            let conditions =
                Conditions { clean: 0.0, deployed: 1.0, filtered: 1.0, wall_radius_m: 0.16, ..options.conditions };
            options = Options { conditions, episode_s: 10.0, ..options };
            let mut environment = VectorEnvironment::new(options);
            let lengths = environment.lengths();
            let mut memory = Memory::of(8, lengths);
            let outputs = vec![0.0; if content == Content::Actions(2) { 8 * 3 * 2 } else { 0 }];
            environment.look(memory.buffers(), |_| true);
            for _ in 0..160 {
                // Everybody drives at the middle of the team; observations have the position in floats 2 and 3.
                let mut actions = Vec::new();
                for team in memory.floats[0].chunks_exact(3 * lengths.observation) {
                    let at = |robot: usize| {
                        let from = robot * lengths.observation + 2;
                        Vec2::new(team[from], team[from + 1])
                    };
                    let middle = (at(0) + at(1) + at(2)) / 3.0;
                    actions.extend((0..3).flat_map(|robot| [middle.x - at(robot).x, middle.y - at(robot).y]));
                }
                environment.step(&actions, &outputs, memory.buffers());
            }
            let touched = environment.chunks[0].environments.teams.iter().filter(|team| team.touched).count();
            assert_eq!(touched, 0, "{content:?}");
        }
    }

    #[test]
    fn data_do_not_depend_on_threads_on_other_environments_nor_on_their_resets() {
        let content = Content::Observations;
        let alone = rolled(options(3, 1, content), 60, 3, None);
        assert_eq!(alone, rolled(options(70, 1, content), 60, 3, None));
        assert_eq!(alone, rolled(options(70, 3, content), 60, 3, None));
        assert_eq!(alone, rolled(options(70, 2, content), 60, 3, Some((20, 5))), "another one is reset");
        assert_ne!(alone, rolled(options(3, 1, content), 60, 3, Some((20, 1))), "one of them is reset");
        assert_ne!(alone, rolled(Options { seed: 8, ..options(3, 1, content) }, 60, 3, None));
    }

    #[test]
    fn an_episode_that_ends_is_truncated_and_the_next_one_begins_unless_it_waits_for_a_reset() {
        for autoreset in [Autoreset::SameStep, Autoreset::Disabled] {
            let mut environments = VectorEnvironment::new(Options { autoreset, ..options(2, 1, Content::Nothing) });
            let mut memory = Memory::of(2, environments.lengths());
            let actions = [0.0; 2 * 3 * 2];
            for step in 1..=20 {
                environments.step(&actions, &[], memory.buffers());
                assert_eq!(memory.flags[1], [step == 20; 2], "an episode has 1 s");
            }
            let same = memory.floats[0] == memory.floats[1];
            assert_eq!(same, autoreset == Autoreset::Disabled, "the last observations are those of the episode");
            assert_eq!(memory.flags[0], [false; 2]);
        }
    }

    #[test]
    fn a_held_action_is_as_one_that_is_given_again_and_its_rewards_are_added() {
        for content in [Content::Observations, Content::Actions(1)] {
            let mut once = options(6, 1, content);
            once.conditions.filtered = 0.5;
            once.autoreset = Autoreset::Disabled;
            let held = Options { repeat: 3, ..once.clone() };
            assert_eq!((once.decisions(), held.decisions()), (20, 7), "an episode of a second");
            let mut environments = [once, held].map(VectorEnvironment::new);
            let mut memories = [0, 1].map(|_| Memory::of(6, environments[0].lengths()));
            (0..2).for_each(|of| environments[of].begin(memories[of].buffers()));
            for step in 0..6 {
                let actions: Vec<f32> = (0..36).map(|at| ((at + step) % 5) as f32 * 0.2 - 0.4).collect();
                let said = vec![step as f32; if content == Content::Actions(1) { 18 } else { 0 }];
                let mut rewards = vec![-0.0; 18];
                for _ in 0..3 {
                    environments[0].step(&actions, &said, memories[0].buffers());
                    rewards.iter_mut().zip(&memories[0].floats[2]).for_each(|(sum, reward)| *sum += reward);
                }
                environments[1].step(&actions, &said, memories[1].buffers());
                memories[0].floats[2] = rewards;
                assert_eq!(memories[0].floats, memories[1].floats, "step {step}, {content:?}");
                assert_eq!(memories[0].flags, memories[1].flags);
            }
            let actions = [0.0; 36];
            let said = vec![0.0; if content == Content::Actions(1) { 18 } else { 0 }];
            environments[1].step(&actions, &said, memories[1].buffers());
            assert!(memories[1].flags[1].iter().all(|truncated| *truncated), "the seventh decision is the last");
            assert_eq!(environments[1].place(0).0.teams[0].step, 20, "it ends with the episode, not with the hold");
        }
    }

    #[test]
    fn floats_of_a_policy_arrive_a_step_later_or_later_still_and_from_neighbours_alone() {
        for (delay_s, least) in [(0.0, 1), (0.1, 2)] {
            let mut options = options(4, 1, Content::Actions(1));
            options.conditions = Conditions {
                clean: if delay_s > 0.0 { 0.0 } else { 1.0 },
                loss: [0.0; 2],
                delay_s: [delay_s; 2],
                everyone: 1.0,
                hold_s: [0.2; 2],
                ..options.conditions
            };
            let mut environments = VectorEnvironment::new(options);
            let mut memory = Memory::of(4, environments.lengths());
            environments.reset(|_| true, memory.buffers());
            assert!(memory.flags[3].iter().all(|heard| !heard), "nobody has said anything");
            for step in 0..12 {
                let said: Vec<f32> = (0..12).map(|robot| (100 * step + robot) as f32).collect();
                environments.step(&[0.0; 24], &said, memory.buffers());
                for edge in (0..36).filter(|edge| memory.flags[3][*edge]) {
                    let (row, receiver, sender) = (edge / 9, edge / 3 % 3, edge % 3);
                    let content = memory.floats[4][edge];
                    assert_ne!(receiver, sender);
                    assert_eq!(content as usize % 100, 3 * row + sender);
                    let behind = step + 1 - content as usize / 100;
                    assert!((least..=6).contains(&behind), "{content} in step {step}");
                    assert!(delay_s > 0.0 || (behind, memory.floats[3][edge]) == (1, 0.05));
                }
                let heard = memory.flags[3].iter().filter(|heard| **heard).count();
                assert!(step < 4 || heard == 24, "all hear the two others: {heard}");
            }
        }
    }
}
