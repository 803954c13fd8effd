//! Ownership of a laboratory's name on this machine. Everything that a laboratory makes is written down before it is
//! made, so that the next start can remove what a crash has left.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nix::poll::{PollTimeout, poll};
use nix::sys::signal::kill;
use nix::unistd::Pid;
use serde::{Deserialize, Serialize};
use tappers::Tap;

use super::carrier::Warn;
use super::error::{Context, LabError, Result, failed};
use super::namespace;
use crate::file::Laboratory;

/// Folder of the files by which commands find running laboratories.
const FOLDER: &str = "/run/murmurate";
/// Longest time for the kernel to release the lock of a process that was killed. It does so up to 0.1 s after others
/// see the process end.
const RELEASE: Duration = Duration::from_secs(2);

/// Returns the path of a file of a laboratory: its `lock`, the list of what it has `made`, its socket or its log.
pub fn path(name: &str, kind: &str) -> PathBuf {
    PathBuf::from(format!("{FOLDER}/lab-{name}.{kind}"))
}

/// Returns the names under which laboratories run or have left something behind, in alphabetical order.
pub fn names() -> Vec<String> {
    let entries = fs::read_dir(FOLDER).into_iter().flatten().flatten();
    let name = |entry: fs::DirEntry| {
        let file = entry.file_name().into_string().ok()?;
        file.strip_prefix("lab-")?.strip_suffix(".lock").map(str::to_owned)
    };
    let mut names: Vec<String> = entries.filter_map(name).collect();
    names.sort();
    names
}

/// Namespaces and interfaces that a laboratory has made, or is about to make.
#[derive(Serialize, Deserialize)]
struct Made {
    namespaces: Vec<String>,
}

/// Ownership of a laboratory's name. Dropping it removes everything that was made under the name.
pub struct Claim {
    name: String,
    /// Called with a warning if not everything can be removed.
    warn: Warn,
    _lock: File,
}

impl Claim {
    /// Takes the name, and removes what an earlier laboratory of that name has left behind after a crash. Fails if such
    /// a laboratory runs. `warn` is called with a warning if not everything can be removed at the end.
    pub fn take(name: &str, warn: Warn) -> Result<Claim> {
        match Claim::try_take(name, warn)? {
            Some(claim) => {
                claim.clean()?;
                Ok(claim)
            }
            None => Err(LabError::Invalid(format!(
                "the lab '{name}' is up already; remove it with 'murmurate lab down --name {name}', or give the file \
                 another 'name'"
            ))),
        }
    }

    /// Takes the name; `None` if a running laboratory has it. A claim cleans up when it is dropped.
    pub fn try_take(name: &str, warn: Warn) -> Result<Option<Claim>> {
        fs::create_dir_all(FOLDER).with_context(|| format!("cannot make the folder {FOLDER}"))?;
        let lock = path(name, "lock");
        let began = Instant::now();
        loop {
            let file = OpenOptions::new().create(true).truncate(false).write(true).open(&lock);
            let file = file.with_context(|| format!("cannot open '{}'", lock.display()))?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) if owner_has_ended(&lock) && began.elapsed() < RELEASE => {
                    // It ends with a timeout, or a signal.
                    let _ = poll(&mut [], PollTimeout::from(20u16));
                    continue;
                }
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(error)) => {
                    return Err(error).with_context(|| format!("cannot lock '{}'", lock.display()));
                }
            }
            // A laboratory that has just ended removes its file: then this lock is one of a file without a name.
            let own = file.metadata().context("a lock file has no metadata")?.ino();
            if fs::metadata(&lock).is_ok_and(|named| named.ino() == own) {
                let written = file.set_len(0).and_then(|()| write!(&file, "{}", Pid::this()));
                written.with_context(|| format!("cannot write '{}'", lock.display()))?;
                return Ok(Some(Claim { name: name.to_owned(), warn, _lock: file }));
            }
        }
    }

    /// Makes the stations of a laboratory, and returns their TAP interfaces. What is made is written down first.
    pub fn make(&self, lab: &Laboratory) -> Result<Vec<Tap>> {
        let stations = (0..lab.stations).map(|station| lab.namespace(station));
        let namespaces: Vec<String> = stations.chain(lab.cable.map(|_| lab.cable_namespace())).collect();
        if let Some(taken) = namespaces.iter().find(|name| namespace::exists(name)) {
            return failed(format!(
                "there is a network namespace '{taken}' that no lab has made; remove it with 'ip netns del {taken}', \
                 or give the laboratory file another 'name'"
            ));
        }
        let made = Made { namespaces };
        // The file is renamed once it is complete. Only the owner of the laboratory's name writes it.
        let incomplete = path(&self.name, "made.incomplete");
        fs::write(&incomplete, serde_json::to_vec(&made).context("a list is JSON")?)
            .and_then(|()| fs::rename(&incomplete, path(&self.name, "made")))
            .context("cannot write to /run")?;
        made.namespaces.iter().try_for_each(|name| namespace::add(name))?;
        let taps = (0..lab.stations).map(|station| namespace::make_station(lab, station)).collect::<Result<_>>()?;
        if lab.cable.is_some() {
            namespace::make_cable(lab)?;
        }
        Ok(taps)
    }

    /// Returns how many namespaces of this name are left of a laboratory that has crashed.
    pub fn left(&self) -> usize {
        self.made().map_or(0, |made| made.namespaces.iter().filter(|name| namespace::exists(name)).count())
    }

    fn made(&self) -> Option<Made> {
        serde_json::from_slice(&fs::read(path(&self.name, "made")).ok()?).ok()
    }

    /// Removes everything that was made under the name.
    fn clean(&self) -> Result<()> {
        namespace::remove(&self.made().map(|made| made.namespaces).unwrap_or_default())?;
        for kind in ["made", "made.incomplete", "sock"] {
            match fs::remove_file(path(&self.name, kind)) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    return Err(error).with_context(|| format!("cannot remove a file of the lab in {FOLDER}"));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// Returns whether the process that is named in a lock file has ended.
fn owner_has_ended(lock: &Path) -> bool {
    let pid = fs::read_to_string(lock).ok().and_then(|text| text.parse().ok());
    pid.is_some_and(|pid| kill(Pid::from_raw(pid), None).is_err())
}

impl Drop for Claim {
    fn drop(&mut self) {
        if let Err(error) = self.clean() {
            (self.warn)(&format!("warning: not everything of the lab '{}' is removed: {error}", self.name));
            return;
        }
        // The lock itself goes last; whether that works changes nothing for the next start.
        let _ = fs::remove_file(path(&self.name, "lock"));
    }
}
