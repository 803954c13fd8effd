//! Descriptor by which another thread wakes the control thread: a counter of the kernel on Linux, and a pair of sockets
//! elsewhere.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

#[cfg(target_os = "linux")]
use nix::sys::eventfd::{EfdFlags, EventFd};
#[cfg(not(target_os = "linux"))]
use std::os::unix::net::UnixDatagram;

/// Bell that any thread rings, whose descriptor is readable until it is silenced. Nobody waits on it.
#[derive(Debug)]
pub struct Bell {
    #[cfg(target_os = "linux")]
    count: EventFd,
    /// The end that is heard, and the one that is rung.
    #[cfg(not(target_os = "linux"))]
    ends: (UnixDatagram, UnixDatagram),
}

impl Bell {
    /// Makes a silent bell. Fails if the operating system has no file descriptor left.
    #[cfg(target_os = "linux")]
    pub fn new() -> io::Result<Bell> {
        Ok(Bell { count: EventFd::from_flags(EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC)? })
    }

    /// Makes a silent bell. Fails if the operating system has no file descriptor left.
    #[cfg(not(target_os = "linux"))]
    pub fn new() -> io::Result<Bell> {
        let ends = UnixDatagram::pair()?;
        ends.0.set_nonblocking(true)?;
        ends.1.set_nonblocking(true)?;
        Ok(Bell { ends })
    }

    /// Makes the descriptor readable.
    pub fn ring(&self) {
        // It fails only if the counter is at its maximum or the queue is full, which signals as well.
        #[cfg(target_os = "linux")]
        let _ = self.count.write(1);
        #[cfg(not(target_os = "linux"))]
        let _ = self.ends.1.send(&[1]);
    }

    /// Makes the descriptor not readable until the bell is rung again.
    pub fn silence(&self) {
        #[cfg(target_os = "linux")]
        let _ = self.count.read();
        #[cfg(not(target_os = "linux"))]
        while self.ends.0.recv(&mut [0]).is_ok() {}
    }
}

impl AsFd for Bell {
    fn as_fd(&self) -> BorrowedFd<'_> {
        #[cfg(target_os = "linux")]
        return self.count.as_fd();
        #[cfg(not(target_os = "linux"))]
        return self.ends.0.as_fd();
    }
}
