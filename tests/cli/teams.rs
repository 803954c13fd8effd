//! Team files and keys on the command line, their refusals, and the example files.

use std::fs::{Permissions, read_to_string, set_permissions, write};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use crate::program::skip::skip;
use crate::program::{murmurate, refuses, run, text};
use nix::sys::stat::Mode;
use nix::unistd::{geteuid, mkfifo};
use tempfile::TempDir;

const TEAM: &str = "team = 1\nkey_file = \"team.key\"\nmode = \"onboard-infra\"\n\n[link.infra]\n\
                    interface = \"wlan0\"\n\n[link.wires]\ninterface = \"lo\"\n";

/// A folder with a team file and its key.
fn folder() -> (TempDir, String) {
    let folder = TempDir::new().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    write(path("team.toml"), TEAM).expect("it can be written");
    assert_eq!(run(&["key", "new", "--out", &path("team.key")]).status.code(), Some(0));
    let file = path("team.toml");
    (folder, file)
}

fn done(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stdout)
}

#[test]
fn every_example_is_valid_and_shows_all_its_values() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("teams");
    let files = std::fs::read_dir(&root).expect("the examples").map(|entry| entry.expect("an example").path());
    let mut names: Vec<String> = Vec::new();
    for path in files {
        let (folder, _) = folder();
        let copy = folder.path().join("team.toml");
        let content = read_to_string(&path).expect("it is text");
        write(&copy, &content).expect("it can be written");
        let output = run(&["config", "check", &copy.to_string_lossy()]);
        assert!(done(&output).contains("valid"), "{}", path.display());
        let err = text(&output.stderr);
        assert_eq!(content.contains("key_file ="), err.is_empty(), "a team without a key is warned of: {err}");
        assert!(content.contains("docs/teams.md"), "{} points to the docs", path.display());
        names.push(path.file_stem().expect("a name").to_string_lossy().into_owned());
    }
    names.sort();
    let modes =
        ["centralized", "flying", "mesh", "mixed", "offboard", "onboard-adhoc", "onboard-infra", "onboard-wlan"];
    assert_eq!(
        names,
        [&modes[..], &["px4-rtk", "robomaster-optitrack", "ros2", "rtk", "turtlebot4", "zenoh"]].concat()
    );
}

#[test]
fn a_key_is_private_to_its_owner_and_not_overwritten_by_accident() {
    let folder = TempDir::new().expect("a temporary folder");
    let path = folder.path().join("team.key");
    let key = path.to_string_lossy().into_owned();
    let said = done(&run(&["key", "new", "--out", &key]));
    assert!(said.contains("fingerprint"), "{said}");
    let first = read_to_string(&path).expect("it is there");
    assert_eq!((first.len(), first.trim_end().len()), (65, 64));
    assert!(first.trim_end().bytes().all(|byte| byte.is_ascii_hexdigit()));
    assert!(!said.contains(&first[..16]), "a key is never printed");
    assert_eq!(path.metadata().expect("it is there").permissions().mode() & 0o777, 0o600);
    refuses(&["key", "new", "--out", &key], &[&key, "--force"]);
    assert_eq!(read_to_string(&path).expect("it is there"), first);
    done(&run(&["key", "new", "--out", &key, "--force"]));
    assert_ne!(read_to_string(&path).expect("it is there"), first);
    assert_eq!(path.metadata().expect("it is there").permissions().mode() & 0o777, 0o600);
    refuses(&["key", "new", "--out", &folder.path().to_string_lossy()], &["--force"]);
    refuses(&["key", "new", "--out", "/nowhere/at/all.key"], &["/nowhere/at/all.key"]);
}

#[test]
fn an_invalid_key_is_refused_in_one_line() {
    let (folder, file) = folder();
    let key: PathBuf = folder.path().join("team.key");
    let sound = read_to_string(&key).expect("it is there");
    let commands = [&["config", "check"][..], &["launch"]];
    let refused =
        |words: &[&str]| commands.iter().for_each(|command| refuses(&[command, &[&*file][..]].concat(), words));
    for mode in [0o640, 0o604, 0o644, 0o700] {
        set_permissions(&key, Permissions::from_mode(mode)).expect("it is ours");
        refused(&["team.key", &format!("mode {mode:04o}"), "chmod 600"]);
    }
    set_permissions(&key, Permissions::from_mode(0o400)).expect("it is ours");
    done(&run(&["config", "check", &file]));
    set_permissions(&key, Permissions::from_mode(0o600)).expect("it is ours");
    for content in ["", "00", &sound[1..], &format!("0{sound}"), &sound.replace(&sound[..1], "x")] {
        write(&key, content).expect("it can be written");
        refused(&["team.key", "64 hexadecimal digits"]);
    }
    std::fs::remove_file(&key).expect("it is ours");
    refused(&["team.key", "is not there", "murmurate key new"]);
    std::fs::create_dir(&key).expect("a folder");
    refused(&["team.key", "not a regular file"]);
    std::fs::remove_dir(&key).expect("it is empty");
    mkfifo(&key, Mode::S_IRUSR | Mode::S_IWUSR).expect("a pipe");
    refused(&["team.key", "not a regular file"]);
}

#[test]
fn root_refuses_a_key_of_an_ordinary_user() {
    let (folder, file) = folder();
    let key = folder.path().join("team.key");
    if !geteuid().is_root() {
        return skip("root", "only root can give a file away");
    }
    chown(&key, Some(1000), None).expect("root may");
    refuses(&["config", "check", &file], &["team.key", "user 1000", "user 0", "chown 0"]);
    chown(&key, Some(0), None).expect("root may");
    // Links are followed: the file at the end counts.
    let link = folder.path().join("link.key");
    symlink(&key, &link).expect("a link");
    done(&run(&["config", "check", &file, "--key-file", &link.to_string_lossy()]));
}

#[test]
fn an_invalid_team_is_refused_in_one_line() {
    let (folder, file) = folder();
    let refused = |change: (&str, &str), words: &[&str]| {
        assert!(TEAM.contains(change.0), "{}", change.0);
        write(&file, TEAM.replacen(change.0, change.1, 1)).expect("it can be written");
        refuses(&["config", "check", &file], words);
        refuses(&["launch", &file], words);
    };
    refused(("key_file = \"team.key\"\n", ""), &["key_file", "'infra'", "key new"]);
    refused(("key_file = \"team.key\"", "confidential = true"), &["confidential (line 2)", "no key_file", "key new"]);
    refused(("team = 1", "team = 1\ncolour = 2"), &["colour (line 2)", "no such field"]);
    refused(("[link.infra]\ninterface = \"wlan0\"", "[link.infra]"), &["link.infra.interface", "missing"]);
    refused(("[link.infra]", "[link.infra]\n[link.infra]"), &["line 6", "duplicate"]);
    let robots = "robots = 2\n[robot.1]\npolicy = \"orca\"\n[robot.1]\npolicy = \"orca\"\n[link.infra]";
    refused(("[link.infra]", robots), &["robot", "duplicate"]);
    let twice = "[deployment]\nmode = \"x\"\nrobots = 2\nplacement = \"drive\"\nstepping = \"seeded\"\n\
                 [[deployment.host]]\nname = \"pc\"\nagents = [[0], [0]]\nsimulates = [0, 1]\nstate_server = true\n";
    refused(("mode = \"onboard-infra\"\n", twice), &["robot 0 has a second agent on host 'pc'"]);
    refused(("mode = ", "plant = \"water\"\nmode = "), &["plant", "line 3", "rigid"]);
    let hull = "plant = \"rigid\"\nwall_radius_m = 0.2\nmode = ";
    refused(("mode = ", hull), &["wall_radius_m (line 4)", "'rigid'", "leave it out"]);
    let plant = "plant = \"rigid\"\n[deployment]\nmode = \"x\"\nrobots = 1\nplacement = \"drive\"\n\
                 stepping = \"seeded\"\n[[deployment.host]]\nname = \"pc\"\nagents = [[0]]\nsimulates = [0]\n\
                 state_server = true\n";
    refused(("mode = \"onboard-infra\"\n", plant), &["plant (line 3)", "[deployment]"]);
    refused(("mode = ", "policy = \"nowhere\"\nmode = "), &["policy file", "nowhere"]);
    refused(("\"onboard-infra\"", "onboard-infra"), &["line 3"]);
    write(&file, TEAM).expect("it can be written");
    let missing = folder.path().join("missing.toml").to_string_lossy().into_owned();
    refuses(&["launch", &missing], &["team file", &missing]);
    refuses(&["config", "show", &file, "--robot", "9"], &["--robot", "0 to 4"]);
    refuses(&["config", "show", &file, "--host", "pc"], &["--host", "'pc'", "world"]);
    refuses(&["config", "show", &file, "--host", "world", "--robot", "1"], &["--robot"]);
    refuses(&["config", "show", &file, "--set", "seed"], &["--set seed", "FIELD=VALUE"]);
    refuses(&["config", "show", &file, "--set", "sed=1"], &["sed (--set)"]);
    refuses(&["config", "check", &file, "--key-file", "/nowhere"], &["/nowhere"]);
    refuses(&["host", &file], &["--host", "--robot", "--role"]);
    let paths = folder.path().join("paths.csv").to_string_lossy().into_owned();
    let lo = ["--interface", "lo", "--trajectories", &paths];
    refuses(&[&["host", &file, "--robot", "1"][..], &lo].concat(), &["--trajectories", "World"]);
}

#[test]
fn show_says_where_every_value_comes_from() {
    let (_folder, file) = folder();
    let args = ["config", "show", &file, "--robot", "2", "--set", "seed=7", "--interface", "eth9"];
    let output = murmurate(&args).env("MURMURATE_EPISODES", "3").output().expect("it starts");
    let shown = done(&output);
    let line = |field: &str| {
        let found = shown.lines().find(|line| line.split_whitespace().next() == Some(field));
        found.unwrap_or_else(|| panic!("{field} is shown in {shown}")).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    assert_eq!(line("seed"), "seed 7 --set");
    assert_eq!(line("episodes"), "episodes 3 MURMURATE_EPISODES");
    assert_eq!(line("mode"), format!("mode onboard-infra {file}:3"));
    assert_eq!(line("link.wires.interface"), "link.wires.interface eth9 --interface");
    assert_eq!(line("link.infra.transport"), "link.infra.transport multicast default");
    assert_eq!(line("policy"), "policy shipped default");
    assert_eq!(line("safety.silence_s"), "safety.silence_s 1.0 default");
    assert_eq!(line("plant"), "plant kinematic default");
    assert_eq!(line("lag_s"), "lag_s 0 default");
    let rigid = ["config", "show", &file, "--set", "plant=rigid", "--set", "sensor=exact"];
    let shown = done(&run(&rigid));
    for expected in ["plant rigid --set", "lag_s 0.5 default", "wall_radius_m 0.16 default", "sensor exact --set"] {
        let found = shown.lines().any(|line| line.split_whitespace().collect::<Vec<_>>().join(" ") == expected);
        assert!(found, "{expected} in {shown}");
    }
    let json = run(&["config", "show", &file, "--json"]);
    let json: serde_json::Value = serde_json::from_str(&done(&json)).expect("one JSON object");
    assert_eq!(json["values"][0]["field"], "team");
    assert_eq!(json["values"][0]["origin"], format!("{file}:1"));
    assert_eq!(json["deployment"]["robots"], 5);
    write(&file, format!("{TEAM}\n[safety]\ndistance = \"off\"\n")).expect("it can be written");
    let shown = done(&run(&["config", "show", &file]));
    let line = shown.lines().find(|line| line.starts_with("safety.distance ")).expect("it is shown");
    assert!(line.contains(" off ") && line.ends_with(&TEAM.lines().count().saturating_add(3).to_string()), "{line}");
}

#[test]
fn doctor_reports_problems_and_remedies() {
    let (folder, file) = folder();
    let output = run(&["doctor", &file, "--host", "world", "--set", "link.infra.interface=wlan99"]);
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stdout);
    assert!(said.contains("warn key: fingerprint") && said.contains("ok   policy: shipped"), "{said}");
    let missing = said.lines().find(|line| line.contains("wlan99")).expect("a line about it");
    assert!(missing.starts_with("fail link infra: interface") && missing.contains("lo (127.0.0.1"), "{missing}");
    assert!(missing.contains("link.infra.interface"), "{missing}");
    let args = ["doctor", &file, "--interface", "lo", "--json", "--listen", "0"];
    let fit = run(&args);
    let found: serde_json::Value = serde_json::from_str(&done(&fit)).expect("one JSON object");
    assert_eq!(found["fit"], true);
    let checks = found["checks"].as_array().expect("checks");
    let is = |what: &str, status: &str| checks.iter().any(|check| check["what"] == what && check["status"] == status);
    assert!(is("key", "warn"), "all have one: {found}");
    for what in ["policy", "link infra, interface", "link infra, MTU", "link infra, group", "link wires, group"] {
        assert!(is(what, "ok"), "{what}: {found}");
    }
    refuses(&["doctor", &file], &["--host", "--robot", "robot-0, "]);
    refuses(&["doctor", &file, "--host", "world", "--listen", "9999"], &["--listen"]);
    std::fs::remove_file(folder.path().join("team.key")).expect("it is ours");
    let output = run(&args);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("is not there"));
}

/// Returns a team on loopback with its own groups.
fn loopback(folder: &TempDir, number: u16) -> String {
    let link = |name: &str, last: u8| {
        format!("[link.{name}]\ninterface = \"lo\"\ngroup = \"239.255.78.{last}:{}\"\n", 40_000 + number)
    };
    let links = link("loopback", 1) + &link("infra", 2);
    let file = folder.path().join("loopback.toml").to_string_lossy().into_owned();
    let key = "key_file = \"team.key\"";
    write(&file, format!("team = {number}\n{key}\nmode = \"offboard\"\nepisodes = 100\n{links}")).expect("written");
    file
}

#[test]
fn launch_starts_a_team_and_stops_it_when_interrupted() {
    let (folder, _) = folder();
    let file = loopback(&folder, 771);
    let mut launch = murmurate(&["launch", &file, "--json", "--set", "robots=2"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut said = Vec::new();
    let mut lines = BufReader::new(launch.stderr.take().expect("it is piped")).lines();
    for line in &mut lines {
        said.push(line.expect("text"));
        if said.last().is_some_and(|line| line.starts_with("3 processes run")) {
            break;
        }
    }
    let pid = nix::unistd::Pid::from_raw(i32::try_from(launch.id()).expect("process numbers are small"));
    nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGTERM).expect("it runs");
    said.extend(lines.map(|line| line.expect("text")));
    let output = launch.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(130), "{said:?}");
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!((&summary["interrupted"], &summary["robots"]), (&true.into(), &2.into()));
    assert!(!said.iter().any(|line| line.contains("killed") || line.contains("failed")), "{said:?}");
}

#[test]
fn doctor_lists_present_and_missing_hosts() {
    let (folder, _) = folder();
    let file = loopback(&folder, 773);
    let set = ["--set", "robots=2"];
    let mut world = murmurate(&["host", &file, "--host", "world", "--json", set[0], set[1]])
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut lines = BufReader::new(world.stdout.take().expect("it is piped")).lines();
    assert!(lines.next().expect("a line").expect("text").contains("ready"));
    let doctor = |host: &str, key: &[&str]| {
        let args = [&["doctor", &*file, "--host", host, "--json"][..], &set, key].concat();
        let output = run(&args);
        // A key that the team does not have is no way into it.
        assert_eq!(output.status.code(), Some(i32::from(!key.is_empty())), "{}", text(&output.stdout));
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
        let of = |what: &str| {
            let checks = found["checks"].as_array().expect("checks").iter().find(|check| check["what"] == what);
            let check = checks.unwrap_or_else(|| panic!("{what}: {found}"));
            (check["status"].as_str().expect("text").to_owned(), check["found"].as_str().expect("text").to_owned())
        };
        ["link loopback, loop-back", "link loopback, host world", "link loopback, host agent-1", "refused"]
            .map(|what| if what == "refused" && key.is_empty() { Default::default() } else { of(what) })
    };
    let [back, heard, missing, _] = doctor("agent-0", &[]);
    assert!(back.0 == "ok" && back.1.contains("there and back in"), "{back:?}");
    assert!(heard.0 == "ok" && heard.1.contains("loss 0 %") && heard.1.contains("there and back in"), "{heard:?}");
    assert_eq!((&*missing.0, &*missing.1), ("warn", "not heard"));
    let other = folder.path().join("other.key").to_string_lossy().into_owned();
    done(&run(&["key", "new", "--out", &other]));
    let [back, heard, _, refused] = doctor("agent-0", &["--key-file", &other]);
    assert_eq!((&*back.0, &*heard.1), ("ok", "not heard"));
    assert!(refused.1.contains("with another key"), "{refused:?}");
    world.kill().expect("it runs");
    world.wait().expect("it is ours");
}

#[test]
fn stop_says_at_once_that_no_interface_is_fit_and_waits_no_longer_than_for_an_answer() {
    let (_folder, file) = folder();
    let output = run(&["stop", &file, "--interface", "wlan99", "--wait", "0.5"]);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("nothing is sent yet, trying for 0.5 s: link 'infra'") && said.contains("wlan99"), "{said}");
    assert_eq!(said.matches("nothing is sent yet").count(), 1, "once: {said}");
}

#[test]
fn launch_passes_on_why_a_process_has_refused() {
    let (folder, _) = folder();
    let file = loopback(&folder, 772);
    let output = run(&["launch", &file, "--interface", "wlan99"]);
    // An interface may come late, so its processes wait a little and are started again before the team is given up.
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let said = text(&output.stderr);
    assert!(said.contains("waiting up to 2 s until it is fit"), "{said}");
    let last = said.lines().last().expect("an error");
    assert!(last.starts_with("error: the process '") && last.contains("wlan99") && last.contains("lo ("), "{said}");
    assert!(text(&output.stdout).contains("0 of 0"), "no episode has a result: {}", text(&output.stdout));
}
