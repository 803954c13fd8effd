//! Channel between the control thread and the actor of a worker: bounded both ways, without waiting on either side.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use actix::{Actor, ActorContext, AsyncContext, Context, Message, Recipient, dev::SendError};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::{TryRecvError, TrySendError};

use super::panic::end_if_panicking;
use super::{Bell, Packet, ROOM};

/// Message of the control thread to the actor of a worker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A packet of the driver, source or observer.
    Packet(Packet),
    /// The control thread has closed the channel. The actor has to stop within a second, in which that of a driver must
    /// stop its robot.
    Close,
}

impl Message for Input {
    type Result = ();
}

/// Packet of a worker, with the number of the worker's life that has sent it.
type Sent = (u32, Packet);

/// Worker's end of the channel to the control thread, which the worker's actor keeps while it exists. A panic in the
/// actor drops it, which ends the process.
#[derive(Debug)]
pub struct Port {
    name: String,
    sender: PacketSender,
    lives: Arc<AtomicU32>,
    /// Dropped with the port, so that its receiver learns of the worker's end; `None` without a receiver.
    alive: Option<std::sync::mpsc::Sender<()>>,
    /// Dropped last, so that the control thread finds the channel closed when it is signalled.
    _end: SignalOnDrop,
}

/// Guard object that signals the control thread when it is dropped, at the end of the worker.
#[derive(Debug)]
struct SignalOnDrop(Arc<Bell>);

impl Drop for SignalOnDrop {
    fn drop(&mut self) {
        self.0.ring();
    }
}

/// Sender of packets from a worker to the control thread; a worker may have several.
#[derive(Clone, Debug)]
pub struct PacketSender {
    life: u32,
    tx: mpsc::Sender<Sent>,
    bell: Arc<Bell>,
    dropped: Arc<AtomicU64>,
}

/// State of a worker, as seen by the control thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkerState {
    /// The worker runs, or some of its packets have not been taken yet.
    Running,
    /// The worker has lost what it works with, such as its program, and begins again: nothing that it has sent before
    /// holds any more. Packets that it has sent since then may wait.
    Restarted,
    /// The worker has ended, and all of its packets have been taken.
    Ended,
}

/// Control thread's end of the channel between the control thread and a worker.
#[derive(Debug)]
pub struct Gate {
    /// Receiver of the worker's packets.
    rx: mpsc::Receiver<Sent>,
    /// Mailbox of the worker's actor; `None` before the actor is started.
    to: Option<Recipient<Input>>,
    bell: Arc<Bell>,
    /// Number of packets to the worker that were dropped because its mailbox was full.
    refused: u64,
    dropped: Arc<AtomicU64>,
    /// Number of times that the worker has begun again, and as many as the control thread knows of.
    lives: Arc<AtomicU32>,
    known: u32,
    /// First packet of a life that the control thread has just learned of.
    first: Option<Packet>,
}

/// Makes the channel of the worker called `name`, and returns both ends. It has no mailbox yet.
pub(super) fn channel(name: &str) -> std::io::Result<(Gate, Port)> {
    let (tx, rx) = mpsc::channel(ROOM);
    let bell = Arc::new(Bell::new()?);
    let (dropped, lives) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU32::new(0)));
    let end = SignalOnDrop(Arc::clone(&bell));
    let sender = PacketSender { life: 0, tx, bell: Arc::clone(&bell), dropped: Arc::clone(&dropped) };
    let port = Port { name: name.to_owned(), sender, lives: Arc::clone(&lives), alive: None, _end: end };
    Ok((Gate { rx, to: None, bell, refused: 0, dropped, lives, known: 0, first: None }, port))
}

impl Port {
    /// Returns the name of the worker, for log messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Sends a packet to the control thread without waiting, as `PacketSender::send` does.
    pub fn send(&self, packet: Packet) {
        self.sender.send(packet);
    }

    /// Returns a further sender of packets from this worker to the control thread, for a task or thread of the worker.
    pub fn sender(&self) -> PacketSender {
        self.sender.clone()
    }

    /// Keeps `alive` until the worker has ended.
    pub(super) fn keep(&mut self, alive: std::sync::mpsc::Sender<()>) {
        self.alive = Some(alive);
    }

    /// Calls `begin` after `pause`, for `Actor::started`; stops the actor if the channel has been closed. (The actor
    /// library calls `started` at each start of an actor, after `Supervised::restarting`.)
    pub fn resume<A>(&self, pause: Duration, context: &mut Context<A>, begin: fn(&mut A, &mut Context<A>))
    where
        A: Actor<Context = Context<A>>,
    {
        if self.sender.is_closed() {
            context.stop();
        } else {
            context.run_later(pause, begin);
        }
    }

    /// Reports to the control thread that the worker begins again, so that nothing that it has sent before holds any
    /// more. Packets of the senders made before are dropped from now on.
    pub fn begin_again(&mut self) {
        self.sender.life += 1;
        self.lives.store(self.sender.life, Ordering::Release);
        self.sender.bell.ring();
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        end_if_panicking(|| (format!("the worker of {}", self.name), String::new()));
    }
}

impl PacketSender {
    /// Sends a packet to the control thread without waiting. If the channel is full, the packet is dropped and counted.
    pub fn send(&self, packet: Packet) {
        match self.tx.try_send((self.life, packet)) {
            Ok(()) => {
                self.bell.ring();
            }
            Err(TrySendError::Full(_)) => {
                let dropped = self.dropped.fetch_add(1, Ordering::Relaxed) + 1;
                if dropped.is_power_of_two() {
                    tracing::warn!(dropped, "a worker sends more than is read: packets are dropped");
                }
            }
            Err(TrySendError::Closed(_)) => {}
        }
    }

    /// Whether the control thread has closed its end of the channel, so that the worker is to end.
    pub fn is_closed(&self) -> bool {
        self.tx.is_closed()
    }
}

impl Gate {
    /// Sets the mailbox of the worker's actor.
    pub(super) fn connect(&mut self, to: Recipient<Input>) {
        self.to = Some(to);
    }

    /// Sends a packet to the worker without waiting. If its mailbox is full, the packet is dropped and counted.
    pub fn send(&mut self, packet: Packet) {
        let Some(to) = &self.to else { return };
        if let Err(SendError::Full(_)) = to.try_send(Input::Packet(packet)) {
            self.refused += 1;
            if self.refused.is_power_of_two() {
                tracing::warn!(refused = self.refused, "a worker does not read what it is sent: packets are dropped");
            }
        }
    }

    /// Calls `each` with the waiting packets of the worker, at most 64 (`ROOM`) of them, and returns whether the worker
    /// still runs. The bound keeps a worker that sends without pause from delaying other actors.
    pub fn take(&mut self, mut each: impl FnMut(Packet)) -> WorkerState {
        // Read before the packets are taken, so that a packet that arrives meanwhile signals again.
        self.bell.silence();
        self.first.take().into_iter().for_each(&mut each);
        for _ in 0..ROOM {
            match self.rx.try_recv() {
                // What a life before has sent late.
                Ok((life, _)) if life < self.known => {}
                Ok((life, packet)) if life > self.known => {
                    self.first = Some(packet);
                    self.bell.ring();
                    return self.restarted(life);
                }
                Ok((_, packet)) => each(packet),
                Err(TryRecvError::Empty) => {
                    let lives = self.lives.load(Ordering::Acquire);
                    return if lives > self.known { self.restarted(lives) } else { WorkerState::Running };
                }
                Err(TryRecvError::Disconnected) => return WorkerState::Ended,
            }
        }
        self.bell.ring();
        WorkerState::Running
    }

    fn restarted(&mut self, life: u32) -> WorkerState {
        self.known = life;
        WorkerState::Restarted
    }

    /// Returns two numbers of packets that were dropped because the channel was full: of those to the worker, and of
    /// those from the worker.
    pub fn dropped(&self) -> (u64, u64) {
        (self.refused, self.dropped.load(Ordering::Relaxed))
    }

    /// Returns the number of times that the worker has begun again.
    pub fn restarts(&self) -> u32 {
        self.known
    }

    /// Returns the file descriptor that becomes readable when the worker has sent packets, begins again or has ended.
    pub fn bell(&self) -> Arc<Bell> {
        Arc::clone(&self.bell)
    }
}

impl Drop for Gate {
    fn drop(&mut self) {
        // An actor that stops upon the message may be started again before this end of its mailbox is gone; then it
        // finds the channel closed.
        self.rx.close();
        // A message without a bound, since a full mailbox must not keep a robot from being stopped.
        self.to.iter().for_each(|to| to.do_send(Input::Close));
    }
}
