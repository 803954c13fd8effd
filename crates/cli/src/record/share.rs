//! The command `murmurate record share`: copies records so that they can be replayed without the team's key.

use std::io::BufWriter;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result};

use crate::record::chosen::{self, print_damage};
use murmurate::config::shown;
use murmurate::net::protocol::key::Key;
use murmurate_record::chosen::Chosen;
use murmurate_record::identity::Identity;
use murmurate_record::keys::RecordedKey;
use murmurate_record::reader::{self, Reader};
use murmurate_record::repair;
use murmurate_record::share::{accepted, copy};
use murmurate_robot::output::{print, talk};
use murmurate_robot::temporary;
use murmurate_robot::{BadInput, Ended, bad, key};

/// Flags of `murmurate record share`.
#[derive(clap::Args)]
pub struct Args {
    /// Record of a host of a team with a key, or the folder of the records of its hosts
    #[arg(value_name = "FILE|DIR")]
    record: PathBuf,
    /// File with the team's key
    #[arg(long, value_name = "FILE")]
    key_file: PathBuf,
    /// The copy, which says which datagrams had a valid tag; for a folder, a folder of copies outside of it. Nothing is
    /// overwritten
    #[arg(short, long, value_name = "FILE.mcap|DIR")]
    output: PathBuf,
}

/// Runs `record share`: checks the authentication tags in the records of hosts with the team's key, and writes copies
/// of the records with the lists of the datagrams that had a valid tag. Of a folder, records without a key are copied,
/// too. Returns [`Ended::Unfit`] if a file of a folder was left out, or a record is damaged.
pub fn run(args: &Args) -> Result<Ended> {
    let key = key::read(&args.key_file)?.key_of_records();
    let Chosen { records, left_out } = chosen::records(std::slice::from_ref(&args.record))?;
    let whole_folder = args.record.is_dir();
    let output_of = |path: &Path| match whole_folder {
        true => args.output.join(path.file_name().unwrap_or_default()),
        false => args.output.clone(),
    };
    if whole_folder && real(&args.output).starts_with(real(&args.record)) {
        let output = args.output.display();
        return bad(format!(
            "--output: '{output}' is in the folder of the records: name another folder, outside of it"
        ));
    }
    let outputs = records.iter().map(|(path, _)| output_of(path));
    if let Some(taken) = outputs.into_iter().find(|output| output.symlink_metadata().is_ok()) {
        return bad(format!("--output: '{}' is there already: move it away, or name another", taken.display()));
    }
    if whole_folder {
        let no_folder = || format!("cannot make the folder '{}'", args.output.display());
        std::fs::create_dir_all(&args.output).with_context(no_folder)?;
    }
    let mut sound = !left_out;
    for (path, identity) in records {
        let output = output_of(&path);
        match one((&path, &identity), &key, &output, whole_folder) {
            Ok(whole) => sound &= whole,
            Err(error) if whole_folder && error.is::<BadInput>() => {
                talk(&format!("left out: {error}"));
                sound = false;
            }
            Err(error) => return Err(error),
        }
    }
    Ok(if sound { Ended::Done } else { Ended::Unfit })
}

/// Returns `path` without links, also if its last folders are not there yet.
fn real(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let known = whole.ancestors().find_map(|folder| Some((folder, folder.canonicalize().ok()?)));
    let Some((folder, mut found)) = known else { return whole };
    for part in whole.strip_prefix(folder).expect("it is one of its folders").components() {
        match part {
            Component::ParentDir => drop(found.pop()),
            part => found.push(part),
        }
    }
    found
}

/// Copies one record to `output`. One that was made without a key is only copied if `as_it_is`. Returns whether the
/// record is whole.
fn one((path, identity): (&Path, &Identity), key: &Key, output: &Path, as_it_is: bool) -> Result<bool> {
    let wrong = |error: reader::ReadError| BadInput(error.to_string());
    let (_, messages) = reader::messages(path).map_err(wrong)?;
    let whole = print_damage(messages.health(), identity.anchor_ns);
    let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let no_room = || format!("cannot write '{}'", output.display());
    let Some(host) = identity.host.as_ref().filter(|host| host.keyed) else {
        if !as_it_is {
            return bad(format!("'{}' is not of a team with a key: share it as it is", path.display()));
        }
        let mut fresh = temporary::file_in(folder, 0o666).with_context(no_room)?;
        repair::copy(&mut Reader::open(path)?, Vec::new(), BufWriter::new(fresh.as_file_mut()))?;
        fresh
            .as_file()
            .sync_all()
            .and_then(|()| fresh.persist(output).map_err(|failed| failed.error))
            .with_context(no_room)?;
        print(&format!("{}: made without a key, as it is", output.display()))?;
        return Ok(whole);
    };
    let key = RecordedKey::new(key, host);
    let found = accepted(messages, key.clone())?;
    if found.accepted.is_empty() && found.refused > 0 {
        return bad(format!("--key-file: no datagram of '{}' has a tag of this key", path.display()));
    }
    let mut fresh = temporary::file_in(folder, 0o666).with_context(no_room)?;
    copy(&mut Reader::open(path)?, key, &found.accepted, BufWriter::new(fresh.as_file_mut()))?;
    fresh
        .as_file()
        .sync_all()
        .and_then(|()| fresh.persist(output).map_err(|failed| failed.error))
        .with_context(no_room)?;
    let (valid, refused) = (found.accepted.len(), found.refused);
    let (output, valid) = (shown::value(output.display()), shown::counted(valid, "datagram"));
    print(&format!("{output}: {valid} had a valid tag, {refused} had not"))?;
    Ok(whole)
}
