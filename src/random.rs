//! Randomness: one seed gives every part of a run its own named, independent stream.
//!
//! A stream is named for what draws from it ("agent/3/action"), so adding a draw in one place never
//! shifts the numbers of another. No generator is ever seeded from the machine.

/// What a stream draws with.
pub use rand::{Rng, RngExt};

use hmac_sha256::Hash;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// A deterministic random stream (ChaCha with 8 rounds: the same numbers on every machine).
pub type Stream = ChaCha8Rng;

/// The root of all randomness of one run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seed([u8; 32]);

impl Seed {
    /// The seed of a whole run, as the user states it.
    pub fn of_run(seed: u64) -> Seed {
        Seed(Hash::hash(&seed.to_le_bytes()))
    }

    /// A seed of these bytes, for a process that draws what nobody else may know.
    pub fn of_bytes(bytes: [u8; 32]) -> Seed {
        Seed(bytes)
    }

    /// The seed of one repeat of the run.
    pub fn of_repeat(seed: u64, repeat: u32) -> Seed {
        Seed::of_run(seed).child(&format!("repeat/{repeat}"))
    }

    /// A seed derived from this one and a name.
    pub fn child(&self, name: &str) -> Seed {
        let mut hash = Hash::new();
        hash.update(self.0);
        hash.update(name);
        Seed(hash.finalize())
    }

    /// The stream of that name.
    pub fn stream(&self, name: &str) -> Stream {
        Stream::from_seed(self.child(name).0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_depends_on_its_seed_and_on_its_name_alone() {
        let draw = |seed: u64, name: &str| Seed::of_run(seed).stream(name).next_u64();
        assert_eq!(draw(1, "a"), draw(1, "a"));
        assert_ne!(draw(1, "a"), draw(2, "a"));
        assert_ne!(draw(1, "a"), draw(1, "b"));
    }
}
