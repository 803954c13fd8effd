//! Outputs of a running host, each with its own background writer: events or a table on stdout, trajectories, and
//! notifications of the service manager. Writing never waits; dropped output is counted by kind.

use std::cell::{Cell, RefCell};
use std::io::{self, Write};
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::Path;
use std::rc::Rc;

use anyhow::{Context, Result, anyhow};
use murmurate::config::shown::{Layout, printable};
use murmurate::results::totals::Step;
use murmurate_report::event::{HostEvent, Unwritten};
use sd_notify::NotifyState;

use crate::BadInput;
use crate::background_writer::{BackgroundWriter, Target};
use crate::output::{FLUSH_TIMEOUT, log_lines_dropped};
use crate::paths::Paths;

/// Outputs of a running host: stdout, the trajectories file, and the service manager. Writing never waits.
pub struct Outlets {
    stdout: BackgroundWriter,
    /// Whether events are printed on stdout, as JSON lines.
    json: bool,
    trajectories: Option<(BackgroundWriter, RefCell<Rows>)>,
    service: Option<BackgroundWriter>,
    events: Cell<u64>,
    steps: Cell<u64>,
}

impl Outlets {
    /// Opens all outputs of a host: stdout, the trajectories file if its path is given, and the service manager's
    /// socket if there is one. If `json` is true, events are printed on stdout. Does not wait for the reader of a pipe.
    pub fn open(json: bool, trajectories: Option<&Path>) -> Result<Outlets> {
        let thread = "cannot start a thread to write";
        let stdout = Target::copy_of(io::stdout()).context("stdout is not open")?;
        let stdout = BackgroundWriter::open(stdout, None).context(thread)?;
        let trajectories = match trajectories {
            None => None,
            Some(path) => {
                let refuse = |e| BadInput(format!("cannot write '{}': {e}", path.display()));
                let target = Target::create(path).map_err(refuse)?;
                // One writer for both, as two threads could mix their lines.
                let same = target.is_same(io::stdout());
                let writer =
                    if same { stdout.clone() } else { BackgroundWriter::open(target, None).context(thread)? };
                Some((writer, RefCell::new(Rows::new()?)))
            }
        };
        let service =
            service_socket().map(|socket| BackgroundWriter::open(Target::Open(OwnedFd::from(socket).into()), None));
        let service = service.transpose().context(thread)?;
        Ok(Outlets { stdout, json, trajectories, service, events: Cell::new(0), steps: Cell::new(0) })
    }

    /// Prints an event as a JSON line on stdout, if the flag `--json` is given; otherwise does nothing.
    pub fn print_event(&self, event: &HostEvent) {
        if self.json && !self.stdout.push((event.to_line() + "\n").into_bytes()) {
            self.events.set(self.events.get() + 1);
        }
    }

    /// Prints the final table of results on stdout.
    pub fn print(&self, table: &str) {
        self.stdout.push(format!("{}\n", printable(table, Layout::Lines)).into_bytes());
    }

    /// Writes a step of the simulation to the trajectories file, if the flag `--trajectories` is given. A step that
    /// cannot be written in time is dropped and counted.
    pub fn step(&self, step: &Step) {
        let Some((writer, rows)) = &self.trajectories else { return };
        if !writer.push(rows.borrow_mut().of(step)) {
            if self.steps.get() == 0 {
                tracing::warn!("steps of the trajectories are dropped: they cannot be written in time, or at all");
            }
            self.steps.set(self.steps.get() + 1);
        }
    }

    /// Sends a notification (`sd_notify`) to the service manager, if it has started this process.
    pub fn notify(&self, state: &NotifyState<'_>) {
        if let Some(writer) = &self.service {
            // A notification that does not fit is dropped. Those for the watchdog are repeated.
            writer.push(format!("{state}\n").into_bytes());
        }
    }

    /// Returns the numbers of log lines, events and steps that were dropped so far, because they could not be written
    /// in time.
    pub fn unwritten(&self) -> Unwritten {
        Unwritten {
            log_lines: log_lines_dropped(),
            events: self.events.get(),
            steps: self.steps.get(),
            record_events: 0,
        }
    }

    /// Returns the error that has ended the output to stdout, such as a full disk, once; `None` otherwise. A pipe that
    /// its reader closed is no error.
    pub fn failure(&self) -> Option<anyhow::Error> {
        self.stdout.failure().map(|error| anyhow!("cannot write to stdout: {error}"))
    }

    /// Waits until queued output is written, at most half a second for each output, logs what was dropped, and returns
    /// the first write error.
    pub fn close(&self) -> Result<()> {
        let others = self.trajectories.iter().map(|(writer, _)| writer).chain(&self.service);
        let writers: Vec<&BackgroundWriter> = std::iter::once(&self.stdout).chain(others).collect();
        for writer in &writers {
            writer.flush(FLUSH_TIMEOUT);
        }
        let dropped: u64 = writers.iter().map(|writer| writer.dropped()).sum();
        if dropped > 0 {
            let Unwritten { log_lines, events, steps, .. } = self.unwritten();
            tracing::warn!(dropped, events, steps, log_lines, "output was dropped: it could not be written in time");
        }
        // A failing trajectories file does not stop the robot, but the error is returned at the end.
        let trajectories = self.trajectories.as_ref().and_then(|(writer, _)| writer.failure());
        match (self.failure(), trajectories) {
            (Some(error), _) => Err(error),
            (None, Some(error)) => Err(anyhow!("cannot write the trajectories: {error}")),
            (None, None) => Ok(()),
        }
    }
}

/// Formats steps as CSV rows of the trajectories file, in memory.
struct Rows {
    paths: Paths<Shared>,
    written: Shared,
}

/// Growing byte buffer that is shared by a CSV writer, which fills it, and its owner, which empties it.
#[derive(Clone, Default)]
struct Shared(Rc<RefCell<Vec<u8>>>);

impl Rows {
    fn new() -> Result<Rows> {
        let written = Shared::default();
        Ok(Rows { paths: Paths::new(written.clone())?, written })
    }

    /// Returns the CSV rows of a step; the first call also returns the header.
    fn of(&mut self, step: &Step) -> Vec<u8> {
        let paths = &mut self.paths;
        paths.write(0, step).and_then(|()| paths.flush()).expect("memory takes everything");
        self.written.0.take()
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns a socket that is connected to the service manager, such as systemd; `None` if no service manager started
/// this process (`sd_notify(3)`).
fn service_socket() -> Option<UnixDatagram> {
    let name = std::env::var_os("NOTIFY_SOCKET")?;
    let address = match name.as_bytes() {
        #[cfg(target_os = "linux")]
        [b'@', name @ ..] => <SocketAddr as std::os::linux::net::SocketAddrExt>::from_abstract_name(name),
        _ => SocketAddr::from_pathname(&name),
    };
    let socket = UnixDatagram::unbound().ok()?;
    socket.connect_addr(&address.ok()?).ok()?;
    Some(socket)
}

#[cfg(test)]
mod tests {
    use murmurate::messages::geometry::{Motion, Vec2};
    use murmurate::messages::ids::RobotId;
    use murmurate::messages::local::{Contacts, Sample};
    use murmurate::messages::wire::Phase;
    use murmurate::time::Time;

    use super::*;

    #[test]
    fn a_full_disk_stops_no_host_and_is_an_error_at_its_end() {
        let outlets = Outlets::open(false, Some(Path::new("/dev/full"))).expect("it is there");
        let sample = Sample {
            robot: RobotId(0),
            time: Time::ZERO,
            motion: Motion::at_rest(Vec2::zeros()),
            heading: 0.0,
            yaw_rate: 0.0,
            command: Vec2::zeros(),
            contacts: Contacts::default(),
        };
        let step =
            Step { episode: 0, phase: Phase::Running, samples: vec![sample], hearing: Vec::new(), sensed: Vec::new() };
        outlets.step(&step);
        outlets.trajectories.as_ref().expect("they are asked for").0.flush(FLUSH_TIMEOUT);
        outlets.step(&step);
        assert_eq!((outlets.unwritten().steps, outlets.failure().is_none()), (1, true));
        let why = outlets.close().expect_err("the disk is full").to_string();
        assert!(why.starts_with("cannot write the trajectories: "), "{why}");
    }
}
