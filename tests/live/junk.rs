//! Sender of junk: datagrams at a given rate, or as fast as it can, to the groups of a team.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use murmurate::net::protocol::codec::VERSION;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Kind of the datagrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Random bytes, or a header of the team with an invalid length or version.
    Malformed,
    /// In the team's format, with tags of another key.
    WrongKey,
    /// The team's own datagrams, repeated.
    Replayed,
}

pub const KINDS: [Kind; 3] = [Kind::Malformed, Kind::WrongKey, Kind::Replayed];
/// Number of different datagrams of one kind.
const DIFFERENT: u16 = 64;

/// Returns junk for the `groups` of the team with this number. Replays are datagrams captured within at most a second.
pub fn junk(kind: Kind, groups: [SocketAddrV4; 2], team: u16) -> [Vec<Vec<u8>>; 2] {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut bytes = |length: usize| (0..length).map(|_| random.random()).collect::<Vec<u8>>();
    let looks = |mut bytes: Vec<u8>, sender: u16, version: u8| {
        bytes[..2].copy_from_slice(&[version, 1]);
        bytes[2..4].copy_from_slice(&team.to_le_bytes());
        bytes[4..6].copy_from_slice(&sender.to_le_bytes());
        bytes
    };
    groups.map(|group| match kind {
        Kind::Malformed => (0..DIFFERENT)
            .map(|n| match n % 4 {
                0 => bytes(20 + 8 * usize::from(n)),
                1 => looks(bytes(200), n % 5, 99),
                2 => looks(bytes(20), n % 5, VERSION),
                _ => looks(bytes(1300), n % 5, VERSION),
            })
            .collect(),
        Kind::WrongKey => (0..DIFFERENT).map(|n| looks(bytes(200), n % 5, VERSION)).collect(),
        Kind::Replayed => overhear(group),
    })
}

fn overhear(group: SocketAddrV4) -> Vec<Vec<u8>> {
    let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::DGRAM, None).expect("a socket");
    socket.set_reuse_address(true).expect("an option");
    socket.set_reuse_port(true).expect("an option");
    socket.bind(&SocketAddr::V4(group).into()).expect("a group");
    socket.join_multicast_v4(group.ip(), &Ipv4Addr::LOCALHOST).expect("a group");
    socket.set_read_timeout(Some(Duration::from_millis(100))).expect("an option");
    let (socket, until, mut buffer) = (UdpSocket::from(socket), Instant::now() + Duration::from_secs(1), [0; 2048]);
    let mut heard = Vec::new();
    while heard.len() < usize::from(DIFFERENT) && Instant::now() < until {
        heard.extend(socket.recv(&mut buffer).ok().map(|length| buffer[..length].to_vec()));
    }
    assert!(!heard.is_empty(), "the team says nothing on {group}");
    heard
}

/// Threads that send until stopped.
pub struct Sender {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<f64>>,
}

impl Sender {
    /// Sends to the groups in turn, `rate_per_s` datagrams together. One thread sends 50 000 a second at the most.
    pub fn start(groups: [SocketAddrV4; 2], junk: &[Vec<Vec<u8>>; 2], rate_per_s: u64) -> Sender {
        let stop = Arc::new(AtomicBool::new(false));
        let threads = rate_per_s.div_ceil(50_000);
        let one = |_| {
            let (stop, junk) = (Arc::clone(&stop), junk.clone());
            thread::spawn(move || babble(groups, &junk, rate_per_s / threads, &stop))
        };
        Sender { threads: (0..threads).map(one).collect(), stop }
    }

    /// Stops sending; returns the rate \[1/s\].
    pub fn stop(self) -> f64 {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.into_iter().map(|thread| thread.join().expect("it stops")).sum()
    }
}

fn babble(groups: [SocketAddrV4; 2], junk: &[Vec<Vec<u8>>; 2], rate_per_s: u64, stop: &AtomicBool) -> f64 {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let began = Instant::now();
    let mut sent = 0u64;
    while !stop.load(Ordering::Relaxed) {
        let due = (began.elapsed().as_nanos() * u128::from(rate_per_s) / 1_000_000_000) as u64;
        // In bursts of at most a millisecond: a delayed thread does not catch up all at once.
        for _ in 0..due.saturating_sub(sent).min(rate_per_s / 1000) {
            let at = sent as usize % 2;
            let _ = socket.send_to(&junk[at][sent as usize / 2 % junk[at].len()], groups[at]);
            sent += 1;
        }
        thread::yield_now();
    }
    sent as f64 / began.elapsed().as_secs_f64()
}
