//! What a robot of a team costs as the team grows at constant density: scenario `swap`, scripted navigation, with one
//! agent for all robots or a host for each. Counts are simulated; processor time is handed in by whoever has a clock.

use serde::{Deserialize, Serialize};

use crate::messages::wire::Kind;
use crate::net::media::radio::Radio;
use crate::net::protocol::codec::TAG_BYTES;
use crate::policy::orca;
use crate::report::cost::Cost;
use crate::time::Span;
use crate::trial::{Trial, TrialError};

/// The deployments: one agent for all in lock step, and a host for each robot.
pub const MODES: [&str; 2] = ["sim", "onboard-adhoc"];
/// How much of a team's time is simulated \[s\].
pub const LASTS_S: f64 = 10.0;
/// How much farther frames carry than they are listened to \[m\]: how far two robots may have come since they were
/// measured.
const MARGIN_M: f32 = 0.25;
/// Ground of each robot in the scenario \[m²\].
pub const GROUND_M2: f64 = 4.0;

/// How far the frames of these teams carry \[m\].
pub fn range_m() -> f32 {
    orca::INTERFACE.radius_m + MARGIN_M
}

/// A team of so many robots for so long. Between hosts latents carry a little farther than they are listened to.
pub fn trial(mode: &str, robots: usize, lasts: Span) -> Result<Trial, TrialError> {
    let trial = Trial::of_team(mode, "swap", robots)?.lasting(lasts);
    if trial.deployment.hosts.len() == 1 {
        return Ok(trial);
    }
    let deployment = trial.deployment.clone().ranged(range_m()).expect("between hosts latents cross a link");
    Ok(Trial { deployment, ..trial })
}

/// What a robot of a team of one size costs, per second of its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// The deployment.
    pub mode: String,
    /// Robots.
    pub robots: usize,
    /// Messages that it says, of all kinds \[1/s\].
    pub messages: f64,
    /// Their bytes \[1/s\].
    pub bytes: f64,
    /// Datagrams that its hosts take in \[1/s\]: 0 where all is one host.
    pub deliveries: f64,
    /// The share of time that its own latents are on the air, by multicast; none without a radio.
    pub airtime: Option<f64>,
    /// The share of time that the air around it is taken, with those whose frames carry to it; none without a radio.
    pub airtime_around: Option<f64>,
    /// Time of one processor \[µs\] that it takes to simulate it.
    pub cpu_us: f64,
}

impl Growth {
    /// What a run in this deployment has cost, and so much processor time \[s\].
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
            airtime_around: airtime.map(|own| own * (1.0 + around()).min(cost.robots as f64)),
            cpu_us: 1e6 * cpu_s / (cost.robots as f64 * cost.virtual_s),
        }
    }
}

/// How many robots the frames of one carry to, far from the edge of the ground.
pub fn around() -> f64 {
    std::f64::consts::PI * f64::from(range_m()).powi(2) / GROUND_M2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_team_is_simulated_and_its_air_reckoned() {
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
        assert!((near - 1.0 - around()).abs() < 1e-9 && (14.0..15.0).contains(&around()), "{near}");
        assert!(trial("onboard-adhoc", 1, Span::from_secs(1.0)).is_err());
    }
}
