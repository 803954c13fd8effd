//! Steps in two phases, between which a caller judges the environments: it may give rewards, end episodes, and make the
//! layouts of those that begin. Also what the caller judges, the true states of the teams.

use super::{Buffers, CHUNK, Chunk, Lengths, Options, VectorEnvironment, stream_of};
use crate::environments::next_episode;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::random::{Seed, Stream};

/// Seed and episode number from which a scenario makes the layout of an episode.
pub type LayoutKey = (u64, u32);

/// True states of the robots of some environments, world frame, one entry per robot, by environment and then by robot.
#[derive(Clone, Debug, Default)]
pub struct TeamStates {
    /// Position \[m\] of the point that the robot's policy commands: the centre, unless its drive is differential.
    pub position: Vec<[f32; 2]>,
    /// Velocity of that point \[m/s\].
    pub velocity: Vec<[f32; 2]>,
    /// Start in the episode \[m\].
    pub start: Vec<[f32; 2]>,
    /// Goal in the episode \[m\].
    pub goal: Vec<[f32; 2]>,
    /// Whether the robot has touched a wall in the last step.
    pub wall: Vec<bool>,
    /// Whether the robot has touched another robot in the last step.
    pub robot: Vec<bool>,
    /// Whether the robot has arrived in the episode.
    pub arrived: Vec<bool>,
    /// Length of the remaining path \[m\].
    pub to_go_m: Vec<f32>,
    /// Length by which the remaining path became shorter in the last step \[m\].
    pub progress_m: Vec<f32>,
    /// Time since the start of the episode \[s\], one entry per environment.
    pub time_s: Vec<f32>,
}

impl VectorEnvironment {
    /// Advances every environment as `step` does, but starts no episode, and leaves observations, scans and messages to
    /// `go_on`, which has to follow.
    ///
    /// # Panics
    /// As `step`.
    pub fn advance(&mut self, actions: &[f32], outputs: &[f32], buffers: Buffers) {
        self.in_chunks((actions, outputs), buffers, |chunk, (options, lengths), given, mut buffers| {
            let robots = chunk.environments.position.len();
            chunk.before.resize(robots, (Contacts::default(), 0.0));
            for row in 0..chunk.streams.len() {
                let one = &mut buffers.row(row, lengths);
                chunk.forget(options, row);
                chunk.hold((options, lengths), (row, given), one, |chunk| chunk.touch(row));
            }
        });
    }

    /// Completes a step that `advance` has begun: starts the next episode in each environment for which `begins` is
    /// true, and fills observations, scans and messages.
    pub fn go_on(&mut self, begins: &[bool], mut buffers: Buffers) {
        let VectorEnvironment { options, lengths, chunks } = self;
        assert_eq!(begins.len(), options.environments);
        for (chunk, begins) in chunks.iter_mut().zip(begins.chunks(CHUNK)) {
            let buffers = buffers.take(chunk.streams.len(), *lengths);
            chunk.go_on((options, *lengths), begins, buffers);
        }
    }

    /// Returns the layouts of the episodes that begin next in the environments for whose indices `mask` returns true,
    /// if nothing else is drawn before.
    pub fn next_layouts(&self, mask: impl Fn(usize) -> bool) -> Vec<LayoutKey> {
        let streams = self.chunks.iter().flat_map(|chunk| &chunk.streams).enumerate();
        let chosen = streams.filter(|(environment, _)| mask(*environment));
        chosen.map(|(_, stream)| next_layout(&self.options, stream.clone())).collect()
    }

    /// Returns the true states of the environments for whose indices `mask` returns true.
    pub fn states(&self, mask: impl Fn(usize) -> bool) -> TeamStates {
        let mut states = TeamStates::default();
        for environment in (0..self.options.environments).filter(|environment| mask(*environment)) {
            let (chunk, row) = (&self.chunks[environment / CHUNK], environment % CHUNK);
            chunk.add_states(&self.options, row, &mut states);
        }
        states
    }
}

impl Options {
    /// Returns the layouts of the episodes with which environments begin whose random streams are made from `seed`.
    pub fn first_layouts(&self, seed: u64) -> Vec<LayoutKey> {
        let root = Seed::of_run(seed);
        (0..self.environments).map(|environment| next_layout(self, stream_of(root, environment))).collect()
    }
}

fn next_layout(options: &Options, mut stream: Stream) -> LayoutKey {
    next_episode(&options.conditions, options.scenario.robots(), &mut stream).1
}

impl Chunk {
    /// Starts the next episode of each environment that `begins`, and fills what the robots observe and hear before
    /// their next decision.
    pub(super) fn go_on(&mut self, (options, lengths): (&Options, Lengths), begins: &[bool], mut buffers: Buffers) {
        buffers.observation.copy_from_slice(buffers.last_observation);
        buffers.scan.copy_from_slice(buffers.last_scan);
        for (row, begins) in begins.iter().enumerate() {
            if *begins {
                let one = buffers.row(row, lengths);
                self.start(options, row);
                self.observe(options, row, one.observation);
                self.scan(row, one.scan);
            }
            if self.hears(options, row) {
                self.receive(options, lengths, row, &mut buffers.row(row, lengths));
            }
        }
    }

    /// Adds the contacts of the last 50 ms of an environment to those of the step.
    fn touch(&mut self, row: usize) {
        for robot in self.environments.teams[row].range() {
            let (now, contacts) = (self.environments.contacts[robot], &mut self.before[robot].0);
            contacts.wall |= now.wall;
            contacts.robot |= now.robot;
        }
    }

    /// Takes the present state of an environment as that before its next step.
    pub(super) fn forget(&mut self, options: &Options, row: usize) {
        let to_go_m = self.to_go_m(options, row);
        for (robot, to_go_m) in self.environments.teams[row].range().zip(to_go_m) {
            self.before[robot] = (Contacts::default(), to_go_m);
        }
    }

    /// Returns the lengths of the remaining paths of the robots of an environment \[m\].
    fn to_go_m(&self, options: &Options, row: usize) -> Vec<f32> {
        let all = &self.environments;
        // A reward for progress has just computed them.
        match options.reward.progress > 0.0 {
            true => all.to_go_m[all.teams[row].range()].to_vec(),
            false => all.lengths_to_go_m(row),
        }
    }

    fn add_states(&self, options: &Options, row: usize, states: &mut TeamStates) {
        let all = &self.environments;
        let pair = |vector: Vec2| [vector.x, vector.y];
        for (robot, to_go_m) in all.teams[row].range().zip(self.to_go_m(options, row)) {
            let (Motion { position, velocity }, task) = (all.point(robot), &all.tasks[robot]);
            let (contacts, before_m) = self.before.get(robot).copied().unwrap_or((Contacts::default(), to_go_m));
            states.position.push(pair(position));
            states.velocity.push(pair(velocity));
            states.start.push(pair(task.start));
            states.goal.push(pair(task.goal));
            states.wall.push(contacts.wall);
            states.robot.push(contacts.robot);
            states.arrived.push(all.arrived[robot]);
            states.to_go_m.push(to_go_m);
            states.progress_m.push(before_m - to_go_m);
        }
        states.time_s.push(all.elapsed_s(row));
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Memory, options};
    use super::super::{Autoreset, Content};
    use super::*;
    use crate::config::Conditions;

    /// Environments under late messages, whose actions are held.
    fn made(autoreset: Autoreset) -> (VectorEnvironment, Memory) {
        let mut options = options(34, 2, Content::Observations);
        let conditions = Conditions { clean: 0.2, deployed: 0.8, ..options.conditions };
        options = Options { conditions, repeat: 2, autoreset, ..options };
        let mut environments = VectorEnvironment::new(options);
        let mut memory = Memory::of(34, environments.lengths());
        environments.begin(memory.buffers());
        (environments, memory)
    }

    fn actions(memory: &Memory) -> Vec<f32> {
        let observed = memory.floats[0].chunks_exact(memory.floats[0].len() / (34 * 3));
        observed.flat_map(|of| [of[0].clamp(-1.0, 1.0), of[1].clamp(-1.0, 1.0)]).collect()
    }

    #[test]
    fn a_step_in_two_phases_is_a_step() {
        let (mut whole, mut of_whole) = made(Autoreset::SameStep);
        let (mut phased, mut of_phased) = made(Autoreset::SameStep);
        let mut begun = 0;
        for _ in 0..25 {
            let given = actions(&of_whole);
            whole.step(&given, &[], of_whole.buffers());
            phased.advance(&given, &[], of_phased.buffers());
            let ended = of_phased.flags[0].iter().zip(&of_phased.flags[1]);
            let begins: Vec<bool> = ended.map(|(terminated, truncated)| *terminated || *truncated).collect();
            let layouts = phased.next_layouts(|at| begins[at]);
            phased.go_on(&begins, of_phased.buffers());
            assert!(of_whole.floats == of_phased.floats && of_whole.flags == of_phased.flags);
            let begins: Vec<usize> = (0..34).filter(|at| begins[*at]).collect();
            let begun_now = begins.iter().map(|at| {
                let (environments, row) = phased.place(*at);
                environments.teams[row].layout
            });
            assert!(begun_now.eq(layouts), "the layouts are those that were foreseen");
            begun += begins.len();
        }
        assert!(begun > 34, "{begun} episodes have begun");
    }

    #[test]
    fn first_layouts_are_foreseen_and_states_have_contacts_and_progress_of_whole_steps() {
        let (mut environments, mut memory) = made(Autoreset::Disabled);
        let first = environments.options().first_layouts(7);
        let layouts = (0..34).map(|at| {
            let (environments, row) = environments.place(at);
            environments.teams[row].layout
        });
        assert!(layouts.eq(first));
        let before = environments.states(|_| true);
        assert_eq!((before.position.len(), before.time_s.len()), (34 * 3, 34));
        assert!(before.progress_m.iter().all(|progress| *progress == 0.0));
        let mut touched = false;
        for _ in 0..10 {
            let before = environments.states(|_| true);
            let given = actions(&memory);
            environments.advance(&given, &[], memory.buffers());
            let after = environments.states(|_| true);
            for (robot, progress_m) in after.progress_m.iter().enumerate() {
                let shorter_m = before.to_go_m[robot] - after.to_go_m[robot];
                assert!((progress_m - shorter_m).abs() < 1e-5, "{progress_m} m, not {shorter_m} m");
            }
            touched |= after.robot.contains(&true) || after.wall.contains(&true);
            assert_eq!(environments.states(|at| at == 33).position, after.position[33 * 3..]);
            environments.go_on(&[false; 34], memory.buffers());
        }
        assert!(touched, "a robot touches a wall or another robot");
        environments.reset(|at| at == 0, memory.buffers());
        let states = environments.states(|at| at == 0);
        assert!(states.progress_m == [0.0; 3] && !states.wall.contains(&true) && states.time_s == [0.0]);
    }
}
