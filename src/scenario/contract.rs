//! Test of the properties that trials, training and the judge of episodes require of every scenario.
//!
//! A crate with a scenario of its own calls [`check`] in a test. `tests/graph/contracts.rs` calls it for each scenario
//! of the registry.

use std::fmt::Display;
use std::sync::Arc;

use super::layout;
use super::{Arena, Entry, Progress, Scenario, ScenarioError, Settings, TaskFile, build_of};
use crate::messages::geometry::{Motion, Planar, Task, Vec2, is_finite};
use crate::messages::local::Contacts;
use crate::observation::{Bound, Channel, Known, Observation, PolicyFrame, Request, builtin};
use crate::time::Span;

/// Team sizes with which the contract test builds a scenario, if the scenario accepts them; `None` is the scenario's
/// default.
const SIZES: [Option<usize>; 6] = [None, Some(2), Some(3), Some(8), Some(12), Some(20)];
/// Scales and hulls \[m\] with which the contract test builds a scenario, if the scenario accepts them: small robots on
/// usual ground, small ground and large ground, robots in tight places, and what fits nowhere.
const SCALES_AND_HULLS: [(Option<f32>, Option<f32>); 9] = [
    (None, None),
    (None, Some(0.06)),
    (Some(0.375), Some(0.06)),
    (Some(0.375), Some(0.1)),
    (Some(0.1), Some(0.02)),
    (Some(1.7), None),
    (Some(3.0), Some(0.5)),
    (None, Some(0.2)),
    (Some(0.3), Some(0.3)),
];

/// Tests the scenario of a registry entry for the properties that every scenario must have, with its default team size
/// and with those of the sizes 2, 3, 8, 12 and 20 that it accepts, each at the scales and hulls that it accepts.
///
/// - Size: robots have the hull that is set, and two of them collide when they touch.
/// - Tasks: one for each robot, the same for equal seeds and others for other seeds; each episode starts where the
///   one before has ended; goals are inside the arena, apart from each other, and not yet reached at the start.
///   Without goals, these hold for the starts.
/// - Channels: each has a name of its own, and its values are finite at the start.
/// - Distance to go: never less than the straight distance to the goal, and zero at the goal.
/// - Reward: finite; stages never decrease; at the goal, the reward with contacts is less than without.
/// - Without goals (`Scenario::cost`): the cost is finite and not below zero, no robot is ever at its goal, and initial
///   velocities are finite and along the heading of the task.
///
/// # Errors
/// The scenario lacks a property: a sentence that names the first one, the scenario, the team size, scale and hull.
pub fn check(entry: &Entry) -> Result<(), String> {
    check_all(entry.name, &|settings| build_of(std::slice::from_ref(entry), entry.name, settings))
}

/// Tests the scenarios of a task file as [`check`] tests those of an entry.
///
/// # Errors
/// The scenario lacks a property: a sentence that names the first one, the scenario, the team size, scale and hull.
pub fn check_file(file: &TaskFile) -> Result<(), String> {
    check_all(file.name(), &|settings| file.scenario(settings))
}

/// Function that makes a scenario from a user's settings.
type Build<'a> = &'a dyn Fn(&Settings) -> Result<Arc<dyn Scenario>, ScenarioError>;

fn check_all(name: &str, built: Build) -> Result<(), String> {
    let all = SCALES_AND_HULLS
        .into_iter()
        .flat_map(|(scale, hull_m)| SIZES.map(|robots| Settings { robots, gap_m: None, scale, hull_m }));
    // A scenario of one size refuses another one.
    if let Err(error) = built(&Settings::default()) {
        return Err(format!("{name} is not built for its default team: {error}"));
    }
    for (settings, scenario) in all.filter_map(|settings| Some((settings, built(&settings).ok()?))) {
        let scenario = &*scenario;
        let size = [("scale", settings.scale), ("hull_m", settings.hull_m)]
            .map(|(field, value)| value.map_or(String::new(), |value| format!(", {field} {value}")));
        let named =
            |broken: String| format!("{} of {} robots{}: {broken}", scenario.name(), scenario.robots(), size.concat());
        require(scenario.name() == name, || format!("its name is not '{name}'")).map_err(named)?;
        hulls(scenario, &settings).map_err(named)?;
        tasks(scenario).map_err(named)?;
        for tasks in (0..4).map(|episode| scenario.tasks(5, episode)) {
            for task in &tasks {
                channels(scenario, (task, &tasks)).map_err(named)?;
                match scenario.cost() {
                    None => distance(scenario, task).map_err(named)?,
                    Some(_) => no_goal(scenario, task).map_err(named)?,
                }
            }
        }
        costs(scenario).map_err(named)?;
        for task in scenario.tasks(3, 0) {
            reward(scenario, &task).map_err(named)?;
        }
    }
    Ok(())
}

/// Returns `Ok` if the condition `holds`, otherwise the text of `broken` as an error.
fn require<M: Display>(holds: bool, broken: impl FnOnce() -> M) -> Result<(), String> {
    if holds { Ok(()) } else { Err(broken().to_string()) }
}

/// Checks that robots are as large as the settings say, for those who judge, guard, plan and draw.
fn hulls(scenario: &dyn Scenario, settings: &Settings) -> Result<(), String> {
    let Some(hull_m) = settings.hull_m else { return Ok(()) };
    let is = |found: f32, wanted: f32| (found / wanted - 1.0).abs() < 1e-4;
    let (separation_m, arena) = (scenario.rules().separation_m, scenario.arena());
    require(is(separation_m, 2.0 * hull_m), || format!("robots collide at {separation_m} m"))?;
    require(is(arena.hull_m(), hull_m), || format!("the arena is for robots with a hull of {} m", arena.hull_m()))
}

fn tasks(scenario: &dyn Scenario) -> Result<(), String> {
    for (seed, episode) in (0..20).flat_map(|seed| (0..3).map(move |episode| (seed, episode))) {
        let at = format!("seed {seed}, episode {episode}");
        let tasks = scenario.tasks(seed, episode);
        require(tasks.len() == scenario.robots(), || format!("{} tasks, {at}", tasks.len()))?;
        require(tasks == scenario.tasks(seed, episode), || format!("other tasks the second time, {at}"))?;
        let drawn = scenario.drawn_arena(seed, episode);
        require(drawn == scenario.drawn_arena(seed, episode), || format!("other obstacles the second time, {at}"))?;
        let arena = drawn.as_ref().unwrap_or(scenario.arena());
        entered(scenario, (&tasks, arena)).map_err(|broken| format!("{broken}, {at}"))?;
        courses(scenario, arena, (seed, episode)).map_err(|broken| format!("{broken}, {at}"))?;
        let places: Vec<Vec2> = match scenario.cost() {
            None => tasks.iter().map(|task| task.goal).collect(),
            Some(_) => tasks.iter().map(|task| task.start).collect(),
        };
        let starts: Vec<Vec2> = scenario.tasks(seed, episode + 1).iter().map(|task| task.start).collect();
        let is_apart = scenario.task_file().is_some_and(TaskFile::draws_apart);
        let chained = places == starts || scenario.cost().is_some() || is_apart;
        require(chained, || format!("the next episode does not start at the goals, {at}"))?;
        if is_apart {
            layout::check(scenario, &tasks).map_err(|why| format!("{why}, {at}"))?;
        }
        for (robot, place) in places.iter().enumerate() {
            require(arena.has_room(*place), || format!("robot {robot} has no room at {}, {at}", place.shown()))?;
            let near = |other: &Vec2| (*other - *place).norm() <= 2.0 * arena.robot_radius_m;
            require(!places[..robot].iter().any(near), || format!("robot {robot} overlaps another, {at}"))?;
            let arrived = scenario.reached(&tasks[robot], tasks[robot].start);
            require(!arrived, || format!("robot {robot} starts at its goal, {at}"))?;
        }
    }
    // Where robots exchange few places, two seeds may give the same.
    let differs = (1..10).any(|seed| scenario.tasks(seed, 0) != scenario.tasks(0, 0));
    require(differs, || "all seeds give equal tasks")
}

/// Checks that every robot has equally many waypoints, at which it has room.
fn courses(scenario: &dyn Scenario, arena: &Arena, (seed, episode): (u64, u32)) -> Result<(), String> {
    let waypoints = scenario.waypoints(seed, episode);
    require(waypoints == scenario.waypoints(seed, episode), || "other waypoints the second time")?;
    let Some(first) = waypoints.first() else { return Ok(()) };
    let (robots, of_each) = (scenario.robots(), waypoints.iter().all(|course| course.len() == first.len()));
    require(waypoints.len() == robots && of_each, || "robots have not equally many waypoints")?;
    let outside = waypoints.iter().flatten().find(|place| !arena.has_room(**place));
    require(outside.is_none(), || format!("no robot has room at the waypoint {:?}", outside.map(Planar::shown)))
}

/// Checks that a robot with obstacles that are drawn for the episode can start, and is on the ground of all episodes.
fn entered(scenario: &dyn Scenario, (tasks, arena): (&[Task], &Arena)) -> Result<(), String> {
    if *arena == *scenario.arena() {
        return Ok(());
    }
    let is_ground =
        arena.half_extent == scenario.arena().half_extent && arena.robot_radius_m == scenario.arena().robot_radius_m;
    require(is_ground, || "the ground of an episode is another one")?;
    for (robot, task) in tasks.iter().enumerate() {
        require(arena.has_room(task.start), || {
            format!("robot {robot} starts in an obstacle at {}", task.start.shown())
        })?;
        let is_turned = scenario.frame(task) != PolicyFrame::World;
        require(!is_turned, || "a policy frame that is not the world frame, with obstacles that are drawn")?;
    }
    Ok(())
}

/// Checks that each channel of the scenario has a name of its own, and finite values for a robot with this `task`, of a
/// team with these `tasks`.
fn channels(scenario: &dyn Scenario, (task, tasks): (&Task, &[Task])) -> Result<(), String> {
    let own = scenario.channels();
    let mut names: Vec<String> = builtin::channels().iter().map(|channel| channel.name.to_string()).collect();
    for channel in &own {
        let name = channel.name.to_string();
        require(!names.contains(&name), || format!("a second channel '{name}' of the observation"))?;
        names.push(name);
    }
    let requests: Vec<Request> = own.iter().map(Channel::request).collect();
    let bound = Bound::new(&requests, &own).map_err(|error| error.to_string())?;
    let seen = Observation::in_frame(scenario.frame(task), task.goal, &Motion::at_rest(task.start));
    let mut values = vec![f32::NAN; bound.floats()];
    let team: Vec<Option<Task>> = tasks.iter().copied().map(Some).collect();
    let known = Known { task, team: &team, own: &seen, sensed: &[] };
    bound.write(&mut vec![0.0; bound.memory()], &known, &mut values);
    require(values.iter().all(|value| value.is_finite()), || "a channel of the observation is not finite at the start")
}

fn distance(scenario: &dyn Scenario, task: &Task) -> Result<(), String> {
    let left = scenario.distance_to_go(task, task.goal);
    require(left < 1e-5, || format!("at the goal there are {left} m to go"))?;
    (0..=100).try_for_each(|k| {
        let position = task.start + (task.goal - task.start) * (k as f32 / 100.0);
        let to_go = scenario.distance_to_go(task, position);
        require(to_go >= (task.goal - position).norm() - 1e-4, || {
            format!("{to_go} m to go from {} to {} are less than a straight line", position.shown(), task.goal.shown())
        })
    })
}

/// Checks a task of a scenario without goals.
fn no_goal(scenario: &dyn Scenario, task: &Task) -> Result<(), String> {
    for position in [task.start, task.goal] {
        require(!scenario.reached(task, position), || "a robot has reached a goal, but the scenario has a cost")?;
        let left = scenario.distance_to_go(task, position);
        require(left == 0.0, || format!("there are {left} m to go, but the scenario has no goals"))?;
    }
    let velocity = scenario.start_velocity(task);
    require(is_finite(velocity), || format!("an initial velocity of {}", velocity.shown()))?;
    let (sin, cos) = libm::sincosf(task.heading());
    let across = cos * velocity.y - sin * velocity.x;
    let along = across.abs() < 1e-3 && cos * velocity.x + sin * velocity.y > -1e-3;
    require(along, || format!("an initial velocity of {}, not along the way to the task's goal", velocity.shown()))
}

/// Checks the cost of a scenario without goals, for its initial states and for a team at rest.
fn costs(scenario: &dyn Scenario) -> Result<(), String> {
    let Some(cost) = scenario.cost() else { return Ok(()) };
    let limit = scenario.rules().limit;
    require(limit > Span::ZERO, || "its episodes, which end by time, take none")?;
    for tasks in (0..4).map(|episode| scenario.tasks(7, episode)) {
        let goals: Vec<Vec2> = tasks.iter().map(|task| task.goal).collect();
        let moving = |task: &Task| Motion { position: task.start, velocity: scenario.start_velocity(task) };
        let at_rest = |task: &Task| Motion::at_rest(task.start);
        for team in [tasks.iter().map(moving).collect::<Vec<_>>(), tasks.iter().map(at_rest).collect()] {
            let found = (cost.of)(&team, &goals);
            require(found.is_finite() && found >= 0.0, || format!("a cost of {found}"))?;
            require((cost.of)(&team, &goals) == found, || "another cost of the same team")?;
        }
    }
    Ok(())
}

fn reward(scenario: &dyn Scenario, task: &Task) -> Result<(), String> {
    let mut stage = Progress::default();
    // From start to goal along a line, through walls, which a reward does not know.
    for k in 0..=400 {
        let share = (k as f32 / 200.0).min(1.0);
        let position = task.start + (task.goal - task.start) * share;
        let motion = Motion { position, velocity: task.goal - task.start };
        let contacts = Contacts { robot: k == 10, wall: k == 20 };
        let before = stage;
        let Some(earned) = scenario.reward(task, &motion, contacts, &mut stage) else { break };
        require(earned.is_finite(), || format!("a reward of {earned} at {}", position.shown()))?;
        require(stage >= before, || format!("{stage:?} after {before:?} at {}", position.shown()))?;
    }
    require(
        scenario.reached(task, task.goal) || scenario.cost().is_some(),
        || "a robot at its goal has not reached it",
    )?;
    let motion = Motion::at_rest(task.goal);
    let free = scenario.reward(task, &motion, Contacts::default(), &mut stage.clone());
    let blocked = scenario.reward(task, &motion, Contacts { robot: true, wall: true }, &mut stage);
    require(blocked < free || free.is_none(), || "contacts at the goal cost nothing")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Rules, swap};

    /// A scenario whose robots all have the same goal.
    #[derive(Debug)]
    struct Crowd(Arc<dyn Scenario>);

    impl Scenario for Crowd {
        fn name(&self) -> &'static str {
            "crowd"
        }
        fn robots(&self) -> usize {
            self.0.robots()
        }
        fn arena(&self) -> &Arena {
            self.0.arena()
        }
        fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
            let tasks = self.0.tasks(seed, episode);
            tasks.iter().map(|_| tasks[0]).collect()
        }
        fn frame(&self, task: &Task) -> PolicyFrame {
            self.0.frame(task)
        }
        fn rules(&self) -> Rules {
            self.0.rules()
        }
    }

    fn crowd(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
        Ok(Arc::new(Crowd(swap::build(settings)?)))
    }

    /// A scenario that says nothing of sizes.
    fn rigid(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
        Ok(Arc::new(Crowd(swap::build(&Settings { scale: None, hull_m: None, ..*settings })?)))
    }

    /// A scenario that has the scale, and robots of one size to the judge.
    #[derive(Debug)]
    struct Lenient(Arc<dyn Scenario>);

    impl Scenario for Lenient {
        fn name(&self) -> &'static str {
            "lenient"
        }
        fn robots(&self) -> usize {
            self.0.robots()
        }
        fn arena(&self) -> &Arena {
            self.0.arena()
        }
        fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
            self.0.tasks(seed, episode)
        }
        fn frame(&self, task: &Task) -> PolicyFrame {
            self.0.frame(task)
        }
        fn rules(&self) -> Rules {
            Rules { separation_m: 0.32, ..self.0.rules() }
        }
    }

    #[test]
    fn a_scenario_of_one_size_refuses_another_one_and_a_judge_of_other_robots_is_named() {
        let entry = Entry { name: "crowd", about: "", build: rigid };
        let refused = |settings| build_of(&[entry], "crowd", &settings).unwrap_err();
        let error = refused(Settings { scale: Some(0.9), ..Settings::default() });
        assert!(error.field() == "scale" && error.to_string().contains("one size only"), "{error}");
        let error = refused(Settings { hull_m: Some(0.1), ..Settings::default() });
        assert!(error.field() == "hull_m" && error.to_string().contains("one size of robots only"), "{error}");
        assert!(build_of(&[entry], "crowd", &Settings { scale: Some(1.0), ..Settings::default() }).is_ok());
        let lenient =
            Entry { name: "lenient", about: "", build: |settings| Ok(Arc::new(Lenient(swap::build(settings)?))) };
        let broken = check(&lenient).unwrap_err();
        assert!(broken.contains("hull_m 0.06: robots collide at 0.32 m"), "{broken}");
    }

    #[test]
    fn a_broken_promise_is_named_with_scenario_seed_and_robot() {
        let entry = Entry { name: "crowd", about: "one goal for all", build: crowd };
        let broken = check(&entry).unwrap_err();
        assert!(broken.starts_with("crowd of "), "{broken}");
        assert!(broken.contains("seed 0, episode 0"), "{broken}");
        let broken = check(&Entry { name: "other", ..entry }).unwrap_err();
        assert!(broken.contains("its name is not 'other'"), "{broken}");
    }
}
