//! The command `murmurate record share`: copies a record so that it can be replayed without the team's key.

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::net::protocol::key::Key;
use crate::program::output::print;
use crate::program::temporary::Temporary;
use crate::program::{BadInput, Ended, bad, key};
use crate::record::reader::{self, Reader};
use crate::record::share::{accepted, copy};

/// Flags of `murmurate record share`.
#[derive(clap::Args)]
pub struct Args {
    /// Record of a host of a team with a key
    #[arg(value_name = "FILE")]
    record: PathBuf,
    /// File with the team's key
    #[arg(long, value_name = "FILE")]
    key_file: PathBuf,
    /// The copy, which says which datagrams had a valid tag
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
}

/// Runs `record share`: checks the authentication tags in a host's record with the team's key, and writes a copy of the
/// record with the list of the datagrams that had a valid tag.
pub fn run(args: &Args) -> Result<Ended> {
    let wrong = |error: reader::ReadError| BadInput(error.to_string());
    let identity = reader::open(&args.record).map_err(wrong)?.identity;
    let Some(host) = identity.host.filter(|host| host.keyed) else {
        return bad(format!("'{}' is not of a team with a key: share it as it is", args.record.display()));
    };
    let key = Key::new(key::read(&args.key_file)?);
    let found = accepted(reader::open(&args.record).map_err(wrong)?.messages, &key, host.id)?;
    if found.accepted.is_empty() && found.refused > 0 {
        return bad(format!("--key-file: no datagram of '{}' has a tag of this key", args.record.display()));
    }
    let folder = args.output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let no_room = || format!("cannot write '{}'", args.output.display());
    let mut fresh = Temporary::new_in(folder, 0o666).with_context(no_room)?;
    copy(&mut Reader::open(&args.record)?, &found.accepted, BufWriter::new(fresh.seekable()))?;
    fresh.sync().with_context(no_room)?;
    fresh.replace(&args.output).with_context(no_room)?;
    let (valid, refused) = (found.accepted.len(), found.refused);
    print(&format!("{}: {valid} datagrams had a valid tag, {refused} had not", args.output.display()))?;
    Ok(Ended::Done)
}
