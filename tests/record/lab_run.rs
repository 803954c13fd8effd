//! A run from elsewhere: what a record of hosts tells of lag, slip, delay and loss is told again by the same run as CSV
//! and as a bag, and what files do not hold is named.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::program::skip::skip;
use crate::program::{refuses, run, text};
use crate::readers::python;
use crate::records;

use crate::twin::{DELAY_S, LOSS, recorded, rows};

/// Beginning of the mapping of a run of the robots of `twin.rs`, whose drivetrain has these limits.
const TEAM: &str = r#"
robots = 3
period_s = 0.05
task = "passage"

[limits]
speed_m_s = 2.5
axis_m_s2 = 1.0
total_m_s2 = 6.0
"#;

const COLUMNS: &str = r#"
[poses]
time = "time_s"
robot = "robot"
x = "x_m"
y = "y_m"
yaw = "heading_rad"
velocity = ["vx_m_s", "vy_m_s"]
touches = ["touches_robot", "touches_wall"]

[commands]
frame = "world"
x = "command_x_m_s"
y = "command_y_m_s"

[receipts]
path = "receipts.csv"
sent = "sent_s"
received = "received_s"
sender = "from"
receiver = "to"
"#;

/// Report of `study twin` on `record`.
fn twin(record: &Path) -> Value {
    let output = run(&["study", "twin", record.to_str().expect("UTF-8"), "--repeats", "2", "--json", "--quiet"]);
    assert!(matches!(output.status.code(), Some(0 | 1)), "{}", text(&output.stderr));
    let report = rows(&text(&output.stdout));
    assert_eq!(report["agrees"], output.status.success(), "{report}");
    report
}

/// Imports the mapping with this text, in a folder with the files that it names, and returns the report of its twin.
fn imported(folder: &Path, name: &str, mapping: &str) -> Value {
    let (toml, record) = (folder.join(format!("{name}.toml")), folder.join(format!("{name}.mcap")));
    std::fs::write(&toml, mapping).expect("the folder is there");
    let [toml, to] = [&toml, &record].map(|path| path.to_str().expect("UTF-8"));
    let output = run(&["record", "import", toml, "-o", to]);
    assert!(output.status.success(), "{name}: {}", text(&output.stderr));
    twin(&record)
}

/// Fitted value of a row, and its interval.
fn fitted(report: &Value, name: &str) -> (f64, [f64; 2]) {
    let all = report["rows"].as_array().expect("rows");
    let row = all.iter().find(|row| row["name"] == name).unwrap_or_else(|| panic!("no row '{name}': {report}"));
    let number = |value: &Value| value.as_f64().expect("a number");
    let of = &row["predicted"];
    (number(&of["value"]), [number(&of["ci95"][0]), number(&of["ci95"][1])])
}

/// Checks that a quantity of an imported run lies in the interval of the same quantity of the record.
fn agrees(record: &Value, import: &Value, name: &str) {
    let ((_, [low, high]), (value, _)) = (fitted(record, name), fitted(import, name));
    // The interval of episodes that were cut otherwise is as wide.
    let reach = (high - low).max(1e-9);
    assert!(
        (low - reach / 2.0..=high + reach / 2.0).contains(&value),
        "{name}: {value}, in the record {low} to {high}"
    );
}

/// Names of the quantities that a report calls not fitted.
fn missing(report: &Value) -> Vec<&str> {
    let all = report["not_fitted"].as_array().expect("a list");
    all.iter().map(|one| one["quantity"].as_str().expect("a name")).collect()
}

/// Writes the receipts of the latents between the hosts of three robots as CSV, from the tables of their messages.
fn write_receipts(hosts: &Path, folder: &Path) {
    let mut sent: BTreeMap<(String, String), (String, String)> = BTreeMap::new();
    let mut arrived: BTreeMap<(String, String, String), String> = BTreeMap::new();
    for record in records(hosts).iter().filter(|path| path.to_string_lossy().contains("robot-")) {
        let table = folder.join("messages.csv");
        let [record, to] = [record, &table].map(|path| path.to_str().expect("UTF-8"));
        assert!(run(&["record", "export", record, "--messages", to]).status.success());
        for line in std::fs::read_to_string(&table).expect("the table is there").lines().skip(1) {
            let cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            let [time, event, host, _, sender, _, number, kind, _] = &cells[..] else { panic!("{line}") };
            let robot = host.trim_start_matches("robot-").to_owned();
            if kind != "Latent" {
                continue;
            }
            let key = (sender.clone(), number.clone());
            if event == "published" {
                sent.insert(key, (time.clone(), robot));
            } else {
                arrived.entry((key.0, key.1, robot)).or_insert(time.clone());
            }
        }
    }
    let mut csv = "sent_s,received_s,from,to\n".to_owned();
    for ((sender, number), (sent_s, from)) in &sent {
        for to in ["0", "1", "2"].iter().filter(|to| *to != from) {
            let received = arrived.get(&(sender.clone(), number.clone(), (*to).to_owned()));
            csv += &format!("{sent_s},{},{from},{to}\n", received.map_or("", |time| time));
        }
    }
    std::fs::write(folder.join("receipts.csv"), csv).expect("the folder is there");
}

#[test]
fn a_run_as_csv_or_as_a_bag_tells_what_its_record_tells() {
    let (folder, hosts) = recorded(16);
    let folder = folder.path();
    let record = twin(&hosts);
    let world = records(&hosts).into_iter().find(|path| path.to_string_lossy().contains("world")).expect("a world");
    let table = folder.join("run.csv");
    let [world, csv] = [&world, &table].map(|path| path.to_str().expect("UTF-8"));
    assert!(run(&["record", "export", world, "--trajectories", csv]).status.success());
    write_receipts(&hosts, folder);

    // Of an emulated run the record has no phases, of which the table would have its episodes.
    let head = "format = \"csv\"\npath = \"run.csv\"\nepisodes = 8.0";
    let import = imported(folder, "csv", &format!("{head}{TEAM}{COLUMNS}"));
    for name in ["drivetrain lag", "slip"] {
        agrees(&record, &import, name);
    }
    let value = |name: &str| fitted(&import, name).0;
    assert!((value("all links, delay") - 1e3 * DELAY_S).abs() < 0.1, "{import}");
    assert!((value("all links, loss") - 1e2 * LOSS).abs() < 2.0, "{import}");
    assert_eq!(missing(&import), ["ticks", "success, makespan and message ages"]);

    // Without velocities they are the differences of the positions, which are half a period old.
    let plain = COLUMNS.replace("velocity = [\"vx_m_s\", \"vy_m_s\"]\n", "").replace("[receipts]", "[unused]");
    let plain = &plain[..plain.find("[unused]").expect("a table")];
    let import = imported(folder, "differences", &format!("{head}{TEAM}{plain}"));
    assert!((fitted(&import, "drivetrain lag").0 - 0.5).abs() < 0.03, "{import}");
    assert_eq!(missing(&import)[..2], ["slip", "delay and loss"]);

    let Some(python) = python("rosbags") else {
        return skip("readers", "RECORD_PYTHON is no Python with rosbags, which writes bags");
    };
    for storage in ["mcap", "sqlite3"] {
        let to = folder.join(storage);
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/lab_run/bags.py");
        let made = Command::new(&python).arg(script).arg(&table).arg(&to).arg(storage).output().expect("it starts");
        assert!(made.status.success(), "{}", text(&made.stderr));
        let head = format!("format = \"rosbag2\"\npath = \"{storage}\"\nstamps = \"header\"\nepisodes = 8.0");
        let topics = "[poses]\ntopic = \"/r{robot}/odom\"\n[commands]\ntopic = \"/r{robot}/cmd_vel\"\n";
        let import = imported(folder, &format!("of-{storage}"), &format!("{head}{TEAM}{topics}"));
        for name in ["drivetrain lag", "slip"] {
            agrees(&record, &import, name);
        }
    }
}

#[test]
fn an_imported_record_is_shown_exported_and_described_but_not_replayed() {
    let folder = tempfile::TempDir::new().expect("a folder");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/lab_run/run.csv");
    std::fs::copy(&data, folder.path().join("run.csv")).expect("the folder is there");
    let mapping = "format = \"csv\"\npath = \"run.csv\"\nrobots = [\"0\", \"1\"]\nperiod_s = 0.1\n\
        episodes = \"episode\"\nhull_m = 0.2\n[axes]\nmove_m = [10.0, 0.0]\nturn_rad = 1.5707963267948966\n\
        [poses]\ntime = \"time_s\"\nrobot = \"robot\"\nx = \"x_m\"\ny = \"y_m\"\n";
    let report = imported(folder.path(), "poses", mapping);
    assert_eq!(missing(&report)[..2], ["lag and slip", "delay and loss"]);
    assert_eq!((&report["rows"], &report["agrees"]), (&serde_json::json!([]), &Value::from(false)));

    let record = folder.path().join("poses.mcap");
    let record = record.to_str().expect("UTF-8");
    let said = text(&run(&["record", "info", record]).stdout);
    assert!(said.contains("a run from elsewhere") && said.contains("/truth") && said.contains("poses.toml"), "{said}");
    let model = folder.path().join("model");
    let to = model.to_str().expect("UTF-8");
    let given = ["--given", "delay_s=0.02", "--given", "loss=0.1", "--out", to];
    let output = run(&[&["study", "twin", record][..], &given].concat());
    assert_eq!(output.status.code(), Some(1), "nothing was fitted: {}", text(&output.stderr));
    assert!(text(&output.stdout).contains("nothing is compared"), "{}", text(&output.stdout));
    let conditions = std::fs::read_to_string(model.join("conditions.toml")).expect("it is written");
    assert!(conditions.contains("delay_s = 0.02") && conditions.contains("loss = 0.1"), "{conditions}");
    let table = folder.path().join("again.csv");
    let to = table.to_str().expect("UTF-8");
    assert!(run(&["record", "export", record, "--trajectories", to]).status.success());
    let rows = std::fs::read_to_string(&table).expect("the table is there");
    // The first pose has no difference to one before it. (0.0866, 1.2610) turned by a quarter and moved by 10.
    let second: Vec<&str> = rows.lines().nth(1).expect("a row").split(',').collect();
    let number = |at: usize| second[at].parse::<f64>().expect("a number");
    let [x, y] = first_of_robot_0_after(&data);
    assert!((number(4) - (10.0 - y)).abs() < 1e-5 && (number(5) - x).abs() < 1e-5, "{rows}");
    assert_eq!(second[1], "running");
    refuses(&["replay", record], &["run from elsewhere", "--watch"]);
    refuses(&["record", "merge", record, "-o", to], &["imported"]);
    let again = folder.path().join("poses.toml");
    let again = again.to_str().expect("UTF-8");
    refuses(&["record", "import", again, "-o", record], &["--output", "there already"]);
    std::fs::write(again, mapping.replace("\"episode\"", "3.0")).expect("the folder is there");
    let few = folder.path().join("few.mcap");
    let few = few.to_str().expect("UTF-8");
    assert!(run(&["record", "import", again, "-o", few]).status.success());
    refuses(&["study", "twin", few], &["2 episodes", "at least 4", "episodes = 10.0"]);
}

/// Position of robot 0 in the second of its rows.
fn first_of_robot_0_after(table: &Path) -> [f64; 2] {
    let text = std::fs::read_to_string(table).expect("the table is there");
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let row = rows.iter().filter(|row| row[2] == "0").nth(1).expect("two rows");
    [3, 4].map(|at| row[at].parse().expect("a number"))
}

#[test]
fn delays_of_different_clocks_are_not_fitted_and_receipts_outside_of_the_poses_do_not_count() {
    let folder = tempfile::TempDir::new().expect("a folder");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/lab_run/run.csv");
    std::fs::copy(&data, folder.path().join("run.csv")).expect("the folder is there");
    let mapping = "format = \"csv\"\npath = \"run.csv\"\nrobots = [\"0\", \"1\"]\nperiod_s = 0.1\n\
        episodes = \"episode\"\n\
        [poses]\ntime = \"time_s\"\nrobot = \"robot\"\nx = \"x_m\"\ny = \"y_m\"\n\
        [receipts]\npath = \"receipts.csv\"\nsent = \"sent\"\nreceived = \"received\"\nsender = \"from\"\n\
        receiver = \"to\"\n";
    let text = std::fs::read_to_string(&data).expect("the table is there");
    let times = text.lines().skip(1).map(|line| line.split(',').nth(1).expect("a time").parse::<f64>());
    let times: Vec<f64> = times.map(|time| time.expect("a number")).collect();
    // The receiver's clock is a second behind. Of ten messages one is lost.
    let mut receipts = "sent,received,from,to\n".to_owned();
    for (at, time) in times.iter().step_by(2).enumerate() {
        let received = if at % 10 == 9 { String::new() } else { (time - 0.98).to_string() };
        receipts += &format!("{time},{received},0,1\n");
    }
    let after = times.iter().copied().fold(0.0, f64::max) + 60.0;
    for late in 0..50 {
        receipts += &format!("{},,0,1\n", after + f64::from(late));
    }
    std::fs::write(folder.path().join("receipts.csv"), receipts).expect("the folder is there");
    let report = imported(folder.path(), "clocks", mapping);
    assert_eq!(missing(&report)[..2], ["lag and slip", "delay"]);
    assert!(report["notes"].to_string().contains("50 receipts left out"), "{report}");
    assert!(report["notes"].to_string().contains("one clock"), "{report}");
    assert!(fitted(&report, "all links, loss").0 < 15.0, "{report}");
}
