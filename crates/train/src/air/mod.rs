//! Messages between the robots of many teams, for environments of any trainer: who has heard whom, how late, and what.
//!
//! An environment is one team with its own random stream, so its data depend neither on the number of threads, nor on
//! that of the environments, nor on resets of others. Pure: time is the number of steps.

mod options;
mod row;
mod state;

pub use options::{Bursts, Options};
pub use state::options_of;

use self::row::Row;
use crate::parallel::{cut, in_parallel};
use murmurate::random::Seed;

/// Number of environments that a thread takes at a time.
const CHUNK: usize = 32;

/// Messages of the robots in a step, in row-major order. N is the number of environments, R that of robots in each, M
/// that of floats of a message.
#[derive(Clone, Copy, Debug)]
pub struct Given<'a> {
    /// Positions of the robots \[m\], \[N, R, 2\]; empty if nothing depends on them.
    pub position: &'a [f32],
    /// Whether each robot sends \[N, R\]; empty if all do.
    pub sends: &'a [bool],
    /// Length of each robot's datagram \[bytes\], \[N, R\]; a single one is that of all.
    pub bytes: &'a [u32],
    /// Index of the robot to which each robot sends \[N, R\], -1 for all others; empty if all send to all others.
    pub to: &'a [i32],
    /// Floats of the messages \[N, R, M\].
    pub content: &'a [f32],
}

/// Buffers that a step fills, in row-major order, by receiver and then by sender.
#[derive(Debug)]
pub struct Buffers<'a> {
    /// Whether the receiver has a message of the sender that has not arrived too long ago \[N, R, R\].
    pub heard: &'a mut [bool],
    /// Time since that message was sent \[s\], \[N, R, R\]; 0 where there is none.
    pub age_s: &'a mut [f32],
    /// Number of the step in which it was sent, from 0 since the environment's reset \[N, R, R\]; -1 where there is
    /// none.
    pub index: &'a mut [i32],
    /// Its floats \[N, R, R, M\]; zeros where there is none.
    pub content: &'a mut [f32],
}

/// Messages of the robots of many teams on their way.
#[derive(Clone, Debug)]
pub struct Air {
    options: Options,
    rows: Vec<Row>,
}

impl Air {
    /// Returns the air of environments that all begin. The options must have passed their check.
    pub fn new(options: Options) -> Air {
        let seed = Seed::of_run(options.seed);
        let row = |environment: usize| Row::new(&options, seed.stream(&format!("environment {environment}")));
        Air { rows: (0..options.environments).map(row).collect(), options }
    }

    /// Returns the options of the environments.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Begins all random streams anew from `seed`, and all environments.
    pub fn reseed(&mut self, seed: u64) {
        *self = Air::new(Options { seed, ..self.options.clone() });
    }

    /// Begins the environments for whose indices `mask` returns true anew: nothing was said there.
    pub fn reset(&mut self, mask: impl Fn(usize) -> bool) {
        let Air { options, rows } = self;
        rows.iter_mut().enumerate().filter(|(at, _)| mask(*at)).for_each(|(_, row)| row.reset(options));
    }

    /// Sends what the robots say in this step, advances all environments by a period, and fills the buffers with what
    /// the robots have heard by then.
    ///
    /// # Panics
    /// If a slice has another length, or `to` names no robot.
    pub fn step(&mut self, given: Given, mut buffers: Buffers) {
        let Air { options, rows } = self;
        let chunks = rows.chunks_mut(CHUNK).enumerate();
        let jobs: Vec<_> = chunks.map(|(at, rows)| (CHUNK * at, buffers.take(rows.len(), options), rows)).collect();
        in_parallel(options.threads, jobs.into_iter(), |(first, mut buffers, rows)| {
            for (at, row) in rows.iter_mut().enumerate() {
                let mut one = buffers.take(1, options);
                row.step(options, given.of(first + at, options));
                row.look(options, &mut one);
            }
        });
    }

    /// Fills the buffers with what the robots have heard, without a step.
    pub fn look(&mut self, mut buffers: Buffers) {
        let Air { options, rows } = self;
        rows.iter().for_each(|row| row.look(options, &mut buffers.take(1, options)));
    }
}

impl<'a> Given<'a> {
    /// Returns what the robots of one environment do.
    fn of(self, environment: usize, options: &Options) -> Given<'a> {
        fn part<T>(all: &[T], at: usize, length: usize) -> &[T] {
            if all.is_empty() { all } else { &all[at * length..(at + 1) * length] }
        }
        let robots = options.robots;
        Given {
            position: part(self.position, environment, 2 * robots),
            sends: part(self.sends, environment, robots),
            bytes: if self.bytes.len() == 1 { self.bytes } else { part(self.bytes, environment, robots) },
            to: part(self.to, environment, robots),
            content: part(self.content, environment, robots * options.floats),
        }
    }
}

impl<'a> Buffers<'a> {
    /// Splits off the parts of the first `environments`.
    fn take(&mut self, environments: usize, options: &Options) -> Buffers<'a> {
        let edges = environments * options.robots * options.robots;
        Buffers {
            heard: cut(&mut self.heard, edges),
            age_s: cut(&mut self.age_s, edges),
            index: cut(&mut self.index, edges),
            content: cut(&mut self.content, edges * options.floats),
        }
    }
}

#[cfg(test)]
mod tests;
