//! Robots that say they are elsewhere, in teams whose tracker measures them: avoided where they are, and named.
//!
//! The tracker has a noise of 2 cm, all messages of 20 ms delay, and drives lag: the conditions of docs/safety.md.

use murmurate::deploy::Impair;
use murmurate::faults::{FaultPlan, LinkFault, LinkFaultKind};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::HostId;
use murmurate::messages::wire::Kind;
use murmurate::policy::Model;
use murmurate::report::TrialReport;
use murmurate::safety::{Clamp, Safety, Switch};
use murmurate::scenario::judge::Verdict;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate::world::{ContactRule, Sensor};

/// Number of robots.
const ROBOTS: u16 = 5;
/// Distance of where liars say that they are from where they are \[m\].
const OFF_M: f32 = 2.0;

fn trial(witness: Switch, seed: u64, episodes: u32) -> Trial {
    let mut trial = Trial::of_team("onboard-infra", "passage", usize::from(ROBOTS)).expect("a preset");
    trial.deployment.witness = witness;
    trial.deployment = trial.deployment.impaired(Some(0.02), None, Impair::All).expect("messages cross links");
    trial.physics.contacts = ContactRule::Judge;
    (trial.physics.wall_radius_m, trial.physics.lag_s) = (0.16, 0.5);
    let (period, latency) = (Span::from_millis(10), Span::from_millis(10));
    trial.physics.sensor = Sensor { position_m: 0.02, velocity_m_s: 0.01, period, latency };
    let model = Model::shipped("passage").expect("it is there");
    let trial = trial.model(model).seed(seed).episodes(episodes).clamp(Clamp::Deployed).safety(Safety::deployed());
    trial.keeping_steps()
}

/// Returns the trial in which one robot says that it is `OFF_M` from where it is. The seed draws which and where.
fn lying(trial: Trial) -> Trial {
    let hosts = vec![HostId((trial.seed % u64::from(ROBOTS)) as u16)];
    let (sin, cos) = (trial.seed as f32 * 2.4).sin_cos();
    let (kind, off_m) = (LinkFaultKind::Misplace, Vec2::new(cos, sin) * OFF_M);
    trial.faults(FaultPlan {
        links: vec![LinkFault { kind, hosts, off_m, ..LinkFault::always("infra") }],
        ..FaultPlan::default()
    })
}

/// Numbers of what happened in trials.
#[derive(Debug, Default)]
struct Found {
    episodes: usize,
    successes: usize,
    /// Episodes that ended because two robots have touched.
    collisions: usize,
    /// Times that a robot began to touch another, in resets too.
    touches: usize,
    /// Accusations, each by one robot of another.
    accusations: u64,
}

impl Found {
    fn add(&mut self, report: &TrialReport) {
        self.episodes += report.episodes.len();
        self.successes += report.successes();
        let collided = |verdict| matches!(verdict, Verdict::RobotCollision);
        self.collisions += report.episodes.iter().filter(|episode| collided(episode.verdict)).count();
        let touches = |robot: usize| {
            let touch = |at: usize| report.steps[at].samples[robot].contacts.robot;
            (1..report.steps.len()).filter(|at| touch(*at) && !touch(*at - 1)).count()
        };
        self.touches += (0..usize::from(ROBOTS)).map(touches).sum::<usize>();
        self.accusations += report.totals.safety.claim;
    }
}

/// Runs trials with as many episodes each as `episodes`, of the seeds from 0 to `trials`, as `change` makes them.
fn run(witness: Switch, (trials, episodes): (u64, u32), change: fn(Trial) -> Trial) -> Found {
    let mut found = Found::default();
    (0..trials).for_each(|seed| found.add(&change(trial(witness, seed, episodes)).run()));
    eprintln!("{witness:?}: {found:?}");
    found
}

/// Number of trials and of episodes of each: MURMURATE_LIAR_TRIALS of ten, or a few of two.
fn size() -> (u64, u32) {
    let few = |_| (5, 2);
    std::env::var("MURMURATE_LIAR_TRIALS").map_or_else(few, |trials| (trials.parse().expect("a number"), 10))
}

#[test]
fn a_liar_collides_with_nobody_and_is_named_where_a_tracker_measures_it() {
    let size = size();
    let believed = run(Switch::Off, size, lying);
    assert!(believed.touches > 0 && believed.accusations == 0, "{believed:?}");
    let witnessed = run(Switch::On, size, lying);
    assert_eq!((witnessed.collisions, witnessed.touches), (0, 0), "{witnessed:?}");
    // Each of the four others accuses it, once in each trial.
    assert_eq!(witnessed.accusations, size.0 * u64::from(ROBOTS - 1), "{witnessed:?}");
    assert!(witnessed.successes > 0, "{witnessed:?}");
}

#[test]
fn nobody_is_accused_in_an_honest_team_even_if_messages_are_lost() {
    let lossy = |mut trial: Trial| {
        trial.deployment.links[0].loss = 0.3;
        trial
    };
    for found in [run(Switch::On, size(), |trial| trial), run(Switch::On, size(), lossy)] {
        assert_eq!((found.accusations, found.touches), (0, 0), "{found:?}");
        assert!(found.successes > 0, "{found:?}");
    }
}

#[test]
fn a_tracker_that_is_cut_off_accuses_nobody() {
    let (from, until) = (Time::ZERO + Span::from_secs(2.0), Time::ZERO + Span::from_secs(6.0));
    let cut = LinkFault { kinds: vec![Kind::Reading], from, until, ..LinkFault::always("infra") };
    let report = trial(Switch::On, 3, 2).faults(FaultPlan { links: vec![cut], ..FaultPlan::default() }).run();
    assert_eq!(report.totals.safety.claim, 0);
    assert!(report.successes() > 0);
}
