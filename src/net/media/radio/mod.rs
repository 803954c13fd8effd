//! Model of a radio channel of IEEE 802.11. The code is pure: it reads no clock and does no I/O. This file holds the
//! channel's parameters and the interframe spaces that follow from them.
//!
//! `channel` is the channel that callers see. Its stations (`station`, `traffic`) share a medium: one that all of them
//! sense (`domain`), or one with space (`field`), in which each has its own view of the medium (`view`) and its own
//! receiver (`receiver`). `links` and `powers` tell who hears whom how well, and `reading` which frames can be read
//! among others. `rate` has the airtime of frames, `adaptation` the choice among rates, and `bianchi` a model of
//! saturation. The code knows no actor, message or clock. Numbers of clauses are those of IEEE 802.11-2016.
//! `docs/radio.md` lists what is not modelled.

mod adaptation;
pub mod bianchi;
pub mod channel;
pub mod counts;
mod domain;
mod field;
mod links;
mod powers;
mod presets;
pub mod rate;
mod reading;
mod receiver;
mod station;
mod traffic;
mod view;

pub use channel::{Channel, Delivery, Destination};
pub use counts::RadioCounts;
pub use powers::{Fading, Powers};
pub use presets::PRESETS;
pub use rate::{Band, Rate, Width};

use serde::{Deserialize, Serialize};

use crate::config::{self, ConfigError};
use crate::time::Span;

/// Topology of a radio channel: with or without an access point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Topology {
    /// Frames go through an access point, an additional station that transmits each of them a second time (IEEE
    /// 802.11-2016, 4.3.5).
    Infrastructure,
    /// Frames go directly from station to station, in one hop (IEEE 802.11-2016, 4.3.2).
    AdHoc,
}

/// Rule for a station's backoff counter in a slot in which another station starts to transmit. The counter is the
/// number of slots that a station still waits before it transmits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Counting {
    /// The counter is frozen in such a slot: only an idle slot decrements it (distributed coordination function, DCF,
    /// IEEE 802.11-2016, 10.3.4.3).
    Dcf,
    /// The counter is decremented also in a slot in which another station starts to transmit (EDCA, IEEE 802.11-2016,
    /// 10.22.2.4; and the model of Bianchi).
    Edca,
}

/// Idle time that stations wait after a frame that no station could decode (interframe space).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Recovery {
    /// Stations wait the usual interframe space, as after any other frame (as in the model of Bianchi).
    Difs,
    /// Stations wait the extended interframe space (EIFS): the usual one and the time of the acknowledgement that the
    /// frame would have had (dynamic EIFS, IEEE 802.11-2016, Table 10-5).
    Eifs,
    /// Stations wait the extended interframe space with an acknowledgement at the lowest mandatory rate of the band
    /// (IEEE 802.11-2016, 10.3.2.3.7).
    EifsBasic,
}

/// Contention window of a station after it has dropped a unicast frame at its retry limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AfterDrop {
    /// The window is the smallest again (IEEE 802.11-2016, 10.3.4.4).
    #[default]
    Reset,
    /// The window stays as it is, until a frame is acknowledged or as many transmissions in a row have failed as the
    /// retry limit allows for one frame and one more (IEEE 802.11-2020, 10.23.2.2, as ns-3 3.44 counts them).
    Keep,
}

/// Choice of the rates at which stations send unicast frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Adaptation {
    /// All at `Radio::rate`.
    #[default]
    Fixed,
    /// By Minstrel, the rate control of Linux: each station learns for each receiver which rate carries most, up to
    /// `Radio::rate`.
    Minstrel,
}

/// Parameters of a radio channel of IEEE 802.11, which all its stations share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Radio {
    /// Topology of the channel: with an access point, or ad hoc.
    pub channel: Topology,
    /// Data rate at which stations send unicast frames, which go to one receiver.
    pub rate: Rate,
    /// Data rate at which stations send multicast frames, which go to many receivers and are not acknowledged.
    pub basic_rate: Rate,
    /// Data rate at which stations send acknowledgements of unicast frames.
    pub ack_rate: Rate,
    /// Width of the channel \[MHz\]: 5, 10, 20 or 40.
    pub width_mhz: Width,
    /// Frequency band of the channel: 2.4 GHz or 5 GHz.
    pub band: Band,
    /// Slot time, the unit in which stations count their backoff \[us\].
    pub slot_us: u32,
    /// Short interframe space (SIFS), the time between a frame and its acknowledgement \[us\].
    pub sifs_us: u32,
    /// Arbitration interframe space number: slots that the medium must be idle after a SIFS before stations count their
    /// backoff. Two slots make a DIFS (IEEE 802.11-2016, 10.3.7).
    pub aifsn: u32,
    /// Propagation delay between any two stations \[us\].
    pub propagation_us: u32,
    /// Minimum contention window \[slots\]: the first backoff of a frame is drawn from 0 to this number. It is one less
    /// than a power of two.
    pub cw_min: u32,
    /// Maximum contention window \[slots\], up to which each failed transmission doubles the window. It is one less
    /// than a power of two.
    pub cw_max: u32,
    /// Rule for a station's backoff counter in a slot in which another station starts to transmit.
    pub counting: Counting,
    /// Idle time that stations wait after a frame that no station could decode.
    pub after_error: Recovery,
    /// Retry limit: largest number of retransmissions of an unacknowledged unicast frame after its first transmission.
    pub retries: u32,
    /// Capacity of the transmit queue of each station and of the access point \[frames\]. A frame that finds the queue
    /// full is lost.
    pub queue: usize,
    /// Length of the headers and trailers that are transmitted with each datagram \[bytes\].
    pub overhead_bytes: usize,
    /// Transmission range of a station \[m\]; `None` for unlimited. It must be `None` with an access point, which
    /// reaches all stations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range_m: Option<f32>,
    /// Probability that noise corrupts a frame, 0 to 1, independently for each receiver.
    pub noise_loss: f64,
    /// Load by stations of other networks: the airtime of the frames that they offer to the channel, as a share of all
    /// time, 0 to 1.
    pub background: f64,
    /// Distance up to which a station senses transmissions, and so waits for their end \[m\]; `None` for all. With it,
    /// each station has its own view of the medium, and frames collide at receivers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sense_m: Option<f32>,
    /// Powers of frames at receivers, from which follow who senses, who hears, and what collisions spoil; `None` for
    /// equal powers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub powers: Option<Powers>,
    /// Whether a receiver turns to a much stronger frame that begins within the preamble of the one it is reading.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub capture: bool,
    /// Position of the access point \[m\], world frame; `None`: all stations hear it, and it hears all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub access_point_m: Option<[f32; 2]>,
    /// Contention window of a station after it has dropped a unicast frame.
    #[serde(skip_serializing_if = "is_default")]
    pub after_drop: AfterDrop,
    /// Choice of the rates of unicast frames.
    #[serde(skip_serializing_if = "is_default")]
    pub adaptation: Adaptation,
    /// Period of beacons \[ms\]; 0: there are none. With an access point it sends them, otherwise a station that is
    /// drawn for each.
    #[serde(skip_serializing_if = "is_default")]
    pub beacon_ms: f64,
}

/// Returns whether a field has its usual value, with which files need not name it.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Bytes of headers and trailers that are transmitted with each UDP datagram \[bytes\]. They are, by clauses of IEEE
/// 802.11-2016: MAC header 24 (9.2.3), QoS control 2 (9.2.4.5), FCS 4; and LLC and SNAP 8 (RFC 1042), IPv4 20 (RFC
/// 791), UDP 8 (RFC 768).
pub(crate) const OVERHEAD_BYTES: usize = 24 + 2 + 4 + 8 + 20 + 8;
/// Bytes of a beacon beside its body: MAC header 24 and FCS 4 (IEEE 802.11-2016, 9.3.3.2).
const BEACON_OVERHEAD_BYTES: usize = 24 + 4;
/// Length of an acknowledgement (ACK) frame of IEEE 802.11 (9.3.1.4) \[bytes\].
pub(crate) const ACK_BYTES: usize = 14;

/// Time intervals of medium access, which follow from the parameters of a radio channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Times {
    /// Slot time, the unit in which stations count their backoff.
    pub slot: Span,
    /// Propagation delay between any two stations.
    pub(crate) propagation: Span,
    /// Arbitration interframe space (AIFS): idle time of the medium before stations count their backoff. It equals a
    /// DIFS if `Radio::aifsn` is 2.
    pub aifs: Span,
    /// Time from the arrival of a unicast frame at its receiver to the arrival of the acknowledgement at the sender.
    pub acknowledged: Span,
    /// Time from the end of a frame that could not be read until stations count their backoff again.
    pub(crate) recovery: Span,
}

impl Radio {
    /// Reads the parameters of a channel from TOML and checks them. Missing fields have the values of the preset
    /// `wifi`; an error names the wrong field.
    pub fn from_toml(text: &str) -> Result<Radio, ConfigError> {
        let radio: Radio = config::from_toml(text)?;
        radio.check()?;
        Ok(radio)
    }

    /// Checks the ranges of all parameters, and that the rates exist at the channel's width. An error names the wrong
    /// field.
    pub fn check(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        for (field, rate) in [("rate", self.rate), ("basic_rate", self.basic_rate), ("ack_rate", self.ack_rate)] {
            if !rate.fits(self.width_mhz) {
                let mhz = u8::from(self.width_mhz);
                return wrong(field, format!("there is no {rate} in a channel of {mhz} MHz; an ofdm rate fits"));
            }
        }
        for (field, value, least, most) in [
            ("slot_us", self.slot_us, 1, 1000),
            ("sifs_us", self.sifs_us, 1, 1000),
            ("aifsn", self.aifsn, 1, 15),
            ("propagation_us", self.propagation_us, 0, 100),
            ("cw_min", self.cw_min, 1, 32_767),
            ("cw_max", self.cw_max, 1, 32_767),
        ] {
            if !(least..=most).contains(&value) {
                return wrong(field, format!("{value} is not {least} to {most}"));
            }
        }
        if !(self.cw_min + 1).is_power_of_two() {
            return wrong("cw_min", format!("{} is not one less than a power of two", self.cw_min));
        }
        if self.cw_max < self.cw_min || !(self.cw_max + 1).is_power_of_two() {
            return wrong("cw_max", format!("{} is not one less than a power of two, from cw_min on", self.cw_max));
        }
        if !(1..=100_000).contains(&self.queue) {
            return wrong("queue", format!("{} is not 1 to 100000 frames", self.queue));
        }
        if self.overhead_bytes > 1000 {
            return wrong("overhead_bytes", format!("{} is not 0 to 1000", self.overhead_bytes));
        }
        if let Some(range_m) = self.range_m {
            if self.channel == Topology::Infrastructure {
                return wrong("range_m", "an access point reaches all stations; only 'ad-hoc' has a range".to_owned());
            }
            if range_m.is_nan() || range_m < 0.0 {
                return wrong("range_m", format!("{range_m} is not a distance"));
            }
        }
        for (field, share) in [("noise_loss", self.noise_loss), ("background", self.background)] {
            if !(0.0..=1.0).contains(&share) {
                return wrong(field, format!("{share} is not a share of 0 to 1"));
            }
        }
        if self.beacon_ms != 0.0 && !(1.0..=10_000.0).contains(&self.beacon_ms) {
            return wrong("beacon_ms", format!("{} is neither 0 nor 1 to 10000", self.beacon_ms));
        }
        self.check_space()
    }

    /// Checks what gives the channel space.
    fn check_space(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: &str| Err(ConfigError::field(field, reason));
        if let Some(sense_m) = self.sense_m {
            if sense_m.is_nan() || sense_m < 0.0 {
                return wrong("sense_m", "it is not a distance");
            }
            if self.range_m.is_some_and(|range_m| range_m > sense_m) {
                return wrong("sense_m", "a station senses what it can read; make it range_m or more");
            }
        }
        if self.access_point_m.is_some() {
            if self.channel == Topology::AdHoc {
                return wrong("access_point_m", "an ad-hoc channel has no access point");
            }
            if !self.has_space() {
                return wrong("access_point_m", "it says nothing without sense_m or powers");
            }
        }
        if self.capture && self.powers.is_none() {
            return wrong("capture", "it compares powers; give a table of powers");
        }
        let Some(powers) = &self.powers else { return Ok(()) };
        if self.range_m.is_some() || self.sense_m.is_some() {
            let field = if self.range_m.is_some() { "range_m" } else { "sense_m" };
            return wrong(field, "distances follow from powers; leave one of the two out");
        }
        if self.channel == Topology::Infrastructure && self.access_point_m.is_none() {
            return wrong(
                "access_point_m",
                "powers need the place of the access point; give it, or channel = \"ad-hoc\"",
            );
        }
        powers.check().map_err(|error| error.within("powers"))
    }

    /// Returns the channel with the topology `channel`, without what only the other one can have. A range is that of
    /// ad-hoc channels: an access point reaches all stations. Powers need the place of an access point, and without one
    /// all of them are equal.
    pub fn on(&self, channel: Topology) -> Radio {
        let mut radio = Radio { channel, ..self.clone() };
        match channel {
            Topology::AdHoc => radio.access_point_m = None,
            Topology::Infrastructure => {
                radio.range_m = None;
                radio.powers = radio.powers.filter(|_| radio.access_point_m.is_some());
                radio.capture &= radio.powers.is_some();
                radio.access_point_m =
                    radio.access_point_m.filter(|_| radio.sense_m.is_some() || radio.powers.is_some());
            }
        }
        radio
    }

    /// Returns whether each station has its own view of the medium. Without space, all stations sense each other.
    pub fn has_space(&self) -> bool {
        self.sense_m.is_some() || self.powers.is_some() || self.adaptation != Adaptation::Fixed
    }

    /// Returns whether what the channel carries depends on where stations are.
    pub fn needs_positions(&self) -> bool {
        self.range_m.is_some() || self.sense_m.is_some() || self.powers.is_some()
    }

    /// Returns the time intervals of medium access that follow from the channel's parameters.
    pub fn times(&self) -> Times {
        let us = |us: u32| Span::from_nanos(1000 * u64::from(us));
        let (slot, sifs, propagation) = (us(self.slot_us), us(self.sifs_us), us(self.propagation_us));
        let aifs = sifs + slot * u64::from(self.aifsn);
        let answer = sifs + self.ack_rate.airtime(ACK_BYTES, self.width_mhz, self.band);
        let recovery = match self.after_error {
            Recovery::Difs => aifs,
            Recovery::Eifs => answer + aifs,
            Recovery::EifsBasic => {
                sifs + self.band.lowest_mandatory().airtime(ACK_BYTES, self.width_mhz, self.band) + aifs
            }
        };
        Times { slot, propagation, aifs, acknowledged: answer + propagation, recovery }
    }

    /// Returns the time that a unicast frame with a datagram of `datagram_bytes` bytes takes on the air, with all
    /// headers.
    pub fn frame_airtime(&self, datagram_bytes: usize) -> Span {
        self.rate.airtime(self.overhead_bytes + datagram_bytes, self.width_mhz, self.band)
    }

    /// Returns the time that a multicast frame with a datagram of `datagram_bytes` bytes takes on the air, with all
    /// headers.
    pub fn multicast_airtime(&self, datagram_bytes: usize) -> Span {
        self.basic_rate.airtime(self.overhead_bytes + datagram_bytes, self.width_mhz, self.band)
    }

    /// Returns the part of a unicast frame's airtime that the datagram of `datagram_bytes` bytes itself takes, without
    /// the headers.
    pub(crate) fn payload_airtime(&self, datagram_bytes: usize) -> Span {
        let empty = self.rate.airtime(self.overhead_bytes, self.width_mhz, self.band);
        self.frame_airtime(datagram_bytes) - empty
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_sound_and_survives_toml() {
        for name in PRESETS {
            let preset = Radio::preset(name).unwrap();
            assert_eq!(Radio::from_toml(&toml::to_string(&preset).unwrap()), Ok(preset), "{name}");
        }
        assert!(Radio::preset("wire").is_none());
        assert_eq!(Radio::from_toml("").unwrap(), Radio::preset("wifi").unwrap());
    }

    #[test]
    fn a_broken_channel_is_refused_by_its_field() {
        let error = |text: &str| Radio::from_toml(text).unwrap_err().to_string();
        let unknown = error("rate = \"ofdm-55\"");
        assert!(unknown.contains("(rate)") && unknown.contains("no such rate"), "{unknown}");
        assert!(error("width_mhz = 10").starts_with("basic_rate"), "there is no DSSS in a narrow channel");
        assert!(error("width_mhz = 30").contains("5, 10, 20 or 40 MHz"));
        assert!(error("cw_min = 16").starts_with("cw_min"));
        assert!(error("cw_max = 7").starts_with("cw_max"));
        assert!(error("queue = 0").starts_with("queue"));
        assert!(error("noise_loss = 1.5").starts_with("noise_loss"));
        assert!(error("background = nan").starts_with("background"));
        assert!(error("range_m = 3.0").starts_with("range_m"));
        assert!(error("channel = \"ad-hoc\"\nrange_m = -1.0").starts_with("range_m"));
        assert!(error("antenna = 2").contains("unknown field"));
    }

    #[test]
    fn intervals_of_the_bianchi_system_match_the_published_table() {
        let radio = Radio::bianchi(3);
        let times = radio.times();
        assert_eq!(times.aifs, Span::from_nanos(128_000));
        // Ts = 8982 us and Tc = 8713 us of basic access.
        let success = radio.frame_airtime(1023) + times.propagation + times.acknowledged + times.aifs;
        assert_eq!(success, Span::from_nanos(8_982_000));
        let collision = radio.frame_airtime(1023) + times.propagation + times.recovery;
        assert_eq!(collision, Span::from_nanos(8_713_000));
        assert_eq!(radio.payload_airtime(1023), Span::from_nanos(8_184_000));
    }
}
