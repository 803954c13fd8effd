//! What others put in the way of this program: links in shared folders, and texts that a terminal would obey.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::PathBuf;

use crate::program::{murmurate, refuses, run, text};
use tempfile::TempDir;

/// A folder in which everybody can write, and a file beside it that must not change.
struct Shared {
    folder: TempDir,
    target: PathBuf,
}

impl Shared {
    fn new() -> Shared {
        let folder = TempDir::new().expect("a temporary folder");
        let target = folder.path().join("target");
        fs::write(&target, "kept").expect("it can be written");
        fs::create_dir(folder.path().join("shared")).expect("a folder");
        fs::set_permissions(folder.path().join("shared"), Permissions::from_mode(0o1777)).expect("it is mine");
        Shared { folder, target }
    }

    /// Plants a link with this name in the shared folder, which leads to the target, and returns its path.
    fn planted(&self, name: &str) -> String {
        let link = self.folder.path().join("shared").join(name);
        symlink(&self.target, &link).expect("a link");
        link.to_string_lossy().into_owned()
    }

    fn at(&self, name: &str) -> String {
        self.folder.path().join(name).to_string_lossy().into_owned()
    }
}

#[test]
fn a_link_that_was_planted_in_a_shared_folder_is_replaced_and_what_it_leads_to_stays() {
    let place = Shared::new();
    let record = place.at("record");
    let sim = ["sim", "--episodes", "1", "--repeats", "1", "--quiet"];
    assert!(run(&[&sim[..], &["--record", &record]].concat()).status.success());
    let record = fs::read_dir(&record).unwrap().next().expect("a record").unwrap().path();
    let record = record.to_string_lossy();
    let commands: [(&[&str], &str); 7] = [
        (&[&sim[..], &["--trajectories"]].concat(), "paths.csv"),
        (&[&sim[..], &["--svg"]].concat(), "episode.svg"),
        (&[&sim[..], &["--animate"]].concat(), "episode.html"),
        (&["record", "export", &record, "--trajectories"], "states.csv"),
        (&["record", "export", &record, "--messages"], "messages.csv"),
        (&["record", "merge", &record, "--output"], "merged.mcap"),
        (&["key", "new", "--force", "--out"], "team.key"),
    ];
    for (command, name) in commands {
        let link = place.planted(name);
        let output = run(&[command, &[&*link]].concat());
        let said = text(&output.stderr);
        assert!(!said.contains("unexpected argument"), "{command:?}: {said}");
        assert_eq!(fs::read_to_string(&place.target).unwrap(), "kept", "{command:?}: {said}");
        // A record of a simulation has nothing to be merged with.
        assert_eq!(output.status.success(), name != "merged.mcap", "{command:?}: {said}");
        let about = fs::symlink_metadata(&link).expect("it is there");
        assert_eq!(about.is_file() && about.len() > 0, output.status.success(), "{command:?}");
    }
}

#[test]
fn a_link_to_a_folder_in_a_shared_folder_takes_no_output() {
    let place = Shared::new();
    fs::create_dir(place.at("own")).expect("a folder");
    let link = place.folder.path().join("shared/out");
    symlink(place.folder.path().join("own"), &link).expect("a link");
    let out = link.to_string_lossy();
    let commands: [&[&str]; 4] = [
        &["train", "passage", "--steps", "1", "--out", &out],
        &["study", "modes", "--layouts", "1", "--repeats", "1", "--out", &out],
        &["sim", "--episodes", "1", "--repeats", "1", "--record", &out],
        &["man", "--out", &out],
    ];
    for command in commands {
        refuses(command, &["link", "others can write"]);
    }
    assert_eq!(fs::read_dir(place.at("own")).unwrap().count(), 0);
}

/// Links of a team on one machine.
const LINKS: &str = "[link.loopback]\ninterface = \"lo\"\n[link.infra]\ninterface = \"lo\"\n";

/// Characters that a terminal obeys, as parts of a name: clear the screen, a line end, a C1 control, right to left.
const EVIL: &str = "a\u{1b}[2J\nforged: ok\r\u{9b}1m\u{202e}";

/// Checks that no text has a character that a terminal obeys, and that what was in `EVIL` is on no line of its own.
fn is_tame(of: &str, said: &str) {
    let odd = |c: char| c.is_control() && !"\n\t".contains(c) || c == '\u{202e}';
    assert!(!said.contains(odd), "{of}: {said:?}");
    assert!(!said.lines().any(|line| line.starts_with("forged")), "{of}: {said}");
    assert!(said.contains("\\u001b[2J\\nforged") || said.contains("\\u001b[2J"), "{of}: {said}");
}

#[test]
fn names_and_values_of_files_cannot_steer_a_terminal() {
    let folder = TempDir::new().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let source = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    // A name of a file, in errors and in tables.
    let policy = at(&format!("{EVIL}.safetensors"));
    refuses(&["sim", "--policy", &policy], &["\\u001b[2J\\nforged"]);
    fs::copy(source.join("policies/passage.safetensors"), &policy).expect("it can be copied");
    for command in
        [&["policy", "check", &policy][..], &["sim", "--episodes", "1", "--repeats", "1", "--policy", &policy]]
    {
        let output = run(command);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        is_tame(&command.join(" "), &text(&output.stdout));
    }
    // Texts of a manifest.
    let bytes = fs::read(source.join("tests/data/python_full.safetensors")).expect("the file is there");
    let changed = |from: &str, to: &str| {
        let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).expect("it is in the file");
        let longer = to.len() - from.len();
        let mut copy = [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat();
        let header = u64::from_le_bytes(copy[..8].try_into().unwrap()) + longer as u64;
        copy[..8].copy_from_slice(&header.to_le_bytes());
        let file = folder.path().join("changed.safetensors");
        fs::write(&file, copy).expect("it can be written");
        file.to_string_lossy().into_owned()
    };
    // JSON within JSON: without the quotes of the outer one.
    let outer = serde_json::to_string(&serde_json::to_string(EVIL).unwrap()).unwrap();
    let named = changed("\\\"passage\\\"", &outer[1..outer.len() - 1]);
    let output = run(&["policy", "check", &named]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    is_tame("a manifest's scenario", &text(&output.stderr));
    // Values of a team file.
    let team = at("team.toml");
    let escaped = "a\\u001b[2J\\nforged: ok\\r\\u009b1m\\u202e";
    fs::write(&team, format!("team = 1\nmode = \"offboard\"\npolicy = \"{escaped}\"\n{LINKS}"))
        .expect("it can be written");
    is_tame("config show", &text(&run(&["config", "show", &team]).stdout));
    is_tame("config show --json", &text(&run(&["config", "show", &team, "--json"]).stdout));
    let refused = run(&["config", "check", &team]);
    assert_eq!(refused.status.code(), Some(2));
    is_tame("config check", &text(&refused.stderr));
    // The name of a record, and what is attached to it.
    let records = at(&format!("records {EVIL}"));
    let recorded = run(&["sim", "--episodes", "1", "--repeats", "1", "--policy", &policy, "--record", &records]);
    assert_eq!(recorded.status.code(), Some(0), "{}", text(&recorded.stderr));
    let info = run(&["record", "info", &records]);
    is_tame("record info", &text(&info.stdout));
}

#[test]
fn what_a_driver_writes_cannot_steer_a_terminal_and_what_would_run_is_listed() {
    let folder = TempDir::new().expect("a temporary folder");
    let file = folder.path().join("team.toml").to_string_lossy().into_owned();
    let script = "printf '\\033[2Ja\\rb\\n' >&2; while read -r line; do :; done";
    let tracker =
        "while :; do echo '{\"robot\": 0, \"x\": -1.0, \"y\": -1.0}'; read -t 0.02 -r line; [ $? = 1 ] && exit; done";
    let team = format!(
        "team = 5\nscenario = \"swap\"\npolicy = \"orca\"\n[deployment]\nmode = \"bench\"\nrobots = 2\n\
         placement = \"drive\"\nstepping = \"seeded\"\n[[deployment.host]]\nname = \"bench\"\n\
         agents = [[0], [1]]\nactuates = [0]\nlocalizes = [0]\nsimulates = [1]\nstate_server = true\n\
         driver = {{ name = \"program\", command = [\"sh\", \"-c\", {script:?}] }}\n\
         source = {{ name = \"program\", command = [\"bash\", \"-c\", {tracker:?}] }}\n"
    );
    fs::write(&file, team).expect("it can be written");
    let checked = run(&["config", "check", &file]);
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
    let said = text(&checked.stdout);
    let lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines.len(), 4, "{said}");
    assert!(lines[1].contains("runs these programs") && lines[1].contains("rights"), "{said}");
    assert!(lines[2].starts_with("  bench: driver 0: sh -c 'printf ") && lines[2].ends_with("done'"), "{said}");
    assert!(lines[3].starts_with("  bench: source: bash -c 'while "), "{said}");
    let plain = run(&["config", "check", "teams/offboard.toml"]);
    assert_eq!(text(&plain.stdout).lines().count(), 1, "nothing is run there");

    let checked = murmurate(&["doctor", &file, "--listen", "1"]).output().expect("it starts");
    is_tame("doctor", &text(&checked.stderr));
}

#[test]
fn the_programs_of_senses_are_listed_for_each_robot() {
    let folder = TempDir::new().expect("a temporary folder");
    let file = folder.path().join("team.toml").to_string_lossy().into_owned();
    let team = "team = 5\nmode = \"sim\"\nscenario = \"swap\"\npolicy = \"orca\"\nrobots = 2\n[senses.camera]\n\
                kind = \"program\"\ncommand = [\"./camera\"]\nshape = [2]\nunit = \"1\"\n\
                robot.1 = { command = [\"./camera\", \"it's\"] }\n";
    fs::write(&file, team).expect("it can be written");
    let checked = run(&["config", "check", &file]);
    let said = text(&checked.stdout);
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
    for line in ["  world: camera 0: ./camera\n", "  world: camera 1: ./camera 'it'\\''s'\n"] {
        assert!(said.contains(line), "{said}");
    }
}
