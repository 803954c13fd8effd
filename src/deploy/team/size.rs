//! The scenario of a team file in its size, and the least distances of robots by their hulls.

use std::sync::Arc;

use super::layers::{LayerValue, Layers, place};
use super::text;
use crate::config::ConfigError;
use crate::deploy::Deployment;
use crate::registry::Registry;
use crate::safety::Safety;
use crate::scenario::{Scenario, ScenarioError, Settings};

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

/// Returns `safety` with the least distances to robots and walls of robots with the hull of the `deployment`, unless
/// the file has distances of its own. An error names the field.
pub fn about_hulls(safety: Safety, layers: &Layers, deployment: &Deployment) -> Result<Safety, ConfigError> {
    let Some(hull_m) = deployment.hull_m else { return Ok(safety) };
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
