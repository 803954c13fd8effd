//! The class `Channel`: delay, loss and contention of the messages of many teams, on numpy buffers that it owns.

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use murmurate::net::media::radio::{self, Radio};
use murmurate_train::air::{Air, Buffers, Bursts, Given as Step, Options, options_of};
use numpy::PyArrayDyn;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};

use crate::arguments::{Given, Seed, float, text, whole, wrong};
use crate::arrays::{finite, opened, values, zeros};
use crate::memory;
use crate::turn::{Turn, bytes_of};

/// Text of the error after a defect.
const PANICKED: &str = "a step of this channel has panicked before, a defect of murmurate; make a new one";

/// Delay, loss and contention of the messages between the robots of N teams, for environments of any trainer.
/// docs/python-channel.md describes it.
#[pyclass(frozen, weakref, module = "murmurate")]
pub struct Channel {
    air: Mutex<Air>,
    /// Whether a thread works on it.
    busy: AtomicBool,
    options: Options,
    /// Whether a receiver has a message of a sender that is not too old (N, R, R), by receiver and then by sender.
    #[pyo3(get)]
    heard: Py<PyArrayDyn<bool>>,
    /// Time since that message was sent [s] (N, R, R); 0 where there is none.
    #[pyo3(get)]
    age: Py<PyArrayDyn<f32>>,
    /// Number of the step in which it was sent, from 0 since the reset (N, R, R), int32; -1 where there is none.
    #[pyo3(get)]
    index: Py<PyArrayDyn<i32>>,
    /// Floats of that message (N, R, R, M); zeros where there is none.
    #[pyo3(get)]
    said: Py<PyArrayDyn<f32>>,
}

/// Opens all buffers of the channel for writing, and works on the air without holding up other threads of Python.
macro_rules! with_buffers {
    ($self:ident, $py:ident, |$air:ident, $buffers:ident| $work:expr) => {{
        let Options { environments: n, robots: r, floats: m, .. } = $self.options;
        let mut heard = opened(("heard", $self.heard.bind($py)), &[n, r, r])?;
        let mut age = opened(("age", $self.age.bind($py)), &[n, r, r])?;
        let mut index = opened(("index", $self.index.bind($py)), &[n, r, r])?;
        let mut said = opened(("said", $self.said.bind($py)), &[n, r, r, m])?;
        let $buffers = Buffers {
            heard: heard.as_slice_mut()?,
            age_s: age.as_slice_mut()?,
            index: index.as_slice_mut()?,
            content: said.as_slice_mut()?,
        };
        let mutex = &$self.air;
        $py.detach(move || {
            let mut guard = mutex.lock().map_err(|_| PyRuntimeError::new_err(PANICKED))?;
            let $air = &mut *guard;
            Ok::<_, PyErr>($work)
        })?
    }};
}

impl Channel {
    /// Makes a channel around this air, whose options are checked.
    fn made(py: Python<'_>, air: Air) -> PyResult<Channel> {
        let options = air.options().clone();
        let Options { environments: n, robots: r, floats: m, .. } = options;
        let this = Channel {
            air: Mutex::new(air),
            busy: AtomicBool::new(false),
            options,
            heard: zeros(py, &[n, r, r])?,
            age: zeros(py, &[n, r, r])?,
            index: zeros(py, &[n, r, r])?,
            said: zeros(py, &[n, r, r, m])?,
        };
        with_buffers!(this, py, |air, buffers| air.look(buffers));
        Ok(this)
    }

    /// Checks that there is memory for the air of these options.
    fn ensure(options: &Options) -> PyResult<()> {
        let Options { environments, robots, .. } = *options;
        memory::ensure(&format!("num_envs: {environments} channels of {robots} robots"), options.memory_bytes())
    }

    /// Keeps out other threads until the result is dropped. If one works on the channel, that is an error.
    fn turn(&self, what: &str) -> PyResult<Turn<'_>> {
        Turn::of(&self.busy, (what, "channel"))
    }
}

#[pymethods]
impl Channel {
    #[new]
    #[pyo3(signature = (
        num_envs, num_robots, *, radio = None, loss = None, burst_share = None, burst_s = None, delay_s = None,
        tail_s = None, range_m = None, period_s = None, spread_s = None, hold_s = None, content = None, threads = None,
        seed = Some(Seed(0)),
    ), text_signature = "(num_envs, num_robots, *, radio=None, loss=0.0, burst_share=0.0, burst_s=1.0, delay_s=0.0, \
        tail_s=0.0, range_m=None, period_s=0.05, spread_s=0.0, hold_s=1.0, content=0, threads=1, seed=0)")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn new(
        py: Python<'_>,
        num_envs: &Bound<'_, PyAny>,
        num_robots: &Bound<'_, PyAny>,
        radio: Given<'_, '_>,
        loss: Given<'_, '_>,
        burst_share: Given<'_, '_>,
        burst_s: Given<'_, '_>,
        delay_s: Given<'_, '_>,
        tail_s: Given<'_, '_>,
        range_m: Given<'_, '_>,
        period_s: Given<'_, '_>,
        spread_s: Given<'_, '_>,
        hold_s: Given<'_, '_>,
        content: Given<'_, '_>,
        threads: Given<'_, '_>,
        seed: Option<Seed>,
    ) -> PyResult<Channel> {
        let or = |argument, given: Given, otherwise| given.map_or(Ok(otherwise), |given| float(argument, given));
        let count =
            |argument, given: Given, least, most| given.map_or(Ok(least), |given| whole(argument, given, least, most));
        let period_s = or("period_s", period_s, 0.05)?;
        let (share, mean_s) = (or("burst_share", burst_share, 0.0)?, or("burst_s", burst_s, 1.0)?);
        if burst_s.is_some() && share == 0.0 {
            return Err(wrong("burst_s", "it has no effect without burst_share"));
        }
        let options = Options {
            environments: whole("num_envs", num_envs, 1, 1_000_000)? as usize,
            robots: whole("num_robots", num_robots, 1, 1000)? as usize,
            floats: count("content", content, 0, 65_536)? as usize,
            threads: count("threads", threads, 1, 1024)? as usize,
            seed: Seed::or_drawn(seed, py)?,
            period_s,
            spread_s: or("spread_s", spread_s, 0.0)?,
            hold_s: or("hold_s", hold_s, 1.0)?,
            range_m: range_m.map(|range_m| float("range_m", range_m)).transpose()?.map(|range_m| range_m as f32),
            loss: or("loss", loss, 0.0)?,
            bursts: (share != 0.0).then_some(Bursts { share, mean_s }),
            delay_s: delay_s.map_or(Ok([0.0; 2]), delay_of)?,
            tail_s: or("tail_s", tail_s, 0.0)?,
            radio: radio.map(radio_of).transpose()?,
        };
        options.check().map_err(|error| pyo3::exceptions::PyValueError::new_err(error.to_string()))?;
        Channel::ensure(&options)?;
        Channel::made(py, py.detach(|| Air::new(options)))
    }

    /// Sends what the robots say in this step, goes on by `period_s`, and writes what they have heard by then into
    /// `heard`, `age`, `index` and `said`. `position` [m] is float32 (N, R, 2), `sends` bool (N, R), `bytes` a number or
    /// int32 (N, R), `to` int32 (N, R) with -1 for all others, `content` float32 (N, R, M).
    #[pyo3(signature = (position = None, *, sends = None, bytes = None, to = None, content = None))]
    fn step(
        &self,
        py: Python<'_>,
        position: Given<'_, '_>,
        sends: Given<'_, '_>,
        bytes: Given<'_, '_>,
        to: Given<'_, '_>,
        content: Given<'_, '_>,
    ) -> PyResult<()> {
        let _turn = self.turn("step")?;
        let Options { environments: n, robots: r, floats: m, .. } = self.options;
        if position.is_none() && self.options.needs_positions() {
            return Err(wrong("position", format!("missing; who hears whom depends on it: float32 {:?}", [n, r, 2])));
        }
        if content.is_none() && m > 0 {
            return Err(wrong("content", format!("missing; its shape is {:?}", [n, r, m])));
        }
        let position = position.map(|given| values::<f32>(("position", given), &[n, r, 2])).transpose()?;
        let content = content.map(|given| values::<f32>(("content", given), &[n, r, m])).transpose()?;
        let sends = sends.map(|given| values::<bool>(("sends", given), &[n, r])).transpose()?;
        let to = to.map(|given| values::<i32>(("to", given), &[n, r])).transpose()?;
        let position = position.as_ref().map_or(Ok(&[][..]), |given| given.as_slice())?;
        let content = content.as_ref().map_or(Ok(&[][..]), |given| given.as_slice())?;
        let sends = sends.as_ref().map_or(Ok(&[][..]), |given| given.as_slice())?;
        let to = to.as_ref().map_or(Ok(&[][..]), |given| given.as_slice())?;
        finite("position", position)?;
        finite("content", content)?;
        if let Some(at) = to.iter().position(|to| !(-1..r as i32).contains(to)) {
            return Err(wrong("to", format!("the value at flat index {at} is {}, and not -1 to {}", to[at], r - 1)));
        }
        let bytes = lengths_of(bytes, [n, r])?;
        let given = Step { position, sends, bytes: &bytes, to, content };
        with_buffers!(self, py, |air, buffers| air.step(given, buffers));
        Ok(())
    }

    /// Begins anew in the environments where `mask`, bool (N), is true, or in all: nothing was said there. With `seed`
    /// all random numbers begin anew; that is possible for all environments together.
    #[pyo3(signature = (mask = None, *, seed = None))]
    fn reset(&self, py: Python<'_>, mask: Given<'_, '_>, seed: Option<Seed>) -> PyResult<()> {
        let _turn = self.turn("reset")?;
        let mask = mask.map(|mask| values::<bool>(("mask", mask), &[self.options.environments])).transpose()?;
        let mask = mask.as_ref().map(|mask| mask.as_slice()).transpose()?;
        if seed.is_some() && mask.is_some() {
            return Err(wrong("seed", "it is for all environments; leave mask out"));
        }
        with_buffers!(self, py, |air, buffers| {
            match seed {
                Some(Seed(seed)) => air.reseed(seed),
                None => air.reset(|environment| mask.is_none_or(|mask| mask[environment])),
            }
            air.look(buffers);
        });
        Ok(())
    }

    /// Returns the state of all environments as bytes, from which `set_state` continues to the bit.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let _turn = self.turn("state")?;
        let bytes = with_buffers!(self, py, |air, _buffers| air.state());
        Ok(PyBytes::new(py, &bytes))
    }

    /// Continues from a state of a channel with the same arguments; `seed` and `threads` may differ. Nothing changes if
    /// the state is refused.
    fn set_state(&self, py: Python<'_>, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let _turn = self.turn("set_state")?;
        let bytes = bytes_of(state)?;
        let set = with_buffers!(self, py, |air, buffers| air.set_state(&bytes).map(|()| air.look(buffers)));
        set.map_err(|error| wrong("state", error))
    }

    /// Returns a channel that continues to the bit as this one does, with arrays of its own.
    fn copy(&self, py: Python<'_>) -> PyResult<Channel> {
        let _turn = self.turn("copy")?;
        Channel::ensure(&self.options)?;
        let air = with_buffers!(self, py, |air, _buffers| air.clone());
        Channel::made(py, air)
    }

    fn __copy__(&self, py: Python<'_>) -> PyResult<Channel> {
        self.copy(py)
    }

    fn __deepcopy__(&self, py: Python<'_>, _memo: &Bound<'_, PyAny>) -> PyResult<Channel> {
        self.copy(py)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let made = py.import("murmurate._module")?.getattr("restored_channel")?;
        Ok((made, (self.state(py)?,).into_pyobject(py)?))
    }

    /// Makes a channel from a state, with its arguments.
    #[staticmethod]
    fn from_state(py: Python<'_>, state: &Bound<'_, PyAny>) -> PyResult<Channel> {
        let bytes = bytes_of(state)?;
        let options = options_of(&bytes).map_err(|error| wrong("state", error))?;
        Channel::ensure(&options)?;
        let mut air = Air::new(options);
        air.set_state(&bytes).map_err(|error| wrong("state", error))?;
        Channel::made(py, air)
    }

    fn __repr__(&self) -> String {
        format!("<Channel: {} environments of {} robots>", self.options.environments, self.options.robots)
    }

    /// Whether `step` needs positions: there is a range.
    #[getter]
    fn needs_position(&self) -> bool {
        self.options.needs_positions()
    }

    /// Number of environments N.
    #[getter]
    fn num_envs(&self) -> usize {
        self.options.environments
    }

    /// Number of robots R of each environment.
    #[getter]
    fn num_robots(&self) -> usize {
        self.options.robots
    }

    /// Duration of a step [s].
    #[getter]
    fn period_s(&self) -> f64 {
        self.options.period_s
    }

    /// Number of newest steps whose messages may still count: who keeps contents by `index` keeps those of so many.
    #[getter]
    fn memory(&self) -> usize {
        self.options.memory()
    }

    /// Time for which a message counts from its arrival [s].
    #[getter]
    fn hold_s(&self) -> f64 {
        self.options.hold_s
    }
}

/// Returns the least and the largest delay \[s\]: those of a pair, or a single one.
fn delay_of(given: &Bound<'_, PyAny>) -> PyResult<[f64; 2]> {
    if let Ok(delay_s) = given.extract::<f64>() {
        return Ok([delay_s; 2]);
    }
    let pair: Result<[f64; 2], _> = given.extract();
    pair.map_err(|_| wrong("delay_s", format!("a {} is neither a number nor a pair of numbers", given.get_type())))
}

/// Returns a radio by the name of its preset, or from a TOML file.
fn radio_of(given: &Bound<'_, PyAny>) -> PyResult<Radio> {
    let name = text("radio", given)?;
    if let Some(radio) = Radio::preset(&name) {
        return Ok(radio);
    }
    let presets = radio::PRESETS.join(", ");
    let content = std::fs::read_to_string(&name)
        .map_err(|error| wrong("radio", format!("'{name}' is neither a preset ({presets}) nor a file: {error}")))?;
    Radio::from_toml(&content).map_err(|error| wrong("radio", format!("'{name}': {error}")))
}

/// Returns the lengths of the robots' datagrams \[bytes\]: one for all, 200 if none is given, or one for each.
fn lengths_of(given: Given, shape: [usize; 2]) -> PyResult<Vec<u32>> {
    const MOST: i32 = 65_507;
    let Some(given) = given else { return Ok(vec![200]) };
    if given.extract::<f64>().is_ok() {
        return Ok(vec![whole("bytes", given, 1, MOST.into())? as u32]);
    }
    let lengths = values::<i32>(("bytes", given), &shape)?;
    let lengths = lengths.as_slice()?;
    match lengths.iter().position(|length| !(1..=MOST).contains(length)) {
        Some(at) => Err(wrong("bytes", format!("the value at flat index {at} is {}, not 1 to {MOST}", lengths[at]))),
        None => Ok(lengths.iter().map(|length| *length as u32).collect()),
    }
}
