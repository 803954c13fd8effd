//! The class `VecEnv`: a vectorised environment on numpy buffers that it owns.

use murmurate::policy::manifest::Field;
use murmurate::scenario::Settings;
use murmurate::train::config::{Conditions, Config};
use murmurate::train::vector::{Autoreset, Buffers, Content, Options, VectorEnvironment};
use numpy::{
    Element, PyArray1, PyArray2, PyArray3, PyArray4, PyArrayDescrMethods, PyArrayMethods, PyReadonlyArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods, dtype,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Vectorised environment of one scenario: N teams of R robots each, advanced together, with results in numpy arrays
/// that every step writes again. docs/python.md describes the arrays.
#[pyclass]
pub struct VecEnv {
    environments: VectorEnvironment,
    /// Observations (N, R, F), float32: goal minus position, position, position plus velocity [m], policy frame.
    #[pyo3(get)]
    obs: Py<PyArray3<f32>>,
    /// Observations (N, R, F) before an automatic reset: where an episode has ended, its last ones.
    #[pyo3(get)]
    last_obs: Py<PyArray3<f32>>,
    /// Rewards (N, R), float32.
    #[pyo3(get)]
    reward: Py<PyArray2<f32>>,
    /// Whether all robots have arrived (N).
    #[pyo3(get)]
    terminated: Py<PyArray1<bool>>,
    /// Whether the time of the episode is over (N).
    #[pyo3(get)]
    truncated: Py<PyArray1<bool>>,
    /// Whether each robot has arrived (N, R).
    #[pyo3(get)]
    arrived: Py<PyArray2<bool>>,
    /// Whether a receiver uses a message of a sender (N, R, R), by receiver and then by sender; (0, R, R) without
    /// messages.
    #[pyo3(get)]
    heard: Py<PyArray3<bool>>,
    /// Time since the message in use arrived [s] (N, R, R), by receiver and then by sender.
    #[pyo3(get)]
    age: Py<PyArray3<f32>>,
    /// Content of the message in use (N, R, R, M), by receiver and then by sender.
    #[pyo3(get)]
    said: Py<PyArray4<f32>>,
}

fn wrong(argument: &str, why: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(format!("{argument}: {why}"))
}

/// Returns the conditions of this name, from those of a training's configuration.
fn conditions(name: &str, config: &Config) -> PyResult<Conditions> {
    let of = |clean, deployed| Conditions { clean, deployed, everyone: 0.0, ..config.conditions.clone() };
    match name {
        "perfect" => Ok(of(1.0, 0.0)),
        "late" => Ok(of(0.0, 1.0)),
        "robust" => Ok(config.conditions.clone()),
        other => Err(wrong("conditions", format!("'{other}' is not 'perfect', 'robust' or 'late'"))),
    }
}

/// Returns the configuration of a preset, or that in a TOML file.
fn config(given: &str) -> PyResult<Config> {
    match Config::preset(given) {
        Some(config) => Ok(config),
        None => {
            let text = std::fs::read_to_string(given)
                .map_err(|error| wrong("config", format!("'{given}' is neither a preset nor a file: {error}")))?;
            Config::from_toml(&text).map_err(|error| wrong("config", format!("'{given}': {error}")))
        }
    }
}

/// Returns what messages between robots carry, as the arguments `message` and `message_size` say.
fn content(message: Option<&str>, message_size: usize) -> PyResult<Content> {
    match message {
        None => Ok(Content::Nothing),
        Some("observations") => Ok(Content::Observations),
        Some("action") if (1..=1024).contains(&message_size) => Ok(Content::Actions(message_size)),
        Some("action") => Err(wrong("message_size", format!("{message_size} is not 1 to 1024"))),
        Some(other) => Err(wrong("message", format!("'{other}' is not None, 'observations' or 'action'"))),
    }
}

/// Returns when an environment resets itself, as the argument `autoreset` says.
fn autoreset(given: &str) -> PyResult<Autoreset> {
    match given {
        "same-step" => Ok(Autoreset::SameStep),
        "disabled" => Ok(Autoreset::Disabled),
        other => Err(wrong("autoreset", format!("'{other}' is not 'same-step' or 'disabled'"))),
    }
}

/// Checks that an argument is an array of this type and shape, in row-major order, and returns its values.
fn values<'py, T: Element + Copy>(
    (argument, given): (&str, &Bound<'py, PyAny>),
    shape: &[usize],
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let py = given.py();
    let array = given
        .cast::<PyUntypedArray>()
        .map_err(|_| wrong(argument, format!("a {} is no numpy array", given.get_type())))?;
    if !array.dtype().is_equiv_to(&dtype::<T>(py)) {
        return Err(wrong(argument, format!("its type is {} and not {}", array.dtype(), dtype::<T>(py))));
    }
    if array.shape() != shape {
        return Err(wrong(argument, format!("its shape is {:?} and not {shape:?}", array.shape())));
    }
    if !array.is_c_contiguous() {
        return Err(wrong(argument, "it is not contiguous in row-major order: pass numpy.ascontiguousarray of it"));
    }
    let array = given.cast::<numpy::PyArrayDyn<T>>().map_err(|error| wrong(argument, error))?;
    array.try_readonly().map_err(|error| wrong(argument, error))
}

fn finite(argument: &str, values: &[f32]) -> PyResult<()> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(wrong(argument, format!("the value at flat index {at} is {}", values[at]))),
        None => Ok(()),
    }
}

/// Opens all buffers of the environment for writing, as `Buffers`.
macro_rules! with_buffers {
    ($self:ident, $py:ident, |$environments:ident, $buffers:ident| $work:expr) => {{
        macro_rules! open {
            ($name:ident) => {
                $self.$name.bind($py).try_readwrite().map_err(|error| wrong(stringify!($name), error))?
            };
        }
        let (mut obs, mut last_obs, mut reward) = (open!(obs), open!(last_obs), open!(reward));
        let (mut terminated, mut truncated, mut arrived) = (open!(terminated), open!(truncated), open!(arrived));
        let (mut heard, mut age, mut said) = (open!(heard), open!(age), open!(said));
        let $buffers = Buffers {
            observation: obs.as_slice_mut()?,
            last_observation: last_obs.as_slice_mut()?,
            reward: reward.as_slice_mut()?,
            terminated: terminated.as_slice_mut()?,
            truncated: truncated.as_slice_mut()?,
            arrived: arrived.as_slice_mut()?,
            heard: heard.as_slice_mut()?,
            age_s: age.as_slice_mut()?,
            message: said.as_slice_mut()?,
        };
        let $environments = &mut $self.environments;
        $py.detach(move || $work);
    }};
}

impl VecEnv {
    /// Returns `n` environments with buffers of their sizes, filled with zeros.
    fn allocated(py: Python<'_>, n: usize, environments: VectorEnvironment) -> VecEnv {
        let lengths = environments.lengths();
        let (r, f, m) = (lengths.robots, lengths.observation, lengths.message);
        let edges = if m > 0 { n } else { 0 };
        VecEnv {
            environments,
            obs: PyArray3::zeros(py, [n, r, f], false).unbind(),
            last_obs: PyArray3::zeros(py, [n, r, f], false).unbind(),
            reward: PyArray2::zeros(py, [n, r], false).unbind(),
            terminated: PyArray1::zeros(py, [n], false).unbind(),
            truncated: PyArray1::zeros(py, [n], false).unbind(),
            arrived: PyArray2::zeros(py, [n, r], false).unbind(),
            heard: PyArray3::zeros(py, [edges, r, r], false).unbind(),
            age: PyArray3::zeros(py, [edges, r, r], false).unbind(),
            said: PyArray4::zeros(py, [edges, r, r, m], false).unbind(),
        }
    }
}

#[pymethods]
impl VecEnv {
    #[new]
    #[pyo3(signature = (
        scenario = "passage", num_envs = 1, *, threads = 1, conditions = "perfect", message = None,
        message_size = 16, autoreset = "same-step", seed = 0, num_robots = None, gap_m = None, episode_s = None,
        config = "robust", radio = None, filtered = None,
    ))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn new(
        py: Python<'_>,
        scenario: &str,
        num_envs: usize,
        threads: usize,
        conditions: &str,
        message: Option<&str>,
        message_size: usize,
        autoreset: &str,
        seed: u64,
        num_robots: Option<usize>,
        gap_m: Option<f32>,
        episode_s: Option<f32>,
        config: &str,
        radio: Option<&str>,
        filtered: Option<f32>,
    ) -> PyResult<VecEnv> {
        let mut config = self::config(config)?;
        let (content, autoreset) = (self::content(message, message_size)?, self::autoreset(autoreset)?);
        for (argument, value, most) in [("num_envs", num_envs, 1 << 20), ("threads", threads, 1024)] {
            if !(1..=most).contains(&value) {
                return Err(wrong(argument, format!("{value} is not 1 to {most}")));
            }
        }
        let episode_s = episode_s.unwrap_or(config.episode_s);
        if !(0.05..=3600.0).contains(&episode_s) {
            return Err(wrong("episode_s", format!("{episode_s} is not 0.05 to 3600")));
        }
        let settings = Settings { robots: num_robots, gap_m };
        let scenario = crate::registry().scenario(scenario, &settings).map_err(|error| wrong("scenario", error))?;
        for (argument, given) in [("radio", radio.is_some()), ("filtered", filtered.is_some())] {
            if given && conditions == "perfect" {
                return Err(wrong(argument, "it has no effect with conditions='perfect'; take 'late' or 'robust'"));
            }
        }
        if let Some(radio) = radio {
            murmurate::program::with_radio("radio", radio, scenario.robots(), &mut config.conditions)
                .map_err(crate::program::exception)?;
        }
        if let Some(filtered) = filtered {
            if !(0.0..=1.0).contains(&filtered) {
                return Err(wrong("filtered", format!("{filtered} is not 0 to 1")));
            }
            config.conditions.filtered = filtered;
        }
        let environments = VectorEnvironment::new(Options {
            scenario,
            environments: num_envs,
            threads,
            conditions: self::conditions(conditions, &config)?,
            reward: config.reward,
            chassis: config.chassis(),
            observation: config.policy.observation.clone(),
            radius_m: config.policy.radius_m,
            limit_m_s: config.policy.limit_m_s,
            episode_s,
            content,
            autoreset,
            seed,
        });
        let mut this = VecEnv::allocated(py, num_envs, environments);
        this.reset(py, None, Some(seed))?;
        Ok(this)
    }

    /// Advances every environment by 50 ms. `actions` are velocities [m/s] in the policy frame, float32 (N, R, 2);
    /// `messages` are the floats that the policies put out, float32 (N, R, M), only with `message="action"`.
    #[pyo3(signature = (actions, messages = None))]
    fn step(
        &mut self,
        py: Python<'_>,
        actions: &Bound<'_, PyAny>,
        messages: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let (n, lengths) = (self.num_envs(), self.environments.lengths());
        let actions = values::<f32>(("actions", actions), &[n, lengths.robots, 2])?;
        let actions = actions.as_slice()?;
        finite("actions", actions)?;
        let shape = [n, lengths.robots, lengths.message];
        let said = match (self.environments.options().content, messages) {
            (Content::Actions(_), Some(messages)) => Some(values::<f32>(("messages", messages), &shape)?),
            (Content::Actions(_), None) => return Err(wrong("messages", format!("missing; their shape is {shape:?}"))),
            (_, Some(_)) => return Err(wrong("messages", "only an environment with message='action' takes them")),
            (_, None) => None,
        };
        let said = said.as_ref().map_or(Ok(&[][..]), |said| said.as_slice())?;
        finite("messages", said)?;
        with_buffers!(self, py, |environments, buffers| environments.step(actions, said, buffers));
        Ok(())
    }

    /// Starts new episodes: in the environments where `mask`, bool (N), is true, or in all. Others do not change. With
    /// `seed` all random numbers begin anew; that is possible for all environments together.
    #[pyo3(signature = (mask = None, *, seed = None))]
    fn reset(&mut self, py: Python<'_>, mask: Option<&Bound<'_, PyAny>>, seed: Option<u64>) -> PyResult<()> {
        let mask = mask.map(|mask| values::<bool>(("mask", mask), &[self.num_envs()])).transpose()?;
        let mask = mask.as_ref().map(|mask| mask.as_slice()).transpose()?;
        match seed {
            Some(_) if mask.is_some() => Err(wrong("seed", "it is for all environments; leave mask out")),
            Some(seed) => {
                with_buffers!(self, py, |environments, buffers| environments.reseed(seed, buffers));
                Ok(())
            }
            None => {
                let chosen = |environment: usize| mask.is_none_or(|mask| mask[environment]);
                with_buffers!(self, py, |environments, buffers| environments.reset(chosen, buffers));
                Ok(())
            }
        }
    }

    /// Number of environments N.
    #[getter]
    fn num_envs(&self) -> usize {
        self.environments.options().environments
    }

    /// Number of robots R of each environment.
    #[getter]
    fn num_robots(&self) -> usize {
        self.environments.lengths().robots
    }

    /// Largest commanded velocity along each axis [m/s].
    #[getter]
    fn limit_m_s(&self) -> f32 {
        self.environments.options().limit_m_s
    }

    /// Largest distance between two robots that receive each other's messages [m].
    #[getter]
    fn radius_m(&self) -> f32 {
        self.environments.options().radius_m
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
        self.environments.options().observation.iter().map(name).collect()
    }
}
