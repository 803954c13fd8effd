//! The built-in policies for teams of many sizes bring their teams to the goals, without contacts.

use murmurate::policy::Model;
use murmurate::safety::{Clamp, Safety};
use murmurate::scenario::judge::Verdict;
use murmurate::trial::Trial;
use murmurate::world::ContactRule;

/// Runs twelve episodes of robots with a lag of 0.5 s, the policy `any-size` and the safety filter, and checks that at
/// least `least` succeed and no robot touches anything.
fn check(scenario: &str, robots: usize, least: usize) {
    let mut trial = Trial::of_team("onboard-adhoc", scenario, robots).expect("there is room").seed(3).episodes(12);
    trial.models = Model::built_in("any-size", scenario).expect("it is built in").into();
    (trial.physics.contacts, trial.physics.wall_radius_m, trial.physics.lag_s) = (ContactRule::Judge, 0.16, 0.5);
    let report = trial.clamp(Clamp::Deployed).safety(Safety::deployed()).run();
    let contacts = |verdict| matches!(verdict, Verdict::RobotCollision | Verdict::WallCollision);
    assert!(!report.episodes.iter().any(|episode| contacts(episode.verdict)), "{:?}", report.episodes);
    assert!(report.successes() >= least, "{scenario}, {robots} robots: {:?}", report.episodes);
}

#[test]
fn the_passage_s_policy_of_any_size_brings_small_and_large_teams_to_their_goals() {
    check("passage", 2, 11);
    check("passage", 5, 11);
    check("passage", 10, 9);
}

#[test]
fn the_swap_s_policy_of_any_size_brings_small_and_large_teams_to_their_goals() {
    check("swap", 4, 11);
    check("swap", 16, 10);
}
