//! Content of an episode's picture, from the steps of a trial.

use std::f64::consts::FRAC_PI_2;

use murmurate::chassis::Chassis;
use murmurate::messages::geometry::{Task, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::Sample;
use murmurate::messages::wire::Phase;
use murmurate::net::media::radio::Radio;
use murmurate::observation::Sweep;
use murmurate::results::episode::Episode;
use murmurate::results::sensing::Sensing;
use murmurate::results::totals::{Hearing, Step};
use murmurate::scenario::course::Course;
use murmurate::scenario::judge::{Judge, JudgedRobot, Verdict};
use murmurate::scenario::{Arena, Cost, Goals, Rules, goals};
use murmurate::time::{Span, Time};

/// Shortest time between two frames; robots move little in it.
const FRAME: Span = Span::from_millis(48);
/// Largest move of a robot between the last step before an episode and its first step with which the former is also
/// shown \[m\].
const JUMP_M: f32 = 0.1;
/// Radius of the ring around a failure, in multiples of the robots' radius.
const WIDER: f32 = 1.45;

/// Largest number of late robots that the verdict names.
const NAMED: usize = 8;

/// Unchanging content of an episode's picture: texts, arena, rules and the robots' tasks.
#[derive(Clone, Debug)]
pub struct Backdrop<'a> {
    /// Title of the picture.
    pub title: String,
    /// Caption of the picture: all that is needed to reproduce the episode.
    pub caption: String,
    /// Ground and obstacles of the scenario.
    pub arena: &'a Arena,
    /// Rules by which the episode is judged.
    pub rules: Rules,
    /// Cost by which the episode is judged; `None` in a scenario with goals.
    pub cost: Option<Cost>,
    /// To whom the goals belong.
    pub goals: Goals,
    /// Radius of the robots' hulls \[m\].
    pub radius_m: f32,
    /// Age from which on a neighbour's message is old: a line between robots is then drawn with the least opacity.
    pub window: Span,
    /// Start and goal of every robot.
    pub tasks: &'a [Task],
    /// Course of every robot through its waypoints.
    pub courses: Vec<Course>,
    /// Chassis of every robot.
    pub chassis: Vec<Chassis>,
    /// Directions of the rays of each sense of the robots; `None` for one whose values are no distances.
    pub sweeps: Vec<Option<Sweep>>,
    /// Radio channel with space on which each robot is a station; `None` without one.
    pub radio: Option<&'a Radio>,
}

impl Backdrop<'_> {
    /// Returns for each goal whether it is reached by robots whose points are at `points` \[m\], world frame. That of a
    /// robot's own task also is if it was `before`, and is not before the robot has passed its course, which this
    /// follows.
    fn reached(&self, points: &[Vec2], courses: &mut [Course], before: &[bool]) -> Vec<bool> {
        let (goals, arrival_m) = (self.tasks.iter().map(|task| task.goal), self.rules.arrival_m);
        match self.goals {
            Goals::Labelled => {
                for (course, point) in courses.iter_mut().zip(points) {
                    course.pass(*point, arrival_m);
                }
                let robots = goals.zip(points).zip(courses);
                let near =
                    robots.map(|((goal, point), course)| course.is_through() && (goal - point).norm() <= arrival_m);
                near.zip(before).map(|(near, before)| near || *before).collect()
            }
            Goals::Unlabelled => goals::held(goals, points.iter().copied(), arrival_m),
        }
    }

    /// Returns the position of the point that a robot's policy commands \[m\], world frame.
    fn point(&self, sample: &Sample) -> Vec2 {
        self.chassis[sample.robot.index()].point_of(sample)
    }
}

/// Content of an episode's picture: what never changes, the frames and the verdict.
#[derive(Clone, Debug)]
pub struct Scene<'a> {
    /// Unchanging content: texts, arena, rules and tasks.
    pub stage: Backdrop<'a>,
    /// Frames from the start of the episode to its verdict; at least one.
    pub frames: Vec<SceneFrame>,
    /// Verdict on the episode as text, and the places to mark.
    pub ending: Ending,
}

/// State of the team at one instant of an episode's picture.
#[derive(Clone, Debug)]
pub struct SceneFrame {
    /// Time since the start of the episode.
    pub time: Span,
    /// Position of each robot's centre \[m\], world frame.
    pub at: Vec<Vec2>,
    /// Position of the point that each robot's policy commands \[m\], world frame.
    pub points: Vec<Vec2>,
    /// Links at this instant, sorted: each is a pair of robots of which at least one uses a message of the other.
    pub links: Vec<Link>,
    /// Newest scan of each sense of each robot.
    pub scans: Vec<Scan>,
}

/// Scan of a robot: the places of its echoes.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Number of the robot.
    pub robot: usize,
    /// Place of the sense when it was published \[m\], world frame.
    pub from: Vec2,
    /// Places of the echoes \[m\], world frame.
    pub echoes: Vec<Vec2>,
}

/// Pair of robots of which at least one uses a message of the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Smaller id of the two robots.
    pub one: usize,
    /// Larger id of the two robots.
    pub other: usize,
    /// Age of the message in use; if both robots use one, the larger age.
    pub age: Span,
    /// Whether each of the two robots uses a message of the other.
    pub mutual: bool,
}

/// End of an episode's picture: the verdict as text, and the places to mark.
#[derive(Clone, Debug)]
pub struct Ending {
    /// Whether the episode succeeded.
    pub success: bool,
    /// Verdict as text.
    pub text: String,
    /// Rings around the places at which the episode failed.
    pub rings: Vec<Ring>,
}

/// Ring that marks the place of a failure in an episode's picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Time since the start of the episode from which on the ring is shown.
    pub from: Span,
    /// Centre of the ring \[m\], world frame.
    pub at: Vec2,
    /// Radius of the ring \[m\].
    pub radius_m: f32,
}

/// First contact that fails an episode.
enum Contact {
    Wall(Span, usize, Vec2),
    Robots(Span, [usize; 2], Vec2, f32),
}

impl<'a> Scene<'a> {
    /// Returns the content of an episode's picture. `episode` is the result of the episode, `steps` are those of its
    /// trial.
    ///
    /// An episode without steps, which was aborted before it began, shows the robots at their starts.
    pub fn new(stage: Backdrop<'a>, episode: &Episode, steps: &[Step]) -> Scene<'a> {
        let (before, steps) = running(episode.episode, steps);
        let began = match (before, steps) {
            (Some(before), _) => time(before),
            // Without a step before it, the first step is assumed to be as long as the second.
            (None, [first, second, ..]) => {
                let step = time(second).since(time(first));
                Time::ZERO + time(first).since(Time::ZERO + step)
            }
            (None, _) => steps.first().map_or(Time::ZERO, time),
        };
        let mut judge = Judge::new(stage.rules, stage.tasks.iter().map(|task| task.goal).collect());
        judge = judge.with_cost(stage.cost).with_goals(stage.goals).with_courses(stage.courses.clone());
        let mut courses = stage.courses.clone();
        let (mut frames, mut contact, mut arrived): (Vec<SceneFrame>, _, _) =
            (Vec::new(), None, vec![false; stage.tasks.len()]);
        frames.extend(before.map(|step| frame(&stage, Span::ZERO, step)));
        for step in steps {
            let after = time(step).since(began);
            let seen: Vec<JudgedRobot> = step
                .samples
                .iter()
                .map(|s| JudgedRobot {
                    position: s.motion.position,
                    point: stage.point(s),
                    velocity: s.motion.velocity,
                    contacts: s.contacts,
                })
                .collect();
            let points: Vec<Vec2> = seen.iter().map(|seen| seen.point).collect();
            arrived = stage.reached(&points, &mut courses, &arrived);
            let over = judge.update(after, &seen).is_some();
            let touches = contact.is_none().then(|| touching(&stage, after, &seen)).flatten();
            let due = frames.last().is_none_or(|last| last.time + FRAME <= after);
            if due || over || touches.is_some() {
                frames.push(frame(&stage, after, step));
            }
            contact = contact.or(touches);
            if over {
                break;
            }
        }
        if frames.is_empty() {
            let at: Vec<Vec2> = stage.tasks.iter().map(|task| task.start).collect();
            frames.push(SceneFrame { time: Span::ZERO, points: at.clone(), at, links: Vec::new(), scans: Vec::new() });
        }
        let ending = ending(&stage, episode, contact, &arrived, &frames[frames.len() - 1]);
        Scene { stage, frames, ending }
    }

    /// Returns the number of robots in the picture.
    pub fn robots(&self) -> usize {
        self.stage.tasks.len()
    }

    /// Returns the duration of the episode, from its start to its last frame.
    pub fn length(&self) -> Span {
        self.frames.last().map_or(Span::ZERO, |frame| frame.time)
    }

    /// Returns for each goal the time from the start of the episode to the first arrival of its robot; for one that is
    /// unlabelled, the time from which on it has a robot until the end. `None` if there is no such time.
    pub fn arrivals(&self) -> Vec<Option<Span>> {
        let mut arrivals = vec![None; self.stage.tasks.len()];
        let (mut reached, mut courses) = (vec![false; arrivals.len()], self.stage.courses.clone());
        for frame in &self.frames {
            reached = self.stage.reached(&frame.points, &mut courses, &reached);
            for (arrival, reached) in arrivals.iter_mut().zip(&reached) {
                *arrival = reached.then(|| arrival.unwrap_or(frame.time));
            }
        }
        arrivals
    }

    /// Returns all pairs of robots, by ids and the smaller first, of which at any time one uses a message of the other.
    /// They are sorted.
    pub fn pairs(&self) -> Vec<(usize, usize)> {
        let mut pairs: Vec<_> =
            self.frames.iter().flat_map(|frame| &frame.links).map(|link| (link.one, link.other)).collect();
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }
}

/// Returns the last uninterrupted series of steps in which the episode runs, and the step before it unless a robot was
/// placed in between. There are several series if a host has left, since the episode is then repeated.
fn running(episode: u32, steps: &[Step]) -> (Option<&Step>, &[Step]) {
    let runs = |step: &Step| step.episode == episode && step.phase == Phase::Running;
    let end = steps.iter().rposition(runs).map_or(0, |last| last + 1);
    let begin = steps[..end].iter().rposition(|step| !runs(step)).map_or(0, |before| before + 1);
    let stretch = &steps[begin..end];
    let before = begin.checked_sub(1).map(|at| &steps[at]).filter(|before| {
        let moves = |first: &Step| {
            let pairs = before.samples.iter().zip(&first.samples);
            pairs.map(|(one, other)| (one.motion.position - other.motion.position).norm()).fold(0.0, f32::max)
        };
        stretch.first().is_some_and(|first| moves(first) < JUMP_M)
    });
    (before, stretch)
}

/// Returns the time of the latest sample of a step.
fn time(step: &Step) -> Time {
    step.samples.iter().map(|sample| sample.time).max().unwrap_or(Time::ZERO)
}

fn frame(stage: &Backdrop, time: Span, step: &Step) -> SceneFrame {
    let at = step.samples.iter().map(|sample| sample.motion.position).collect();
    let points = step.samples.iter().map(|sample| stage.point(sample)).collect();
    let scans = step.sensed.iter().filter_map(|sensing| scan(&stage.sweeps, sensing)).collect();
    SceneFrame { time, at, points, links: links(&step.hearing), scans }
}

/// Returns the places of the echoes of a scan; `None` for values that are no distances.
fn scan(sweeps: &[Option<Sweep>], sensing: &Sensing) -> Option<Scan> {
    let Sensing { sensed, position, heading } = sensing;
    let sweep = (*sweeps.get(usize::from(sensed.sense))?)?;
    let along = |angle: f64, x: f64| {
        let (sin, cos) = angle.sin_cos();
        Vec2::new((cos * x) as f32, (sin * x) as f32)
    };
    let (heading, [ahead, left]) = (f64::from(*heading), sweep.mount_m.map(f64::from));
    let from = position + along(heading, ahead) + along(heading + FRAC_PI_2, left);
    let rays = sensed.values.0.iter().enumerate().filter(|(_, range)| range.is_finite());
    let echo = |(ray, range): (usize, &f32)| {
        from + along(heading + sweep.from_rad + sweep.step_rad * ray as f64, f64::from(*range))
    };
    Some(Scan { robot: sensed.robot.index(), from, echoes: rays.map(echo).collect() })
}

/// Returns one link for each pair of robots of which at least one uses a message of the other.
fn links(hearing: &[Hearing]) -> Vec<Link> {
    let pair = |one: RobotId, other: RobotId| (one.index().min(other.index()), one.index().max(other.index()));
    let mut links: Vec<Link> = Vec::new();
    for Hearing { robot, of, age } in hearing {
        let (one, other) = pair(*robot, *of);
        match links.iter_mut().find(|link| (link.one, link.other) == (one, other)) {
            Some(link) => (link.age, link.mutual) = (link.age.max(*age), true),
            None => links.push(Link { one, other, age: *age, mutual: false }),
        }
    }
    links.sort_by_key(|link| (link.one, link.other));
    links
}

/// Returns the contact for which the judge would fail the episode at this instant; `None` if there is none.
fn touching(stage: &Backdrop, after: Span, seen: &[JudgedRobot]) -> Option<Contact> {
    if let Some(robot) = seen.iter().position(|robot| robot.contacts.wall) {
        return Some(Contact::Wall(after, robot, seen[robot].position));
    }
    let pairs = (0..seen.len()).flat_map(|one| (one + 1..seen.len()).map(move |other| [one, other]));
    let apart = |[one, other]: [usize; 2]| (seen[one].position - seen[other].position).norm();
    let nearest = pairs.min_by(|a, b| apart(*a).total_cmp(&apart(*b)))?;
    let middle = (seen[nearest[0]].position + seen[nearest[1]].position) / 2.0;
    (apart(nearest) < stage.rules.separation_m).then(|| Contact::Robots(after, nearest, middle, apart(nearest)))
}

/// Returns the verdict on an episode as text, and the places to mark.
fn ending(
    stage: &Backdrop,
    episode: &Episode,
    contact: Option<Contact>,
    arrived: &[bool],
    last: &SceneFrame,
) -> Ending {
    let late: Vec<usize> = (0..arrived.len()).filter(|robot| !arrived[*robot]).collect();
    let mut names = late.iter().take(NAMED).map(usize::to_string).collect::<Vec<_>>().join(", ");
    if late.len() > NAMED {
        names += &format!(" and {} more", late.len() - NAMED);
    }
    let ring = |from, at, apart_m: f32| vec![Ring { from, at, radius_m: stage.radius_m * WIDER + apart_m / 2.0 }];
    let (text, rings) = match (episode.verdict, contact) {
        (Verdict::Success, _) => {
            (format!("Success: all have arrived after {:.2} s", episode.makespan_s.unwrap_or(0.0)), Vec::new())
        }
        (Verdict::Completed, _) => ("Completed".to_owned(), Vec::new()),
        (Verdict::WallCollision, Some(Contact::Wall(after, robot, at))) => {
            (format!("Failure: robot {robot} touches a wall after {:.2} s", after.as_secs()), ring(after, at, 0.0))
        }
        (Verdict::RobotCollision, Some(Contact::Robots(after, [one, other], at, apart_m))) => {
            let how = format!("{apart_m:.2} m between their centres");
            let text = format!("Failure: robots {one} and {other} collide after {:.2} s, {how}", after.as_secs());
            (text, ring(after, at, apart_m))
        }
        (Verdict::WallCollision, _) => ("Failure: a robot has touched a wall".to_owned(), Vec::new()),
        (Verdict::RobotCollision, _) => ("Failure: two robots have collided".to_owned(), Vec::new()),
        (Verdict::Timeout, _) if stage.goals.are_unlabelled() => {
            let rings = late.iter().flat_map(|goal| ring(last.time, stage.tasks[*goal].goal, 0.0)).collect();
            (format!("Failure: timeout; {} of {} goals have no robot", late.len(), arrived.len()), rings)
        }
        (Verdict::Timeout, _) => {
            let rings = late.iter().flat_map(|robot| ring(last.time, last.at[*robot], 0.0)).collect();
            (format!("Failure: timeout; not at their goals: {names}"), rings)
        }
        (Verdict::Unseen, _) => ("A robot was out of sight for too long".to_owned(), Vec::new()),
        (Verdict::Aborted, _) => {
            let text = format!("Aborted after {:.2} s", last.time.as_secs());
            let text = episode.reason.map_or(text.clone(), |reason| format!("{text}: {reason}"));
            let robot = episode.reason.and_then(|reason| reason.robot);
            let at = robot.and_then(|robot| last.at.get(robot.index()));
            (text, at.map_or_else(Vec::new, |at| ring(last.time, *at, 0.0)))
        }
    };
    let text = match (stage.cost, episode.cost) {
        (Some(Cost { name, unit, .. }), Some(cost)) => format!("{text}; {name} {cost:.4} {unit}"),
        _ => text,
    };
    Ending { success: !episode.verdict.is_failure(), text, rings }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::messages::geometry::Motion;
    use murmurate::messages::local::{Contacts, Sample};
    use murmurate::messages::wire::{Features, Sensed};
    use murmurate::results::episode::{AbortCause, AbortReason, Judged};

    fn step(ms: u64, phase: Phase, xs: [f32; 2]) -> Step {
        let sample = |(robot, x): (RobotId, f32)| Sample {
            robot,
            time: Time::ZERO + Span::from_millis(ms),
            motion: Motion::at_rest(Vec2::new(x, 0.0)),
            heading: 0.0,
            yaw_rate: 0.0,
            command: Vec2::zeros(),
            contacts: Contacts::default(),
        };
        let hearing = vec![
            Hearing { robot: RobotId(0), of: RobotId(1), age: Span::from_millis(20) },
            Hearing { robot: RobotId(1), of: RobotId(0), age: Span::from_millis(70) },
        ];
        Step { episode: 0, phase, samples: RobotId::team(2).zip(xs).map(sample).collect(), hearing, sensed: Vec::new() }
    }

    #[test]
    fn an_episode_begins_at_the_robots_positions_and_ends_with_its_verdict() {
        let passage = murmurate::scenario::build("passage", &murmurate::scenario::Settings::of(2)).unwrap();
        let task = |x| Task { start: Vec2::new(x, 0.0), goal: Vec2::new(x + 0.5, 0.0) };
        let tasks = [task(0.0), task(1.0)];
        let stage = Backdrop {
            title: String::new(),
            caption: String::new(),
            arena: passage.arena(),
            rules: passage.rules(),
            cost: None,
            goals: Goals::Labelled,
            radius_m: 0.16,
            window: Span::from_millis(200),
            tasks: &tasks,
            courses: vec![Course::default(); 2],
            chassis: vec![Chassis::default(); 2],
            sweeps: Vec::new(),
            radio: None,
        };
        let steps = [
            step(1000, Phase::Resetting, [0.0, 1.0]),
            step(1050, Phase::Running, [0.05, 1.0]),
            step(1060, Phase::Running, [0.05, 1.0]),
            step(1100, Phase::Running, [0.5, 0.8]),
            step(1150, Phase::Running, [0.5, 1.5]),
            step(1200, Phase::Running, [0.5, 1.6]),
        ];
        let (verdict, makespan_s) = (Verdict::RobotCollision, None);
        let judged = Judged::Truth;
        let episode = Episode {
            repeat: 0,
            episode: 0,
            verdict,
            judged,
            makespan_s,
            reset_s: 0.0,
            min_separation_m: 0.3,
            cost: None,
            reason: None,
        };
        let scene = Scene::new(stage, &episode, &steps);
        let times: Vec<u64> = scene.frames.iter().map(|frame| frame.time.as_nanos() / 1_000_000).collect();
        assert_eq!(times, [0, 50, 100, 150]);
        assert_eq!(scene.arrivals(), [100, 150].map(|ms| Some(Span::from_millis(ms))));
        let link = Link { one: 0, other: 1, age: Span::from_millis(70), mutual: true };
        assert_eq!(scene.frames[1].links, [link]);
        assert!(scene.ending.text.contains("robots 0 and 1 collide after 0.10 s"), "{}", scene.ending.text);
        assert_eq!((scene.ending.rings.len(), scene.ending.rings[0].from), (1, Span::from_millis(100)));

        let unlabelled = Backdrop { goals: Goals::Unlabelled, ..scene.stage.clone() };
        let unlabelled = Scene::new(unlabelled, &Episode { verdict: Verdict::Timeout, ..episode }, &steps);
        assert_eq!(unlabelled.arrivals(), [100, 150].map(|ms| Some(Span::from_millis(ms))));
        assert_eq!(unlabelled.ending.text, "Failure: timeout; 0 of 2 goals have no robot");

        // Robot 1 passes 0.8 m before its goal at 1.5 m; robot 0 has its waypoint behind it from the start.
        let courses = [0.0, 0.6].map(|x| Course::new(vec![Vec2::new(x, 0.0)])).to_vec();
        let through = Scene::new(Backdrop { courses, ..scene.stage.clone() }, &episode, &steps);
        assert_eq!(through.arrivals(), [100, 150].map(|ms| Some(Span::from_millis(ms))));
        let courses = [2.0, 0.6].map(|x| Course::new(vec![Vec2::new(x, 0.0)])).to_vec();
        let missed = Scene::new(Backdrop { courses, ..scene.stage.clone() }, &episode, &steps);
        assert_eq!(missed.arrivals()[0], None, "a goal counts after the waypoints alone");

        let reason = Some(AbortReason { cause: AbortCause::Missing, robot: Some(RobotId(1)), others: 0 });
        let aborted = Episode { verdict: Verdict::Aborted, reason, ..episode };
        let ending = Scene::new(scene.stage.clone(), &aborted, &steps).ending;
        assert_eq!(ending.text, "Aborted after 0.15 s: robot 1 has not been heard for 1 s");
        assert_eq!(ending.rings.len(), 1, "and it is marked");
    }

    #[test]
    fn echoes_are_where_the_rays_of_a_turned_robot_end() {
        let sweeps = [None, Some(Sweep { mount_m: [0.5, 0.25], ..Sweep::new(3, (-FRAC_PI_2, 2.0 * FRAC_PI_2), 2.0) })];
        let values = Features([1.0, f32::INFINITY, 2.0].into());
        let sensing = |sense| {
            let sensed = Sensed::split(RobotId(1), sense, 0, &values.0).expect("they can be sent").remove(0);
            Sensing { sensed, position: Vec2::new(1.0, 2.0), heading: FRAC_PI_2 as f32 }
        };
        let scan = scan(&sweeps, &sensing(1)).expect("it has rays");
        let places = [(scan.from, (0.75, 2.5)), (scan.echoes[0], (1.75, 2.5)), (scan.echoes[1], (-1.25, 2.5))];
        for (place, (x, y)) in places {
            assert!((place - Vec2::new(x, y)).norm() < 1e-5, "{place:?}");
        }
        assert_eq!((scan.robot, scan.echoes.len()), (1, 2));
        assert!(super::scan(&sweeps, &sensing(0)).is_none() && super::scan(&sweeps, &sensing(2)).is_none());
    }
}
