//! Channels between the control thread, which drives a robot, and the workers, which are threads that do its I/O: one
//! bounded channel for each worker.
//!
//! The control thread has the [`Gate`], the worker the [`Port`]. Each direction holds up to `ROOM` packets. Further
//! ones are dropped and counted, so no thread blocks on sending. A packet is plain bytes, so input can be recorded and
//! replayed like a datagram. Every packet of a worker signals a descriptor, which the real-time event loop watches.

pub(crate) mod child;
pub(crate) mod exclusive;
pub mod sender_clock;
mod settings;

pub use settings::Settings;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use nix::sys::eventfd::{EfdFlags, EventFd};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TryRecvError;

use crate::config::ConfigError;

/// One message between the control thread and a worker, as bytes.
pub type Packet = Box<[u8]>;

/// Largest number of waiting packets in each direction of a channel between the control thread and a worker: those of
/// three seconds at 20 a second.
pub const ROOM: usize = 64;

/// Input and output of a driver or of a source of readings. It runs on a thread of its own, where it may start an
/// asynchronous runtime.
pub trait Worker: Send {
    /// Checks that this machine has what the worker needs, such as a program file; called before the worker is started.
    /// It is no part of the check of a team file, which may be valid although this host lacks something.
    fn check(&self) -> Result<(), ConfigError> {
        Ok(())
    }

    /// Does the input and output until the control thread closes `port`. Then the worker has one second to return, in
    /// which a driver must stop its robot.
    fn run(self: Box<Self>, port: Port);

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

/// Worker's end of the channel between the control thread and the worker.
#[derive(Debug)]
pub struct Port {
    rx: mpsc::Receiver<Packet>,
    sender: PacketSender,
    /// Dropped last, so that the control thread finds the channel closed when it is signalled.
    _end: SignalOnDrop,
}

/// Guard object that signals the control thread when it is dropped, at the end of the worker.
#[derive(Debug)]
struct SignalOnDrop(Arc<EventFd>);

impl Drop for SignalOnDrop {
    fn drop(&mut self) {
        let _ = self.0.write(1);
    }
}

/// Sender of packets from a worker to the control thread; a worker may have several.
#[derive(Clone, Debug)]
pub struct PacketSender {
    tx: mpsc::Sender<Packet>,
    event_fd: Arc<EventFd>,
    dropped: Arc<AtomicU64>,
}

/// State of a worker, as seen by the control thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkerState {
    /// The worker runs, or some of its packets have not been taken yet.
    Running,
    /// The worker has ended, and all of its packets have been taken.
    Ended,
}

/// Control thread's end of the channel between the control thread and a worker.
#[derive(Debug)]
pub struct Gate {
    /// Receiver of the worker's packets. Dropped first, so that the worker finds its sender closed.
    rx: mpsc::Receiver<Packet>,
    tx: mpsc::Sender<Packet>,
    event_fd: Arc<EventFd>,
    /// Number of packets to the worker that were dropped because the channel was full.
    refused: u64,
    dropped: Arc<AtomicU64>,
}

/// Makes a channel between the control thread and a worker, and returns both ends.
///
/// # Errors
/// If the operating system has no file descriptor left.
pub fn channel() -> std::io::Result<(Gate, Port)> {
    let (control_tx, worker_rx) = mpsc::channel(ROOM);
    let (worker_tx, control_rx) = mpsc::channel(ROOM);
    let flags = EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC;
    let event_fd = Arc::new(EventFd::from_flags(flags)?);
    let dropped = Arc::new(AtomicU64::new(0));
    let end = SignalOnDrop(Arc::clone(&event_fd));
    let sender = PacketSender { tx: worker_tx, event_fd: Arc::clone(&event_fd), dropped: Arc::clone(&dropped) };
    let gate = Gate { tx: control_tx, rx: control_rx, event_fd, refused: 0, dropped };
    Ok((gate, Port { rx: worker_rx, sender, _end: end }))
}

impl Port {
    /// Blocks until a packet from the control thread arrives. Returns `None` once the control thread has closed the
    /// channel.
    pub fn wait(&mut self) -> Option<Packet> {
        self.rx.blocking_recv()
    }

    /// Waits asynchronously for a packet from the control thread. Returns `None` once the control thread has closed the
    /// channel.
    pub async fn next(&mut self) -> Option<Packet> {
        self.rx.recv().await
    }

    /// Returns a further sender of packets from this worker to the control thread, for another thread of the worker.
    pub fn sender(&self) -> PacketSender {
        self.sender.clone()
    }
}

impl PacketSender {
    /// Sends a packet to the control thread without waiting. If the channel is full, the packet is dropped and counted.
    pub fn send(&self, packet: Packet) {
        match self.tx.try_send(packet) {
            Ok(()) => {
                // The write fails only if the counter is at its maximum, which signals as well.
                let _ = self.event_fd.write(1);
            }
            Err(mpsc::error::TrySendError::Full(_)) => {
                let dropped = self.dropped.fetch_add(1, Ordering::Relaxed) + 1;
                if dropped.is_power_of_two() {
                    tracing::warn!(dropped, "a worker sends more than is read: packets are dropped");
                }
            }
            Err(mpsc::error::TrySendError::Closed(_)) => {}
        }
    }

    /// Whether the control thread has closed its end of the channel, so that the worker is to end.
    pub fn is_closed(&self) -> bool {
        self.tx.is_closed()
    }
}

impl Gate {
    /// Sends a packet to the worker without waiting. If the channel is full, the packet is dropped and counted.
    pub fn send(&mut self, packet: Packet) {
        if let Err(mpsc::error::TrySendError::Full(_)) = self.tx.try_send(packet) {
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
        let _ = self.event_fd.read();
        for _ in 0..ROOM {
            match self.rx.try_recv() {
                Ok(packet) => each(packet),
                Err(TryRecvError::Empty) => return WorkerState::Running,
                Err(TryRecvError::Disconnected) => return WorkerState::Ended,
            }
        }
        let _ = self.event_fd.write(1);
        WorkerState::Running
    }

    /// Returns two numbers of packets that were dropped because the channel was full: of those to the worker, and of
    /// those from the worker.
    pub fn dropped(&self) -> (u64, u64) {
        (self.refused, self.dropped.load(Ordering::Relaxed))
    }

    /// Returns the file descriptor that becomes readable when the worker has sent packets or has ended.
    pub fn event_fd(&self) -> Arc<EventFd> {
        Arc::clone(&self.event_fd)
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    fn packet(n: usize) -> Packet {
        n.to_le_bytes().into()
    }

    #[test]
    fn packets_without_room_are_counted_and_no_thread_blocks() {
        let (mut gate, mut port) = channel().unwrap();
        (0..ROOM + 3).for_each(|n| gate.send(packet(n)));
        let sender = port.sender();
        (0..ROOM + 5).for_each(|n| sender.send(packet(n)));
        assert_eq!(gate.dropped(), (3, 5));
        let mut heard = Vec::new();
        gate.take(|packet| heard.push(packet));
        assert_eq!(heard, (0..ROOM).map(packet).collect::<Vec<_>>(), "in order");
        assert_eq!(port.wait(), Some(packet(0)));
    }

    #[test]
    fn a_worker_ends_when_the_control_thread_is_gone() {
        let (gate, mut port) = channel().unwrap();
        let worker = thread::spawn(move || {
            let sender = port.sender();
            while port.wait().is_some() {}
            sender.is_closed()
        });
        drop(gate);
        assert!(worker.join().unwrap());
    }

    #[test]
    fn the_end_of_a_worker_is_signalled_and_found_after_its_last_packet() {
        let (mut gate, port) = channel().unwrap();
        let sender = port.sender();
        sender.send(packet(7));
        drop(sender);
        drop(port);
        assert_eq!(gate.event_fd().read(), Ok(2));
        let mut heard = Vec::new();
        assert_eq!((gate.take(|packet| heard.push(packet)), heard), (WorkerState::Ended, vec![packet(7)]));
        gate.send(packet(8));
        assert_eq!(gate.dropped(), (0, 0), "the worker is gone");
    }

    #[test]
    fn the_descriptor_is_readable_as_long_as_something_is_left() {
        let (mut gate, port) = channel().unwrap();
        assert!(gate.event_fd().read().is_err(), "nothing yet");
        port.sender().send(packet(1));
        port.sender().send(packet(2));
        assert_eq!(gate.event_fd().read(), Ok(2));
        gate.event_fd().write(2).unwrap();
        let mut heard = 0;
        gate.take(|_| heard += 1);
        assert_eq!(heard, 2);
        assert!(gate.event_fd().read().is_err(), "all is read");
    }
}
