//! Serial lines: opening of a device at a rate, as a descriptor that does not wait.

use std::io;
use std::os::fd::OwnedFd;

use nix::fcntl::{OFlag, open as open_file};
use nix::sys::stat::Mode;
use nix::sys::termios::{BaudRate, ControlFlags, SetArg, cfmakeraw, cfsetspeed, tcgetattr, tcsetattr};

/// Opens the device at a rate of `BAUDS` \[baud\], with eight bits, no parity and no flow control.
pub fn open(device: &str, baud: u32) -> io::Result<OwnedFd> {
    let rate = match baud {
        9600 => BaudRate::B9600,
        19_200 => BaudRate::B19200,
        38_400 => BaudRate::B38400,
        57_600 => BaudRate::B57600,
        115_200 => BaudRate::B115200,
        230_400 => BaudRate::B230400,
        #[cfg(target_os = "linux")]
        460_800 => BaudRate::B460800,
        #[cfg(target_os = "linux")]
        921_600 => BaudRate::B921600,
        _ => return Err(io::Error::new(io::ErrorKind::InvalidInput, "this system has no such rate")),
    };
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
    let line = open_file(device, flags, Mode::empty())?;
    let mut form = tcgetattr(&line)?;
    cfmakeraw(&mut form);
    cfsetspeed(&mut form, rate)?;
    form.control_flags |= ControlFlags::CLOCAL | ControlFlags::CREAD;
    form.control_flags &= !(ControlFlags::CSTOPB | ControlFlags::CRTSCTS);
    tcsetattr(&line, SetArg::TCSANOW, &form)?;
    Ok(line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::fd::AsFd;

    #[test]
    fn a_line_passes_every_byte_unchanged_and_what_is_no_line_is_refused() {
        let pair = nix::pty::openpty(None, None).expect("a pseudo-terminal");
        let name = nix::unistd::ttyname(pair.slave.as_fd()).expect("it has a name");
        let line = open(name.to_str().expect("a path"), 57_600).expect("a line");
        let all: Vec<u8> = (0..=255).collect();
        assert_eq!(nix::unistd::write(&line, &all).expect("room"), all.len());
        let mut read = Vec::new();
        while read.len() < all.len() {
            let mut bytes = [0; 256];
            let count = nix::unistd::read(&pair.master, &mut bytes).expect("bytes");
            read.extend_from_slice(&bytes[..count]);
        }
        assert_eq!(read, all);
        assert!(open("/dev/null", 57_600).is_err() && open("/dev/none", 57_600).is_err());
    }
}
