//! Trials of flocking through a field with its scripted policy.

use murmurate::report::TrialReport;
use murmurate::scenario::judge::Verdict;

fn run(mode: &str, scenario: &str, policy: &str, episodes: u32) -> TrialReport {
    crate::trial(mode, (scenario, None), policy).episodes(episodes).run()
}

fn completed(report: &TrialReport) -> usize {
    report.episodes.iter().filter(|episode| episode.verdict == Verdict::Completed).count()
}

fn mean_cost(report: &TrialReport) -> f64 {
    let costs: Vec<f64> = report.episodes.iter().filter_map(|episode| episode.cost).collect();
    costs.iter().sum::<f64>() / costs.len() as f64
}

#[test]
fn a_flock_passes_between_the_obstacles_and_one_that_does_not_know_them_touches_them() {
    for (mode, scenario) in [("sim", "flocking-field-table"), ("onboard-adhoc", "flocking-field-table")] {
        let report = run(mode, scenario, "flock-field", 6);
        assert!(completed(&report) >= 5, "{mode}: {} of 6 without a contact", completed(&report));
        // Robots that stand deviate by the square of the migration's speed.
        assert!(mean_cost(&report) < 0.6 * 0.1 * 0.1, "{mode}: {} m2/s2", mean_cost(&report));
        let blind = run(mode, scenario, "flock-local", 6);
        assert!(completed(&blind) <= 2, "{mode}: {} of 6", completed(&blind));
    }
}

#[test]
fn equal_seeds_flock_equally() {
    let run = || run("offboard", "flocking-field-table", "flock-field", 1);
    assert_eq!(run().totals.trace, run().totals.trace);
}
