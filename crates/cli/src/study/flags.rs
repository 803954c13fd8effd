//! Flags of the studies `modes`, `delay` and `range`, which compare policies in several columns of conditions; creates
//! a [`Study`] from them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use clap::builder::PossibleValuesParser;
use murmurate::chassis::Chassis;
use murmurate::registry::Registry;
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{Scenario, Settings};
use murmurate_study::columns::{self, Column};
use murmurate_study::conditions::Deployed;
use murmurate_study::handling::{self, Preset};
use murmurate_study::{PolicyUnderTest, Study};

use super::run::{CommandLine, Run, check_unique};
use super::shard::Shard;
use crate::conditions;
use crate::drive::DriveFlags;
use crate::size::{self, SizeFlags};
use murmurate_robot::BadInput;
use murmurate_robot::bad;
use murmurate_robot::output::{read_text, talk};
use murmurate_robot::own_name;
use murmurate_robot::policy;
use murmurate_robot::recording::RecordFlags;

/// Flags that the studies `modes`, `delay` and `range` have in common.
#[derive(clap::Args)]
pub struct Shared {
    /// Policies to compare, each a name in the registry (shipped, robust, published, orca or another, also of your
    /// crate) or a policy file (safetensors); may be given several times. 'NAME@HANDLING' gives one policy a handling
    /// of its own [default: the better one of shipped and orca: shipped for passage and flocking]
    #[arg(long = "policy", value_name = "NAME|FILE[@HANDLING]")]
    policies: Vec<String>,
    /// Handling of policies: 'default' (newest message held, mean actions) or 'as-published' (buffer cleared every
    /// step, sampled actions), each also with the safety filter ('filtered', 'as-published-filtered'); may be given
    /// several times, for every policy without one of its own [default: default]
    #[arg(long = "handling", value_parser = PossibleValuesParser::new(handling::PRESETS.iter().map(|p| p.name)))]
    handlings: Vec<String>,
    /// Task of the team: a name, or a task file (docs/tasks.md)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "passage")]
    scenario: String,
    /// Size of the team [default: the scenario's own]
    #[arg(long)]
    robots: Option<usize>,
    /// Width of the scenario's bottleneck [m] [default: the scenario's own]
    #[arg(long)]
    gap_m: Option<f32>,
    #[command(flatten)]
    size: SizeFlags,
    /// Number of episodes of a trial, each with its own layout
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    layouts: u32,
    /// File with layouts, of which the first --layouts are used; without it the scenario draws them from the seed
    #[arg(long, value_name = "FILE.json")]
    episodes_file: Option<PathBuf>,
    /// World, and delay and loss of messages between robots in place of the radio, such as 'study twin' fits them, for
    /// all columns but 'sim' (docs/twin.md)
    #[arg(long, value_name = "FILE.toml")]
    conditions: Option<PathBuf>,
    /// Number of trials in every column: the same layouts with other random numbers
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    repeats: u32,
    /// Runs the K-th of N parts of the trials, each part on a machine of its own, into the folder of --out. The same
    /// command without this flag then writes the report (docs/study.md)
    #[arg(long, value_name = "K/N", requires = "out")]
    pub shard: Option<Shard>,
    #[command(flatten)]
    drive: DriveFlags,
    /// Flags for records of the trials.
    #[command(flatten)]
    pub record: RecordFlags,
    /// Flags that all studies share, such as the seed and the output folder.
    #[command(flatten)]
    pub run: Run,
}

/// Flags of `murmurate study modes`.
#[derive(clap::Args)]
pub struct Modes {
    /// Columns of the table, separated by commas [default: all]
    #[arg(long, value_delimiter = ',', value_parser = PossibleValuesParser::new(columns::MODES))]
    columns: Vec<String>,
    /// Flags that the studies `modes`, `delay` and `range` have in common, such as policies and scenario.
    #[command(flatten)]
    pub shared: Shared,
}

/// Flags of `murmurate study delay`.
#[derive(clap::Args)]
pub struct Delay {
    /// Delays [ms], separated by commas [default: 0,20,50,100,200]
    #[arg(long, value_delimiter = ',')]
    delays_ms: Vec<f64>,
    /// Shares of messages lost, 0 to 1, separated by commas [default: 0,0.16,0.3,0.56]
    #[arg(long, value_delimiter = ',')]
    losses: Vec<f64>,
    /// Flags that the studies `modes`, `delay` and `range` have in common, such as policies and scenario.
    #[command(flatten)]
    pub shared: Shared,
}

/// Flags of `murmurate study range`.
#[derive(clap::Args)]
pub struct Range {
    /// Communication ranges [m], separated by commas; a column with an unlimited range comes last
    /// [default: 0.5,0.75,1,1.5,2,2.5,3,4]
    #[arg(long, value_delimiter = ',')]
    ranges_m: Vec<f32>,
    /// Flags that the studies `modes`, `delay` and `range` have in common, such as policies and scenario.
    #[command(flatten)]
    pub shared: Shared,
}

impl Modes {
    /// Returns the study `modes` as the flags define it. An error names the flag.
    pub fn study(&self, registry: &Registry) -> Result<Study> {
        check_unique("--columns", &self.columns)?;
        // Columns keep the order of the table, not that of the flag.
        let wanted = |name: &&str| self.columns.is_empty() || self.columns.iter().any(|column| column == name);
        let columns = columns::MODES.iter().filter(|name| wanted(name));
        let columns = columns.map(|name| Column::of_table(name).expect("a column of the table")).collect();
        let own =
            if self.columns.is_empty() { String::new() } else { format!(" --columns {}", self.columns.join(",")) };
        self.shared.study(registry, "modes", columns, &own)
    }
}

impl Delay {
    /// Returns the study `delay` as the flags define it. An error names the flag.
    pub fn study(&self, registry: &Registry) -> Result<Study> {
        let delays_ms = if self.delays_ms.is_empty() {
            columns::DELAYS_S.iter().map(|delay| 1000.0 * delay).collect()
        } else {
            self.delays_ms.clone()
        };
        let losses = if self.losses.is_empty() { columns::LOSSES.to_vec() } else { self.losses.clone() };
        for (flag, values, most) in [("--delays-ms", &delays_ms, 60_000.0), ("--losses", &losses, 1.0)] {
            check_unique(flag, values)?;
            if let Some(value) = values.iter().find(|value| !(0.0..=most).contains(*value)) {
                return bad(format!("{flag}: {value} is not 0 to {most}"));
            }
        }
        let delays_s: Vec<f64> = delays_ms.iter().map(|delay| delay / 1000.0).collect();
        let columns = Column::delays(&delays_s, &losses);
        let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
        check_unique("--delays-ms, --losses", &names)?;
        let own = list("--delays-ms", &self.delays_ms) + &list("--losses", &self.losses);
        self.shared.study(registry, "delay", columns.clone(), &own)
    }
}

impl Range {
    /// Returns the study `range` as the flags define it. An error names the flag.
    pub fn study(&self, registry: &Registry) -> Result<Study> {
        let ranges_m = if self.ranges_m.is_empty() { columns::RANGES_M.to_vec() } else { self.ranges_m.clone() };
        check_unique("--ranges-m", &ranges_m)?;
        if let Some(range) = ranges_m.iter().find(|range| !(0.0..=1e6).contains(*range)) {
            return bad(format!("--ranges-m: {range} is not 0 to 1000000"));
        }
        self.shared.study(registry, "range", Column::ranges(&ranges_m), &list("--ranges-m", &self.ranges_m))
    }
}

fn list<T: ToString>(flag: &str, values: &[T]) -> String {
    let values: Vec<String> = values.iter().map(ToString::to_string).collect();
    if values.is_empty() { String::new() } else { format!(" {flag} {}", values.join(",")) }
}

impl Shared {
    fn study(&self, registry: &Registry, name: &'static str, columns: Vec<Column>, own: &str) -> Result<Study> {
        let mut conditions = Deployed::shared();
        if let Some(path) = &self.conditions {
            conditions = conditions.with(conditions::file(path)?);
            registry.plant(&conditions.plant).map_err(|e| BadInput(format!("--conditions: {e}")))?;
        }
        let flags = self.size.over(Settings { robots: self.robots, gap_m: self.gap_m, ..Settings::default() });
        let fitted = conditions.fitted.as_ref().map(|fitted| fitted.under(Settings::default())).unwrap_or_default();
        let settings =
            Settings { scale: flags.scale.or(fitted.scale), hull_m: flags.hull_m.or(fitted.hull_m), ..flags };
        let scenario = registry
            .scenario(&self.scenario, &settings)
            .map_err(|error| size::refused(&error, &flags, &[("--conditions", fitted)]))?;
        let layouts = match &self.episodes_file {
            None => Layouts::of_scenario(&*scenario, self.run.seed, self.layouts),
            Some(path) => {
                let text = read_text(path, "episodes file")?;
                Layouts::from_json(&text, &*scenario, self.layouts).map_err(|e| {
                    let text = format!("the episodes file '{}': {e}", path.display());
                    BadInput(text.replace("--episodes", "--layouts"))
                })?
            }
        };
        conditions.body = self.drive.over(&conditions.body)?;
        let chassis = conditions.body.chassis().map_err(|e| BadInput(format!("--drive: {e}")))?;
        let team = vec![chassis; scenario.robots()];
        let study = Study {
            name,
            columns,
            policies: self.policies_under_test(registry, &*scenario, &team)?,
            conditions,
            layouts,
            repeats: self.repeats,
            seed: self.run.seed,
            command: self.command(name, own),
            build: build(registry)?,
            scenario: Arc::clone(&scenario),
            settings,
        };
        study.check().map_err(|e| BadInput(format!("the study '{name}': {e}")))?;
        Ok(study)
    }

    /// Loads every policy, once for each handling under which it is tested. An error names the flag or the file.
    fn policies_under_test(
        &self,
        registry: &Registry,
        scenario: &dyn Scenario,
        team: &[Chassis],
    ) -> Result<Vec<PolicyUnderTest>> {
        let usual = [registry.default_policy(scenario).to_owned()];
        let policies = if self.policies.is_empty() { &usual[..] } else { &self.policies };
        let named = |name: &String| handling::preset(name).expect("the parser lets only presets through");
        let mut handlings: Vec<&'static Preset> = self.handlings.iter().map(named).collect();
        if handlings.is_empty() {
            handlings.push(&handling::PRESETS[0]);
        }
        let mut tested = Vec::new();
        for given in policies {
            let (policy, own) = split(given)?;
            for handling in own.map_or(handlings.clone(), |own| vec![own]) {
                tested.push(self.load(registry, (policy, handling), scenario, team)?);
            }
        }
        let names: Vec<String> = tested.iter().map(PolicyUnderTest::name).collect();
        check_unique("--policy, --handling", &names)?;
        Ok(tested)
    }

    fn load(
        &self,
        registry: &Registry,
        (policy, handling): (&str, &'static Preset),
        scenario: &dyn Scenario,
        team: &[Chassis],
    ) -> Result<PolicyUnderTest> {
        let loaded = policy::load(registry, Some(Path::new(policy)), None, scenario)?.for_team(team);
        for warning in loaded.warnings.iter().filter(|_| !self.run.quiet) {
            talk(&format!("warning: {warning}"));
        }
        let digest = loaded.model.digest().to_owned();
        // A policy without an action distribution acts equally under every handling.
        let model = loaded.model.clone().with_draw(handling.draw).unwrap_or(loaded.model);
        Ok(PolicyUnderTest { policy: loaded.name, model, digest, handling })
    }

    /// Returns the command line that reproduces the study `name`, without flags that do not affect the results. `own`
    /// has the flags that only this study has.
    fn command(&self, name: &str, own: &str) -> String {
        let mut command = CommandLine(format!("{} study {name}{own}", own_name()));
        let mut add = |flag: &str, value: Option<String>| command.add(flag, value);
        self.policies.iter().for_each(|policy| add("policy", Some(policy.clone())));
        self.handlings.iter().for_each(|handling| add("handling", Some(handling.clone())));
        add("scenario", Some(self.scenario.clone()));
        add("robots", self.robots.map(|robots| robots.to_string()));
        add("gap-m", self.gap_m.map(|gap_m| gap_m.to_string()));
        self.size.given().for_each(|(flag, value)| add(flag, Some(value)));
        add("episodes-file", self.episodes_file.as_ref().map(|path| path.display().to_string()));
        add("conditions", self.conditions.as_ref().map(|path| path.display().to_string()));
        self.drive.given().for_each(|(flag, value)| add(flag, Some(value)));
        add("layouts", Some(self.layouts.to_string()));
        add("repeats", Some(self.repeats.to_string()));
        add("seed", Some(self.run.seed.to_string()));
        command.0
    }
}

impl Shared {
    /// Returns the paths of the files that the flags name: policies, `--scenario`, `--episodes-file` and
    /// `--conditions`. Names of policies and scenarios in the registry are among them.
    pub fn files(&self) -> Vec<PathBuf> {
        let policies = self.policies.iter().map(|given| PathBuf::from(split(given).map_or(&**given, |(file, _)| file)));
        let files = [&self.episodes_file, &self.conditions].into_iter().flatten().cloned();
        policies.chain([PathBuf::from(&self.scenario)]).chain(files).collect()
    }
}

/// Returns the text that identifies the program in records: the digest of this crate's sources. If another crate has
/// added entries to the registry, a digest of the executable is appended.
pub fn build(registry: &Registry) -> Result<String> {
    if !registry.is_extended() {
        return Ok(murmurate_robot::build::digest().to_owned());
    }
    let program = std::env::current_exe().and_then(std::fs::read).context("cannot read this program")?;
    Ok(format!("{}+{}", murmurate_robot::build::digest(), &blake3::hash(&program).to_hex()[..16]))
}

/// Splits a value 'NAME@HANDLING' of `--policy` into the policy and its handling; `None` if it has no '@HANDLING'.
/// Fails if there is no such handling.
fn split(given: &str) -> Result<(&str, Option<&'static Preset>)> {
    match given.rsplit_once('@') {
        // A file name may contain '@'.
        None => Ok((given, None)),
        Some(_) if Path::new(given).exists() => Ok((given, None)),
        Some((policy, name)) => match handling::preset(name) {
            Some(preset) => Ok((policy, Some(preset))),
            None => bad(format!("--policy {given}: there is no handling '{name}'; there are: {}", handling::names())),
        },
    }
}
