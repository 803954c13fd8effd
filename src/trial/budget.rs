//! Network budget of a trial: what messages in parts need of each link, and what a radio channel carries.

use std::fmt;

use crate::config::ConfigError;
use crate::deploy::{Deployment, Link};
use crate::messages::ids::RobotId;
use crate::messages::wire::{Encoding, Form, Kind};
use crate::net::media::radio::bianchi::Saturation;
use crate::net::media::radio::{Radio, Topology};
use crate::net::protocol::parts;
use crate::policy::Models;

/// Needs of a policy's messages on a link, without repairs and all else.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// Name of the link.
    pub link: String,
    /// Number of robots whose messages travel on the link.
    pub robots: usize,
    /// Number of floats of a message.
    pub floats: usize,
    /// Encoding of the floats.
    pub encoding: Encoding,
    /// Messages of a robot in a second, of the mean of all.
    pub rate_hz: f64,
    /// Payload of the datagrams of all robots \[bit/s\].
    pub needs_bit_s: f64,
    /// Payload of multicast datagrams of that size that the radio channel carries \[bit/s\]; `None` for a medium that
    /// is no radio. It is that of the link, or of Wi-Fi with its usual basic rate if the link names no channel.
    pub carries_bit_s: Option<f64>,
    /// Whether the link names its radio channel, which is then emulated.
    pub is_known: bool,
}

impl Budget {
    /// Returns whether the channel carries less than the messages need.
    pub fn is_exceeded(&self) -> bool {
        self.carries_bit_s.is_some_and(|carries| self.needs_bit_s > carries)
    }
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Budget { link, robots, floats, encoding, rate_hz, needs_bit_s, carries_bit_s, is_known } = self;
        let needs = needs_bit_s / 1e6;
        write!(
            f,
            "{robots} robots x {floats} floats as {encoding} at {rate_hz:.0} Hz need {needs:.1} Mbit/s of '{link}'"
        )?;
        let carries = carries_bit_s.map(|carries| carries / 1e6);
        match carries {
            Some(carries) if *is_known => write!(f, "; this channel's multicast carries {carries:.1}"),
            Some(carries) => write!(f, "; Wi-Fi's multicast at its usual basic rate carries {carries:.1}"),
            None => Ok(()),
        }
    }
}

/// Returns the budgets of the links on which messages in parts of `models` travel; none if their messages fit into a
/// datagram, or if none leaves its host.
pub(super) fn of(deployment: &Deployment, models: &Models) -> Vec<Budget> {
    let (features, form, robots) = (models.features(), models.form(), deployment.robots);
    let rate_hz = |robot: RobotId| 1.0 / models.of(robot).interface().period.as_secs();
    let mean_hz = RobotId::team(robots).map(rate_hz).sum::<f64>() / robots as f64;
    let hosts = deployment.hosts.iter().filter(|host| !host.agents.is_empty()).count();
    if !form.is_in_parts(features) || hosts < 2 {
        return Vec::new();
    }
    let carrying = deployment.links.iter().filter(|link| link.carries.contains(&Kind::Latent));
    carrying.map(|link| budget(link, (robots, hosts), (features, form), mean_hz)).collect()
}

fn budget(link: &Link, (robots, hosts): (usize, usize), (floats, form): (usize, Form), rate_hz: f64) -> Budget {
    let (datagrams, bytes) = parts::datagrams(floats, form.encoding);
    let topology = link.medium.topology();
    let radio = link.radio.clone().or(Radio::preset("wifi").filter(|_| topology.is_some()));
    let carries_bit_s = radio.zip(topology).map(|(radio, topology)| {
        let down = Saturation::of_multicast(&radio, hosts, bytes).frames_per_s;
        let frames_per_s = match topology {
            Topology::AdHoc => down,
            // Each frame goes up to the access point first, at the rate of frames for one station.
            Topology::Infrastructure => {
                1.0 / (1.0 / down + 1.0 / Saturation::of_radio(&radio, hosts, bytes).frames_per_s)
            }
        };
        frames_per_s * 8.0 * bytes as f64
    });
    let needs_bit_s = robots as f64 * rate_hz * 8.0 * (datagrams * bytes) as f64;
    let (link, is_known) = (link.name.clone(), link.radio.is_some());
    Budget { link, robots, floats, encoding: form.encoding, rate_hz, needs_bit_s, carries_bit_s, is_known }
}

/// Checks that the emulated radio channels of a deployment carry the messages of `models`.
pub(super) fn check(deployment: &Deployment, models: &Models) -> Result<(), ConfigError> {
    match of(deployment, models).into_iter().find(|budget| budget.is_known && budget.is_exceeded()) {
        None => Ok(()),
        Some(budget) => {
            let why = format!("{budget}: send fewer floats or steps, in a smaller encoding, or at a higher basic_rate");
            Err(ConfigError::field("policy", why))
        }
    }
}
