//! A relay without the key between robots and their motors: commands that it delays drive no robot.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Stdio};
use std::time::Duration;

use murmurate::net::protocol::codec::VERSION;
use murmurate_report::event::HostEvent;

use crate::beside;
use crate::crew::{Said, report};
use crate::stop::in_full;
use crate::stop::team::{Case, Running};

/// Process of the relay.
struct Relay {
    child: Child,
    tell: ChildStdin,
    hear: BufReader<ChildStdout>,
}

impl Relay {
    fn start(team: &Running) -> Relay {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/live/stop/relay.py");
        let mut command = team.lab.command("relay", "python3");
        command.args([script, "left", "right", &VERSION.to_string()]).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("there is python3");
        let (tell, hear) = (child.stdin.take().expect("it is piped"), child.stdout.take().expect("it is piped"));
        let mut relay = Relay { child, tell, hear: BufReader::new(hear) };
        relay.answer();
        relay
    }

    fn answer(&mut self) -> String {
        let mut line = String::new();
        self.hear.read_line(&mut line).expect("it answers");
        line.trim().to_owned()
    }

    /// Sends a command; returns the number of frames that the relay holds after it.
    fn tell(&mut self, command: &str) -> usize {
        writeln!(self.tell, "{command}").expect("it listens");
        self.answer().parse().expect("a number")
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn relayed() -> Option<(Running, Relay)> {
    let team = Case { mode: "onboard-adhoc", file: "onboard-adhoc", unicast: false, relayed: true }.start()?;
    let relay = Relay::start(&team);
    Some((team, relay))
}

/// Delays commands while the team runs, stops the team, and releases them after this time: while it is stopped, or
/// while it is held.
fn released_after(team: &mut Running, relay: &mut Relay, held: Duration, rearmed: bool) {
    team.driven();
    relay.tell("hold");
    team.crew.pass(Duration::from_millis(400));
    team.succeeds(&["stop"]);
    if rearmed {
        team.succeeds(&["stop", "--rearm"]);
    }
    team.crew.pass(held);
    let kept = relay.tell("pass");
    assert!(kept >= 20, "{kept} commands were held back");
    relay.tell("release 0");
    team.nobody_moves("held back and released");
    if !rearmed {
        team.succeeds(&["stop", "--rearm"]);
    }
    team.succeeds(&["resume"]);
    report(&format!(
        "{kept} commands, released after {held:?} {}: nobody moved",
        if rearmed { "held" } else { "stopped" }
    ));
}

/// Delays commands without a stop, while those with a piggybacked report pass: the older ones are refused.
fn released_beside_reports(team: &mut Running, relay: &mut Relay) {
    team.driven();
    let before = late(team);
    relay.tell("hold-bare");
    team.crew.pass(Duration::from_millis(1500));
    let released = relay.tell("release 500") as u64;
    assert!(released >= 20, "{released} commands were held back");
    // Counts are reported once a second.
    late(team);
    late(team);
    let refused = late(team) - before;
    relay.tell("pass");
    assert!(refused >= released, "{refused} of {released} were refused");
    report(&format!("{released} commands, released after 0.5 s beside reports: all refused"));
}

/// Delays commands before a stop and releases them after the resume, beside newer ones: all are refused.
fn released_after_a_resume(team: &mut Running, relay: &mut Relay) {
    team.driven();
    relay.tell("hold");
    team.crew.pass(Duration::from_millis(400));
    team.succeeds(&["stop"]);
    team.succeeds(&["stop", "--rearm"]);
    relay.tell("pass");
    team.succeeds(&["resume"]);
    team.driven();
    let before = late(team);
    let released = relay.tell("release 500") as u64;
    late(team);
    late(team);
    let refused = late(team) - before;
    assert!(released >= 20 && refused >= released, "{refused} of {released} were refused");
    report(&format!("{released} commands of before a stop, released after the resume: all refused"));
}

/// Returns the number of datagrams that the World's host has refused as late.
fn late(team: &Running) -> u64 {
    team.crew.until("the World's host tells its counts", |heard| match &heard.said {
        Said::Event(HostEvent::Counted(counted)) if heard.host == "world" => Some(counted.links.late),
        _ => None,
    })
}

#[test]
fn commands_that_a_relay_delays_drive_no_robot_and_jitter_loses_nothing() {
    let _beside = beside();
    let Some((mut team, mut relay)) = relayed() else { return };
    team.driven();
    let before = late(&team);
    relay.tell("jitter 100");
    team.crew.pass(Duration::from_secs(5));
    assert_eq!(late(&team), before, "jitter of 100 ms loses nothing");
    relay.tell("pass");
    released_beside_reports(&mut team, &mut relay);
    released_after(&mut team, &mut relay, Duration::from_secs(1), false);
    released_after_a_resume(&mut team, &mut relay);
}

#[test]
fn commands_that_a_relay_delays_for_minutes_drive_no_robot() {
    if !in_full("holding back for minutes") {
        return;
    }
    let _beside = beside();
    let Some((mut team, mut relay)) = relayed() else { return };
    for (held_s, rearmed) in
        [(1, false), (1, true), (8, false), (8, true), (45, false), (45, true), (300, false), (300, true)]
    {
        released_after(&mut team, &mut relay, Duration::from_secs(held_s), rearmed);
    }
}
