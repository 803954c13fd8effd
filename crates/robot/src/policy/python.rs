//! Policies in Python: the process that computes their steps, and the protocol on the socket to it.
//!
//! A frame is its length (u32), the number of the call (u32), its kind (u8) and a body; all numbers are little-endian.
//! The host says hello with the contract and the arrays of each call as JSON; the policy answers with what it has.
//! Then a call is a role (u8), the numbers of robots and of places for neighbours (u32 each) and the arrays as 32-bit
//! floats, and its answer the arrays that come out. A call that has failed is answered by a line of text. The number
//! tells a late answer from that of the present call.

mod child;

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use murmurate_onnx::engine::{Array, Engine};
use murmurate_onnx::network::{Network, PYTHON, Port};
use murmurate_onnx::structure::Role;
use murmurate_onnx::{Contract, Parts};
use serde::{Deserialize, Serialize};

use self::child::{START, shortened, start};
use crate::BadInput;

/// Version of the protocol.
const PROTOCOL: u32 = 1;
/// Longest time for one call. A robot does not wait for it: its Agent gives a step up after half a period.
const CALL: Duration = Duration::from_secs(10);
/// Pauses before a process is started again, one after the other \[s\]; the last one for all further ones.
const PAUSES_S: [u64; 5] = [0, 1, 2, 4, 8];
/// Time without a failure after which the pauses begin anew.
const SOUND: Duration = Duration::from_secs(60);
/// Longest frame that is read \[bytes\].
const MAX_FRAME: usize = 64 << 20;
/// Prefix of the address of a process that serves a policy.
const ADDRESS: &str = "unix:";

/// Kinds of frames.
mod kind {
    pub const HELLO: u8 = 0;
    pub const CALL: u8 = 1;
    pub const ANSWER: u8 = 2;
    pub const ERROR: u8 = 3;
    pub const RESET: u8 = 4;
}

/// First frame of the host: the contract, and the arrays of the calls.
#[derive(Serialize)]
struct Hello<'a> {
    protocol: u32,
    contract: &'a Contract,
    calls: Vec<Calls>,
}

/// Arrays of the calls of one role.
#[derive(Serialize)]
struct Calls {
    role: &'static str,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
}

/// Answer of the policy to the first frame.
#[derive(Deserialize)]
struct Greeting {
    protocol: u32,
    /// Name of the class.
    name: String,
    /// Digest of the class's source.
    digest: String,
    /// Whether it has the methods `encode` and `act`, and not `step`.
    two: bool,
}

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
    resets: u32,
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

    fn reset(&self) {
        self.process.reset();
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

/// Returns the digest of a contract and of the source of its class. Where the process is found does not count.
fn digest_of(contract: &Contract, source: &str) -> Result<String> {
    let contract = serde_json::to_string(&Contract { python: None, ..contract.clone() }).context("it is plain data")?;
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
                let (stream, child) = start(class, folder)?;
                (stream, Some(child))
            }
        };
        (link.stream, link.child) = (Some(stream), child);
        let roles = [("step", Role::Step), ("encode", Role::Encode), ("act", Role::Act)];
        let calls = roles.map(|(role, of)| {
            let (inputs, outputs) = murmurate_onnx::network::ports(&self.contract, of);
            Calls { role, inputs, outputs }
        });
        let hello = Hello { protocol: PROTOCOL, contract: &self.contract, calls: calls.into() };
        let hello = serde_json::to_vec(&hello).map_err(|error| error.to_string())?;
        let answer = link.exchange(kind::HELLO, &[&hello], START)?;
        let greeting: Greeting =
            serde_json::from_slice(&answer).map_err(|error| format!("it does not greet as a policy does: {error}"))?;
        if greeting.protocol != PROTOCOL {
            let theirs = greeting.protocol;
            return Err(format!(
                "it speaks protocol {theirs}, and this program {PROTOCOL}: install one version of both"
            ));
        }
        Ok(greeting)
    }

    /// Returns the outputs of a call with so many places for neighbours. One that fails is an error, after which the
    /// process is started again if it has ended or says nothing.
    fn call(&self, (role, places): (Role, usize), inputs: &[Array], outputs: &[Port]) -> Result<Vec<Array>, String> {
        let mut link = self.locked();
        if link.stream.is_none() {
            self.again(&mut link)?;
        }
        let robots = inputs.first().and_then(|array| array.shape.first()).copied().unwrap_or(1);
        let counts = [robots, places].map(|count| u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
        let code = match role {
            Role::Step => 0_u8,
            Role::Encode => 1,
            Role::Act => 2,
        };
        let mut body = vec![code];
        body.extend_from_slice(counts.as_flattened());
        let floats = inputs.iter().flat_map(|array| &array.values);
        floats.for_each(|float| body.extend_from_slice(&float.to_le_bytes()));
        let answer = link.exchange(kind::CALL, &[&body], CALL)?;
        let sizes: Vec<usize> = outputs.iter().map(|port| robots * port.axes.iter().product::<usize>()).collect();
        if answer.len() != 4 * sizes.iter().sum::<usize>() {
            return Err(format!("'{}' has answered {} bytes instead of its outputs", self.what, answer.len()));
        }
        let mut all = answer.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        let array = |(port, size): (&Port, usize)| {
            let shape = std::iter::once(robots).chain(port.axes.iter().copied()).collect();
            Array { shape, values: all.by_ref().take(size).collect() }
        };
        Ok(outputs.iter().zip(sizes).map(array).collect())
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
        let opened = self.open(link);
        if opened.is_err() {
            link.end();
        }
        opened.map(drop)
    }

    fn reset(&self) {
        let mut link = self.locked();
        let seed = link.resets;
        link.resets = seed.wrapping_add(1);
        // A process that is gone is noticed with the next call.
        let _ = link.send(kind::RESET, &[&seed.to_le_bytes()]);
    }
}

impl Link {
    fn send(&mut self, kind: u8, body: &[&[u8]]) -> Result<(), String> {
        let length = 5 + body.iter().map(|bytes| bytes.len()).sum::<usize>();
        let mut frame =
            u32::try_from(length).map_err(|_| "the inputs are too large".to_owned())?.to_le_bytes().to_vec();
        frame.extend_from_slice(&self.number.to_le_bytes());
        frame.push(kind);
        body.iter().for_each(|bytes| frame.extend_from_slice(bytes));
        let stream = self.stream.as_mut().ok_or("there is no process")?;
        stream.set_write_timeout(Some(CALL)).and_then(|()| stream.write_all(&frame)).map_err(|error| error.to_string())
    }

    /// Sends a frame and returns the body of its answer. Ends the connection if there is none in time.
    fn exchange(&mut self, kind: u8, body: &[&[u8]], longest: Duration) -> Result<Vec<u8>, String> {
        self.number = self.number.wrapping_add(1);
        let answer = self.send(kind, body).and_then(|()| self.receive(Instant::now() + longest));
        match answer {
            Ok((kind::ERROR, text)) => Err(shortened(&String::from_utf8_lossy(&text))),
            Ok((kind::ANSWER, body)) => Ok(body),
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
            let mut head = [0; 9];
            read(&mut head)?;
            let [l0, l1, l2, l3, n0, n1, n2, n3, kind] = head;
            let length = usize::try_from(u32::from_le_bytes([l0, l1, l2, l3])).unwrap_or(usize::MAX);
            if !(5..=MAX_FRAME).contains(&length) {
                return Err(format!("it has sent a frame of {length} bytes"));
            }
            let mut body = vec![0; length - 5];
            read(&mut body)?;
            if u32::from_le_bytes([n0, n1, n2, n3]) == self.number {
                return Ok((kind, body));
            }
        }
    }

    /// Ends the connection and the process. Returns how it has ended, if it had before.
    fn end(&mut self) -> Option<String> {
        self.stream = None;
        let mut child = self.child.take()?;
        let ended = child.try_wait().ok().flatten();
        // One that is halted does not end by itself.
        let _ = child.kill();
        let _ = child.wait();
        ended.map(|status| status.to_string())
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.end();
    }
}
