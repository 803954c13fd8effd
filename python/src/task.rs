//! Tasks in Python: instances of `murmurate.Scenario`, whose methods draw layouts, give rewards, end episodes and
//! observe. The checks of what they return, but for places of robots, are in `murmurate/_bound.py`.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use murmurate::messages::geometry::{Task, Vec2};
use murmurate::scenario::task_file::{Behaviour, EpisodeStep};
use murmurate::scenario::{Scenario, Settings, TaskFile, layout};
use murmurate_train::vector::{LayoutKey, TeamStates};
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Sum of the rewards of an episode, by the indices of its repeat and of itself: the mean of the team's robots.
pub type Returns = BTreeMap<(u32, u32), f64>;

/// Task in Python, bound to its checks.
#[derive(Debug)]
pub struct PythonTask {
    /// Object of the class `Bound`.
    bound: Py<PyAny>,
    /// Name of the class, with which errors begin.
    class: String,
    text: String,
    has_reset: bool,
    has_reward: bool,
    has_done: bool,
    has_observe: bool,
    /// Layouts that are known: those that were drawn for episodes which are about to begin.
    layouts: Mutex<BTreeMap<LayoutKey, Vec<Task>>>,
    /// Scenarios with the ground of the task, by the number of robots, by which places are checked.
    grounds: Mutex<BTreeMap<usize, Arc<dyn Scenario>>>,
    /// First exception of a method that had no caller in Python.
    failure: Mutex<Option<PyErr>>,
    returns: Mutex<Returns>,
}

/// Ground of a task whose places are drawn elsewhere.
#[derive(Debug)]
struct Ground;

impl Behaviour for Ground {
    fn draws(&self) -> bool {
        true
    }

    fn tasks(&self, _: usize, _: u64, _: u32) -> Vec<Task> {
        unreachable!("a ground has no episodes")
    }

    fn judges(&self) -> bool {
        false
    }

    fn judge(&self, _: &EpisodeStep) -> bool {
        false
    }

    fn observes(&self) -> bool {
        false
    }

    fn observe(&self, _: &EpisodeStep) -> Vec<f32> {
        Vec::new()
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A value is whole after a panic elsewhere: each is replaced at once.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl PythonTask {
    /// Returns the task that an argument `scenario` is, an instance or a subclass of `murmurate.Scenario`; `None` for a
    /// name. A mistake in its attributes is a `ValueError` that names class and attribute.
    pub fn of(given: &Bound<'_, PyAny>) -> PyResult<Option<Arc<PythonTask>>> {
        let bound = given.py().import("murmurate._bound")?.call_method1("bound", (given,))?;
        if bound.is_none() {
            return Ok(None);
        }
        let has = |method: &str| bound.getattr("methods")?.contains(method);
        Ok(Some(Arc::new(PythonTask {
            class: bound.getattr("class_name")?.extract()?,
            text: bound.getattr("text")?.extract()?,
            has_reset: has("reset")?,
            has_reward: has("reward")?,
            has_done: has("done")?,
            has_observe: has("observe")?,
            bound: bound.unbind(),
            layouts: Mutex::default(),
            grounds: Mutex::default(),
            failure: Mutex::default(),
            returns: Mutex::default(),
        })))
    }

    /// Returns the task file of the task, with its behaviour.
    pub fn file(self: &Arc<PythonTask>) -> PyResult<TaskFile> {
        let behaviour = Arc::clone(self) as Arc<dyn Behaviour>;
        let file = TaskFile::with_behaviour(&self.text, behaviour).map_err(|error| self.wrong(error))?;
        match crate::registry().scenarios().iter().any(|entry| entry.name == file.name()) {
            true => Err(self.wrong(format!("name: '{}' is a scenario of this program; take another", file.name()))),
            false => Ok(file),
        }
    }

    /// Returns a `ValueError` that names class and attribute; `error` begins with the attribute.
    pub fn wrong(&self, error: impl std::fmt::Display) -> PyErr {
        PyValueError::new_err(format!("{}.{error}", self.class))
    }

    /// Returns the name of the task.
    pub fn name(&self) -> PyResult<String> {
        Ok(TaskFile::with_behaviour(&self.text, Arc::new(Ground)).map_err(|error| self.wrong(error))?.name().to_owned())
    }

    /// Whether the class has a method of its own.
    pub fn has_methods(&self) -> bool {
        self.has_reset || self.has_reward || self.has_done || self.has_observe
    }

    /// Returns the object of Python with the checks of the class.
    pub fn bound(&self) -> &Py<PyAny> {
        &self.bound
    }

    /// Whether the class has its own layouts.
    pub fn has_reset(&self) -> bool {
        self.has_reset
    }

    /// Whether the class has its own rewards.
    pub fn has_reward(&self) -> bool {
        self.has_reward
    }

    /// Whether the class has its own ends of episodes.
    pub fn has_done(&self) -> bool {
        self.has_done
    }

    /// Whether the class has its own observations.
    pub fn has_observe(&self) -> bool {
        self.has_observe
    }

    /// Draws the layouts of episodes of `robots` robots, in one call, and keeps them until `forget`. Does nothing
    /// without a method `reset`. A layout that robots cannot have is a `ValueError`; nothing is kept then.
    pub fn prepare(&self, py: Python<'_>, robots: usize, keys: &[LayoutKey]) -> PyResult<()> {
        if !self.has_reset || keys.is_empty() {
            return Ok(());
        }
        let drawn = self.draw(py, robots, keys)?;
        locked(&self.layouts).extend(keys.iter().copied().zip(drawn));
        Ok(())
    }

    /// Drops layouts whose episodes have begun.
    pub fn forget(&self) {
        locked(&self.layouts).clear();
    }

    /// Returns the layouts of episodes, which were checked.
    fn draw(&self, py: Python<'_>, robots: usize, keys: &[LayoutKey]) -> PyResult<Vec<Vec<Task>>> {
        let (seeds, episodes): (Vec<u64>, Vec<u32>) = keys.iter().copied().unzip();
        let drawn = self.bound.bind(py).call_method1("reset", (robots, seeds, episodes))?;
        let (starts, goals): (PyReadonlyArrayDyn<f32>, PyReadonlyArrayDyn<f32>) = drawn.extract()?;
        let points = |all: &[f32]| -> Vec<Vec2> { all.as_chunks::<2>().0.iter().map(|at| Vec2::from(*at)).collect() };
        let pairs = points(starts.as_slice()?).into_iter().zip(points(goals.as_slice()?));
        let tasks: Vec<Task> = pairs.map(|(start, goal)| Task { start, goal }).collect();
        let ground = self.ground(robots)?;
        let checked = tasks.chunks_exact(robots).enumerate().map(|(row, tasks)| {
            check(&*ground, tasks)
                .map_err(|why| self.wrong(format!("reset: in row {row} of {}, {why}", keys.len())))?;
            Ok(tasks.to_vec())
        });
        checked.collect()
    }

    fn ground(&self, robots: usize) -> PyResult<Arc<dyn Scenario>> {
        if let Some(known) = locked(&self.grounds).get(&robots) {
            return Ok(Arc::clone(known));
        }
        let file = TaskFile::with_behaviour(&self.text, Arc::new(Ground)).map_err(|error| self.wrong(error))?;
        let ground = file.scenario(&Settings::of(robots)).map_err(|error| PyValueError::new_err(error.to_string()))?;
        locked(&self.grounds).insert(robots, Arc::clone(&ground));
        Ok(ground)
    }

    /// Calls a method of the class with a state of teams of `robots` robots, and returns the array that it makes.
    pub fn call<'py>(&self, method: &str, robots: usize, state: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        self.bound.bind(state.py()).call_method1(method, (robots, state))
    }

    /// Returns the first exception of a method that had no caller in Python, and forgets it.
    pub fn take_failure(&self) -> Option<PyErr> {
        locked(&self.failure).take()
    }

    /// Returns whether a method that had no caller in Python has failed.
    pub fn has_failed(&self) -> bool {
        locked(&self.failure).is_some()
    }

    /// Returns the returns of the episodes that were judged.
    pub fn returns(&self) -> Returns {
        locked(&self.returns).clone()
    }

    fn fail(&self, error: PyErr) {
        locked(&self.failure).get_or_insert(error);
    }

    /// Returns whether the episode is to end, after its reward was added.
    fn judged(&self, py: Python<'_>, step: &EpisodeStep) -> PyResult<bool> {
        let (robots, state) = (step.robots.len(), state_at(py, step)?);
        if self.has_reward {
            let rewards: PyReadonlyArrayDyn<f32> = self.call("reward", robots, &state)?.extract()?;
            let sum: f64 = rewards.as_slice()?.iter().map(|reward| f64::from(*reward)).sum();
            let mut returns = locked(&self.returns);
            let all = returns.entry((step.repeat, step.episode)).or_insert(0.0);
            *all = if step.is_first { 0.0 } else { *all } + sum / robots as f64;
        }
        if !self.has_done {
            return Ok(false);
        }
        let ended: PyReadonlyArrayDyn<bool> = self.call("done", robots, &state)?.extract()?;
        Ok(ended.as_slice()?.iter().all(|ended| *ended))
    }
}

/// Makes the object of Python with the state of a team at a step of an episode.
fn state_at<'py>(py: Python<'py>, step: &EpisodeStep) -> PyResult<Bound<'py, PyAny>> {
    let states = TeamStates {
        position: step.robots.iter().map(|robot| [robot.point.x, robot.point.y]).collect(),
        velocity: step.robots.iter().map(|robot| [robot.velocity.x, robot.velocity.y]).collect(),
        start: step.tasks.iter().map(|task| [task.start.x, task.start.y]).collect(),
        goal: step.tasks.iter().map(|task| [task.goal.x, task.goal.y]).collect(),
        wall: step.robots.iter().map(|robot| robot.contacts.wall).collect(),
        robot: step.robots.iter().map(|robot| robot.contacts.robot).collect(),
        arrived: step.arrived.to_vec(),
        to_go_m: step.to_go_m.to_vec(),
        progress_m: step.progress_m.to_vec(),
        time_s: vec![step.after.as_secs() as f32],
    };
    state(py, step.robots.len(), states)
}

/// Makes the object of Python with the states of teams of `robots` robots.
pub fn state<'py>(py: Python<'py>, robots: usize, of: TeamStates) -> PyResult<Bound<'py, PyAny>> {
    let n = of.time_s.len();
    let arrays = PyDict::new(py);
    let pairs = [("position", of.position), ("velocity", of.velocity), ("start", of.start), ("goal", of.goal)];
    for (name, values) in pairs {
        arrays.set_item(name, PyArray1::from_vec(py, values.into_flattened()).reshape([n, robots, 2])?)?;
    }
    for (name, values) in [("wall", of.wall), ("robot", of.robot), ("arrived", of.arrived)] {
        arrays.set_item(name, PyArray1::from_vec(py, values).reshape([n, robots])?)?;
    }
    for (name, values) in [("to_go_m", of.to_go_m), ("progress_m", of.progress_m)] {
        arrays.set_item(name, PyArray1::from_vec(py, values).reshape([n, robots])?)?;
    }
    arrays.set_item("time_s", PyArray1::from_vec(py, of.time_s))?;
    py.import("murmurate._bound")?.call_method1("state", (arrays,))
}

/// Checks that robots have room at their starts and goals, apart from each other and from their goals.
fn check(ground: &dyn Scenario, tasks: &[Task]) -> Result<(), String> {
    layout::check(ground, tasks)?;
    match tasks.iter().position(|task| ground.reached(task, task.start)) {
        None => Ok(()),
        Some(robot) => {
            let arrival_m = ground.rules().arrival_m;
            Err(format!("robot {robot} starts within {arrival_m} m of its goal: draw goals farther away"))
        }
    }
}

impl Behaviour for PythonTask {
    fn draws(&self) -> bool {
        self.has_reset
    }

    fn tasks(&self, robots: usize, seed: u64, episode: u32) -> Vec<Task> {
        if let Some(known) = locked(&self.layouts).get(&(seed, episode)) {
            return known.clone();
        }
        let nowhere = || vec![Task { start: Vec2::zeros(), goal: Vec2::zeros() }; robots];
        if self.has_failed() {
            return nowhere();
        }
        Python::attach(|py| self.draw(py, robots, &[(seed, episode)])).map_or_else(
            |error| {
                self.fail(error);
                nowhere()
            },
            |mut drawn| drawn.remove(0),
        )
    }

    fn judges(&self) -> bool {
        self.has_reward || self.has_done
    }

    fn judge(&self, step: &EpisodeStep) -> bool {
        if self.has_failed() {
            return true;
        }
        Python::attach(|py| self.judged(py, step)).unwrap_or_else(|error| {
            self.fail(error);
            true
        })
    }

    fn observes(&self) -> bool {
        self.has_observe
    }

    fn observe(&self, step: &EpisodeStep) -> Vec<f32> {
        if self.has_failed() {
            return Vec::new();
        }
        let seen = |py: Python<'_>| -> PyResult<Vec<f32>> {
            let floats: PyReadonlyArrayDyn<f32> =
                self.call("observe", step.robots.len(), &state_at(py, step)?)?.extract()?;
            Ok(floats.as_slice()?.to_vec())
        };
        Python::attach(seen).unwrap_or_else(|error| {
            self.fail(error);
            Vec::new()
        })
    }
}
