//! Scale of a task and hull of its robots, wherever a scenario is chosen: flags, deployments, conditions, team files
//! and trainings.

use std::path::Path;

use crate::program::{refuses, run, text};
use serde_json::Value;
use tempfile::TempDir;

/// Four small robots, as flags.
const SMALL: [&str; 6] = ["--robots", "4", "--scale", "0.375", "--hull-m", "0.06"];
const SIM: [&str; 9] = ["sim", "--scenario", "swap", "--policy", "orca", "--quiet", "--json", "--episodes", "4"];

fn file(folder: &TempDir, name: &str, content: &str) -> String {
    let path = folder.path().join(name);
    std::fs::write(&path, content).expect("a temporary file");
    path.to_str().expect("its path is text").to_owned()
}

/// The result of a command with `--json`.
fn json(args: &[&str]) -> Value {
    let output = run(args);
    assert!(output.status.success(), "{args:?}: {}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("a result is JSON")
}

fn sim(flags: &[&str]) -> Value {
    json(&[&SIM[..], &["--repeats", "1"], flags].concat())
}

#[test]
fn small_robots_stay_on_small_ground_and_flags_files_and_conditions_give_one_trace() {
    let folder = TempDir::new().expect("a temporary folder");
    let csv = folder.path().join("paths.csv");
    let mode = ["--mode", "offboard"];
    let flags = sim(&[&mode[..], &SMALL, &["--trajectories", csv.to_str().unwrap()]].concat());
    assert_eq!(flags["successes"], 4, "{flags}");
    let rows = std::fs::read_to_string(&csv).expect("the trajectories");
    let mut lines = rows.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let [x, y] = ["x_m", "y_m"].map(|name| header.iter().position(|column| *column == name).expect("the column"));
    for line in lines {
        let row: Vec<&str> = line.split(',').collect();
        let within = |at: usize| row[at].parse::<f32>().expect("a number").abs() <= 0.7501;
        assert!(within(x) && within(y), "beyond 1.5 m x 1.5 m: {line}");
    }
    let deployment = run(&["deployment", "offboard", "--robots", "4"]);
    let deployment = text(&deployment.stdout);
    let sized = format!("scale = 0.375\nhull_m = 0.06\n{deployment}");
    let sized = file(&folder, "deployment.toml", &sized);
    let of_file = sim(&["--deployment", &sized]);
    assert_eq!(of_file["trace_hash"], flags["trace_hash"], "a deployment file has the same fields");
    let conditions = file(&folder, "conditions.toml", "scale = 0.375\nhull_m = 0.06\n");
    let of_conditions = sim(&[&mode[..], &["--robots", "4", "--conditions", &conditions]].concat());
    assert_eq!(of_conditions["trace_hash"], flags["trace_hash"], "and conditions");
    let over = sim(&["--deployment", &sized, "--hull-m", "0.08"]);
    assert_ne!(over["trace_hash"], flags["trace_hash"], "a flag counts before the file");
}

#[test]
fn the_default_size_may_be_written() {
    for scenario in ["passage", "swap"] {
        let of = |flags: &[&str]| {
            let args = ["sim", "--scenario", scenario, "--policy", "orca", "--mode", "offboard", "--episodes", "2"];
            json(&[&args[..], &["--repeats", "1", "--json", "--quiet"], flags].concat())["trace_hash"].clone()
        };
        assert_eq!(of(&[]), of(&["--scale", "1", "--hull-m", "0.16"]), "{scenario}");
        assert_ne!(of(&[]), of(&["--scale", "1.1"]), "{scenario}");
    }
}

#[test]
fn small_robots_with_the_filter_collide_with_nobody_in_both_worlds() {
    for (scenario, plant) in [("swap", "kinematic"), ("swap", "rigid"), ("passage", "rigid")] {
        let args = ["sim", "--scenario", scenario, "--policy", "orca", "--mode", "onboard-adhoc", "--plant", plant];
        let size = ["--scale", "0.5", "--hull-m", "0.08", "--safety", "deployed", "--episodes", "6", "--repeats", "1"];
        let result = json(&[&args[..], &size, &["--json", "--quiet"]].concat());
        assert_eq!(result["robot_collisions"], 0, "{scenario} in {plant}: {result}");
        assert_eq!(result["wall_collisions"], 0, "{scenario} in {plant}: {result}");
        assert!(result["successes"].as_u64() >= Some(4), "{scenario} in {plant}: {result}");
    }
}

#[test]
fn what_cannot_work_is_refused_by_the_flag_or_the_field_and_its_file() {
    let folder = TempDir::new().expect("a temporary folder");
    refuses(&["sim", "--hull-m", "0.6"], &["--hull-m: ", "'passage'", "gap of 1 m", "of at most"]);
    refuses(&["sim", "--scale", "0.3"], &["--scale: ", "of at least"]);
    refuses(&["sim", "--scenario", "swap", "--scale", "0.375"], &["--scale: ", "hull_m"]);
    refuses(&["sim", "--hull-m", "nan"], &["--hull-m: ", "0.01 to 0.85 m"]);
    refuses(&["sim", "--scale=-1"], &["--scale: ", "0.05 to 20"]);
    refuses(&["sim", "--gap-m", "0.4"], &["--gap-m: ", "0.6 to 3 m"]);
    refuses(&["sim", "--scenario", "swap", "--gap-m", "1"], &["--gap-m: ", "no walls"]);
    refuses(&["study", "modes", "--scale", "0.3"], &["--scale: "]);
    refuses(&["train", "passage", "--hull-m", "0.6", "--print-config"], &["--hull-m: "]);
    let conditions = file(&folder, "c.toml", "hull_m = 0.6\n");
    refuses(&["sim", "--conditions", &conditions], &["the conditions file", "c.toml': hull_m: "]);
    let deployment = text(&run(&["deployment", "offboard"]).stdout);
    let deployment = file(&folder, "d.toml", &format!("scale = 0.3\n{deployment}"));
    refuses(&["sim", "--deployment", &deployment], &["the deployment file", "d.toml': scale: "]);
}

#[test]
fn a_team_file_has_the_size_and_its_robots_keep_apart_by_their_hulls() {
    let folder = TempDir::new().expect("a temporary folder");
    let team = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("teams/offboard.toml"))
        .unwrap();
    let team = team.replace("scenario = \"passage\"\n", "");
    let with = |name: &str, head: &str, tail: &str| file(&folder, name, &format!("{head}\n{team}\n{tail}"));
    let small = with("small.toml", "scenario = \"swap\"\nrobots = 4\nscale = 0.375\nhull_m = 0.06", "");
    let shown = text(&run(&["config", "show", &small]).stdout);
    let value = |key: &str| {
        let line = shown.lines().find(|line| line.split_whitespace().next() == Some(key));
        line.unwrap_or_else(|| panic!("no {key} in {shown}")).split_whitespace().nth(1).expect("a value").to_owned()
    };
    let near = |key: &str, wanted: f32| (value(key).parse::<f32>().expect("a number") - wanted).abs() < 1e-4;
    assert!(near("scale", 0.375) && near("hull_m", 0.06), "{shown}");
    assert!(near("safety.distance_min_m", 0.2) && near("safety.walls_min_m", 0.1), "{shown}");
    let own = with("own.toml", "scenario = \"swap\"\nrobots = 4\nhull_m = 0.06", "[safety]\ndistance_min_m = 0.3");
    let shown = text(&run(&["config", "show", &own]).stdout);
    assert!(shown.lines().any(|line| line.starts_with("safety.distance_min_m") && line.contains("0.3")), "{shown}");
    let wide = with("wide.toml", "scenario = \"swap\"\nrobots = 4\nscale = 0.375", "");
    refuses(&["config", "check", &wide], &["scale (line 3)", "hull_m"]);
}

#[test]
fn a_training_keeps_its_size_in_its_configuration() {
    let printed = text(&run(&["train", "passage", "--scale", "0.5", "--hull-m", "0.08", "--print-config"]).stdout);
    assert!(printed.contains("scale = 0.5") && printed.contains("hull_m = 0.08"), "{printed}");
    let folder = TempDir::new().expect("a temporary folder");
    let config = file(&folder, "small.toml", &printed);
    let again = text(&run(&["train", "passage", "--config", &config, "--print-config"]).stdout);
    assert!(again.contains("scale = 0.5") && again.contains("hull_m = 0.08"), "{again}");
    let flocking = text(&run(&["train", "flocking", "--scale", "2", "--print-config"]).stdout);
    assert!(flocking.contains("scale = 2"), "{flocking}");
}

#[test]
fn a_study_of_another_size_says_so() {
    let study =
        ["study", "modes", "--columns", "sim", "--policy", "orca", "--layouts", "1", "--repeats", "1", "--quiet"];
    let report = json(&[&study[..], &["--scale", "0.5", "--hull-m", "0.08", "--json"]].concat());
    assert_eq!(report["scenario"], "passage, 5 robots, scale 0.5, hull 0.08 m");
}
