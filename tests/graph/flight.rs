//! Teams whose robots fly at a height: they rise before a reset, hover and land after a stop, and land at the end.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use murmurate::deploy::Routes;
use murmurate::faults::{ActorFault, ActorFaultKind, FaultPlan, Role};
use murmurate::flight::InAir;
use murmurate::graph::event::Event;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Flight, Phase, Stop, Wire};
use murmurate::policy::Model;
use murmurate::report::TrialReport;
use murmurate::safety::Safety;
use murmurate::simulate::Proceed;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;

/// Number of robots of the team, and of the episodes of a run.
const ROBOTS: usize = 8;
const EPISODES: u32 = 3;

/// Flight of each robot: its states, each with the time of its first message.
type Flights = BTreeMap<RobotId, Vec<(Time, Flight)>>;

/// Returns a team that crosses the passage, in the air or on the ground.
fn team(flies: bool) -> Trial {
    let mut trial = Trial::of_team("onboard-adhoc", "passage", ROBOTS).expect("a preset");
    if flies {
        trial.deployment.body.height_m = Some(0.8);
    }
    let model = Model::shipped("passage").expect("a policy of any size");
    let trial = Trial::new(trial.deployment, trial.scenario, model).safety(Safety::deployed());
    trial.seed(5).episodes(EPISODES).keeping_steps()
}

/// Runs a trial and returns its report and the flights.
fn fly(trial: &Trial) -> (TrialReport, Flights) {
    let flights: Rc<RefCell<Flights>> = Rc::default();
    let seen = Rc::clone(&flights);
    let note = move |now: Time, _: HostId, event: Event| {
        if let Event::Message(Wire::Aloft(aloft)) = event {
            let mut all = seen.borrow_mut();
            let of_robot = all.entry(aloft.robot).or_default();
            if of_robot.last().is_none_or(|(_, flight)| *flight != aloft.flight) {
                of_robot.push((now, aloft.flight));
            }
        }
    };
    let report = trial.run_observed(note, |_, _, _| Proceed::Continue);
    let flights = flights.borrow().clone();
    (report, flights)
}

/// Whether no robot has come down but by landing, and all stand on the ground at the end.
fn all_have_landed(flights: &Flights) -> bool {
    flights.len() == ROBOTS
        && flights.values().all(|of_robot| {
            let falls = |pair: &[(Time, Flight)]| pair[1].1 == Flight::Grounded && pair[0].1 != Flight::Landing;
            !of_robot.windows(2).any(falls) && of_robot.last().is_some_and(|(_, last)| *last == Flight::Grounded)
        })
}

fn states(of_robot: &[(Time, Flight)]) -> Vec<Flight> {
    of_robot.iter().map(|(_, flight)| *flight).collect()
}

/// A time in the middle of the first episode.
fn midst(report: &TrialReport) -> Time {
    let running = report.steps.iter().filter(|step| step.episode == 0 && step.phase == Phase::Running);
    let running: Vec<Time> = running.map(|step| step.samples[0].time).collect();
    running[running.len() / 2]
}

fn fault(role: Role, robot: u16, kind: ActorFaultKind, at: Time, for_s: f64) -> FaultPlan {
    let (robot, lasts) = (RobotId(robot), Span::from_secs(for_s));
    let fault = ActorFault { role, robot, kind, at, lasts, by: Span::ZERO, episode: None };
    FaultPlan { actors: vec![fault], links: Vec::new() }
}

#[test]
fn a_team_rises_before_its_reset_crosses_as_on_the_ground_and_lands() {
    let ground = team(false).run();
    let (report, flights) = fly(&team(true));
    assert_eq!((report.episodes.len(), report.successes()), (3, ground.successes()), "{:?}", report.episodes);
    assert!(all_have_landed(&flights), "{flights:?}");
    let whole = [Flight::Grounded, Flight::Rising, Flight::Flying, Flight::Landing, Flight::Grounded];
    assert!(flights.values().all(|of_robot| states(of_robot) == whole), "{flights:?}");
    let last = flights.values().map(|of_robot| of_robot[2].0).max().expect("a team");
    let early = report.steps.iter().take_while(|step| step.samples[0].time < last);
    let driven = early.flat_map(|step| &step.samples).filter(|sample| sample.command != Vec2::zeros());
    let on_ground = driven.filter(|sample| sample.time < flights[&sample.robot][2].0);
    assert_eq!(on_ground.count(), 0, "no robot is driven before it is at its height");
}

#[test]
fn a_stopped_team_hovers_for_a_second_lands_and_goes_on_after_a_resume() {
    let at = midst(&fly(&team(true)).0);
    let later = |ms| at + Span::from_millis(ms);
    let by = Routes::of(&team(true).deployment).server_host();
    let stops = vec![
        (at, Stop::engage(by, Latch::default())),
        (later(8000), Stop::rearm(by, Latch::engaged(1))),
        (later(9000), Stop::resume(by, Latch::held(2))),
    ];
    let (report, flights) = fly(&Trial { stops: stops.clone(), ..team(true) });
    let landing = |of_robot: &Vec<(Time, Flight)>| of_robot[3];
    assert!(flights.values().all(|of_robot| landing(of_robot).1 == Flight::Landing), "{flights:?}");
    let after = |of_robot: &Vec<(Time, Flight)>| landing(of_robot).0.since(at).as_secs();
    assert!(flights.values().all(|of_robot| (0.99..1.2).contains(&after(of_robot))), "{flights:?}");
    assert!(all_have_landed(&flights) && report.episodes.len() == EPISODES as usize, "{:?}", report.episodes);
    assert!(flights.values().all(|of_robot| of_robot.len() == 9), "each flies twice: {flights:?}");

    let mut hovering = Trial { stops, ..team(true) };
    hovering.deployment.body.stop_in_air = Some(InAir::Hover);
    let (_, flights) = fly(&hovering);
    assert!(flights.values().all(|of_robot| of_robot.len() == 5), "each flies once: {flights:?}");
}

#[test]
fn a_robot_whose_battery_is_flat_lands_and_the_team_waits_for_it() {
    let at = midst(&fly(&team(true)).0);
    let plan = fault(Role::Body, 3, ActorFaultKind::Flat, at, 6.0);
    let (report, flights) = fly(&team(true).faults(plan));
    let lands = |of_robot: &[(Time, Flight)]| states(of_robot).iter().filter(|one| **one == Flight::Landing).count();
    let of_team: Vec<usize> = flights.values().map(|of_robot| lands(of_robot)).collect();
    assert_eq!(of_team, [1, 1, 1, 2, 1, 1, 1, 1], "the others hover, and land at the end");
    assert!(all_have_landed(&flights) && report.episodes.len() == EPISODES as usize, "{:?}", report.episodes);
    assert_eq!(report.successes(), EPISODES as usize - 1, "the first is aborted: {:?}", report.episodes);
}

#[test]
fn a_robot_hovers_without_its_agent_and_lands_without_the_state_server() {
    let at = midst(&fly(&team(true)).0);
    let (_, flights) = fly(&team(true).faults(fault(Role::Agent, 3, ActorFaultKind::Crash, at, 4.0)));
    assert!(all_have_landed(&flights) && flights[&RobotId(3)].len() == 5, "{flights:?}");

    let (_, flights) = fly(&team(true).faults(fault(Role::Body, 3, ActorFaultKind::Crash, at, 1.0)));
    assert!(all_have_landed(&flights), "{flights:?}");

    let plan = fault(Role::StateServer, 0, ActorFaultKind::Crash, at, 6.0);
    let (report, flights) = fly(&team(true).faults(plan));
    assert!(all_have_landed(&flights) && flights.values().all(|of_robot| of_robot.len() == 9), "{flights:?}");
    let after = flights.values().map(|of_robot| of_robot[3].0.since(at).as_secs());
    assert!(after.clone().all(|after| (1.7..2.5).contains(&after)), "{:?}", after.collect::<Vec<_>>());
    assert_eq!(report.episodes.len(), EPISODES as usize);
}
