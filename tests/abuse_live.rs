//! Junk at a running team: as many datagrams as one core sends, up to 100 000 a second, at every group of a team on
//! real sockets. Control ticks stay inside their deadline, episodes end as they would, memory stays flat.
//! `MURMURATE_JUNK_S=10` sends for so many seconds.
#![cfg(target_os = "linux")]

mod crew;
mod program;

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crew::{Crew, Said, folder, report};
use murmurate::report::event::HostEvent;
use murmurate::scenario::judge::Verdict;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const RATE_PER_S: u64 = 100_000;
const HOSTS: [&str; 4] = ["agent-0", "agent-1", "agent-2", "world"];
const ROBOTS: [u16; 3] = [0, 1, 2];

/// Random bytes, and datagrams that look like the team's own with a tag that is none.
fn junk(team: u16) -> Vec<Vec<u8>> {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut bytes = |length: usize| (0..length).map(|_| random.random()).collect::<Vec<u8>>();
    let looks = |mut bytes: Vec<u8>, sender: u16| {
        bytes[..2].copy_from_slice(&[2, 1]);
        bytes[2..4].copy_from_slice(&team.to_le_bytes());
        bytes[4..6].copy_from_slice(&sender.to_le_bytes());
        bytes
    };
    (0..64u16).map(|n| if n % 2 == 0 { bytes(20 + 8 * usize::from(n)) } else { looks(bytes(200), n % 5) }).collect()
}

/// Sends until it is told to stop; how many a second.
fn babble(groups: [SocketAddr; 2], team: u16, stop: &AtomicBool) -> f64 {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let (junk, began) = (junk(team), Instant::now());
    let mut sent = 0u64;
    while !stop.load(Ordering::Relaxed) {
        let due = (began.elapsed().as_nanos() * u128::from(RATE_PER_S) / 1_000_000_000) as u64;
        // In bursts of a millisecond at the most: who was kept from sending does not make up for all of it at once.
        let burst = due.saturating_sub(sent).min(RATE_PER_S / 1000);
        for _ in 0..burst {
            let (what, group) = (&junk[sent as usize % junk.len()], groups[sent as usize % 2]);
            let _ = socket.send_to(what, group);
            sent += 1;
        }
        thread::yield_now();
    }
    sent as f64 / began.elapsed().as_secs_f64()
}

/// Whether a process comes before those that have no deadline.
fn has_priority(crew: &Crew, host: &str) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", crew.pid(host))).expect("it runs");
    // Behind the name in parentheses: proc(5) counts niceness as the 19th field, and the name is the second.
    let rest = stat.rsplit_once(')').expect("a name").1;
    rest.split_whitespace().nth(16).expect("a niceness").starts_with('-')
}

/// What a process has in memory \[KiB\].
fn resident_kib(crew: &Crew, host: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", crew.pid(host))).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("it is told");
    line.split_whitespace().next().expect("a number").parse().expect("a number")
}

#[test]
fn a_running_team_does_not_mind_junk() {
    let seconds = std::env::var("MURMURATE_JUNK_S").map_or(2.0, |given| given.parse().expect("a number"));
    let number = 791;
    let groups = [1, 2].map(|last| SocketAddr::from((Ipv4Addr::new(239, 255, 81, last), 40_791)));
    let links: String = ["loopback", "infra"]
        .iter()
        .zip(groups)
        .map(|(link, group)| format!("[link.{link}]\ninterface = \"lo\"\ngroup = \"{group}\"\n"))
        .collect();
    let head = format!("team = {number}\nkey_file = \"team.key\"\nmode = \"offboard\"\nrobots = 3\nepisodes = 10000\n");
    let (_folder, file) = folder(&(head + &links));
    let mut crew = Crew::new(move |host| {
        let mut args = vec!["host", &file, "--host", host, "--json"];
        if host == "world" {
            args.extend(["--trajectories", "/dev/stdout"]);
        }
        // As its service is started (packaging/), where this is permitted: before everything that has no deadline.
        let mut command = Command::new("nice");
        command.args(["-n", "-10", env!("CARGO_BIN_EXE_murmurate")]).args(&args).stdin(Stdio::null());
        command.env_remove("MURMURATE_JUNK_S").env("MURMURATE_LOG", "warn");
        command
    });
    HOSTS.iter().for_each(|host| crew.start(host));
    crew.ready(&HOSTS);
    crew.runs_after(None, &ROBOTS);

    // As long without as with, to compare.
    let watch = |crew: &Crew, span: Duration| {
        let (until, mut late, mut aborted, mut steps) = (Instant::now() + span, 0, 0, 0);
        crew.until("the time is over", |heard| {
            match &heard.said {
                Said::Log(line) if line.contains("late") || line.contains("too old") || line.contains("silent") => {
                    report(&format!("{}: {line}", heard.host));
                    late += 1;
                }
                Said::Event(HostEvent::Episode(episode)) if episode.verdict == Verdict::Aborted => aborted += 1,
                Said::Row(row) if row.robot == 0 => steps += 1,
                _ => {}
            }
            (heard.at >= until).then_some(())
        });
        (late, aborted, steps)
    };
    let span = Duration::from_secs_f64(seconds);
    let (late_before, ..) = watch(&crew, span);
    let before = HOSTS.map(|host| resident_kib(&crew, host));
    let stop = Arc::new(AtomicBool::new(false));
    let babbler = {
        let stop = Arc::clone(&stop);
        thread::spawn(move || babble(groups, number, &stop))
    };
    let (late, aborted, steps) = watch(&crew, span);
    let after = HOSTS.map(|host| resident_kib(&crew, host));
    stop.store(true, Ordering::Relaxed);
    let rate = babbler.join().expect("it stops");
    let episode = crew.runs_after(None, &ROBOTS);
    report(&format!(
        "{rate:.0} datagrams/s for {seconds} s: {late} late ticks or silences ({late_before} before), {aborted} \
         episodes given up, {steps} World steps; KiB {before:?} -> {after:?}; episode {episode} runs"
    ));
    assert_eq!(aborted, 0, "junk has ended an episode");
    for ((host, before), after) in HOSTS.iter().zip(before).zip(after) {
        assert!(after <= before + 2048, "{host} has grown from {before} to {after} KiB");
    }
    if !has_priority(&crew, "world") {
        return report("late ticks are not judged: hosts may not come before the sender here, which needs root");
    }
    assert!(late <= late_before + 1, "{late} late ticks under junk, {late_before} without");
    assert!(steps as f64 >= seconds * 20.0 * 0.9, "the World has made {steps} steps in {seconds} s");
}
