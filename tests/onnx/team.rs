//! JaxMARL's recurrent team in the scenario and the plant of `tests/stranger`: what its memory is worth.

use std::sync::Arc;

use murmurate::registry::Registry;
use murmurate::trial::Trial;
use murmurate_onnx::Network;

/// Mean return of the team in JaxMARL's own environment over 2000 episodes, and half of its 95 % interval
/// (`examples/others/jaxmarl/reference.py`).
const IN_JAXMARL: [f64; 2] = [-30.86, 0.47];

/// Returns the mean return of an episode of the team, and half of its 95 % interval. Without memory each step begins
/// from the state at the start.
fn returns(remembers: bool, episodes: u32) -> [f64; 2] {
    let mut parts = super::others::parts("jaxmarl/spread");
    if !remembers {
        // A gap that is shorter than a period comes before each step.
        parts.contract.state.as_mut().expect("it has a state").after_gap_s = 0.05;
    }
    let model = Arc::new(Network::load(parts).expect("it loads")).model();
    let registry = Registry::builtin().with_scenario(crate::spread::SPREAD).with_plant(crate::mpe::MPE);
    let trial = Trial::from_registry(&registry, "sim", "spread", None).expect("a preset of the scenario");
    let trial = trial.plant("mpe").seed(1).episodes(episodes).model(model);
    assert_eq!(trial.check(), Ok(()));
    let report = trial.run();
    let found: Vec<f64> = report.episodes.iter().filter_map(|episode| episode.cost).map(|cost| -25.0 * cost).collect();
    let count = found.len() as f64;
    assert_eq!(count, f64::from(episodes), "every episode lasts its time");
    let mean = found.iter().sum::<f64>() / count;
    let variance = found.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / (count - 1.0);
    [mean, 1.96 * (variance / count).sqrt()]
}

#[test]
fn the_team_of_jaxmarl_earns_what_it_earns_there_and_less_without_its_memory() {
    let [trained, forgetful] = [true, false].map(|remembers| returns(remembers, 400));
    println!("as trained {trained:.2?}, state zeroed {forgetful:.2?}");
    let [there, half] = IN_JAXMARL;
    assert!((trained[0] - there).abs() <= trained[1] + half, "{trained:?}, and {IN_JAXMARL:?} in JaxMARL");
    assert!(forgetful[0] + forgetful[1] < trained[0] - trained[1], "{forgetful:?} without memory, {trained:?} with it");
}
