//! The command `murmurate record merge`: merges the records of a team's hosts into one, and prints the clock offsets
//! that were found.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::record::chosen;
use murmurate::config::shown;
use murmurate::net::protocol::key::Key;
use murmurate_record::chosen::Chosen;
use murmurate_record::identity::Identity;
use murmurate_record::merge::{self, Merge, MergeError};
use murmurate_robot::output::{print, talk};
use murmurate_robot::temporary;
use murmurate_robot::{Ended, bad, key};

/// Flags of `murmurate record merge`.
#[derive(clap::Args)]
pub struct Args {
    /// Records of the hosts of one run, or their folder
    #[arg(required = true, value_name = "FILE|DIR")]
    records: Vec<PathBuf>,
    /// File with the team's key, for records of a confidential team
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// The merged record
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
}

/// Runs `record merge`: merges the records of hosts into one file, and prints the clock offset that was found for each
/// host.
pub fn run(args: &Args) -> Result<Ended> {
    let Chosen { records, left_out } = chosen::records(&args.records)?;
    let folder = args.output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let no_room = || format!("cannot write '{}'", args.output.display());
    let place = args.output.canonicalize().ok();
    if place.is_some() && records.iter().any(|(path, _)| path.canonicalize().ok() == place) {
        return bad(format!("--output: '{}' is one of the records: name another file", args.output.display()));
    }
    let mut fresh = temporary::file_in(folder, 0o640).with_context(no_room)?;
    let key = args.key_file.as_deref().map(key::read).transpose()?.map(|file| file.key_of_records());
    let Merge { parts, alignment, whole } = into_file(records, key.as_ref(), fresh.as_file_mut())?;
    fresh.as_file().sync_all().with_context(no_room)?;
    fresh.persist(&args.output).map_err(|failed| failed.error).with_context(no_room)?;
    for part in &parts {
        let (ahead, uncertainty) = part.clock.latest_ns();
        print(&format!(
            "{}: {:+.3} ms, within {:.3} ms",
            shown::value(&part.host),
            ahead as f64 / 1e6,
            uncertainty as f64 / 1e6
        ))?;
    }
    let beyond = alignment.beyond_ns as f64 / 1e6;
    print(&format!(
        "{} matched; none arrives before its sending beyond these bounds, which contain {beyond:.3} ms for \
         the lengths of turns",
        shown::counted(alignment.matched, "datagram")
    ))?;
    Ok(if whole && !left_out { Ended::Done } else { Ended::Unfit })
}

/// Merges the records of the hosts of one run into the file `output`, and prints on stderr which are left out or
/// damaged. What arrived encrypted is read with `key`.
pub fn into_file(records: Vec<(PathBuf, Identity)>, key: Option<&Key>, output: &mut File) -> Result<Merge> {
    merge::merge(records, key, output, talk).map_err(|error| match error {
        MergeError::Unusable(error) => chosen::wrong(error).into(),
        other => other.into(),
    })
}
