//! Origin: the study, program, seed, policy and conditions that a kept record was computed for. A record carries it by
//! itself, so that records of several folders can be put together and none counts where it does not belong.

use serde::{Deserialize, Serialize};

/// Digest of the sources that the program was built from (`build.rs`).
pub const BUILD: &str = env!("SOURCE_DIGEST");
/// The program's version.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The origin of a record. Two records with equal origins and of equal repeats are the same numbers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Which study.
    pub study: String,
    /// The program's version.
    pub version: String,
    /// Digest of the program's sources.
    pub build: String,
    /// The seed.
    pub seed: u64,
    /// Digest of the policy's file; empty for scripted navigation, and where no policy runs.
    pub policy: String,
    /// Digest of everything else that decides what comes of it.
    pub conditions: String,
}

impl Origin {
    /// An origin in this program.
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
    fn origins_differ_in_whatever_decides_and_survive_their_file() {
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
