//! Medium of a network study, a radio channel or shaped links, by name or from a file; and its emulator.

use serde::{Deserialize, Serialize};

use super::shaped::{Links, Shaped};
use murmurate::config::{self, ConfigError};
use murmurate::messages::geometry::Vec2;
use murmurate::net::media::radio::channel::Reached;
use murmurate::net::media::radio::{self, Channel, Delivery, Destination, Radio};
use murmurate::random::Seed;
use murmurate::time::Time;

/// Medium between the stations of a network study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Medium {
    /// Channel of IEEE 802.11 that all stations share.
    Radio(Radio),
    /// Wired network with a link for each station, shaped by a token bucket.
    Shaped(Shaped),
}

/// Name of the preset with shaped links.
const SHAPED: &str = "shaped";

impl Medium {
    /// Returns the preset medium with this name: a preset of the radio, or `shaped`. `None` if there is none.
    pub fn named(name: &str) -> Option<Medium> {
        if name == SHAPED {
            return Some(Medium::Shaped(Shaped::megabit()));
        }
        Radio::preset(name).map(Medium::Radio)
    }

    /// Returns the names of all preset media as text, for error messages.
    pub fn names() -> String {
        radio::PRESETS.into_iter().chain([SHAPED]).collect::<Vec<_>>().join(", ")
    }

    /// Reads a medium from TOML and checks it: shaped links if the text has the field `rate_bit_s`, otherwise a radio.
    /// An error names the field.
    pub fn from_toml(text: &str) -> Result<Medium, ConfigError> {
        let table: toml::Table = config::from_toml(text)?;
        if !table.contains_key("rate_bit_s") {
            return Radio::from_toml(text).map(Medium::Radio);
        }
        let shaped: Shaped = config::from_toml(text)?;
        shaped.check()?;
        Ok(Medium::Shaped(shaped))
    }

    /// Returns whether the medium carries messages by the places of stations.
    pub fn needs_places(&self) -> bool {
        matches!(self, Medium::Radio(radio) if radio.needs_positions())
    }

    /// Checks the ranges of the medium's parameters. An error names the field.
    pub fn check(&self) -> Result<(), ConfigError> {
        match self {
            Medium::Radio(radio) => radio.check(),
            Medium::Shaped(shaped) => shaped.check(),
        }
    }
}

/// Emulator of the medium between the stations of a network study: delivers their datagrams with delay and loss. `T` is
/// what identifies a datagram in its deliveries.
pub enum MediumEmulator<T> {
    /// Emulator of a radio channel.
    Radio(Box<Channel<T>>),
    /// Emulator of shaped links.
    Shaped(Box<Links<T>>),
}

impl<T: Clone> MediumEmulator<T> {
    /// Returns an emulator of the medium with this number of stations and empty queues.
    pub fn new(medium: Medium, stations: u16, seed: &Seed) -> MediumEmulator<T> {
        match medium {
            Medium::Radio(radio) => MediumEmulator::Radio(Box::new(Channel::new(radio, stations, seed))),
            Medium::Shaped(shaped) => MediumEmulator::Shaped(Box::new(Links::new(shaped, stations, seed))),
        }
    }

    /// Sets the place of each station \[m\]. It matters on a radio channel alone.
    pub fn place(&mut self, places: &[[f32; 2]]) {
        if let MediumEmulator::Radio(channel) = self {
            (0..).zip(places).for_each(|(station, place)| channel.place(station, Vec2::from(*place)));
        }
    }

    /// Returns whom a transmission of the station `from` reaches on a radio channel, by the places; none on shaped
    /// links.
    pub fn reached(&self, from: u16) -> Vec<Reached> {
        match self {
            MediumEmulator::Radio(channel) => channel.reached(from),
            MediumEmulator::Shaped(_) => Vec::new(),
        }
    }

    /// Queues a datagram of `bytes` bytes at the station `from`, for the receivers `to`; the medium adds headers to it.
    /// `token` is returned in its deliveries. The datagram is dropped if the station's queue is full.
    pub fn offer(&mut self, now: Time, from: u16, to: Destination, bytes: usize, token: T) {
        match self {
            MediumEmulator::Radio(channel) => channel.offer(now, from, to, bytes, token),
            MediumEmulator::Shaped(links) => links.offer(now, from, to, bytes, token),
        }
    }

    /// Returns the time at which `wake` has to be called next; `None` if there is nothing to do without a new datagram.
    pub fn wake_at(&self) -> Option<Time> {
        match self {
            MediumEmulator::Radio(channel) => channel.wake_at(),
            MediumEmulator::Shaped(links) => links.wake_at(),
        }
    }

    /// Advances the medium to the time `now`, and appends the datagrams that have arrived to `deliveries`.
    pub fn wake(&mut self, now: Time, deliveries: &mut Vec<Delivery<T>>) {
        match self {
            MediumEmulator::Radio(channel) => channel.wake(now, deliveries),
            MediumEmulator::Shaped(links) => links.wake(now, deliveries),
        }
    }

    /// Returns the time \[s\] in which the medium was busy with the stations' frames, from the start until `now`; for
    /// shaped links the mean over the stations.
    pub fn busy_s(&self, now: Time) -> f64 {
        match self {
            MediumEmulator::Radio(channel) => channel.counts(now).airtime_ns as f64 * 1e-9,
            MediumEmulator::Shaped(links) => links.busy_s(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_a_radio_or_shaped_links() {
        assert!(matches!(Medium::from_toml("retries = 3"), Ok(Medium::Radio(Radio { retries: 3, .. }))));
        let shaped =
            Medium::from_toml("rate_bit_s = 1e6\nburst_bytes = 1600\nqueue_bytes = 9000\nloss = 0.16").unwrap();
        assert!(matches!(shaped, Medium::Shaped(Shaped { queue_bytes: 9000, overhead_bytes: 42, .. })));
        assert!(Medium::from_toml("rate_bit_s = -1.0\nburst_bytes = 1600\nqueue_bytes = 9000").is_err());
        assert!(Medium::named("shaped").is_some() && Medium::named("telepathy").is_none());
    }
}
