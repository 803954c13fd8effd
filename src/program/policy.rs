//! The policy that a user has named, or the scenario's own, from its file to a model.

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use crate::policy::gnn::Network;
use crate::policy::shipped::{published, shipped};
use crate::policy::{Draw, Model, weights};
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
    /// A digest of its file; empty for scripted navigation.
    pub digest: String,
    /// What its file does not say and was assumed, for a warning.
    pub assumed: Option<String>,
}

/// Reads the policy: a file, `orca`, `shipped`, `published`, or without any the shipped one of the scenario (`orca` if
/// there is none). `action` says how actions are drawn (`mean`, `sample`); without it the file does.
pub fn load(named: Option<&Path>, action: Option<&str>, scenario: &dyn Scenario) -> Result<Loaded> {
    let own = match named.and_then(Path::to_str) {
        None | Some("shipped") => shipped(scenario.name()).map(|bytes| ("shipped", bytes)),
        Some("published") => published(scenario.name()).map(|bytes| ("published", bytes)),
        Some(_) => None,
    };
    let named = named.unwrap_or(Path::new("orca"));
    let (name, bytes) = match own {
        Some((name, bytes)) => (name.to_owned(), Cow::Borrowed(bytes)),
        None if named == Path::new("orca") => {
            if action.is_some() {
                let why = "--action: the policy 'orca' draws nothing; leave the flag out";
                return Err(BadInput(why.to_owned()).into());
            }
            let (name, digest) = ("orca".to_owned(), String::new());
            return Ok(Loaded { model: Model::Orca, name, digest, assumed: None });
        }
        None if named == Path::new("shipped") || named == Path::new("published") => {
            let (name, scenario) = (named.display(), scenario.name());
            return Err(BadInput(format!("--policy {name}: the scenario '{scenario}' has none; use 'orca'")).into());
        }
        None => {
            let name = named.display().to_string();
            let bytes = read_bytes(named, "policy file (or name the policy 'orca')")?;
            (name, Cow::Owned(bytes))
        }
    };
    let digest = blake3::hash(&bytes).to_hex()[..16].to_owned();
    let file = weights::read(&bytes).map_err(|e| BadInput(format!("the policy file '{name}': {e}")))?;
    if file.manifest.scenario != scenario.name() {
        let (theirs, ours) = (&file.manifest.scenario, scenario.name());
        return Err(BadInput(format!("the policy file '{name}' is for the scenario '{theirs}', not '{ours}'")).into());
    }
    let assumed = file.assumed.as_ref().map(|assumed| format!("the policy file '{name}': {assumed}"));
    let draw = match action {
        Some("mean") => Draw::Mean,
        Some(_) => Draw::Sample,
        None => file.manifest.draw,
    };
    Ok(Loaded { model: Model::Gnn(Arc::new(Network::new(file)), draw), name, digest, assumed })
}
