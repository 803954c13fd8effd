//! Reads what the flags of the simulating commands name or set: a conditions file, a deployment file, a communication
//! range, a fault plan. An error names the flag or the file.

use std::path::Path;

use anyhow::Result;

use murmurate::deploy::Deployment;
use murmurate::deploy::conditions::Conditions;
use murmurate::faults::FaultPlan;
use murmurate::hearing::CommRange;
use murmurate::messages::ids::RobotId;
use murmurate::registry::Registry;
use murmurate::trial::Trial;
use murmurate_robot::BadInput;
use murmurate_robot::output::read_text;

/// Reads and checks a conditions file (TOML): plant, properties of the robots' motion, delay and loss of messages.
pub fn file(path: &Path) -> Result<Conditions> {
    of_text(&read_text(path, "conditions file")?, path)
}

/// Checks the text of the conditions file at `path`, and returns its conditions.
pub fn of_text(text: &str, path: &Path) -> Result<Conditions> {
    Conditions::from_toml(text).map_err(|e| BadInput(format!("the conditions file '{}': {e}", path.display())).into())
}

/// Checks the text of the deployment file at `path` (TOML), and returns its deployment. It is an error if the file has
/// a real robot, as a simulation has none.
pub fn deployment(text: &str, path: &Path, registry: &Registry) -> Result<Deployment> {
    let wrong = |error| BadInput(format!("the deployment file '{}': {error}", path.display()));
    let deployment = Deployment::from_toml(text).map_err(wrong)?;
    deployment.check_simulated().map_err(wrong)?;
    Ok(deployment.from_folder(registry, path.parent().unwrap_or(Path::new(""))))
}

/// Returns the communication range that the flags `--comm-range-m` and `--comm-range-std-m` set: its mean `mean_m`
/// \[m\] and its standard deviation `std_m` \[m\]. If only the deviation is set, the mean is the radius of the trial's
/// policy. If neither is set, returns `None`, so that the policy's own range holds. An invalid value is an error.
pub fn range(mean_m: Option<f32>, std_m: f32, trial: &Trial) -> Result<Option<CommRange>> {
    if !(0.0..=1e3).contains(&std_m) {
        return Err(BadInput(format!("--comm-range-std-m: {std_m} is not 0 to 1000")).into());
    }
    if let Some(mean_m) = mean_m.filter(|mean| mean.is_nan() || *mean < 0.0) {
        return Err(BadInput(format!("--comm-range-m: {mean_m} is not a distance")).into());
    }
    if std_m > 0.0 && mean_m == Some(f32::INFINITY) {
        return Err(BadInput("--comm-range-std-m: an infinite range has no deviation".to_owned()).into());
    }
    if mean_m.is_none() && std_m == 0.0 {
        return Ok(None);
    }
    let of_robot = |robot| trial.comm_range(robot).mean_m;
    let Some(mean_m) = mean_m.or_else(|| {
        let first = of_robot(RobotId(0));
        RobotId::team(trial.deployment.robots).all(|robot| of_robot(robot) == first).then_some(first)
    }) else {
        let why = "--comm-range-std-m: robots of this team hear within different radii; give --comm-range-m, too";
        return Err(BadInput(why.to_owned()).into());
    };
    Ok(Some(CommRange { mean_m, std_m }))
}

/// Returns the fault plan that `given` names. If it is a whole number, it is the seed from which faults for `trial` are
/// drawn; otherwise it is the path of a fault plan file (TOML), which `read` reads.
pub fn faults(given: &str, trial: &Trial, read: impl Fn(&Path, &str) -> Result<String>) -> Result<FaultPlan> {
    if let Ok(seed) = given.parse::<u64>() {
        return Ok(trial.clone().random_faults(seed).faults);
    }
    let text = read(Path::new(given), "fault plan (a seed would be a whole number)")?;
    FaultPlan::from_toml(&text).map_err(|e| BadInput(format!("the fault plan '{given}': {e}")).into())
}
