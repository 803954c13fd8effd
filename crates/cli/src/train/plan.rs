//! Creates the [`Trainer`] of a new or a resumed training from the flags.

use anyhow::{Context, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::folder::Folder;
use super::{Args, PRESET};
use crate::conditions;
use crate::size;
use crate::study;
use murmurate::config::{ConfigError, from_table, regular, unquoted};
use murmurate::deploy::conditions::Conditions;
use murmurate::policy::hops::entry;
use murmurate::registry::Registry;
use murmurate::scenario::{Scenario, ScenarioError, Settings, goals};
use murmurate_robot::BadInput;
use murmurate_robot::output::{self, read_bytes, read_text};
use murmurate_robot::own_name;
use murmurate_study::network::conditions as of_medium;
use murmurate_train::config::{self, Config};
use murmurate_train::trainer::{Plan, Trainer};

/// Returns the training configuration that the flags define, as TOML with a heading. An error names the flag or the
/// file.
pub fn config_text(args: &Args, registry: &Registry) -> Result<String> {
    let Plan { scenario, preset, config, .. } = plan(args, registry)?;
    // Errors of the configuration show now and not when the training starts.
    Trainer::new(
        Plan { scenario: scenario.clone(), task: None, preset: preset.clone(), config: config.clone(), seed: 0 },
        registry,
    )
    .map_err(|e| BadInput(e.to_string()))?;
    let text = toml::to_string(&config).context("a configuration is TOML")?;
    Ok(format!(
        "# Training of '{scenario}', from preset '{preset}'. Fields: docs/training.md. Use: {} train {scenario} \
         --config FILE.toml\n{text}",
        own_name()
    ))
}

/// Returns the plan of a training (scenario, preset, configuration, seed) that the flags define. The groups of robots
/// in a preset are scaled to the size of the team.
fn plan(args: &Args, registry: &Registry) -> Result<Plan> {
    let preset = args.preset.as_deref().unwrap_or(PRESET);
    let (mut config, preset) = match &args.config {
        Some(path) => {
            let text = read_text(path, "training configuration")?;
            let config = Config::from_toml(&text);
            let wrong = |e| BadInput(format!("the training configuration '{}': {e}", path.display()));
            (config.map_err(wrong)?, "a configuration of the user's")
        }
        None => {
            let config = Config::preset(preset).expect("the parser accepts presets only");
            let config = sized(args, Config { robots: args.robots.or(config.robots), ..config })?;
            let scaled = config.scaled_for(&args.scenario, registry);
            (scaled.map_err(|e| refused(args, &e))?, preset)
        }
    };
    config = sized(args, config)?;
    config = with_fields(config, &args.set, Config::from_table)?;
    config.body = args.drive.over(&config.body)?;
    if let Some(radio) = &args.radio {
        let settings = config.settings(config.robots, None);
        let scenario = registry.scenario(&args.scenario, &settings).map_err(|e| refused(args, &e))?;
        with_radio("--radio", radio, scenario.as_ref(), &mut config.conditions)?;
    }
    if let Some(path) = &args.conditions {
        let Conditions { lag_s, delay_s, loss, .. } = conditions::file(path)?;
        let given = &mut config.conditions;
        given.lag_s = lag_s.map_or(given.lag_s, |lag_s| [lag_s; 2]);
        given.delay_s = delay_s.map_or(given.delay_s, |delay_s| [delay_s as f32; 2]);
        given.loss = loss.map_or(given.loss, |loss| [loss as f32; 2]);
    }
    let settings = config.settings(config.robots, None);
    let scenario = registry.scenario(&args.scenario, &settings).ok();
    config = config.for_task(scenario.as_ref().and_then(|scenario| scenario.task_file()));
    if scenario.is_some_and(|scenario| scenario.goals().are_unlabelled()) && !sees_goals(&config) {
        return Err(BadInput(format!(
            "{}: its goals are unlabelled, and policy.observation has the goal of the robot's own task alone. In its \
             place put {{ name = \"{}\", shape = [{}, 2], unit = \"m\", frame = \"policy\" }}",
            args.scenario,
            goals::NEAREST,
            goals::NEAREST_GOALS,
        ))
        .into());
    }
    let (scenario, preset) = (args.scenario.clone(), preset.to_owned());
    Ok(Plan { scenario, task: None, preset, config, seed: args.seed.unwrap_or(0) })
}

/// Returns whether a policy of the configuration observes goals of the team besides that of its own task.
fn sees_goals(config: &Config) -> bool {
    let observed = config.observed();
    let requests = entry::requests(&observed);
    requests.iter().any(|request| [goals::CHANNEL, goals::NEAREST].contains(&&*request.channel))
}

/// Returns the configuration with the scale and hull of the flags, or else of the conditions file.
fn sized(args: &Args, config: Config) -> Result<Config> {
    let fitted = args.conditions.as_deref().map(conditions::file).transpose()?.unwrap_or_default();
    let Settings { scale, hull_m, .. } = args.size.over(fitted.under(Settings::default()));
    Ok(Config { scale: scale.or(config.scale), hull_m: hull_m.or(config.hull_m), ..config })
}

/// Returns the error that the scenario cannot be made, which names the flag of the wrong setting.
fn refused(args: &Args, error: &ScenarioError) -> BadInput {
    size::refused(error, &args.size.over(Settings::default()), &[])
}

/// Sets the delay and loss of messages in `conditions` to those of a medium, for the robots of `scenario` at the starts
/// of an episode. `radio` is a preset or a radio file. Errors begin with `flag`, the name of the flag or argument.
pub fn with_radio(flag: &str, radio: &str, scenario: &dyn Scenario, conditions: &mut config::Conditions) -> Result<()> {
    let medium = study::medium(flag, radio)?;
    let starts: Vec<[f32; 2]> = scenario.tasks(0, 0).iter().map(|task| [task.start.x, task.start.y]).collect();
    of_medium::apply(&medium, &starts, conditions)
        .ok_or_else(|| BadInput(format!("{flag}: none of a team's messages arrives on '{radio}'")).into())
}

/// Returns the configuration with the fields of `set` changed (`FIELD=VALUE`, the value as TOML or as plain text).
/// `check` converts the whole table to a configuration again and checks it.
pub fn with_fields<T: Serialize + DeserializeOwned>(
    config: T,
    set: &[String],
    check: impl Fn(&toml::Table) -> Result<T, ConfigError>,
) -> Result<T> {
    if set.is_empty() {
        return Ok(config);
    }
    let mut table = toml::Table::try_from(&config).context("a configuration is TOML")?;
    for given in set {
        let wrong = |why: &str| BadInput(format!("--set {given}: {why}"));
        let (field, value) = given.split_once('=').ok_or_else(|| wrong("it is not FIELD=VALUE"))?;
        let value = toml::from_str::<toml::Table>(&format!("value = {value}"))
            .ok()
            .and_then(|mut parsed| parsed.remove("value"))
            .unwrap_or_else(|| toml::Value::String(value.to_owned()));
        let mut path: Vec<&str> = field.trim().split('.').collect();
        let last = path.pop().expect("a split text has a part");
        let mut into = &mut table;
        for part in path {
            let inner = into.entry(part).or_insert_with(|| toml::Table::new().into());
            into = inner.as_table_mut().ok_or_else(|| wrong(&format!("'{part}' has no fields")))?;
        }
        into.insert(last.to_owned(), value);
        // Each by itself, so that the error is of this flag.
        from_table::<T>(&table).map_err(|error| wrong(&error.to_string()))?;
    }
    Ok(check(&table).map_err(|e| BadInput(format!("--set: {e}")))?)
}

/// Returns the trainer of a new training from the flags. An error names the flag or the file.
pub fn begin(args: &Args, registry: &Registry) -> Result<Trainer> {
    let plan = plan(args, registry)?;
    let mut trainer = Trainer::new(plan, registry).map_err(|e| match &args.config {
        Some(path) => BadInput(format!("the training configuration '{}': {e}", path.display())),
        None => BadInput(e.to_string()),
    })?;
    if let Some(path) = &args.from {
        let wrong = |why: String| BadInput(format!("cannot begin with '{}': {why}", path.display()));
        let bytes = read_bytes(path, "checkpoint")?;
        trainer.initialize_from(&bytes).map_err(|e| wrong(e.to_string()))?;
    }
    Ok(trainer)
}

/// Returns the trainer of the training in the folder, as its checkpoint has it. Fails if its scenario, seed or
/// configuration differs from the flags.
pub fn resume(args: &Args, folder: &Folder, registry: &Registry) -> Result<Trainer> {
    let wrong = |why: String| BadInput(format!("cannot resume '{}': {why}", folder.checkpoint().display()));
    let bytes = regular::read(&folder.checkpoint(), output::MAX_CHECKPOINT)
        .map_err(|e| wrong(format!("{e}; leave out --resume to start a training")))?;
    let trainer = Trainer::resume(&bytes, registry).map_err(|e| wrong(unquoted(&e.to_string())))?;
    let theirs = trainer.plan();
    let ours = plan(args, registry)?;
    let other = |what: &str, theirs: &str, ours: &str| {
        Err(wrong(format!("it is of another training: {what} is {theirs} there and {ours} here")))
    };
    if theirs.scenario != ours.scenario {
        other("the scenario", &theirs.scenario, &ours.scenario)?;
    }
    if let Some(task) = &theirs.task {
        let file = registry.task_file(&theirs.scenario).map_err(|e| refused(args, &e))?;
        if file.text() != task {
            return Err(wrong(format!("its task file was another than '{}' is now", theirs.scenario)).into());
        }
    }
    if args.seed.is_some_and(|seed| seed != theirs.seed) {
        other("the seed", &theirs.seed.to_string(), &ours.seed.to_string())?;
    }
    if args.preset.is_some() && theirs.preset != ours.preset {
        other("the preset", &theirs.preset, &ours.preset)?;
    }
    if !args.drive.is_empty() && args.drive.over(&theirs.config.body)? != theirs.config.body {
        return Err(wrong("its drive differs; see [body] in config.toml beside it".to_owned()).into());
    }
    let (from_files, given) = ([&args.config, &args.conditions], [&args.preset, &args.radio]);
    let names_fields = from_files.iter().any(|file| file.is_some())
        || given.iter().any(|name| name.is_some())
        || args.robots.is_some()
        || args.size.given().next().is_some()
        || !args.set.is_empty();
    if names_fields && theirs.config != ours.config {
        return Err(wrong("its configuration differs; see config.toml beside it".to_owned()).into());
    }
    Ok(trainer)
}
