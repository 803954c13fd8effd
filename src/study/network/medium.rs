//! What a network study sends over: a radio channel or shaped links, by name or as a file; and one of them at work.

use serde::{Deserialize, Serialize};

use super::shaped::{Links, Shaped};
use crate::config::{self, ConfigError};
use crate::net::media::radio::{self, Channel, Delivery, Destination, Radio};
use crate::random::Seed;
use crate::time::Time;

/// What messages are sent over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Medium {
    /// A channel of 802.11 that all stations share.
    Radio(Radio),
    /// A shaped link for each station.
    Shaped(Shaped),
}

/// The name of the medium that is no radio.
const SHAPED: &str = "shaped";

impl Medium {
    /// The medium of that name.
    pub fn named(name: &str) -> Option<Medium> {
        if name == SHAPED {
            return Some(Medium::Shaped(Shaped::megabit()));
        }
        Radio::preset(name).map(Medium::Radio)
    }

    /// All names.
    pub fn names() -> String {
        radio::PRESETS.into_iter().chain([SHAPED]).collect::<Vec<_>>().join(", ")
    }

    /// Reads a medium from TOML and checks it: a radio file, or shaped links if it says `rate_bit_s`.
    pub fn from_toml(text: &str) -> Result<Medium, ConfigError> {
        let table: toml::Table = config::from_toml(text)?;
        if !table.contains_key("rate_bit_s") {
            return Radio::from_toml(text).map(Medium::Radio);
        }
        let shaped: Shaped = config::from_toml(text)?;
        shaped.check()?;
        Ok(Medium::Shaped(shaped))
    }

    /// Checks that there can be such a medium.
    pub fn check(&self) -> Result<(), ConfigError> {
        match self {
            Medium::Radio(radio) => radio.check(),
            Medium::Shaped(shaped) => shaped.check(),
        }
    }
}

/// A medium at work.
pub enum Air<T> {
    /// A radio channel.
    Radio(Box<Channel<T>>),
    /// Shaped links.
    Shaped(Box<Links<T>>),
}

impl<T: Clone> Air<T> {
    /// A silent medium with so many stations.
    pub fn new(medium: Medium, stations: u16, seed: &Seed) -> Air<T> {
        match medium {
            Medium::Radio(radio) => Air::Radio(Box::new(Channel::new(radio, stations, seed))),
            Medium::Shaped(shaped) => Air::Shaped(Box::new(Links::new(shaped, stations, seed))),
        }
    }

    /// A station is given a datagram of so many bytes to send.
    pub fn offer(&mut self, now: Time, from: u16, to: Destination, bytes: usize, token: T) {
        match self {
            Air::Radio(channel) => channel.offer(now, from, to, bytes, token),
            Air::Shaped(links) => links.offer(now, from, to, bytes, token),
        }
    }

    /// When anything is next due.
    pub fn wake_at(&self) -> Option<Time> {
        match self {
            Air::Radio(channel) => channel.wake_at(),
            Air::Shaped(links) => links.wake_at(),
        }
    }

    /// Does what is due.
    pub fn wake(&mut self, now: Time, deliveries: &mut Vec<Delivery<T>>) {
        match self {
            Air::Radio(channel) => channel.wake(now, deliveries),
            Air::Shaped(links) => links.wake(now, deliveries),
        }
    }

    /// For how long it was taken by the stations until now \[s\].
    pub fn taken_s(&self, now: Time) -> f64 {
        match self {
            Air::Radio(channel) => channel.counts(now).airtime_ns as f64 * 1e-9,
            Air::Shaped(links) => links.taken_s(),
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
