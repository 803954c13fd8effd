//! Randomness: one seed gives every part of a run its own named, independent stream.
//!
//! A stream is named for what draws from it ("agent/3/action"), so adding a draw in one place never
//! shifts the numbers of another. No generator is ever seeded from the machine, and no distribution asks the platform's
//! mathematical library, so that a stream gives the same numbers everywhere.

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

/// Two independent numbers of the standard normal distribution (Marsaglia's polar method).
pub fn normals(stream: &mut Stream) -> [f64; 2] {
    loop {
        let [x, y] = [stream.random::<f64>(), stream.random()].map(|unit| 2.0 * unit - 1.0);
        let square = x * x + y * y;
        if square > 0.0 && square < 1.0 {
            let stretch = (-2.0 * libm::log(square) / square).sqrt();
            return [x * stretch, y * stretch];
        }
    }
}

/// A number of the exponential distribution with mean 1.
pub fn exponential(stream: &mut Stream) -> f64 {
    -libm::log(1.0 - stream.random::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean, variance and the share above `limit` of so many numbers.
    fn figures(numbers: &[f64], limit: f64) -> [f64; 3] {
        let n = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / n;
        let variance = numbers.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
        [mean, variance, numbers.iter().filter(|x| **x > limit).count() as f64 / n]
    }

    #[test]
    fn numbers_are_distributed_as_they_are_named() {
        let close = |found: [f64; 3], meant: [f64; 3]| {
            let off = found.iter().zip(meant).map(|(found, meant)| (found - meant).abs()).fold(0.0, f64::max);
            assert!(off < 0.01, "{found:?}, not {meant:?}");
        };
        let mut stream = Seed::of_run(3).stream("numbers");
        let pairs: Vec<[f64; 2]> = (0..200_000).map(|_| normals(&mut stream)).collect();
        for axis in 0..2 {
            let numbers: Vec<f64> = pairs.iter().map(|pair| pair[axis]).collect();
            // Beyond two deviations lie 2.275 % (and as many below).
            close(figures(&numbers, 2.0), [0.0, 1.0, 0.02275]);
        }
        let both = pairs.iter().map(|[x, y]| x * y).sum::<f64>() / pairs.len() as f64;
        assert!(both.abs() < 0.01, "the two know nothing of each other: {both}");
        let numbers: Vec<f64> = (0..400_000).map(|_| exponential(&mut stream)).collect();
        close(figures(&numbers, 3.0), [1.0, 1.0, 0.0498]);
    }

    #[test]
    fn a_stream_depends_on_its_seed_and_on_its_name_alone() {
        let draw = |seed: u64, name: &str| Seed::of_run(seed).stream(name).next_u64();
        assert_eq!(draw(1, "a"), draw(1, "a"));
        assert_ne!(draw(1, "a"), draw(2, "a"));
        assert_ne!(draw(1, "a"), draw(1, "b"));
    }
}
