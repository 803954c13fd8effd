//! Worker of a driver, source or observer: an actor on a thread of its own, which does the input and output.

use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use actix::{Actor, ActorContext, ArbiterHandle, Context, Handler, Recipient, Supervised, Supervisor, System};
use tokio::runtime;

use super::channel::{self, Gate, Input, PacketSender, Port};
use super::{Packet, ROOM};
use crate::config::ConfigError;

/// Input and output of a driver, a source of readings or an observer, before it is started: settings, from which an
/// actor is made.
pub trait Worker: Send {
    /// Checks that this machine has what the worker needs, such as a program file; called before the worker is started.
    /// It is no part of the check of a team file, which may be valid although this host lacks something.
    fn check(&self) -> Result<(), ConfigError> {
        Ok(())
    }

    /// Starts the worker's actor in `seat` by [`Seat::start`], and returns the actor's mailbox.
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input>;

    /// Returns the program that the worker runs, with its arguments; `None` if it runs none.
    fn runs(&self) -> Option<Vec<String>> {
        None
    }

    /// Returns the description of a resource that only one robot and one process of the machine may use, such as a
    /// robot's network address; `None` if the worker needs no such resource.
    fn claim(&self) -> Option<String> {
        None
    }
}

/// Place for the actor of one worker: an arbiter of its own, and the port to the control thread.
#[derive(Debug)]
pub struct Seat {
    arbiter: ArbiterHandle,
    port: Port,
}

impl Seat {
    /// Returns a sender of packets to the control thread, which can be used before the actor runs.
    pub fn sender(&self) -> PacketSender {
        self.port.sender()
    }

    /// Starts the actor that `make` returns, under supervision: when it stops before its mailbox is told to close, it
    /// is started again, by `Supervised::restarting`. Its mailbox holds [`ROOM`] messages. The actor has to keep the
    /// port, since the worker has ended when the port is dropped.
    pub fn start<A>(self, make: impl FnOnce(Port) -> A + Send + 'static) -> Recipient<Input>
    where
        A: Actor<Context = Context<A>> + Supervised + Handler<Input>,
    {
        let Seat { arbiter, port } = self;
        let start = move |context: &mut Context<A>| {
            context.set_mailbox_capacity(ROOM);
            make(port)
        };
        Supervisor::start_in_arbiter(&arbiter, start).recipient()
    }

    /// Starts an actor that calls the function that `make` returns with each packet of the control thread, until the
    /// channel is closed: for a worker that has no input and no timers of its own.
    pub fn serve<F>(self, make: impl FnOnce() -> F + Send + 'static) -> Recipient<Input>
    where
        F: FnMut(Packet) + Unpin + 'static,
    {
        self.start(|port| Server { handle: make(), _port: port })
    }
}

/// Actor that calls a function with each packet.
struct Server<F> {
    handle: F,
    _port: Port,
}

impl<F: FnMut(Packet) + Unpin + 'static> Actor for Server<F> {
    type Context = Context<Self>;
}

impl<F: FnMut(Packet) + Unpin + 'static> Supervised for Server<F> {}

impl<F: FnMut(Packet) + Unpin + 'static> Handler<Input> for Server<F> {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        match input {
            Input::Packet(packet) => (self.handle)(packet),
            Input::Close => context.stop(),
        }
    }
}

/// Running worker. It ends after its [`Gate`] is dropped.
#[derive(Debug)]
pub struct Running {
    system: System,
    thread: JoinHandle<()>,
    /// Closed when the actor no longer exists.
    ended: Receiver<()>,
}

impl Running {
    /// Waits until the worker has ended, for at most `longest`. Its gate must be dropped before, since only then it
    /// ends. Returns whether it has; otherwise its thread is abandoned.
    pub fn join(self, longest: Duration) -> bool {
        let ended = self.ended.recv_timeout(longest) == Err(RecvTimeoutError::Disconnected);
        if ended {
            self.system.stop();
            // It has nothing left to do.
            let _ = self.thread.join();
        }
        ended
    }
}

/// Waits until all these workers have ended, for at most `longest` in total. Returns for each whether it has.
pub(crate) fn join_all(workers: Vec<Running>, longest: Duration) -> Vec<bool> {
    let until = Instant::now() + longest;
    workers.into_iter().map(|worker| worker.join(until.saturating_duration_since(Instant::now()))).collect()
}

/// Starts a worker called `name` on a new arbiter. Returns the control thread's end of its channel, and the running
/// worker.
///
/// # Errors
/// If the operating system has no file descriptor or no thread left.
pub fn start(worker: Box<dyn Worker>, name: &str) -> io::Result<(Gate, Running)> {
    let (mut gate, mut port) = channel::channel(name)?;
    let (alive, ended) = channel();
    port.keep(alive);
    let (system, thread) = arbiter(name)?;
    gate.connect(worker.start(Seat { arbiter: system.arbiter().clone(), port }));
    Ok((gate, Running { system, thread, ended }))
}

/// Starts a thread called `name` with an arbiter: a system of the actor library with an asynchronous runtime. Logs know
/// the worker by the thread's name.
fn arbiter(name: &str) -> io::Result<(System, JoinHandle<()>)> {
    let (started, system) = sync_channel(1);
    let run = move || {
        let runtime = match runtime::Builder::new_current_thread().enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => return drop(started.send(Err(error))),
        };
        let runner = System::with_tokio_rt(|| runtime);
        let _ = started.send(Ok(System::current()));
        // It ends when its system is stopped.
        let _ = runner.run();
    };
    let thread = thread::Builder::new().name(name.to_owned()).spawn(run)?;
    let system = system.recv().map_err(io::Error::other)??;
    Ok((system, thread))
}
