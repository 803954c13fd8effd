//! A laboratory that runs on a thread of this process, for as long as a command needs it.

use std::os::unix::net::UnixStream;
use std::thread::{self, JoinHandle};

use super::carrier::{CaptureWriter, Carrier, Outside, Warn};
use super::claim::Claim;
use super::error::{Context, Result};
use crate::file::Laboratory;
use crate::report::LabReport;

/// Running laboratory of this process. Dropping it removes everything that it made.
pub struct Running {
    /// The laboratory when it began: names and addresses of its stations.
    pub about: LabReport,
    // Dropped in this order: the thread's end is asked for and awaited before the stations are removed.
    thread: Option<(UnixStream, JoinHandle<Result<LabReport>>)>,
    _claim: Claim,
}

impl Running {
    /// Makes the stations of a laboratory, and carries their frames from now on. Transmissions are captured by
    /// `capture`, if there is one, and `warn` is called with warnings.
    pub fn start(lab: &Laboratory, capture: Option<Box<dyn CaptureWriter>>, warn: Warn) -> Result<Running> {
        let claim = Claim::take(&lab.name, warn)?;
        let carrier = Carrier::new(lab, claim.make(lab)?, capture, warn);
        let about = carrier.report();
        let (stop, stopped) = UnixStream::pair().context("cannot make a pipe")?;
        let thread = thread::Builder::new().name("lab".to_owned());
        let thread = thread.spawn(move || carrier.carry(&Outside { control: None, stop: &stopped }));
        let thread = Some((stop, thread.context("cannot start a thread")?));
        Ok(Running { about, thread, _claim: claim })
    }

    /// Ends the laboratory, removes everything that it made, and returns its final counters.
    pub fn end(mut self) -> Result<LabReport> {
        self.join().expect("it ends once")
    }

    fn join(&mut self) -> Option<Result<LabReport>> {
        let (stop, thread) = self.thread.take()?;
        drop(stop);
        Some(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // The counters are not asked for.
        if !thread::panicking() {
            self.join();
        }
    }
}
