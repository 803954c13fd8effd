//! The class `VecEnv`: a vectorised environment on numpy buffers that it owns.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use murmurate::policy::manifest::Field;
use murmurate_train::vector::{Autoreset, Buffers, Content, Options, VectorEnvironment, options_of};
use numpy::{PyArray1, PyArray3, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};

use crate::arguments::{Arguments, Given, Seed, whole, wrong};
use crate::arrays::{Shapes, finite, opened, values, zeros};
use crate::memory;
use crate::picture::Picture;
use crate::task::PythonTask;
use crate::tasked::{Begins, core_of};
use crate::turn::{Turn, bytes_of};

/// Vectorised environment of one scenario: N teams of R robots each, advanced together, with results in numpy arrays
/// that every step writes again. docs/python.md describes the arrays.
///
/// Its attributes may be read at any time. A step, a reset or a state keeps out those of other threads meanwhile.
#[pyclass(frozen, weakref, module = "murmurate")]
pub struct VecEnv {
    pub(crate) environments: Mutex<VectorEnvironment>,
    /// Whether a thread works on the environments.
    busy: AtomicBool,
    /// Settings, but for the seed.
    pub(crate) options: Options,
    /// Seed from which the random streams last began anew.
    seed: AtomicU64,
    /// Observations (N, R, F), float32: pairs of floats [m] or [m/s], policy frame, as `observation_fields` names them.
    #[pyo3(get)]
    pub(crate) obs: Py<PyArrayDyn<f32>>,
    /// Observations (N, R, F) before an automatic reset: where an episode has ended, its last ones.
    #[pyo3(get)]
    pub(crate) last_obs: Py<PyArrayDyn<f32>>,
    /// Rewards (N, R), float32.
    #[pyo3(get)]
    pub(crate) reward: Py<PyArrayDyn<f32>>,
    /// Whether all robots have arrived (N).
    #[pyo3(get)]
    pub(crate) terminated: Py<PyArrayDyn<bool>>,
    /// Whether the time of the episode is over (N).
    #[pyo3(get)]
    pub(crate) truncated: Py<PyArrayDyn<bool>>,
    /// Whether each robot has arrived (N, R).
    #[pyo3(get)]
    pub(crate) arrived: Py<PyArrayDyn<bool>>,
    /// Whether a receiver uses a message of a sender (N, R, R), by receiver and then by sender; (0, R, R) without
    /// messages.
    #[pyo3(get)]
    pub(crate) heard: Py<PyArrayDyn<bool>>,
    /// Time since the message in use arrived [s] (N, R, R), by receiver and then by sender.
    #[pyo3(get)]
    pub(crate) age: Py<PyArrayDyn<f32>>,
    /// Content of the message in use (N, R, R, M), by receiver and then by sender.
    #[pyo3(get)]
    pub(crate) said: Py<PyArrayDyn<f32>>,
    /// Distances along the rays of each robot's lidar [m] (N, R, K), float32, its range for no echo; (N, R, 0) without
    /// one. Rays all around are numbered in the policy frame, others in the robot's own frame.
    #[pyo3(get)]
    pub(crate) scan: Py<PyArrayDyn<f32>>,
    /// Distances [m] (N, R, K) before an automatic reset: where an episode has ended, its last ones.
    #[pyo3(get)]
    pub(crate) last_scan: Py<PyArrayDyn<f32>>,
    /// Result of the method `observe` of a task in Python (N, R, K), float32, after a reset where there was one;
    /// (N, R, 0) without such a method.
    #[pyo3(get)]
    pub(crate) observed: Py<PyArrayDyn<f32>>,
    /// Result of that method (N, R, K) before an automatic reset.
    #[pyo3(get)]
    pub(crate) last_observed: Py<PyArrayDyn<f32>>,
    /// Task in Python; `None` for another scenario.
    pub(crate) task: Option<Arc<PythonTask>>,
}

/// Opens all buffers of the environment for writing, as `Buffers`, and works on the environments without holding up
/// other threads of Python.
macro_rules! with_buffers {
    ($self:ident, $py:ident, |$environments:ident, $buffers:ident| $work:expr) => {{
        let shapes = Shapes::of(&$self.options);
        macro_rules! open {
            ($name:ident, $shape:ident) => {
                opened((stringify!($name), $self.$name.bind($py)), &shapes.$shape)?
            };
        }
        let (mut obs, mut last_obs, mut reward) = (open!(obs, obs), open!(last_obs, obs), open!(reward, rows));
        let (mut terminated, mut truncated) = (open!(terminated, environments), open!(truncated, environments));
        let (mut arrived, mut heard) = (open!(arrived, rows), open!(heard, edges));
        let (mut age, mut said) = (open!(age, edges), open!(said, said));
        let (mut scan, mut last_scan) = (open!(scan, scan), open!(last_scan, scan));
        #[allow(unused_mut, reason = "a step takes them apart")]
        let mut $buffers = Buffers {
            observation: obs.as_slice_mut()?,
            last_observation: last_obs.as_slice_mut()?,
            reward: reward.as_slice_mut()?,
            terminated: terminated.as_slice_mut()?,
            truncated: truncated.as_slice_mut()?,
            arrived: arrived.as_slice_mut()?,
            heard: heard.as_slice_mut()?,
            age_s: age.as_slice_mut()?,
            message: said.as_slice_mut()?,
            scan: scan.as_slice_mut()?,
            last_scan: last_scan.as_slice_mut()?,
        };
        let mutex = &$self.environments;
        $py.detach(move || {
            let mut guard = mutex.lock().map_err(|_| PyRuntimeError::new_err(PANICKED))?;
            let $environments = &mut *guard;
            Ok::<_, PyErr>($work)
        })?
    }};
}

pub(crate) use with_buffers;

/// Text of the error after a defect.
pub(crate) const PANICKED: &str =
    "a step of this environment has panicked before, a defect of murmurate; make a new one";

impl VecEnv {
    /// Returns these environments with buffers of their sizes, filled with zeros.
    fn allocated(
        py: Python<'_>,
        environments: VectorEnvironment,
        (task, observed): (Option<Arc<PythonTask>>, usize),
    ) -> PyResult<VecEnv> {
        let options = environments.options().clone();
        let shapes = Shapes::of(&options);
        Ok(VecEnv {
            environments: Mutex::new(environments),
            busy: AtomicBool::new(false),
            seed: AtomicU64::new(options.seed),
            options,
            obs: zeros(py, &shapes.obs)?,
            last_obs: zeros(py, &shapes.obs)?,
            reward: zeros(py, &shapes.rows)?,
            terminated: zeros(py, &shapes.environments)?,
            truncated: zeros(py, &shapes.environments)?,
            arrived: zeros(py, &shapes.rows)?,
            heard: zeros(py, &shapes.edges)?,
            age: zeros(py, &shapes.edges)?,
            said: zeros(py, &shapes.said)?,
            scan: zeros(py, &shapes.scan)?,
            last_scan: zeros(py, &shapes.scan)?,
            observed: zeros(py, &[shapes.rows[0], shapes.rows[1], observed])?,
            last_observed: zeros(py, &[shapes.rows[0], shapes.rows[1], observed])?,
            task,
        })
    }

    /// Makes environments, if there is memory for them, and fills their arrays.
    pub(crate) fn made(py: Python<'_>, options: Options, task: Option<Arc<PythonTask>>) -> PyResult<VecEnv> {
        let what = format!("num_envs: {} environments of {} robots", options.environments, options.scenario.robots());
        // A step of a task in Python keeps what was before it.
        let copies = if task.as_ref().is_some_and(|task| task.has_methods()) { 2 } else { 1 };
        memory::ensure(&what, copies * options.memory_bytes())?;
        if let Some(task) = &task {
            task.prepare(py, options.scenario.robots(), &options.first_layouts(options.seed))?;
        }
        let environments = py.detach(|| VectorEnvironment::new(options));
        let observed = crate::tasked::first_look(py, task.as_deref(), &environments)?;
        let floats = observed.as_ref().map_or(Ok(0), |observed| observed.getattr("shape")?.get_item(2)?.extract())?;
        let this = VecEnv::allocated(py, environments, (task, floats))?;
        with_buffers!(this, py, |environments, buffers| environments.begin(buffers));
        this.begin_observed(py, observed)?;
        Ok(this)
    }

    /// Keeps out other threads until the result is dropped. If one works on the environments, that is an error.
    fn turn(&self, what: &str) -> PyResult<Turn<'_>> {
        Turn::of(&self.busy, (what, "environment"))
    }
}

#[pymethods]
impl VecEnv {
    #[new]
    #[pyo3(signature = (
        scenario = None, num_envs = None, *, threads = None, conditions = None, message = None, message_size = None,
        autoreset = None, seed = Some(Seed(0)), num_robots = None, gap_m = None, episode_s = None, config = None,
        stage = None, penalties = None, repeat = None, radio = None, filtered = None,
        scale = None, hull_m = None, senses = None,
    ), text_signature = "(scenario='passage', num_envs=1, *, threads=1, conditions='perfect', message=None, \
        message_size=None, autoreset='same-step', seed=0, num_robots=None, gap_m=None, episode_s=None, config=None, \
        stage=None, penalties=None, repeat=None, radio=None, filtered=None, \
        scale=None, hull_m=None, senses=None)")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn new(
        py: Python<'_>,
        scenario: Given<'_, '_>,
        num_envs: Given<'_, '_>,
        threads: Given<'_, '_>,
        conditions: Given<'_, '_>,
        message: Given<'_, '_>,
        message_size: Given<'_, '_>,
        autoreset: Given<'_, '_>,
        seed: Option<Seed>,
        num_robots: Given<'_, '_>,
        gap_m: Given<'_, '_>,
        episode_s: Given<'_, '_>,
        config: Given<'_, '_>,
        stage: Given<'_, '_>,
        penalties: Given<'_, '_>,
        repeat: Given<'_, '_>,
        radio: Given<'_, '_>,
        filtered: Given<'_, '_>,
        scale: Given<'_, '_>,
        hull_m: Given<'_, '_>,
        senses: Given<'_, '_>,
    ) -> PyResult<VecEnv> {
        let arguments = Arguments {
            scenario,
            num_envs,
            threads,
            conditions,
            message,
            message_size,
            autoreset,
            num_robots,
            gap_m,
            episode_s,
            config,
            stage,
            penalties,
            repeat,
            radio,
            filtered,
            scale,
            hull_m,
            senses,
        };
        let (options, task) = arguments.options(py, Seed::or_drawn(seed, py)?)?;
        VecEnv::made(py, options, task)
    }

    /// Advances every environment by `repeat` steps of 50 ms. `actions` are velocities [m/s] in the policy frame,
    /// float32 (N, R, 2); `messages` are the floats that the policies put out, float32 (N, R, M), only with
    /// `message="action"`.
    #[pyo3(signature = (actions, messages = None))]
    fn step(&self, py: Python<'_>, actions: &Bound<'_, PyAny>, messages: Given<'_, '_>) -> PyResult<()> {
        let _turn = self.turn("step")?;
        let (n, lengths) = (self.num_envs(), self.options.lengths());
        let actions = values::<f32>(("actions", actions), &[n, lengths.robots, 2])?;
        let actions = actions.as_slice()?;
        finite("actions", actions)?;
        let shape = [n, lengths.robots, lengths.message];
        let said = match (self.options.content, messages) {
            (Content::Actions(_), Some(messages)) => Some(values::<f32>(("messages", messages), &shape)?),
            (Content::Actions(_), None) => return Err(wrong("messages", format!("missing; their shape is {shape:?}"))),
            (_, Some(_)) => return Err(wrong("messages", "only an environment with message='action' takes them")),
            (_, None) => None,
        };
        let words = said.as_ref().map_or(Ok(&[][..]), |said| said.as_slice())?;
        finite("messages", words)?;
        match self.task.as_deref().filter(|task| task.has_methods()) {
            Some(task) => self.step_task(py, task, (actions, words))?,
            None => with_buffers!(self, py, |environments, buffers| environments.step(actions, words, buffers)),
        }
        Ok(())
    }

    /// Starts new episodes: in the environments where `mask`, bool (N), is true, or in all. Others do not change. With
    /// `seed` all random numbers begin anew; that is possible for all environments together.
    #[pyo3(signature = (mask = None, *, seed = None))]
    fn reset(&self, py: Python<'_>, mask: Given<'_, '_>, seed: Option<Seed>) -> PyResult<()> {
        let _turn = self.turn("reset")?;
        let mask = mask.map(|mask| values::<bool>(("mask", mask), &[self.num_envs()])).transpose()?;
        let mask = mask.as_ref().map(|mask| mask.as_slice()).transpose()?;
        match seed {
            Some(_) if mask.is_some() => Err(wrong("seed", "it is for all environments; leave mask out")),
            Some(Seed(seed)) => {
                if let Some(task) = self.task.as_deref().filter(|task| task.has_methods()) {
                    self.begin_task(py, task, Begins::Anew(seed))?;
                    self.seed.store(seed, Ordering::Relaxed);
                    return Ok(());
                }
                with_buffers!(self, py, |environments, buffers| environments.reseed(seed, buffers));
                self.seed.store(seed, Ordering::Relaxed);
                Ok(())
            }
            None => {
                let chosen = |environment: usize| mask.is_none_or(|mask| mask[environment]);
                if let Some(task) = self.task.as_deref().filter(|task| task.has_methods()) {
                    let chosen: Vec<bool> = (0..self.num_envs()).map(chosen).collect();
                    return self.begin_task(py, task, Begins::Chosen(&chosen));
                }
                with_buffers!(self, py, |environments, buffers| environments.reset(chosen, buffers));
                Ok(())
            }
        }
    }

    /// Returns the state of all environments as bytes: robots, random streams, held messages, filters and clocks of the
    /// episodes, and the contents of the arrays. `set_state` continues from it to the bit.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let _turn = self.turn("state")?;
        // The metadata, and then the whole.
        memory::ensure("state: it would", 2 * self.options.memory_bytes())?;
        let bytes = with_buffers!(self, py, |environments, buffers| environments.state(&buffers));
        match self.task.as_deref().filter(|task| task.has_methods()) {
            Some(_) => self.with_observed(py, &bytes),
            None => Ok(PyBytes::new(py, &bytes)),
        }
    }

    /// Returns the true states of all robots, world frame, after the last step or reset: a `murmurate.State`.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let _turn = self.turn("truth")?;
        self.state_of(py, None)
    }

    /// Continues from a state of environments with the same arguments; `seed` and `threads` may differ. Nothing changes
    /// if the state is refused.
    fn set_state(&self, py: Python<'_>, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let _turn = self.turn("set_state")?;
        self.restore(py, &bytes_of(state)?)
    }

    /// Returns environments that continue to the bit as these do, with arrays of their own.
    fn copy(&self, py: Python<'_>) -> PyResult<VecEnv> {
        let _turn = self.turn("copy")?;
        memory::ensure("copy: its environments", self.options.memory_bytes())?;
        let copied = with_buffers!(self, py, |environments, _buffers| environments.clone());
        let floats = self.observed.bind(py).shape()[2];
        let copy = VecEnv::allocated(py, copied, (self.task.clone(), floats))?;
        macro_rules! copied {
            ($($name:ident)*) => { $(self.$name.bind(py).copy_to(copy.$name.bind(py))?;)* };
        }
        copied!(obs last_obs reward terminated truncated arrived heard age said scan last_scan observed last_observed);
        Ok(copy)
    }

    fn __copy__(&self, py: Python<'_>) -> PyResult<VecEnv> {
        self.copy(py)
    }

    fn __deepcopy__(&self, py: Python<'_>, _memo: &Bound<'_, PyAny>) -> PyResult<VecEnv> {
        self.copy(py)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let made = py.import("murmurate._module")?.getattr("restored")?;
        let scenario = self.task.as_ref().map(|task| task.bound().bind(py).getattr("scenario")).transpose()?;
        Ok((made, (self.state(py)?, scenario).into_pyobject(py)?))
    }

    /// Makes environments from a state, with its scenario from the registry and its settings. For a state of a task in
    /// Python, `scenario` is that task.
    #[staticmethod]
    #[pyo3(signature = (state, scenario = None))]
    fn from_state(py: Python<'_>, state: &Bound<'_, PyAny>, scenario: Given<'_, '_>) -> PyResult<VecEnv> {
        let bytes = bytes_of(state)?;
        let task = scenario.map(PythonTask::of).transpose()?.flatten();
        let registry = match &task {
            Some(task) => crate::registry().clone().with_task(&task.name()?, task.file()?),
            None => crate::registry().clone(),
        };
        let options =
            options_of(core_of(&bytes, task.as_deref())?, &registry).map_err(|error| wrong("state", error))?;
        let this = VecEnv::made(py, options, task)?;
        this.restore(py, &bytes)?;
        Ok(this)
    }

    /// Returns a picture of one environment, uint8 (height, width, 3): walls, robots as discs, and goals as rings.
    #[pyo3(signature = (environment = None))]
    fn render<'py>(&self, py: Python<'py>, environment: Given<'_, '_>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let _turn = self.turn("render")?;
        let last = self.num_envs() as i64 - 1;
        let environment = environment.map_or(Ok(0), |given| whole("environment", given, 0, last))? as usize;
        let guard = self.environments.lock().map_err(|_| PyRuntimeError::new_err(PANICKED))?;
        let (environments, row) = guard.place(environment);
        let picture = Picture::of(environments, row, self.options.scenario.cost().is_none());
        drop(guard);
        PyArray1::from_vec(py, picture.pixels).reshape([picture.height, picture.width, 3])
    }

    fn __repr__(&self) -> String {
        let (name, n, r) = (self.options.scenario.name(), self.num_envs(), self.num_robots());
        format!("<VecEnv '{name}': {n} environments of {r} robots>")
    }

    /// Name of the scenario.
    #[getter]
    fn scenario(&self) -> &str {
        self.options.scenario.name()
    }

    /// Number of environments N.
    #[getter]
    pub(crate) fn num_envs(&self) -> usize {
        self.options.environments
    }

    /// Number of robots R of each environment.
    #[getter]
    pub(crate) fn num_robots(&self) -> usize {
        self.options.scenario.robots()
    }

    /// Seed from which the random numbers last began anew.
    #[getter]
    fn seed(&self) -> u64 {
        self.seed.load(Ordering::Relaxed)
    }

    /// Largest commanded velocity along each axis [m/s].
    #[getter]
    fn limit_m_s(&self) -> f32 {
        self.options.limit_m_s
    }

    /// Largest distance between two robots that receive each other's messages [m].
    #[getter]
    fn radius_m(&self) -> f32 {
        self.options.radius_m
    }

    /// Longest time for which a deployed robot uses a message [s], as the configuration says.
    #[getter]
    fn hold_s(&self) -> f64 {
        self.options.hold_s
    }

    /// Longest duration of an episode [s].
    #[getter]
    fn episode_s(&self) -> f32 {
        self.options.episode_s
    }

    /// Largest number of calls of `step` in an episode.
    #[getter]
    fn episode_steps(&self) -> u32 {
        self.options.decisions()
    }

    /// Number of steps of 50 ms for which an action is held.
    #[getter]
    fn repeat(&self) -> u32 {
        self.options.repeat
    }

    /// What messages carry: None, "observations" or "action".
    #[getter]
    fn message(&self) -> Option<&'static str> {
        match self.options.content {
            Content::Nothing => None,
            Content::Observations => Some("observations"),
            Content::Actions(_) => Some("action"),
        }
    }

    /// When an ended episode is followed by the next one: "same-step" or "disabled".
    #[getter]
    fn autoreset(&self) -> &'static str {
        match self.options.autoreset {
            Autoreset::SameStep => "same-step",
            Autoreset::Disabled => "disabled",
        }
    }

    /// Names of the entries of an observation, each with two floats.
    #[getter]
    fn observation_fields(&self) -> Vec<&'static str> {
        let name = |field: &Field| match field {
            Field::GoalMinusPosition => "goal-minus-position",
            Field::Position => "position",
            Field::PositionPlusVelocity => "position-plus-velocity",
            Field::Velocity => "velocity",
            Field::FilterAndLag => "filter-and-lag",
        };
        self.options.observation.iter().map(name).collect()
    }
}

impl VecEnv {
    /// Continues from a state, which the caller has a turn for.
    fn restore(&self, py: Python<'_>, bytes: &[u8]) -> PyResult<()> {
        if let Some(task) = self.task.as_deref().filter(|task| task.has_methods()) {
            let seed = self.restore_task(py, task, bytes)?;
            self.seed.store(seed, Ordering::Relaxed);
            return Ok(());
        }
        core_of(bytes, None)?;
        let seed = with_buffers!(self, py, |environments, buffers| {
            let set = environments.set_state(bytes, buffers);
            set.map(|()| environments.options().seed)
        });
        self.seed.store(seed.map_err(|error| wrong("state", error))?, Ordering::Relaxed);
        Ok(())
    }
}
