//! The command `murmurate replay`: replays records and compares them message by message.

mod actions;
pub mod of_host;
mod page;

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

use crate::record::chosen;
use crate::sim;
use crate::study;
use murmurate::config::shown::{self, counted};
use murmurate::graph::event;
use murmurate::messages::ids::HostId;
use murmurate::registry::Registry;
use murmurate::time::Time;
use murmurate_record::chosen::Chosen;
use murmurate_record::compare::Compared;
use murmurate_record::reader::{self, Opened};
use murmurate_replay::files::Files;
use murmurate_replay::fitness::{self, Unfit, Wanted};
use murmurate_replay::{ReplayError, host, rerun};
use murmurate_robot::output::{self, Confined, print, talk};
use murmurate_robot::{BadInput, Ended, bad, policy};

/// Replays records of simulations and of hosts, and checks that every bit is the same.
#[derive(clap::Args)]
#[command(
    after_help = "Exit codes: 0 everything is equal, to the bit; 1 there is a difference: the first is named; 2 a \
    flag or a file is wrong, or a record is of another build or lacks its key, and nothing was compared. Of several \
    files those that cannot be used are named and left out, and the code is 1; so it is where a file is damaged."
)]
pub struct Args {
    /// Records, or folders of records (docs/record.md)
    #[arg(required = true, value_name = "FILE|DIR")]
    records: Vec<PathBuf>,
    /// Takes only records of simulations: runs each again from its seed
    #[arg(long, conflicts_with = "host")]
    rerun: bool,
    /// Takes only records of hosts: runs each again alone, with its recorded inputs
    #[arg(long)]
    host: bool,
    /// File with the team's key, for records of a team with one; the key is in no record
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// Gives the recorded inputs to another policy, and prints by how much its actions differ
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "rerun")]
    policy: Option<PathBuf>,
    /// CSV file for each step of both policies, with --policy
    #[arg(long, value_name = "FILE.csv", requires = "policy")]
    steps: Option<PathBuf>,
    /// Figure of the differences over time, with --policy
    #[arg(long, value_name = "FILE.svg", requires = "policy")]
    svg: Option<PathBuf>,
    /// Replays a record of another build of this program, too; it may differ for that alone
    #[arg(long)]
    force: bool,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    page: crate::watch::RecordPage,
}

/// Result of the replay of one record; a line of the printed table.
#[derive(Serialize)]
struct Line {
    record: PathBuf,
    /// Name of the recorded run: a host's name, a simulation's repeat, or the name of a study's trial.
    of: String,
    equal: bool,
    messages: u64,
    /// Whether the record was cut by a crash; it is then compared up to the cut.
    cut: bool,
    /// Time since the start of the run at which the record lacks events \[s\]. Nothing after it is compared. `None` if
    /// it lacks none.
    gap_s: Option<f64>,
    /// Time since the start of the run behind which messages are lost, as the file is damaged \[s\]. Nothing after it
    /// is compared. `None` if none are.
    damaged_s: Option<f64>,
    /// Descriptions of the damaged places of the file.
    damaged: Vec<String>,
    difference: Option<String>,
}

/// Results of the replays of all records that the command names.
#[derive(Serialize)]
struct Table {
    records: Vec<Line>,
}

/// Runs `replay`: replays all records and prints whether they are equal, or shows them on a page if `--watch` is given.
/// Returns [`Ended::Unfit`] if a replay differs from its record.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    if args.page.is_on() {
        return page::watch(args, registry);
    }
    let Chosen { records, left_out } = chosen::records(&args.records)?;
    let (only, mut table, mut sound) = (records.len() == 1 && !left_out, Table { records: Vec::new() }, !left_out);
    let (mut shown, mut refused) = (false, None);
    for (path, _) in records {
        match one(args, &path, registry) {
            Ok(line) => {
                shown = true;
                table.records.extend(line);
            }
            Err(error) if !only && error.is::<BadInput>() => {
                talk(&format!("left out: {error}"));
                refused.get_or_insert(error);
                sound = false;
            }
            Err(error) => return Err(error),
        }
    }
    if let Some(error) = refused.filter(|_| !shown) {
        return Err(error);
    }
    if args.policy.is_some() {
        return Ok(if sound { Ended::Done } else { Ended::Unfit });
    }
    print(&if args.json { serde_json::to_string(&table).context("a result is JSON")? } else { table.to_string() })?;
    sound &= table.records.iter().all(|line| line.equal && line.damaged.is_empty());
    Ok(if sound { Ended::Done } else { Ended::Unfit })
}

/// Replays one record. Returns its line of the table; `None` with the flag `--policy`, which prints another table.
fn one(args: &Args, path: &Path, registry: &Registry) -> Result<Option<Line>> {
    let opened = reader::open(path).map_err(|error| BadInput(error.to_string()))?;
    check(args, path, &opened)?;
    let damage = opened.messages.health().faults.iter().map(|fault| fault.since(opened.identity.anchor_ns));
    let damaged: Vec<String> = damage.collect();
    let of = match &opened.identity.host {
        Some(host) => format!("host {}", host.name),
        // A record of a study is named by its column, its policy and its repeat.
        None if opened.identity.job.is_some() => {
            path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
        }
        None => format!("repeat {}", opened.identity.repeat),
    };
    let files = Files::extract(&opened)?;
    let compared = match &opened.identity.host {
        Some(host) if args.policy.is_some() => {
            damaged.iter().for_each(|damage| talk(&format!("'{}' is damaged: {damage}", path.display())));
            let name = host.name.clone();
            actions::show(args, &name, of_host::prepare(args, (path, opened), &files, registry)?)?;
            return Ok(None);
        }
        Some(_) => {
            let (prepared, _) = of_host::prepare(args, (path, opened), &files, registry)?;
            let compared = host::compare(prepared, stamp);
            output::stamp_as_recorded(None);
            compared.map_err(sorted)?
        }
        None if args.policy.is_some() => {
            return bad(format!("--policy: '{}' is the record of a simulation; use 'sim --policy'", path.display()));
        }
        None => rerun(opened, &files, registry, |_, _| {}, |_| {})?,
    };
    let Compared { messages, difference, cut, gap_s, damaged_s } = compared;
    let equal = difference.is_none();
    let difference = difference.map(|difference| difference.to_string());
    Ok(Some(Line { record: path.to_owned(), of, equal, messages, cut, gap_s, damaged_s, damaged, difference }))
}

/// Fails if a record cannot be replayed with these flags: if it is of an operator, of the other kind than the flags
/// permit, not from the beginning of its run, or of another build without `--force`.
fn check(args: &Args, path: &Path, Opened { identity, messages, .. }: &Opened) -> Result<()> {
    let at = path.display();
    let wanted = match (args.rerun, args.host) {
        (true, _) => Wanted::Simulations,
        (_, true) => Wanted::Hosts,
        _ => Wanted::All,
    };
    if let Err(unfit) = fitness::check(identity, messages.health(), wanted) {
        return bad(match unfit {
            Unfit::LosesFiles(why) => format!("files that a replay of '{at}' needs may be lost: {why}"),
            Unfit::OfOperator => format!(
                "'{at}' has what an operator received, and nothing that could run again; look at it with --watch"
            ),
            Unfit::Imported => {
                format!("'{at}' is a run from elsewhere, and nothing in it could run again; look at it with --watch")
            }
            Unfit::OfHost => format!("--rerun: '{at}' is the record of a host; use --host"),
            Unfit::OfSimulation => format!("--host: '{at}' is the record of a simulation; use --rerun"),
            Unfit::Excerpt => format!(
                "'{at}' has only the seconds around what happened (--record-last), and a replay needs a run from its \
                 beginning; look at it with --watch"
            ),
            Unfit::FurtherPart => format!("'{at}' goes on from another file of its record: name the first one"),
        });
    }
    if identity.build != murmurate_robot::build::digest() {
        let (theirs, this) = (&identity.build, murmurate_robot::build::digest());
        if !args.force {
            return bad(format!(
                "'{at}' was made by another build of this program ({theirs}, version {}; this is {this}): replay it \
                 with that one, or try with --force",
                identity.version
            ));
        }
        talk(&format!("warning: '{at}' was made by another build ({theirs}; this is {this}) and may differ for that"));
    }
    // Of a host the answers of the engine are in the record.
    policy::onnx::open_library()?;
    let (theirs, this) = (&identity.engine, murmurate_onnx::engine::about());
    let is_of_a_graph = !theirs.is_empty() && !theirs.starts_with(murmurate_onnx::network::PYTHON);
    if identity.is_of_simulation() && is_of_a_graph && *theirs != this {
        talk(&format!(
            "warning: the policy of '{at}' was computed by {theirs}, and here it is {this}: the last digits of its \
             numbers may be others, and the run with them"
        ));
    }
    Ok(())
}

/// Lets this thread read the files of a record and those that the user has named, and nothing else that the record
/// names.
pub fn confine(files: &Files, named: Option<&Path>) -> Confined {
    Confined::to([Some(files.folder()), named].into_iter().flatten().map(Path::to_owned).collect())
}

/// Converts the error of a replay: one about the content of a record becomes a [`BadInput`].
fn sorted(error: ReplayError) -> anyhow::Error {
    match error {
        ReplayError::Unusable(why) => BadInput(why).into(),
        ReplayError::Trial(error) => BadInput(error.to_string()).into(),
        ReplayError::Open(error) => error.into(),
        other => other.into(),
    }
}

/// Runs a recorded simulation again from its seed, and compares it with its record. Calls `observe` with each event of
/// the run, and `turned` with the time of each instant after its events.
fn rerun(
    opened: Opened,
    files: &Files,
    registry: &Registry,
    observe: impl Fn(HostId, event::Event) + 'static,
    mut turned: impl FnMut(Time),
) -> Result<Compared> {
    let Opened { identity, messages, .. } = opened;
    let arguments = files.in_place(&identity.arguments);
    let confined = confine(files, None);
    let trial = match identity.job {
        Some(job) => study::of_record(&arguments, (job, identity.repeat), registry)?,
        None => {
            let place = |path: &Path| files.extracted(path).map(Path::to_owned);
            sim::of_record(&arguments, identity.repeat, registry, &place)?
        }
    };
    drop(confined);
    let compared = rerun::rerun(&trial, messages, observe, |now| {
        stamp(now);
        turned(now);
    });
    output::stamp_as_recorded(None);
    compared.map_err(sorted)
}

/// Marks the lines of the log from now on as of this time of a record.
fn stamp(now: Time) {
    output::stamp_as_recorded(Some(now));
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.records.iter().map(|line| line.of.chars().count()).max().unwrap_or(0);
        for (index, line) in self.records.iter().enumerate() {
            if index > 0 {
                writeln!(f)?;
            }
            let Line { of, messages, cut, gap_s, damaged_s, damaged, difference, .. } = line;
            write!(f, "{:width$}  ", shown::value(of))?;
            match difference {
                None => write!(f, "equal, {}", counted(messages, "message"))?,
                Some(difference) => {
                    write!(f, "DIFFERS after {}\n{difference}", counted(messages, "equal message"))?;
                }
            }
            if let Some(damaged_s) = damaged_s {
                write!(f, ", up to {damaged_s:.3} s, where the file is damaged")?;
            } else if let Some(gap_s) = gap_s {
                write!(f, ", up to {gap_s:.3} s, where the record lacks events")?;
            } else if *cut {
                write!(f, ", up to the end of the record, which a crash has cut")?;
            }
            for damage in damaged {
                write!(f, "\n  the file is damaged: {damage}")?;
            }
        }
        Ok(())
    }
}
