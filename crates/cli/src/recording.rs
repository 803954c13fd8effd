//! Writes the records of simulations: one record for each trial.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::Result;

use murmurate::graph::event;
use murmurate::graph::process::Graph;
use murmurate::messages::ids::HostId;
use murmurate::report::TrialReport;
use murmurate::results::episode::Episode;
use murmurate::simulate::Proceed;
use murmurate::time::Time;
use murmurate::trial::Trial;
use murmurate_record::file::Beginning;
use murmurate_record::identity::{Identity, StudyJob};
use murmurate_record::queue::WhenFull;
use murmurate_record::series::{self, Retention};
use murmurate_record::topics::{Stage, Topics};
use murmurate_record::writer::Recording;
use murmurate_record::{Event, Scope};
use murmurate_robot::BadInput;
use murmurate_robot::recording::{RecordFlags, arguments, attach, make};

/// Records of the simulated trials of a command (`sim` or `study`): one file or series of files for each trial, in one
/// folder.
pub struct Simulated {
    folder: PathBuf,
    beginning: Beginning,
    retention: Retention,
    failure: Mutex<Option<anyhow::Error>>,
}

/// Description of one trial that is recorded: name of its record, policy, and place in a study.
#[derive(Clone)]
pub struct Recorded {
    /// Name of the record's file, without `.mcap`.
    pub name: String,
    /// Digest of the policy's file; empty for scripted navigation.
    pub policy: String,
    /// Column and policy of the trial in a study; `None` for a trial of `sim`.
    pub job: Option<StudyJob>,
}

impl Recorded {
    /// Returns the description of a trial of `sim`. Its record is named after the repeat, such as `repeat-0003`.
    pub fn repeat(trial: &Trial) -> Recorded {
        let name = format!("repeat-{:04}", trial.repeat);
        Recorded { name, policy: trial.models.digest(), job: None }
    }
}

impl Simulated {
    /// Creates the folder for the records of all trials; returns `None` if the flag `--record` is not given. `files`
    /// are the files that flags name, which are attached to each record. `names` are the names of all records to be
    /// written; fails if one of them exists already.
    pub fn open(
        flags: &RecordFlags,
        files: Vec<PathBuf>,
        names: impl IntoIterator<Item = String>,
    ) -> Result<Option<Simulated>> {
        let Some(folder) = &flags.record else { return flags.refuse_without_folder().map(|()| None) };
        let retention = flags.retention(None, None)?;
        make(folder)?;
        let taken = names.into_iter().map(|name| Simulated::path(folder, &name)).find(|path| path.exists());
        if let Some(path) = taken {
            let why = format!("--record: '{}' is there already; name another folder", path.display());
            return Err(BadInput(why).into());
        }
        let beginning = Beginning {
            identity: Identity::here(murmurate_robot::build::digest(), arguments(), ""),
            attached: attach(files)?,
        };
        Ok(Some(Simulated { folder: folder.to_owned(), beginning, retention, failure: Mutex::default() }))
    }

    fn path(folder: &Path, name: &str) -> PathBuf {
        folder.join(format!("{name}.mcap"))
    }

    /// Runs a trial while its record is written, and returns its report. `proceed` is called with the episodes finished
    /// so far, and says whether the trial goes on. A write error is kept for the method `finish`. If the record cannot
    /// be started, the trial is not run and the report is empty.
    pub fn run(
        &self,
        (recorded, trial): (&Recorded, &Trial),
        mut proceed: impl FnMut(&[Episode]) -> Proceed,
    ) -> TrialReport {
        self.run_observed((recorded, trial), |_, _, _| {}, |_, _, episodes| proceed(episodes))
    }

    /// Runs a trial while its record, described by `recorded`, is written, and returns the trial's report. `report` is
    /// called with each event of a host. `proceed` is called after each event of the event queue, with the actor graph,
    /// the virtual time and the episodes finished so far, and says whether the trial goes on. A write error is kept for
    /// the method `finish`. If the record cannot be started, the trial is not run and its report is empty.
    pub fn run_observed(
        &self,
        (recorded, trial): (&Recorded, &Trial),
        report: impl Fn(Time, HostId, event::Event) + 'static,
        mut proceed: impl FnMut(&Graph, Time, &[Episode]) -> Proceed,
    ) -> TrialReport {
        let mut beginning = self.beginning.clone();
        let identity = &mut beginning.identity;
        (identity.repeat, identity.policy, identity.job) = (trial.repeat, recorded.policy.clone(), recorded.job);
        identity.engine = trial.models.engine();
        let topics = Topics::new(Stage::of(trial), Scope::Simulation, 0);
        let path = Simulated::path(&self.folder, &recorded.name);
        let recording = match Recording::start(&path, &beginning, topics, (WhenFull::Wait, self.retention)) {
            Ok(recording) => recording,
            Err(error) => {
                self.fail(error.into());
                return TrialReport::default();
            }
        };
        let (events, turns) = (recording.inlet(), recording.inlet());
        let report = trial.run_observed(
            move |now, host, observed| {
                if let Some(event) = Event::of(Scope::Simulation, host, observed) {
                    events.push(event);
                }
                report(now, host, observed);
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

    /// Deletes the record of a trial that was interrupted, because the command runs that trial again from its
    /// beginning.
    pub fn discard(&self, recorded: &Recorded) {
        let path = Simulated::path(&self.folder, &recorded.name);
        // A file that cannot be deleted stays, and the next run names it.
        let parts = (0..).map(|part| series::part_of(&path, part)).take_while(|file| file.exists());
        parts.for_each(|file| drop(std::fs::remove_file(file)));
    }

    fn fail(&self, error: anyhow::Error) {
        self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).get_or_insert(error);
    }

    /// Returns the first error that occurred in writing a record of any trial, if there was one.
    pub fn finish(&self) -> Result<()> {
        self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take().map_or(Ok(()), Err)
    }
}
