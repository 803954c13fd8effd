//! Records of hosts on a network where somebody sends junk, and copies of authentic datagrams: they replay to their
//! end, and are hardly longer than in a quiet network.
//!
//! The variable MURMURATE_RECORD_JUNK has datagrams a second and episodes (`just full-record-junk`: 20 000 and 4, which
//! take half a minute).

use std::collections::BTreeSet;
use std::fs::write;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use murmurate::messages::ids::HostId;
use murmurate::net::protocol::codec::{self, FLAGS_AT, Flags, Header};
use socket2::{Domain, Protocol, Socket, Type};
use tempfile::TempDir;

use crate::program::{murmurate, run, text};
use crate::records;

/// What somebody without the key sends.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Noise {
    Quiet,
    /// Datagrams of 1.1 kB with the right version and team, and a tag of nothing.
    Junk,
    /// Datagrams that have come by, again and again.
    Copies,
}

fn team(folder: &Path, number: u16, episodes: u32) -> (PathBuf, [SocketAddrV4; 2]) {
    let groups = [1, 2].map(|last| SocketAddrV4::new(Ipv4Addr::new(239, 255, 78, last), 40_000 + number));
    let links: String = ["loopback", "infra"]
        .iter()
        .zip(groups)
        .map(|(link, group)| format!("[link.{link}]\ninterface = \"lo\"\ngroup = \"{group}\"\n"))
        .collect();
    let head =
        format!("team = {number}\nkey_file = \"team.key\"\nmode = \"offboard\"\nrobots = 3\nepisodes = {episodes}\n");
    let file = folder.join("team.toml");
    write(&file, head + &links).unwrap();
    assert!(run(&["key", "new", "--out", folder.join("team.key").to_str().unwrap()]).status.success());
    (file, groups)
}

/// Listens on a group, as anybody can.
fn listener(group: SocketAddrV4) -> UdpSocket {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP)).unwrap();
    socket.set_reuse_address(true).unwrap();
    socket.bind(&SocketAddrV4::new(*group.ip(), group.port()).into()).unwrap();
    socket.join_multicast_v4(group.ip(), &Ipv4Addr::LOCALHOST).unwrap();
    socket.set_nonblocking(true).unwrap();
    socket.into()
}

/// Sends `noise` at the rate `per_s` \[1/s\] until the sender of `stop` is dropped. Returns the achieved rate \[1/s\].
fn disturb(noise: Noise, number: u16, groups: [SocketAddrV4; 2], per_s: u64, stop: &Receiver<()>) -> f64 {
    let sender = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP)).unwrap();
    sender.set_multicast_if_v4(&Ipv4Addr::LOCALHOST).unwrap();
    let sender: UdpSocket = sender.into();
    let ears = groups.map(listener);
    let (mut heard, mut kept): (BTreeSet<Vec<u8>>, [Vec<Vec<u8>>; 2]) = Default::default();
    let header = Header { flags: Flags(0), team: number, sender: HostId(1), incarnation: 77, sequence: 0 };
    let mut junk = codec::start(&header);
    junk[FLAGS_AT] = Flags::TAGGED;
    junk.resize(1100, 0x5a);
    let (begun, mut next, mut sent, mut bytes) = (Instant::now(), 0u64, 0u64, [0; 2048]);
    // One look a millisecond at what is due.
    while stop.recv_timeout(Duration::from_millis(1)) == Err(RecvTimeoutError::Timeout) {
        let due = (begun.elapsed().as_secs_f64() * per_s as f64) as u64;
        // At most what is due now: a machine that was busy does not catch up with a burst.
        next = next.max(due.saturating_sub(per_s / 20));
        while next < due {
            let link = (next % 2) as usize;
            junk[10..18].copy_from_slice(&next.to_le_bytes());
            let of_link = &kept[link];
            let datagram = match noise {
                Noise::Copies if !of_link.is_empty() => Some(&of_link[(next / 2) as usize % of_link.len()]),
                Noise::Junk => Some(&junk),
                _ => None,
            };
            sent += u64::from(datagram.is_some_and(|datagram| sender.send_to(datagram, groups[link]).is_ok()));
            next += 1;
        }
        for (ear, kept) in ears.iter().zip(&mut kept) {
            while let Ok(length) = ear.recv(&mut bytes) {
                if noise == Noise::Copies && kept.len() < 4000 && heard.insert(bytes[..length].to_vec()) {
                    kept.push(bytes[..length].to_vec());
                }
            }
        }
    }
    sent as f64 / begun.elapsed().as_secs_f64()
}

/// Records a team under noise. Returns the bytes a second of all its records.
fn recorded(noise: Noise, number: u16, per_s: u64, episodes: u32) -> f64 {
    let folder = TempDir::new().unwrap();
    let (file, groups) = team(folder.path(), number, episodes);
    let to = folder.path().join("records");
    let flags = ["launch", file.to_str().unwrap(), "--quiet", "--json", "--record", to.to_str().unwrap()];
    let (stop, stopped) = channel();
    let disturber = std::thread::spawn(move || disturb(noise, number, groups, per_s, &stopped));
    let output = murmurate(&flags).output().expect("it starts");
    drop(stop);
    let sent = disturber.join().unwrap();
    assert!(output.status.success(), "{noise:?}: {}", text(&output.stderr));
    let key = folder.path().join("team.key");
    let replay = run(&["replay", to.to_str().unwrap(), "--key-file", key.to_str().unwrap()]);
    let said = text(&replay.stdout);
    assert!(replay.status.success(), "{noise:?}: {said}{}", text(&replay.stderr));
    assert!(said.matches("equal, ").count() == 4 && !said.contains("up to"), "{noise:?}, to the end: {said}");
    let info: serde_json::Value =
        serde_json::from_str(&text(&run(&["record", "info", "--json", to.to_str().unwrap()]).stdout)).unwrap();
    let all = info["records"].as_array().unwrap();
    assert!(all.len() == records(&to).len() && all.iter().all(|one| one["dropped"] == 0), "{info}");
    let rates = all.iter().map(|one| one["bytes"].as_f64().unwrap() / one["duration_s"].as_f64().unwrap());
    let rate = rates.sum();
    println!(
        "{noise:?}: {sent:.0} datagrams a second, records of {:.1} kB/s in all, replayed to their end",
        rate / 1e3
    );
    rate
}

#[test]
fn junk_and_copies_of_datagrams_neither_end_a_record_nor_make_it_long() {
    let said = std::env::var("MURMURATE_RECORD_JUNK").unwrap_or_else(|_| "3000 1".to_owned());
    let (per_s, episodes) = said.split_once(' ').expect("a rate and a number of episodes");
    let (per_s, episodes) = (per_s.parse().unwrap(), episodes.parse().unwrap());
    let quiet = recorded(Noise::Quiet, 821, per_s, episodes);
    for (noise, number) in [(Noise::Junk, 822), (Noise::Copies, 823)] {
        let rate = recorded(noise, number, per_s, episodes);
        assert!(rate <= 2.0 * quiet, "{noise:?}: {rate} bytes a second, {quiet} in a quiet network");
    }
}
