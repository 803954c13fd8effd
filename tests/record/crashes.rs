//! Files of processes that were killed.

use std::io::Cursor;
use std::path::Path;

use murmurate_record::reader::Reader;
use murmurate_record::repair::copy;
use tempfile::TempDir;

use crate::program::skip::skip;
use crate::program::{murmurate, run, text};
use crate::records;

/// Number of messages in the first bytes of a file, and whether it has its end.
fn messages(bytes: &[u8]) -> (u64, bool) {
    let Ok(mut reader) = Reader::of(Path::new("cut"), Cursor::new(bytes.to_vec())) else { return (0, false) };
    let mut count = 0;
    while reader.next_message().expect("a cut is no damage").is_some() {
        count += 1;
    }
    assert!(reader.health().is_whole() == reader.is_complete() || reader.health().faults.len() == 1);
    (count, reader.is_complete())
}

#[test]
fn a_file_cut_at_any_byte_is_read_and_a_longer_one_never_holds_less() {
    let folder = TempDir::new().unwrap();
    let to = folder.path().to_str().unwrap();
    let sim = ["sim", "--mode", "centralized", "--episodes", "1", "--repeats", "1", "--record", to];
    assert!(run(&sim).status.success());
    let bytes = std::fs::read(&records(folder.path())[0]).unwrap();
    let (mut before, whole) = (0, messages(&bytes));
    assert!(whole.0 > 300 && whole.1, "{whole:?}");
    // Every byte of the beginning and of the end, and a prime number's multiples between.
    let cuts = (0..400).chain((400..bytes.len() - 400).step_by(4801)).chain(bytes.len() - 400..bytes.len());
    for cut in cuts {
        let (count, complete) = messages(&bytes[..cut]);
        assert!(count >= before && (!complete || count == whole.0), "{cut}: {count} after {before}");
        before = count;
    }
    assert_eq!(before, whole.0);
    let mut mended = Cursor::new(Vec::new());
    let half = &bytes[..bytes.len() / 2];
    let mut half_read = Reader::of(Path::new("half"), Cursor::new(half.to_vec())).unwrap();
    let found = copy(&mut half_read, Vec::new(), &mut mended).unwrap();
    assert_eq!((found, true), messages(mended.get_ref()), "whole again");
    assert_eq!((found, false), messages(half));
}

#[test]
fn a_host_that_is_killed_leaves_a_record_that_can_be_read_repaired_and_replayed() {
    let folder = TempDir::new().unwrap();
    let (team, to) = (folder.path().join("team.toml"), folder.path().join("records"));
    let link =
        |name: &str, last: u8| format!("[link.{name}]\ninterface = \"lo\"\ngroup = \"239.255.77.{last}:40813\"\n");
    let links = link("loopback", 1) + &link("infra", 2);
    std::fs::write(&team, format!("team = 813\nmode = \"offboard\"\nrobots = 2\nepisodes = 9\n{links}")).unwrap();
    let host = ["host", team.to_str().unwrap(), "--host", "world", "--json", "--record", to.to_str().unwrap()];
    let mut child = murmurate(&host).stdout(std::process::Stdio::piped()).spawn().expect("it starts");
    // Two events with counts: two seconds of its run.
    let lines = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
    let seen = lines.map_while(Result::ok).filter(|line| line.contains("\"counted\"")).take(2).count();
    assert_eq!(seen, 2);
    child.kill().expect("it runs");
    child.wait().expect("it has ended");
    let record = records(&to).remove(0);
    let mut reader = Reader::open(&record).unwrap();
    let mut last = 0;
    let first = reader.next_message().unwrap().expect("there are messages").at;
    while let Some(message) = reader.next_message().unwrap() {
        last = message.at;
    }
    let held_s = (last - first) as f64 / 1e9;
    assert!(!reader.is_complete() && held_s > 1.6, "{held_s} s of 2 s");
    let replayed = run(&["replay", record.to_str().unwrap()]);
    assert!(replayed.status.success() && text(&replayed.stdout).contains("a crash has cut"), "{replayed:?}");
    let mended = run(&["record", "repair", to.to_str().unwrap()]);
    assert!(mended.status.success(), "{}", text(&mended.stderr));
    assert!(text(&run(&["record", "info", record.to_str().unwrap()]).stdout).contains("whole"));
    let kept = records(&to);
    assert!(kept.len() == 2 && kept.iter().any(|path| path.extension().is_some_and(|end| end == "cut")), "{kept:?}");
}

#[test]
fn a_launch_whose_records_do_not_fit_on_the_disk_prints_all_results_and_names_the_loss() {
    let folder = TempDir::new().unwrap();
    let team = folder.path().join("team.toml");
    let to = folder.path().join("small");
    std::fs::create_dir(&to).unwrap();
    std::fs::write(&team, "team = 814\nmode = \"centralized\"\nrobots = 2\nepisodes = 1\n").unwrap();
    // A file system of its own, which goes with the command.
    let kept = folder.path().join("kept");
    let script = "mount -t tmpfs -o size=150k small \"$1\" && \
                  \"$0\" launch \"$2\" --interface lo --json --record \"$1\"; \
                  code=$?; cp -r \"$1\" \"$3\"; exit $code";
    let program = murmurate(&[]).get_program().to_owned();
    let mut command = std::process::Command::new("unshare");
    command.args(["--user", "--map-root-user", "--mount", "sh", "-c", script]).arg(program).args([&to, &team, &kept]);
    let output = command.env_remove("MURMURATE_LOG").stdin(std::process::Stdio::null()).output();
    let Some(output) = output.ok().filter(|output| !text(&output.stderr).contains("unshare:")) else {
        return skip("mounts", "no file system can be mounted here");
    };
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let last = said.lines().last().expect("an error");
    assert!(last.starts_with("error: every episode has a result, but the process"), "{said}");
    assert!(last.contains("small") && last.contains("No space left on device"), "{said}");
    let results: serde_json::Value = serde_json::from_slice(&output.stdout).expect("the results");
    assert_eq!((&results["episodes"], &results["interrupted"]), (&1.into(), &false.into()), "{results}");
    assert!(!said.contains("started again"), "{said}");
    let gone = said.matches("can no longer be written").count();
    // Each record ends with its last whole chunk, and is read up to there.
    let mut cut = 0;
    for record in records(&kept) {
        let reader = Reader::open(&record).expect("it has a beginning");
        let health = reader.health();
        assert!(health.faults.is_empty(), "{health:?}");
        if let Some(end) = &health.cut {
            assert_eq!((end.from, end.to), (health.bytes, health.bytes), "nothing is behind its end: {end}");
            cut += 1;
        }
    }
    assert!(cut >= 1 && gone <= cut, "{cut} are cut, and it is said {gone} times: {said}");
}

/// Runs two episodes of a team with records on a file system of its own, which the kernel then makes read-only, as it
/// does after an error of a disk, and one more. Prints what `launch` prints, and ends with its exit code.
const READ_ONLY: &str = r#"
    mount -o loop,errors=remount-ro image disk || { echo "no file system can be mounted here" >&2; exit 77; }
    name=$(losetup --noheadings --output NAME --associated image)
    fault=/sys/fs/ext4/${name##*/}/trigger_fs_error
    [ -w "$fault" ] || { echo "no fault can be made here" >&2; exit 77; }
    mkfifo said
    "$0" launch team.toml --interface lo --json --record disk/runs >results 2>said &
    while read -r line; do
        printf '%s\n' "$line" >&2
        case $line in
        *"episode 2"*) echo here >"$fault"; : >disk/probe && echo "the disk can be written" >&2 ;;
        esac
    done <said
    wait $!
    code=$?
    cp -r disk/runs kept
    cat results
    exit $code
"#;

#[test]
fn a_disk_that_becomes_read_only_in_mid_run_ends_the_records_and_not_the_run() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("disk")).unwrap();
    std::fs::write(path("team.toml"), "team = 815\nmode = \"centralized\"\nrobots = 2\nepisodes = 3\n").unwrap();
    std::fs::File::create(path("image")).unwrap().set_len(16 << 20).unwrap();
    let made = std::process::Command::new("mkfs.ext4").args(["-q", "-m", "0"]).arg(path("image")).output();
    let is_root = nix::unistd::geteuid().is_root();
    if !is_root || !made.is_ok_and(|made| made.status.success()) {
        return skip("mounts", "a disk that becomes read-only needs root and mkfs.ext4");
    }
    let program = murmurate(&[]).get_program().to_owned();
    let mut command = std::process::Command::new("unshare");
    command.args(["--mount", "bash", "-c", READ_ONLY]).arg(program).current_dir(folder.path());
    let output = command.env_remove("MURMURATE_LOG").stdin(std::process::Stdio::null()).output().expect("it starts");
    let said = text(&output.stderr);
    if output.status.code() == Some(77) {
        return skip("mounts", said.lines().last().unwrap_or("no disk can be mounted here"));
    }
    // The run goes on to its end, says at the moment what has happened to which file, and again at the end.
    assert!(!said.contains("the disk can be written"), "{said}");
    let results: serde_json::Value = serde_json::from_slice(&output.stdout).expect("the results");
    assert_eq!((&results["episodes"], &results["interrupted"]), (&3.into(), &false.into()), "{results} {said}");
    let (before, after) = said.split_once("episode 3").expect("the last episode has a result");
    let at_once = before.lines().find(|line| line.contains("can no longer be written")).expect("it is said at once");
    assert!(at_once.contains("Read-only file system") && at_once.contains("disk/runs/"), "{at_once}");
    let last = after.lines().last().expect("an error");
    assert!(last.starts_with("error: every episode has a result") && last.contains("Read-only"), "{last}");
    assert_eq!(output.status.code(), Some(1), "{said}");
    // What was recorded until then is read, named as cut, and runs again.
    let kept = path("kept");
    for record in records(&kept) {
        let reader = Reader::open(&record).expect("it has a beginning");
        let health = reader.health();
        assert!(health.faults.is_empty() && health.cut.is_some() && !health.nothing, "{health:?}");
    }
    let info: serde_json::Value =
        serde_json::from_slice(&run(&["record", "info", "--json", kept.to_str().unwrap()]).stdout).expect("a table");
    let all = info["records"].as_array().expect("records");
    assert!(!all.is_empty() && all.iter().all(|one| one["duration_s"].as_f64().unwrap() > 2.0), "{info}");
    let verdicts: u64 =
        all.iter().flat_map(|one| one["verdicts"].as_object().unwrap().values()).map(|n| n.as_u64().unwrap()).sum();
    assert!(verdicts >= 1, "the first episode is in it: {info}");
    let replayed = run(&["replay", kept.to_str().unwrap()]);
    assert!(replayed.status.success() && text(&replayed.stdout).contains("equal, "), "{replayed:?}");
}
