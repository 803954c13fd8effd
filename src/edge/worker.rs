//! Worker of a driver, source, sense or observer: an actor on a thread of its own, which does the input and output.

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

/// Worker that answers each packet of the control thread by a function, for what takes long and needs no I/O.
pub struct Answering<M>(M);

impl<M> Answering<M> {
    /// Creates a worker that answers by the function that `make` returns on the worker's thread.
    pub fn new<F>(make: M) -> Answering<M>
    where
        M: FnOnce() -> F + Send + 'static,
        F: FnMut(Packet) -> Packet + Unpin + 'static,
    {
        Answering(make)
    }
}

impl<M, F> Worker for Answering<M>
where
    M: FnOnce() -> F + Send + 'static,
    F: FnMut(Packet) -> Packet + Unpin + 'static,
{
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        let sender = seat.sender();
        seat.serve(move || {
            let mut answer = (self.0)();
            move |packet: Packet| sender.send(answer(packet))
        })
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

#[cfg(test)]
mod tests {
    use std::os::fd::AsFd;
    use std::sync::mpsc::SyncSender;

    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

    use super::*;
    use crate::edge::WorkerState;

    /// Longest wait for a worker to end: only one that hangs takes so long.
    const HANGS: Duration = Duration::from_secs(60);

    /// Worker that says which packet it has begun with, and then hangs until it is told to go on; then it sends the
    /// packet back, so often.
    struct Hanging {
        begun: SyncSender<Packet>,
        go_on: Receiver<usize>,
    }

    impl Worker for Hanging {
        fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
            let sender = seat.sender();
            seat.serve(move || {
                move |packet: Packet| {
                    self.begun.send(packet.clone()).expect("the test listens");
                    let often = self.go_on.recv().unwrap_or(0);
                    (0..often).for_each(|_| sender.send(packet.clone()));
                }
            })
        }
    }

    /// Starts a worker, sends it a packet, and waits until it hangs with it.
    fn hangs() -> (Gate, Running, Receiver<Packet>, std::sync::mpsc::Sender<usize>) {
        let ((begun, began), (go_on, told)) = (sync_channel(2 * ROOM), channel());
        let (mut gate, running) = start(Box::new(Hanging { begun, go_on: told }), "one that hangs").unwrap();
        gate.send(Packet::from([0]));
        assert_eq!(began.recv_timeout(HANGS), Ok(Packet::from([0])));
        (gate, running, began, go_on)
    }

    #[test]
    fn a_worker_that_hangs_costs_what_has_no_room_and_ends_when_it_goes_on() {
        let (mut gate, running, began, go_on) = hangs();
        let packets: Vec<u8> = (1..=200).collect();
        packets.iter().for_each(|number| gate.send(Packet::from([*number])));
        let (refused, lost) = gate.dropped();
        // The actor library admits one message more for each sender.
        assert!((200 - ROOM as u64 - 1..=200 - ROOM as u64).contains(&refused) && lost == 0, "{refused} {lost}");
        assert_eq!(gate.take(|_| panic!("it says nothing")), WorkerState::Running);
        // The end of the host reaches it although its mailbox is full.
        drop(gate);
        drop(go_on);
        assert!(running.join(HANGS));
        let kept: Vec<u8> = began.try_iter().map(|packet| packet[0]).collect();
        assert_eq!(kept, packets[..kept.len()], "what had room, in order");
        assert_eq!(kept.len() as u64 + refused, 200);
    }

    #[test]
    fn a_worker_that_never_goes_on_does_not_hold_up_the_end_of_its_host() {
        let (gate, running, _began, _go_on) = hangs();
        drop(gate);
        let asked = Instant::now();
        let longest = Duration::from_millis(50);
        assert!(!running.join(longest), "its thread is abandoned");
        assert!(asked.elapsed() >= longest);
    }

    #[test]
    fn what_a_worker_sends_while_nobody_reads_is_dropped_beyond_the_room_and_counted() {
        let (mut gate, running, began, go_on) = hangs();
        go_on.send(1000).unwrap();
        let full = ROOM as u64;
        // It says at its end that it has sent all.
        gate.send(Packet::from([1]));
        assert_eq!(began.recv_timeout(HANGS), Ok(Packet::from([1])));
        assert_eq!(gate.dropped(), (0, 1000 - full));
        let (bell, mut taken) = (gate.bell(), 0);
        assert_eq!(poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::ZERO), Ok(1));
        gate.take(|packet| taken += u64::from(*packet == [0]));
        assert_eq!(taken, full);
        go_on.send(1).unwrap();
        while gate.take(|packet| taken += u64::from(*packet == [1])) == WorkerState::Running && taken == full {
            poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::from(1000u16)).unwrap();
        }
        assert_eq!(taken, full + 1, "it goes on");
        drop(gate);
        assert!(running.join(HANGS));
    }
}
