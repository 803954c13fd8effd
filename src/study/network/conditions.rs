//! What a training needs to know of a medium: the delay and loss of what a team says on it.

use super::case::{Addressing, Assurance, Case, Network, Sweep};
use super::emulate;
use super::medium::Medium;
use crate::net::media::radio::Topology;
use crate::train::config::Conditions;

/// The decisions of a robot, each with a message \[1/s\].
const RATE: f64 = 20.0;

/// Puts the delay and the loss of a medium in place of those of a training: a team's latents, best-effort multicast.
/// Delays are drawn between the 10 % and the 90 % quantile; the loss is the share that did not come. `None` if nothing
/// comes at all.
pub fn put(medium: &Medium, robots: usize, conditions: &mut Conditions) -> Option<()> {
    let stations = u16::try_from(robots.clamp(2, 200)).expect("it is at most 200");
    let network = match medium {
        Medium::Shaped(_) => Network::Shaped,
        Medium::Radio(radio) if radio.channel == Topology::AdHoc => Network::AdHoc,
        Medium::Radio(_) => Network::Infrastructure,
    };
    let sweep = Sweep { stations, ..Sweep::whole(medium.clone()) };
    let (addressing, reliability) = (Addressing::Multicast, Assurance::BestEffort);
    let case = Case { network, addressing, reliability, retries: 0, rate: RATE * f64::from(stations) };
    let outcome = emulate::run(&sweep, &case, &|| true)?;
    let [low, _, high, _] = outcome.quantiles_s?;
    let loss = 1.0 - outcome.arrived as f64 / outcome.due as f64;
    conditions.delay_s = [low.min(0.5) as f32, high.min(0.5) as f32];
    conditions.loss = [loss as f32; 2];
    Some(())
}
