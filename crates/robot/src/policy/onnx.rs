//! Loading of policies of format 3, a contract with ONNX graphs: their files, and their check in a process of its own.

use std::ffi::OsStr;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::observation::Observation;
use murmurate::policy::{Draw, Neighbour, Policy};
use murmurate::random::Seed;
use murmurate::time::Span;
use murmurate_onnx::Network;
use murmurate_onnx::parts::Refused;
use murmurate_onnx::{Contract, Parts, check};
use serde::{Deserialize, Serialize};

use super::python;
use crate::output::{read_bytes, read_text};
use crate::{BadInput, bad, this_program};

/// Longest time that the check of a policy may take.
const CHECK_TIMEOUT: Duration = Duration::from_secs(60);
/// Most memory that the process of a check may address \[bytes\].
const CHECK_MEMORY: u64 = 4 << 30;
/// Variable that is set for the process of a check.
const CHILD: &str = "CHECKS_A_POLICY_OF_MURMURATE";
/// Variable that names the library of onnxruntime.
const LIBRARY: &str = "ORT_DYLIB_PATH";
/// Number of steps of which the time is measured.
const TIMED_STEPS: usize = 200;

/// Result of the check of a policy, which its process prints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Checked {
    /// The policy can be used.
    Sound(Sound),
    /// The policy cannot be used; the text says why.
    Refused(String),
}

/// Findings of the check of a sound policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sound {
    /// Digest of the files that were checked.
    pub digest: String,
    /// Remarks, a sentence each.
    pub remarks: Vec<String>,
    /// Median time of a step of one robot with the most neighbours \[us\], on this machine.
    pub step_us: f64,
}

/// Returns whether a file is one of a policy of format 3, by the ending of its name.
pub fn is_format_3(path: &Path) -> bool {
    matches!(path.extension().and_then(OsStr::to_str), Some("toml" | "onnx"))
}

/// Reads the files of the policy `path`: a contract with the graphs that it names beside it, or one ONNX file.
///
/// # Errors
/// The outer error says which file cannot be read, the inner one why they make no policy.
pub fn parts(path: &Path) -> Result<Result<Parts, Refused>> {
    if path.extension() == Some(OsStr::new("onnx")) {
        return Ok(Parts::of_graph(read_bytes(path, "policy file")?));
    }
    let text = read_text(path, "policy file")?;
    let folder = path.parent().unwrap_or(Path::new(""));
    Parts::of_contract(&text, |file| {
        if !is_beside(file) {
            let why = "it names a graph that is not beside it: give the name of a file in its folder, of letters, \
                       digits and '-_.'";
            return Err(BadInput(format!("the policy file '{}': {why}", path.display())).into());
        }
        read_bytes(&folder.join(file), "graph of the policy")
    })
}

/// Returns whether the name of a graph is that of a file in the contract's folder.
fn is_beside(file: &str) -> bool {
    let plain = file.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
    plain && file.len() <= 100 && !file.starts_with('.') && !file.is_empty()
}

/// Opens the library of onnxruntime that a variable names, for all graphs of this process. An error names the variable.
pub fn open_library() -> Result<()> {
    let Some(path) = std::env::var_os(LIBRARY) else { return Ok(()) };
    let opened = murmurate_onnx::engine::open(Path::new(&path));
    opened.map_err(|why| BadInput(format!("{LIBRARY}: '{}': {why}", Path::new(&path).display())).into())
}

/// Returns the paths of the graphs that a policy's contract names; empty if `path` is no such contract.
pub fn graphs(path: &Path) -> Vec<PathBuf> {
    let toml = path.extension() == Some(OsStr::new("toml"));
    let text = if toml { read_text(path, "policy file").ok() } else { None };
    let Some(contract) = text.and_then(|text| Contract::parse(&text).ok()) else { return Vec::new() };
    let folder = path.parent().unwrap_or(Path::new(""));
    let names = contract.files().map(|(_, name)| name);
    names.filter(|name| is_beside(name)).map(|name| folder.join(name)).collect()
}

/// Loads the policy `path` after a check of it in a process of its own, within limits of memory and time: a graph is a
/// program, and may take all of both. Returns the findings of the check, too.
pub fn load(path: &Path) -> Result<(Arc<Network>, Sound)> {
    let refuse = |why: String| BadInput(format!("the policy file '{}': {why}", path.display()));
    open_library()?;
    // What is wrong with a file is said before a process is started for it.
    let parts = parts(path)?.map_err(|why| refuse(why.to_string()))?;
    if parts.contract.python.is_some() {
        return in_python(parts, path);
    }
    let sound = match in_own_process(path)? {
        Checked::Sound(sound) => sound,
        Checked::Refused(why) => return Err(refuse(why).into()),
    };
    if sound.digest != parts.digest {
        return Err(refuse("it was changed while it was checked; try again".to_owned()).into());
    }
    let network = Network::load(parts).map_err(|why| refuse(why.to_string()))?;
    Ok((Arc::new(network), sound))
}

/// Starts the process of a policy in Python, and checks the policy as others are. It is in a process of its own.
fn in_python(parts: Parts, path: &Path) -> Result<(Arc<Network>, Sound)> {
    let refuse = |why: String| BadInput(format!("the policy file '{}': {why}", path.display()));
    let folder = path.parent().unwrap_or(Path::new(""));
    let network = Arc::new(python::network(parts, folder).map_err(|why| refuse(why.to_string()))?);
    let remarks = check::check(&network).map_err(|why| refuse(why.to_string()))?;
    let (digest, step_us) = (network.digest().to_owned(), step_us(&network));
    Ok((network, Sound { digest, remarks, step_us }))
}

/// Returns a warning if a step of a policy takes so long that on a robot it would be late, always or now and then.
pub fn too_slow(network: &Network, sound: &Sound) -> Option<String> {
    let half_us = 0.5e6 / network.contract().rate_hz;
    (sound.step_us > half_us / 2.0).then(|| {
        format!(
            "a step takes {:.1} ms on this machine, and on a robot one that takes more than {:.1} ms counts as none: \
             take a smaller network or a lower rate_hz",
            sound.step_us / 1e3,
            half_us / 1e3
        )
    })
}

/// Checks the policy `path` in this process, for the one that has started it.
pub fn check_here(path: &Path) -> Result<Checked> {
    limit_memory()?;
    open_library()?;
    let loaded = parts(path)?.and_then(Network::load).map(Arc::new);
    let checked = loaded.and_then(|network| check::check(&network).map(|remarks| (network, remarks)));
    Ok(match checked {
        Ok((network, remarks)) => {
            let digest = network.digest().to_owned();
            Checked::Sound(Sound { digest, remarks, step_us: step_us(&network) })
        }
        Err(why) => Checked::Refused(why.to_string()),
    })
}

#[cfg(target_os = "linux")]
fn limit_memory() -> Result<()> {
    use nix::sys::resource::{Resource, setrlimit};
    setrlimit(Resource::RLIMIT_AS, CHECK_MEMORY, CHECK_MEMORY).context("cannot limit the memory of the check")?;
    let seconds = CHECK_TIMEOUT.as_secs();
    setrlimit(Resource::RLIMIT_CPU, seconds, seconds).context("cannot limit the time of the check")
}

#[cfg(not(target_os = "linux"))]
fn limit_memory() -> Result<()> {
    let _ = CHECK_MEMORY;
    Ok(())
}

/// Starts this program again for the check of the policy `path`, and returns what it says.
fn in_own_process(path: &Path) -> Result<Checked> {
    // A program without the command `policy check` would load the policy again, and so on.
    if std::env::var_os(CHILD).is_some() {
        return bad(
            "this program checks a policy within the check of one: it lacks the command 'policy check'".to_owned()
        );
    }
    let program = this_program()?;
    let mut command = Command::new(&program[0]);
    command.args(&program[1..]).args(["policy", "check", "--here"]).arg("--").arg(path).env(CHILD, "1");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).env("RUST_BACKTRACE", "0");
    let child = command.spawn().context("cannot start a process for the check of a policy")?;
    let ended = |why: &str| Checked::Refused(format!("its check {why}"));
    Ok(match output_of(child)? {
        None => ended(&format!("did not end within {} s: its graph takes too long", CHECK_TIMEOUT.as_secs())),
        Some(output) => serde_json::from_slice(&output).unwrap_or_else(|_| {
            ended("ended without an answer: its graph took more memory than a check may, or the engine broke")
        }),
    })
}

/// Returns what a process has printed when it ends; `None` if it was ended, because it took too long.
fn output_of(mut child: Child) -> Result<Option<Vec<u8>>> {
    let mut stdout = child.stdout.take().context("the process of a check has an output")?;
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let mut output = Vec::new();
        let read = stdout.read_to_end(&mut output).map(|_| output);
        // A receiver that is gone has waited long enough.
        let _ = sender.send(read);
    });
    let output = match receiver.recv_timeout(CHECK_TIMEOUT) {
        Ok(output) => Some(output.context("cannot read the answer of a check")?),
        Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
            child.kill().context("cannot end the process of a check")?;
            None
        }
    };
    child.wait().context("cannot wait for the process of a check")?;
    Ok(output)
}

/// Returns the median time of a step of one robot with the most neighbours \[us\].
fn step_us(network: &Arc<Network>) -> f64 {
    let contract = network.contract();
    let values: Vec<f32> = vec![0.1; contract.requests().iter().map(|request| request.floats()).sum()];
    let message = vec![0.1; contract.message.floats];
    let neighbour = Neighbour { motion: Motion::at_rest(Vec2::new(0.5, 0.5)), features: &message, age: Span::ZERO };
    let neighbours = vec![neighbour; contract.max_neighbours];
    let own = Observation::new(Motion::default(), Vec2::new(1.0, 1.0));
    let own = Observation { values: &values, heading: Some(0.0), ..own };
    let (mut robot, mut stream) = (network.robot(RobotId(0), Draw::Mean), Seed::of_run(0).stream("timing"));
    let mut features = message.clone();
    let mut times: Vec<f64> = (0..TIMED_STEPS)
        .map(|_| {
            let begins = Instant::now();
            robot.encode(&own, &mut features);
            robot.act(&own, &features, &neighbours, &mut stream);
            begins.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
