//! Waits for the participants of a measurement to connect. Connections are authenticated concurrently, each within a
//! time limit. A participant needs the team's key and the name of one of its hosts.

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use anyhow::{Context, Result, bail};
use nix::poll::{PollFd, PollFlags, poll};

use super::connection::{Connection, Side};
use super::{GREETING, Request, Response};
use murmurate::config::shown::counted;
use murmurate_robot::output::talk;
use murmurate_robot::own_name;

/// Longest time until the coordinator notices an interruption while it waits for connections \[ms\].
const LOOK: u16 = 100;
/// Largest number of concurrent connections that are not authenticated yet: several for each host of a large team. Each
/// times out after two `GREETING`s, which bounds the delay by connections that send nothing.
const GREETED: usize = 256;

/// Result of the authentication of a new connection: the peer's address, and the host's name with the connection, or an
/// error.
type Greeted = (SocketAddr, Result<(String, Connection)>);

/// Waits until every host has connected to `listener` and is authenticated with `key`. Returns the connections in the
/// order of `hosts`; none if `stop` is set before.
pub fn gather(
    (listener, key): (&TcpListener, Option<[u8; 32]>),
    hosts: &[String],
    (stop, quiet): (&AtomicBool, bool),
) -> Result<Vec<Connection>> {
    listener.set_nonblocking(true).context("cannot wait for hosts")?;
    if !quiet {
        let at = listener.local_addr().map_or("ADDRESS:PORT".to_owned(), |at| at.to_string());
        talk(&format!(
            "waiting for: {}; on each of them: {} study network --live TEAM.toml --coordinator {at} --host NAME",
            hosts.join(", "),
            own_name()
        ));
    }
    let (sender, greeted): (Sender<Greeted>, Receiver<Greeted>) = channel();
    let (mut here, mut greeting): (BTreeMap<usize, Connection>, usize) = (BTreeMap::new(), 0);
    while here.len() < hosts.len() {
        if stop.load(Ordering::Relaxed) {
            for connection in here.values_mut() {
                connection.send(&Request::Done)?;
            }
            return Ok(Vec::new());
        }
        let mut waiting = [PollFd::new(listener.as_fd(), PollFlags::POLLIN)];
        // An interrupted poll is not an error; the loop checks `stop`.
        let _ = poll(&mut waiting, LOOK);
        while let Ok((stream, from)) = listener.accept() {
            // Connections beyond the limit are closed.
            if greeting < GREETED {
                greeting += 1;
                let sender = sender.clone();
                thread::spawn(move || {
                    // The receiver is gone once all hosts have connected.
                    let _ = sender.send((from, greet(stream, key)));
                });
            }
        }
        for (from, greeted) in greeted.try_iter() {
            greeting -= 1;
            admit(&mut here, hosts, from, greeted);
            if !quiet {
                talk(&progress(&here, hosts));
            }
        }
    }
    Ok(here.into_values().collect())
}

/// Authenticates a new connection and receives the host's name, each line within the time limit `GREETING`.
fn greet(stream: TcpStream, key: Option<[u8; 32]>) -> Result<(String, Connection)> {
    stream.set_nonblocking(false).context("cannot set up the connection")?;
    let mut connection = Connection::open(stream, Side::Coordinator, key.as_ref())?;
    match connection.receive_first(GREETING)? {
        Response::Host(name) => Ok((name, connection)),
        _ => bail!("it did not send its host name"),
    }
}

fn admit(
    here: &mut BTreeMap<usize, Connection>,
    hosts: &[String],
    from: SocketAddr,
    greeted: Result<(String, Connection)>,
) {
    match greeted {
        Ok((name, connection)) => match hosts.iter().position(|host| *host == name) {
            Some(at) => drop(here.insert(at, connection)),
            None => talk(&format!("{from} is ignored: its host name '{name}' is not one of a host with agents")),
        },
        Err(error) => talk(&format!("{from} is ignored: {error:#}")),
    }
}

fn progress(here: &BTreeMap<usize, Connection>, hosts: &[String]) -> String {
    let missing = hosts.iter().enumerate().filter(|(at, _)| !here.contains_key(at)).map(|(_, host)| host.as_str());
    let missing: Vec<&str> = missing.collect();
    let missing = if missing.is_empty() { String::new() } else { format!("; missing: {}", missing.join(", ")) };
    let are = if hosts.len() == 1 { "is" } else { "are" };
    format!("{} of {} {are} connected{missing}", here.len(), counted(hosts.len(), "host"))
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::time::Instant;

    use super::*;

    fn participant(address: SocketAddr, key: [u8; 32], name: &str) -> Connection {
        let mut connection =
            Connection::open(TcpStream::connect(address).unwrap(), Side::Participant, Some(&key)).unwrap();
        connection.send(&Response::Host(name.to_owned())).unwrap();
        connection
    }

    #[test]
    fn silent_and_flooding_connections_delay_no_host() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let hosts = ["a".to_owned(), "b".to_owned()];
        // In sequence, twenty connections that send nothing would take twenty time limits.
        let mute: Vec<TcpStream> = (0..20).map(|_| TcpStream::connect(address).unwrap()).collect();
        let flood = thread::spawn(move || {
            let mut stream = TcpStream::connect(address).unwrap();
            let number = [b'0'; 32];
            stream.write_all(&number).and_then(|()| stream.write_all(b"\n")).unwrap();
            // Waits until the connection is closed.
            let mut sent = 0;
            while stream.write_all(&[b'x'; 1 << 16]).is_ok() {
                sent += 1 << 16;
            }
            sent
        });
        let began = Instant::now();
        let there = thread::spawn(move || ["a", "b"].map(|name| participant(address, [7; 32], name)));
        let here = gather((&listener, Some([7; 32])), &hosts, (&AtomicBool::new(false), true)).unwrap();
        assert_eq!(here.len(), 2);
        assert!(began.elapsed() < 10 * GREETING, "it waited for the silent connections, one after another");
        drop((there.join().unwrap(), mute));
        let sent = flood.join().unwrap();
        assert!(sent < 16 << 20, "{sent} bytes were taken");
    }

    #[test]
    fn a_greeting_that_comes_byte_by_byte_ends_at_its_deadline() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let began = Instant::now();
        let slow = thread::spawn(move || {
            let mut one = [0; 1];
            // Each byte arrives well within the timeout of a single read.
            stream.set_read_timeout(Some(GREETING / 20)).unwrap();
            while stream.write_all(b"0").is_ok() {
                while stream.read(&mut one).is_ok_and(|read| read > 0) {}
            }
        });
        let (accepted, _) = listener.accept().unwrap();
        let error = Connection::open(accepted, Side::Coordinator, None).err().expect("it is too slow").to_string();
        // Without a deadline for the whole line, it would have read on to the longest one there may be.
        let is_late = ["the peer is too slow", "the peer sends nothing"].contains(&&*error);
        assert!(began.elapsed() >= GREETING && is_late, "{error}");
        slow.join().unwrap();
    }
}
