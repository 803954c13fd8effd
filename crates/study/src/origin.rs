//! Origin of a record: the study, program, seed, policy and conditions that it was computed for. Every record contains
//! its origin. So records of several folders can be combined, and records of other conditions are ignored.

use serde::{Deserialize, Serialize};

/// Version of the program.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Origin of a trial's record: the properties that determine its numbers. Records of the same repeat with equal origins
/// are equal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Name of the study that the trial belongs to.
    pub study: String,
    /// Version of the program that computed the record.
    pub version: String,
    /// Digest of the program's sources: programs with equal digests compute the same numbers.
    pub build: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Digest of the policy's file; empty for scripted navigation, and if no policy runs.
    pub policy: String,
    /// Digest of all other conditions, such as scenario, layouts, column, world and handling.
    pub conditions: String,
}

impl Origin {
    /// Returns the origin of a record that this program computes for a study with this seed. `build` is the digest of
    /// the program's sources, `policy` that of the policy's file; `conditions` is everything else on which the numbers
    /// depend, and is stored as a digest.
    pub fn here(build: &str, study: &str, seed: u64, policy: &str, conditions: &impl Serialize) -> Origin {
        let conditions = serde_json::to_vec(conditions).expect("conditions are plain data");
        Origin {
            study: study.to_owned(),
            version: VERSION.to_owned(),
            build: build.to_owned(),
            seed,
            policy: policy.to_owned(),
            conditions: blake3::hash(&conditions).to_hex()[..32].to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_differ_in_every_condition_and_survive_json() {
        let one = Origin::here("1f", "delay", 1, "ab", &("passage", 5));
        assert_eq!(one, Origin::here("1f", "delay", 1, "ab", &("passage", 5)));
        let others = [
            Origin::here("1f", "range", 1, "ab", &("passage", 5)),
            Origin::here("1f", "delay", 2, "ab", &("passage", 5)),
            Origin::here("1f", "delay", 1, "ac", &("passage", 5)),
            Origin::here("1f", "delay", 1, "ab", &("passage", 6)),
        ];
        assert!(others.iter().all(|other| *other != one));
        assert_eq!(one.build, "1f");
        let text = serde_json::to_string(&one).expect("it is JSON");
        assert_eq!(serde_json::from_str::<Origin>(&text).expect("it can be read"), one);
    }
}
