//! Studies: the same policies in several columns of conditions, on the same layouts, as often as asked for.
//!
//! Pure: a study says which trials there are, makes each of them, and puts together what came of them. Who runs them,
//! on how many threads, and what is kept in files, is the program's. [`docs/study.md`] walks through it.
//!
//! [`docs/study.md`]: https://github.com/murmurate/murmurate/blob/main/docs/study.md

pub mod columns;
pub mod conditions;
pub mod handling;
pub mod network;
pub mod origin;
pub mod pages;
pub mod published;
pub mod record;
pub mod results;
pub mod table;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use self::columns::Column;
use self::handling::Preset;
use self::origin::Origin;
use crate::config::ConfigError;
use crate::policy::Model;
use crate::scenario::Scenario;
use crate::scenario::layout::Layouts;
use crate::trial::Trial;

/// A policy under one handling.
#[derive(Clone)]
pub struct Entrant {
    /// The policy's name in reports.
    pub policy: String,
    /// What drives the robots, drawing actions as the handling says.
    pub model: Model,
    /// A digest of its file; empty for scripted navigation.
    pub digest: String,
    /// How it is handled.
    pub handling: &'static Preset,
}

impl Entrant {
    /// What it is called beside others.
    pub fn name(&self) -> String {
        format!("{}, {}", self.policy, self.handling.name)
    }
}

/// A whole study.
#[derive(Clone)]
pub struct Study {
    /// Which one: `modes`, `delay`, `range`.
    pub name: &'static str,
    /// The conditions.
    pub columns: Vec<Column>,
    /// Who is compared.
    pub entrants: Vec<Entrant>,
    /// What the team is to do.
    pub scenario: Arc<dyn Scenario>,
    /// Width of its bottleneck \[m\], if it was chosen.
    pub gap_m: Option<f32>,
    /// The episodes of every trial.
    pub layouts: Layouts,
    /// Trials of every entrant in every column.
    pub repeats: u32,
    /// The root of all randomness. Trials of one repeat share it over columns and entrants.
    pub seed: u64,
    /// The command that makes this study.
    pub command: String,
    /// What tells programs apart that may compute other numbers; `origin::BUILD` for this crate's own.
    pub build: String,
}

/// One trial of a study.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Job {
    /// Which column.
    pub column: usize,
    /// Which entrant.
    pub entrant: usize,
    /// Which repeat.
    pub repeat: u32,
}

/// What makes a study this one and no other: what was computed for one identity is of use to no other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identity {
    /// Which study.
    pub study: String,
    /// The program's version.
    pub version: String,
    /// Digest of the program's sources.
    pub build: String,
    /// The scenario, with its team and its gap.
    pub scenario: String,
    /// How many layouts, and their digest.
    pub layouts: String,
    /// Trials of every entrant in every column.
    pub repeats: u32,
    /// The seed.
    pub seed: u64,
    /// The columns in full.
    pub columns: Vec<Column>,
    /// The world and the radio of the deployed columns.
    pub conditions: conditions::Deployed,
    /// Policies with the digests of their files, and how they are handled.
    pub entrants: Vec<String>,
    /// The command that makes this study.
    pub command: String,
}

/// The fields that make it this study, those first that say most. How its command was typed does not.
const FIELDS: [&str; 10] =
    ["study", "scenario", "seed", "repeats", "entrants", "columns", "conditions", "layouts", "version", "build"];

impl Identity {
    /// The first field in which another one differs: its name, and the values here and there.
    pub fn difference(&self, other: &Identity) -> Option<(String, String, String)> {
        let fields = |identity: &Identity| match serde_json::to_value(identity) {
            Ok(serde_json::Value::Object(fields)) => fields,
            _ => unreachable!("an identity is plain data"),
        };
        let (mine, theirs) = (fields(self), fields(other));
        let mut differing = FIELDS.into_iter().filter(|field| mine.get(*field) != theirs.get(*field));
        differing.next().map(|field| {
            let shown = |value: Option<&serde_json::Value>| {
                let text = value.map_or("nothing".to_owned(), ToString::to_string);
                if text.chars().count() > 60 {
                    format!("{}...", text.chars().take(57).collect::<String>())
                } else {
                    text
                }
            };
            (field.to_owned(), shown(mine.get(field)), shown(theirs.get(field)))
        })
    }
}

impl Study {
    /// All trials, column by column.
    pub fn jobs(&self) -> Vec<Job> {
        let entrants = self.entrants.len();
        let of = |column| (0..entrants).flat_map(move |entrant| (0..self.repeats).map(move |r| (column, entrant, r)));
        let all = (0..self.columns.len()).flat_map(of);
        all.map(|(column, entrant, repeat)| Job { column, entrant, repeat }).collect()
    }

    /// One of its trials.
    pub fn trial(&self, job: Job) -> Trial {
        let (column, entrant) = (&self.columns[job.column], &self.entrants[job.entrant]);
        let mut trial = column.trial(Arc::clone(&self.scenario), entrant);
        (trial.seed, trial.repeat, trial.layouts) = (self.seed, job.repeat, self.layouts.clone());
        trial.keeping_steps()
    }

    /// Whether every trial can be run, so that nothing is found to be wrong half-way.
    pub fn check(&self) -> Result<(), ConfigError> {
        let first = self.jobs().into_iter().filter(|job| job.repeat == 0);
        first.map(|job| self.trial(job)).try_for_each(|trial| trial.check())
    }

    /// What makes it this study.
    pub fn identity(&self) -> Identity {
        let entrant = |entrant: &Entrant| {
            let digest = if entrant.digest.is_empty() { String::new() } else { format!(" [{}]", entrant.digest) };
            format!("{}{digest}", entrant.name())
        };
        Identity {
            study: self.name.to_owned(),
            version: origin::VERSION.to_owned(),
            build: self.build.clone(),
            scenario: self.place(),
            layouts: self.episodes(),
            repeats: self.repeats,
            seed: self.seed,
            columns: self.columns.clone(),
            conditions: conditions::Deployed::shared(),
            entrants: self.entrants.iter().map(entrant).collect(),
            command: self.command.clone(),
        }
    }

    /// The origin of a trial's record. Other columns, other entrants and the number of repeats decide nothing.
    pub fn origin(&self, job: Job) -> Origin {
        let (column, entrant) = (&self.columns[job.column], &self.entrants[job.entrant]);
        let conditions = (
            self.place(),
            self.episodes(),
            column,
            conditions::Deployed::shared(),
            entrant.handling.name,
            &entrant.policy,
        );
        Origin { build: self.build.clone(), ..Origin::here(self.name, self.seed, &entrant.digest, &conditions) }
    }

    /// How many layouts, and their digest.
    fn episodes(&self) -> String {
        format!("{} [{}]", self.layouts.len(), self.layouts_digest())
    }

    /// The scenario, its team, and its bottleneck if that was chosen, in words.
    pub fn place(&self) -> String {
        let gap = self.gap_m.map_or(String::new(), |gap_m| format!(", gap {gap_m} m"));
        format!("{}, {} robots{gap}", self.scenario.name(), self.scenario.robots())
    }

    fn layouts_digest(&self) -> String {
        let mut hash = xxhash_rust::xxh3::Xxh3::new();
        for task in (0..self.layouts.len()).flat_map(|episode| self.layouts.episode(episode)) {
            for float in [task.start.x, task.start.y, task.goal.x, task.goal.y] {
                hash.update(&float.to_bits().to_le_bytes());
            }
        }
        format!("{:016x}", hash.digest())
    }
}
