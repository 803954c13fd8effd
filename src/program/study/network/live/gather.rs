//! Arrival of the participants: connections are greeted side by side, each within a deadline, and whoever shows the key
//! and a name of the team is let in.

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use anyhow::{Context, Result, bail};
use nix::poll::{PollFd, PollFlags, poll};

use super::line::{End, Line};
use super::{Answer, GREETING, Instruction};
use crate::program::output::talk;

/// How long one wait for a host lasts: then it is looked whether all is to end \[ms\].
const LOOK: u16 = 100;
/// Connections that are greeted at the same time: several for each host of a large team. Each lasts `GREETING` at most,
/// so that strangers who say nothing hold nobody up for longer.
const GREETED: usize = 256;

/// A connection that was greeted: the host's name, and the way to it.
type Greeted = (SocketAddr, Result<(String, Line)>);

/// Waits until every host has come; nobody is there after a Ctrl-C.
pub fn gather(
    (listener, key): (&TcpListener, Option<[u8; 32]>),
    hosts: &[String],
    (stop, quiet): (&AtomicBool, bool),
) -> Result<Vec<Line>> {
    listener.set_nonblocking(true).context("cannot wait for hosts")?;
    if !quiet {
        let at = listener.local_addr().map_or("ADDRESS:PORT".to_owned(), |at| at.to_string());
        talk(&format!(
            "waiting for: {}; on each of them: murmurate study network --live TEAM.toml --coordinator {at} --host NAME",
            hosts.join(", ")
        ));
    }
    let (sender, greeted): (Sender<Greeted>, Receiver<Greeted>) = channel();
    let (mut here, mut greeting): (BTreeMap<usize, Line>, usize) = (BTreeMap::new(), 0);
    while here.len() < hosts.len() {
        if stop.load(Ordering::Relaxed) {
            for line in here.values_mut() {
                line.say(&Instruction::Done)?;
            }
            return Ok(Vec::new());
        }
        let mut waiting = [PollFd::new(listener.as_fd(), PollFlags::POLLIN)];
        // An interruption is no mistake: it is looked at above.
        let _ = poll(&mut waiting, LOOK);
        while let Ok((stream, from)) = listener.accept() {
            // One too many is closed.
            if greeting < GREETED {
                greeting += 1;
                let sender = sender.clone();
                thread::spawn(move || {
                    // Nobody waits for it any more when all are here.
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

/// Learns which host is at the other end, within the time that a greeting may take.
fn greet(stream: TcpStream, key: Option<[u8; 32]>) -> Result<(String, Line)> {
    stream.set_nonblocking(false).context("cannot set up the connection")?;
    let mut line = Line::open(stream, End::Coordinator, key.as_ref())?;
    match line.hear_first(GREETING)? {
        Answer::Host(name) => Ok((name, line)),
        _ => bail!("it does not say which host it is"),
    }
}

fn admit(here: &mut BTreeMap<usize, Line>, hosts: &[String], from: SocketAddr, greeted: Result<(String, Line)>) {
    match greeted {
        Ok((name, line)) => match hosts.iter().position(|host| *host == name) {
            Some(at) => drop(here.insert(at, line)),
            None => talk(&format!("{from} says that it is '{name}', which runs no agent of this team; ignored")),
        },
        Err(error) => talk(&format!("{from} is ignored: {error:#}")),
    }
}

fn progress(here: &BTreeMap<usize, Line>, hosts: &[String]) -> String {
    let missing = hosts.iter().enumerate().filter(|(at, _)| !here.contains_key(at)).map(|(_, host)| host.as_str());
    let missing: Vec<&str> = missing.collect();
    let missing = if missing.is_empty() { String::new() } else { format!("; missing: {}", missing.join(", ")) };
    format!("{} of {} hosts are here{missing}", here.len(), hosts.len())
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::time::Instant;

    use super::*;

    fn participant(address: SocketAddr, key: [u8; 32], name: &str) -> Line {
        let mut line = Line::open(TcpStream::connect(address).unwrap(), End::Participant, Some(&key)).unwrap();
        line.say(&Answer::Host(name.to_owned())).unwrap();
        line
    }

    #[test]
    fn connections_that_say_nothing_or_too_much_hold_up_no_host() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let hosts = ["a".to_owned(), "b".to_owned()];
        // Twenty that say nothing: one after the other they would take twenty deadlines.
        let mute: Vec<TcpStream> = (0..20).map(|_| TcpStream::connect(address).unwrap()).collect();
        let flood = thread::spawn(move || {
            let mut stream = TcpStream::connect(address).unwrap();
            let number = [b'0'; 32];
            stream.write_all(&number).and_then(|()| stream.write_all(b"\n")).unwrap();
            // Until it is shut out: much less than what was read before a tag once.
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
        assert!(began.elapsed() < GREETING, "the mute ones were waited for");
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
            // As slowly as its own clock of reads allows: each byte comes long before a timeout of its own.
            stream.set_read_timeout(Some(GREETING / 20)).unwrap();
            while stream.write_all(b"0").is_ok() {
                while stream.read(&mut one).is_ok_and(|read| read > 0) {}
            }
        });
        let (accepted, _) = listener.accept().unwrap();
        assert!(Line::open(accepted, End::Coordinator, None).is_err());
        let took = began.elapsed();
        assert!(took >= GREETING && took < 2 * GREETING, "{took:?}");
        slow.join().unwrap();
    }
}
