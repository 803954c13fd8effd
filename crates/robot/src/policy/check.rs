//! The command `murmurate policy check`: describes a policy file or a built-in policy, and checks that this program can
//! run it.

use std::borrow::Cow;
use std::path::PathBuf;

use anyhow::{Context, Result};
use serde::Serialize;

use super::facts::{Facts, ProbeFacts, drawn, lines, list, made, observation, probe as probe_row};
use super::{check_hops, check_onnx, onnx};
use crate::output::{print, read_bytes, talk};
use crate::{BadInput, Ended};
use murmurate::policy::file::{self, AnyManifest};
use murmurate::policy::gnn::GnnWeights;
use murmurate::policy::hops::manifest::Entry;
use murmurate::policy::manifest::{Activation, Aggregation, Architecture, EdgeField, Manifest};
use murmurate::policy::probe::{self, Difference};
use murmurate::policy::shipped;
use murmurate::registry::Registry;
use murmurate::scenario::task_file::is_task_file;

/// Flags of `murmurate policy check`.
#[derive(clap::Args)]
pub struct Args {
    /// The policy file; or 'shipped' or 'published', for one that is built into the program
    policy: PathBuf,
    /// Scenario of a built-in policy; or the task file for which the policy is
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "passage")]
    scenario: String,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    json: bool,
    /// Checks a policy of format 3 in this process, for the one that has started it
    #[arg(long, hide = true)]
    here: bool,
}

/// Runs `policy check`: prints a description of a policy file.
///
/// # Errors
/// If the file cannot be read or this program cannot run it.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    if onnx::is_format_3(&args.policy) {
        return format_3(args);
    }
    let name = args.policy.display().to_string();
    let refuse = |why: String| BadInput(format!("the policy file '{name}': {why}"));
    let bytes = bytes(args, registry)?;
    let file = file::read(&bytes).map_err(|error| refuse(error.to_string()))?;
    let (network, difference) = probe::network(file).map_err(|error| refuse(error.to_string()))?;
    foreign(network.manifest().scenario(), args, registry)?.map_or(Ok(()), |why| Err(refuse(why)))?;
    match network.manifest() {
        AnyManifest::Format1(manifest) => show(args, &facts(name, &network, manifest, difference), table),
        AnyManifest::Format2(manifest) => show(args, &facts(name, &network, manifest, difference), check_hops::table),
    }
}

/// Returns the facts of a policy file of format 1 or 2 called `file`.
fn facts<'a, M>(
    file: String,
    network: &'a GnnWeights,
    manifest: &'a M,
    difference: Option<Difference>,
) -> Facts<'a, M> {
    Facts {
        file,
        digest: network.digest(),
        manifest,
        parameters: network.parameters(),
        latent_bytes: 4 * network.interface().features,
        probe: difference.map(ProbeFacts::of),
        warnings: network.assumed().map(str::to_owned).into_iter().collect(),
    }
}

/// Runs `policy check` for a policy of format 3.
fn format_3(args: &Args) -> Result<Ended> {
    if args.here {
        print(&serde_json::to_string(&onnx::check_here(&args.policy)?).context("a result is JSON")?)?;
        return Ok(Ended::Done);
    }
    let (network, sound) = onnx::load(&args.policy)?;
    let facts = check_onnx::Facts {
        file: args.policy.display().to_string(),
        manifest: network.contract(),
        engine: if network.contract().python.is_some() {
            Some(murmurate_onnx::network::PYTHON)
        } else {
            murmurate_onnx::engine::name()
        },
        sound,
    };
    print(&if args.json {
        serde_json::to_string(&facts).context("facts are JSON")?
    } else {
        check_onnx::table(&facts)
    })?;
    Ok(Ended::Done)
}

/// Prints the facts, as JSON or as the text that `table` makes of them.
fn show<M: Serialize>(args: &Args, facts: &Facts<M>, table: fn(&Facts<M>) -> String) -> Result<Ended> {
    print(&if args.json { serde_json::to_string(facts).context("facts are JSON")? } else { table(facts) })?;
    if !args.json {
        facts.warnings.iter().for_each(|warning| talk(&format!("warning: {warning}")));
    }
    Ok(Ended::Done)
}

/// Returns the reason why no command runs the policy, if neither the program nor the task file of the flag `--scenario`
/// has a scenario with the name in its file. Fails if that file cannot be read.
fn foreign(scenario: &str, args: &Args, registry: &Registry) -> Result<Option<String>> {
    let mut known: Vec<String> = registry.scenarios().iter().map(|entry| entry.name.to_owned()).collect();
    if is_task_file(&args.scenario) {
        let file = registry.task_file(&args.scenario).map_err(|error| BadInput(format!("--scenario: {error}")))?;
        known.push(file.name().to_owned());
    }
    Ok((!known.iter().any(|name| name == scenario)).then(|| {
        format!(
            "it is for the scenario '{scenario}', which this program does not have: it has {}; if that is a task file, \
             name it with --scenario, and a crate of your own can add others (docs/library.md)",
            known.join(", ")
        )
    }))
}

/// Returns the content of the policy file that the arguments name, or of a built-in policy of the scenario.
fn bytes(args: &Args, registry: &Registry) -> Result<Cow<'static, [u8]>> {
    let Args { policy, scenario, .. } = args;
    let name = match policy.to_str() {
        Some(name) if shipped::NAMES.contains(&name) => name,
        Some(name) if !policy.exists() && registry.policies().iter().any(|entry| entry.name == name) => {
            return Err(BadInput(format!("the policy '{name}' is code, not a file: there is nothing to check")).into());
        }
        _ => return Ok(Cow::Owned(read_bytes(policy, "policy file")?)),
    };
    let Some(built_in) = shipped::built_in(name, scenario) else {
        return Err(BadInput(format!("there is no {name} policy for the scenario '{scenario}'")).into());
    };
    Ok(Cow::Borrowed(built_in))
}

fn table(facts: &Facts<Manifest>) -> String {
    let manifest = facts.manifest;
    let architecture = match manifest.architecture {
        Architecture::Published => "published layers",
        Architecture::Full => "full, equation (1) of the paper",
    };
    let Activation::Relu = manifest.activation.unwrap_or(Activation::Relu);
    let Aggregation::Sum = manifest.aggregation.unwrap_or(Aggregation::Sum);
    let edge = manifest.edge.iter().map(|field| match field {
        EdgeField::Age => "age of the message [s]",
        EdgeField::RelativePosition => "the neighbour's position - the own [m]",
    });
    let rows = [
        ("scenario", manifest.scenario.clone()),
        ("architecture", format!("{architecture}; activation relu, aggregation sum")),
        ("networks", networks(facts)),
        ("observation", observation(&manifest.observation.iter().copied().map(Entry::from).collect::<Vec<_>>())),
        ("edge", list(edge.collect())),
        (
            "action",
            format!(
                "velocity [m/s], policy frame, at most {} along each axis, {} times a second; {}",
                manifest.limit_m_s,
                manifest.rate_hz,
                drawn(manifest.draw)
            ),
        ),
        (
            "messages",
            format!(
                "{} floats ({} bytes), used within {} m for {} s",
                facts.latent_bytes / 4,
                facts.latent_bytes,
                manifest.radius_m,
                manifest.hold_s
            ),
        ),
        ("probe", probe_row(facts)),
        ("made by", made(manifest.training.as_ref())),
        ("digest", facts.digest.to_owned()),
    ];
    lines(&facts.file, &rows)
}

/// Returns a text with the layer widths of the encoder, message network and update network, and the number of
/// parameters.
fn networks(facts: &Facts<Manifest>) -> String {
    let widths = |widths: &[usize]| widths.iter().map(usize::to_string).collect::<Vec<_>>().join("-");
    let Manifest { encoder, message, update, .. } = facts.manifest;
    let [encoder, message, update] = [encoder, message, update].map(|network| widths(network));
    format!("encoder {encoder}, message {message}, update {update}: {} parameters", facts.parameters)
}
