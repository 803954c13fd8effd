//! The records that a command takes, of the files and folders that the user has named: each run once, and one bad file
//! among good ones is left out.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Result;

use murmurate_record::identity::Identity;
use murmurate_record::reader::{self, ReadError, Reader};
use murmurate_record::series;
use murmurate_robot::output::talk;
use murmurate_robot::{BadInput, bad};

/// Name of the metadata that `record merge` gives to its output.
pub const MERGED: &str = "murmurate.merge";

/// Records of a command.
pub struct Chosen {
    /// Path and identity of each record.
    pub records: Vec<(PathBuf, Identity)>,
    /// Whether a file was left out because it is no record that can be used.
    pub left_out: bool,
}

/// Returns all `named` files, with each folder among them replaced by the MCAP files in it (`*.mcap`), sorted by name.
pub fn files(named: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for path in named {
        if !path.is_dir() {
            all.push(path.clone());
            continue;
        }
        let wrong = |error| BadInput(format!("cannot read the folder '{}': {error}", path.display()));
        let entries = std::fs::read_dir(path).map_err(wrong)?;
        let found = entries.filter_map(|entry| Some(entry.ok()?.path()));
        let mut found: Vec<PathBuf> = found.filter(|path| path.extension().is_some_and(|e| e == "mcap")).collect();
        found.sort();
        if found.is_empty() {
            return bad(format!("the folder '{}' has no record (*.mcap)", path.display()));
        }
        all.extend(found);
    }
    Ok(all)
}

/// Returns the first files of all `named` records: further files of a record are read together with its first one.
pub fn first_files(named: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut all = files(named)?;
    let by_hand = |path: &Path| named.iter().any(|named| named == path);
    all.retain(|path| by_hand(path) || series::first_of(path).is_none_or(|first| !first.exists()));
    Ok(all)
}

/// One copy of a record: its path, what it is of, and what it lacks (whether it is damaged, fewer bytes first).
type Copied = (PathBuf, Identity, (bool, u64));

/// Returns the records among the `named` files and folders. Files that are no records, such as an empty one, are named
/// on stderr and left out. Of several copies of a record the one that lacks least is taken. Fails if no record is left.
pub fn records(named: &[PathBuf]) -> Result<Chosen> {
    let paths = first_files(named)?;
    let only = paths.len() == 1;
    let mut copies: BTreeMap<String, Vec<Copied>> = BTreeMap::new();
    let (mut order, mut left_out) = (Vec::new(), false);
    for path in paths {
        match reader::messages(&path) {
            Ok((identity, messages)) => {
                let key = format!("{:?}", identity.to_metadata());
                let health = messages.health();
                let lacks = (!health.is_whole(), u64::MAX - health.bytes);
                let known = copies.entry(key.clone()).or_default();
                if known.is_empty() {
                    order.push(key);
                }
                known.push((path, identity, lacks));
            }
            Err(error) if only => return Err(BadInput(reason(&path, error)).into()),
            Err(error) => {
                talk(&format!("left out: {}", reason(&path, error)));
                left_out = true;
            }
        }
    }
    let mut records = Vec::new();
    for key in order {
        let mut same = copies.remove(&key).expect("it was noted");
        same.sort_by(|(a, _, lacks), (b, _, other)| (lacks, a).cmp(&(other, b)));
        let mut same = same.into_iter();
        let (path, identity, _) = same.next().expect("it has one at least");
        for (other, ..) in same {
            talk(&format!("'{}' is the same record as '{}' and counts once", other.display(), path.display()));
        }
        records.push((path, identity));
    }
    if records.is_empty() {
        return bad("none of these files is a record that can be used".to_owned());
    }
    records.sort_by(|(a, _), (b, _)| a.cmp(b));
    Ok(Chosen { records, left_out })
}

/// Returns why a file is no record that can be used.
fn reason(path: &Path, error: ReadError) -> String {
    let merged = |reader: Reader| reader.metadata().iter().any(|(name, _)| name == MERGED);
    match error {
        ReadError::Nameless { .. } if Reader::open(path).is_ok_and(merged) => {
            format!("'{}' was merged of several records: name those", path.display())
        }
        other => other.to_string(),
    }
}

/// Prints on stderr what is damaged in a record, with times since `zero` \[ns\]. Returns whether it is whole.
pub fn tell(health: &murmurate_record::health::Health, zero: u64) -> bool {
    health.lines(zero).iter().for_each(|line| talk(line));
    health.is_whole()
}
