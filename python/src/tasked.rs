//! Steps, resets and states of `VecEnv` with a task in Python. If a method of the task fails, everything is as before.

use murmurate_train::vector::{Autoreset, Buffers, VectorEnvironment, layouts_of};
use numpy::{PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::arguments::wrong;
use crate::arrays::{Shapes, opened};
use crate::task::{PythonTask, state};
use crate::vec_env::{PANICKED, VecEnv, with_buffers};

/// First bytes of the state of environments with a task in Python.
const MAGIC: &[u8; 16] = b"murmurate-pytask";

/// Episodes that begin.
#[derive(Clone, Copy)]
pub enum Begins<'a> {
    /// Those of all environments, with random streams from this seed.
    Anew(u64),
    /// Those of the environments whose entry is true.
    Chosen(&'a [bool]),
}

/// Returns what the task observes at the beginning of all environments; `None` if it does not observe. Fails if the
/// layouts of the environments could not be drawn.
pub fn first_look<'py>(
    py: Python<'py>,
    task: Option<&PythonTask>,
    environments: &VectorEnvironment,
) -> PyResult<Option<Bound<'py, PyAny>>> {
    let Some(task) = task else { return Ok(None) };
    task.forget();
    task.take_failure().map_or(Ok(()), Err)?;
    if !task.has_observe() {
        return Ok(None);
    }
    let robots = environments.options().scenario.robots();
    let state = state(py, robots, environments.states(|_| true))?;
    task.call("observe", robots, &state).map(Some)
}

/// Returns the state of the environments within a state of a task in Python, or the bytes themselves for other
/// environments. `task` is the task of the environments that are to continue from it.
pub fn core_of<'a>(bytes: &'a [u8], task: Option<&PythonTask>) -> PyResult<&'a [u8]> {
    let is_task = task.is_some_and(PythonTask::has_methods);
    match (bytes.strip_prefix(MAGIC), is_task) {
        (None, false) => Ok(bytes),
        (None, true) => Err(wrong("state", "it is not of a task in Python with methods of its own")),
        (Some(_), false) => {
            let why = "it is of a task in Python; give the task, too: VecEnv.from_state(state, Mine()), or set_state \
                       of VecEnv(Mine(), ...)";
            Err(wrong("state", why))
        }
        (Some(rest), true) => {
            let length = rest.get(4..12).and_then(|bytes| bytes.try_into().ok()).map(u64::from_le_bytes);
            let length = length.and_then(|length| usize::try_from(length).ok());
            length.and_then(|length| rest[12..].get(..length)).ok_or_else(|| wrong("state", "it ends too early"))
        }
    }
}

/// Returns the checksum of bytes.
fn checksum(py: Python<'_>, bytes: &[u8]) -> PyResult<u32> {
    py.import("zlib")?.getattr("crc32")?.call1((PyBytes::new(py, bytes),))?.extract()
}

impl VecEnv {
    /// Advances every environment, with one call of each method of the task.
    pub fn step_task(&self, py: Python<'_>, task: &PythonTask, given: (&[f32], &[f32])) -> PyResult<()> {
        let same_step = self.options.autoreset == Autoreset::SameStep;
        if !(task.has_reward() || task.has_done() || task.has_observe() || same_step) {
            with_buffers!(self, py, |environments, buffers| environments.step(given.0, given.1, buffers));
            return Ok(());
        }
        self.undoing(py, || {
            with_buffers!(self, py, |environments, buffers| environments.advance(given.0, given.1, buffers));
            let judged = task.has_reward() || task.has_done() || task.has_observe();
            let state = judged.then(|| self.state_of(py, None)).transpose()?;
            let ended = self.judged(py, task, state.as_ref())?;
            if let Some(state) = state.as_ref().filter(|_| task.has_observe()) {
                let seen = self.seen(task, state)?;
                self.write_observed(py, &seen, None)?;
            }
            let begins = if same_step { ended } else { vec![false; self.num_envs()] };
            let keys = self.looking(py, |environments| environments.next_layouts(|at| begins[at]))?;
            task.prepare(py, self.num_robots(), &keys)?;
            let begins = &begins[..];
            with_buffers!(self, py, |environments, buffers| environments.go_on(begins, buffers));
            self.look_again(py, task, begins)
        })
    }

    /// Starts episodes.
    pub fn begin_task(&self, py: Python<'_>, task: &PythonTask, begins: Begins) -> PyResult<()> {
        self.undoing(py, || {
            let keys = match begins {
                Begins::Anew(seed) => self.options.first_layouts(seed),
                Begins::Chosen(mask) => self.looking(py, |environments| environments.next_layouts(|at| mask[at]))?,
            };
            task.prepare(py, self.num_robots(), &keys)?;
            let all = vec![true; self.num_envs()];
            let mask = match begins {
                Begins::Anew(seed) => {
                    with_buffers!(self, py, |environments, buffers| environments.reseed(seed, buffers));
                    &all
                }
                Begins::Chosen(mask) => {
                    with_buffers!(self, py, |environments, buffers| environments.reset(|at| mask[at], buffers));
                    mask
                }
            };
            self.look_again(py, task, mask)?;
            self.copy_observed(py, mask)
        })
    }

    /// Observes in the environments that have begun, whose layouts were drawn.
    fn look_again(&self, py: Python<'_>, task: &PythonTask, begun: &[bool]) -> PyResult<()> {
        task.forget();
        task.take_failure().map_or(Ok(()), Err)?;
        if task.has_observe() && begun.contains(&true) {
            let state = self.state_of(py, Some(begun))?;
            let seen = self.seen(task, &state)?;
            self.write_observed(py, &seen, Some(begun))?;
        }
        Ok(())
    }

    /// Returns the bytes of a state with what the task has observed.
    pub fn with_observed<'py>(&self, py: Python<'py>, core: &[u8]) -> PyResult<Bound<'py, PyBytes>> {
        let mut rest = (core.len() as u64).to_le_bytes().to_vec();
        rest.extend_from_slice(core);
        for array in [&self.observed, &self.last_observed] {
            let floats: PyReadonlyArrayDyn<f32> = array.bind(py).extract()?;
            floats.as_slice()?.iter().for_each(|float| rest.extend_from_slice(&float.to_le_bytes()));
        }
        let sum = checksum(py, &rest)?.to_le_bytes();
        Ok(PyBytes::new(py, &[&MAGIC[..], &sum, &rest].concat()))
    }

    /// Continues from a state, and returns its seed.
    pub fn restore_task(&self, py: Python<'_>, task: &PythonTask, bytes: &[u8]) -> PyResult<u64> {
        let core = core_of(bytes, Some(task))?;
        let (sum, rest) = bytes[MAGIC.len()..].split_at(4);
        if checksum(py, rest)?.to_le_bytes() != sum {
            return Err(wrong("state", "the state is damaged: its checksum does not match; take a copy that is whole"));
        }
        let floats = rest[8 + core.len()..].as_chunks::<4>().0;
        let shape = self.observed.bind(py).shape().to_vec();
        let each: usize = shape.iter().product();
        if floats.len() != 2 * each {
            return Err(wrong("state", "the state is of other environments: 'observe' has another number of floats"));
        }
        let keys = layouts_of(core).map_err(|error| wrong("state", error))?;
        self.undoing(py, || {
            task.prepare(py, self.num_robots(), &keys)?;
            let set = with_buffers!(self, py, |environments, buffers| {
                environments.set_state(core, buffers).map(|()| environments.options().seed)
            });
            task.forget();
            let seed = set.map_err(|error| wrong("state", error))?;
            task.take_failure().map_or(Ok(()), Err)?;
            for (array, floats) in [&self.observed, &self.last_observed].into_iter().zip(floats.chunks(each.max(1))) {
                let mut to = opened(("observed", array.bind(py)), &shape)?;
                to.as_slice_mut()?.iter_mut().zip(floats).for_each(|(to, from)| *to = f32::from_le_bytes(*from));
            }
            Ok(seed)
        })
    }

    /// Writes what the task has observed at the beginning.
    pub fn begin_observed(&self, py: Python<'_>, observed: Option<Bound<'_, PyAny>>) -> PyResult<()> {
        observed.map_or(Ok(()), |observed| {
            self.write_observed(py, &observed, None)?;
            self.observed.bind(py).copy_to(self.last_observed.bind(py))
        })
    }

    /// Returns the state of all environments, or of those that `mask` selects, as the object that methods get.
    pub fn state_of<'py>(&self, py: Python<'py>, mask: Option<&[bool]>) -> PyResult<Bound<'py, PyAny>> {
        let states = self.looking(py, |environments| environments.states(|at| mask.is_none_or(|mask| mask[at])))?;
        state(py, self.num_robots(), states)
    }

    /// Calls `reward` and `done`, writes what they say, and returns where episodes have ended.
    fn judged(&self, py: Python<'_>, task: &PythonTask, state: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<bool>> {
        let (robots, shapes) = (self.num_robots(), Shapes::of(&self.options));
        let called =
            |has: bool, method: &str| state.filter(|_| has).map(|state| task.call(method, robots, state)).transpose();
        let (rewards, done) = (called(task.has_reward(), "reward")?, called(task.has_done(), "done")?);
        if let Some(rewards) = rewards {
            let rewards: PyReadonlyArrayDyn<f32> = rewards.extract()?;
            opened(("reward", self.reward.bind(py)), &shapes.rows)?
                .as_slice_mut()?
                .copy_from_slice(rewards.as_slice()?);
        }
        let mut terminated = opened(("terminated", self.terminated.bind(py)), &shapes.environments)?;
        let mut truncated = opened(("truncated", self.truncated.bind(py)), &shapes.environments)?;
        let (terminated, truncated) = (terminated.as_slice_mut()?, truncated.as_slice_mut()?);
        if let Some(done) = done {
            let done: PyReadonlyArrayDyn<bool> = done.extract()?;
            for ((ended, over), done) in terminated.iter_mut().zip(truncated.iter_mut()).zip(done.as_slice()?) {
                *ended |= done;
                *over &= !*ended;
            }
        }
        Ok(terminated.iter().zip(truncated.iter()).map(|(ended, over)| *ended || *over).collect())
    }

    /// Calls `observe`, whose array has to have as many floats as at the beginning.
    fn seen<'py>(&self, task: &PythonTask, state: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        task.call("observe", self.num_robots(), state)
    }

    /// Writes what was observed: without a mask what was before a reset and what is now, else what is now in the
    /// environments that the mask selects.
    fn write_observed(&self, py: Python<'_>, seen: &Bound<'_, PyAny>, mask: Option<&[bool]>) -> PyResult<()> {
        let seen: PyReadonlyArrayDyn<f32> = seen.extract()?;
        let (seen, shape) = (seen.as_slice()?, self.observed.bind(py).shape().to_vec());
        let each = shape[1] * shape[2];
        let write = |name: &str, array: &Py<PyArrayDyn<f32>>| {
            let mut to = opened((name, array.bind(py)), &shape)?;
            let chosen = to.as_slice_mut()?.chunks_exact_mut(each).enumerate();
            let chosen = chosen.filter(|(at, _)| mask.is_none_or(|mask| mask[*at]));
            chosen.zip(seen.chunks_exact(each)).for_each(|((_, to), seen)| to.copy_from_slice(seen));
            Ok::<_, PyErr>(())
        };
        if mask.is_none() {
            write("last_observed", &self.last_observed)?;
        }
        write("observed", &self.observed)
    }

    /// Takes what is observed now as what was before a reset, in the environments that the mask selects.
    fn copy_observed(&self, py: Python<'_>, mask: &[bool]) -> PyResult<()> {
        let shape = self.observed.bind(py).shape().to_vec();
        let each = shape[1] * shape[2];
        if each == 0 {
            return Ok(());
        }
        let from: PyReadonlyArrayDyn<f32> = self.observed.bind(py).extract()?;
        let mut to = opened(("last_observed", self.last_observed.bind(py)), &shape)?;
        let rows = to.as_slice_mut()?.chunks_exact_mut(each).zip(from.as_slice()?.chunks_exact(each)).zip(mask);
        rows.filter(|(_, begun)| **begun).for_each(|((to, from), _)| to.copy_from_slice(from));
        Ok(())
    }

    /// Reads the environments, without holding up other threads of Python.
    fn looking<T: Send>(&self, py: Python<'_>, look: impl FnOnce(&VectorEnvironment) -> T + Send) -> PyResult<T> {
        py.detach(|| {
            let guard = self.environments.lock().map_err(|_| PyRuntimeError::new_err(PANICKED))?;
            Ok(look(&guard))
        })
    }

    /// Does `work` on environments and arrays. If it fails, all of them are as before.
    fn undoing<T>(&self, py: Python<'_>, work: impl FnOnce() -> PyResult<T>) -> PyResult<T> {
        let before = self.looking(py, VectorEnvironment::clone)?;
        let arrays = self.arrays(py);
        let copies: Vec<_> = arrays.iter().map(|array| array.call_method0("copy")).collect::<PyResult<_>>()?;
        let done = work();
        if done.is_err() {
            *self.environments.lock().map_err(|_| PyRuntimeError::new_err(PANICKED))? = before;
            let copy = py.import("numpy")?.getattr("copyto")?;
            arrays.iter().zip(copies).try_for_each(|(array, before)| copy.call1((array, before)).map(drop))?;
        }
        done
    }

    /// Returns all arrays of the environments.
    fn arrays<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyAny>> {
        let VecEnv { obs, last_obs, reward, terminated, truncated, arrived, heard, age, said, .. } = self;
        let VecEnv { scan, last_scan, observed, last_observed, .. } = self;
        let floats = [obs, last_obs, reward, age, said, scan, last_scan, observed, last_observed];
        let flags = [terminated, truncated, arrived, heard];
        let floats = floats.into_iter().map(|array| array.bind(py).clone().into_any());
        floats.chain(flags.into_iter().map(|array| array.bind(py).clone().into_any())).collect()
    }
}
