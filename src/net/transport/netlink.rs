//! Notices of the kernel that network interfaces or their addresses have changed (rtnetlink(7)), for a thread that
//! opens sockets again. Reads only from the kernel; control threads do not use it.

use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::thread;
use std::time::Duration;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{AddressFamily, MsgFlags, NetlinkAddr, SockFlag, SockProtocol, SockType, bind, recv, socket};

use super::removed::Removed;

/// Groups of notices: interfaces, IPv4 addresses, IPv6 addresses (linux/rtnetlink.h, `RTMGRP_*`).
const GROUPS: u32 = 0x1 | 0x10 | 0x100;
/// Type of the notice that an interface was removed (linux/rtnetlink.h, `RTM_DELLINK`).
const REMOVED: u16 = 17;
/// Length of a notice's header \[bytes\]: length, type, flags, number and sender (linux/netlink.h, `nlmsghdr`).
const HEADER_BYTES: usize = 16;
/// Offset of the interface's number in a notice: behind its family, type and padding (linux/rtnetlink.h, `ifinfomsg`).
const INDEX_AT: usize = HEADER_BYTES + 4;
/// Shortest time between two looks at the interfaces, however many notices arrive.
const PACE: Duration = Duration::from_millis(20);

/// Socket on which the kernel tells of changes of network interfaces. Without it, interfaces are only looked at
/// periodically.
pub struct LinkWatch(Option<OwnedFd>);

impl LinkWatch {
    /// Subscribes to the kernel's notices of this network namespace.
    pub fn open() -> LinkWatch {
        let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
        let open = socket(AddressFamily::Netlink, SockType::Raw, flags, SockProtocol::NetlinkRoute);
        LinkWatch(open.and_then(|fd| bind(fd.as_raw_fd(), &NetlinkAddr::new(0, GROUPS)).map(|()| fd)).ok())
    }

    /// Whether the kernel tells of changes.
    pub fn is_told(&self) -> bool {
        self.0.is_some()
    }

    /// Waits until the kernel tells of a change, at most for `longest`. Returns which interfaces were removed.
    pub fn wait(&self, longest: Duration) -> Removed {
        let Some(socket) = &self.0 else {
            thread::park_timeout(longest);
            return Removed::Only(Vec::new());
        };
        let timeout = PollTimeout::try_from(longest).unwrap_or(PollTimeout::MAX);
        if let Ok(1..) = poll(&mut [PollFd::new(socket.as_fd(), PollFlags::POLLIN)], timeout) {
            thread::park_timeout(PACE);
        }
        let (mut removed, mut buffer) = (Vec::new(), [0; 8192]);
        loop {
            match recv(socket.as_raw_fd(), &mut buffer, MsgFlags::MSG_DONTWAIT) {
                Ok(length) => removed.extend(removals(&buffer[..length])),
                Err(Errno::EINTR) => {}
                Err(Errno::ENOBUFS) => return Removed::Unknown,
                Err(_) => return Removed::Only(removed),
            }
        }
    }
}

/// Returns the numbers of the interfaces that the notices in `bytes` tell were removed. A bridge tells of ports that
/// leave it by the same type, with a family of its own; they stay.
fn removals(mut bytes: &[u8]) -> Vec<u32> {
    let mut removed = Vec::new();
    while let Some(header) = bytes.get(..HEADER_BYTES) {
        let length = u32::from_ne_bytes([header[0], header[1], header[2], header[3]]) as usize;
        let kind = u16::from_ne_bytes([header[4], header[5]]);
        let Some(notice) = bytes.get(..length).filter(|notice| notice.len() >= HEADER_BYTES) else { break };
        if kind == REMOVED
            && notice.get(HEADER_BYTES) == Some(&0)
            && let Some(&[a, b, c, d]) = notice.get(INDEX_AT..INDEX_AT + 4)
        {
            removed.push(u32::from_ne_bytes([a, b, c, d]));
        }
        // Notices begin at multiples of four bytes.
        bytes = bytes.get(length.next_multiple_of(4)..).unwrap_or_default();
    }
    removed
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A notice of this type, of an interface with this number, in this address family.
    fn notice(kind: u16, family: u8, index: u32) -> Vec<u8> {
        let body = [&[family, 0, 1, 0][..], &index.to_ne_bytes(), &[0; 9]].concat();
        let mut bytes = u32::try_from(HEADER_BYTES + body.len()).expect("it is short").to_ne_bytes().to_vec();
        bytes.extend(kind.to_ne_bytes());
        bytes.extend([0; 10]);
        bytes.extend(body);
        bytes
    }

    #[test]
    fn only_interfaces_that_were_removed_are_found_and_odd_bytes_are_none() {
        let padded = [notice(REMOVED, 0, 7), vec![0; 3]].concat();
        let all = [padded, notice(16, 0, 8), vec![0; 3], notice(REMOVED, 7, 9), vec![0; 3], notice(REMOVED, 0, 10)];
        assert_eq!(removals(&all.concat()), [7, 10]);
        let one = notice(REMOVED, 0, 7);
        for cut in 0..one.len() {
            assert_eq!(removals(&one[..cut]), [0u32; 0], "{cut} bytes");
        }
        assert_eq!(removals(&[0; 64]), [0u32; 0], "a length of zero ends it");
    }

    #[test]
    fn a_watch_without_a_notice_waits_no_longer_than_it_may() {
        let watch = LinkWatch::open();
        assert!(watch.0.is_some(), "every process may listen to these notices");
        assert!(matches!(watch.wait(Duration::from_millis(1)), Removed::Only(_)));
    }
}
