//! Latents on an emulated link that no robot can use are not carried, and nothing else changes by that.

use murmurate::deploy::{Deployment, Impair};
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::report::TrialReport;
use murmurate::scenario::Settings;
use murmurate::time::Span;
use murmurate::trial::Trial;

/// Returns a trial of a team whose ground is several times as wide as its communication range.
fn spread_out(loss: f64, mode: &str) -> Trial {
    let settings = Settings { robots: Some(70), scale: Some(2.0), ..Settings::default() };
    let scenario = Registry::builtin().scenario("swap", &settings).expect("it is sound");
    let deployment = Deployment::preset(mode, 70).expect("it is a mode").sized(&settings);
    let deployment = deployment.impaired(Some(0.02), Some(loss), Impair::Latent).expect("latents cross a link");
    Trial::new(deployment, scenario, Model::Orca).seed(4).lasting(Span::from_millis(5000))
}

#[test]
fn a_run_is_the_same_to_the_bit_and_far_fewer_datagrams_arrive() {
    for (mode, loss) in [("onboard-adhoc", 0.16), ("onboard-adhoc", 0.0), ("onboard-infra", 0.16)] {
        let trial = spread_out(loss, mode);
        let near = trial.run();
        let everywhere = Trial { everywhere: true, ..trial }.run();
        assert_eq!(near.totals.trace, everywhere.totals.trace, "{mode}, loss {loss}");
        assert_eq!(near.totals.messages, everywhere.totals.messages);
        let arrived = |report: &TrialReport| report.totals.links.accepted;
        let (few, all) = (arrived(&near), arrived(&everywhere));
        assert!(2 * few < all && few > 0, "{mode}, loss {loss}: {few} of {all}");
    }
}
