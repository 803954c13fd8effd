//! Waypoints of a task file: every robot passes its own in order before it goes to its goal, and each host knows them
//! without a message.

use murmurate::deploy::Deployment;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Phase;
use murmurate::policy::Model;
use murmurate::results::totals::Steps;
use murmurate::scenario::layout::{LayoutError, Layouts};
use murmurate::scenario::{Settings, TaskFile};
use murmurate::trial::Trial;

const ERRANDS: &str = include_str!("../../examples/tasks/errands.toml");

fn trial(mode: &str) -> Trial {
    let task = TaskFile::read(ERRANDS).expect("it is sound");
    let scenario = task.scenario(&Settings::of(4)).expect("it is sound");
    let deployment = Deployment::preset(mode, scenario.robots()).expect("it is a mode");
    let mut trial = Trial::new(deployment, scenario, Model::Orca).seed(3).episodes(4);
    trial.steps = Steps::Reported;
    trial
}

#[test]
fn robots_pass_their_waypoints_in_order_and_then_arrive() {
    for (mode, least) in [("sim", 4), ("onboard-adhoc", 3)] {
        let trial = trial(mode);
        trial.check().unwrap_or_else(|error| panic!("{mode}: {error}"));
        let report = trial.run();
        assert!(report.successes() >= least, "{mode}: {} of 4", report.successes());
        let arrival_m = trial.scenario.rules().arrival_m;
        for episode in report.episodes.iter().filter(|episode| !episode.verdict.is_failure()) {
            let running = |robot: usize| {
                let steps =
                    report.steps.iter().filter(|step| (step.episode, step.phase) == (episode.episode, Phase::Running));
                steps.map(move |step| step.samples[robot].motion.position)
            };
            for (robot, task) in trial.layouts.episode(episode.episode).iter().enumerate() {
                let course = trial.layouts.course(episode.episode, RobotId(robot as u16));
                assert_eq!(course.waypoints().len(), 2);
                let mut way = running(robot);
                for place in course.waypoints().iter().chain([&task.goal]) {
                    let comes = way.any(|at| (at - place).norm() <= arrival_m);
                    assert!(comes, "{mode}, episode {}: robot {robot} has not been at {place}", episode.episode);
                }
            }
        }
        assert_eq!(report.totals.trace, trial.run().totals.trace, "{mode}: it repeats");
    }
}

#[test]
fn on_the_way_back_the_areas_are_passed_in_the_reverse_order() {
    let trial = trial("sim");
    for episode in 0..4 {
        for robot in RobotId::team(4) {
            let course = trial.layouts.course(episode, robot);
            let norths: Vec<bool> = course.waypoints().iter().map(|at: &Vec2| at.y > 0.0).collect();
            assert_eq!(norths, [episode % 2 == 0, episode % 2 == 1], "episode {episode}");
        }
    }
    let file = Layouts::from_json("{\"episodes\": []}", &*trial.scenario, 1);
    assert!(matches!(file, Err(LayoutError::Drawn { what: "waypoints", .. })), "{file:?}");
}
