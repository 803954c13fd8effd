//! Writer of a record: the event queue, and the thread that converts the events and writes them to files.

use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use mcap::McapError;

use super::Event;
use super::file::{Beginning, RecordError};
use super::queue::{Inlet, Outlet, WhenFull, queue};
use super::series::{Retention, Series, Triggers};
use super::topics::Topics;

/// Period of flushes in real time. A crash loses up to this, one pause of the writer, and the events still in the
/// queue.
const FLUSH: Duration = Duration::from_millis(170);

/// Record that is being made: its event queue, and the thread that writes its files.
pub struct Recording {
    inlet: Rc<Inlet>,
    /// Disconnected when the thread has closed its last file, or has panicked.
    ended: Receiver<()>,
    path: PathBuf,
    failure: Arc<Mutex<Option<String>>>,
}

impl Recording {
    /// Creates the record's first file, unless only excerpts are stored, and starts the thread that writes. `topics`
    /// converts events to messages; `when_full` says what happens to events when the queue is full, and `retention`
    /// which part of the run is stored.
    pub fn start(
        path: &Path,
        beginning: &Beginning,
        topics: Topics,
        (when_full, retention): (WhenFull, Retention),
    ) -> Result<Recording, RecordError> {
        let series = Series::begin(path, beginning.clone(), topics.stage(), retention)?;
        let (inlet, outlet) = queue(when_full);
        let failure = Arc::new(Mutex::new(None));
        let (running, ended) = channel();
        let failed = Arc::clone(&failure);
        let flush = (when_full == WhenFull::Drop).then_some(FLUSH);
        thread::Builder::new()
            .name("record".to_owned())
            .spawn(move || {
                // Dropped last, in a panic, too.
                let _running: Sender<()> = running;
                let mut series = series;
                let fails = |error: &McapError| {
                    *failed.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = Some(reason(error));
                };
                let served = serve(&mut series, &outlet, topics, flush);
                // Stored before the queue is closed, whose other end then asks for the reason.
                served.as_ref().err().map(fails);
                drop(outlet);
                match served {
                    Ok(()) => drop(series.finish().map_err(|error| fails(&error))),
                    Err(_) => series.salvage(),
                }
            })
            .map_err(|error| RecordError::Create { path: path.to_owned(), error })?;
        Ok(Recording { inlet: Rc::new(inlet), ended, path: path.to_owned(), failure })
    }

    /// Returns the sending end of the record's event queue, for the thread that runs the actors.
    pub fn inlet(&self) -> Rc<Inlet> {
        Rc::clone(&self.inlet)
    }

    /// Returns the reason why the record can no longer be written; `None` while it can.
    pub fn failure(&self) -> Option<RecordError> {
        let reason = self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).clone()?;
        Some(RecordError::Write { path: self.path.clone(), reason })
    }

    /// Ends the record and waits until it is written, for at most `most` if that is not `None`. Returns the number of
    /// events that were dropped. An error says that the record is incomplete.
    pub fn finish(self, most: Option<Duration>) -> Result<u64, RecordError> {
        self.inlet.close();
        if let Some(most) = most
            && self.ended.recv_timeout(most) == Err(RecvTimeoutError::Timeout)
        {
            let reason = format!("its disk has taken more than {} s", most.as_secs_f64());
            return Err(RecordError::Write { path: self.path, reason });
        }
        // Nothing is ever sent.
        let _ = self.ended.recv();
        match self.failure() {
            Some(error) => Err(error),
            None => Ok(self.inlet.dropped()),
        }
    }
}

/// Returns the text of an error; of an I/O error, that of the operating system.
fn reason(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

/// Writes the events from the queue until its other end is closed.
fn serve(series: &mut Series, outlet: &Outlet, mut topics: Topics, flush: Option<Duration>) -> Result<(), McapError> {
    let (mut taken, mut instant) = (Vec::new(), Vec::new());
    let (mut flushed, mut written) = (Instant::now(), false);
    let (mut triggers, mut happens) = (Triggers::default(), false);
    while outlet.take(&mut taken) {
        for event in taken.drain(..) {
            let Event::Turn(now) = event else {
                happens |= triggers.sees(&event);
                instant.push(event);
                continue;
            };
            let at = topics.time_of(now);
            if std::mem::take(&mut happens) {
                series.keep(at)?;
            }
            let mut result = Ok(());
            topics.instant(now, &instant, &mut |topic, at, data| {
                if result.is_ok() {
                    result = series.write(topic, at, data);
                }
            });
            result?;
            instant.clear();
            series.end_instant(at)?;
            written = true;
        }
        if flush.is_some_and(|period| written && flushed.elapsed() >= period) {
            series.flush()?;
            (flushed, written) = (Instant::now(), false);
        }
    }
    Ok(())
}
