//! A trial and its report: five robots cross a passage, driven by the trained policy, first on a perfect network and
//! then on one that is slow and loses half of the messages between robots.
//!
//!     cargo run --release --example trial

use murmurate::deploy::Impair;
use murmurate::policy::Model;
use murmurate::report::TrialReport;
use murmurate::trial::Trial;

fn print_report(what: &str, report: &TrialReport) {
    println!("{what}: {} of {} episodes succeeded", report.successes(), report.episodes.len());
    println!("  trace {:032x}", report.totals.trace);
    for episode in &report.episodes {
        let makespan = episode.makespan_s.map_or("-".to_owned(), |makespan| format!("{makespan:.2} s"));
        println!("  episode {}: {:?}, makespan {makespan}", episode.episode, episode.verdict);
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Robots that send messages directly to each other, all in this process, under virtual time.
    let trial = Trial::preset("onboard-adhoc", "passage")?.model(Model::shipped("passage")?).seed(7).episodes(4);
    print_report("perfect network", &trial.run());

    // A trial is data: change what you like, and check it.
    let mut worse = trial.clone();
    worse.deployment = trial.deployment.clone().impaired(Some(0.05), Some(0.5), Impair::Latent)?;
    worse.check()?;
    print_report("50 ms late, half of it lost", &worse.run());

    // The same trial is the same run, bit for bit.
    assert_eq!(trial.run().totals.trace, trial.run().totals.trace);
    Ok(())
}
