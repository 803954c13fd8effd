//! The trial that the flags of `murmurate sim` define.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;

use super::setup::Setup;
use crate::{conditions, deployment, size};
use murmurate::config::ConfigError;
use murmurate::deploy::conditions::Conditions;
use murmurate::deploy::{self, Deployment, Impair};
use murmurate::messages::ids::RobotId;
use murmurate::registry::Registry;
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{Scenario, ScenarioError, Settings, TaskFile};
use murmurate::senses::Settings as SenseSettings;
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate::world::{Overrides, Placement};
use murmurate_robot::output::read_text;
use murmurate_robot::{BadInput, bad, policy};

/// Returns the conditions of the file that a flag names; none without one.
fn given(args: &Setup) -> Result<Conditions> {
    let Some(path) = &args.conditions else { return Ok(Conditions::default()) };
    conditions::of_text(&args.changes.read("conditions", path, "conditions file")?, path)
}

/// Returns the deployment with the delay, loss, range and radio that the flags set for its links.
fn network(args: &Setup, fitted: &Conditions, mut deployment: Deployment) -> Result<Deployment> {
    if args.impair.is_some() && args.delay_ms == 0.0 && args.loss == 0.0 {
        return bad("--impair: there is neither delay nor loss; add --delay-ms or --loss".to_owned());
    }
    let impair = if args.impair.as_deref() == Some("all") { Impair::All } else { Impair::Latent };
    deployment = deployment::impaired(deployment, (args.delay_ms, args.loss), impair)?;
    if args.delay_ms == 0.0 && args.loss == 0.0 && fitted.impair() {
        deployment = fitted.links(deployment).map_err(|e| BadInput(format!("--conditions: {e}")))?;
    }
    if let Some(range_m) = args.link_range_m {
        deployment = deployment.ranged(range_m).map_err(|e| BadInput(format!("--link-range-m: {e}")))?;
    }
    deployment::with_radio(deployment, &args.radio, &args.changes)
}

/// Returns the settings of the scenario: those of the flags, or else of the conditions, or else of the deployment
/// `file`.
fn settings(args: &Setup, fitted: &Conditions, file: Option<&Deployment>) -> Settings {
    let file = size::of_file(file);
    let Settings { scale, hull_m, .. } = args.size.over(fitted.under(Settings::default()));
    Settings {
        robots: args.robots.or(file.robots),
        gap_m: args.gap_m.or(file.gap_m),
        scale: scale.or(file.scale),
        hull_m: hull_m.or(file.hull_m),
    }
}

/// Returns the error that the scenario cannot be made, which names the flag or the file of the wrong setting.
fn refused(args: &Setup, fitted: &Conditions, file: Option<&Deployment>, error: &ScenarioError) -> BadInput {
    let flags = args.size.over(Settings { robots: args.robots, gap_m: args.gap_m, ..Settings::default() });
    let fitted = fitted.under(Settings::default());
    let path = |path: Option<&Path>| path.unwrap_or(Path::new("")).display().to_string();
    let (named, conditions) = (path(args.deployment.as_deref()), path(args.conditions.as_deref()));
    let files = [
        (&*format!("the conditions file '{conditions}'"), fitted),
        (&*format!("the deployment file '{named}'"), size::of_file(file)),
    ];
    size::refused(error, &flags, &files)
}

/// Returns the place of a file that is elsewhere than its path says, such as one of a record; `None` if it is there.
pub type Elsewhere<'a> = &'a dyn Fn(&Path) -> Option<PathBuf>;

/// Trial that flags define.
pub struct Defined {
    /// The trial; all other trials of its policy are repeats of it.
    pub trial: Trial,
    /// Name of its policy in reports.
    pub policy: String,
    /// Warnings about the use of the policy.
    pub warnings: Vec<String>,
}

/// Returns the trial of `episodes` drawn from `seed` that the flags of `sim` define for `policy` (`None` for the
/// scenario's default policy). `place` returns another place of a policy of a role, for a replay.
pub fn of_flags(
    args: &Setup,
    (seed, episodes): (u64, u32),
    policy: Option<&Path>,
    (registry, place): (&Registry, Elsewhere),
) -> Result<Defined> {
    check_changes(args)?;
    let registry = &with_changed_task(args, registry)?;
    let read = |path: &PathBuf| {
        let text = args.changes.read("deployment", path, "deployment file")?;
        conditions::deployment(&text, path, registry)
    };
    let file = args.deployment.as_ref().map(read).transpose()?;
    let fitted = &given(args)?;
    let settings = settings(args, fitted, file.as_ref());
    let scenario =
        registry.scenario(&args.scenario, &settings).map_err(|e| refused(args, fitted, file.as_ref(), &e))?;
    let mut deployment = match file {
        Some(file) if file.robots != scenario.robots() => {
            return bad(format!("--robots: {} robots, but the deployment file has {}", scenario.robots(), file.robots));
        }
        Some(file) => file,
        None => preset(args, scenario.robots(), registry)?,
    };
    deployment = deployment.sized(&settings);
    deployment = of_files(args, deployment, registry, place)?.for_task(scenario.task_file());
    check_pace(&deployment, registry)?;
    deployment = network(args, fitted, deployment)?;
    if let Some(rate_hz) = args.latent_rate_hz {
        deployment = deployment.with_latent_rate(rate_hz).map_err(|e| BadInput(format!("--latent-rate-hz: {e}")))?;
    }
    deployment.placement = args.placement.unwrap_or(deployment.placement);
    if let Some(plant) = args.plant.clone().or_else(|| fitted.plant.clone()) {
        deployment.plant = plant;
    }
    deployment.body = args.drive.over(&deployment.body)?;
    deployment.check().map_err(|e| BadInput(format!("--drive: {e}")))?;
    let loaded = policy::load_team(registry, policy, args.action, (&deployment, &*scenario))?;
    let policy::LoadedTeam { models, name: policy, warnings } = loaded;
    let mut trial = Trial::with_registry(registry, deployment, Arc::clone(&scenario), models);
    trial = trial.seed(seed).episodes(episodes);
    trial.handling = args.handling;
    if !(0.0..=1000.0).contains(&args.step_ms) {
        return bad(format!("--step-ms: {} is not 0 to 1000", args.step_ms));
    }
    trial.step_takes = Span::from_secs(args.step_ms / 1000.0);
    trial.estimator = *registry.estimator(&args.estimator).expect("the flag takes names of the registry alone");
    let safety = args.safety(trial.deployment.stepping);
    trial = physics(args, fitted, trial)?.clamp(args.clamp).safety(safety);
    if let Some(path) = &args.episodes_file {
        trial.layouts = layouts(path, (args, episodes), &*scenario)?;
    }
    // Checked without and then with the faults, so that errors name the right file.
    let place = match &args.deployment {
        Some(path) => format!("the deployment file '{}'", path.display()),
        None => format!("mode '{}'", args.mode),
    };
    trial.check().map_err(|e| BadInput(format!("{place}: {e}")))?;
    trial.range = conditions::range(args.comm_range_m, args.comm_range_std_m, &trial)?;
    if let Some(given) = &args.faults {
        trial.faults = conditions::faults(given, &trial, |path, what| args.changes.read("faults", path, what))?;
        trial.check().map_err(|e| BadInput(format!("the fault plan '{given}': {e}")))?;
    }
    Ok(Defined { trial, policy, warnings })
}

/// Checks that the files whose fields change are given.
fn check_changes(args: &Setup) -> Result<()> {
    let faults = args.faults.as_deref().is_some_and(|given| given.parse::<u64>().is_err());
    let given = [
        ("conditions", args.conditions.is_some()),
        ("faults", faults),
        ("radio", args.radio != "none"),
        ("roles", args.roles.is_some()),
        ("scenario", args.scenario.ends_with(".toml")),
        ("senses", args.senses.is_some()),
    ];
    match given.into_iter().find(|(flag, given)| !given && args.changes.concern(flag)) {
        None => Ok(()),
        Some((flag, _)) => bad(format!("--{flag}: it names no file, and a field of its file changes")),
    }
}

/// Returns the registry with the task file of `--scenario` as it is with changed fields.
fn with_changed_task(args: &Setup, registry: &Registry) -> Result<Registry> {
    if !args.changes.concern("scenario") {
        return Ok(registry.clone());
    }
    let path = &args.scenario;
    let wrong = |error: ConfigError| BadInput(format!("the task file '{path}': {error}"));
    let task = TaskFile::read(&args.changes.read("scenario", Path::new(path), "task file")?).map_err(wrong)?;
    registry.check_senses(&task).map_err(wrong)?;
    Ok(registry.clone().with_task(path, task))
}

/// Returns the deployment of the preset mode of `--mode`, with changed fields.
fn preset(args: &Setup, robots: usize, registry: &Registry) -> Result<Deployment> {
    let preset = Deployment::preset(&args.mode, robots).expect("the parser lets only modes through");
    if !args.changes.concern("deployment") {
        return Ok(preset);
    }
    let text = args.changes.over("deployment", preset.to_toml())?;
    let changed = conditions::deployment(&text, Path::new(&args.mode), registry)?;
    let size = |deployment: &Deployment| (deployment.robots, deployment.settings());
    if size(&changed) != size(&preset) {
        return bad("deployment: a mode takes its size from --robots, --gap-m, --scale and --hull-m".to_owned());
    }
    Ok(changed)
}

/// Returns the layouts of the episodes of a file.
fn layouts(path: &Path, (args, episodes): (&Setup, u32), scenario: &dyn Scenario) -> Result<Layouts> {
    let text = read_text(path, "episodes file")?;
    let layouts = Layouts::from_json(&text, scenario, episodes)
        .map_err(|e| BadInput(format!("the episodes file '{}': {e}", path.display())))?;
    if args.placement == Some(Placement::Drive) && !layouts.chained() {
        let reason = "its episodes do not start where those before them have ended";
        return bad(format!("--placement drive: the episodes file '{}': {reason}", path.display()));
    }
    Ok(layouts)
}

/// Returns the deployment with the senses and roles of the files that the flags name. `place` returns another place of
/// a policy of a role.
fn of_files(args: &Setup, mut deployment: Deployment, registry: &Registry, place: Elsewhere) -> Result<Deployment> {
    if let Some(path) = &args.senses {
        deployment = perceiving((args, path), deployment, registry)?;
    }
    if let Some(path) = &args.roles {
        deployment = in_roles((args, path), deployment, registry)?;
    }
    for policy in deployment.roles.values_mut().filter_map(|role| role.policy.as_mut()) {
        *policy = place(policy).unwrap_or_else(|| std::mem::take(policy));
    }
    Ok(deployment)
}

/// Returns the deployment with the senses of a file.
fn perceiving((args, path): (&Setup, &Path), deployment: Deployment, registry: &Registry) -> Result<Deployment> {
    let text = args.changes.read("senses", path, "senses file")?;
    let wrong = |error: ConfigError| BadInput(format!("the senses file '{}': {error}", path.display()));
    let senses = deploy::senses_of(&text).map_err(wrong)?;
    Ok(deployment.perceiving(registry, senses).map_err(wrong)?)
}

/// Returns the deployment with the roles of a file.
fn in_roles((args, path): (&Setup, &Path), deployment: Deployment, registry: &Registry) -> Result<Deployment> {
    let text = args.changes.read("roles", path, "roles file")?;
    let wrong = |error: ConfigError| BadInput(format!("the roles file '{}': {error}", path.display()));
    let folder = path.parent().unwrap_or(Path::new(""));
    let roles = deploy::roles_of(registry, &text, folder).map_err(wrong)?;
    Ok(deployment.in_roles(registry, roles).map_err(wrong)?)
}

/// Checks that no sense of a deployment needs a worker, which runs in real time.
fn check_pace(deployment: &Deployment, registry: &Registry) -> Result<()> {
    let works = |(_, name, settings): &(u8, &str, &SenseSettings)| {
        registry.sense(name, settings, RobotId(0)).is_ok_and(|parts| parts.worker.is_some())
    };
    let mut all = RobotId::team(deployment.robots).flat_map(|robot| deployment.senses_of(robot));
    match all.find(works) {
        None => Ok(()),
        Some((_, name, settings)) => {
            let why = format!("'{}' runs in real time, and 'sim' does not; take 'launch'", settings.kind);
            bad(format!("senses.{name}.kind: {why}"))
        }
    }
}

/// Returns the trial with the properties of simulated robots that the flags set.
fn physics(args: &Setup, fitted: &Conditions, mut trial: Trial) -> Result<Trial> {
    if let Some(lag_s) = args.lag_s.filter(|lag_s| !(0.0..=10.0).contains(lag_s)) {
        return bad(format!("--lag-s: {lag_s} is not 0 to 10"));
    }
    if let Some(radius_m) = args.wall_radius_m.filter(|radius_m| !(*radius_m > 0.0 && *radius_m <= 10.0)) {
        return bad(format!("--wall-radius-m: {radius_m} is not above 0 and at most 10"));
    }
    let Setup { lag_s, contacts, wall_radius_m, sensor, .. } = *args;
    let overrides = Overrides { lag_s, contacts, wall_radius_m, sensor };
    // An unknown plant in a file is reported later, with the file's other errors.
    if let Ok(entry) = trial.registry.plant(&trial.deployment.plant) {
        let flag = |field: &str| format!("--{}", field.replace('_', "-"));
        trial.physics = overrides
            .physics(entry, trial.scenario.arena())
            .map_err(|error| BadInput(format!("{}: {error}", flag(error.field))))?;
        trial.physics = fitted.physics(trial.physics, lag_s);
    }
    Ok(trial)
}
