//! Floods of junk, one kind at a time, at every group of a running team on real sockets. Control ticks meet their
//! deadline, no episode is aborted, memory does not grow, and a second after the flood there is no trace of it.
//!
//! `MURMURATE_JUNK=full` sends each kind at 30 000 and at 100 000 datagrams a second for 10 s; the default is 30 000
//! for 1 s. It prints a table of rates, processor time and late ticks.

use std::net::{Ipv4Addr, SocketAddrV4};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::alone;
use crate::crew::{Crew, Said, folder, report};
use crate::junk;
use crate::program::lateness::Lateness;
use crate::program::skip::skip;
use crate::program::{murmurate, text};
use murmurate::scenario::judge::Verdict;
use murmurate_report::event::HostEvent;

const HOSTS: [&str; 4] = ["agent-0", "agent-1", "agent-2", "world"];
const ROBOTS: [u16; 3] = [0, 1, 2];
/// Rate up to which no tick may be late \[datagrams/s\].
const HARMLESS_PER_S: u64 = 30_000;
const FLOOD_PER_S: u64 = 100_000;

/// Whether a process has a higher priority than normal ones.
fn has_priority(crew: &Crew, host: &str) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", crew.pid(host))).expect("it runs");
    // Fields after the name in parentheses: niceness is the 19th field in proc(5), and the name is the second.
    let rest = stat.rsplit_once(')').expect("a name").1;
    rest.split_whitespace().nth(16).expect("a niceness").starts_with('-')
}

/// Returns the processor time of a process so far \[s\].
fn cpu_s(crew: &Crew, host: &str) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", crew.pid(host))).expect("it runs");
    let rest = stat.rsplit_once(')').expect("a name").1;
    // User and system time are the 14th and 15th field, in hundredths of a second (proc(5)).
    rest.split_whitespace().skip(11).take(2).map(|ticks| ticks.parse::<f64>().expect("a number") / 100.0).sum()
}

/// Memory of a process \[KiB\].
fn resident_kib(crew: &Crew, host: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", crew.pid(host))).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("it is told");
    line.split_whitespace().next().expect("a number").parse().expect("a number")
}

/// Output within a time.
#[derive(Debug, Default)]
struct Seen {
    late: usize,
    aborted: usize,
    steps: usize,
}

fn watch(crew: &Crew, span: Duration) -> Seen {
    let (until, mut seen) = (Instant::now() + span, Seen::default());
    crew.until("the time is over", |heard| {
        match &heard.said {
            Said::Log(line) if line.contains("late") || line.contains("too old") || line.contains("silent") => {
                report(&format!("{}: {line}", heard.host));
                seen.late += 1;
            }
            Said::Event(HostEvent::Episode(episode)) if episode.verdict == Verdict::Aborted => seen.aborted += 1,
            Said::Row(row) if row.robot == 0 => seen.steps += 1,
            _ => {}
        }
        (heard.at >= until).then_some(())
    });
    seen
}

/// Starts a team; returns its folder and file, its groups and its number, too.
fn team() -> (Crew, (tempfile::TempDir, String), [SocketAddrV4; 2], u16) {
    let number = 791;
    let groups = [1, 2].map(|last| SocketAddrV4::new(Ipv4Addr::new(239, 255, 81, last), 40_791));
    let links: String = ["loopback", "infra"]
        .iter()
        .zip(groups)
        .map(|(link, group)| format!("[link.{link}]\ninterface = \"lo\"\ngroup = \"{group}\"\n"))
        .collect();
    let head = format!("team = {number}\nkey_file = \"team.key\"\nmode = \"offboard\"\nrobots = 3\nepisodes = 10000\n");
    let (folder, file) = folder(&(head + &links));
    let path = file.clone();
    let mut crew = Crew::new(move |host| {
        let mut args = vec!["host", &file, "--host", host, "--json"];
        if host == "world" {
            args.extend(["--trajectories", "/dev/stdout"]);
        }
        // With the priority of its service (packaging/), where this is permitted.
        let mut command = Command::new("nice");
        command.args(["-n", "-10", env!("CARGO_BIN_EXE_murmurate")]).args(&args).stdin(Stdio::null());
        command.env_remove("MURMURATE_JUNK").env("MURMURATE_LOG", "warn");
        command
    });
    HOSTS.iter().for_each(|host| crew.start(host));
    crew.ready(&HOSTS);
    crew.runs_after(None, &ROBOTS);

    (crew, (folder, path), groups, number)
}

/// Stops the team, by an operator with high priority; returns the time until all robots had confirmed \[s\].
fn stop(file: &str) -> f64 {
    let mut command = Command::new("nice");
    command.args(["-n", "-10", env!("CARGO_BIN_EXE_murmurate"), "stop", file, "--json"]);
    let output = command.env_remove("MURMURATE_JUNK").stdin(Stdio::null()).output().expect("it starts");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    said["took_s"].as_f64().expect("it took")
}

fn go_on(file: &str) {
    for words in [&["stop", file, "--rearm"][..], &["resume", file]] {
        let output = murmurate(words).env_remove("MURMURATE_JUNK").output().expect("it starts");
        assert_eq!(output.status.code(), Some(0), "{words:?}: {}", text(&output.stderr));
    }
}

#[test]
fn a_running_team_withstands_floods_of_junk() {
    let _alone = alone();
    let full = std::env::var("MURMURATE_JUNK").is_ok_and(|what| what == "full");
    let span = Duration::from_secs(if full { 10 } else { 1 });
    let rates = if full { vec![HARMLESS_PER_S, FLOOD_PER_S] } else { vec![HARMLESS_PER_S] };
    let (crew, (_folder, file), groups, number) = team();
    let judged = has_priority(&crew, "world");
    let used = |before: f64| HOSTS.iter().map(|host| cpu_s(&crew, host)).sum::<f64>() - before;
    let quiet = watch(&crew, span);
    report("kind       asked/s  sent/s  CPU of 4 hosts  late ticks  given up  World steps  late after  stop confirmed");
    for (kind, rate) in junk::KINDS.into_iter().flat_map(|kind| rates.iter().map(move |rate| (kind, *rate))) {
        let what = junk::junk(kind, groups, number);
        // Ignore the output meanwhile.
        crew.pass(Duration::from_millis(10));
        let before = HOSTS.map(|host| resident_kib(&crew, host));
        let sender = junk::Sender::start(groups, &what, rate);
        let begun = used(0.0);
        let seen = watch(&crew, span);
        let cpu = used(begun) / span.as_secs_f64();
        let sent = sender.stop();
        watch(&crew, Duration::from_secs(1));
        let after = watch(&crew, Duration::from_secs(1));
        let (sender, machine) = (junk::Sender::start(groups, &what, rate), Lateness::watch());
        let took_s = stop(&file);
        sender.stop();
        let machine_s = machine.end().as_secs_f64();
        go_on(&file);
        crew.runs_after(None, &ROBOTS);
        assert!(took_s <= 1.0 + machine_s, "under {kind:?} at {rate}/s a stop is confirmed after {took_s} s");
        let name = format!("{kind:?}");
        let Seen { late, aborted, steps } = seen;
        report(&format!(
            "{name:10} {rate:7} {sent:7.0} {cpu:15.2} {late:11} {aborted:9} {steps:12} {:11} {took_s:13.3} s",
            after.late
        ));
        assert_eq!(aborted, 0, "{kind:?} has ended an episode");
        for ((host, before), after) in HOSTS.iter().zip(before).zip(HOSTS.map(|host| resident_kib(&crew, host))) {
            assert!(after <= before + 2048, "{host} has grown from {before} to {after} KiB");
        }
        if judged && rate <= HARMLESS_PER_S {
            // On a shared machine with a debug build, single late ticks are no defect.
            let allowed = quiet.late + if full { 0 } else { 2 };
            assert!(late <= allowed, "{late} late ticks under {kind:?}, {} without", quiet.late);
            assert!(steps * 10 >= quiet.steps * 9, "the World has made {steps} steps, {} without", quiet.steps);
        }
    }
    let episode = crew.runs_after(None, &ROBOTS);
    report(&format!("episode {episode} runs"));
    if !judged {
        skip("priority", "late ticks are not judged: hosts may not come before the sender here, which needs root");
    }
}
