//! Policies in Python: the process that computes their steps, and the calls on the socket to it. The frames are those
//! of `murmurate_onnx::frames`.

mod child;

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use murmurate::messages::ids::RobotId;
use murmurate_onnx::engine::{Array, Engine};
use murmurate_onnx::frames::{self, Greeting, Kind};
use murmurate_onnx::network::{Network, PYTHON, Port};
use murmurate_onnx::structure::Role;
use murmurate_onnx::{Contract, Parts};

use self::child::{Child, START, shortened, start};
use crate::BadInput;

/// Longest time for one call. A robot does not wait for it: its Agent gives a step up after half a period.
const CALL: Duration = Duration::from_secs(10);
/// Pauses before a process is started again, one after the other \[s\]; the last one for all further ones.
const PAUSES_S: [u64; 5] = [0, 1, 2, 4, 8];
/// Time without a failure after which the pauses begin anew.
const SOUND: Duration = Duration::from_secs(60);
/// Largest memory of a process, unless the contract says otherwise \[MB\].
const MEMORY_MB: u32 = 4096;
/// Prefix of the address of a process that serves a policy.
const ADDRESS: &str = "unix:";

/// Process that computes the steps of a policy.
struct Process {
    what: String,
    source: Source,
    contract: Contract,
    link: Mutex<Link>,
}

/// Where the process comes from.
enum Source {
    /// It is started: the module and class, and the folder of the contract.
    Started(String, PathBuf),
    /// It waits at this socket.
    Address(PathBuf),
}

/// Connection to the process.
#[derive(Default)]
struct Link {
    stream: Option<UnixStream>,
    child: Option<Child>,
    number: u32,
    failures: usize,
    failed: Option<Instant>,
    /// Seed with which each robot has begun anew last.
    seeds: BTreeMap<RobotId, u64>,
}

/// Calls of one role.
struct Call {
    process: Arc<Process>,
    role: Role,
    /// Place of the first input with an axis of neighbours, from which their number is known.
    of_neighbours: Option<usize>,
    outputs: Vec<Port>,
}

impl Engine for Call {
    fn run(&self, inputs: &[Array]) -> Result<Vec<Array>, String> {
        let places = self.of_neighbours.map_or(0, |at| inputs[at].shape[1]);
        self.process.call((self.role, places), inputs, &self.outputs)
    }

    fn reset(&self, robot: RobotId, seed: u64) {
        self.process.reset(robot, seed);
    }
}

/// Starts the process of the policy `parts`, whose contract is in `folder`, and returns its network.
///
/// # Errors
/// The process does not start, or is no policy of this contract; a sentence.
pub fn network(parts: Parts, folder: &Path) -> Result<Network> {
    let Parts { contract, .. } = parts;
    let what = contract.python.clone().context("a policy in Python names its class")?;
    let source = match what.strip_prefix(ADDRESS) {
        Some(path) => Source::Address(PathBuf::from(path)),
        None => Source::Started(what.clone(), folder.to_owned()),
    };
    let process = Process { what, source, contract: contract.clone(), link: Mutex::default() };
    let greeting =
        process.open(&mut process.locked()).map_err(|why| BadInput(format!("its policy in Python: {why}")))?;
    if greeting.two && contract.message.floats == 0 {
        let why =
            "its policy in Python: it has 'encode', and its contract no message: write 'step', or 'message.floats'";
        return Err(BadInput(why.to_owned()).into());
    }
    let digest = digest_of(&contract, &greeting.digest)?;
    let roles: &[Role] = if greeting.two { &[Role::Encode, Role::Act] } else { &[Role::Step] };
    let process = Arc::new(process);
    let name = format!("{PYTHON} ({})", shortened(&greeting.name));
    Ok(Network::of_engine((contract, digest, name), roles, |role, inputs, outputs| {
        let of_neighbours = inputs.iter().position(|port| port.of_neighbours);
        Arc::new(Call { process: Arc::clone(&process), role, of_neighbours, outputs: outputs.to_vec() })
    }))
}

/// Returns the digest of a contract and of the source of its class. Where the process is found, and how much memory it
/// may take, do not count.
fn digest_of(contract: &Contract, source: &str) -> Result<String> {
    let contract = Contract { python: None, memory_mb: None, ..contract.clone() };
    let contract = serde_json::to_string(&contract).context("it is plain data")?;
    let sum = hmac_sha256::Hash::hash(format!("{contract} {source}").as_bytes());
    Ok(data_encoding::HEXLOWER.encode(&sum[..8]))
}

impl Process {
    fn locked(&self) -> MutexGuard<'_, Link> {
        self.link.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Connects to the process, which is started if this program starts it, and greets it.
    fn open(&self, link: &mut Link) -> Result<Greeting, String> {
        let (stream, child) = match &self.source {
            Source::Address(path) => {
                let why = |error| format!("nothing answers at '{}': {error}", path.display());
                (UnixStream::connect(path).map_err(why)?, None)
            }
            Source::Started(class, folder) => {
                let (stream, child) = start(class, folder, self.contract.memory_mb.unwrap_or(MEMORY_MB))?;
                (stream, Some(child))
            }
        };
        (link.stream, link.child) = (Some(stream), child);
        let answer = link.exchange(Kind::Hello, &frames::hello(&self.contract)?, START)?;
        frames::greeting(&answer)
    }

    /// Returns the outputs of a call with so many places for neighbours. One that fails is an error, after which the
    /// process is started again if it has ended or says nothing.
    fn call(&self, (role, places): (Role, usize), inputs: &[Array], outputs: &[Port]) -> Result<Vec<Array>, String> {
        let mut link = self.locked();
        if link.stream.is_none() {
            self.again(&mut link)?;
        }
        let robots = inputs.first().and_then(|array| array.shape.first()).copied().unwrap_or(1);
        let answer = link.exchange(Kind::Call, &frames::call(role, (robots, places), inputs), CALL)?;
        frames::outputs(&answer, robots, outputs).map_err(|why| format!("'{}': {why}", self.what))
    }

    /// Starts the process again, or connects to it again, unless it has just failed.
    fn again(&self, link: &mut Link) -> Result<(), String> {
        let pause = Duration::from_secs(PAUSES_S[link.failures.min(PAUSES_S.len() - 1)]);
        if link.failed.is_some_and(|failed| failed.elapsed() < pause) {
            return Err(format!("'{}' has ended and is started again soon", self.what));
        }
        if link.failed.is_none_or(|failed| failed.elapsed() > SOUND) {
            link.failures = 0;
        }
        link.failures += 1;
        link.failed = Some(Instant::now());
        // Its robots go on in their episodes, for which it has to begin as the process before did.
        let seeds: Vec<(RobotId, u64)> = link.seeds.iter().map(|(robot, seed)| (*robot, *seed)).collect();
        let begun = self.open(link).and_then(|_| {
            seeds.into_iter().try_for_each(|(robot, seed)| link.send(Kind::Reset, &frames::reset(robot, seed)))
        });
        if begun.is_err() {
            link.end();
        }
        begun
    }

    fn reset(&self, robot: RobotId, seed: u64) {
        let mut link = self.locked();
        link.seeds.insert(robot, seed);
        // A process that is gone is noticed with the next call.
        let _ = link.send(Kind::Reset, &frames::reset(robot, seed));
    }
}

impl Link {
    fn send(&mut self, kind: Kind, body: &[u8]) -> Result<(), String> {
        let frame = frames::frame(kind, self.number, body)?;
        let stream = self.stream.as_mut().ok_or("there is no process")?;
        stream.set_write_timeout(Some(CALL)).and_then(|()| stream.write_all(&frame)).map_err(|error| error.to_string())
    }

    /// Sends a frame and returns the body of its answer. Ends the connection if there is none in time.
    fn exchange(&mut self, kind: Kind, body: &[u8], longest: Duration) -> Result<Vec<u8>, String> {
        self.number = self.number.wrapping_add(1);
        let answer = self.send(kind, body).and_then(|()| self.receive(Instant::now() + longest));
        match answer {
            Ok((kind, text)) if kind == Kind::Error as u8 => Err(shortened(&String::from_utf8_lossy(&text))),
            Ok((kind, body)) if kind == Kind::Answer as u8 => Ok(body),
            Ok((other, _)) => Err(format!("it has answered by a frame of kind {other}")),
            Err(why) => {
                let status = self.end();
                Err(status.map_or(why.clone(), |status| format!("{why} ({status})")))
            }
        }
    }

    /// Receives the answer to the present call; late ones to calls before it are dropped.
    fn receive(&mut self, until: Instant) -> Result<(u8, Vec<u8>), String> {
        let stream = self.stream.as_mut().ok_or("there is no process")?;
        let mut read = |bytes: &mut [u8]| -> Result<(), String> {
            let mut at = 0;
            while at < bytes.len() {
                let left = until.saturating_duration_since(Instant::now());
                if left.is_zero() {
                    return Err("it does not answer".to_owned());
                }
                stream.set_read_timeout(Some(left)).map_err(|error| error.to_string())?;
                match stream.read(&mut bytes[at..]) {
                    Ok(0) => return Err("it has ended".to_owned()),
                    Ok(count) => at += count,
                    Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => return Err(error.to_string()),
                }
            }
            Ok(())
        };
        loop {
            let mut head = [0; frames::HEAD];
            read(&mut head)?;
            let head = frames::head(head)?;
            let mut body = vec![0; head.body];
            read(&mut body)?;
            if head.number == self.number {
                return Ok((head.kind, body));
            }
        }
    }

    /// Ends the connection and the process. Returns how it has ended, if it had before.
    fn end(&mut self) -> Option<String> {
        self.stream = None;
        let child = self.child.take()?;
        let ended = child.group.has_ended();
        child.group.finish().filter(|_| ended).map(|status| status.to_string())
    }
}
