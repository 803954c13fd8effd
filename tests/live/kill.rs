//! Deaths at any moment: every kind of process of a team that runs on real sockets. Motors stop in time, the next
//! episode runs, and nobody is left behind. `MURMURATE_KILLS=50` strikes at so many moments (an hour has room for 400).

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read};
use std::os::fd::AsFd;
use std::process::Stdio;
use std::time::{Duration, Instant};

use crate::alone;
use crate::beside;
use crate::crew::{Crew, Said, folder, report};
use crate::program::lateness::Lateness;
use crate::program::murmurate;
use murmurate_report::event::HostEvent;
use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::Signal;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Validity of a motor command (`actors::graph::COMMAND_VALIDITY`).
const VALID_S: f64 = 0.2;
/// A step of the World.
const STEP_S: f64 = 0.05;
/// Longest silence of the state server before robots stop.
const SILENCE_S: f64 = 1.0;
/// Allowed lateness of a process; that of the World and that of the machine are measured.
const SLACK_S: f64 = 0.02;

/// Time for which a process is halted, or dead before its restart.
const HALT: Duration = Duration::from_millis(1500);

pub const ROBOTS: [u16; 3] = [0, 1, 2];

/// Agents, World and state server, each a process of its own.
pub fn team(number: u16) -> String {
    let mut text = format!("team = {number}\nkey_file = \"team.key\"\nepisodes = 10000\n\n[deployment]\n");
    text += "mode = \"apart\"\nrobots = 3\nplacement = \"drive\"\nstepping = \"seeded\"\n\n";
    for robot in ROBOTS {
        text += &format!("[[deployment.host]]\nname = \"agent-{robot}\"\nagents = [[{robot}]]\n\n");
    }
    text += "[[deployment.host]]\nname = \"world\"\nsimulates = [0, 1, 2]\n\n";
    text += "[[deployment.host]]\nname = \"server\"\nstate_server = true\n\n";
    let links = [
        ("loopback", "loopback", "\"latent\", \"reading\", \"heartbeat\", \"mode\", \"stop\""),
        ("infra", "access-point", "\"motor-command\""),
    ];
    for (name, medium, carries) in links {
        text += &format!("[[deployment.link]]\nname = \"{name}\"\nmedium = \"{medium}\"\ncarries = [{carries}]\n\n");
    }
    for (name, last) in [("loopback", 1), ("infra", 2)] {
        let group = format!("239.255.79.{last}:{}", 40_000 + number);
        text += &format!("[link.{name}]\ninterface = \"lo\"\ngroup = \"{group}\"\n\n");
    }
    text
}

/// Starts the whole team, up to its first running episode.
fn launched(file: &str) -> (Crew, u32) {
    let file = file.to_owned();
    let mut crew = Crew::new(move |host| {
        let mut args = vec!["host", &file, "--host", host, "--json"];
        if host == "world" {
            args.extend(["--trajectories", "/dev/stdout"]);
        }
        let mut command = murmurate(&args);
        command.env_remove("MURMURATE_KILLS");
        command
    });
    let hosts = ["agent-0", "agent-1", "agent-2", "world", "server"];
    hosts.iter().for_each(|host| crew.start(host));
    crew.ready(&hosts);
    let episode = crew.runs_after(None, &ROBOTS);
    (crew, episode)
}

/// Offset of the World's clock from this process's, under the assumption that the fastest line takes no time.
struct Clocks {
    origin: Option<Instant>,
}

impl Clocks {
    fn see(&mut self, time_s: f64, heard: Instant) -> Instant {
        let span = Duration::from_secs_f64(time_s);
        let origin = heard.checked_sub(span).expect("the machine is older than the test");
        self.origin = Some(self.origin.map_or(origin, |before| before.min(origin)));
        self.origin.expect("it is known now") + span
    }
}

/// Result of one kill.
struct Stroke {
    victim: String,
    signal: Signal,
    /// Times after it at which its robots were last driven, and first were not \[s\].
    driven_s: f64,
    stood_s: f64,
}

/// Waits for a random number of steps and signals the victim while its robots are driven. Returns the result.
fn strike(crew: &mut Crew, episode: u32, victim: &str, signal: Signal, random: &mut ChaCha8Rng) -> Stroke {
    let robots: Vec<u16> = match victim.strip_prefix("agent-") {
        Some(robot) => vec![robot.parse().expect("a robot's number")],
        None => ROBOTS.to_vec(),
    };
    let mut clocks = Clocks { origin: None };
    let (mut steps, mut now) = (random.random_range(1..30u32), f64::NAN);
    crew.row("a moment at which they are driven", |row, heard| {
        clocks.see(row.time_s, heard);
        if row.time_s != now {
            (now, steps) = (row.time_s, steps.saturating_sub(1));
        }
        (steps == 0 && robots.contains(&row.robot) && row.is_driven()).then_some(())
    });
    // Anywhere within a step.
    crew.pass(Duration::from_micros(random.random_range(0..50_000)));
    let struck = crew.signal(victim, signal);
    let stroke = |driven_s, stood_s| Stroke { victim: victim.to_owned(), signal, driven_s, stood_s };
    let stroke = if victim == "world" {
        // Its motors are halted or dead with it. They must not start later from earlier commands.
        crew.pass(HALT);
        stroke(0.0, 0.0)
    } else {
        let (mut driven_s, mut stood_s) = (0.0, None);
        let since = |at: Instant| at.saturating_duration_since(struck).as_secs_f64();
        crew.row("they stand", |row, heard| {
            let at_s = since(clocks.see(row.time_s, heard));
            if at_s > 0.0 && robots.contains(&row.robot) {
                if row.is_driven() {
                    (driven_s, stood_s) = (at_s, None);
                } else {
                    stood_s = stood_s.or(Some(at_s));
                }
            }
            (at_s > HALT.as_secs_f64()).then_some(())
        });
        stroke(driven_s, stood_s.unwrap_or(f64::INFINITY))
    };
    if signal == Signal::SIGSTOP {
        crew.signal(victim, Signal::SIGCONT);
    } else {
        assert_eq!(crew.ended(victim), None, "{victim} was killed");
        crew.start(victim);
    }
    if victim == "world" {
        let (mut first, mut seen) = (f64::NAN, 0);
        crew.row("the World's first step", |row, _| {
            if seen == 0 {
                first = row.time_s;
            }
            seen += 1;
            assert!(row.time_s != first || !row.is_driven(), "robot {} starts by itself: {row:?}", row.robot);
            (seen == ROBOTS.len()).then_some(())
        });
    }
    crew.runs_after(Some(episode), &ROBOTS);
    stroke
}

#[test]
fn motors_stop_in_time_whichever_process_is_killed_and_the_next_episode_runs() {
    let _alone = alone();
    let (_folder, file) = folder(&team(781));
    let (mut crew, mut episode) = launched(&file);
    let kinds = [
        ("agent-1", Signal::SIGKILL),
        ("server", Signal::SIGKILL),
        ("world", Signal::SIGKILL),
        ("agent-2", Signal::SIGSTOP),
        ("server", Signal::SIGSTOP),
        ("world", Signal::SIGSTOP),
    ];
    let moments = std::env::var("MURMURATE_KILLS").map_or(kinds.len(), |kills| kills.parse().expect("a number"));
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut strokes = Vec::new();
    for moment in 0..moments {
        let (victim, signal) = kinds[moment % kinds.len()];
        let machine = Lateness::watch();
        let stroke = strike(&mut crew, episode, victim, signal, &mut random);
        let silence_s = if victim == "server" { SILENCE_S + STEP_S } else { 0.0 };
        let worst_s = silence_s + VALID_S + SLACK_S + machine.end().as_secs_f64();
        let Stroke { driven_s, stood_s, .. } = stroke;
        report(&format!(
            "{moment}: {signal} of {victim} in episode {episode}: driven until {:.0} ms after, stood {:.0} ms after",
            driven_s * 1e3,
            stood_s * 1e3
        ));
        assert!(driven_s <= worst_s, "{victim}: a robot was driven {driven_s} s after {signal}");
        assert!(stood_s <= worst_s + 2.0 * STEP_S, "{victim}: its robots stand only {stood_s} s after {signal}");
        strokes.push(stroke);
        episode = crew.runs_after(None, &ROBOTS);
    }
    for (victim, signal) in kinds {
        let like = strokes.iter().filter(|stroke| (&*stroke.victim, stroke.signal) == (victim, signal));
        let latest = like.clone().map(|stroke| stroke.stood_s).fold(0.0, f64::max);
        report(&format!("{signal} of {victim}: {} times, robots stood within {:.0} ms", like.count(), latest * 1e3));
    }
}

/// Ends a host in the middle of a running episode after this one; returns that episode.
fn told_to_end(crew: &mut Crew, after: Option<u32>, victim: &str, team_stands: Duration) -> u32 {
    let (mut waiting, mut now) = (ROBOTS.to_vec(), None);
    let episode = crew.row("all are driven in a running episode", |row, _| {
        if now != Some(row.episode) || row.phase != "Running" {
            (now, waiting) = (Some(row.episode), ROBOTS.to_vec());
        }
        if row.phase == "Running" && row.is_driven() && after.is_none_or(|after| row.episode > after) {
            waiting.retain(|robot| *robot != row.robot);
        }
        waiting.is_empty().then_some(row.episode)
    });
    let machine = Lateness::watch();
    let struck = crew.signal(victim, Signal::SIGTERM);
    assert_eq!(crew.ended(victim), Some(0), "{victim} ends cleanly");
    let until = struck + Duration::from_millis(2500);
    let mut last = BTreeMap::new();
    crew.until("it is waited for", |heard| {
        match &heard.said {
            Said::Row(row) if row.is_driven() => {
                last.insert(row.robot, heard.at.saturating_duration_since(struck));
            }
            Said::Event(HostEvent::Episode(ended)) => assert!(ended.episode < episode, "it is used up: {ended:?}"),
            Said::Log(line) => assert!(!line.contains("emergency stop"), "leaving is not stopping: {line}"),
            _ => {}
        }
        // The World's host prints nothing once it has ended.
        let closed = victim == "world" && heard.host == victim && matches!(heard.said, Said::Closed);
        (closed || Instant::now() >= until).then_some(())
    });
    crew.pass(until.saturating_duration_since(Instant::now()));
    report(&format!("SIGTERM of {victim} in episode {episode}: last driven after {last:.0?}"));
    let slack = Duration::from_secs_f64(STEP_S + SLACK_S) + machine.end();
    for (robot, after) in last {
        let own = victim == "world" || victim == format!("agent-{robot}");
        let bar = if own { Duration::from_millis(200) } else { team_stands };
        assert!(after <= bar + slack, "robot {robot} stands {after:?} after");
    }
    episode
}

#[test]
fn the_team_stops_and_waits_for_a_terminated_host_and_repeats_the_episode() {
    let _beside = beside();
    let (_folder, file) = folder(&team(783));
    let (mut crew, _) = launched(&file);
    let mut last = None;
    for victim in ["agent-1", "server", "world"] {
        // The last message of a state server takes at most half of its allowed silence.
        let episode = told_to_end(&mut crew, last, victim, Duration::from_millis(500));
        last = Some(episode);
        crew.start(victim);
        crew.ready(&[victim]);
        let next = crew.row("all run again", |row, _| (row.phase == "Running").then_some(row.episode));
        assert_eq!(next, episode, "the same episode, after {victim}");
        crew.until("it has its result", |heard| match &heard.said {
            Said::Event(HostEvent::Episode(ended)) => (ended.episode == episode).then_some(()),
            _ => None,
        });
    }
}

#[test]
fn no_process_outlives_a_killed_launch() {
    // Processes that another test starts meanwhile would inherit the pipe, too.
    let _alone = alone();
    let (_folder, file) = folder(&team(782));
    // Launch and all its processes inherit the pipe, so it is closed when the last of them has ended.
    let (mut all_gone, held) = std::io::pipe().expect("a pipe");
    let mut command = murmurate(&["launch", &file, "--json"]);
    command.env_remove("MURMURATE_KILLS").stdout(Stdio::null()).stderr(Stdio::piped());
    fcntl(&held, FcntlArg::F_SETFD(FdFlag::empty())).expect("it can be inherited");
    let mut launch = command.spawn().expect("it starts");
    drop(held);
    let lines = BufReader::new(launch.stderr.take().expect("it is piped")).lines();
    assert!(lines.map_while(Result::ok).any(|line| line.starts_with("5 processes run")), "it runs");
    launch.kill().expect("it runs");
    launch.wait().expect("it is ours");
    let mut polled = [PollFd::new(all_gone.as_fd(), PollFlags::POLLIN)];
    let ready = poll(&mut polled, PollTimeout::from(10_000u16)).expect("it can be polled");
    assert_eq!(ready, 1, "a host goes on although its launch is dead");
    assert_eq!(all_gone.read(&mut [0; 1]).expect("it can be read"), 0);
}
