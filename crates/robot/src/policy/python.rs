//! Policies in Python: the processes that compute their steps, one for each thread that asks, and the calls on the
//! sockets to them. The frames are those of `murmurate_onnx::frames`.

mod child;
mod link;

use std::collections::BTreeMap;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::ThreadId;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use murmurate::messages::ids::RobotId;
use murmurate_onnx::engine::{Array, Engine};
use murmurate_onnx::frames::{self, Greeting, Kind};
use murmurate_onnx::joint::Joint;
use murmurate_onnx::network::{Network, PYTHON, Port};
use murmurate_onnx::structure::Role;
use murmurate_onnx::{Contract, Parts};

use self::child::{START, shortened, start};
use self::link::{CALL, Link};
use crate::BadInput;

/// Pauses before a process is started again, one after the other \[s\]; the last one for all further ones.
const PAUSES_S: [u64; 5] = [0, 1, 2, 4, 8];
/// Time without a failure after which the pauses begin anew.
const SOUND: Duration = Duration::from_secs(60);
/// Largest memory of a process, unless the contract says otherwise \[MB\].
const MEMORY_MB: u32 = 4096;
/// Prefix of the address of a process that serves a policy.
const ADDRESS: &str = "unix:";

/// Policy whose steps are computed by processes, each for one thread.
struct Program {
    what: String,
    source: Source,
    contract: Contract,
    /// Connections that no thread uses.
    free: Mutex<Vec<Link>>,
    /// Sessions of the threads.
    sessions: Mutex<Vec<(ThreadId, Weak<Session>)>>,
}

/// Where the processes come from.
enum Source {
    /// They are started: the module and class, and the folder of the contract.
    Started(String, PathBuf),
    /// One waits at this socket.
    Address(PathBuf),
}

/// Use of a process by one thread. Afterwards the next thread takes its connection.
struct Session {
    program: Arc<Program>,
    link: Mutex<Link>,
    /// Calls of each role that wait to be made together.
    waiting: Mutex<BTreeMap<Role, Joint>>,
}

impl Drop for Session {
    fn drop(&mut self) {
        let mut link = std::mem::take(self.link.get_mut().unwrap_or_else(PoisonError::into_inner));
        link.seeds.clear();
        locked(&self.program.free).push(link);
    }
}

/// Calls of one role.
struct Call {
    program: Arc<Program>,
    /// Session of the thread whose engine this is; `None` for one of all threads.
    session: Option<Arc<Session>>,
    role: Role,
    inputs: Arc<[Port]>,
    outputs: Arc<[Port]>,
}

impl Call {
    fn session(&self) -> Arc<Session> {
        self.session.clone().unwrap_or_else(|| self.program.session())
    }
}

impl Engine for Call {
    fn run(&self, inputs: &[Array]) -> Result<Vec<Array>, String> {
        // The number of places for neighbours is known from the first input that has them.
        let places = self.inputs.iter().position(|port| port.of_neighbours).map_or(0, |at| inputs[at].shape[1]);
        self.session().call((self.role, places), inputs, &self.outputs)
    }

    fn reset(&self, robot: RobotId, seed: u64) {
        self.session().reset(robot, seed);
    }

    fn of_thread(&self) -> Option<Arc<dyn Engine>> {
        let (program, session) = (Arc::clone(&self.program), Some(self.program.session()));
        let (inputs, outputs) = (Arc::clone(&self.inputs), Arc::clone(&self.outputs));
        Some(Arc::new(Call { program, session, role: self.role, inputs, outputs }))
    }

    fn is_joint(&self) -> bool {
        true
    }

    fn ask(&self, robot: RobotId, inputs: &[Array]) {
        self.session().waiting(self.role, |waiting| waiting.ask(robot, inputs));
    }

    fn answer(&self, robot: RobotId) -> Option<Result<Vec<Array>, String>> {
        let session = self.session();
        session.waiting(self.role, |waiting| waiting.answer(robot, &self.inputs, |inputs| self.run(inputs)))
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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
    let (free, sessions) = (Mutex::default(), Mutex::default());
    let program = Arc::new(Program { what, source, contract: contract.clone(), free, sessions });
    let opened = program.open(&mut locked(&program.session().link));
    let greeting = opened.map_err(|why| BadInput(format!("its policy in Python: {why}")))?;
    if greeting.two && contract.message.floats == 0 {
        let why =
            "its policy in Python: it has 'encode', and its contract no message: write 'step', or 'message.floats'";
        return Err(BadInput(why.to_owned()).into());
    }
    let digest = digest_of(&contract, &greeting.digest)?;
    let roles: &[Role] = if greeting.two { &[Role::Encode, Role::Act] } else { &[Role::Step] };
    let name = format!("{PYTHON} ({})", shortened(&greeting.name));
    Ok(Network::of_engine((contract, digest, name), roles, |role, inputs, outputs| {
        let program = Arc::clone(&program);
        Arc::new(Call { program, session: None, role, inputs: inputs.into(), outputs: outputs.into() })
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

impl Program {
    /// Returns the session of the thread that calls this: that which it has, or a new one with a connection that no
    /// other thread uses. A connection that is new is made with the first call.
    fn session(self: &Arc<Program>) -> Arc<Session> {
        let thread = std::thread::current().id();
        let mut sessions = locked(&self.sessions);
        sessions.retain(|(_, session)| session.strong_count() > 0);
        let own = sessions.iter().find(|(of, _)| *of == thread).and_then(|(_, session)| session.upgrade());
        own.unwrap_or_else(|| {
            let link = locked(&self.free).pop().unwrap_or_default();
            let session = Session { program: Arc::clone(self), link: Mutex::new(link), waiting: Mutex::default() };
            let session = Arc::new(session);
            sessions.push((thread, Arc::downgrade(&session)));
            session
        })
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
        (link.stream, link.child, link.opened) = (Some(stream), child, true);
        let answer = link.exchange(Kind::Hello, &frames::hello(&self.contract)?, START)?;
        frames::greeting(&answer)
    }

    /// Starts the process, or connects to it, unless it has just failed.
    fn again(&self, link: &mut Link) -> Result<(), String> {
        if link.opened {
            let pause = Duration::from_secs(PAUSES_S[link.failures.min(PAUSES_S.len() - 1)]);
            if link.failed.is_some_and(|failed| failed.elapsed() < pause) {
                return Err(format!("'{}' has ended and is started again soon", self.what));
            }
            if link.failed.is_none_or(|failed| failed.elapsed() > SOUND) {
                link.failures = 0;
            }
            link.failures += 1;
            link.failed = Some(Instant::now());
        }
        // Its robots have begun, or go on in their episodes, for which it has to begin as the process before did.
        let seeds: Vec<(RobotId, u64)> = link.seeds.iter().map(|(robot, seed)| (*robot, *seed)).collect();
        let begun = self.open(link).and_then(|_| {
            seeds.into_iter().try_for_each(|(robot, seed)| link.send(Kind::Reset, &frames::reset(robot, seed)))
        });
        if begun.is_err() {
            link.end();
        }
        begun
    }
}

impl Session {
    /// Returns the outputs of a call with so many places for neighbours. One that fails is an error, after which the
    /// process is started again if it has ended or says nothing.
    fn call(&self, (role, places): (Role, usize), inputs: &[Array], outputs: &[Port]) -> Result<Vec<Array>, String> {
        let mut link = locked(&self.link);
        if link.stream.is_none() {
            self.program.again(&mut link)?;
        }
        let robots = inputs.first().and_then(|array| array.shape.first()).copied().unwrap_or(1);
        let answer = link.exchange(Kind::Call, &frames::call(role, (robots, places), inputs), CALL)?;
        frames::outputs(&answer, robots, outputs).map_err(|why| format!("'{}': {why}", self.program.what))
    }

    /// Calls `with` with the calls of a role that wait.
    fn waiting<T>(&self, role: Role, with: impl FnOnce(&mut Joint) -> T) -> T {
        with(locked(&self.waiting).entry(role).or_default())
    }

    fn reset(&self, robot: RobotId, seed: u64) {
        let mut link = locked(&self.link);
        link.seeds.insert(robot, seed);
        // A process that is gone is noticed with the next call.
        let _ = link.send(Kind::Reset, &frames::reset(robot, seed));
    }
}
