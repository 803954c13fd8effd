//! Origin: the study, program, seed, policy and conditions that a record was computed for. Every record contains its
//! origin, so that records of several folders can be combined and a record of other conditions is ignored.

use serde::{Deserialize, Serialize};

pub use crate::record::identity::BUILD;

/// The program's version.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Properties that decide the numbers of one trial's record. Two records of one repeat with equal origins are equal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Name of the study.
    pub study: String,
    /// The program's version.
    pub version: String,
    /// Digest of the program's sources.
    pub build: String,
    /// Root of all randomness.
    pub seed: u64,
    /// Digest of the policy's file; empty for scripted navigation, and where no policy runs.
    pub policy: String,
    /// Digest of scenario, layouts, column, world and handling.
    pub conditions: String,
}

impl Origin {
    /// Returns the origin of a record that this program computes.
    pub fn here(study: &str, seed: u64, policy: &str, conditions: &impl Serialize) -> Origin {
        let conditions = serde_json::to_vec(conditions).expect("conditions are plain data");
        Origin {
            study: study.to_owned(),
            version: VERSION.to_owned(),
            build: BUILD.to_owned(),
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
        let one = Origin::here("delay", 1, "ab", &("passage", 5));
        assert_eq!(one, Origin::here("delay", 1, "ab", &("passage", 5)));
        let others = [
            Origin::here("range", 1, "ab", &("passage", 5)),
            Origin::here("delay", 2, "ab", &("passage", 5)),
            Origin::here("delay", 1, "ac", &("passage", 5)),
            Origin::here("delay", 1, "ab", &("passage", 6)),
        ];
        assert!(others.iter().all(|other| *other != one));
        assert!(BUILD.len() == 16 && one.build == BUILD);
        let text = serde_json::to_string(&one).expect("it is JSON");
        assert_eq!(serde_json::from_str::<Origin>(&text).expect("it can be read"), one);
    }
}
