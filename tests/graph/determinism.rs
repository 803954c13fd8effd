//! Determinism: a seed gives the same run bit for bit, on any thread and beside any other run.

use std::cell::RefCell;
use std::rc::Rc;

use murmurate::deploy::Impair;
use murmurate::hearing::CommRange;
use murmurate::policy;
use murmurate::report::TrialReport;
use murmurate::simulate::Proceed;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;

/// Returns a trial that uses every source of random numbers.
fn busy(mode: &str) -> Trial {
    let mut trial = Trial::preset(mode, "passage").expect("a preset").seed(11).episodes(2);
    if mode.starts_with("onboard") || mode == "offboard" {
        trial.deployment =
            trial.deployment.impaired(Some(0.02), Some(0.16), Impair::All).expect("latents cross links there");
        trial.range = Some(CommRange { mean_m: 2.0, std_m: 0.5 });
        trial = trial.random_faults(3);
    }
    trial
}

fn trace(report: &TrialReport) -> u128 {
    assert!(report.finished, "the trial ran to its end");
    report.totals.trace
}

#[test]
fn the_same_seed_gives_the_same_trace() {
    for mode in ["sim", "centralized", "offboard", "onboard-adhoc"] {
        let first = busy(mode).run();
        for _ in 0..4 {
            let again = busy(mode).run();
            assert_eq!((trace(&first), &first.episodes), (trace(&again), &again.episodes), "{mode}");
        }
        let elsewhere = std::thread::spawn(move || busy(mode).run()).join().expect("a trial does not panic");
        assert_eq!(trace(&first), trace(&elsewhere), "{mode} on another thread");
    }
}

#[test]
fn a_sampled_policy_is_deterministic_too() {
    let trial = || Trial { models: policy::untrained(4).into(), ..busy("onboard-adhoc") }.episodes(1);
    assert_eq!(trace(&trial().run()), trace(&trial().run()));
}

#[test]
fn runs_depend_on_seed_and_repeat() {
    let other = trace(&busy("offboard").seed(12).run());
    let repeat = trace(&Trial { repeat: 1, ..busy("offboard") }.run());
    let first = trace(&busy("offboard").run());
    assert!(first != other && first != repeat && other != repeat);
}

#[test]
fn concurrent_trials_do_not_affect_each_other() {
    let alone = trace(&busy("onboard-infra").run());
    std::thread::scope(|scope| {
        let noise = scope.spawn(|| busy("offboard").run());
        assert_eq!(alone, trace(&busy("onboard-infra").run()));
        noise.join().expect("a trial does not panic");
    });
}

#[test]
fn events_have_the_time_of_their_own_instant() {
    let times: Rc<RefCell<Vec<Time>>> = Rc::default();
    let (heard, mut events) = (Rc::clone(&times), 0);
    let report = busy("offboard").run_observed(
        move |now, _, _| heard.borrow_mut().push(now),
        |_, now, _| {
            events += times.borrow().len();
            assert!(times.borrow_mut().drain(..).all(|at| at == now), "at {now:?}");
            Proceed::Continue
        },
    );
    assert!(report.finished && events > 1000, "{events} events");
}

#[test]
fn a_run_is_the_same_whether_its_events_are_followed_or_not() {
    for (mode, scenario, robots) in
        [("offboard", "passage", 5), ("onboard-infra", "swap", 12), ("onboard-adhoc", "swap", 80)]
    {
        let trial = Trial::of_team(mode, scenario, robots).expect("a preset of a team of this size");
        let mut trial = trial.seed(2).lasting(Span::from_millis(5000));
        trial.deployment =
            trial.deployment.impaired(Some(0.02), Some(0.16), Impair::All).expect("latents cross links there");
        trial.range = Some(CommRange { mean_m: 2.0, std_m: 0.5 });
        let alone = trial.run();
        let followed = trial.run_observed(|_, _, _| {}, |_, _, _| Proceed::Continue);
        assert_eq!(alone.totals.trace, followed.totals.trace, "{mode}, {robots} robots");
        assert_eq!(alone.episodes, followed.episodes, "{mode}, {robots} robots");
        assert_eq!(alone.totals.links, followed.totals.links, "{mode}, {robots} robots");
    }
}
