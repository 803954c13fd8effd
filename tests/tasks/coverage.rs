//! Trials of coverage with its scripted policy.

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::registry::Registry;
use murmurate::scenario::judge::Verdict;
use murmurate::trial::Trial;
use murmurate_tasks::coverage::{
    Point,
    field::Field,
    run::{Baseline, Parameters, Rest, Team, run},
    size::{TABLE, TRUNCATION},
};

fn trial(mode: &str, scenario: &str, robots: Option<usize>) -> Trial {
    let registry = murmurate_tasks::add(Registry::builtin());
    let trial = Trial::from_registry(&registry, mode, scenario, robots).expect("a preset");
    let entry = registry.policy("coverage-cvt").expect("it is registered");
    let model = (entry.build)(&*trial.scenario).expect("it is for coverage");
    trial.model(model).seed(3)
}

/// Returns the cost of a team that stands at the starts of an episode.
fn standing(trial: &Trial, episode: u32) -> f64 {
    let tasks = trial.scenario.tasks(3, episode);
    let team: Vec<Motion> = tasks.iter().map(|task| Motion::at_rest(task.start)).collect();
    let goals: Vec<Vec2> = tasks.iter().map(|task| task.goal).collect();
    (trial.scenario.cost().expect("it has no goals").of)(&team, &goals)
}

/// Returns the mean cost of the decentralised baseline in an episode, with robots that follow it at once.
fn baseline(trial: &Trial, episode: u32) -> f64 {
    let tasks = trial.scenario.tasks(3, episode);
    let features = TABLE.features(tasks.iter().map(|task| task.goal));
    let field = Field::of_features(TABLE.grid, &features, TRUNCATION).expect("goals are places");
    let parameters = Parameters {
        step_s: 0.1,
        speed_m_s: f64::from(TABLE.speed_m_s),
        communication_m: f64::from(TABLE.communication_m),
        local_map_m: TABLE.local_map_m,
        sensor_m: TABLE.sensor_m,
        rest: Rest::Never,
    };
    let starts: Vec<Point> = tasks.iter().map(|task| TABLE.on_ground(task.start)).collect();
    let team = Team::new(&field, parameters, Baseline::Decentralised, &starts);
    run(team, (TABLE.limit_s / parameters.step_s) as usize, 1).mean * standing(trial, episode)
}

#[test]
fn the_policy_covers_as_well_as_its_baseline_and_better_than_robots_that_stand() {
    for mode in ["sim", "offboard"] {
        let trial = trial(mode, "coverage-table", None).episodes(3);
        let report = trial.clone().run();
        assert_eq!(report.episodes.len(), 3);
        for (episode, result) in (0..3).zip(&report.episodes) {
            let (cost, baseline) = (result.cost.expect("it was judged"), baseline(&trial, episode));
            let standing = standing(&trial, episode);
            println!("{mode}: {cost:.4} m2, the baseline {baseline:.4} m2, standing {standing:.4} m2");
            assert_eq!(result.verdict, Verdict::Completed);
            assert!((cost / baseline - 1.0).abs() < 0.03 && cost < 0.7 * standing);
        }
    }
}

#[test]
fn equal_seeds_cover_equally() {
    let run = || trial("offboard", "coverage-table", Some(3)).run();
    let (one, other) = (run(), run());
    assert_eq!(one.totals.trace, other.totals.trace);
}

#[test]
fn a_team_of_the_published_size_completes_its_episode() {
    let trial = trial("sim", "coverage", None);
    let report = trial.clone().run();
    let episode = &report.episodes[0];
    let cost = episode.cost.expect("it was judged");
    println!("{:?}, {cost} m2, standing {} m2", episode.verdict, standing(&trial, 0));
    assert_eq!(episode.verdict, Verdict::Completed);
    assert!(cost < standing(&trial, 0));
}
