//! The scenario of a team file in its size, and the least distances of robots by their hulls.

use std::path::PathBuf;
use std::sync::Arc;

use super::layers::{LayerValue, Layers, place};
use super::{Team, text};
use crate::config::ConfigError;
use crate::deploy::Deployment;
use crate::registry::Registry;
use crate::safety::Safety;
use crate::scenario::task_file::is_task_file;
use crate::scenario::{Scenario, ScenarioError, Settings, TaskFile};

impl Team {
    /// Makes the team's scenario, in the size of its deployment; `registry` has it, unless it is of a task file. An
    /// error names the wrong setting.
    pub fn make_scenario(&self, registry: &Registry) -> Result<Arc<dyn Scenario>, ScenarioError> {
        let settings = self.deployment.settings();
        match &self.task {
            Some((_, file)) => file.scenario(&settings),
            None => registry.scenario(&self.scenario, &settings),
        }
    }
}

/// Returns the registry with the task file that the field `scenario` names, if it names one, and that file with its
/// path. All scenarios of the team are then of this content. `path` returns the path that a field contains. An error
/// names the field.
pub fn knowing_task(
    registry: &Registry,
    layers: &Layers,
    path: impl Fn(&LayerValue) -> PathBuf,
) -> Result<(Registry, Option<(PathBuf, TaskFile)>), ConfigError> {
    let entry = layers.find(&[String::new()], "scenario").expect("it has a default");
    if !is_task_file(text(&entry)) {
        return Ok((registry.clone(), None));
    }
    let path = path(&entry);
    let file = registry.task_file(&path.to_string_lossy());
    let file = file.map_err(|e| ConfigError::field(place("scenario", &entry.origin), e.to_string()))?;
    Ok((registry.clone().with_task(text(&entry), file.clone()), Some((path, file))))
}

/// Creates the scenario named in the field `entry` with the settings of its team. An error names the setting that is
/// wrong, where it is written, or the scenario.
pub fn build(
    registry: &Registry,
    layers: &Layers,
    entry: &LayerValue,
    settings: &Settings,
) -> Result<Arc<dyn Scenario>, ConfigError> {
    registry.scenario(text(entry), settings).map_err(|error| {
        let field = match error {
            ScenarioError::Size { field, .. } => field,
            _ => "scenario",
        };
        let written = layers.find(&[String::new()], field).map(|entry| place(field, &entry.origin));
        let inline = || format!("deployment.{field}");
        ConfigError::field(written.unwrap_or_else(inline), error.to_string())
    })
}

/// Returns `safety` with the least distances to robots and walls of robots with the hull of the `deployment`, or else
/// of the team's task file, unless the team file has distances of its own. An error names the field.
pub fn about_hulls(
    safety: Safety,
    layers: &Layers,
    (task, deployment): (Option<&TaskFile>, &Deployment),
) -> Result<Safety, ConfigError> {
    let Some(hull_m) = deployment.hull_m.or(task.map(TaskFile::hull_m)) else { return Ok(safety) };
    let of_hull = safety.of_hull(hull_m);
    let (mut found, given) = (safety, |field: &str| layers.table(&format!("safety.{field}")).is_some());
    if !given("distance_min_m") {
        found.distance_min_m = of_hull.distance_min_m;
    }
    if !given("walls_min_m") {
        found.walls_min_m = of_hull.walls_min_m;
    }
    found.check().map_err(|error| error.within("safety"))?;
    Ok(found)
}
