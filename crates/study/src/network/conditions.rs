//! Delay and loss of a team's latents on a medium of a network study, to train a policy under these conditions.

use super::case::{Addressing, Case, NetworkKind, ReliabilityMode, Sweep};
use super::emulate;
use super::medium::Medium;
use super::places::Places;
use murmurate::net::media::radio::Topology;
use murmurate_train::config::Conditions;

/// Latents that a robot sends \[1/s\]: one for each decision.
const RATE: f64 = 20.0;

/// Sets the delay and loss of messages in the training conditions `conditions` to those of robots at `places` \[m\]
/// (200 at most) on the medium. The places matter on a radio with space, where messages to those in reach count. An
/// emulation finds delay and loss for latents that are sent 20 times a second by best-effort multicast; the delay is a
/// range from its 10 % to its 90 % quantile, both 0.5 s at most. Returns `None`, and changes nothing, if no message
/// arrives.
pub fn apply(medium: &Medium, places: &[[f32; 2]], conditions: &mut Conditions) -> Option<()> {
    let stations = u16::try_from(places.len().clamp(2, 200)).expect("it is at most 200");
    let network = match medium {
        Medium::Shaped(_) => NetworkKind::Shaped,
        Medium::Radio(radio) if radio.channel == Topology::AdHoc => NetworkKind::AdHoc,
        Medium::Radio(_) => NetworkKind::Infrastructure,
    };
    let matter = medium.needs_places() && places.len() == usize::from(stations);
    let places = matter.then(|| Places::Given(places.to_vec()));
    let sweep = Sweep { stations, places, ..Sweep::whole(medium.clone()) };
    let (addressing, reliability) = (Addressing::Multicast, ReliabilityMode::BestEffort);
    let case = Case { network, addressing, reliability, retries: 0, rate: RATE * f64::from(stations) };
    let outcome = emulate::run(&sweep, &case, &|| true)?;
    let [low, _, high, _] = outcome.quantiles_s?;
    let loss = 1.0 - outcome.arrived as f64 / outcome.due as f64;
    conditions.delay_s = [low.min(0.5) as f32, high.min(0.5) as f32];
    conditions.loss = [loss as f32; 2];
    Some(())
}
