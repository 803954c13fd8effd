//! Receiver of one station of a channel with space: which transmissions are at it, and which one it reads.

use serde::{Deserialize, Serialize};

use super::Radio;
use super::links::EQUAL_POWER;
use super::powers::{decibels, milliwatts};
use super::rate::Rate;
use super::reading::ln_read;
use crate::time::{Span, Time};

/// Ratio of a frame's power to noise and others from which on every rate is read: 35 dB, at which one frame in 10^16 of
/// the fastest one is not.
const CLEAR_RATIO: f64 = 3162.0;
/// Time from a frame's beginning within which a receiver finds its preamble (IEEE 802.11-2016, 17.3.10.6).
const DETECTION: Span = Span::from_nanos(4_000);
/// Time from a frame's beginning within which a receiver may turn to another one: its preamble.
const PREAMBLE: Span = Span::from_nanos(16_000);
/// Ratio of the powers from which on a receiver turns to another frame \[dB\], as ns-3 3.44 has it.
const CAPTURE_DB: f64 = 5.0;
/// Ratio of the powers at which a preamble is found on a channel without powers \[dB\], as ns-3 3.44 has it.
const DETECT_DB: f64 = 4.0;

/// Thresholds of the receivers of a channel.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Thresholds {
    /// Power of the noise \[mW\].
    noise: f64,
    /// Least power of a frame whose preamble is found \[mW\].
    detect: f64,
    /// Least ratio of a frame's power to noise and others at which its preamble is found.
    detect_ratio: f64,
    /// Ratio of powers at which a receiver turns to another frame; infinite if it never does.
    capture_ratio: f64,
}

impl Thresholds {
    /// Returns the thresholds of a channel with these parameters.
    pub fn new(radio: &Radio) -> Thresholds {
        let capture_ratio = if radio.capture { milliwatts(CAPTURE_DB) } else { f64::INFINITY };
        match &radio.powers {
            Some(powers) => Thresholds {
                noise: milliwatts(powers.noise_dbm),
                detect: milliwatts(powers.detect_dbm),
                detect_ratio: milliwatts(powers.detect_db),
                capture_ratio,
            },
            None => Thresholds { noise: 0.0, detect: EQUAL_POWER, detect_ratio: milliwatts(DETECT_DB), capture_ratio },
        }
    }

    /// Returns whether a frame of this power is read by itself, in some share of cases.
    #[inline]
    pub fn hears(&self, power: f64) -> bool {
        power >= self.detect && power >= self.detect_ratio * self.noise
    }

    /// Returns whether a frame of this power is read for sure, if nothing disturbs it.
    pub fn is_clear(&self, power: f64) -> bool {
        self.hears(power) && power >= CLEAR_RATIO * self.noise
    }

    /// Returns how a receiver reads a whole frame that nothing disturbs, from its beginning at `since` to its end at
    /// `now`; `None` if it does not hear it.
    #[inline]
    pub fn undisturbed(&self, since: Time, now: Time, frame: Arrival) -> Option<Read> {
        let ln_read = self.ln_read(frame, 0.0, now.since(since));
        self.hears(frame.power).then_some(Read { ln_read, alone: true })
    }

    /// Returns the logarithm of the probability that a part of a frame is read, beside others of the power `others`
    /// \[mW\].
    #[inline]
    fn ln_read(&self, frame: Arrival, others: f64, part: Span) -> f64 {
        let others = self.noise + others;
        if others == 0.0 || frame.power >= CLEAR_RATIO * others || part == Span::ZERO {
            return 0.0;
        }
        ln_read(frame.rate, decibels(frame.power / others), frame.bits_per_s * part.as_secs())
    }
}

/// Frame at a receiver.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Arrival {
    /// Number of the transmission.
    pub air: u32,
    /// Power at the receiver \[mW\].
    pub power: f64,
    /// Rate of the frame.
    pub rate: Rate,
    /// Bits of the frame for each second of its time on the air.
    pub bits_per_s: f64,
}

/// Frame that a receiver reads.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Reading {
    arrival: Arrival,
    began: Time,
    /// Time up to which `ln_read` counts.
    counted: Time,
    /// Logarithm of the probability that all so far was read.
    ln_read: f64,
    /// Whether no other frame has come meanwhile.
    alone: bool,
}

/// How a receiver has read a frame up to its end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Read {
    /// Logarithm of the probability that the frame is read.
    pub ln_read: f64,
    /// Whether no other frame has disturbed it.
    pub alone: bool,
}

/// Receiver of one station.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Receiver {
    /// Frames with power at the station.
    arrivals: Vec<(u32, f64)>,
    reading: Option<Reading>,
}

impl Receiver {
    /// Handles that the station itself sends: what it reads is lost.
    pub fn stop(&mut self) {
        self.reading = None;
    }

    /// Handles the beginning of a frame at the station, which may be sending itself.
    pub fn arrive(&mut self, now: Time, arrival: Arrival, sending: bool, thresholds: &Thresholds) {
        self.count(now, thresholds);
        self.arrivals.push((arrival.air, arrival.power));
        if sending {
            return;
        }
        let all = self.power();
        let others = |power: f64| thresholds.noise + (all - power).max(0.0);
        if let Some(reading) = &mut self.reading {
            // Up to now nothing has disturbed it.
            (reading.alone, reading.counted) = (false, now);
            let age = now.since(reading.began);
            let power = reading.arrival.power;
            if age < DETECTION {
                if power >= thresholds.detect_ratio * others(power) {
                    return;
                }
            } else if age > PREAMBLE || arrival.power <= thresholds.capture_ratio * others(arrival.power) {
                return;
            }
            self.reading = None;
        }
        let found =
            arrival.power >= thresholds.detect && arrival.power >= thresholds.detect_ratio * others(arrival.power);
        if found {
            let alone = self.arrivals.len() == 1;
            self.reading = Some(Reading { arrival, began: now, counted: now, ln_read: 0.0, alone });
        }
    }

    /// Handles the end of a frame at the station; returns how it was read, or `None` if it was not.
    pub fn leave(&mut self, now: Time, air: u32, thresholds: &Thresholds) -> Option<Read> {
        self.count(now, thresholds);
        self.arrivals.retain(|(other, _)| *other != air);
        let reading = self.reading.take_if(|reading| reading.arrival.air == air)?;
        Some(Read { ln_read: reading.ln_read, alone: reading.alone })
    }

    /// Returns the power of all frames at the station \[mW\].
    fn power(&self) -> f64 {
        self.arrivals.iter().map(|(_, power)| power).sum()
    }

    /// Counts the bits of the frame that is read up to `now`, with the noise and the other frames of that time.
    fn count(&mut self, now: Time, thresholds: &Thresholds) {
        let others = match &self.reading {
            None => return,
            Some(reading) if reading.alone => 0.0,
            Some(reading) => (self.power() - reading.arrival.power).max(0.0),
        };
        let Some(reading) = &mut self.reading else { return };
        let part = now.since(std::mem::replace(&mut reading.counted, now));
        reading.ln_read += thresholds.ln_read(reading.arrival, others, part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::media::radio::{Powers, Topology};

    /// Returns the shares in which two frames at 6 Mbit/s of 260 bytes are read, of which the second is stronger by
    /// `difference_db` and begins `later_us` later.
    fn two(difference_db: f64, later_us: u64, capture: bool) -> [f64; 2] {
        let powers = Some(Powers::default());
        let radio = Radio { channel: Topology::AdHoc, powers, capture, ..Radio::default() };
        let thresholds = Thresholds::new(&radio);
        let rate = Rate::named("ofdm-6");
        let took = rate.airtime(260, radio.width_mhz, radio.band);
        let arrival =
            |air: u32, dbm: f64| Arrival { air, power: milliwatts(dbm), rate, bits_per_s: 2080.0 / took.as_secs() };
        let mut receiver = Receiver::default();
        let later = Span::from_nanos(1000 * later_us);
        receiver.arrive(Time::ZERO, arrival(0, -50.0), false, &thresholds);
        receiver.arrive(Time::ZERO + later, arrival(1, -50.0 + difference_db), false, &thresholds);
        let share = |read: Option<Read>| read.map_or(0.0, |read| libm::exp(read.ln_read));
        let first = share(receiver.leave(Time::ZERO + took, 0, &thresholds));
        [first, share(receiver.leave(Time::ZERO + later + took, 1, &thresholds))]
    }

    #[test]
    fn overlapping_frames_are_read_as_in_ns_3() {
        let near = |got: [f64; 2], expected: [f64; 2]| (0..2).all(|at| (got[at] - expected[at]).abs() < 0.05);
        assert!(near(two(0.0, 0, false), [0.0, 0.0]), "no preamble is found");
        assert!(near(two(5.0, 0, false), [0.0, 1.0]), "that of the stronger one is");
        assert!(near(two(3.0, 0, false), [0.0, 0.0]));
        assert!(near(two(0.0, 20, false), [0.75, 0.0]), "{:?}", two(0.0, 20, false));
        assert!(near(two(-1.0, 20, false), [1.0, 0.0]), "a weaker later one does no harm");
        assert!(near(two(2.0, 20, false), [0.0, 0.0]), "a stronger later one spoils both");
        assert!(near(two(10.0, 10, false), [0.0, 0.0]));
        assert!(near(two(10.0, 10, true), [0.0, 1.0]), "with capture, the receiver turns to it in time");
        assert!(near(two(10.0, 20, true), [0.0, 0.0]), "and not later");
    }

    #[test]
    fn a_station_that_sends_reads_nothing() {
        let radio = Radio { channel: Topology::AdHoc, sense_m: Some(30.0), ..Radio::default() };
        let thresholds = Thresholds::new(&radio);
        let arrival = Arrival { air: 1, power: EQUAL_POWER, rate: radio.rate, bits_per_s: 1e6 };
        let mut receiver = Receiver::default();
        receiver.arrive(Time::ZERO, arrival, false, &thresholds);
        receiver.stop();
        assert!(receiver.leave(Time::ZERO + Span::from_nanos(1000), 1, &thresholds).is_none());
        receiver.arrive(Time::ZERO, arrival, true, &thresholds);
        assert!(receiver.leave(Time::ZERO, 1, &thresholds).is_none());
    }
}
