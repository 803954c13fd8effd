//! Wi-Fi card of an interface, as data.

use std::fmt;

/// Mode in which an interface takes part in a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mode {
    /// Ad-hoc network: stations send to each other directly (IBSS).
    AdHoc,
    /// Station of an access point.
    Station,
    /// Access point.
    AccessPoint,
    /// Mesh point (IEEE 802.11s), which can forward frames of others.
    MeshPoint,
    /// Outside the context of a network (OCB).
    Outside,
    /// It receives what others send to each other.
    Monitor,
    /// Any other one.
    Other,
}

impl fmt::Display for Mode {
    /// Writes the name that `iw` has for the mode.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Mode::AdHoc => "IBSS",
            Mode::Station => "managed",
            Mode::AccessPoint => "AP",
            Mode::MeshPoint => "mesh point",
            Mode::Outside => "OCB",
            Mode::Monitor => "monitor",
            Mode::Other => "another mode",
        })
    }
}

/// Modes that interfaces of one card may have at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Combination {
    /// Sets of modes, each with the number of interfaces that may have one of them.
    pub limits: Vec<(u32, Vec<Mode>)>,
    /// Number of interfaces at once.
    pub most: u32,
    /// Number of channels at once.
    pub channels: u32,
}

/// Use of the channel since the card is on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load {
    /// Time on the channel \[ms\].
    pub active_ms: u64,
    /// Time in which the channel was sensed busy \[ms\].
    pub busy_ms: u64,
}

impl Load {
    /// Returns the share of the time in which the channel was busy; `None` before the first second.
    pub fn share(&self) -> Option<f64> {
        (self.active_ms >= 1000).then(|| self.busy_ms as f64 / self.active_ms as f64)
    }
}

/// Other station that the card hears.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Peer {
    /// Its address.
    pub address: [u8; 6],
    /// Mean power of what it sends \[dBm\].
    pub signal_dbm: Option<i8>,
    /// Frames that were sent to it.
    pub sent: u32,
    /// Transmissions after the first of a frame.
    pub retries: u32,
    /// Frames that were given up.
    pub failed: u32,
    /// Rate of the last frame that was sent to it \[Mbit/s\].
    pub rate_mbit_s: Option<f64>,
    /// Time since it was heard last \[ms\].
    pub silent_ms: Option<u32>,
}

/// Wi-Fi card of an interface.
#[derive(Clone, Debug, PartialEq)]
pub struct Card {
    /// Mode of the interface.
    pub mode: Mode,
    /// Name of the network; `None` outside of one.
    pub network: Option<String>,
    /// Centre of the channel \[MHz\]; `None` without one.
    pub frequency_mhz: Option<u32>,
    /// Whether the card sleeps between frames; `None` if the driver does not say.
    pub power_save: Option<bool>,
    /// Country whose rules the kernel follows, by its two letters, `00` for none; `None` if the kernel does not say.
    pub country: Option<String>,
    /// Whether a mesh point forwards frames of others; `None` for other modes.
    pub forwards: Option<bool>,
    /// Modes that the card can have, in order.
    pub modes: Vec<Mode>,
    /// Modes that its interfaces can have at once.
    pub combinations: Vec<Combination>,
    /// Use of the channel; `None` if the driver does not measure it.
    pub load: Option<Load>,
    /// Other stations, by address.
    pub peers: Vec<Peer>,
}

impl Card {
    /// Returns whether the channel is one of the band at 2.4 GHz.
    pub fn is_low_band(&self) -> bool {
        self.frequency_mhz.is_some_and(|mhz| mhz < 3000)
    }

    /// Returns whether the card can have an interface in the mode `mode` beside one in the mode `other`.
    pub fn has_beside(&self, mode: Mode, other: Mode) -> bool {
        self.combinations.iter().any(|combination| {
            let limit_of = |mode: Mode| combination.limits.iter().position(|(_, modes)| modes.contains(&mode));
            match (limit_of(mode), limit_of(other)) {
                (Some(one), Some(two)) => combination.most > 1 && (one != two || combination.limits[one].0 > 1),
                _ => false,
            }
        })
    }
}
