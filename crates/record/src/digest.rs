//! Digests of the metadata of a record, in metadata of their own: MCAP has no checksum for single metadata, and the
//! checksum over all of a file is at its end, which a crash may have cut off.
//!
//! The digests are of names and values, not of bytes, so they hold in a copy that another program has made.

use super::reading::element::Map;

/// Name of the metadata with the digests of the others.
pub const METADATA: &str = "murmurate.digest";

/// Returns the digest of metadata, as hexadecimal digits.
fn of(name: &str, values: &Map) -> String {
    let mut bytes = Vec::new();
    let pairs = values.iter().flat_map(|(name, value)| [name, value]);
    for text in std::iter::once(name).chain(pairs.map(String::as_str)) {
        bytes.extend((text.len() as u64).to_le_bytes());
        bytes.extend(text.as_bytes());
    }
    format!("{:032x}", xxhash_rust::xxh3::xxh3_128(&bytes))
}

/// Returns the values of the metadata [`METADATA`] for the metadata `all`, each a name and values.
pub fn of_all(all: &[(&str, &Map)]) -> Map {
    all.iter().map(|(name, values)| ((*name).to_owned(), of(name, values))).collect()
}

/// Result of the comparison of metadata with their digest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Match {
    /// They agree with their digest.
    Right,
    /// They have no digest.
    Unknown,
    /// They contradict their digest.
    Wrong {
        /// Whether a copy of them is right, so that nothing is lost.
        copied: bool,
    },
}

/// Results of the comparison of a file's metadata with their digests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Judged {
    /// Result for each of the metadata, in their order.
    pub of: Vec<Match>,
    /// Names of metadata with a digest that are not in the file.
    pub absent: Vec<String>,
}

/// Decides which of the metadata `all`, in the order of the file, are as they were written. A file may have digests
/// twice, so that damage to them can be distinguished from damage to the metadata.
pub fn judge(all: &[(&str, &Map)]) -> Judged {
    // A damaged digest says nothing about its metadata.
    let is_digest = |text: &str| text.len() == 32 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    let is_list = |values: &Map| values.values().all(|text| is_digest(text));
    let lists = all.iter().filter(|(name, _)| *name == METADATA);
    let broken = lists.clone().any(|(_, values)| !is_list(values));
    let digests = |(_, values): &(&str, &Map)| -> Map {
        let right = values.iter().filter(|(_, text)| is_digest(text));
        right.map(|(name, text)| (name.clone(), text.clone())).collect()
    };
    let lists: Vec<Map> = lists.map(digests).collect();
    let listed = |name: &str, digest: &str| lists.iter().any(|list| list.get(name).is_some_and(|is| is == digest));
    let confirmed = |name: &str| {
        all.iter().any(|(other, values)| *other == name && *other != METADATA && listed(name, &of(other, values)))
    };
    let verdict = |(name, values): &(&str, &Map)| {
        if *name == METADATA && !is_list(values) {
            return Match::Wrong { copied: all.iter().any(|(name, other)| *name == METADATA && is_list(other)) };
        }
        if *name == METADATA {
            // One of two lists that contradicts what the other one confirms is itself damaged.
            let agrees = |(name, digest): (&String, &String)| {
                !confirmed(name) || all.iter().any(|(n, v)| n == name && of(n, v) == *digest)
            };
            let whole = lists.iter().all(|list| list.keys().all(|name| values.contains_key(name) || !confirmed(name)));
            return match whole && values.iter().all(agrees) {
                true => Match::Right,
                false => Match::Wrong { copied: true },
            };
        }
        if listed(name, &of(name, values)) {
            Match::Right
        } else if lists.iter().any(|list| list.contains_key(*name)) {
            Match::Wrong { copied: confirmed(name) }
        } else if !lists.is_empty() && !broken && name.starts_with("murmurate.") {
            // The name itself is damaged.
            Match::Wrong { copied: false }
        } else {
            Match::Unknown
        }
    };
    let verdicts = all.iter().map(verdict).collect();
    let named = lists.iter().flat_map(|list| list.keys());
    let mut absent: Vec<String> = named.filter(|name| !all.iter().any(|(other, _)| other == name)).cloned().collect();
    absent.sort();
    absent.dedup();
    // A name that only a damaged list has was never that of metadata.
    absent.retain(|name| lists.iter().all(|list| list.contains_key(name)));
    Judged { of: verdicts, absent }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(pairs: &[(&str, &str)]) -> Map {
        pairs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
    }

    #[test]
    fn changed_metadata_are_told_from_a_changed_list_by_the_second_copy() {
        let (run, stage) = (map(&[("seed", "7"), ("format", "2")]), map(&[("walls", "[]")]));
        let list = of_all(&[("murmurate.run", &run), ("murmurate.stage", &stage)]);
        let other = map(&[("seed", "6"), ("format", "2")]);
        let [r, s, l] = ["murmurate.run", "murmurate.stage", METADATA];
        let right = Match::Right;
        let whole = judge(&[(r, &run), (s, &stage), (l, &list)]);
        assert_eq!((whole.of, whole.absent), (vec![right; 3], vec![]));
        let changed = judge(&[(r, &other), (s, &stage), (l, &list)]);
        assert_eq!(changed.of, [Match::Wrong { copied: false }, right, right]);
        let copied = judge(&[(r, &other), (s, &stage), (l, &list), (r, &run), (l, &list)]);
        assert_eq!(copied.of, [Match::Wrong { copied: true }, right, right, right, right]);
        let mut wrong = list.clone();
        wrong.insert(r.to_owned(), "0".repeat(32));
        let listed = judge(&[(r, &run), (s, &stage), (l, &wrong), (r, &run), (l, &list)]);
        assert_eq!(listed.of, [right, right, Match::Wrong { copied: true }, right, right]);
        assert_eq!(judge(&[(r, &run), (l, &list)]).absent, [s]);
        assert_eq!(judge(&[(r, &run), ("theirs", &stage)]).of, [Match::Unknown; 2]);
        // Zeros from the middle of the list on, as after a power cut: nothing is known of what it no longer lists.
        for (name, digest) in [(s, format!("{:\0<32}", "2b41")), ("murmurate.st\0\0\0", String::new())] {
            let mut zeros = list.clone();
            zeros.remove(s);
            zeros.insert(name.to_owned(), digest);
            let cut = judge(&[(r, &run), (s, &stage), (l, &zeros)]);
            assert_eq!(cut.of, [right, Match::Unknown, Match::Wrong { copied: false }]);
            assert!(cut.absent.is_empty(), "{:?}", cut.absent);
            let copied = judge(&[(r, &run), (s, &stage), (l, &zeros), (l, &list)]);
            assert_eq!(copied.of, [right, right, Match::Wrong { copied: true }, right]);
        }
        assert_eq!(judge(&[("murmurate.ruN", &run), (s, &stage), (l, &list)]).of[0], Match::Wrong { copied: false });
    }
}
