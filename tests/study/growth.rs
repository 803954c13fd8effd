//! Cost of a growing team, as counts, which are the same on every machine. `benches/growth.rs` has the times.

use murmurate::messages::wire::{KINDS, Kind};
use murmurate::report::TrialReport;
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate_report::cost::Cost;
use murmurate_study::network::growth;

fn team(mode: &str, robots: usize) -> Trial {
    let trial = Trial::of_team(mode, "swap", robots).expect("there is room for them");
    Trial { everywhere: true, ..trial }
}

/// Returns a team whose frames reach a little beyond the communication range.
fn ranged(trial: Trial) -> Trial {
    let deployment = trial.deployment.clone().ranged(growth::range_m()).expect("latents cross a link");
    Trial { deployment, ..trial }
}

fn lasting(trial: &Trial, seconds: f64) -> (TrialReport, Cost) {
    let report = trial.clone().lasting(Span::from_secs(seconds)).run();
    let cost = Cost::of(trial.deployment.robots, &report);
    (report, cost)
}

#[test]
fn a_robot_of_a_large_team_sends_and_receives_no_more_than_one_of_a_small_team() {
    for mode in ["sim", "onboard-adhoc", "onboard-infra"] {
        let cost = |robots| Cost::of(robots, &growth::trial(mode, robots, Span::from_secs(6.0)).unwrap().run());
        let [small, large] = [50, 200].map(cost);
        assert!(large.messages < 1.02 * small.messages, "{mode}: {small:?}, {large:?}");
        assert!(large.bytes < 1.1 * small.bytes, "{mode}: {small:?}, {large:?}");
        // A larger ground has relatively fewer robots at its edge, where half of the neighbours are missing.
        assert!(large.deliveries <= 1.3 * small.deliveries, "{mode}: {small:?}, {large:?}");
    }
}

#[test]
fn without_a_range_all_robots_hear_each_other() {
    let [small, large] = [20, 60].map(|robots| lasting(&team("onboard-adhoc", robots), 4.0).1);
    assert!(large.deliveries > 2.0 * small.deliveries, "{small:?}, {large:?}");
}

#[test]
fn a_range_beyond_the_communication_range_changes_nothing_but_the_deliveries() {
    for (mode, robots) in [("onboard-adhoc", 30), ("offboard", 30), ("onboard-infra", 40)] {
        let trial = team(mode, robots).seed(5).episodes(2);
        let (everywhere, near) = (trial.run(), ranged(trial).run());
        assert!(everywhere.finished && near.finished);
        assert_eq!(everywhere.totals.trace, near.totals.trace, "{mode}");
        assert_eq!(everywhere.episodes, near.episodes, "{mode}");
        let deliveries = [&everywhere, &near].map(|report| report.totals.links.accepted);
        assert!(deliveries[1] < deliveries[0] * 9 / 10, "{mode}: {deliveries:?}");
    }
}

#[test]
fn a_trial_of_a_given_length_counts_all_of_it_by_kind() {
    let (report, cost) = lasting(&team("onboard-adhoc", 5), 4.0);
    assert!(!report.finished && (cost.virtual_s - 4.0).abs() < 1e-6);
    let totals = &report.totals;
    assert_eq!(totals.published.iter().map(|kind| kind.messages).sum::<u64>(), totals.messages);
    let of = |kind: Kind| cost.kinds[kind as usize];
    assert_eq!(KINDS.map(|kind| of(kind).kind), KINDS);
    // Every step of the world is read; heartbeats come five times a second.
    assert!((of(Kind::Reading).messages - 20.0).abs() < 0.5, "{cost:?}");
    assert!((of(Kind::Heartbeat).messages - 5.0).abs() < 0.5, "{cost:?}");
    assert!(of(Kind::Latent).bytes > 20.0 * of(Kind::Latent).messages && of(Kind::Stop).messages == 0.0, "{cost:?}");
    assert!(cost.airtime.is_none() && cost.deliveries > 4.0 * of(Kind::Latent).messages);
}
