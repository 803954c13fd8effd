//! Selection of the records among named files and folders: each run once, and without files that cannot be used.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::identity::{Identity, MERGED};
use super::reader::{self, ReadError, Reader};
use super::reading::element::Map;
use super::series;

/// Error: the named files and folders are no usable records. The text says why.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unusable(pub String);

impl From<ReadError> for Unusable {
    fn from(error: ReadError) -> Unusable {
        Unusable(error.to_string())
    }
}

/// Selected records.
#[derive(Debug)]
pub struct Chosen {
    /// Path and identity of each record.
    pub records: Vec<(PathBuf, Identity)>,
    /// Whether a file was left out because it is no record that can be used.
    pub left_out: bool,
}

/// Returns all `named` files, with each folder among them replaced by the MCAP files in it (`*.mcap`), sorted by name.
pub fn files(named: &[PathBuf]) -> Result<Vec<PathBuf>, Unusable> {
    let mut all = Vec::new();
    for path in named {
        if !path.is_dir() {
            all.push(path.clone());
            continue;
        }
        let wrong = |error| Unusable(format!("cannot read the folder '{}': {error}", path.display()));
        let entries = std::fs::read_dir(path).map_err(wrong)?;
        let found = entries.filter_map(|entry| Some(entry.ok()?.path()));
        let mut found: Vec<PathBuf> = found.filter(|path| path.extension().is_some_and(|e| e == "mcap")).collect();
        found.sort();
        if found.is_empty() {
            return Err(Unusable(format!("the folder '{}' has no record (*.mcap)", path.display())));
        }
        all.extend(found);
    }
    Ok(all)
}

/// Returns the first files of all `named` records: further files of a record are read together with its first one.
pub fn first_files(named: &[PathBuf]) -> Result<Vec<PathBuf>, Unusable> {
    let mut all = files(named)?;
    let by_hand = |path: &Path| named.iter().any(|named| named == path);
    all.retain(|path| by_hand(path) || series::first_of(path).is_none_or(|first| !first.exists()));
    Ok(all)
}

/// One copy of a record: its path, its identity, and a measure of what it lacks (damaged ones last, then those with
/// fewer bytes).
type Copied = (PathBuf, Identity, (bool, u64));

/// Returns the records among the `named` files and folders. Files that are no records, such as an empty one, are left
/// out. Of several copies of a record the one that lacks least is taken. Calls `warn` with a line of text for each file
/// that is not taken. Fails if no record is left.
pub fn records(named: &[PathBuf], mut warn: impl FnMut(&str)) -> Result<Chosen, Unusable> {
    let paths = first_files(named)?;
    let only = paths.len() == 1;
    let mut copies: BTreeMap<Map, Vec<Copied>> = BTreeMap::new();
    let (mut order, mut left_out) = (Vec::new(), false);
    for path in paths {
        match reader::messages(&path) {
            Ok((identity, messages)) => {
                let key = identity.to_metadata();
                let health = messages.health();
                let lacks = (!health.is_whole(), u64::MAX - health.bytes);
                let known = copies.entry(key.clone()).or_default();
                if known.is_empty() {
                    order.push(key);
                }
                known.push((path, identity, lacks));
            }
            Err(error) if only => return Err(Unusable(reason(&path, error))),
            Err(error) => {
                warn(&format!("left out: {}", reason(&path, error)));
                left_out = true;
            }
        }
    }
    let mut records = Vec::new();
    for key in order {
        let mut same = copies.remove(&key).expect("each key in the order has copies");
        same.sort_by(|(a, _, lacks), (b, _, other)| (lacks, a).cmp(&(other, b)));
        let mut same = same.into_iter();
        let (path, identity, _) = same.next().expect("a key has at least one copy");
        for (other, ..) in same {
            warn(&format!("'{}' is the same record as '{}' and counts once", other.display(), path.display()));
        }
        records.push((path, identity));
    }
    if records.is_empty() {
        return Err(Unusable("none of these files is a record that can be used".to_owned()));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::{Beginning, RecordFile};
    use crate::stage::Stage;
    use murmurate::trial::Trial;

    /// Writes the record of a simulation's repeat, with an end or, as a crash leaves it, without one.
    fn record(path: &Path, repeat: u32, ends: bool) {
        let mut identity = Identity::here("1f", vec!["sim".to_owned()], "");
        (identity.repeat, identity.anchor_ns) = (repeat, 7);
        let stage = Stage::of(&Trial::preset("sim", "passage").unwrap());
        let mut file = RecordFile::create(path, &Beginning { identity, attached: Vec::new() }, &stage).unwrap();
        match ends {
            true => file.finish().unwrap(),
            false => file.flush().unwrap(),
        }
    }

    #[test]
    fn of_a_folder_each_run_counts_once_by_its_best_copy_and_bad_files_are_left_out() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = |name: &str| folder.path().join(name);
        record(&path("cut.mcap"), 0, false);
        record(&path("whole.mcap"), 0, true);
        record(&path("other.mcap"), 1, true);
        std::fs::write(path("empty.mcap"), "").unwrap();
        std::fs::write(path("notes.txt"), "no record").unwrap();
        let mut warnings = Vec::new();
        let chosen = records(&[folder.path().to_owned()], |line| warnings.push(line.to_owned())).unwrap();
        let names: Vec<PathBuf> = chosen.records.into_iter().map(|(path, _)| path).collect();
        assert_eq!(names, [path("other.mcap"), path("whole.mcap")]);
        assert!(chosen.left_out);
        assert!(warnings[0].starts_with("left out: ") && warnings[0].contains("empty.mcap' is empty"), "{warnings:?}");
        assert!(warnings[1].contains("cut.mcap' is the same record as") && warnings.len() == 2, "{warnings:?}");
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let folder = tempfile::TempDir::new().unwrap();
        let of = |path: &Path| records(&[path.to_owned()], |_| {}).unwrap_err().to_string();
        assert!(of(folder.path()).ends_with("has no record (*.mcap)"));
        let file = folder.path().join("notes.txt");
        std::fs::write(&file, "no record").unwrap();
        assert!(of(&file).contains("is no record"), "{}", of(&file));
        let both = [file.clone(), file];
        let error = records(&both, |_| {}).unwrap_err();
        assert_eq!(error.to_string(), "none of these files is a record that can be used");
    }
}
