//! The benchmark of communication: policies of several tasks on several channels, compared in pairs.
//!
//! A cell is a task, a channel and a number of robots. Each episode is a trial of its own with a seed of its own, the
//! same ones in all cells, so that two policies, or two channels, are compared on the same layouts.

pub mod matrix;
pub mod pages;
pub mod results;
pub mod seeds;
pub mod table;
pub mod verdict;

use murmurate::messages::wire::Kind;
use murmurate::results::episode::Episode;
use murmurate::results::listening::Listening;
use murmurate::results::totals::Steps;
use murmurate::trial::Trial;
use serde::{Deserialize, Serialize};

use self::matrix::{Air, Cell, Empty};
use super::differing;
use super::origin::{self, Origin};
use super::record::are_possible;

/// Name of the study, in its files.
pub const NAME: &str = "commbench";

/// Number of episodes of a job: what an interruption loses.
pub const EPISODES_OF_A_PART: u32 = 20;

/// Policy in a cell of the benchmark, with its trial.
#[derive(Clone)]
pub struct Entry {
    /// Index of its cell.
    pub cell: usize,
    /// Name of the column of the results: a kind of policy, or the name of a policy that was entered.
    pub entrant: String,
    /// Policy as `sim --policy` takes it.
    pub policy: String,
    /// Trial with the task, the channel and the policy; seed, layout and faults are those of each episode.
    pub trial: Trial,
    /// Number of episodes.
    pub episodes: u32,
    /// Conditions that determine the results: settings with their values, and digests of files that they name.
    pub conditions: Vec<String>,
}

/// Benchmark: its cells and entries, and what makes them its own.
#[derive(Clone)]
pub struct Bench {
    /// Cells, in the order of the tables.
    pub cells: Vec<Cell>,
    /// Policies in the cells, ordered by cell.
    pub entries: Vec<Entry>,
    /// Names of the columns of the results.
    pub entrants: Vec<String>,
    /// Places of the matrix that are empty.
    pub empty: Vec<Empty>,
    /// Seed of the benchmark, at most [`seeds::MOST_SEED`].
    pub seed: u64,
    /// Command that reproduces this benchmark.
    pub command: String,
    /// Digest of the program's sources: programs with equal digests compute the same numbers.
    pub build: String,
}

/// Part of an entry's episodes, which is computed and stored as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Job {
    /// Index of the entry.
    pub entry: usize,
    /// Index of the part, from 0.
    pub part: u32,
}

/// Identity of a benchmark: everything that determines its results, and the command that started it. Stored results
/// are reused only if all fields but the command are the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identity {
    /// Name of the study, [`NAME`].
    pub study: String,
    /// Version of the program.
    pub version: String,
    /// Digest of the program's sources.
    pub build: String,
    /// Cells: task, channel and number of robots of each.
    pub cells: Vec<String>,
    /// Names of the columns of the results.
    pub entrants: Vec<String>,
    /// Digest of the conditions of all entries, files included.
    pub conditions: String,
    /// Seed of the benchmark.
    pub seed: u64,
    /// Command that reproduces this benchmark.
    pub command: String,
}

/// Names of the fields of [`Identity`] that its `difference` compares, the most informative first.
const FIELDS: [&str; 7] = ["study", "seed", "entrants", "cells", "conditions", "version", "build"];

impl Identity {
    /// Returns the first field in which two identities differ, except the command: its name, its value in `self` and
    /// its value in `other`, both as JSON cut to 60 characters; `None` if there is none.
    pub fn difference(&self, other: &Identity) -> Option<(String, String, String)> {
        differing(&FIELDS, self, other)
    }
}

impl Cell {
    /// Returns the cell in words, such as `passage on iid-30 with 5 robots`.
    pub fn words(&self) -> String {
        format!("{} on {} with {} robots", self.task.name, self.channel.name, self.robots)
    }
}

impl Bench {
    /// Returns all jobs, ordered by entry and then by part.
    pub fn jobs(&self) -> Vec<Job> {
        let parts = |entry: &Entry| entry.episodes.div_ceil(EPISODES_OF_A_PART);
        let of = |(at, entry): (usize, &Entry)| (0..parts(entry)).map(move |part| Job { entry: at, part });
        self.entries.iter().enumerate().flat_map(of).collect()
    }

    /// Returns the indices of the episodes of a job.
    pub fn episodes(&self, job: Job) -> std::ops::Range<u32> {
        let first = job.part * EPISODES_OF_A_PART;
        first..(first + EPISODES_OF_A_PART).min(self.entries[job.entry].episodes)
    }

    /// Returns the cell of an entry.
    pub fn cell(&self, entry: &Entry) -> &Cell {
        &self.cells[entry.cell]
    }

    /// Builds the trial of the episode with index `episode` of an entry.
    pub fn trial(&self, entry: usize, episode: u32) -> Trial {
        let entry = &self.entries[entry];
        let seed = seeds::of_episode(self.seed, episode);
        let scenario = &entry.trial.scenario;
        let mut trial = entry.trial.clone();
        trial.layouts = seeds::layout(&**scenario, seed);
        if let Air::Bursts { share, mean_s } = self.cell(entry).channel.air {
            let latents = trial.deployment.links.iter().find(|link| link.carries.contains(&Kind::Latent));
            let link = &latents.expect("robots of the benchmark hear each other over a link").name;
            trial.faults = seeds::silences(seed, link, (share, mean_s), scenario.rules().limit.as_secs());
        }
        // Delivery is counted at all receivers, as on real links.
        Trial { seed, steps: Steps::Followed, everywhere: true, ..trial }
    }

    /// Returns the identity of the benchmark, by which stored results are recognised as its own.
    pub fn identity(&self) -> Identity {
        let all: Vec<(&[String], u32)> =
            self.entries.iter().map(|entry| (&*entry.conditions, entry.episodes)).collect();
        Identity {
            study: NAME.to_owned(),
            version: origin::VERSION.to_owned(),
            build: self.build.clone(),
            cells: self.cells.iter().map(Cell::words).collect(),
            entrants: self.entrants.clone(),
            conditions: Origin::here(&self.build, NAME, self.seed, "", &all).conditions,
            seed: self.seed,
            command: self.command.clone(),
        }
    }

    /// Returns the origin of the record of a job. It does not depend on the other entries.
    pub fn origin(&self, job: Job) -> Origin {
        let entry = &self.entries[job.entry];
        Origin::here(&self.build, NAME, self.seed, &entry.policy, &entry.conditions)
    }
}

/// Record of a job: results of its episodes, and of the messages in them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// Origin of the record: study, version, build, seed, policy and conditions that it was computed for.
    pub origin: Origin,
    /// Index of the part, from 0.
    pub part: u32,
    /// Results of the episodes, each with its index in the part, and the part as its repeat.
    pub episodes: Vec<Episode>,
    /// Delivery and age of messages between robots.
    pub listening: Listening,
}

impl Record {
    /// Returns the record of a job without an episode so far.
    pub fn new(bench: &Bench, job: Job) -> Record {
        let (origin, part) = (bench.origin(job), job.part);
        Record { origin, part, episodes: Vec::new(), listening: Listening::default() }
    }

    /// Adds the result of the job's next episode, which ran as a trial of its own.
    pub fn add(&mut self, result: Episode, listening: &Listening) {
        let episode = u32::try_from(self.episodes.len()).expect("parts are short");
        self.episodes.push(Episode { repeat: self.part, episode, ..result });
        self.listening.merge(listening);
    }

    /// Returns whether this is the complete record of the job, with numbers that its trials can have.
    pub fn belongs_to(&self, bench: &Bench, job: Job) -> bool {
        are_possible(&self.episodes, self.part, &self.listening)
            && self.origin == bench.origin(job)
            && self.part == job.part
            && self.episodes.len() == bench.episodes(job).len()
    }
}
