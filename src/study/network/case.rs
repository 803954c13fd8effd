//! What a network study varies, as data, and the cases that follow.

use serde::{Deserialize, Serialize};

use super::medium::Medium;
use super::talk::AROUND_BYTES;
use crate::config::ConfigError;
use crate::messages::wire::MAX_FEATURES;
use crate::net::media::radio::Topology;

/// How a message finds its readers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Addressing {
    /// A datagram of its own for every reader.
    Unicast,
    /// One datagram for all.
    Multicast,
}

/// How sure a message is to arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Assurance {
    /// It is sent once (the project's link layer, as the next two).
    BestEffort,
    /// It is sent again a little later while readers report loss.
    Repeat,
    /// Whoever misses it asks for it, while nothing newer is there.
    Nack,
    /// RTPS reliable: heartbeats, positive acknowledgements, repairs.
    Ack,
    /// The same with positive acknowledgements disabled: a reader answers a heartbeat only when it misses something.
    AckOff,
}

impl Assurance {
    /// Every one of them.
    pub const ALL: [Assurance; 5] =
        [Assurance::BestEffort, Assurance::Repeat, Assurance::Nack, Assurance::Ack, Assurance::AckOff];
}

/// How stations are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Network {
    /// A radio channel with an access point.
    Infrastructure,
    /// A radio channel from station to station.
    AdHoc,
    /// Not a radio: each station's own shaped link.
    Shaped,
}

/// How much an RTPS writer keeps for repairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum History {
    /// The newest so many samples (KEEP_LAST).
    Last(u32),
    /// Everything that not all readers have acknowledged (KEEP_ALL).
    All,
}

/// How it was found what becomes of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// On an emulated medium.
    Emulated,
    /// Between hosts.
    Live,
}

impl Source {
    /// Both.
    pub const ALL: [Source; 2] = [Source::Emulated, Source::Live];
}

/// One case: everything that decides what becomes of the messages.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// How stations are connected.
    pub network: Network,
    /// How messages find their readers.
    pub addressing: Addressing,
    /// How sure they are to arrive.
    pub reliability: Assurance,
    /// How often the medium access sends a unicast frame again. Multicast frames are never sent again; their way up to
    /// an access point is.
    pub retries: u32,
    /// Messages of all stations together \[1/s\].
    pub rate: f64,
}

/// A whole sweep.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sweep {
    /// Stations; each publishes, and each of the others is to hear it.
    pub stations: u16,
    /// Content of a message \[bytes\]: sender, number, stamp and two floats of position (24), the rest features.
    pub bytes: usize,
    /// What it is sent over.
    pub medium: Medium,
    /// Messages of all stations together \[1/s\].
    pub rates: Vec<f64>,
    /// See `Case`.
    pub networks: Vec<Network>,
    /// See `Case`.
    pub addressings: Vec<Addressing>,
    /// See `Case`.
    pub reliabilities: Vec<Assurance>,
    /// See `Case`.
    pub retries: Vec<u32>,
    /// What an RTPS writer keeps.
    pub history: History,
    /// How long messages are counted, in each case \[s\].
    pub seconds: f64,
    /// The root of all randomness.
    pub seed: u64,
}

/// Bytes of a message that are no features.
pub const FIXED_BYTES: usize = 24;
/// The rates of a sweep \[1/s\]: 60 and 200 are those of the paper's figures.
pub const RATES: [f64; 8] = [10.0, 20.0, 60.0, 100.0, 200.0, 300.0, 400.0, 500.0];
/// Its retry limits.
pub const RETRIES: [u32; 4] = [1, 3, 5, 7];

impl Sweep {
    /// Everything that is varied, over a medium.
    pub fn whole(medium: Medium) -> Sweep {
        let networks = match &medium {
            Medium::Radio(_) => vec![Network::Infrastructure, Network::AdHoc],
            Medium::Shaped(_) => vec![Network::Shaped],
        };
        Sweep {
            stations: 5,
            bytes: 152,
            medium,
            rates: RATES.to_vec(),
            networks,
            addressings: vec![Addressing::Unicast, Addressing::Multicast],
            reliabilities: Assurance::ALL.to_vec(),
            retries: RETRIES.to_vec(),
            history: History::Last(1),
            seconds: 20.0,
            seed: 0,
        }
    }

    /// How many features a message has.
    pub fn features(&self) -> usize {
        (self.bytes.saturating_sub(FIXED_BYTES) / 4).min(MAX_FEATURES)
    }

    /// Checks that there can be such a sweep.
    pub fn check(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        if !(2..=200).contains(&self.stations) {
            return wrong("stations", format!("{} is not 2 to 200", self.stations));
        }
        let most = FIXED_BYTES + 4 * MAX_FEATURES;
        if !(FIXED_BYTES..=most).contains(&self.bytes) || !self.bytes.is_multiple_of(4) {
            return wrong("bytes", format!("{} is not a multiple of 4 from {FIXED_BYTES} to {most}", self.bytes));
        }
        if let Some(rate) = self.rates.iter().find(|rate| !(0.1..=100_000.0).contains(*rate)) {
            return wrong("rates", format!("{rate} is not 0.1 to 100000 messages a second"));
        }
        if !(0.1..=3600.0).contains(&self.seconds) {
            return wrong("seconds", format!("{} is not 0.1 to 3600", self.seconds));
        }
        if let Some(retries) = self.retries.iter().find(|retries| **retries > 255) {
            return wrong("retries", format!("{retries} is not 0 to 255"));
        }
        let stations = f64::from(self.stations);
        if let Some(rate) = self.rates.iter().find(|rate| *rate * self.seconds < stations) {
            let least = stations / rate;
            return wrong(
                "seconds",
                format!("{} is too short for {rate} messages a second: {least} at least", self.seconds),
            );
        }
        if self.history == History::Last(0) {
            return wrong("history", "a writer keeps at least 1 sample".to_owned());
        }
        self.medium.check()?;
        let Medium::Shaped(shaped) = &self.medium else { return Ok(()) };
        let frame = self.bytes + AROUND_BYTES + shaped.overhead_bytes;
        for (field, bytes) in [("burst_bytes", shaped.burst_bytes), ("queue_bytes", shaped.queue_bytes)] {
            if bytes < frame {
                return wrong("medium", format!("{field} is {bytes}, and a message is {frame} bytes on the link"));
            }
        }
        Ok(())
    }

    /// All cases, by combination and then by rate.
    pub fn cases(&self) -> Vec<Case> {
        let mut cases = Vec::new();
        for &network in &self.networks {
            for &addressing in &self.addressings {
                for &reliability in &self.reliabilities {
                    for retries in self.retries_of(network, addressing) {
                        let case = |&rate| Case { network, addressing, reliability, retries, rate };
                        cases.extend(self.rates.iter().map(case));
                    }
                }
            }
        }
        cases
    }

    fn retries_of(&self, network: Network, addressing: Addressing) -> Vec<u32> {
        match (network, addressing, &self.medium) {
            (Network::Shaped, ..) | (_, _, Medium::Shaped(_)) => vec![0],
            (_, Addressing::Unicast, _) => self.retries.clone(),
            (Network::AdHoc, Addressing::Multicast, _) => vec![0],
            (_, Addressing::Multicast, Medium::Radio(radio)) => vec![radio.retries],
        }
    }

    /// The medium as it is in a case.
    pub fn medium_of(&self, case: &Case) -> Medium {
        let mut medium = self.medium.clone();
        if let Medium::Radio(radio) = &mut medium {
            radio.channel = match case.network {
                Network::AdHoc | Network::Shaped => Topology::AdHoc,
                Network::Infrastructure => Topology::Infrastructure,
            };
            // Repairs to one reader are unicast in every case.
            if case.addressing == Addressing::Unicast {
                radio.retries = case.retries;
            }
        }
        medium
    }
}

macro_rules! named {
    ($($type:ty),*) => { $(
        impl std::fmt::Display for $type {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                match serde_json::to_value(self) {
                    Ok(serde_json::Value::String(name)) => f.write_str(&name),
                    _ => unreachable!("it is a name"),
                }
            }
        }
    )* };
}

named!(Addressing, Assurance, Network, Source);

impl std::fmt::Display for History {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            History::Last(depth) => write!(f, "{depth}"),
            History::All => f.write_str("all"),
        }
    }
}

impl Case {
    /// What all its rates have in common, in a few words.
    pub fn combination(&self) -> String {
        let Case { network, addressing, reliability, retries, .. } = self;
        match addressing {
            Addressing::Unicast if *network != Network::Shaped => {
                format!("{network} {addressing} {reliability}, {retries} retries")
            }
            _ => format!("{network} {addressing} {reliability}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::media::radio::Radio;

    #[test]
    fn retries_are_varied_for_unicast_alone() {
        let sweep = Sweep::whole(Medium::Radio(Radio::default()));
        sweep.check().unwrap();
        let cases = sweep.cases();
        assert_eq!(cases.len(), 2 * (5 * 4 + 5) * RATES.len());
        let multicast = cases.iter().filter(|case| case.addressing == Addressing::Multicast);
        assert!(multicast.into_iter().all(|case| [0, 7].contains(&case.retries)));
        assert_eq!(cases[0].combination(), "infrastructure unicast best-effort, 1 retries");
        assert!(Sweep { bytes: 23, ..sweep }.check().is_err());
    }
}
