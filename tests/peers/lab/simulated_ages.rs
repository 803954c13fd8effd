//! Success and ages of neighbours' messages at decisions, of simulated episodes with a radio on every link by radio:
//! what a run of the same team over the lab is held against (`just full-lab`).
//!
//!     simulated_ages MODE RADIO EPISODES REPEATS        one JSON object; RADIO is a preset

use std::process::ExitCode;

use murmurate::net::media::radio::Radio;
use murmurate::policy::Model;
use murmurate::simulate::Proceed;
use murmurate::trial::Trial;
use murmurate_study::twin::estimate::smooth_quantile_of;
use murmurate_study::twin::predict;

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [mode, radio, episodes, repeats] = &words[..] else {
        eprintln!("simulated_ages MODE RADIO EPISODES REPEATS");
        return ExitCode::from(2);
    };
    let radio = Radio::preset(radio).expect("a preset of the radio");
    let (episodes, repeats): (u32, u32) = (episodes.parse().expect("a number"), repeats.parse().expect("a number"));
    let (mut ages, mut medians, mut successes, mut all) = (Vec::new(), Vec::new(), 0, 0);
    for repeat in 0..repeats {
        let model = Model::shipped("passage").expect("it is built in");
        let mut trial = Trial::preset(mode, "passage").expect("a mode").model(model).episodes(episodes);
        trial.deployment = trial.deployment.with_radio(&radio);
        trial.repeat = repeat;
        let run = predict::run(&trial, |_| Proceed::Continue).expect("nobody interrupts it");
        let own: Vec<f64> = run.decisions.iter().flat_map(|one| one.ages_s.iter().copied()).collect();
        medians.push(1e3 * smooth_quantile_of(own.clone(), 0.5).expect("robots speak"));
        ages.extend(own);
        all += run.episodes.len();
        successes +=
            run.episodes.iter().filter(|one| one.verdict == murmurate::scenario::judge::Verdict::Success).count();
    }
    let quantile = |q: f64| 1e3 * smooth_quantile_of(ages.clone(), q).expect("robots speak");
    medians.sort_by(f64::total_cmp);
    println!(
        "{{\"successes\":{successes},\"episodes\":{all},\"age_p50_ms\":{:.2},\"age_p90_ms\":{:.2},\
         \"age_p50_ms_least\":{:.2},\"age_p50_ms_most\":{:.2}}}",
        quantile(0.5),
        quantile(0.9),
        medians[0],
        medians[medians.len() - 1]
    );
    ExitCode::SUCCESS
}
