//! The policy that a user has named, or the scenario's own, from its name or its file to a model.

use std::path::Path;

use crate::policy::{Draw, Model};
use crate::registry::Registry;
use crate::scenario::Scenario;
use anyhow::Result;

use crate::program::BadInput;
use crate::program::output::read_bytes;

/// A policy that can drive a team.
pub struct Loaded {
    /// What drives it.
    pub model: Model,
    /// Its name in reports.
    pub name: String,
    /// What its file does not say and was assumed, for a warning.
    pub assumed: Option<String>,
}

/// Loads the policy: one that the registry has a name for, or a file; without any the one that the scenario has
/// usually. `draw` says how actions are drawn; without it the file does.
pub fn load(registry: &Registry, named: Option<&Path>, draw: Option<Draw>, scenario: &dyn Scenario) -> Result<Loaded> {
    let named = named.unwrap_or_else(|| Path::new(registry.usual_policy(scenario)));
    let name = named.display().to_string();
    let (model, place) = match named.to_str().and_then(|name| registry.policy(name)) {
        Some(entry) => ((entry.build)(scenario), format!("--policy {name}")),
        None => {
            let known: Vec<&str> = registry.policies().iter().map(|entry| entry.name).collect();
            let bytes = read_bytes(named, &format!("policy file (or name a policy: {})", known.join(", ")))?;
            (Model::from_file(&bytes, scenario.name()), format!("the policy file '{name}'"))
        }
    };
    let mut model = model.map_err(|error| BadInput(format!("{place}: {error}")))?;
    if let Some(draw) = draw {
        let nothing = || BadInput(format!("--action: the policy '{name}' draws nothing; leave the flag out"));
        model = model.with_draw(draw).ok_or_else(nothing)?;
    }
    let assumed = model.assumed().map(|assumed| format!("{place}: {assumed}"));
    Ok(Loaded { model, name, assumed })
}
