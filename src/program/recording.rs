//! Recording of runs: the flag `--record`, names of record files, and their identity and attachments.

use std::cell::Cell;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Result;

use crate::deploy::team::Team;
use crate::graph::process::{Graph, ProcessEvent};
use crate::live::LiveHost;
use crate::messages::ids::HostId;
use crate::program::output::read_bytes;
use crate::program::{BadInput, bad};
use crate::record::file::{Attached, Beginning};
use crate::record::identity::{HostIdentity, Identity};
use crate::record::queue::{Inlet, WhenFull};
use crate::record::series::Retention;
use crate::record::topics::{Stage, Topics};
use crate::record::writer::Recording;
use crate::record::{Event, Scope};
use crate::time::{Span, Time};

/// Time that the end of a host waits for the writer of its record.
const FINISH_TIMEOUT: Duration = Duration::from_millis(1500);

/// Flag for records.
#[derive(clap::Args, Clone, Default)]
pub struct RecordFlags {
    /// Folder for records of the run (MCAP): to look at, to replay, to hand on (docs/record.md)
    #[arg(long, value_name = "DIR")]
    pub record: Option<PathBuf>,
    /// Keeps only this time before and after an emergency stop, an aborted episode, or the signal USR1 to the host
    #[arg(long, value_name = "SECONDS")]
    pub record_last: Option<f64>,
    /// Begins another file of the record after this size
    #[arg(long, value_name = "MB")]
    pub record_size: Option<f64>,
}

impl RecordFlags {
    /// Returns how much of a run is recorded: the time around events, and the size of a file, from the flags or else
    /// from `last_s` \[s\] and `size_mb` \[MB\], which are fields of the team file. An error names the flag.
    fn retention(&self, last_s: Option<f64>, size_mb: Option<f64>) -> Result<Retention> {
        let (last_s, size_mb) = (self.record_last.or(last_s), self.record_size.or(size_mb));
        match (last_s, size_mb) {
            (Some(last_s), _) if !(1.0..=3600.0).contains(&last_s) => {
                bad(format!("--record-last: {last_s} s is not 1 to 3600 s"))
            }
            (_, Some(size_mb)) if !(1.0..=1e6).contains(&size_mb) => {
                bad(format!("--record-size: {size_mb} MB is not 1 to 1000000 MB"))
            }
            _ => Ok(Retention {
                last: last_s.map(Span::from_secs),
                most_bytes: size_mb.map(|size_mb| (size_mb * 1e6) as u64),
            }),
        }
    }

    /// Fails if a flag of a record is given without a folder for it.
    fn refuse_without_folder(&self) -> Result<()> {
        let given = [("--record-last", self.record_last.is_some()), ("--record-size", self.record_size.is_some())];
        match given.iter().find(|(_, given)| *given) {
            Some((flag, _)) => bad(format!("{flag}: there is no record; add --record DIR")),
            None => Ok(()),
        }
    }

    /// Returns the flags of records as arguments for another process.
    pub fn arguments(&self) -> Vec<OsString> {
        let last = self.record_last.map(|last_s| ("--record-last", OsString::from(last_s.to_string())));
        let size = self.record_size.map(|size_mb| ("--record-size", OsString::from(size_mb.to_string())));
        let folder = self.record.clone().map(|folder| ("--record", OsString::from(folder)));
        [folder, last, size].into_iter().flatten().flat_map(|(flag, value)| [flag.into(), value]).collect()
    }
}

/// Flags with a value that do not affect the run.
const OUTPUTS: [&str; 12] = [
    "--record",
    "--record-last",
    "--record-size",
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
/// Flags without a value that do not affect the run.
const SWITCHES: [&str; 5] = ["--json", "--quiet", "--launched", "--watch", "--control"];

/// Returns the arguments of this command without those that do not affect the run, so that equal runs have equal
/// records.
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

/// Creates the folder of records.
fn make(folder: &Path) -> Result<()> {
    let refuse = |error| BadInput(format!("--record: cannot make the folder '{}': {error}", folder.display()));
    std::fs::create_dir_all(folder).map_err(refuse)?;
    Ok(())
}

/// Reads the files to attach to a record. Names that are not files are ignored.
fn attach(names: impl IntoIterator<Item = PathBuf>) -> Result<Vec<Attached>> {
    let files = names.into_iter().filter(|name| name.is_file());
    let attached = files.map(|path| {
        let name = path.to_string_lossy().into_owned();
        let media_type = if name.ends_with(".toml") { "application/toml" } else { "application/octet-stream" };
        Ok(Attached { content: read_bytes(&path, "file")?, name, media_type })
    });
    attached.collect()
}

/// Recording of the repeats of a simulation, one file each.
#[cfg(feature = "sim")]
pub struct Simulated {
    folder: PathBuf,
    beginning: Beginning,
    retention: Retention,
    failure: Mutex<Option<anyhow::Error>>,
}

#[cfg(feature = "sim")]
impl Simulated {
    /// Prepares the folder of the records; `None` if no folder is given. `files` are the files named by flags, and
    /// `policy` is the digest of the policy's file. A folder with a record of another run is an error.
    pub fn open(flags: &RecordFlags, files: Vec<PathBuf>, policy: &str, repeats: u32) -> Result<Option<Simulated>> {
        let Some(folder) = &flags.record else { return flags.refuse_without_folder().map(|()| None) };
        let retention = flags.retention(None, None)?;
        make(folder)?;
        let taken = (0..repeats).map(|repeat| Simulated::path(folder, repeat)).find(|path| path.exists());
        if let Some(path) = taken {
            let why = format!("--record: '{}' is there already; name another folder", path.display());
            return Err(BadInput(why).into());
        }
        let beginning = Beginning { identity: Identity::here(arguments(), policy), attached: attach(files)? };
        Ok(Some(Simulated { folder: folder.to_owned(), beginning, retention, failure: Mutex::default() }))
    }

    fn path(folder: &Path, repeat: u32) -> PathBuf {
        folder.join(format!("repeat-{repeat:04}.mcap"))
    }

    /// Runs a trial and records it.
    pub fn run(
        &self,
        trial: &crate::trial::Trial,
        mut proceed: impl FnMut(&[crate::report::episode::Episode]) -> crate::trial::Proceed,
    ) -> crate::trial::TrialReport {
        self.run_observed(trial, |_, _| {}, |_, _, episodes| proceed(episodes))
    }

    /// Runs a trial and records it, with callbacks as `Trial::run_observed` has.
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
        let recording = match Recording::start(&path, &beginning, topics, (WhenFull::Wait, self.retention)) {
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

    /// Returns the first error of any recording.
    pub fn finish(&self) -> Result<()> {
        self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take().map_or(Ok(()), Err)
    }
}

/// Recording of a host in real time.
pub struct OfHost {
    recording: Cell<Option<Recording>>,
    inlet: Rc<Inlet>,
    failed: Cell<bool>,
}

impl OfHost {
    /// Creates the record `NAME-INCARNATION.mcap` of a host, in the folder of the flag or else of the team file; `None`
    /// if neither names one. `began` is the run's time zero; `files` are the team file and the policy's file, `policy`
    /// is the digest of the latter.
    pub fn open(
        flags: &RecordFlags,
        (team, live): (&Team, &LiveHost),
        (began, keyed): (Instant, bool),
        (files, policy): (Vec<PathBuf>, &str),
    ) -> Result<Option<OfHost>> {
        let Some(folder) = flags.record.as_ref().or(team.record.as_ref()) else {
            return flags.refuse_without_folder().map(|()| None);
        };
        let retention = flags.retention(team.record_last_s, team.record_size_mb)?;
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
        let recording = Recording::start(&path, &beginning, topics, (WhenFull::Drop, retention))?;
        let inlet = recording.inlet();
        Ok(Some(OfHost { recording: Cell::new(Some(recording)), inlet, failed: Cell::new(false) }))
    }

    /// Adds an event of the current turn.
    pub fn push(&self, host: HostId, event: ProcessEvent) {
        if let Some(event) = Event::of(Scope::Host, host, event) {
            self.inlet.push(event);
        }
    }

    /// Keeps the events of the last seconds and the next ones, if the record keeps events only on request.
    pub fn keep(&self) {
        self.inlet.push(Event::Keep);
    }

    /// Marks the end of a turn of the event loop, at time `now`.
    pub fn turn(&self, now: Time) {
        self.inlet.turn(now);
        if self.inlet.is_abandoned() && !self.failed.replace(true) {
            tracing::error!("the record can no longer be written; the host goes on without it");
        }
    }

    /// Number of events dropped so far.
    pub fn dropped(&self) -> u64 {
        self.inlet.dropped()
    }

    /// Ends the record. Later calls do nothing.
    pub fn finish(&self) -> Result<()> {
        let Some(recording) = self.recording.take() else { return Ok(()) };
        recording.finish(Some(FINISH_TIMEOUT))?;
        Ok(())
    }
}
