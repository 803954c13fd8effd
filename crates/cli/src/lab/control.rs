//! Commands to a running laboratory: its counters, from its socket, and its end.

use std::io::Read;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::claim::{Claim, path};
use super::needs;
use murmurate::config::shown::counted;
use murmurate_lab::report::LabReport;
use murmurate_robot::output::talk;
use murmurate_robot::{BadInput, Ended};

/// Longest time for a running laboratory to answer.
const ANSWER: Duration = Duration::from_secs(5);
/// Longest time for a laboratory to end after it was asked to; then it is killed.
const END: Duration = Duration::from_secs(10);

/// Returns the counters of a running laboratory.
pub fn report(name: &str) -> Result<LabReport> {
    let down = || match &running()[..] {
        [] => BadInput(format!("no lab '{name}' is up; start it with 'murmurate lab up FILE'")),
        others => BadInput(format!(
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

/// Waits until `source` is readable, at most `ms` \[ms\]. Returns whether it is.
pub fn readable(source: impl AsFd, ms: u64) -> Result<bool> {
    let timeout = PollTimeout::try_from(ms.min(600_000)).unwrap_or(PollTimeout::NONE);
    match poll(&mut [PollFd::new(source.as_fd(), PollFlags::POLLIN)], timeout) {
        Ok(count) => Ok(count > 0),
        Err(Errno::EINTR) => Ok(false),
        Err(error) => Err(anyhow!(error)).context("cannot wait for a socket"),
    }
}

/// Ends a laboratory, and removes what one that has crashed has left.
pub fn down(name: &str) -> Result<Ended> {
    needs::capabilities()?;
    let Some(claim) = Claim::try_take(name)? else {
        let pid = Pid::from_raw(i32::try_from(report(name)?.pid).context("a process has a number")?);
        kill(pid, Signal::SIGTERM).context("cannot ask the lab to end")?;
        let began = Instant::now();
        let mut killed = false;
        loop {
            if let Some(claim) = Claim::try_take(name)? {
                drop(claim);
                talk(&format!("the lab '{name}' is removed"));
                return Ok(Ended::Done);
            }
            if began.elapsed() > END && !killed {
                killed = true;
                kill(pid, Signal::SIGKILL).context("cannot kill the lab")?;
            }
            if began.elapsed() > 2 * END {
                return Err(anyhow!("the lab '{name}' does not end; its process is {pid}"));
            }
            poll(&mut [], PollTimeout::from(20u16)).ok();
        }
    };
    let left = claim.left();
    drop(claim);
    let others = running();
    if left == 0 && !others.is_empty() {
        let why =
            format!("no lab '{name}' is up: nothing was removed; with --name remove one of {}", others.join(", "));
        return Err(BadInput(why).into());
    }
    talk(&match left {
        0 => format!("no lab '{name}' is up"),
        _ => format!("removed: {} that a lab '{name}' had left behind", counted(left, "station")),
    });
    Ok(Ended::Done)
}
