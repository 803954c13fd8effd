//! Cost per robot as a team grows at constant density: scenario `swap`, scripted navigation, with one agent for all
//! robots or one host per robot. Counts are simulated; processor time is measured by the caller.

use serde::{Deserialize, Serialize};

use murmurate::messages::wire::Kind;
use murmurate::net::media::radio::Radio;
use murmurate::net::protocol::codec::TAG_BYTES;
use murmurate::policy::orca;
use murmurate::time::Span;
use murmurate::trial::{Trial, TrialError};
use murmurate_report::cost::Cost;

/// Modes in which the cost of growing teams is computed: `sim`, with one agent for all robots, and `onboard-adhoc`,
/// with one host per robot.
pub const MODES: [&str; 2] = ["sim", "onboard-adhoc"];
/// Default simulated time of a trial of a growing team \[s\].
pub const DURATION_S: f64 = 10.0;
/// Transmission range beyond the communication range \[m\]: the distance by which two robots may have approached since
/// they were measured.
const MARGIN_M: f32 = 0.25;
/// Ground area per robot \[m²\] in the trials of growing teams, in the scenario `swap`.
pub const GROUND_M2: f64 = 4.0;

/// Returns the transmission range of robots in the trials of growing teams \[m\]: the communication range with a
/// margin.
pub fn range_m() -> f32 {
    orca::INTERFACE.radius_m + MARGIN_M
}

/// Returns a trial of `robots` robots in the scenario `swap` that runs for the simulated time `lasts`. `mode` is `sim`
/// or `onboard-adhoc`. Frames between hosts reach as far as [`range_m`]. An error says that the team cannot be made.
pub fn trial(mode: &str, robots: usize, lasts: Span) -> Result<Trial, TrialError> {
    let trial = Trial { everywhere: true, ..Trial::of_team(mode, "swap", robots)?.lasting(lasts) };
    if trial.deployment.hosts.len() == 1 {
        return Ok(trial);
    }
    let deployment = trial.deployment.clone().ranged(range_m()).expect("between hosts latents cross a link");
    Ok(Trial { deployment, ..trial })
}

/// Cost of a team of one size, per robot and simulated second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Mode of the deployment: `sim` or `onboard-adhoc`.
    pub mode: String,
    /// Number of robots.
    pub robots: usize,
    /// Messages of all kinds that are published, per robot \[1/s\].
    pub messages: f64,
    /// Bytes of the published messages, without authentication tags, per robot \[1/s\].
    pub bytes: f64,
    /// Datagrams that hosts receive, per robot \[1/s\]; 0 if there is only one host.
    pub deliveries: f64,
    /// Share of time in which a robot's own latents occupy the radio channel by multicast; `None` without a radio, or
    /// if there is only one host.
    pub airtime: Option<f64>,
    /// Share of time in which the latents of a robot and of all robots within its transmission range occupy the
    /// radio channel; `None` without a radio, or if there is only one host.
    pub airtime_around: Option<f64>,
    /// Processor time of the simulation \[µs\] per robot and simulated second.
    pub cpu_us: f64,
}

impl Growth {
    /// Returns the cost per robot of a trial from its counts `cost` and its processor time `cpu_s` \[s\]. `mode` is the
    /// trial's mode. Airtimes are computed for frames of the radio `radio`; without one, or without deliveries, they
    /// are `None`.
    pub fn of(mode: &str, cost: &Cost, cpu_s: f64, radio: Option<&Radio>) -> Growth {
        let latents = cost.kinds.iter().find(|kind| kind.kind == Kind::Latent).expect("all kinds are counted");
        let on_air = |radio: &Radio| {
            let datagram_bytes = (latents.bytes / latents.messages.max(f64::MIN_POSITIVE)).round() as usize + TAG_BYTES;
            latents.messages * (radio.multicast_airtime(datagram_bytes) + radio.times().aifs).as_secs()
        };
        let airtime = radio.filter(|_| cost.deliveries > 0.0).map(on_air);
        Growth {
            mode: mode.to_owned(),
            robots: cost.robots,
            messages: cost.messages,
            bytes: cost.bytes,
            deliveries: cost.deliveries,
            airtime,
            airtime_around: airtime.map(|own| own * (1.0 + neighbours_in_range()).min(cost.robots as f64)),
            cpu_us: 1e6 * cpu_s / (cost.robots as f64 * cost.virtual_s),
        }
    }
}

/// Returns the mean number of other robots within transmission range of a robot far from the edge of the ground, in the
/// trials of growing teams.
pub fn neighbours_in_range() -> f64 {
    std::f64::consts::PI * f64::from(range_m()).powi(2) / GROUND_M2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn airtime_is_computed_from_a_simulated_team() {
        let of = |mode, robots| {
            let trial = trial(mode, robots, Span::from_secs(2.0)).unwrap();
            let cost = Cost::of(robots, &trial.run());
            Growth::of(mode, &cost, 0.001, Some(&Radio::default()))
        };
        let (alone, five, fifty) = (of("sim", 5), of("onboard-adhoc", 5), of("onboard-adhoc", 50));
        assert!(alone.airtime.is_none() && alone.deliveries == 0.0 && (alone.cpu_us - 100.0).abs() < 1e-6);
        // A latent is sent every 50 ms, and a frame of 1 Mbit/s takes a millisecond or two.
        let own = five.airtime.unwrap();
        assert!((0.01..0.06).contains(&own), "{five:?}");
        assert!((five.airtime_around.unwrap() / own - 5.0).abs() < 1e-9, "all five hear each other");
        let near = fifty.airtime_around.unwrap() / fifty.airtime.unwrap();
        assert!(
            (near - 1.0 - neighbours_in_range()).abs() < 1e-9 && (14.0..15.0).contains(&neighbours_in_range()),
            "{near}"
        );
        assert!(trial("onboard-adhoc", 1, Span::from_secs(1.0)).is_err());
    }
}
