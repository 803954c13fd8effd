//! Worker of the source `gpsd`: a TCP client that subscribes to reports and passes the lines on unchanged.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::thread;
use std::time::Duration;

use murmurate::edge::{Packet, PacketSender, Port, Worker};
use murmurate::messages::ids::RobotId;

/// Request that subscribes to reports (gpsd_json(5)).
const WATCH: &[u8] = b"?WATCH={\"enable\":true,\"json\":true};\n";
/// Longest accepted line \[bytes\]; the limit of gpsd itself is 10240. A longer line is cut, which makes it malformed.
const LONGEST: usize = 16_384;
/// Longest wait for bytes. The worker notices the end of the host after at most this time.
const WAIT: Duration = Duration::from_millis(100);
/// Timeout for the TCP connection to gpsd to be opened.
const CONNECT: Duration = Duration::from_millis(500);
/// Number of waits without a byte after which the connection counts as lost: 5 s in total. Receivers report each second
/// or faster.
const SILENT: u32 = 50;
/// Number of waits without a byte after which the name of gpsd's host is resolved again: 1 s in total. Another address
/// ends the connection.
const UNSURE: u32 = 10;
/// Pause after the first failed connection to gpsd, and longest pause, as numbers of waits of 0.1 s. The pause doubles
/// after each further failure.
const PAUSES: [u32; 2] = [2, 32];

/// Worker of the source `gpsd`: a TCP client that receives the reports of gpsd and connects again after errors.
pub struct Subscriber {
    /// Address and TCP port of gpsd, or name of its host with the port. A name is resolved for each connection.
    pub address: String,
    /// Robot that the receiver is on, for log messages.
    pub robot: RobotId,
}

impl Worker for Subscriber {
    fn run(self: Box<Self>, port: Port) {
        let sender = port.sender();
        let [mut pause, longest] = PAUSES;
        let mut failures = 0u32;
        while !sender.is_closed() {
            let mut lines = Lines::default();
            let end = self.subscribe().and_then(|stream| self.follow(stream, &mut lines, &sender));
            let Err(error) = end else { return };
            if lines.passed > 0 {
                (pause, failures) = (PAUSES[0], 0);
            }
            failures += 1;
            if failures.is_power_of_two() {
                let Subscriber { address, robot } = &*self;
                tracing::warn!("no reports of gpsd at {address} for {robot}: {error}; does it run, with its receiver?");
            }
            (0..pause).take_while(|_| !sender.is_closed()).for_each(|_| thread::park_timeout(WAIT));
            pause = (2 * pause).min(longest);
        }
    }
}

impl Subscriber {
    fn subscribe(&self) -> io::Result<TcpStream> {
        let mut connected = Err(io::Error::other("its name has no address"));
        for at in resolve(&self.address)? {
            connected = TcpStream::connect_timeout(&at, CONNECT);
            if connected.is_ok() {
                break;
            }
        }
        let mut stream = connected?;
        stream.set_read_timeout(Some(WAIT))?;
        stream.set_write_timeout(Some(WAIT))?;
        stream.write_all(WATCH)?;
        Ok(stream)
    }

    /// Passes lines from gpsd to the source until the host ends. An error is the reason for which the connection ended.
    fn follow(&self, mut stream: TcpStream, lines: &mut Lines, sender: &PacketSender) -> io::Result<()> {
        let (mut buffer, mut silent) = ([0; 4096], 0);
        let at = stream.peer_addr()?;
        let mut asked: Option<thread::JoinHandle<io::Result<Vec<SocketAddr>>>> = None;
        while !sender.is_closed() {
            // A resolver may take seconds, in which readings may come again, so it has a thread of its own.
            if silent == UNSURE && asked.is_none() {
                let address = self.address.clone();
                asked = Some(thread::spawn(move || resolve(&address)));
            }
            if let Some(answer) = asked.take_if(|asked| asked.is_finished())
                && let Ok(Ok(now)) = answer.join()
                && !now.contains(&at)
                && silent >= UNSURE
            {
                return Err(io::Error::other(format!("it is silent at {at}, and its name has another address now")));
            }
            match stream.read(&mut buffer) {
                Ok(0) => return Err(io::Error::other("it has closed the connection")),
                Ok(length) => {
                    silent = 0;
                    lines.take(&buffer[..length], |line| sender.send(line));
                }
                Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                    silent += 1
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
            if silent >= SILENT {
                return Err(io::Error::other("it is silent"));
            }
        }
        Ok(())
    }
}

/// Returns the addresses of gpsd: an IP address as it is, or all of a name.
fn resolve(address: &str) -> io::Result<Vec<SocketAddr>> {
    address.to_socket_addrs().map(Iterator::collect)
}

/// Splitter of a byte stream into lines.
#[derive(Debug, Default)]
struct Lines {
    /// Bytes of the current, unfinished line.
    begun: Vec<u8>,
    /// Number of complete lines so far.
    passed: u64,
}

impl Lines {
    /// Takes the next bytes, and calls `each` with every line that they complete.
    fn take(&mut self, bytes: &[u8], mut each: impl FnMut(Packet)) {
        for byte in bytes {
            match byte {
                b'\n' => {
                    self.passed += 1;
                    each(Packet::from(std::mem::take(&mut self.begun)));
                }
                b'\r' => {}
                _ if self.begun.len() < LONGEST => self.begun.push(*byte),
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_put_together_and_a_long_one_is_cut() {
        let (mut lines, mut all) = (Lines::default(), Vec::new());
        for bytes in [&b"ab"[..], b"c\r\n\nd", b"e\n", &[b'x'; 20_000], b"\nf"] {
            lines.take(bytes, |line| all.push(line.into_vec()));
        }
        assert_eq!(all[..3], [b"abc".to_vec(), b"".to_vec(), b"de".to_vec()]);
        assert_eq!((all[3].len(), all.len(), lines.passed), (LONGEST, 4, 4));
    }
}
