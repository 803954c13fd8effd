//! Making of records: the flag `--record`, the names of files, and what is put into a record beside its events.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Result;

use crate::deploy::team::Team;
use crate::graph::process::{Graph, ProcessEvent};
use crate::live::LiveHost;
use crate::messages::ids::HostId;
use crate::program::BadInput;
use crate::program::output::read_bytes;
use crate::record::file::{Attached, Beginning, Recording};
use crate::record::identity::{HostIdentity, Identity};
use crate::record::queue::{Inlet, WhenFull};
use crate::record::topics::{Stage, Topics};
use crate::record::{Event, Scope};
use crate::time::Time;

/// Time that the end of a host waits for the writer of its record.
const FINISH_TIMEOUT: Duration = Duration::from_millis(1500);

/// Flag for records.
#[derive(clap::Args, Clone, Default)]
pub struct RecordFlags {
    /// Folder for records of the run (MCAP): to look at, to replay, to hand on (docs/record.md)
    #[arg(long, value_name = "DIR")]
    pub record: Option<PathBuf>,
}

/// Flags with a value that do not change what is run.
const OUTPUTS: [&str; 10] = [
    "--record",
    "--trajectories",
    "--animate",
    "--svg",
    "--jobs",
    "--listen",
    "--token-file",
    "--speed",
    "--metrics",
    "--metrics-token-file",
];
/// The same without a value.
const SWITCHES: [&str; 5] = ["--json", "--quiet", "--launched", "--watch", "--control"];

/// Returns the arguments of this program's command, from its name on, without those that do not change what is run:
/// equal runs have equal records.
fn arguments() -> Vec<String> {
    let all = std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned());
    let mut value_follows = false;
    let changes = |argument: &String| {
        if std::mem::take(&mut value_follows) || SWITCHES.contains(&&**argument) {
            return false;
        }
        value_follows = OUTPUTS.contains(&&**argument);
        let joined = |flag: &&str| argument.strip_prefix(*flag).is_some_and(|rest| rest.starts_with('='));
        !value_follows && !OUTPUTS.iter().any(joined)
    };
    all.filter(changes).collect()
}

/// Makes the folder of records.
fn make(folder: &Path) -> Result<()> {
    let refuse = |error| BadInput(format!("--record: cannot make the folder '{}': {error}", folder.display()));
    std::fs::create_dir_all(folder).map_err(refuse)?;
    Ok(())
}

/// Reads the files of a run for its record; names that are no files are left out.
fn attach(names: impl IntoIterator<Item = PathBuf>) -> Result<Vec<Attached>> {
    let files = names.into_iter().filter(|name| name.is_file());
    let attached = files.map(|path| {
        let name = path.to_string_lossy().into_owned();
        let media_type = if name.ends_with(".toml") { "application/toml" } else { "application/octet-stream" };
        Ok(Attached { content: read_bytes(&path, "file")?, name, media_type })
    });
    attached.collect()
}

/// Records of the repeats of a simulation.
#[cfg(feature = "sim")]
pub struct Simulated {
    folder: PathBuf,
    beginning: Beginning,
    failure: Mutex<Option<anyhow::Error>>,
}

#[cfg(feature = "sim")]
impl Simulated {
    /// Prepares the folder. `files` are those that the flags name, `policy` is the digest of the policy's file. A
    /// folder with a record of another run is refused.
    pub fn open(folder: &Path, files: Vec<PathBuf>, policy: &str, repeats: u32) -> Result<Simulated> {
        make(folder)?;
        let taken = (0..repeats).map(|repeat| Simulated::path(folder, repeat)).find(|path| path.exists());
        if let Some(path) = taken {
            let why = format!("--record: '{}' is there already; name another folder", path.display());
            return Err(BadInput(why).into());
        }
        let beginning = Beginning { identity: Identity::here(arguments(), policy), attached: attach(files)? };
        Ok(Simulated { folder: folder.to_owned(), beginning, failure: Mutex::default() })
    }

    fn path(folder: &Path, repeat: u32) -> PathBuf {
        folder.join(format!("repeat-{repeat:04}.mcap"))
    }

    /// Runs a trial with a record of it.
    pub fn run(
        &self,
        trial: &crate::trial::Trial,
        mut proceed: impl FnMut(&[crate::report::episode::Episode]) -> crate::trial::Proceed,
    ) -> crate::trial::TrialReport {
        self.run_observed(trial, |_, _| {}, |_, _, episodes| proceed(episodes))
    }

    /// Runs a trial with a record of it, and reports what happens as `Trial::run_observed` does.
    pub fn run_observed(
        &self,
        trial: &crate::trial::Trial,
        report: impl Fn(HostId, ProcessEvent) + 'static,
        mut proceed: impl FnMut(&Graph, Time, &[crate::report::episode::Episode]) -> crate::trial::Proceed,
    ) -> crate::trial::TrialReport {
        let mut beginning = self.beginning.clone();
        beginning.identity.repeat = trial.repeat;
        let topics = Topics::new(Stage::of(&trial.plan()), Scope::Simulation, 0);
        let path = Simulated::path(&self.folder, trial.repeat);
        let recording = match Recording::start(&path, &beginning, topics, WhenFull::Wait) {
            Ok(recording) => recording,
            Err(error) => {
                self.fail(error.into());
                return crate::trial::TrialReport::default();
            }
        };
        let (events, turns) = (recording.inlet(), recording.inlet());
        let report = trial.run_observed(
            move |host, observed| {
                if let Some(event) = Event::of(Scope::Simulation, host, observed) {
                    events.push(event);
                }
                report(host, observed);
            },
            |graph, now, episodes| {
                turns.turn(now);
                proceed(graph, now, episodes)
            },
        );
        if let Err(error) = recording.finish(None) {
            self.fail(error.into());
        }
        report
    }

    fn fail(&self, error: anyhow::Error) {
        self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).get_or_insert(error);
    }

    /// Returns the first error.
    pub fn finish(&self) -> Result<()> {
        self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take().map_or(Ok(()), Err)
    }
}

/// Record of a host in real time.
pub struct OfHost {
    recording: Cell<Option<Recording>>,
    inlet: Rc<Inlet>,
    failed: Cell<bool>,
}

impl OfHost {
    /// Creates the record of a host that is to run, `NAME-INCARNATION.mcap`, in the folder of the flag or else of the
    /// team file; `None` if there is neither. `began` is the run's time zero; `files` are the team file and the
    /// policy's file.
    pub fn open(
        flags: &RecordFlags,
        (team, live): (&Team, &LiveHost),
        (began, keyed): (Instant, bool),
        (files, policy): (Vec<PathBuf>, &str),
    ) -> Result<Option<OfHost>> {
        let Some(folder) = flags.record.as_ref().or(team.record.as_ref()) else { return Ok(None) };
        make(folder)?;
        let name = team.deployment.hosts[usize::from(team.host.0)].name.clone();
        let mut identity = Identity::here(arguments(), policy);
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        identity.anchor_ns = wall.saturating_sub(began.elapsed()).as_nanos() as u64;
        let (incarnation, seed, transports) = live.process();
        let path = folder.join(format!("{name}-{incarnation:08x}.mcap"));
        let seed = seed.iter().map(|byte| format!("{byte:02x}")).collect();
        identity.host = Some(HostIdentity { name, id: team.host, incarnation, seed, transports, keyed });
        let variables = std::env::vars_os().map(|(name, value)| (name, value.to_string_lossy().into_owned()));
        let variables = variables.filter_map(|(name, value)| Some((name.into_string().ok()?, value)));
        identity.variables = variables.filter(|(name, _)| name.starts_with("MURMURATE_")).collect();
        let topics = Topics::new(Stage::of(live.plan()), Scope::Host, identity.anchor_ns);
        let beginning = Beginning { identity, attached: attach(files)? };
        let recording = Recording::start(&path, &beginning, topics, WhenFull::Drop)?;
        let inlet = recording.inlet();
        Ok(Some(OfHost { recording: Cell::new(Some(recording)), inlet, failed: Cell::new(false) }))
    }

    /// Takes an event of the present turn.
    pub fn push(&self, host: HostId, event: ProcessEvent) {
        if let Some(event) = Event::of(Scope::Host, host, event) {
            self.inlet.push(event);
        }
    }

    /// Ends a turn of the event loop.
    pub fn turn(&self, now: Time) {
        self.inlet.turn(now);
        if self.inlet.is_abandoned() && !self.failed.replace(true) {
            tracing::error!("the record can no longer be written; the host goes on without it");
        }
    }

    /// Number of events that the record lacks so far.
    pub fn dropped(&self) -> u64 {
        self.inlet.dropped()
    }

    /// Ends the record; later calls do nothing.
    pub fn finish(&self) -> Result<()> {
        let Some(recording) = self.recording.take() else { return Ok(()) };
        recording.finish(Some(FINISH_TIMEOUT))?;
        Ok(())
    }
}
