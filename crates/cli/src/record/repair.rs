//! The command `murmurate record repair`: gives records that were cut or damaged an end, without what is damaged.

use std::io::BufWriter;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::record::chosen::files;
use murmurate::config::shown;
use murmurate_record::reader::{ReadError, Reader};
use murmurate_record::repair::copy;
use murmurate_robot::output::{print, talk};
use murmurate_robot::temporary;
use murmurate_robot::{BadInput, Ended, bad};

/// Flags of `murmurate record repair`.
#[derive(clap::Args)]
pub struct Args {
    /// Records, or folders of records; a whole record is left as it is
    #[arg(required = true, value_name = "FILE|DIR")]
    records: Vec<PathBuf>,
}

/// Runs `record repair`: replaces each record that was cut or damaged by one with an end and an index, which holds
/// everything intact. The original file is kept with the suffix `.cut`. Whole records are left as they are. Returns
/// [`Ended::Unfit`] if something was lost in the middle of a record, or a file could not be used.
pub fn run(args: &Args) -> Result<Ended> {
    let paths = files(&args.records)?;
    let (only, mut sound) = (paths.len() == 1, true);
    for path in paths {
        match mend(&path) {
            Ok(lost_nothing) => sound &= lost_nothing,
            Err(error) if !only && error.is::<BadInput>() => {
                talk(&format!("left out: {error}"));
                sound = false;
            }
            Err(error) => return Err(error),
        }
    }
    Ok(if sound { Ended::Done } else { Ended::Unfit })
}

/// Repairs one file. Returns whether nothing was lost in the middle of it.
fn mend(path: &Path) -> Result<bool> {
    let wrong = |error: ReadError| BadInput(error.to_string());
    let mut reader = Reader::open_one(path).map_err(wrong)?;
    let health = reader.health().clone();
    if health.nothing {
        return Err(wrong(ReadError::Empty { path: path.to_owned(), zeros: health.bytes > 0 }).into());
    }
    if health.is_whole() {
        talk(&format!("'{}' is whole already", path.display()));
        return Ok(true);
    }
    let mut kept = path.as_os_str().to_owned();
    kept.push(".cut");
    let kept = PathBuf::from(kept);
    if kept.symlink_metadata().is_ok() {
        return bad(format!("'{}' is there already: move it away, so that nothing is lost", kept.display()));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let no_room = || format!("cannot write beside '{}'", path.display());
    // As the original, which may be for few.
    let mode = path.metadata().map_or(0o640, |about| about.mode() & 0o666);
    let mut fresh = temporary::file_in(folder, mode).with_context(no_room)?;
    let messages = copy(&mut reader, Vec::new(), BufWriter::new(fresh.as_file_mut()))?;
    fresh.as_file().sync_all().with_context(no_room)?;
    std::fs::hard_link(path, &kept).with_context(|| format!("cannot keep '{}' as it was", path.display()))?;
    fresh.persist(path).map_err(|failed| failed.error).with_context(no_room)?;
    health.faults.iter().for_each(|fault| talk(&format!("'{}': not in it: {fault}", path.display())));
    let (shown_path, kept) = (shown::value(path.display()), shown::value(kept.display()));
    print(&format!("{shown_path}: {}; as it was: {kept}", shown::counted(messages, "message")))?;
    Ok(health.faults.is_empty())
}
