//! Rosters of a team that runs: keys are rotated and members are added, revoked and replaced, and no episode is lost
//! but that of a revoked robot.

use std::fs;
use std::net::{Ipv4Addr, UdpSocket};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use murmurate::messages::ids::HostId;
use murmurate::net::protocol::codec::{self, Flags, Header};
use murmurate_report::event::HostEvent;
use nix::sys::signal::Signal;

use crate::alone;
use crate::crew::{Crew, Said, folder, report};
use crate::kill::{self, ROBOTS};
use crate::program::{murmurate, run, text};

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
        let mut written = kill::team(TEAM).replace("\"team.key\"", "\"keys/operator-1.key\"");
        written = format!("confidential = true\n{}", written.replace("placement = \"drive\"", "placement = \"exact\""));
        for host in HOSTS {
            written += &format!("[host.{host}]\nkey_file = \"keys/{host}.key\"\n\n");
        }
        let (folder, file) = folder(&written);
        let keys = folder.path().join("keys");
        assert_eq!(run(&["key", "new", &file, "--out", &keys.to_string_lossy()]).status.code(), Some(0));
        let of = file.clone();
        let mut crew = Crew::new(move |host| {
            let mut command = murmurate(&["host", &of, "--host", host, "--json"]);
            if host == "world" {
                command.args(["--trajectories", "/dev/stdout"]);
            }
            command
        });
        HOSTS.iter().for_each(|host| crew.start(host));
        crew.ready(&HOSTS);
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

#[test]
fn keys_are_rotated_and_members_added_revoked_and_replaced_while_a_team_runs() {
    let _alone = alone();
    let mut team = Team::start();
    team.goes_on(&ROBOTS);
    // A laptop that will miss all changes.
    let stale = team.folder.path().join("stale.key");
    fs::copy(team.key("operator-1.key"), &stale).expect("it can be copied");
    let stale = stale.to_string_lossy().into_owned();

    // Rotation: beyond the time for which the keys before it are valid.
    let rotation_s = team.change(&["rotate"], 2);
    team.loses_nothing_for(Duration::from_secs(12));
    // A new operator, and its end.
    let addition_s = team.change(&["add", "operator-2"], 3);
    let second = team.key("operator-2.key").to_string_lossy().into_owned();
    team.goes_on(&ROBOTS);
    team.succeeds(&["stop", &team.file, "--key-file", &second, "--json"]);
    assert_eq!(team.aborted(), "emergency stop");
    team.succeeds(&["stop", &team.file, "--rearm", "--key-file", &second]);
    team.succeeds(&["resume", &team.file, "--key-file", &second]);
    team.goes_on(&ROBOTS);
    let revocation_s = team.change(&["revoke", "operator-2"], 4);
    let refused = run(&["stop", &team.file, "--key-file", &second, "--json"]);
    assert_eq!(refused.status.code(), Some(1), "{}", text(&refused.stdout));
    team.goes_on(&ROBOTS);
    // The laptop gets the roster from the hosts.
    let began = Instant::now();
    team.succeeds(&["stop", &team.file, "--key-file", &stale, "--json"]);
    let laptop = began.elapsed();
    assert_eq!(team.aborted(), "emergency stop");
    team.succeeds(&["stop", &team.file, "--rearm"]);
    team.succeeds(&["resume", &team.file]);
    team.goes_on(&ROBOTS);

    // A robot is revoked, and replaced.
    let robot_s = team.change(&["revoke", "agent-1"], 5);
    assert_eq!(team.aborted(), "robot 1 was revoked and may move uncontrolled");
    let mut driven = 0;
    let until = Instant::now() + Duration::from_millis(1500);
    let settled = until - Duration::from_millis(1000);
    team.crew.until("the team stands", |heard| {
        if let Said::Row(row) = &heard.said
            && heard.at >= settled
            && row.is_driven()
        {
            driven += 1;
        }
        (heard.at >= until).then_some(())
    });
    assert_eq!(driven, 0, "the team stands");
    team.crew.signal("agent-1", Signal::SIGKILL);
    team.crew.ended("agent-1");
    let root = team.key("root.key").to_string_lossy().into_owned();
    team.succeeds(&["key", "add", "agent-1", "--root", &root]);
    team.crew.start("agent-1");
    team.crew.ready(&["agent-1"]);
    let roster = team.key("6.roster").to_string_lossy().into_owned();
    team.succeeds(&["key", "spread", &team.file, &roster]);
    team.goes_on(&ROBOTS);

    // A host that starts again does not go back to an older roster.
    team.restart("agent-0");
    let (old, present) = (fs::read(team.key("5.roster")).expect("a roster"), fs::read(team.key("6.roster")));
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).expect("a socket");
    let interface: socket2::Socket = socket.try_clone().expect("a copy").into();
    interface.set_multicast_if_v4(&Ipv4Addr::LOCALHOST).expect("the loopback interface");
    let header = Header { flags: Flags(0), team: TEAM, sender: HostId(1), incarnation: 5, sequence: 0 };
    for _ in 0..50 {
        let datagram = codec::with_roster(&header, &old);
        socket.send_to(&datagram, (Ipv4Addr::new(239, 255, 79, 1), 40_000 + TEAM)).expect("it is sent");
    }
    team.goes_on(&ROBOTS);
    assert_eq!(team.kept("agent-0"), present.expect("a roster"));
    report(&format!(
        "rosters on all hosts after: rotation {rotation_s:.2} s, new operator {addition_s:.2} s, operator revoked \
         {revocation_s:.2} s, robot revoked {robot_s:.2} s; a stop by a laptop that had missed three {laptop:.2?}"
    ));
}
