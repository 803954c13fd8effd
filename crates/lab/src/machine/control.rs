//! Commands to a running laboratory: its counters, from its socket, and its end.

use std::io::Read;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use nix::poll::{PollTimeout, poll};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::carrier::Warn;
use super::claim::{Claim, path};
use super::error::{Context, LabError, Result, failed};
use super::needs;
use crate::report::LabReport;

/// Longest time for a running laboratory to answer.
const ANSWER: Duration = Duration::from_secs(5);
/// Longest time for a laboratory to end after it was asked to; then it is killed.
const END: Duration = Duration::from_secs(10);

/// Returns the counters of a running laboratory.
pub fn report(name: &str) -> Result<LabReport> {
    let down = || match &running()[..] {
        [] => LabError::Invalid(format!("no lab '{name}' is up; start it with 'murmurate lab up FILE'")),
        others => LabError::Invalid(format!(
            "no lab '{name}' is up; start it with 'murmurate lab up FILE', or name one that is up: {}",
            others.join(", ")
        )),
    };
    let mut stream = UnixStream::connect(path(name, "sock")).map_err(|_| down())?;
    stream.set_read_timeout(Some(ANSWER)).context("cannot set a time limit")?;
    let mut text = String::new();
    stream.read_to_string(&mut text).with_context(|| format!("the lab '{name}' does not answer"))?;
    serde_json::from_str(&text).with_context(|| format!("the lab '{name}' is of another version of this program"))
}

/// Returns the names of the laboratories that run on this machine, in quotes.
fn running() -> Vec<String> {
    let mut names = super::claim::names();
    names.retain(|name| UnixStream::connect(path(name, "sock")).is_ok());
    names.iter().map(|name| format!("'{name}'")).collect()
}

/// Result of [`down`]: what was removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Removed {
    /// A laboratory that ran, with all that it had made.
    Running,
    /// This number of stations that a crashed laboratory had left behind; 0 if there was nothing of that name.
    Left(usize),
}

/// Ends a laboratory, or removes what a crashed one has left behind. `warn` is called with a warning if not everything
/// can be removed.
pub fn down(name: &str, warn: Warn) -> Result<Removed> {
    needs::capabilities()?;
    let Some(claim) = Claim::try_take(name, warn)? else { return end(name, warn).map(|()| Removed::Running) };
    let left = claim.left();
    drop(claim);
    let others = running();
    if left == 0 && !others.is_empty() {
        let why =
            format!("no lab '{name}' is up: nothing was removed; with --name remove one of {}", others.join(", "));
        return Err(LabError::Invalid(why));
    }
    Ok(Removed::Left(left))
}

/// Asks a laboratory that runs to end, kills it if it does not, and removes what it has made.
fn end(name: &str, warn: Warn) -> Result<()> {
    let pid = Pid::from_raw(i32::try_from(report(name)?.pid).context("a process has a number")?);
    kill(pid, Signal::SIGTERM).context("cannot ask the lab to end")?;
    let began = Instant::now();
    let mut killed = false;
    loop {
        if let Some(claim) = Claim::try_take(name, warn)? {
            drop(claim);
            return Ok(());
        }
        if began.elapsed() > END && !killed {
            killed = true;
            kill(pid, Signal::SIGKILL).context("cannot kill the lab")?;
        }
        if began.elapsed() > 2 * END {
            return failed(format!("the lab '{name}' does not end; its process is {pid}"));
        }
        poll(&mut [], PollTimeout::from(20u16)).ok();
    }
}
