//! Task files, wherever a scenario is chosen: the check of a file, simulations and their records, trainings, team
//! files.

use crate::program::{murmurate, refuses, run, text};
use serde_json::Value;
use tempfile::TempDir;

const FOUR_ROOMS: &str = "examples/tasks/four-rooms.toml";
const TEXT: &str = include_str!("../../examples/tasks/four-rooms.toml");

fn file(folder: &TempDir, name: &str, content: &str) -> String {
    let path = folder.path().join(name);
    std::fs::write(&path, content).expect("a temporary file");
    path.to_str().expect("its path is text").to_owned()
}

fn path(of: &std::path::Path) -> &str {
    of.to_str().expect("its path is text")
}

fn json(output: &std::process::Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", text(&output.stderr)))
}

#[test]
fn a_task_is_checked_and_what_cannot_work_is_named() {
    let folder = TempDir::new().expect("a temporary folder");
    let svg = folder.path().join("rooms.svg");
    let output = run(&["task", "check", FOUR_ROOMS, "--json", "--layouts", "8", "--svg", path(&svg)]);
    let checked = json(&output);
    assert!(output.status.success(), "{checked}");
    assert_eq!((&checked["name"], &checked["doors"], &checked["walls"]), (&"four-rooms".into(), &4.into(), &7.into()));
    assert!(std::fs::read_to_string(&svg).expect("the picture").contains("four-rooms"));
    // A wall in place of a door of each of two rooms closes the room between them.
    let closed = TEXT.replace("[-3.0, -0.15, -2.0, 0.15]", "[-3.0, -0.15, -1.0, 0.15]");
    let closed =
        file(&folder, "closed.toml", &closed.replace("[-0.15, -3.0, 0.15, -2.0]", "[-0.15, -3.0, 0.15, -1.0]"));
    let output = run(&["task", "check", &closed, "--layouts", "4"]);
    let said = text(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{said}");
    for expected in ["cannot work: walls: no robot gets", "cannot work: goals: no way leads", "scripted_success: "] {
        assert!(said.contains(expected), "{said}");
    }
    let output = run(&["task", "check", "examples/tasks/navigation.toml", "--layouts", "1", "--json"]);
    assert_eq!(json(&output)["senses"], serde_json::json!(["eyes"]));
    let nose = "\n[senses.nose]\nkind = \"nose\"\n";
    let nose = file(&folder, "nose.toml", &format!("{TEXT}{nose}"));
    refuses(&["sim", "--scenario", &nose], &["nose.toml", "senses.nose.kind: there is no kind of sense 'nose'"]);
    let program =
        format!("{TEXT}\n[senses.cam]\nkind = \"program\"\ncommand = [\"true\"]\nshape = [2]\nunit = \"1\"\n");
    let program = file(&folder, "program.toml", &program);
    refuses(&["sim", "--scenario", &program], &["senses.cam.kind: 'program' runs in real time"]);
    let late = ["task", "check", "examples/tasks/unlabelled-table.toml", "--mode", "onboard-adhoc", "--delay-ms", "20"];
    let output = run(&[&late[..], &["--loss", "0.16", "--layouts", "3", "--json"]].concat());
    let checked = json(&output);
    assert_eq!((&checked["successes"], &checked["robots"]), (&3.into(), &5.into()), "{checked}");
    let apart = include_str!("../../examples/tasks/unlabelled-table.toml");
    let wall = "hull_m = 0.07\nwalls = [{ rect = [-1.54, -0.05, 1.54, 0.05] }]";
    let apart = file(&folder, "apart.toml", &apart.replace("hull_m = 0.07", wall));
    let said = text(&run(&["task", "check", &apart, "--layouts", "1"]).stdout);
    assert!(said.contains("goals: no way leads from start to goal in 1 of 1 layout: first for robot 0"), "{said}");
    refuses(&["task", "check", FOUR_ROOMS, "--mode", "onboard-adhoc", "--loss", "2"], &["--loss: 2 is not 0 to 1"]);
    let wrong = file(&folder, "wrong.toml", &TEXT.replace("limit_s = 60.0", "limit_s = -60.0"));
    refuses(&["task", "check", &wrong], &["wrong.toml", "rules.limit_s: -60 is not 1 to 3600"]);
    let small = file(&folder, "small.toml", &TEXT.replace("[0.7, 0.7, 2.7, 2.7]", "[0.7, 0.7, 0.8, 0.8]"));
    refuses(&["task", "check", &small], &["small.toml", "exchange[3]: it has room for 1 robot with"]);
    refuses(&["task", "check", "nowhere.toml"], &["cannot read the task file 'nowhere.toml'"]);
}

#[test]
fn a_record_of_a_task_file_is_replayed_without_the_file() {
    let folder = TempDir::new().expect("a temporary folder");
    let task = file(&folder, "rooms.toml", TEXT);
    let records = folder.path().join("records");
    let run_in = |args: &[&str]| {
        let output = murmurate(args).current_dir(folder.path()).output().expect("the program starts");
        assert!(output.status.success(), "{args:?}: {}", text(&output.stderr));
        text(&output.stdout)
    };
    let sim = ["sim", "--scenario", "rooms.toml", "--policy", "orca", "--robots", "4", "--mode", "offboard"];
    let few = ["--episodes", "1", "--repeats", "1", "--quiet", "--record", "records"];
    run_in(&[&sim[..], &few].concat());
    // Another task is there now.
    std::fs::write(&task, TEXT.replace("[2.0, -0.15, 3.0, 0.15]", "[2.1, -0.15, 3.0, 0.15]")).expect("it is written");
    let said = run_in(&["replay", path(&records.join("repeat-0000.mcap"))]);
    std::fs::remove_file(&task).expect("it is there");
    let again = run_in(&["replay", path(&records.join("repeat-0000.mcap"))]);
    assert_eq!(said, again);
}

#[test]
fn names_of_scenarios_are_refused_with_a_hint_and_a_team_file_names_a_task_beside_it() {
    refuses(&["sim", "--scenario", "maze"], &["'maze'", "passage"]);
    refuses(&["sim", "--scenario", "maze.toml"], &["--scenario: ", "maze.toml"]);
    let folder = TempDir::new().expect("a temporary folder");
    let named = file(&folder, "named.toml", &TEXT.replace("\"four-rooms\"", "\"passage\""));
    refuses(&["sim", "--scenario", &named], &["name: 'passage' is a scenario of this program"]);
    file(&folder, "rooms.toml", TEXT);
    let team = "team = 1\nmode = \"offboard\"\nscenario = \"rooms.toml\"\npolicy = \"orca\"\n[link.loopback]\n\
                interface = \"lo\"\n[link.infra]\ninterface = \"lo\"\n";
    let team_file = file(&folder, "team.toml", team);
    let output = run(&["config", "check", &team_file]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let wrong = file(&folder, "wrong.toml", &team.replace("rooms.toml", "room.toml"));
    refuses(&["config", "check", &wrong], &["scenario (line 3): ", "room.toml"]);
}

#[test]
fn a_training_keeps_its_task_and_a_changed_file_does_not_continue_it() {
    let folder = TempDir::new().expect("a temporary folder");
    let task = file(&folder, "rooms.toml", TEXT);
    let out = folder.path().join("run");
    let args = ["train", &task, "--robots", "4", "--preset", "any-size", "--steps", "200", "--quiet", "--out"];
    let small = ["--set", "ppo.environments=4", "--set", "ppo.minibatch=32"];
    let args = [&args[..], &[path(&out)], &small].concat();
    let output = run(&args);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let config = std::fs::read_to_string(out.join("config.toml")).expect("it is there");
    assert!(config.contains("arrival = 5.0") && config.contains("wall = 8.0"), "{config}");
    let policy = out.join("policy.safetensors");
    let policy = path(&policy);
    refuses(&["policy", "check", policy], &["'four-rooms'", "--scenario"]);
    assert!(run(&["policy", "check", policy, "--scenario", &task]).status.success());
    let sim = ["sim", "--scenario", &task, "--robots", "4", "--policy", policy, "--episodes", "1", "--repeats", "1"];
    assert!(run(&sim).status.success());
    std::fs::write(&task, TEXT.replace("limit_s = 60.0", "limit_s = 50.0")).expect("it is written");
    let again = [&args[..], &["--resume"]].concat();
    refuses(&again, &["cannot resume", "its task file was another"]);
}
