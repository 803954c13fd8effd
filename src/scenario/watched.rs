//! Episodes of a run as the behaviour of their task sees them: the judge, to which the behaviour adds ends, and the
//! observer, which gives what robots observe.

use std::sync::Arc;

use super::judge::{Judge, JudgedRobot, Judgement, Verdict};
use super::layout::Layouts;
use super::task_file::{Behaviour, EpisodeStep};
use super::{Scenario, TaskFile};
use crate::messages::geometry::{Task, Vec2};
use crate::messages::ids::RobotId;
use crate::time::Span;

/// Judge of a running episode: by the rules of the scenario, and by the behaviour of its task, if that judges.
#[derive(Clone, Debug)]
pub(crate) struct EpisodeJudge {
    /// Judge by the rules.
    pub(crate) rules: Judge,
    watched: Option<Watched>,
}

impl EpisodeJudge {
    /// Begins the episode with the index `episode` of the trial with the index `repeat`, whose episodes have these
    /// `layouts`.
    pub(crate) fn begun(
        scenario: &Arc<dyn Scenario>,
        (repeat, episode): (u32, u32),
        layouts: &Layouts,
    ) -> EpisodeJudge {
        let tasks = layouts.episode(episode);
        let rules = Judge::new(scenario.rules(), tasks.iter().map(|task| task.goal).collect());
        let watched = behaviour(&**scenario).filter(|behaviour| behaviour.judges());
        let watched = watched.map(|_| Watched::begun(scenario, (repeat, episode), tasks.to_vec()));
        let courses = RobotId::team(tasks.len()).map(|robot| layouts.course(episode, robot));
        let rules = rules.with_courses(courses.collect());
        EpisodeJudge { rules: rules.with_cost(scenario.cost()).with_goals(scenario.goals()), watched }
    }

    /// Processes the true states of all robots at one step, as `Judge::update` does. An episode that the behaviour of
    /// the task ends is a success, if it has not failed before.
    pub(crate) fn update(&mut self, after: Span, robots: &[JudgedRobot]) -> Option<Judgement> {
        let judged = self.rules.update(after, robots);
        let arrived = self.rules.arrived();
        let ends = self.watched.as_mut().map(|watched| watched.at(after, robots, arrived, |of, step| of.judge(step)));
        judged.or_else(|| (ends == Some(true)).then(|| self.rules.end(after, Verdict::Success)))
    }
}

/// Observer of the episodes of a run, for the sense `task`.
#[derive(Debug)]
pub(crate) struct Onlooker {
    scenario: Arc<dyn Scenario>,
    watched: Option<Watched>,
    arrived: Vec<bool>,
}

impl Onlooker {
    /// Returns the observer of the episodes of a scenario; `None` if the behaviour of its task does not observe.
    pub(crate) fn of(scenario: &Arc<dyn Scenario>) -> Option<Onlooker> {
        behaviour(&**scenario).filter(|behaviour| behaviour.observes())?;
        Some(Onlooker { scenario: Arc::clone(scenario), watched: None, arrived: Vec::new() })
    }

    /// Begins an episode, as `EpisodeJudge::begun` does.
    pub(crate) fn begin(&mut self, (repeat, episode): (u32, u32), tasks: Vec<Task>) {
        self.arrived = vec![false; tasks.len()];
        self.watched = Some(Watched::begun(&self.scenario, (repeat, episode), tasks));
    }

    /// Returns what the robots observe at a step; `None` before the first episode.
    pub(crate) fn look(&mut self, after: Span, robots: &[JudgedRobot]) -> Option<Vec<f32>> {
        let Onlooker { scenario, watched: Some(watched), arrived } = self else { return None };
        let points: Vec<Vec2> = robots.iter().map(|robot| robot.point).collect();
        let mut reached = vec![false; points.len()];
        scenario.arrivals(&watched.tasks, &points, &mut reached);
        arrived.iter_mut().zip(reached).for_each(|(arrived, reached)| *arrived |= reached);
        Some(watched.at(after, robots, arrived, |of, step| of.observe(step)))
    }
}

/// Episode with what its behaviour has seen of it.
#[derive(Clone, Debug)]
struct Watched {
    scenario: Arc<dyn Scenario>,
    repeat: u32,
    episode: u32,
    tasks: Vec<Task>,
    /// Lengths of the remaining paths at the last step \[m\]; empty before the first one.
    before_m: Vec<f32>,
}

fn behaviour(scenario: &dyn Scenario) -> Option<&Arc<dyn Behaviour>> {
    scenario.task_file().and_then(TaskFile::behaviour)
}

impl Watched {
    fn begun(scenario: &Arc<dyn Scenario>, (repeat, episode): (u32, u32), tasks: Vec<Task>) -> Watched {
        Watched { scenario: Arc::clone(scenario), repeat, episode, tasks, before_m: Vec::new() }
    }

    /// Returns the lengths of the remaining paths \[m\] of robots at these points \[m\], world frame.
    fn to_go_m(&self, points: impl Iterator<Item = Vec2>) -> Vec<f32> {
        let mut to_go_m = vec![0.0; self.tasks.len()];
        self.scenario.distances_to_go(&self.tasks, &points.collect::<Vec<_>>(), &mut to_go_m);
        to_go_m
    }

    /// Calls the behaviour with the state of the team at a step.
    fn at<T>(
        &mut self,
        after: Span,
        robots: &[JudgedRobot],
        arrived: &[bool],
        call: impl FnOnce(&dyn Behaviour, &EpisodeStep) -> T,
    ) -> T {
        let to_go_m = self.to_go_m(robots.iter().map(|robot| robot.point));
        let is_first = self.before_m.is_empty();
        let starts = || self.to_go_m(self.tasks.iter().map(|task| task.start));
        let before_m = if is_first { starts() } else { std::mem::take(&mut self.before_m) };
        let progress_m: Vec<f32> = before_m.iter().zip(&to_go_m).map(|(before, now)| before - now).collect();
        let Watched { repeat, episode, ref tasks, .. } = *self;
        let (to_go, progress_m) = (&to_go_m[..], &progress_m[..]);
        let step = EpisodeStep { repeat, episode, after, tasks, robots, arrived, to_go_m: to_go, progress_m, is_first };
        let behaviour = behaviour(&*self.scenario).expect("an episode is watched by a behaviour");
        let result = call(&**behaviour, &step);
        self.before_m = to_go_m;
        result
    }
}
