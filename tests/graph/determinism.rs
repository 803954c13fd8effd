//! One seed, one run: bit for bit, however often, on whatever thread, beside whatever else.

use murmurate::deploy::Impair;
use murmurate::hearing::CommRange;
use murmurate::policy;
use murmurate::report::trial::TrialReport;
use murmurate::trial::Trial;

/// A trial in which everything that draws random numbers does so.
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
fn a_sampled_network_repeats_itself_too() {
    let trial = || Trial { model: policy::untrained(4), ..busy("onboard-adhoc") }.episodes(1);
    assert_eq!(trace(&trial().run()), trace(&trial().run()));
}

#[test]
fn seed_and_repeat_make_a_difference() {
    let other = trace(&busy("offboard").seed(12).run());
    let repeat = trace(&Trial { repeat: 1, ..busy("offboard") }.run());
    let first = trace(&busy("offboard").run());
    assert!(first != other && first != repeat && other != repeat);
}

#[test]
fn a_trial_does_not_notice_another_beside_it() {
    let alone = trace(&busy("onboard-infra").run());
    std::thread::scope(|scope| {
        let noise = scope.spawn(|| busy("offboard").run());
        assert_eq!(alone, trace(&busy("onboard-infra").run()));
        noise.join().expect("a trial does not panic");
    });
}
