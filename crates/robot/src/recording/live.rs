//! Recording in real time: the record of a host, and the record of what an operator receives.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Result;
use data_encoding::HEXLOWER;

use super::wifi::Samples;
use super::{RecordFlags, arguments, attach, log, make};
use murmurate::deploy::team::Team;
use murmurate::graph::event;
use murmurate::live::LiveHost;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::key::Key;
use murmurate::time::Time;
use murmurate_record::file::Beginning;
use murmurate_record::identity::{HostIdentity, Identity};
use murmurate_record::queue::{Inlet, WhenFull};
use murmurate_record::series::Retention;
use murmurate_record::topics::{Stage, Topics};
use murmurate_record::writer::Recording;
use murmurate_record::{Event, Scope};

/// Largest size of a value of a sense in the inputs of a host, as text of a program and as a message of others
/// \[bytes\], and number of measurements a second for which a record has room.
const SENSED_BYTES: usize = 33;
const SENSED_PER_S: usize = 50;

/// Longest time that a process waits at its end until its record is written.
const FINISH_TIMEOUT: Duration = Duration::from_millis(1500);

/// Record of a running process (host or operator) that is being written in real time. A thread of its own writes it.
pub struct LiveRecord {
    scope: Scope,
    recording: Cell<Option<Recording>>,
    inlet: Rc<Inlet>,
    failed: Cell<bool>,
    /// Sampler of the host's Wi-Fi cards; `None` without one.
    samples: Option<Samples>,
}

impl LiveRecord {
    /// Starts the record `NAME-INCARNATION.mcap` of a host, in the folder of the flag `--record`, or otherwise of the
    /// team file; returns `None` if neither names a folder. `began` is the time at which the run began, and `key` is
    /// that of the host, of which the record says only whether there is one, and which roster is in force. `files` are
    /// the team file and the policy file, which are attached; `policy` is the digest of the policy file.
    pub fn of_host(
        flags: &RecordFlags,
        (team, live): (&Team, &LiveHost),
        (began, key): (Instant, Option<&Key>),
        (files, policy): (Vec<PathBuf>, &str),
    ) -> Result<Option<LiveRecord>> {
        let Some(folder) = flags.record.as_ref().or(team.record.as_ref()) else {
            return flags.refuse_without_folder().map(|()| None);
        };
        let retention = flags.retention(team.record_last_s, team.record_size_mb)?;
        let name = team.deployment.hosts[usize::from(team.host.0)].name.clone();
        let mut identity = here(began, policy);
        identity.engine = live.trial().models.engine();
        let (incarnation, seed, transports) = live.process();
        let file = format!("{name}-{incarnation:08x}");
        let seed = HEXLOWER.encode(&seed);
        let (keyed, signed) = (key.is_some(), key.is_some_and(|key| key.signatures().is_some()));
        let roster = key.and_then(Key::sealed_roster).map_or_else(String::new, |sealed| HEXLOWER.encode(sealed));
        identity.host =
            Some(HostIdentity { name, id: team.host, incarnation, seed, transports, keyed, signed, roster });
        let beginning = Beginning { identity, attached: attach(files)? };
        let stage = Stage::of(live.trial());
        let mut record = LiveRecord::start((folder, &file), Scope::Host, (beginning, stage), retention)?;
        let places = team.links.iter().flatten();
        let interfaces = places.filter_map(|place| place.endpoint.interface().map(str::to_owned)).collect();
        record.samples = Samples::start(interfaces, murmurate_wifi::look);
        let trial = live.trial();
        let heard: f64 = trial.budgets().iter().map(|budget| budget.needs_bit_s / 8.0).sum();
        // A worker's answers have all floats of its robots' messages.
        let (features, period) = (trial.models.features(), trial.models.period());
        let answered = 4.0 * (trial.deployment.robots * features) as f64 / period.as_secs();
        let sensed = SENSED_BYTES * SENSED_PER_S * trial.sensed_values();
        record.inlet.expect((3.0 * heard + 1.5 * answered) as usize + sensed);
        Ok(Some(record))
    }

    /// Starts the record `operator-INCARNATION.mcap` of an operator, in the folder of the flag `--record`; returns
    /// `None` without that flag. `stage` has the team's hosts, robots, ground and walls. `began` is the time at
    /// which the run began; `files` is the team file, which is attached.
    #[cfg(feature = "watch")]
    pub fn of_operator(
        flags: &RecordFlags,
        (incarnation, stage): (u32, Stage),
        began: Instant,
        files: Vec<PathBuf>,
    ) -> Result<Option<LiveRecord>> {
        let Some(folder) = &flags.record else { return flags.refuse_without_folder().map(|()| None) };
        let retention = flags.retention(None, None)?;
        let mut identity = here(began, "");
        identity.operator = true;
        let beginning = Beginning { identity, attached: attach(files)? };
        let file = format!("operator-{incarnation:08x}");
        LiveRecord::start((folder, &file), Scope::Operator, (beginning, stage), retention).map(Some)
    }

    fn start(
        (folder, file): (&Path, &str),
        scope: Scope,
        (beginning, stage): (Beginning, Stage),
        retention: Retention,
    ) -> Result<LiveRecord> {
        make(folder)?;
        let topics = Topics::new(stage, scope, beginning.identity.anchor_ns);
        let path = folder.join(format!("{file}.mcap"));
        let recording = Recording::start(&path, &beginning, topics, (WhenFull::Drop, retention))?;
        let inlet = recording.inlet();
        log::collect(true);
        Ok(LiveRecord { scope, recording: Cell::new(Some(recording)), inlet, failed: Cell::new(false), samples: None })
    }

    /// Adds an event of the host `host` to the record. It belongs to the current turn of the event loop.
    pub fn push(&self, host: HostId, event: event::Event) {
        if let Some(event) = Event::of(self.scope, host, event) {
            self.inlet.push(event);
        }
    }

    /// Requests that the record keeps the events of the last seconds and of the next ones. Only a record of excerpts
    /// (`--record-last`) needs this; others keep everything.
    pub fn keep(&self) {
        self.inlet.push(Event::Keep);
    }

    /// Marks the end of a turn of the event loop (one pass over all pending inputs), at the time `now`, in the record.
    /// Adds the lines that the program has logged since the last turn, and the samples of Wi-Fi. `steps` is the number
    /// of things that the host's actors have done so far; `None` if it is not known.
    pub fn turn(&self, now: Time, steps: Option<u64>) {
        log::take(|line| self.inlet.push(Event::Logged(line)));
        self.samples.iter().for_each(|samples| samples.take(|sample| self.inlet.push(Event::Wifi(Box::new(sample)))));
        match steps {
            Some(steps) => self.inlet.turn_of(now, steps),
            None => self.inlet.turn(now),
        }
        if self.inlet.is_abandoned() && !self.failed.replace(true) {
            let recording = self.recording.take();
            let why = recording.as_ref().and_then(Recording::failure).map(|why| format!(": {why}"));
            self.recording.set(recording);
            let why = why.unwrap_or_default();
            tracing::error!("the record can no longer be written, and this goes on without it{why}");
        }
    }

    /// Returns the number of events that the record lacks so far, because they could not be written in time.
    pub fn dropped(&self) -> u64 {
        self.inlet.dropped()
    }

    /// Ends the record and waits until it is written, at most 1.5 s. Later calls do nothing.
    pub fn finish(&self) -> Result<()> {
        let Some(recording) = self.recording.take() else { return Ok(()) };
        log::collect(false);
        recording.finish(Some(FINISH_TIMEOUT))?;
        Ok(())
    }
}

/// Returns the [`Identity`] for the record of this process, whose run began at `began`. `policy` is the digest of the
/// policy's file.
fn here(began: Instant, policy: &str) -> Identity {
    let mut identity = Identity::here(crate::build::digest(), arguments(), policy);
    let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    identity.anchor_ns = wall.saturating_sub(began.elapsed()).as_nanos() as u64;
    let variables = std::env::vars_os().map(|(name, value)| (name, value.to_string_lossy().into_owned()));
    let variables = variables.filter_map(|(name, value)| Some((name.into_string().ok()?, value)));
    identity.variables = variables.filter(|(name, _)| name.starts_with("MURMURATE_")).collect();
    identity
}
