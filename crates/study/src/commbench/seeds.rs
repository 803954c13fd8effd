//! Seeds of the benchmark's episodes, held apart from those of trainings, and the silences of its channel with bursts.
//!
//! A layout is drawn from a seed and the number of the episode. Trainings draw theirs from any seed with numbers below
//! [`LAYOUT_NUMBERS`], and judge themselves on further numbers of two seeds below 2^32. The benchmark takes one layout
//! of each of its seeds: the one whose number is [`LAYOUT_NUMBERS`]. Its seeds begin at 2^62.

use murmurate::faults::{FaultPlan, LinkFault};
use murmurate::messages::wire::Kind;
use murmurate::random::{RngExt, Seed};
use murmurate::scenario::Scenario;
use murmurate::scenario::layout::Layouts;
use murmurate::time::{Span, Time};
use murmurate_train::environments::LAYOUT_NUMBERS;

/// Least seed of an episode of the benchmark.
pub const FIRST: u64 = 1 << 62;
/// Largest number of episodes of a cell, so that the seeds of two benchmarks do not overlap.
pub const MOST_EPISODES: u32 = 1 << 24;
/// Largest seed of a benchmark.
pub const MOST_SEED: u64 = u32::MAX as u64;

/// Returns the seed of the episode with index `episode`, below [`MOST_EPISODES`], of the benchmark with the seed
/// `seed`, at most [`MOST_SEED`]. All cells have the same ones, so that policies and channels are compared in pairs.
pub fn of_episode(seed: u64, episode: u32) -> u64 {
    assert!(seed <= MOST_SEED && episode < MOST_EPISODES, "seeds of two benchmarks do not overlap");
    FIRST + seed * u64::from(MOST_EPISODES) + u64::from(episode)
}

/// Returns the layout of the episode whose seed is `seed`, as the one of a trial.
pub fn layout(scenario: &dyn Scenario, seed: u64) -> Layouts {
    Layouts::of_scenario(scenario, seed, LAYOUT_NUMBERS + 1).since(LAYOUT_NUMBERS)
}

/// Draws the silences of an episode: for the share `share` of the time, and `mean_s` in the mean \[s\], no latent
/// crosses the link `link`. Times count from the start of the episode and end after `horizon_s` \[s\].
pub fn silences(seed: u64, link: &str, (share, mean_s): (f64, f64), horizon_s: f64) -> FaultPlan {
    let mut stream = Seed::of_run(seed).stream("commbench/bursts");
    let between_s = mean_s * (1.0 - share) / share;
    let mut exponential = |mean: f64| -mean * libm::log(1.0 - stream.random_range(0.0..1.0));
    let mut plan = FaultPlan::default();
    let mut now_s = exponential(between_s);
    while now_s < horizon_s {
        let end_s = now_s + exponential(mean_s);
        plan.links.push(LinkFault {
            kinds: vec![Kind::Latent],
            from: Time::ZERO + Span::from_secs(now_s),
            until: Time::ZERO + Span::from_secs(end_s),
            episode: Some(0),
            ..LinkFault::always(link)
        });
        now_s = end_s + exponential(between_s);
    }
    plan
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::registry::Registry;
    use murmurate::scenario::Settings;
    use std::collections::BTreeSet;

    #[test]
    fn seeds_of_benchmarks_are_apart_from_each_other_and_from_those_of_evaluations() {
        let seeds: BTreeSet<u64> = (0..3).flat_map(|seed| (0..100).map(move |at| of_episode(seed, at))).collect();
        assert_eq!(seeds.len(), 300);
        assert_eq!(of_episode(1, 0) - of_episode(0, MOST_EPISODES - 1), 1);
        assert!(seeds.iter().all(|seed| *seed > u64::from(u32::MAX)), "evaluations of trainings take less");
        assert_eq!(of_episode(MOST_SEED, MOST_EPISODES - 1) >> 62, 1, "the last seed is no other one's");
    }

    #[test]
    fn no_training_takes_the_layout_of_an_episode_of_the_benchmark() {
        let scenario = Registry::builtin().scenario("passage", &Settings::default()).expect("a scenario");
        let seed = of_episode(7, 3);
        let ours = layout(&*scenario, seed);
        assert_eq!(ours.len(), 1);
        for number in 0..LAYOUT_NUMBERS {
            assert_ne!(ours.episode(0), &scenario.tasks(seed, number)[..], "number {number}");
        }
        assert_eq!(ours.episode(0), &scenario.tasks(seed, LAYOUT_NUMBERS)[..]);
    }

    #[test]
    fn silences_last_for_their_share_of_the_time() {
        let plan = silences(5, "ad-hoc", (0.3, 0.5), 10_000.0);
        let silent_s: f64 = plan.links.iter().map(|fault| fault.until.since(fault.from).as_secs()).sum();
        assert!((silent_s / 10_000.0 - 0.3).abs() < 0.02, "{silent_s}");
        assert!((silent_s / plan.links.len() as f64 - 0.5).abs() < 0.03, "{silent_s}");
        assert!(plan.links.is_sorted_by_key(|fault| fault.from));
        assert_eq!(plan.links, silences(5, "ad-hoc", (0.3, 0.5), 10_000.0).links);
        assert_ne!(plan.links, silences(6, "ad-hoc", (0.3, 0.5), 10_000.0).links);
    }
}
