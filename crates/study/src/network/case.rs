//! Parameters of a network study, and the cases that result from them.

use serde::{Deserialize, Serialize};

use super::medium::Medium;
use super::places::Places;
use super::traffic::FRAMING_BYTES;
use murmurate::config::ConfigError;
use murmurate::messages::wire::MAX_FEATURES;
use murmurate::net::media::radio::Topology;

/// Addressing of messages in a network study: a datagram for each receiver, or one for all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Addressing {
    /// One datagram for each receiver.
    Unicast,
    /// One datagram for all receivers.
    Multicast,
}

/// Reliability mode of messages: of the link layer (`net::protocol::reliability`) or of RTPS.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReliabilityMode {
    /// Each message is sent once (link layer).
    BestEffort,
    /// Each message is repeated after a short time while receivers report loss (link layer).
    Repeat,
    /// Receivers request missing messages, which are retransmitted unless there is a newer one (link layer).
    Nack,
    /// RTPS reliable: heartbeats, positive acknowledgements, retransmissions.
    Ack,
    /// RTPS reliable without positive acknowledgements: a reader answers a heartbeat only if it misses a sample.
    AckOff,
}

impl ReliabilityMode {
    /// All reliability modes.
    pub const ALL: [ReliabilityMode; 5] = [
        ReliabilityMode::BestEffort,
        ReliabilityMode::Repeat,
        ReliabilityMode::Nack,
        ReliabilityMode::Ack,
        ReliabilityMode::AckOff,
    ];
}

/// Kind of network between the stations of a network study.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NetworkKind {
    /// Radio channel with an access point.
    Infrastructure,
    /// Radio channel between stations in one hop, without an access point.
    AdHoc,
    /// Wired network with a shaped link for each station.
    Shaped,
}

/// History of an RTPS writer: the samples that it keeps for retransmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum History {
    /// This number of newest samples (KEEP_LAST of DDS).
    Last(u32),
    /// All samples that are not yet acknowledged by all readers (KEEP_ALL of DDS).
    All,
}

/// Source of the outcome of a network study's case: emulation or measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// The case was emulated.
    Emulated,
    /// The case was measured between hosts.
    Live,
}

impl Source {
    /// Both sources of outcomes.
    pub const ALL: [Source; 2] = [Source::Emulated, Source::Live];
}

/// Case of a network study: one combination of its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// Kind of network between the stations.
    pub network: NetworkKind,
    /// Addressing of messages.
    pub addressing: Addressing,
    /// Reliability mode of messages.
    pub reliability: ReliabilityMode,
    /// Retry limit of unicast frames (802.11). Multicast frames are not retransmitted, except on their way to an access
    /// point.
    pub retries: u32,
    /// Message rate of all stations together \[1/s\].
    pub rate: f64,
}

/// Parameters of a network study; its cases are all combinations of the lists, but only those with unicast by radio
/// differ in the retry limit. A station is a host that sends and receives messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sweep {
    /// Number of stations. Each one publishes to all others.
    pub stations: u16,
    /// Payload of a message \[bytes\]: 24 for sender, sequence number, timestamp and a position of two floats; the rest
    /// for features.
    pub bytes: usize,
    /// Medium between the stations.
    pub medium: Medium,
    /// Places of the stations; `None`: each is within range of all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub places: Option<Places>,
    /// Message rates of all stations together \[1/s\].
    pub rates: Vec<f64>,
    /// Kinds of networks of which the study has cases.
    pub networks: Vec<NetworkKind>,
    /// Addressings of which the study has cases.
    pub addressings: Vec<Addressing>,
    /// Reliability modes of which the study has cases.
    pub reliabilities: Vec<ReliabilityMode>,
    /// Retry limits (802.11) of unicast frames of which the study has cases.
    pub retries: Vec<u32>,
    /// Samples that RTPS writers keep for retransmission.
    pub history: History,
    /// Duration \[s\] of the measurement in each case. Each case begins 3 s earlier (warm-up), and runs for another 2 s
    /// in which late messages arrive (drain).
    pub seconds: f64,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Payload of a network study's message without features \[bytes\]: sender, sequence number, timestamp and position.
pub const FIXED_BYTES: usize = 24;
/// Default message rates of a network study, of all stations together \[1/s\]; 60 and 200 are those of the paper's
/// figures.
pub const RATES: [f64; 8] = [10.0, 20.0, 60.0, 100.0, 200.0, 300.0, 400.0, 500.0];
/// Default retry limits (802.11) of a network study.
pub const RETRIES: [u32; 4] = [1, 3, 5, 7];

impl Sweep {
    /// Returns a network study of 5 stations on this medium, over the default values of all parameters.
    pub fn whole(medium: Medium) -> Sweep {
        let networks = match &medium {
            Medium::Radio(_) => vec![NetworkKind::Infrastructure, NetworkKind::AdHoc],
            Medium::Shaped(_) => vec![NetworkKind::Shaped],
        };
        Sweep {
            stations: 5,
            bytes: 152,
            medium,
            places: None,
            rates: RATES.to_vec(),
            networks,
            addressings: vec![Addressing::Unicast, Addressing::Multicast],
            reliabilities: ReliabilityMode::ALL.to_vec(),
            retries: RETRIES.to_vec(),
            history: History::Last(1),
            seconds: 20.0,
            seed: 0,
        }
    }

    /// Returns the number of features in a message of `bytes` payload; a feature is a float of 4 bytes.
    pub fn features(&self) -> usize {
        (self.bytes.saturating_sub(FIXED_BYTES) / 4).min(MAX_FEATURES)
    }

    /// Checks the ranges of the study's parameters. An error names the field.
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
        if let Some(places) = &self.places {
            places.check(self.stations)?;
            if !self.medium.needs_places() {
                return wrong(
                    "places",
                    "nothing depends on them; give a medium with range_m, sense_m or powers".to_owned(),
                );
            }
        }
        let Medium::Shaped(shaped) = &self.medium else { return Ok(()) };
        let frame = self.bytes + FRAMING_BYTES + shaped.overhead_bytes;
        for (field, bytes) in [("burst_bytes", shaped.burst_bytes), ("queue_bytes", shaped.queue_bytes)] {
            if bytes < frame {
                return wrong("medium", format!("{field} is {bytes}, and a message is {frame} bytes on the link"));
            }
        }
        Ok(())
    }

    /// Returns all cases of the study, ordered by the combination of their other parameters, and then by message
    /// rate.
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

    fn retries_of(&self, network: NetworkKind, addressing: Addressing) -> Vec<u32> {
        match (network, addressing, &self.medium) {
            (NetworkKind::Shaped, ..) | (_, _, Medium::Shaped(_)) => vec![0],
            (_, Addressing::Unicast, _) => self.retries.clone(),
            (NetworkKind::AdHoc, Addressing::Multicast, _) => vec![0],
            (_, Addressing::Multicast, Medium::Radio(radio)) => vec![radio.retries],
        }
    }

    /// Returns the study's medium as it is in `case`: with the topology (access point or one hop) and the retry limit
    /// of the case.
    pub fn medium_of(&self, case: &Case) -> Medium {
        let mut medium = self.medium.clone();
        if let Medium::Radio(radio) = &mut medium {
            *radio = radio.on(match case.network {
                NetworkKind::AdHoc | NetworkKind::Shaped => Topology::AdHoc,
                NetworkKind::Infrastructure => Topology::Infrastructure,
            });
            // Retransmissions to one receiver are unicast even if the messages are multicast.
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

named!(Addressing, ReliabilityMode, NetworkKind, Source);

impl std::fmt::Display for History {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            History::Last(depth) => write!(f, "{depth}"),
            History::All => f.write_str("all"),
        }
    }
}

impl Case {
    /// Returns the case's network, addressing and reliability mode as text, with the retry limit for unicast by radio;
    /// without the message rate.
    pub fn combination(&self) -> String {
        let Case { network, addressing, reliability, retries, .. } = self;
        match addressing {
            Addressing::Unicast if *network != NetworkKind::Shaped => {
                format!("{network} {addressing} {reliability}, {retries} retries")
            }
            _ => format!("{network} {addressing} {reliability}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::net::media::radio::Radio;

    #[test]
    fn retries_are_varied_for_unicast_only() {
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
