//! Trials of coverage with its scripted policy.

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::scenario::judge::Verdict;
use murmurate::trial::Trial;

fn trial(mode: &str, scenario: &str, robots: Option<usize>) -> Trial {
    crate::trial(mode, (scenario, robots), "coverage-cvt")
}

/// Returns the cost of a team that stands at the starts of an episode.
fn standing(trial: &Trial, episode: u32) -> f64 {
    let tasks = trial.scenario.tasks(3, episode);
    let team: Vec<Motion> = tasks.iter().map(|task| Motion::at_rest(task.start)).collect();
    let goals: Vec<Vec2> = tasks.iter().map(|task| task.goal).collect();
    (trial.scenario.cost().expect("it has no goals").of)(&team, &goals)
}

#[test]
fn robots_that_go_to_what_they_see_cover_better_than_robots_that_stand() {
    for mode in ["sim", "offboard"] {
        let trial = trial(mode, "coverage-table", None).episodes(4);
        let report = trial.clone().run();
        assert_eq!(report.episodes.len(), 4);
        let standing = (0..4).map(|episode| standing(&trial, episode)).sum::<f64>() / 4.0;
        let costs: Vec<f64> = report.episodes.iter().filter_map(|episode| episode.cost).collect();
        let mean = costs.iter().sum::<f64>() / 4.0;
        println!("{mode}: {mean} m2, standing {standing} m2");
        assert_eq!(costs.len(), 4);
        assert!(mean < 0.9 * standing, "{mode}: {mean} m2, standing {standing} m2");
    }
}

#[test]
fn a_team_that_knows_more_covers_better() {
    let cost = |policy: &str| {
        let report = crate::trial("sim", ("coverage-table", None), policy).episodes(8).run();
        report.episodes.iter().filter_map(|episode| episode.cost).sum::<f64>() / 8.0
    };
    let [clairvoyant, centralised, alone] = ["coverage-clairvoyant", "coverage-centralised", "coverage-cvt"].map(cost);
    assert!(clairvoyant < centralised && centralised < alone, "{clairvoyant} {centralised} {alone}");
}

#[test]
fn equal_seeds_cover_equally() {
    let run = || trial("offboard", "coverage-table", Some(3)).run();
    let (one, other) = (run(), run());
    assert_eq!(one.totals.trace, other.totals.trace);
}

#[test]
fn a_team_of_the_published_size_completes_its_episode() {
    let trial = trial("sim", "coverage", None);
    let report = trial.clone().run();
    let episode = &report.episodes[0];
    let cost = episode.cost.expect("it was judged");
    println!("{:?}, {cost} m2, standing {} m2", episode.verdict, standing(&trial, 0));
    assert_eq!(episode.verdict, Verdict::Completed);
    assert!(cost < standing(&trial, 0));
}
