//! The command `murmurate config`: checks a team file, or prints the values in effect.

use std::collections::BTreeSet;

use anyhow::{Context, Result};
use clap::Subcommand;
use murmurate::config::shown::{self, counted};
use murmurate::deploy::team::Origin;
use murmurate::deploy::{Deployment, Host};
use murmurate::graph::devices::{self, RunBy};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::registry::Registry;
use murmurate::trial::Trial;
use serde_json::json;

use crate::output::{print, talk};
use crate::team;
use crate::{BadInput, Ended};

/// Checks a team file, or shows every value of it with its origin.
#[derive(Subcommand)]
pub enum Args {
    /// Checks a team file with its key and its policy, for every host or for one
    Check(Check),
    /// Prints every value in effect and where it comes from
    Show(Show),
}

/// Flags of `murmurate config check`.
#[derive(clap::Args)]
pub struct Check {
    #[command(flatten)]
    team: team::TeamArgs,
    #[command(flatten)]
    which: team::Which,
}

/// Flags of `murmurate config show`.
#[derive(clap::Args)]
pub struct Show {
    #[command(flatten)]
    team: team::TeamArgs,
    #[command(flatten)]
    which: team::Which,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs `config check` or `config show`.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    match args {
        Args::Check(args) => check(args, registry),
        Args::Show(args) => show(args, registry),
    }
}

fn check(args: &Check, registry: &Registry) -> Result<Ended> {
    let file = args.team.read(registry)?;
    let hosts: Vec<HostId> = args.which.find(&file)?.map_or_else(|| file.hosts().collect(), |host| vec![host]);
    let (mut keys, mut policies, mut seen) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
    for &host in &hosts {
        let team = args.team.for_host(&file, host)?;
        if keys.insert(team.key_file.clone()) {
            seen.extend(team::key(&team)?.map(|file| file.fingerprint()));
        }
        if policies.insert(team.policy.clone()) {
            let loaded = team::policy(&team, registry)?;
            loaded.warnings.iter().for_each(|warning| talk(&format!("warning: {warning}")));
            // Whether the team has what its policies take.
            Trial::of_host(registry, &team, loaded.models).map_err(|error| BadInput(error.to_string()))?;
        }
    }
    if seen.len() > 1 || (keys.len() > 1 && keys.contains(&None)) {
        talk("warning: not all hosts have the same key; hosts with different keys do not accept each other's messages");
    }
    let deployment = file.deployment();
    let keys = if seen.is_empty() { "no key".to_owned() } else { format!("key {}", Vec::from_iter(seen).join(", ")) };
    let named: Vec<&Host> = hosts.iter().map(|host| &deployment.hosts[usize::from(host.0)]).collect();
    let (links, hosts) = (deployment.links.len(), hosts.len());
    let mode = shown::value(&deployment.mode);
    let path = shown::value(args.team.path().display());
    print(&format!("{path}: valid: mode {mode}, {}, {}, {keys}", counted(hosts, "host"), counted(links, "link")))?;
    programs(&named, deployment, registry)?.into_iter().try_for_each(|line| print(&line))?;
    Ok(Ended::Done)
}

/// Returns the lines that say which programs the hosts run: whoever may write a team file decides on them. None if they
/// run none.
fn programs(hosts: &[&Host], deployment: &Deployment, registry: &Registry) -> Result<Vec<String>> {
    let mut lines = Vec::new();
    for host in hosts {
        let of_senses = programs_of_senses(host, deployment, registry)?;
        for RunBy { device, command } in devices::programs(host, registry)?.into_iter().chain(of_senses) {
            let command: Vec<String> = command.iter().map(|word| quoted(word)).collect();
            let host = shown::value(&host.name);
            lines.push(format!("  {host}: {device}: {}", shown::value(command.join(" "))));
        }
    }
    if !lines.is_empty() {
        lines.insert(0, "it runs these programs, with the rights of whoever starts a host:".to_owned());
    }
    Ok(lines)
}

/// Returns the programs that the senses of a host's robots run.
fn programs_of_senses(host: &Host, deployment: &Deployment, registry: &Registry) -> Result<Vec<RunBy>> {
    let mut programs = Vec::new();
    for &robot in host.simulates.iter().chain(&host.actuates) {
        for (_, name, settings) in deployment.senses_of(RobotId(robot)) {
            let parts = registry.sense(name, settings, RobotId(robot)).map_err(|error| error.within("senses"))?;
            let command = parts.worker.and_then(|worker| worker.runs());
            programs.extend(command.map(|command| RunBy { device: format!("{name} {robot}"), command }));
        }
    }
    Ok(programs)
}

/// Returns a word of a command as a shell would take it.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

fn show(args: &Show, registry: &Registry) -> Result<Ended> {
    let file = args.team.read(registry)?;
    let host = args.which.find(&file)?;
    let path = args.team.path().display();
    let origin = |origin: &Origin| match origin {
        Origin::File(line) => format!("{path}:{line}"),
        other => other.to_string(),
    };
    let all = file.values(host);
    if args.json {
        let values: Vec<_> = all
            .iter()
            .map(|shown| json!({"field": shown.key, "value": shown.value, "origin": origin(&shown.origin)}))
            .collect();
        let host = host.map(|host| &file.deployment().hosts[usize::from(host.0)].name);
        let object = json!({"host": host, "values": values, "deployment": file.deployment()});
        print(&serde_json::to_string(&object).context("values are JSON")?)?;
        return Ok(Ended::Done);
    }
    let width = |of: fn(&murmurate::deploy::team::Shown) -> usize| all.iter().map(of).max().unwrap_or(0);
    let (keys, values) = (width(|shown| shown.key.len()), width(|shown| shown.value.len()));
    let lines: Vec<String> = all
        .iter()
        .map(|shown| {
            let (key, value) = (shown::value(&shown.key), shown::value(&shown.value));
            format!("{key:keys$}  {value:values$}  {}", shown::value(origin(&shown.origin)))
        })
        .collect();
    print(&lines.join("\n"))?;
    Ok(Ended::Done)
}
