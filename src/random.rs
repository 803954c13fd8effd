//! Pseudo-random numbers: independent, named streams that derive from one seed.
//!
//! A stream's name states its user ("agent/3/action"), so an added draw in one place never shifts the numbers of
//! another. No generator is seeded from the machine. No distribution calls the platform's mathematical library, so a
//! stream gives the same numbers on every machine.

/// Traits of the crate `rand` with the methods that draw numbers from a [`Stream`].
pub use rand::{Rng, RngExt};

use hmac_sha256::Hash;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Deterministic generator of pseudo-random numbers: ChaCha with 8 rounds. Equal seeds give equal numbers on every
/// machine.
pub type Stream = ChaCha8Rng;

/// A 256-bit seed. Random streams and further seeds are derived from a seed and a name by SHA-256.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seed([u8; 32]);

impl Seed {
    /// Makes the seed of a whole run from the number that the user gives.
    pub fn of_run(seed: u64) -> Seed {
        Seed(Hash::hash(&seed.to_le_bytes()))
    }

    /// Makes a seed of the given bytes, such as secret ones from the operating system for a process on a network.
    pub fn of_bytes(bytes: [u8; 32]) -> Seed {
        Seed(bytes)
    }

    /// Makes the seed of one repeat of a run. `seed` is the number that the user gives, `repeat` the index of the
    /// repeat.
    pub(crate) fn of_repeat(seed: u64, repeat: u32) -> Seed {
        Seed::of_run(seed).child(&format!("repeat/{repeat}"))
    }

    /// Derives another seed from this seed and `name`; different names give independent seeds.
    pub fn child(&self, name: &str) -> Seed {
        let mut hash = Hash::new();
        hash.update(self.0);
        hash.update(name);
        Seed(hash.finalize())
    }

    /// Makes the random stream that belongs to this seed and `name`; different names give independent streams.
    pub fn stream(&self, name: &str) -> Stream {
        Stream::from_seed(self.child(name).0)
    }
}

/// Position in a random stream, by which `#[serde(with = "random::stored")]` stores a stream.
pub mod stored {
    use rand::SeedableRng;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Stream;

    /// Position in a random stream. (The position within the stream has more than 64 bits.)
    #[derive(Clone, Debug, Serialize, Deserialize)]
    pub struct StoredStream {
        seed: [u8; 32],
        stream: u64,
        position: [u64; 2],
    }

    impl StoredStream {
        /// Returns the position of a stream.
        pub fn of(stream: &Stream) -> StoredStream {
            let position = stream.get_word_pos();
            let position = [(position >> 64) as u64, position as u64];
            StoredStream { seed: stream.get_seed(), stream: stream.get_stream(), position }
        }

        /// Returns a stream that continues at this position.
        pub fn stream(&self) -> Stream {
            let mut stream = Stream::from_seed(self.seed);
            stream.set_stream(self.stream);
            stream.set_word_pos(u128::from(self.position[0]) << 64 | u128::from(self.position[1]));
            stream
        }
    }

    /// Stores the position of a stream.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(stream: &Stream, to: S) -> Result<S::Ok, S::Error> {
        StoredStream::of(stream).serialize(to)
    }

    /// Reads a stream that continues at the stored position.
    ///
    /// # Errors
    /// Those of the deserializer.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Stream, D::Error> {
        StoredStream::deserialize(from).map(|stored| stored.stream())
    }
}

/// Draws two independent numbers of the standard normal distribution from `stream` (Marsaglia's polar method).
pub fn normals(stream: &mut Stream) -> [f64; 2] {
    NormalPair::draw(stream).numbers()
}

/// Draws a point of the uniform distribution over the disc of this radius about the origin.
pub fn in_disc(radius: f32, stream: &mut Stream) -> [f32; 2] {
    loop {
        let [x, y]: [f32; 2] = [stream.random_range(-1.0..=1.0), stream.random_range(-1.0..=1.0)];
        if x * x + y * y <= 1.0 {
            return [x * radius, y * radius];
        }
    }
}

/// Draws a number of the standard normal distribution from `stream` and returns whether it is at least `limit`. The
/// stream advances as in one call of [`normals`], whose first number is compared. Most calls need no logarithm.
pub(crate) fn normal_reaches(limit: f64, stream: &mut Stream) -> bool {
    let pair = NormalPair::draw(stream);
    // Farther from zero than the number can be, with a margin for rounding, its sign or its bound decides.
    if limit * limit > 1.001 * pair.bound_of_square() {
        return limit < 0.0;
    }
    pair.numbers()[0] >= limit
}

/// Point drawn from the uniform distribution over the unit disc, of which the polar method makes two normal numbers.
struct NormalPair {
    x: f64,
    y: f64,
    /// Square of the distance from the centre, above 0 and below 1.
    square: f64,
}

impl NormalPair {
    fn draw(stream: &mut Stream) -> NormalPair {
        loop {
            let [x, y] = [stream.random::<f64>(), stream.random()].map(|unit| 2.0 * unit - 1.0);
            let square = x * x + y * y;
            if square > 0.0 && square < 1.0 {
                return NormalPair { x, y, square };
            }
        }
    }

    fn numbers(&self) -> [f64; 2] {
        let stretch = (-2.0 * libm::log(self.square) / self.square).sqrt();
        [self.x * stretch, self.y * stretch]
    }

    /// Returns an upper bound of the square of the first number: the exponent of a floating-point number bounds its
    /// logarithm.
    fn bound_of_square(&self) -> f64 {
        let halvings = 1023 - (self.square.to_bits() >> 52) as i64;
        self.x * self.x * 2.0 * halvings as f64 * std::f64::consts::LN_2 / self.square
    }
}

/// Returns the number that a standard normal one exceeds with the probability `above`, by the approximation of P. J.
/// Acklam (2003), whose relative error is below 1.2e-9. From a uniform number it makes a normal one.
pub(crate) fn normal_above(above: f64) -> f64 {
    /// Quotient of polynomials in the middle, and in the tails, highest power first.
    const MIDDLE: [[f64; 6]; 2] = [
        [
            -3.969683028665376e1,
            2.209460984245205e2,
            -2.759285104469687e2,
            1.38357751867269e2,
            -3.066479806614716e1,
            2.506628277459239,
        ],
        [
            -5.447609879822406e1,
            1.615858368580409e2,
            -1.556989798598866e2,
            6.680131188771972e1,
            -1.328068155288572e1,
            1.0,
        ],
    ];
    const TAIL: [[f64; 6]; 2] = [
        [
            -7.784894002430293e-3,
            -3.223964580411365e-1,
            -2.400758277161838,
            -2.549732539343734,
            4.374664141464968,
            2.938163982698783,
        ],
        [0.0, 7.784695709041462e-3, 3.224671290700398e-1, 2.445134137142996, 3.754408661907416, 1.0],
    ];
    const BREAK: f64 = 0.02425;
    let quotient = |[over, under]: [[f64; 6]; 2], at: f64| {
        let polynomial = |of: [f64; 6]| of.iter().fold(0.0, |sum, one| sum * at + one);
        polynomial(over) / polynomial(under)
    };
    // From the lower end, as the approximation is given.
    let below = (1.0 - above).clamp(1e-300, 1.0 - 1e-16);
    let tail = |share: f64| quotient(TAIL, libm::sqrt(-2.0 * libm::log(share)));
    if below < BREAK {
        tail(below)
    } else if above < BREAK {
        -tail(above.max(1e-300))
    } else {
        let from_middle = below - 0.5;
        from_middle * quotient(MIDDLE, from_middle * from_middle)
    }
}

/// Draws a number of the exponential distribution with mean 1 from `stream` (inversion method).
pub fn exponential(stream: &mut Stream) -> f64 {
    -libm::log(1.0 - stream.random::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean, variance and the fraction above `limit` of some numbers.
    fn figures(numbers: &[f64], limit: f64) -> [f64; 3] {
        let n = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / n;
        let variance = numbers.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
        [mean, variance, numbers.iter().filter(|x| **x > limit).count() as f64 / n]
    }

    #[test]
    fn a_normal_number_is_exceeded_as_often_as_tables_say() {
        for (above, number) in [(0.5, 0.0), (0.158_655_254, 1.0), (0.025, 1.959_963_985), (1e-6, 4.753_424_309)] {
            assert!((normal_above(above) - number).abs() < 1e-6, "{above}: {}", normal_above(above));
            assert!((normal_above(1.0 - above) + number).abs() < 1e-6, "{above}");
        }
        assert!(normal_above(0.0) > 8.0 && normal_above(1.0) < -8.0);
    }

    #[test]
    fn normal_and_exponential_numbers_have_their_moments_and_tails() {
        let close = |actual: [f64; 3], expected: [f64; 3]| {
            let off =
                actual.iter().zip(expected).map(|(actual, expected)| (actual - expected).abs()).fold(0.0, f64::max);
            assert!(off < 0.01, "{actual:?}, not {expected:?}");
        };
        let mut stream = Seed::of_run(3).stream("numbers");
        let pairs: Vec<[f64; 2]> = (0..200_000).map(|_| normals(&mut stream)).collect();
        for axis in 0..2 {
            let numbers: Vec<f64> = pairs.iter().map(|pair| pair[axis]).collect();
            // Beyond two deviations lie 2.275 % (and as many below).
            close(figures(&numbers, 2.0), [0.0, 1.0, 0.02275]);
        }
        let both = pairs.iter().map(|[x, y]| x * y).sum::<f64>() / pairs.len() as f64;
        assert!(both.abs() < 0.01, "the two are uncorrelated: {both}");
        let numbers: Vec<f64> = (0..400_000).map(|_| exponential(&mut stream)).collect();
        close(figures(&numbers, 3.0), [1.0, 1.0, 0.0498]);
    }

    #[test]
    fn a_comparison_without_a_logarithm_is_that_of_the_number() {
        let (mut compared, mut drawn) = (Seed::of_run(4).stream("numbers"), Seed::of_run(4).stream("numbers"));
        for draw in 0..200_000 {
            let limit = f64::from(draw % 101) / 10.0 - 5.0;
            assert_eq!(normal_reaches(limit, &mut compared), normals(&mut drawn)[0] >= limit, "{limit}");
        }
        assert_eq!(compared, drawn, "both have drawn the same");
    }

    #[test]
    fn a_stream_depends_on_its_seed_and_its_name_only() {
        let draw = |seed: u64, name: &str| Seed::of_run(seed).stream(name).next_u64();
        assert_eq!(draw(1, "a"), draw(1, "a"));
        assert_ne!(draw(1, "a"), draw(2, "a"));
        assert_ne!(draw(1, "a"), draw(1, "b"));
    }
}
