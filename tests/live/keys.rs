//! An operator with another key than its team, with none, or with one too many: it is told so, and never a key.

use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tungstenite::Message;

use crate::beside;
use crate::crew::{Crew, folder};
use crate::kill::team;
use crate::program::{murmurate, run, text};
use crate::restarts::control;

/// Team whose host "world" runs, with or without a key, and what an operator may say to it.
struct Keyed {
    _folder: tempfile::TempDir,
    _crew: Crew,
    /// Team file with the right key, one without a key, and the path of another key.
    own: String,
    keyless: String,
    other_key: String,
}

impl Keyed {
    fn start(number: u16, has_key: bool) -> Keyed {
        let (folder, own) = folder(&team(number));
        let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        let (keyless, other_key) = (path("keyless.toml"), path("other.key"));
        std::fs::write(&keyless, team(number).replace("key_file = \"team.key\"\n", "")).expect("a folder");
        assert_eq!(run(&["key", "new", "--out", &other_key]).status.code(), Some(0));
        let file = if has_key { own.clone() } else { keyless.clone() };
        let mut crew = Crew::new(move |host| murmurate(&["host", &file, "--host", host, "--json"]));
        crew.start("world");
        crew.ready(&["world"]);
        Keyed { _folder: folder, _crew: crew, own, keyless, other_key }
    }

    /// Returns what a command says of its failure.
    fn fails(&self, args: &[&str]) -> String {
        let output = run(args);
        let said = format!("{}{}", text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(1), "{args:?}: {said}");
        for key in ["team.key", "other.key"] {
            let key = std::fs::read_to_string(self._folder.path().join(key)).expect("a key");
            assert!(!said.contains(key.trim()), "no key is shown");
        }
        said
    }
}

#[test]
fn a_stop_with_a_wrong_key_or_none_says_that_the_key_is_wrong() {
    let _beside = beside();
    let keyed = Keyed::start(785, true);
    for command in [&["stop"][..], &["stop", "--rearm"], &["resume"]] {
        let asked = |file: &str, more: &[&str]| keyed.fails(&[command, &[file], more].concat());
        let said = asked(&keyed.own, &["--key-file", &keyed.other_key]);
        assert!(said.contains("it has another key than this machine"), "{command:?}: {said}");
        let said = asked(&keyed.keyless, &[]);
        assert!(said.contains("it has a key, but this machine has none"), "{command:?}: {said}");
    }
    // In JSON as well.
    let said = keyed.fails(&["stop", &keyed.own, "--key-file", &keyed.other_key, "--json"]);
    assert!(said.contains("another key"), "{said}");
    let doctor = ["doctor", &keyed.own, "--host", "server", "--listen", "2", "--key-file", &keyed.other_key];
    let said = keyed.fails(&doctor);
    assert!(said.contains("of this team with another key") && said.contains("it has another key"), "{said}");
}

#[test]
fn a_stop_with_a_key_for_a_team_without_one_says_so_and_an_absent_team_is_no_matter_of_keys_alone() {
    let _beside = beside();
    let keyed = Keyed::start(786, false);
    let said = keyed.fails(&["stop", &keyed.own]);
    assert!(said.contains("it has no key, but this machine has one"), "{said}");
    let nobody = keyed.fails(&["stop", &keyed.own, "--set", "team=787"]);
    assert!(nobody.contains("nothing of this team is heard") && nobody.contains("look at the robot"), "{nobody}");
}

#[test]
fn a_confidential_team_is_stopped_by_who_encrypts_and_who_does_not_is_told_so() {
    let _beside = beside();
    let (_folder, file) = folder(&team(815).replacen("episodes", "confidential = true\nepisodes", 1));
    let (run_file, hosts) = (file.clone(), ["agent-0", "agent-1", "agent-2", "world", "server"]);
    let mut crew = Crew::new(move |host| murmurate(&["host", &run_file, "--host", host, "--json"]));
    hosts.iter().for_each(|host| crew.start(host));
    crew.ready(&hosts);
    for args in [&["stop", &*file][..], &["stop", &file, "--rearm"], &["resume", &file]] {
        let done = run(args);
        assert_eq!(done.status.code(), Some(0), "{args:?}: {}", text(&done.stderr));
    }
    let in_clear = ["--set", "confidential=false"];
    for args in [&["stop", &*file][..], &["doctor", &file, "--host", "server", "--listen", "2"]] {
        let output = run(&[args, &in_clear].concat());
        let said = format!("{}{}", text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("only one of it and this machine encrypts"), "{said}");
    }
    let doctor = run(&["doctor", &file, "--host", "server", "--listen", "2"]);
    assert!(text(&doctor.stdout).contains("datagrams are encrypted"), "{}", text(&doctor.stdout));
}

#[test]
fn members_have_keys_of_their_own_and_only_an_operator_gives_orders() {
    let _beside = beside();
    let hosts = ["agent-0", "agent-1", "agent-2", "world", "server"];
    let mut written = team(789).replace("\"team.key\"", "\"keys/operator-1.key\"");
    for host in hosts {
        written += &format!("[host.{host}]\nkey_file = \"keys/{host}.key\"\n\n");
    }
    let (folder, file) = folder(&written);
    let path = |name: &str| folder.path().join("keys").join(name).to_string_lossy().into_owned();
    let keys = folder.path().join("keys").to_string_lossy().into_owned();
    let made = run(&["key", "new", &file, "--out", &keys]);
    assert_eq!(made.status.code(), Some(0), "{}", text(&made.stderr));
    assert_eq!(
        text(&made.stdout).lines().count(),
        hosts.len() + 2,
        "beside those of hosts the operator's and the root's"
    );
    let refuses = |args: &[&str], words: &[&str]| {
        let output = run(args);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
        assert!(words.iter().all(|word| said.contains(word)), "{args:?}: {said}");
    };
    refuses(&["key", "new", &file, "--out", &keys], &["agent-0.key", "--force"]);
    // The file of a member makes no roster, and is as it was.
    refuses(&["key", "revoke", "agent-1", "--root", &path("operator-1.key")], &["no root key", "root.key"]);
    refuses(&["key", "revoke", "agent-9", "--root", &path("root.key")], &["no member 'agent-9'", "agent-0"]);
    refuses(&["key", "spread", &file, &path("root.key")], &["no roster"]);
    refuses(&["key", "new", &file, "--out", &path("more"), "--operators", "20"], &["24 members"]);
    let run_file = file.clone();
    let mut crew = Crew::new(move |host| murmurate(&["host", &run_file, "--host", host, "--json"]));
    hosts.iter().for_each(|host| crew.start(host));
    crew.ready(&hosts);
    // On a host's machine there is that host's file alone, which is not one to listen with.
    let checked = text(&run(&["doctor", &file, "--host", "agent-0"]).stdout);
    for said in ["is that of 'agent-0', who can impersonate no other, by roster 1", "not listened to: the key file"] {
        assert!(checked.contains(said), "{checked}");
    }
    let stopped = run(&["stop", &file]);
    assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped.stderr));
    // The files of hosts are no operators', and each is that of one host.
    for command in ["stop", "resume"] {
        refuses(&[command, &file, "--key-file", &path("agent-1.key")], &["agent-1", "operator"]);
    }
    let other = ["host", &file, "--host", "agent-0", "--key-file", &path("agent-1.key")];
    refuses(&other, &["that of 'agent-1'", "'agent-0'"]);
    refuses(&["stop", &file, "--set", "team=790"], &["of team 789", "team 790"]);
    for (rearm, args) in [(true, &["stop", &file, "--rearm"][..]), (false, &["resume", &file])] {
        let done = run(args);
        assert_eq!(done.status.code(), Some(0), "{rearm}: {}", text(&done.stderr));
    }
}

/// Process that is ended when the test is over.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_page_with_a_wrong_key_says_that_it_understands_nothing_and_stops_nobody() {
    use std::io::{BufRead, BufReader};
    let _beside = beside();
    let keyed = Keyed::start(788, true);
    let mut command = murmurate(&["watch", &keyed.own, "--key-file", &keyed.other_key]);
    let mut watch = Ended(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("it starts"));
    let mut lines = BufReader::new(watch.0.stderr.take().expect("it is piped")).lines().map_while(Result::ok);
    let url = lines.find_map(|line| Some(line.strip_prefix("watch: http://")?.to_owned())).expect("its address");
    let mut page = control(url.split('/').next().expect("an address"));
    let until = Instant::now() + Duration::from_secs(30);
    loop {
        assert!(Instant::now() < until, "the page never says it");
        let Message::Text(said) = page.read().expect("it runs") else { continue };
        let said: Value = serde_json::from_str(&said).expect("it is JSON");
        if said["body"]["trouble"].as_str().is_some_and(|why| why.contains("it has another key")) {
            break;
        }
    }
    assert!(lines.any(|line| line.starts_with("warning: ") && line.contains("another key")), "and the terminal");
}
