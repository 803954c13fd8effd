//! The command `murmurate policy check`: describes a policy file or a built-in policy, and checks that this program can
//! run it.

use std::borrow::Cow;
use std::path::PathBuf;

use anyhow::{Context, Result};
use serde::Serialize;

use crate::policy::Draw;
use crate::policy::manifest::{Activation, Aggregation, Architecture, EdgeField, Field, Manifest};
use crate::policy::probe::{self, Difference};
use crate::policy::shipped;
use crate::policy::weights::{self, Probe};
use crate::program::output::{print, read_bytes, talk};
use crate::program::{BadInput, Ended};
use crate::registry::Registry;

/// Flags of `murmurate policy check`.
#[derive(clap::Args)]
pub struct Args {
    /// The policy file; or 'shipped' or 'published', for one that is built into the program
    policy: PathBuf,
    /// Scenario of a built-in policy
    #[arg(long, default_value = "passage")]
    scenario: String,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// Properties of a policy file that this program can run; printed by `policy check`.
#[derive(Serialize)]
struct Facts<'a> {
    file: String,
    /// First 64 bits of the file's BLAKE3 hash, in hexadecimal.
    digest: &'a str,
    manifest: &'a Manifest,
    parameters: usize,
    /// Size of a latent in a message \[bytes\].
    latent_bytes: usize,
    probe: Option<ProbeFacts>,
    warnings: Vec<String>,
}

/// Largest differences between the outputs of the file's networks and the correct outputs in the file (its probe).
/// Differences from numbers above 1 are relative.
#[derive(Serialize)]
struct ProbeFacts {
    robots: usize,
    latent_difference: f32,
    output_difference: f32,
}

/// Runs `policy check`: prints a description of a policy file.
///
/// # Errors
/// If the file cannot be read or this program cannot run it.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let name = args.policy.display().to_string();
    let refuse = |why: String| BadInput(format!("the policy file '{name}': {why}"));
    let bytes = bytes(args, registry)?;
    let file = weights::read(&bytes).map_err(|error| refuse(error.to_string()))?;
    let layers = file.networks.iter().flat_map(|network| network.layers());
    let parameters = layers.map(|layer| (layer.inputs() + 1) * layer.outputs()).sum();
    let (network, difference) = probe::network(file).map_err(|error| refuse(error.to_string()))?;
    let probe = difference.map(|Difference { robots, latent, output }| ProbeFacts {
        robots,
        latent_difference: latent,
        output_difference: output,
    });
    let manifest = network.manifest();
    let known: Vec<&str> = registry.scenarios().iter().map(|entry| entry.name).collect();
    let foreign = (!known.contains(&&*manifest.scenario)).then(|| {
        format!(
            "this program has no scenario '{}', only {}; a crate of your own can add it",
            manifest.scenario,
            known.join(", ")
        )
    });
    let facts = Facts {
        file: name,
        digest: network.digest(),
        manifest,
        parameters,
        latent_bytes: 4 * network.interface().features,
        probe,
        warnings: network.assumed().map(str::to_owned).into_iter().chain(foreign).collect(),
    };
    print(&if args.json { serde_json::to_string(&facts).context("facts are JSON")? } else { table(&facts) })?;
    if !args.json {
        facts.warnings.iter().for_each(|warning| talk(&format!("warning: {warning}")));
    }
    Ok(Ended::Done)
}

/// Returns the content of the policy file that the arguments name, or of the built-in policy `shipped` or `published`
/// of the scenario.
fn bytes(args: &Args, registry: &Registry) -> Result<Cow<'static, [u8]>> {
    let Args { policy, scenario, .. } = args;
    let (name, built_in) = match policy.to_str() {
        Some("shipped") => ("shipped", shipped::shipped(scenario)),
        Some("published") => ("published", shipped::published(scenario)),
        Some(name) if !policy.exists() && registry.policies().iter().any(|entry| entry.name == name) => {
            return Err(BadInput(format!("the policy '{name}' is code, not a file: there is nothing to check")).into());
        }
        _ => return Ok(Cow::Owned(read_bytes(policy, "policy file")?)),
    };
    let Some(built_in) = built_in else {
        return Err(BadInput(format!("there is no {name} policy for the scenario '{scenario}'")).into());
    };
    Ok(Cow::Borrowed(built_in))
}

fn table(facts: &Facts) -> String {
    let manifest = facts.manifest;
    let architecture = match manifest.architecture {
        Architecture::Published => "published layers",
        Architecture::Full => "full, equation (1) of the paper",
    };
    let Activation::Relu = manifest.activation.unwrap_or(Activation::Relu);
    let Aggregation::Sum = manifest.aggregation.unwrap_or(Aggregation::Sum);
    let observation = manifest.observation.iter().map(|field| match field {
        Field::GoalMinusPosition => "goal - position [m]",
        Field::Position => "position [m]",
        Field::PositionPlusVelocity => "position + velocity x 1 s [m]",
    });
    let edge = manifest.edge.iter().map(|field| match field {
        EdgeField::Age => "age of the message [s]",
        EdgeField::RelativePosition => "the neighbour's position - the own [m]",
    });
    let list = |names: Vec<&str>| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    let draw = match manifest.draw {
        Draw::Mean => "the mean of its distribution",
        Draw::Sample => "sampled from its distribution",
    };
    let probe = facts.probe.as_ref().map_or("none in the file".to_owned(), |probe| {
        format!(
            "{} robots: latents within {:.1e}, outputs within {:.1e} (accepted: {:.0e})",
            probe.robots,
            probe.latent_difference,
            probe.output_difference,
            Probe::TOLERANCE
        )
    });
    let made = manifest.training.as_ref().map_or("not stated".to_owned(), |made| {
        format!("{}, preset {}, seed {}, {} decisions", made.program, made.preset, made.seed, made.decisions)
    });
    let rows = [
        ("scenario", manifest.scenario.clone()),
        ("architecture", format!("{architecture}; activation relu, aggregation sum")),
        ("networks", networks(facts)),
        ("observation", format!("{}; policy frame", list(observation.collect()))),
        ("edge", list(edge.collect())),
        (
            "action",
            format!(
                "velocity [m/s], policy frame, at most {} along each axis, {} times a second; {draw}",
                manifest.limit_m_s, manifest.rate_hz
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
        ("probe", probe),
        ("made by", made),
        ("digest", facts.digest.to_owned()),
    ];
    let rows = rows.map(|(name, value)| format!("  {name:<14} {value}"));
    format!("{}: this program can run it\n{}", facts.file, rows.join("\n"))
}

/// Returns a text with the layer widths of the encoder, message network and update network, and the number of
/// parameters.
fn networks(facts: &Facts) -> String {
    let widths = |widths: &[usize]| widths.iter().map(usize::to_string).collect::<Vec<_>>().join("-");
    let Manifest { encoder, message, update, .. } = facts.manifest;
    let [encoder, message, update] = [encoder, message, update].map(|network| widths(network));
    format!("encoder {encoder}, message {message}, update {update}: {} parameters", facts.parameters)
}
