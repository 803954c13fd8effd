//! Steps of policies that take time under virtual time.

use murmurate::policy::Model;
use murmurate::report::TrialReport;
use murmurate::time::Span;
use murmurate::trial::Trial;

fn run(mode: &str, ms: u64) -> TrialReport {
    let trial = Trial::of_team(mode, "swap", 2).expect("a preset").seed(4).episodes(2).model(Model::Orca);
    let trial = Trial { step_takes: Span::from_millis(ms), ..trial };
    assert_eq!(trial.check(), Ok(()));
    trial.run()
}

#[test]
fn a_step_that_takes_time_acts_later_and_twice_alike() {
    for mode in ["sim", "offboard"] {
        let (at_once, later) = (run(mode, 0), run(mode, 10));
        assert_eq!((at_once.successes(), later.successes()), (2, 2), "{mode}");
        assert_ne!(at_once.totals.trace, later.totals.trace, "{mode}: commands are later");
        assert_eq!(run(mode, 10).totals.trace, later.totals.trace, "{mode}");
    }
}

#[test]
fn robots_of_a_policy_that_is_always_late_stand() {
    // Half of the period of 50 ms is the limit.
    assert_eq!(run("offboard", 25).successes(), 2, "an answer at its deadline is in time");
    assert_eq!(run("offboard", 26).successes(), 0);
}
