//! Exclusive use of a resource, such as a robot, by one process of this machine.

use std::io;

/// Lock on a resource that only one process of this machine may use. The kernel releases it when the process ends,
/// however it ends. Processes in different network namespaces do not exclude each other.
#[derive(Debug)]
pub struct Exclusive {
    /// Socket that is bound to an abstract name made from the resource's description. It receives nothing.
    #[cfg(target_os = "linux")]
    _name: std::os::unix::net::UnixDatagram,
    /// Locked file in the folder for temporary files, named by the resource's description.
    #[cfg(not(target_os = "linux"))]
    _file: std::fs::File,
}

impl Exclusive {
    /// Locks the resource with this description, such as the network address of a robot. Returns `None` if another
    /// process, or this one, has locked it.
    #[cfg(target_os = "linux")]
    pub fn lock(resource: &str) -> io::Result<Option<Exclusive>> {
        use std::os::linux::net::SocketAddrExt;
        use std::os::unix::net::{SocketAddr, UnixDatagram};

        // A digest, since an abstract name has at most 107 bytes.
        let name = format!("murmurate/{}", blake3::hash(resource.as_bytes()).to_hex());
        match UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(name)?) {
            Ok(_name) => Ok(Some(Exclusive { _name })),
            Err(error) if error.kind() == io::ErrorKind::AddrInUse => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Locks the resource with this description, such as the network address of a robot. Returns `None` if another
    /// process, or this one, has locked it.
    #[cfg(not(target_os = "linux"))]
    pub fn lock(resource: &str) -> io::Result<Option<Exclusive>> {
        let name = format!("murmurate-{}", blake3::hash(resource.as_bytes()).to_hex());
        let file = std::fs::File::options().create(true).append(true).open(std::env::temp_dir().join(name))?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Exclusive { _file: file })),
            Err(std::fs::TryLockError::WouldBlock) => Ok(None),
            Err(std::fs::TryLockError::Error(error)) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;

    #[test]
    fn a_resource_is_locked_once_at_a_time() {
        let lock = |resource: &str| Exclusive::lock(resource).expect("sockets can be made");
        let held = lock("a robot of this test").expect("it is free");
        assert!(lock("a robot of this test").is_none());
        assert!(lock(&"another ".repeat(100)).is_some(), "its description is longer than a name may be");
        drop(held);
        // A program that another test of this process starts has the socket too, until it runs.
        let end = Instant::now() + Duration::from_secs(20);
        while lock("a robot of this test").is_none() {
            assert!(Instant::now() < end, "the resource stays locked");
            std::thread::yield_now();
        }
    }
}
