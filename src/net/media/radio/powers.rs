//! Powers of frames at their receivers: path loss over distance, walls, shadowing and fading.

use std::f64::consts::{FRAC_1_SQRT_2, LN_10};

use serde::{Deserialize, Serialize};

use crate::config::{ConfigError, in_range};
use crate::random::{self, RngExt, Stream};

/// Fading of a frame's power at a receiver by reflections, anew for each frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fading {
    /// The power is that of the path.
    #[default]
    None,
    /// The power is exponentially distributed around that of the path: many reflections and no direct view (Rayleigh).
    Rayleigh,
}

/// Powers of frames at their receivers, and what receivers make of them.
///
/// At distance d \[m\] a frame has the power P = `tx_dbm` - `reference_db` - 10 `exponent` log10(d), less `wall_db` for
/// each wall between (log-distance model, T. S. Rappaport, Wireless Communications, 2nd ed., 4.9). To that come
/// shadowing and fading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Powers {
    /// Transmit power of a station \[dBm\].
    pub tx_dbm: f64,
    /// Loss at a distance of 1 m \[dB\]; also of shorter ones.
    pub reference_db: f64,
    /// Exponent of the loss over distance: 2 in free space, 3 to 4 between walls.
    pub exponent: f64,
    /// Standard deviation of the shadowing, a normal number \[dB\] drawn for each frame and receiver.
    pub shadowing_db: f64,
    /// Fading of each frame at each receiver.
    pub fading: Fading,
    /// Loss at each wall of the scenario that the straight path crosses \[dB\].
    pub wall_db: f64,
    /// Noise of a receiver \[dBm\]: thermal noise of 20 MHz, -101 dBm, and a noise figure.
    pub noise_dbm: f64,
    /// Power from which on a station senses a frame, and so waits for its end \[dBm\].
    pub sense_dbm: f64,
    /// Least power at which a receiver finds the preamble of a frame \[dBm\].
    pub detect_dbm: f64,
    /// Least ratio of the power to noise and other frames in the first 4 us at which a receiver finds a preamble
    /// \[dB\].
    pub detect_db: f64,
}

impl Default for Powers {
    /// Returns 16 dBm and an exponent of 3 at 2.4 GHz, with the receivers that ns-3 3.44 assumes: preambles are found
    /// and sensed from -82 dBm on, the least sensitivity of IEEE 802.11-2016, 17.3.10.6.
    fn default() -> Powers {
        Powers {
            tx_dbm: 16.0,
            // Free space at 2.4 GHz: 20 log10(4 pi f / c).
            reference_db: 40.05,
            exponent: 3.0,
            shadowing_db: 0.0,
            fading: Fading::None,
            wall_db: 0.0,
            noise_dbm: -94.0,
            sense_dbm: -82.0,
            detect_dbm: -82.0,
            detect_db: 4.0,
        }
    }
}

/// Largest gain by Rayleigh fading that is looked for \[dB\]: one frame in twenty thousand has more.
const MOST_FADING_DB: f64 = 10.0;
/// Largest gain by shadowing that is looked for, in standard deviations.
const MOST_SHADOWING: f64 = 3.5;

impl Powers {
    /// Checks the ranges of all numbers. An error names the wrong one.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        in_range("tx_dbm", self.tx_dbm, (-40.0, 60.0))?;
        in_range("reference_db", self.reference_db, (0.0, 120.0))?;
        in_range("exponent", self.exponent, (1.0, 8.0))?;
        in_range("shadowing_db", self.shadowing_db, (0.0, 20.0))?;
        in_range("wall_db", self.wall_db, (0.0, 100.0))?;
        in_range("noise_dbm", self.noise_dbm, (-120.0, 0.0))?;
        in_range("sense_dbm", self.sense_dbm, (-120.0, 0.0))?;
        in_range("detect_dbm", self.detect_dbm, (-120.0, 0.0))?;
        in_range("detect_db", self.detect_db, (-20.0, 30.0))
    }

    /// Returns the power \[dBm\] at a distance \[m\] behind a number of walls, without shadowing and fading.
    pub fn of_path(&self, distance_m: f64, walls: usize) -> f64 {
        decibels(Scale::of(self).of_path(distance_m * distance_m, walls))
    }

    /// Returns whether each frame has a power of its own.
    pub(super) fn varies(&self) -> bool {
        self.shadowing_db > 0.0 || self.fading != Fading::None
    }

    /// Returns the least power that matters to a receiver \[dBm\]: less is neither sensed nor read, and disturbs less
    /// than noise does.
    pub(super) fn floor_dbm(&self) -> f64 {
        self.noise_dbm.min(self.detect_dbm).min(self.sense_dbm)
    }

    /// Returns the least power of a path \[dBm\] whose frames may matter.
    pub(super) fn least_path_dbm(&self) -> f64 {
        self.floor_dbm() - self.most_fading_db() - MOST_SHADOWING * self.shadowing_db
    }

    fn most_fading_db(&self) -> f64 {
        if self.fading == Fading::None { 0.0 } else { MOST_FADING_DB }
    }

    /// Returns the distance \[m\] beyond which no frame matters.
    pub(super) fn reach_m(&self) -> f64 {
        let loss = self.tx_dbm - self.reference_db - self.least_path_dbm();
        libm::exp(loss / (10.0 * self.exponent) * LN_10).max(1.0)
    }
}

/// Powers as ratios and in milliwatts, in which they are computed for each frame.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Scale {
    /// Power at a distance of 1 m \[mW\].
    base: f64,
    /// Half of the exponent, for squared distances.
    half_exponent: f64,
    /// The exponent, if it is a small whole number: then powers are products.
    whole: Option<u8>,
    /// Ratio behind a wall.
    wall: f64,
    /// Standard deviation of the logarithm of the shadowing; 0 for none.
    shadowing: f64,
    fades: bool,
    /// Least power that matters to a receiver \[mW\].
    floor: f64,
    /// Least power of a path whose frames may matter \[mW\].
    pub least_path: f64,
    /// Least power that is sensed \[mW\].
    sense: f64,
}

impl Scale {
    /// Returns the powers of a channel.
    pub fn of(powers: &Powers) -> Scale {
        Scale {
            base: milliwatts(powers.tx_dbm - powers.reference_db),
            half_exponent: 0.5 * powers.exponent,
            whole: (1..=6).find(|whole| f64::from(*whole) == powers.exponent),
            wall: milliwatts(-powers.wall_db),
            shadowing: powers.shadowing_db / 10.0 * LN_10,
            fades: powers.fading == Fading::Rayleigh,
            floor: milliwatts(powers.floor_dbm()),
            least_path: milliwatts(powers.least_path_dbm()),
            sense: milliwatts(powers.sense_dbm),
        }
    }

    /// Returns the power \[mW\] over a path with the square of its length \[m^2\] behind a number of walls, without
    /// shadowing and fading.
    pub fn of_path(&self, squared_m2: f64, walls: usize) -> f64 {
        let squared = squared_m2.max(1.0);
        let over = match self.whole {
            Some(whole) => {
                let odd = if whole % 2 == 1 { squared.sqrt() } else { 1.0 };
                1.0 / (0..whole / 2).fold(odd, |over, _| over * squared)
            }
            None => libm::pow(squared, -self.half_exponent),
        };
        (0..walls).fold(self.base * over, |power, _| power * self.wall)
    }

    /// Returns the probability that shadowing lifts a path of this power \[mW\] to where a frame may matter.
    pub fn chance(&self, path: f64) -> f64 {
        if self.shadowing == 0.0 {
            return 1.0;
        }
        let most_fading = if self.fades { milliwatts(MOST_FADING_DB) } else { 1.0 };
        let lacks = libm::log(self.floor / (most_fading * path));
        0.5 * libm::erfc(lacks / self.shadowing * FRAC_1_SQRT_2)
    }

    /// Returns the power of one frame \[mW\], from that of its path and the path's `chance`: draws shadowing and
    /// fading. `None` if it is so weak that it does not matter.
    pub fn of_frame(&self, path: f64, chance: f64, stream: &mut Stream) -> Option<f64> {
        let mut power = path;
        if self.shadowing > 0.0 {
            let above: f64 = stream.random();
            if above >= chance {
                return None;
            }
            power *= libm::exp(self.shadowing * random::normal_above(above));
        }
        if self.fades {
            power *= random::exponential(stream);
        }
        Some(power).filter(|power| *power >= self.floor)
    }

    /// Returns whether a frame of this power \[mW\] matters to a receiver.
    pub fn matters(&self, power: f64) -> bool {
        power >= self.floor
    }

    /// Returns whether a frame of this power \[mW\] is sensed.
    pub fn is_sensed(&self, power: f64) -> bool {
        power >= self.sense
    }
}

/// Returns a power in milliwatts for one in dBm.
pub(super) fn milliwatts(dbm: f64) -> f64 {
    libm::exp(dbm / 10.0 * LN_10)
}

/// Returns a ratio of powers in decibels.
pub(super) fn decibels(ratio: f64) -> f64 {
    10.0 * libm::log10(ratio)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;

    #[test]
    fn power_falls_with_distance_and_walls() {
        let powers = Powers { wall_db: 6.0, ..Powers::default() };
        assert!((powers.of_path(1.0, 0) - (16.0 - 40.05)).abs() < 1e-9);
        assert!((powers.of_path(100.0, 0) - (16.0 - 40.05 - 60.0)).abs() < 1e-9);
        assert!((powers.of_path(100.0, 2) - (16.0 - 40.05 - 72.0)).abs() < 1e-9);
        for exponent in [2.0, 3.0, 5.0] {
            let [near, far] = [0.0, 1e-9].map(|more| Powers { exponent: exponent + more, ..powers });
            assert!((near.of_path(300.0, 0) - far.of_path(300.0, 0)).abs() < 1e-6, "products are powers");
        }
        let reach = powers.reach_m();
        assert!((powers.of_path(reach, 0) - powers.floor_dbm()).abs() < 1e-6);
    }

    #[test]
    fn faded_powers_have_the_published_distribution() {
        let powers = Powers { fading: Fading::Rayleigh, ..Powers::default() };
        let mut stream = Seed::of_run(1).stream("fading");
        let path = milliwatts(-60.0);
        let mut drawn = |powers: &Powers| {
            let scale = Scale::of(powers);
            scale.of_frame(path, scale.chance(path), &mut stream).map(decibels)
        };
        let below = (0..20_000).filter(|_| drawn(&powers).is_none_or(|dbm| dbm < -70.0)).count();
        // Below a tenth of the mean: 1 - exp(-0.1).
        assert!((below as f64 / 20_000.0 - 0.0952).abs() < 0.008, "{below}");
        let powers = Powers { shadowing_db: 4.0, ..Powers::default() };
        let above = (0..20_000).filter(|_| drawn(&powers).is_some_and(|dbm| dbm > -56.0)).count();
        assert!((above as f64 / 20_000.0 - 0.1587).abs() < 0.01, "{above}");
    }

    #[test]
    fn paths_whose_frames_seldom_matter_are_left_out_as_often_as_by_each_power() {
        for fading in [Fading::None, Fading::Rayleigh] {
            let powers = Powers { shadowing_db: 4.0, fading, ..Powers::default() };
            let mut stream = Seed::of_run(1).stream("fading");
            let scale = Scale::of(&powers);
            let mut matters = |path: f64, chance: f64| {
                (0..40_000).filter(|_| scale.of_frame(path, chance, &mut stream).is_some()).count() as f64 / 4e4
            };
            for path in [-90.0, -96.0, -100.0].map(milliwatts) {
                let (all, some) = (matters(path, 1.0), matters(path, scale.chance(path)));
                assert!((all - some).abs() < 0.01, "{path} mW: {all} and {some}");
            }
        }
    }
}
