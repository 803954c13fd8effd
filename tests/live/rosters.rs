//! Rosters of a team that runs: keys are rotated and members are added, revoked and replaced, and no episode is lost
//! but that of a revoked robot.

use std::fs;
use std::net::{Ipv4Addr, UdpSocket};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use murmurate::messages::ids::HostId;
use murmurate::net::protocol::codec::{self, Flags, Header};
use murmurate::net::protocol::roster;
use murmurate_report::event::HostEvent;
use nix::sys::signal::Signal;

use crate::alone;
use crate::crew::{Crew, Said, of_members, report};
use crate::kill::{self, ROBOTS};
use crate::program::{run, text};

const TEAM: u16 = 797;
const HOSTS: [&str; 5] = ["agent-0", "agent-1", "agent-2", "world", "server"];

/// Team whose members have keys of their own, and encrypt.
struct Team {
    crew: Crew,
    file: String,
    folder: tempfile::TempDir,
}

impl Team {
    fn start() -> Team {
        let written = kill::team(TEAM).replace("placement = \"drive\"", "placement = \"exact\"");
        let (crew, folder, file) = of_members(&format!("confidential = true\n{written}"), &HOSTS);
        Team { crew, file, folder }
    }

    fn key(&self, name: &str) -> PathBuf {
        self.folder.path().join("keys").join(name)
    }

    /// Makes a roster by `key CHANGE [NAME]`, and spreads it. Returns how long that took, as the command says.
    fn change(&self, change: &[&str], number: u32) -> f64 {
        let root = self.key("root.key").to_string_lossy().into_owned();
        self.succeeds(&[&["key"], change, &["--root", &root]].concat());
        let roster = self.key(&format!("{number}.roster")).to_string_lossy().into_owned();
        let said = self.succeeds(&["key", "spread", &self.file, &roster, "--json"]);
        let said: serde_json::Value = serde_json::from_str(&said).expect("one object");
        assert_eq!((said["roster"].as_u64(), said["missing"].as_array().map(Vec::len)), (Some(number.into()), Some(0)));
        said["took_s"].as_f64().expect("a time")
    }

    fn succeeds(&self, args: &[&str]) -> String {
        let output = run(args);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Reads what hosts say until each of these robots was driven again, and fails if an episode is aborted meanwhile.
    fn goes_on(&self, robots: &[u16]) {
        let mut waiting = robots.to_vec();
        self.crew.until("robots are driven", |heard| {
            match &heard.said {
                Said::Event(HostEvent::Aborted { reason, .. }) => panic!("an episode is lost: {reason}"),
                Said::Row(row) => waiting.retain(|robot| !(*robot == row.robot && row.is_driven())),
                _ => {}
            }
            waiting.is_empty().then_some(())
        });
    }

    /// Reads what hosts say for this long, and fails if an episode is aborted meanwhile.
    fn loses_nothing_for(&self, time: Duration) {
        let until = Instant::now() + time;
        self.crew.until("time passes", |heard| {
            if let Said::Event(HostEvent::Aborted { reason, .. }) = &heard.said {
                panic!("an episode is lost: {reason}");
            }
            (heard.at >= until).then_some(())
        });
    }

    /// Waits until an episode is aborted; returns the reason.
    fn aborted(&self) -> String {
        self.crew.until("an episode is aborted", |heard| match &heard.said {
            Said::Event(HostEvent::Aborted { reason, .. }) => Some(reason.to_string()),
            _ => None,
        })
    }

    fn restart(&mut self, host: &str) {
        self.crew.signal(host, Signal::SIGKILL);
        self.crew.ended(host);
        self.crew.start(host);
        self.crew.ready(&[host]);
    }

    /// Returns the roster that a member has on disk.
    fn kept(&self, name: &str) -> Vec<u8> {
        let all = fs::read_dir(self.folder.path().join("keys")).expect("it is there");
        let kept = all.map(|file| file.expect("a file").path()).find(|path| {
            let file = path.file_name().expect("it has a name").to_string_lossy().into_owned();
            file.starts_with(&format!("{name}-")) && file.ends_with(".roster")
        });
        fs::read(kept.expect("it has kept one")).expect("it can be read")
    }
}

/// Rotates the keys, and adds and revokes an operator. Returns by when all hosts had each roster \[s\].
fn changes_without_a_loss(team: &Team) -> [f64; 3] {
    // Beyond the time for which the keys before it are valid.
    let rotated = team.change(&["rotate"], 2);
    team.loses_nothing_for(Duration::from_secs(12));
    let added = team.change(&["add", "operator-2"], 3);
    let second = team.key("operator-2.key").to_string_lossy().into_owned();
    team.goes_on(&ROBOTS);
    team.succeeds(&["stop", &team.file, "--key-file", &second, "--json"]);
    assert_eq!(team.aborted(), "emergency stop");
    team.succeeds(&["stop", &team.file, "--rearm", "--key-file", &second]);
    team.succeeds(&["resume", &team.file, "--key-file", &second]);
    team.goes_on(&ROBOTS);
    let revoked = team.change(&["revoke", "operator-2"], 4);
    let refused = run(&["stop", &team.file, "--key-file", &second, "--json"]);
    assert_eq!(refused.status.code(), Some(1), "{}", text(&refused.stdout));
    team.goes_on(&ROBOTS);
    [rotated, added, revoked]
}

/// Stops the team as an operator with an old key file, which gets the roster from the hosts. Returns how long it took.
fn stale_operator_stops(team: &Team, key_file: &Path) -> Duration {
    let began = Instant::now();
    team.succeeds(&["stop", &team.file, "--key-file", &key_file.to_string_lossy(), "--json"]);
    let took = began.elapsed();
    assert_eq!(team.aborted(), "emergency stop");
    team.succeeds(&["stop", &team.file, "--rearm"]);
    team.succeeds(&["resume", &team.file]);
    team.goes_on(&ROBOTS);
    took
}

/// Revokes a robot, and gives it a new key. Returns by when all other hosts had the roster without it \[s\].
fn robot_is_replaced(team: &mut Team) -> f64 {
    let took_s = team.change(&["revoke", "agent-1"], 5);
    assert_eq!(team.aborted(), "robot 1 was revoked and may move uncontrolled");
    let mut driven = 0;
    let until = Instant::now() + Duration::from_millis(1500);
    let settled = until - Duration::from_millis(1000);
    team.crew.until("the team stands", |heard| {
        let drives = matches!(&heard.said, Said::Row(row) if heard.at >= settled && row.is_driven());
        driven += u32::from(drives);
        (heard.at >= until).then_some(())
    });
    assert_eq!(driven, 0, "the team stands");
    team.crew.signal("agent-1", Signal::SIGKILL);
    team.crew.ended("agent-1");
    team.succeeds(&["key", "add", "agent-1", "--root", &team.key("root.key").to_string_lossy()]);
    team.crew.start("agent-1");
    team.crew.ready(&["agent-1"]);
    team.succeeds(&["key", "spread", &team.file, &team.key("6.roster").to_string_lossy()]);
    team.goes_on(&ROBOTS);
    took_s
}

/// Starts a host again, and repeats an older roster to it.
fn old_roster_is_refused(team: &mut Team) {
    team.restart("agent-0");
    let [old, present] = ["5.roster", "6.roster"].map(|name| fs::read(team.key(name)).expect("a roster"));
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).expect("a socket");
    let interface: socket2::Socket = socket.try_clone().expect("a copy").into();
    interface.set_multicast_if_v4(&Ipv4Addr::LOCALHOST).expect("the loopback interface");
    let header = Header { flags: Flags(0), team: TEAM, sender: HostId(1), incarnation: 5, sequence: 0 };
    for _ in 0..50 {
        let datagram = codec::with_roster(&header, &roster::pages(&old)[0]);
        socket.send_to(&datagram, (Ipv4Addr::new(239, 255, 79, 1), 40_000 + TEAM)).expect("it is sent");
    }
    team.goes_on(&ROBOTS);
    assert_eq!(team.kept("agent-0"), present);
}

#[test]
fn keys_are_rotated_and_members_added_revoked_and_replaced_while_a_team_runs() {
    let _alone = alone();
    let mut team = Team::start();
    team.goes_on(&ROBOTS);
    let stale = team.folder.path().join("stale.key");
    fs::copy(team.key("operator-1.key"), &stale).expect("it can be copied");
    let [rotated, added, revoked] = changes_without_a_loss(&team);
    let laptop = stale_operator_stops(&team, &stale);
    let robot = robot_is_replaced(&mut team);
    old_roster_is_refused(&mut team);
    report(&format!(
        "rosters on all hosts after: rotation {rotated:.2} s, new operator {added:.2} s, operator revoked \
         {revoked:.2} s, robot revoked {robot:.2} s; a stop by a laptop that had missed three {laptop:.2?}"
    ));
}
