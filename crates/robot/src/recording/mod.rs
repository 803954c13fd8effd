//! Recording of runs: the flags `--record`, `--record-last` and `--record-size`, and the arguments and files that go
//! into a record.

mod live;
pub mod log;
mod wifi;

pub use self::live::LiveRecord;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::destination::check_folder;
use crate::output::read_bytes;
use crate::policy;
use crate::{BadInput, bad};
use murmurate::time::Span;
use murmurate_record::file::Attached;
use murmurate_record::series::Retention;

/// Flags for the record of a run: `--record`, `--record-last` and `--record-size`.
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
    /// Returns how much of a run is kept in its record: the time around events, and the largest size of a file. Both
    /// are from the flags, or else from `last_s` \[s\] and `size_mb` \[MB\], which are fields of the team file; `None`
    /// if neither gives them. An error names the flag.
    pub fn retention(&self, last_s: Option<f64>, size_mb: Option<f64>) -> Result<Retention> {
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

    /// Fails if `--record-last` or `--record-size` is given. Called if no folder for a record is given.
    pub fn refuse_without_folder(&self) -> Result<()> {
        let given = [("--record-last", self.record_last.is_some()), ("--record-size", self.record_size.is_some())];
        match given.iter().find(|(_, given)| *given) {
            Some((flag, _)) => bad(format!("{flag}: there is no record; add --record DIR")),
            None => Ok(()),
        }
    }

    /// Returns these flags as command-line arguments, for another process of this program.
    pub fn arguments(&self) -> Vec<OsString> {
        let last = self.record_last.map(|last_s| ("--record-last", OsString::from(last_s.to_string())));
        let size = self.record_size.map(|size_mb| ("--record-size", OsString::from(size_mb.to_string())));
        let folder = self.record.clone().map(|folder| ("--record", OsString::from(folder)));
        [folder, last, size].into_iter().flatten().flat_map(|(flag, value)| [flag.into(), value]).collect()
    }
}

/// Flags with a value that do not affect what happens in the run; they are left out of a record's arguments.
const OUTPUTS: [&str; 14] = [
    "--out",
    "--shard",
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
/// Flags without a value that do not affect what happens in the run; they are left out of a record's arguments.
const SWITCHES: [&str; 5] = ["--json", "--quiet", "--launched", "--watch", "--control"];

/// Returns the command-line arguments of this process without those that do not affect the run, so that equal runs have
/// equal records.
pub fn arguments() -> Vec<String> {
    let all = crate::own_arguments().into_iter().map(|argument| argument.to_string_lossy().into_owned());
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

/// Creates the folder for records, if it does not exist. An error names the flag `--record`.
pub fn make(folder: &Path) -> Result<()> {
    let refuse = |error| BadInput(format!("--record: cannot make the folder '{}': {error}", folder.display()));
    check_folder(folder).map_err(refuse)?;
    std::fs::create_dir_all(folder).map_err(|error| refuse(error.to_string()))?;
    Ok(())
}

/// Reads the files to attach to a record, and after them the graphs of those that are contracts of policies. Paths that
/// are not files, such as names of built-in policies, are ignored.
pub fn attach(names: impl IntoIterator<Item = PathBuf>) -> Result<Vec<Attached>> {
    let mut files: Vec<PathBuf> = names.into_iter().filter(|name| name.is_file()).collect();
    let graphs: Vec<PathBuf> = files.iter().flat_map(|file| policy::onnx::graphs(file)).collect();
    files.extend(graphs);
    let attached = files.into_iter().map(|path| {
        let name = path.to_string_lossy().into_owned();
        let media_type = if name.ends_with(".toml") { "application/toml" } else { "application/octet-stream" };
        Ok(Attached { content: read_bytes(&path, "file")?, name, media_type })
    });
    attached.collect()
}
