//! Records of the hosts of a real team, which run again alone.

use std::fs::write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use murmurate::graph::inputs::{DeviceId, Input};
use murmurate::messages::wire::{Latent, Wire};
use murmurate::net::protocol::codec;
use murmurate::time::Span;
use murmurate_record::tape::{self, Turn};
use tempfile::TempDir;

use crate::edited::{edit, is_latent};
use crate::program::{murmurate, refuses, run, text};
use crate::records;

/// Runs one episode of a team with a key, and returns the folder with its files and the folder with its records.
fn launched(number: u16) -> (TempDir, PathBuf) {
    launched_with(number, "key_file = \"team.key\"\n", "")
}

/// Runs one episode of a team with keys: `keys` names them at the top of its file, `tables` in tables of hosts.
fn launched_with(number: u16, keys: &str, tables: &str) -> (TempDir, PathBuf) {
    launched_while(number, (keys, tables), |_| {})
}

/// Runs one episode as [`launched_with`], and does something meanwhile in the folder with its files.
fn launched_while(number: u16, (keys, tables): (&str, &str), meanwhile: impl FnOnce(&Path)) -> (TempDir, PathBuf) {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let link = |name: &str, last: u8| {
        format!("[link.{name}]\ninterface = \"lo\"\ngroup = \"239.255.77.{last}:{}\"\n", 40_000 + number)
    };
    let head = "mode = \"offboard\"\nrobots = 3\nepisodes = 1\n";
    let team = format!("team = {number}\n{keys}{head}{}{}{tables}", link("loopback", 1), link("infra", 2));
    write(path("team.toml"), team).expect("it can be written");
    let (team, one, each) = (path("team.toml"), path("team.key"), path("keys"));
    assert!(run(&["key", "new", "--out", one.to_str().unwrap()]).status.success());
    let [of_team, out] = [&team, &each].map(|path| path.to_string_lossy());
    assert!(run(&["key", "new", &of_team, "--out", &out, "--operators", "2"]).status.success());
    let to = path("records");
    let mut launch = murmurate(&[
        "launch",
        team.to_str().unwrap(),
        "--quiet",
        "--json",
        "--record",
        to.to_str().unwrap(),
        "--through",
        "env HOST={host}",
    ]);
    let launch = launch.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    meanwhile(folder.path());
    let output = launch.wait_with_output().expect("it ends");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout) + &text(&output.stderr);
    for key in secrets(folder.path()) {
        assert!(!said.contains(&key[..16]), "no key is shown");
    }
    (folder, to)
}

/// Returns all secret keys of the team in this folder, as hexadecimal digits.
fn secrets(folder: &Path) -> Vec<String> {
    let members = std::fs::read_dir(folder.join("keys")).expect("it was made");
    let files =
        members.map(|file| file.expect("a file").path()).filter(|path| path.extension() == Some("key".as_ref()));
    let members = files.map(|path| std::fs::read_to_string(path).expect("a key file"));
    let secret = |line: &str| Some(line.split_once("\"")?.1.trim_end_matches('"').to_owned());
    let of_member = |text: String| {
        let lines = text.lines().filter(|line| line.starts_with("shared") || line.starts_with("secret"));
        lines.filter_map(secret).collect::<Vec<String>>()
    };
    let one = std::fs::read_to_string(folder.join("team.key")).expect("it was made").trim().to_owned();
    members.flat_map(of_member).chain([one]).collect()
}

/// Returns the record of the host with this name in a folder.
fn record_of(folder: &Path, host: &str) -> PathBuf {
    let all = records(folder).into_iter();
    let mut named = all.filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().contains(host)));
    named.next().unwrap_or_else(|| panic!("no record of {host}"))
}

fn replayed(record: &Path, more: &[&str]) -> (i32, String) {
    let output = run(&[&["replay", "--host", record.to_str().unwrap()], more].concat());
    (output.status.code().expect("it ends"), text(&output.stdout) + &text(&output.stderr))
}

#[test]
fn hosts_of_a_team_with_a_key_run_again_to_the_bit_and_each_change_is_noticed() {
    let (folder, records_of) = launched(811);
    let key = folder.path().join("team.key");
    let with_key = ["--key-file", key.to_str().unwrap()];
    let (status, said) = replayed(&records_of, &with_key);
    assert_eq!((status, said.matches("equal, ").count()), (0, 4), "{said}");
    // The key is never taken from where a record says, which may be of somebody else.
    let (status, said) = replayed(&records_of, &[]);
    assert!(status == 2 && said.contains("--key-file"), "{said}");
    let secret = std::fs::read_to_string(&key).unwrap();
    for record in records(&records_of) {
        assert_eq!(record.metadata().unwrap().permissions().mode() & 0o007, 0, "not for everybody");
        let bytes = std::fs::read(record).unwrap();
        assert!(!bytes.windows(16).any(|part| secret.as_bytes().windows(16).any(|key| key == part)), "no key in it");
    }
    let agent = record_of(&records_of, "agent-0");
    let changed = folder.path().join("changed.mcap");
    type Change = fn(&mut Turn) -> bool;
    let changes: [(&str, Change); 3] = [
        ("one bit of a latent", |turn| {
            let Some(at) = turn.inputs.iter().position(is_latent) else { return false };
            let Input::Frame(link, frame, from) = turn.inputs[at].clone() else { unreachable!() };
            let mut bytes = frame.to_vec();
            bytes[60] ^= 1;
            turn.inputs[at] = Input::Frame(link, bytes.into(), from);
            true
        }),
        ("one latent left out", |turn| {
            let Some(at) = turn.inputs.iter().position(is_latent) else { return false };
            turn.inputs.remove(at);
            true
        }),
        ("one turn a microsecond later", |turn| {
            turn.now += Span::from_nanos(1000);
            true
        }),
    ];
    for (what, change) in changes {
        let mut done = false;
        edit(&agent, &changed, |turn| {
            // In the middle of the run, when latents are used.
            if !done && turn.now.as_secs() > 2.5 {
                done = change(turn);
            }
        });
        assert!(done, "{what}");
        let (status, said) = replayed(&changed, &with_key);
        assert_eq!(status, 1, "{what}: {said}");
        let at = said.split("first difference at ").nth(1).expect("it is named").split(' ').next().unwrap();
        assert!((2.5..4.0).contains(&at.parse::<f64>().unwrap()), "{what}: {said}");
    }
    edit(&agent, &changed, |_| {});
    assert_eq!(replayed(&changed, &with_key).0, 0, "a copy is equal");
    let shared = folder.path().join("shared.mcap");
    shares(&agent, &key, &shared);
    shares_a_folder(&records_of, &key, folder.path());
    differs_with_another_policy(&agent, &key, folder.path());
    std::fs::remove_file(&key).unwrap();
    assert_eq!(replayed(&shared, &[]).0, 0, "a shared copy needs no key");
    refuses(&["replay", "--host", agent.to_str().unwrap()], &["a team with a key", "--key-file"]);
}

/// Makes a copy that can be replayed without the key, and one whose list lacks the latents' datagrams.
fn shares(agent: &Path, key: &Path, copy: &Path) {
    let share = ["record", "share", agent.to_str().unwrap(), "--key-file", key.to_str().unwrap(), "-o"];
    let output = run(&[&share[..], &[copy.to_str().unwrap()]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let (status, said) = replayed(copy, &[]);
    assert!(status == 0 && said.contains("equal, ") && said.contains("no tag is checked"), "{said}");
    let wrong = copy.with_extension("key");
    assert!(run(&["key", "new", "--out", wrong.to_str().unwrap()]).status.success());
    let share = ["record", "share", agent.to_str().unwrap(), "--key-file", wrong.to_str().unwrap(), "-o"];
    refuses(&[&share[..], &["unused.mcap"]].concat(), &["--key-file", "no datagram"]);
    edit(copy, &copy.with_extension("cut"), |turn| {
        for input in turn.inputs.iter_mut().filter(|input| is_latent(input)) {
            // Datagrams that are on no list are refused, as with a wrong tag.
            if let Input::Frame(_, frame, _) = input {
                let mut bytes = frame.to_vec();
                *bytes.last_mut().unwrap() ^= 1;
                *frame = bytes.into();
            }
        }
    });
    assert_eq!(replayed(&copy.with_extension("cut"), &[]).0, 1, "no latent is accepted");
}

/// Makes copies of all records of the team, beside which a file lies that is none.
fn shares_a_folder(records_of: &Path, key: &Path, folder: &Path) {
    let copies = folder.join("copies");
    let empty = records_of.join("a.mcap");
    write(&empty, "").unwrap();
    let [from, key, to] = [records_of, key, &copies].map(|path| path.to_str().unwrap());
    let output = run(&["record", "share", from, "--key-file", key, "-o", to]);
    let (said, why) = (text(&output.stdout), text(&output.stderr));
    assert_eq!((output.status.code(), said.matches("had a valid tag").count()), (Some(1), 4), "{said}{why}");
    assert!(why.contains("left out") && why.contains("a.mcap"), "{why}");
    std::fs::remove_file(&empty).unwrap();
    let (status, said) = replayed(&copies, &[]);
    assert_eq!((status, said.matches("equal, ").count()), (0, 4), "{said}");
    shares_into_no_place_that_is_taken((records_of, &copies), (from, key), &folder.join("link"));
}

/// Checks that copies go neither beside nor into the records, by whatever name, and that nothing is overwritten.
fn shares_into_no_place_that_is_taken((records_of, copies): (&Path, &Path), (from, key): (&str, &str), link: &Path) {
    let content = |folder: &Path| -> Vec<_> {
        records(folder)
            .into_iter()
            .map(|path| std::fs::read(&path).map(|bytes| (path, bytes)).expect("a file"))
            .collect()
    };
    let (before, shared) = (content(records_of), content(copies));
    std::os::unix::fs::symlink(records_of, link).expect("a link can be made");
    let name = records_of.file_name().expect("it has a name");
    let inside = [
        records_of.to_owned(),
        records_of.join("copies"),
        records_of.join("a/b"),
        records_of.join("..").join(name).join("c"),
        copies.join("none/../..").join(name).join("d"),
        link.join("e"),
    ];
    for to in inside {
        refuses(&["record", "share", from, "--key-file", key, "-o", to.to_str().unwrap()], &["another folder"]);
    }
    // One that is there already is named, and none of the others is written beside it.
    let half = copies.with_extension("half");
    std::fs::create_dir(&half).unwrap();
    let last = before.last().expect("there are records").0.file_name().unwrap();
    write(half.join(last), "mine").unwrap();
    let named = [last.to_str().unwrap(), "there already"];
    refuses(&["record", "share", from, "--key-file", key, "-o", half.to_str().unwrap()], &named);
    assert_eq!(content(&half), [(half.join(last), b"mine".to_vec())]);
    // A single one, too, above all the record itself.
    let one = before[0].0.to_str().unwrap();
    for to in [one, half.join(last).to_str().unwrap()] {
        refuses(&["record", "share", one, "--key-file", key, "-o", to], &["there already"]);
    }
    refuses(&["record", "merge", from, "-o", one], &["is one of the records"]);
    assert!(content(records_of) == before && content(copies) == shared, "nothing has changed");
}

/// Returns how many datagrams in a record have arrived encrypted, and in clear; rosters always are.
fn arrived(record: &Path) -> [usize; 2] {
    let (_, mut messages) = murmurate_record::reader::messages(record).expect("a record");
    let mut found = [0, 0];
    while let Some(message) = messages.next_message().expect("it is whole") {
        let turn = (message.channel.topic == "/tape/turn").then(|| tape::read(&message.data).expect("a turn"));
        for frame in turn.into_iter().flat_map(Turn::frames).filter(|frame| codec::roster_of(frame).is_none()) {
            found[usize::from(!codec::is_encrypted(&frame))] += 1;
        }
    }
    found
}

/// Checks that no file in a folder has 8 bytes of a key of the team in it, or 16 digits.
fn have_no_key(records_of: &Path, team: &Path) {
    for key in secrets(team) {
        let bytes = data_encoding::HEXLOWER.decode(key.as_bytes()).expect("digits");
        for record in records(records_of) {
            let content = std::fs::read(record).expect("a record");
            let has = |part: &[u8]| content.windows(part.len()).any(|window| window == part);
            assert!(!has(&bytes[..8]) && !has(&key.as_bytes()[..16]), "no key in it");
        }
    }
}

#[test]
fn records_of_a_confidential_team_run_again_with_the_key_and_shared_copies_without_it() {
    let (folder, records_of) = launched_with(813, "key_file = \"team.key\"\nconfidential = true\n", "");
    let [key, copies, merged] =
        ["team.key", "copies", "run.mcap"].map(|name| folder.path().join(name).to_str().unwrap().to_owned());
    let (from, with_key) = (records_of.to_str().unwrap(), ["--key-file", &*key]);
    for record in records(&records_of) {
        let [encrypted, clear] = arrived(&record);
        assert!(encrypted > 50 && clear == 0, "{}: {encrypted} and {clear}", record.display());
    }
    have_no_key(&records_of, folder.path());
    let (status, said) = replayed(&records_of, &with_key);
    assert_eq!((status, said.matches("equal, ").count()), (0, 4), "{said}");
    let output = run(&["record", "share", from, "--key-file", &key, "-o", &copies]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    for copy in records(Path::new(&copies)) {
        let [encrypted, clear] = arrived(&copy);
        assert!(encrypted == 0 && clear > 50, "{}: {encrypted} and {clear}", copy.display());
    }
    have_no_key(Path::new(&copies), folder.path());
    for more in [&[][..], &with_key] {
        let (status, said) = replayed(Path::new(&copies), more);
        assert_eq!((status, said.matches("equal, ").count()), (0, 4), "{said}");
        assert!(said.contains("no tag is checked"), "{said}");
    }
    // What arrived joins the clocks of hosts.
    refuses(&["record", "merge", from, "-o", &merged], &["is encrypted", "--key-file", "record share"]);
    for of in [&["record", "merge", from, "--key-file", &key][..], &["record", "merge", &copies]] {
        let output = run(&[of, &["-o", &merged]].concat());
        let said = text(&output.stdout);
        assert!(output.status.success() && !said.contains("\n0 datagrams"), "{said}{}", text(&output.stderr));
    }
}

/// Hosts of the team, by name.
const HOSTS: [&str; 4] = ["agent-0", "agent-1", "agent-2", "world"];

/// Runs one episode of a confidential team whose members have keys of their own, and does something meanwhile. Checks
/// that each record runs again with its host's key, and a shared copy of it without.
fn members_run_again(number: u16, meanwhile: impl FnOnce(&Path)) {
    let tables: String = HOSTS.iter().map(|host| format!("[host.{host}]\nkey_file = \"keys/{host}.key\"\n")).collect();
    let keys = "key_file = \"keys/operator-1.key\"\nconfidential = true\n";
    let (folder, records_of) = launched_while(number, (keys, &tables), meanwhile);
    have_no_key(&records_of, folder.path());
    for record in records(&records_of) {
        let name = record.file_name().expect("a record has a name").to_string_lossy();
        let host = HOSTS.into_iter().find(|host| name.starts_with(host)).expect("it is of a host");
        let [encrypted, clear] = arrived(&record);
        assert!(encrypted > 50 && clear == 0, "{host}: {encrypted} and {clear}");
        let key = folder.path().join("keys").join(host).with_extension("key");
        let (status, said) = replayed(&record, &["--key-file", &key.to_string_lossy()]);
        assert_eq!((status, said.matches("equal, ").count()), (0, 1), "{host}: {said}");
        shares(&record, &key, &folder.path().join(host).with_extension("mcap"));
    }
    assert_eq!(records(&records_of).len(), HOSTS.len());
}

#[test]
fn records_of_confidential_members_run_again_each_with_its_own_key() {
    members_run_again(814, |_| {});
}

#[test]
fn records_of_members_whose_roster_changes_run_again_with_and_without_their_keys() {
    members_run_again(815, |folder| {
        let path = |name: &str| folder.join(name).to_string_lossy().into_owned();
        for (change, roster) in [(&["rotate"][..], "keys/2.roster"), (&["revoke", "operator-2"], "keys/3.roster")] {
            let made = run(&[&["key"], change, &["--root", &path("keys/root.key")]].concat());
            assert!(made.status.success(), "{}", text(&made.stderr));
            let spread = run(&["key", "spread", &path("team.toml"), &path(roster), "--wait", "60"]);
            assert!(spread.status.success(), "{}", text(&spread.stderr));
        }
    });
}

fn differs_with_another_policy(agent: &Path, key: &Path, folder: &Path) {
    let (steps, figure) = (folder.join("steps.csv"), folder.join("actions.svg"));
    let flags = ["--key-file", key.to_str().unwrap(), "--policy", "published", "--json"];
    let files = ["--steps", steps.to_str().unwrap(), "--svg", figure.to_str().unwrap()];
    let (status, said) = replayed(agent, &[&flags[..], &files].concat());
    let said: serde_json::Value = serde_json::from_str(said.lines().next().unwrap()).expect("one JSON object");
    let robot = &said["robots"][0];
    assert_eq!((status, &robot["robot"], said["robots"].as_array().unwrap().len()), (0, &0.into(), 1), "{said}");
    assert!(robot["most_m_s"].as_f64().unwrap() > 0.05 && robot["steps"].as_u64().unwrap() > 50, "{said}");
    let rows = std::fs::read_to_string(&steps).unwrap().lines().count() as u64;
    assert_eq!(rows, robot["steps"].as_u64().unwrap() + 1);
    assert!(std::fs::read_to_string(&figure).unwrap().starts_with("<svg"));
    let (_, same) = replayed(agent, &["--key-file", key.to_str().unwrap(), "--policy", "shipped"]);
    assert!(same.contains("none differs"), "the same policy acts the same: {same}");
}

/// Runs one episode of `swap` with the policy of format 3 called `name`, and replays all its records. Returns the
/// folder of its files, that of its records, and the file with the team's key.
fn replayed_with(number: u16, name: &str) -> (TempDir, PathBuf, String) {
    let policy = Path::new(crate::program::ROOT).join(format!("tests/onnx/data/{name}.policy.toml"));
    let policy = policy.canonicalize().expect("it is there");
    let head = format!("key_file = \"team.key\"\nscenario = \"swap\"\npolicy = '{}'\n", policy.display());
    let (folder, records_of) = launched_with(number, &head, "");
    let key = folder.path().join("team.key").to_string_lossy().into_owned();
    let (status, said) = replayed(&records_of, &["--key-file", &key]);
    assert_eq!((status, said.matches("equal, ").count()), (0, 4), "{said}");
    (folder, records_of, key)
}

#[test]
fn a_policy_that_a_worker_computes_runs_again_from_its_recorded_answers() {
    let (folder, records_of, key) = replayed_with(814, "field");
    // What the worker has answered decides what the robot does.
    let agent = record_of(&records_of, "agent-0");
    let changed = folder.path().join("changed.mcap");
    let mut left_out = 0;
    edit(&agent, &changed, |turn| {
        let before = turn.inputs.len();
        turn.inputs.retain(|input| !matches!(input, Input::Packet(DeviceId::Agent(_), _)));
        left_out += before - turn.inputs.len();
    });
    assert!(left_out > 20, "{left_out}");
    let (status, said) = replayed(&changed, &["--key-file", &key]);
    assert!(status == 1 && said.contains("first difference at "), "{said}");
}

#[test]
fn messages_in_parts_are_recorded_part_by_part_and_join_again() {
    let (_folder, records_of, _) = replayed_with(816, "wide");
    let mut reader = murmurate_record::reader::Reader::open(&record_of(&records_of, "agent-0")).expect("a record");
    let mut parts = [0_u32; 3];
    while let Some(message) = reader.next_message().expect("it is whole") {
        if message.channel.topic != "/wire/agent-0" {
            continue;
        }
        if let Ok((_, Wire::Latent(Latent { part: Some(part), .. }))) = codec::decode(&message.data) {
            assert_eq!((part.of, part.floats, part.encoding), (3, 1500, 1));
            parts[usize::from(part.index)] += 1;
        }
    }
    assert!(parts.iter().all(|count| *count > 20), "{parts:?}");
}

#[test]
fn a_merged_record_has_the_messages_of_all_hosts_in_the_order_of_one_time() {
    let (folder, records_of) = launched(812);
    let merged = folder.path().join("run.mcap");
    let output = run(&["record", "merge", records_of.to_str().unwrap(), "-o", merged.to_str().unwrap()]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let mut reader = murmurate_record::reader::Reader::open(&merged).unwrap();
    let (mut last, mut publishers) = (0, std::collections::BTreeSet::new());
    while let Some(message) = reader.next_message().unwrap() {
        assert!(message.at >= last, "in order");
        last = message.at;
        publishers.extend(message.channel.topic.strip_prefix("/wire/").map(str::to_owned));
    }
    assert!(reader.is_complete());
    assert_eq!(publishers.into_iter().collect::<Vec<_>>(), ["agent-0", "agent-1", "agent-2", "world"]);
}
