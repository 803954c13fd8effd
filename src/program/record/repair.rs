//! The command `murmurate record repair`: repairs records that a crash has cut.

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::program::output::{print, talk};
use crate::program::replay::files;
use crate::program::temporary::Temporary;
use crate::program::{BadInput, Ended};
use crate::record::reader::Reader;
use crate::record::repair::repair;

/// Flags of `murmurate record repair`.
#[derive(clap::Args)]
pub struct Args {
    /// Records, or folders of records; a whole record is left as it is
    #[arg(required = true, value_name = "FILE|DIR")]
    records: Vec<PathBuf>,
}

/// Runs `record repair`: replaces each record that a crash has cut by one with an end and an index. The original file
/// is kept with the suffix `.cut`. Complete records are left as they are.
pub fn run(args: &Args) -> Result<Ended> {
    for path in files(&args.records)? {
        mend(&path)?;
    }
    Ok(Ended::Done)
}

fn mend(path: &Path) -> Result<()> {
    let wrong = |error: crate::record::reader::ReadError| BadInput(error.to_string());
    let mut reader = Reader::open(path).map_err(wrong)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let no_room = || format!("cannot write beside '{}'", path.display());
    let mut fresh = Temporary::new_in(folder, 0o666).with_context(no_room)?;
    let found = repair(&mut reader, BufWriter::new(fresh.seekable()))?;
    if found.was_complete {
        talk(&format!("'{}' is whole already", path.display()));
        return Ok(());
    }
    fresh.sync().with_context(no_room)?;
    let mut kept = path.as_os_str().to_owned();
    kept.push(".cut");
    std::fs::hard_link(path, &kept).with_context(|| format!("cannot keep '{}' as it was", path.display()))?;
    fresh.replace(path).with_context(no_room)?;
    let kept = Path::new(&kept).display();
    print(&format!("{}: {} messages; as it was: {kept}", path.display(), found.messages))
}
