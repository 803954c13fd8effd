//! Studies: repeated trials of the same policies on the same layouts, in several columns. A column is one set of
//! conditions, such as a deployment mode or a delay.
//!
//! Pure: a study lists its trials, builds each of them and aggregates the results. The program runs the trials on
//! several threads and stores their files. [`docs/study.md`] is a guide.
//!
//! [`docs/study.md`]: https://github.com/murmurate/murmurate/blob/main/docs/study.md

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod columns;
pub mod commbench;
pub mod conditions;
pub mod handling;
pub mod network;
pub mod origin;
pub mod pages;
pub mod published;
pub mod record;
pub mod results;
pub mod sweep;
pub mod table;
pub mod twin;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use self::columns::Column;
use self::handling::Preset;
use self::origin::Origin;
use murmurate::config::ConfigError;
use murmurate::config::shown::counted;
use murmurate::policy::Model;
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{Scenario, Settings};
use murmurate::trial::Trial;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Policy under test in a study: a policy with one handling (use of messages, choice of actions, limit of commands,
/// safety filter).
#[derive(Clone)]
pub struct PolicyUnderTest {
    /// Name of the policy in reports.
    pub policy: String,
    /// Model of the policy, with mean or sampled actions as the handling says.
    pub model: Model,
    /// Digest of the policy's file; empty for scripted navigation.
    pub digest: String,
    /// Preset of the policy's handling: use of messages, choice of actions, limit of commands, safety filter.
    pub handling: &'static Preset,
}

impl PolicyUnderTest {
    /// Returns the name of the policy under test in figures and tables: policy and handling.
    pub fn name(&self) -> String {
        format!("{}, {}", self.policy, self.handling.name)
    }
}

/// Study that runs each policy in each column (set of conditions): its policies, columns, layouts and repeats.
#[derive(Clone)]
pub struct Study {
    /// Name of the study: `modes`, `delay` or `range`.
    pub name: &'static str,
    /// Columns of the study, each with one set of conditions.
    pub columns: Vec<Column>,
    /// Policies to compare.
    pub policies: Vec<PolicyUnderTest>,
    /// Scenario of all trials.
    pub scenario: Arc<dyn Scenario>,
    /// Settings from which the scenario was made, such as the width of its bottleneck; those that are not set are the
    /// scenario's defaults.
    pub settings: Settings,
    /// World and radio of all columns but `sim`, which has the conditions of training.
    pub conditions: conditions::Deployed,
    /// Starts and goals of the episodes of every trial.
    pub layouts: Layouts,
    /// Number of trials of every policy in every column.
    pub repeats: u32,
    /// Seed of all random numbers. Trials of the same repeat have the same random numbers in all columns and for all
    /// policies.
    pub seed: u64,
    /// Command that reproduces this study.
    pub command: String,
    /// Digest of the program's sources: programs with equal digests compute the same numbers. It is `origin::BUILD`
    /// for this crate's program.
    pub build: String,
}

/// Indices that identify one trial of a study: its column, policy and repeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Job {
    /// Index of the trial's column in the study.
    pub column: usize,
    /// Index of the trial's policy under test in the study.
    pub policy: usize,
    /// Index of the trial's repeat, from 0. Repeats have the same layouts and other random numbers.
    pub repeat: u32,
}

/// Identity of a study: everything that determines its results, and the command that started it. Stored results are
/// reused only if all fields but the command are the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identity {
    /// Name of the study.
    pub study: String,
    /// Version of the program.
    pub version: String,
    /// Digest of the program's sources: programs with equal digests compute the same numbers.
    pub build: String,
    /// Scenario, number of robots, and width of the bottleneck, scale and hull if they are set, as text.
    pub scenario: String,
    /// Number of layouts (starts and goals of an episode) and a digest of all of them, as text.
    pub layouts: String,
    /// Number of trials of every policy in every column.
    pub repeats: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Columns of the study, each with one set of conditions.
    pub columns: Vec<Column>,
    /// World and radio of all columns but `sim`.
    pub conditions: conditions::Deployed,
    /// Names of the policies under test, each with its handling and the digest of its file.
    #[serde(rename = "entrants")]
    pub policies: Vec<String>,
    /// Command that reproduces this study.
    pub command: String,
}

/// Names of the fields of [`Identity`] that its `difference` compares, the most informative first. The command is
/// not compared.
const FIELDS: [&str; 10] =
    ["study", "scenario", "seed", "repeats", "entrants", "columns", "conditions", "layouts", "version", "build"];

impl Identity {
    /// Returns the first field in which two identities of studies differ, except the command: its name, its value
    /// in `self` and its value in `other`, both as JSON cut to 60 characters; `None` if there is none.
    pub fn difference(&self, other: &Identity) -> Option<(String, String, String)> {
        differing(&FIELDS, self, other)
    }
}

/// Returns the first of `fields` in which two identities differ: its name, its value in `mine` and its value in
/// `theirs`, both as JSON cut to 60 characters; `None` if there is none.
fn differing<I: Serialize>(fields: &[&str], mine: &I, theirs: &I) -> Option<(String, String, String)> {
    let fields_of = |identity: &I| match serde_json::to_value(identity) {
        Ok(serde_json::Value::Object(fields)) => fields,
        _ => unreachable!("an identity is plain data"),
    };
    let (mine, theirs) = (fields_of(mine), fields_of(theirs));
    let field = fields.iter().find(|field| mine.get(**field) != theirs.get(**field))?;
    let shown = |value: Option<&serde_json::Value>| {
        let text = value.map_or("nothing".to_owned(), ToString::to_string);
        if text.chars().count() > 60 { format!("{}...", text.chars().take(57).collect::<String>()) } else { text }
    };
    Some(((*field).to_owned(), shown(mine.get(*field)), shown(theirs.get(*field))))
}

impl Study {
    /// Returns all trials of the study by their indices, ordered by column, then policy, then repeat.
    pub fn jobs(&self) -> Vec<Job> {
        let policies = self.policies.len();
        let of = |column| (0..policies).flat_map(move |policy| (0..self.repeats).map(move |r| (column, policy, r)));
        let all = (0..self.columns.len()).flat_map(of);
        all.map(|(column, policy, repeat)| Job { column, policy, repeat }).collect()
    }

    /// Builds one trial of the study, ready to run: with its column's conditions, its policy, seed, repeat and layouts.
    pub fn trial(&self, job: Job) -> Trial {
        let (column, tested) = (&self.columns[job.column], &self.policies[job.policy]);
        let mut trial = column.trial(Arc::clone(&self.scenario), tested, &self.conditions);
        (trial.seed, trial.repeat, trial.layouts) = (self.seed, job.repeat, self.layouts.clone());
        // Its figures follow messages to their receivers.
        Trial { everywhere: true, ..trial }.keeping_steps()
    }

    /// Checks the configuration of the study's trials. An error names the field at fault.
    pub fn check(&self) -> Result<(), ConfigError> {
        let first = self.jobs().into_iter().filter(|job| job.repeat == 0);
        first.map(|job| self.trial(job)).try_for_each(|trial| trial.check())
    }

    /// Returns the identity of the study, by which stored results are recognised as its own.
    pub fn identity(&self) -> Identity {
        let tested = |tested: &PolicyUnderTest| {
            let digest = if tested.digest.is_empty() { String::new() } else { format!(" [{}]", tested.digest) };
            format!("{}{digest}", tested.name())
        };
        Identity {
            study: self.name.to_owned(),
            version: origin::VERSION.to_owned(),
            build: self.build.clone(),
            scenario: self.scenario_text(),
            layouts: self.layouts_text(),
            repeats: self.repeats,
            seed: self.seed,
            columns: self.columns.clone(),
            conditions: self.conditions.clone(),
            policies: self.policies.iter().map(tested).collect(),
            command: self.command.clone(),
        }
    }

    /// Returns the origin of the record of one trial: study, version, build, seed, policy and conditions. It does not
    /// depend on the study's other columns and policies, nor on the number of repeats.
    pub fn origin(&self, job: Job) -> Origin {
        let (column, tested) = (&self.columns[job.column], &self.policies[job.policy]);
        let conditions =
            (self.scenario_text(), self.layouts_text(), column, &self.conditions, tested.handling.name, &tested.policy);
        Origin::here(&self.build, self.name, self.seed, &tested.digest, &conditions)
    }

    /// Returns the number of layouts, and their digest, as text.
    fn layouts_text(&self) -> String {
        format!("{} [{}]", self.layouts.len(), self.layouts_digest())
    }

    /// Returns the scenario's name and the number of robots as text, with the width of the bottleneck, the scale and
    /// the hull if they are set, and the digest of the task file if the scenario is from one.
    pub fn scenario_text(&self) -> String {
        let Settings { gap_m, scale, hull_m, .. } = self.settings;
        let gap = gap_m.map_or(String::new(), |gap_m| format!(", gap {gap_m} m"));
        let scale = scale.map_or(String::new(), |scale| format!(", scale {scale}"));
        let hull = hull_m.map_or(String::new(), |hull_m| format!(", hull {hull_m} m"));
        let task = self.scenario.task_file().map_or(String::new(), |file| format!(", task file {}", file.digest()));
        format!("{}, {}{gap}{scale}{hull}{task}", self.scenario.name(), counted(self.scenario.robots(), "robot"))
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
