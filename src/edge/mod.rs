//! What joins the thread that drives a robot with the threads that do its I/O: one bounded channel for each worker.
//!
//! The control thread has the [`Gate`], the worker the [`Port`]. Both ways hold `ROOM` packets; what finds none is
//! dropped and counted, and nobody waits. A packet is a plain value as bytes, so what comes in can be kept and played
//! again like a datagram. Whatever a worker says rings a descriptor, which the driver of real time watches.

pub mod child;
mod settings;

pub use settings::Settings;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use nix::sys::eventfd::{EfdFlags, EventFd};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TryRecvError;

/// One message over the channel.
pub type Packet = Box<[u8]>;

/// Packets that wait in one direction at the most: three seconds of a robot that is told something 20 times a second.
pub const ROOM: usize = 64;

/// What does the I/O of a driver or a source. It has a thread of its own, and may start a runtime there.
pub trait Worker: Send {
    /// Works until the port is closed. It then has a second to end, and the robot is to stand.
    fn run(self: Box<Self>, port: Port);
}

/// The worker's end of a channel.
#[derive(Debug)]
pub struct Port {
    told: mpsc::Receiver<Packet>,
    mouth: Mouth,
    /// Dropped last: whoever looks then finds that the worker is gone.
    _last: LastRing,
}

/// Rings when the worker has ended.
#[derive(Debug)]
struct LastRing(Arc<EventFd>);

impl Drop for LastRing {
    fn drop(&mut self) {
        let _ = self.0.write(1);
    }
}

/// A worker's way to the control thread, of which it may have several.
#[derive(Clone, Debug)]
pub struct Mouth {
    says: mpsc::Sender<Packet>,
    bell: Arc<EventFd>,
    dropped: Arc<AtomicU64>,
}

/// Whether a worker works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Worked {
    /// It does.
    On,
    /// It has ended, and all that it has said was taken.
    Ended,
}

/// The control thread's end of a channel.
#[derive(Debug)]
pub struct Gate {
    /// Dropped first: a worker that hears nothing more finds its mouth closed.
    heard: mpsc::Receiver<Packet>,
    tells: mpsc::Sender<Packet>,
    bell: Arc<EventFd>,
    /// Packets that have found no room: to the worker, and from it.
    refused: u64,
    dropped: Arc<AtomicU64>,
}

/// Both ends of a new channel. An error is the machine's, which has no descriptor left.
pub fn channel() -> std::io::Result<(Gate, Port)> {
    let (tells, told) = mpsc::channel(ROOM);
    let (says, heard) = mpsc::channel(ROOM);
    let flags = EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC;
    let bell = Arc::new(EventFd::from_flags(flags)?);
    let dropped = Arc::new(AtomicU64::new(0));
    let (mouth, last) = (Mouth { says, bell: Arc::clone(&bell), dropped: Arc::clone(&dropped) }, Arc::clone(&bell));
    Ok((Gate { tells, heard, bell, refused: 0, dropped }, Port { told, mouth, _last: LastRing(last) }))
}

impl Port {
    /// Waits for a packet, on a thread that is free to wait; none once the control thread is gone.
    pub fn wait(&mut self) -> Option<Packet> {
        self.told.blocking_recv()
    }

    /// The same in a task.
    pub async fn next(&mut self) -> Option<Packet> {
        self.told.recv().await
    }

    /// The way back.
    pub fn mouth(&self) -> Mouth {
        self.mouth.clone()
    }
}

impl Mouth {
    /// Says something to the control thread. It is dropped and counted where that has not kept up.
    pub fn say(&self, packet: Packet) {
        match self.says.try_send(packet) {
            Ok(()) => {
                // A bell that has rung too often to count has rung.
                let _ = self.bell.write(1);
            }
            Err(mpsc::error::TrySendError::Full(_)) => {
                let dropped = self.dropped.fetch_add(1, Ordering::Relaxed) + 1;
                if dropped.is_power_of_two() {
                    tracing::warn!(dropped, "a worker says more than is read");
                }
            }
            Err(mpsc::error::TrySendError::Closed(_)) => {}
        }
    }

    /// Whether the control thread is gone.
    pub fn is_closed(&self) -> bool {
        self.says.is_closed()
    }
}

impl Gate {
    /// Tells the worker something. It is dropped and counted where the worker has not kept up.
    pub fn tell(&mut self, packet: Packet) {
        if let Err(mpsc::error::TrySendError::Full(_)) = self.tells.try_send(packet) {
            self.refused += 1;
            if self.refused.is_power_of_two() {
                tracing::warn!(refused = self.refused, "a worker does not keep up with what it is told");
            }
        }
    }

    /// Takes what the worker has said: at most `ROOM` packets, so that a worker that never stops holds up nobody.
    pub fn take(&mut self, mut each: impl FnMut(Packet)) -> Worked {
        // Before the packets: what comes between rings again.
        let _ = self.bell.read();
        for _ in 0..ROOM {
            match self.heard.try_recv() {
                Ok(packet) => each(packet),
                Err(TryRecvError::Empty) => return Worked::On,
                Err(TryRecvError::Disconnected) => return Worked::Ended,
            }
        }
        let _ = self.bell.write(1);
        Worked::On
    }

    /// Packets that have found no room: to the worker, and from it.
    pub fn dropped(&self) -> (u64, u64) {
        (self.refused, self.dropped.load(Ordering::Relaxed))
    }

    /// What has something to read when the worker has said something.
    pub fn bell(&self) -> Arc<EventFd> {
        Arc::clone(&self.bell)
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
    fn what_finds_no_room_is_counted_and_nobody_waits() {
        let (mut gate, mut port) = channel().unwrap();
        (0..ROOM + 3).for_each(|n| gate.tell(packet(n)));
        let mouth = port.mouth();
        (0..ROOM + 5).for_each(|n| mouth.say(packet(n)));
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
            let mouth = port.mouth();
            while port.wait().is_some() {}
            mouth.is_closed()
        });
        drop(gate);
        assert!(worker.join().unwrap());
    }

    #[test]
    fn the_end_of_a_worker_rings_and_is_found_behind_its_last_word() {
        let (mut gate, port) = channel().unwrap();
        let mouth = port.mouth();
        mouth.say(packet(7));
        drop(mouth);
        drop(port);
        assert_eq!(gate.bell().read(), Ok(2));
        let mut heard = Vec::new();
        assert_eq!((gate.take(|packet| heard.push(packet)), heard), (Worked::Ended, vec![packet(7)]));
        gate.tell(packet(8));
        assert_eq!(gate.dropped(), (0, 0), "there is nobody to keep up");
    }

    #[test]
    fn the_bell_rings_as_long_as_something_is_left() {
        let (mut gate, port) = channel().unwrap();
        assert!(gate.bell().read().is_err(), "nothing yet");
        port.mouth().say(packet(1));
        port.mouth().say(packet(2));
        assert_eq!(gate.bell().read(), Ok(2));
        gate.bell().write(2).unwrap();
        let mut heard = 0;
        gate.take(|_| heard += 1);
        assert_eq!(heard, 2);
        assert!(gate.bell().read().is_err(), "all is read");
    }
}
