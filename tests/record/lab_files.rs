//! Mappings, CSV files and bags that are wrong: each of many mutations is refused in one line that names the file and
//! the place in it, or is read; nothing panics. And each field of a mapping that is wrong is named.

use std::path::{Path, PathBuf};

use murmurate::random::Seed;
use murmurate::registry::Registry;
use rand::RngExt;
use tempfile::TempDir;

const CSV: &str = r#"format = "csv"
path = "run.csv"
robots = 2
period_s = 0.1
episodes = "episode"
task = "passage"
hull_m = 0.16
half_extent_m = [2.0, 3.0]

[units]
length = "m"
angle = "rad"
time = "s"

[axes]
turn_rad = 0.5
move_m = [1.0, -1.0]

[limits]
speed_m_s = 2.5

[poses]
time = "time_s"
robot = "robot"
x = "x_m"
y = "y_m"
yaw = "heading_rad"
velocity = ["vx_m_s", "vy_m_s"]

[commands]
frame = "world"
x = "command_x_m_s"
y = "command_y_m_s"
"#;

const BAG: &str = r#"format = "rosbag2"
path = "BAG"
robots = 2
period_s = 0.1
episodes = [[0.0, 1.0], [1.0, 2.0], [2.0, 3.0], [3.0, 4.0]]

[poses]
topic = "/r{robot}/pose"

[commands]
topic = "/r{robot}/cmd_vel"
"#;

/// A folder with the files of the run: a table, and a bag of each storage in a folder of its own.
fn files() -> TempDir {
    let folder = TempDir::new().expect("a folder");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/lab_run");
    let bytes = |name: &str| std::fs::read(data.join(name)).expect("the file is there");
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).expect("it can be written");
    write("run.csv", &bytes("run.csv"));
    for (storage, file) in [("sqlite3", "bag.db3"), ("mcap", "bag.mcap")] {
        std::fs::create_dir(folder.path().join(storage)).expect("it can be made");
        let (packed, mut plain) = (bytes(&format!("{file}.zst")), Vec::new());
        let mut decoder = ruzstd::decoding::StreamingDecoder::new(&packed[..]).expect("it is of zstd");
        std::io::Read::read_to_end(&mut decoder, &mut plain).expect("it is whole");
        write(&format!("{storage}/{file}"), &plain);
        let metadata = String::from_utf8(bytes("metadata.yaml")).expect("text");
        let metadata = metadata.replace("bag.db3", file).replace("sqlite3", storage);
        write(&format!("{storage}/metadata.yaml"), metadata.as_bytes());
    }
    folder
}

/// Imports the run of a mapping. An error is one line.
fn import(folder: &Path, mapping: &str) -> Result<(usize, usize), String> {
    let path = folder.join("mapping.toml");
    std::fs::write(&path, mapping).expect("it can be written");
    imported(&path)
}

fn imported(path: &Path) -> Result<(usize, usize), String> {
    let read = murmurate_import::read(path, &Registry::builtin()).map_err(|error| error.to_string());
    let said = read.map(|run| (run.steps.steps.len(), run.samples.commands.iter().map(Vec::len).sum()));
    if let Err(why) = &said {
        assert!(!why.is_empty() && !why.contains(['\n', '\r']), "{why}");
        assert!(why.len() < 2000, "{why}");
    }
    said
}

#[test]
fn the_files_of_a_run_are_read_and_all_forms_hold_the_same() {
    let folder = files();
    let of_csv = import(folder.path(), CSV).expect("it is sound");
    assert_eq!(of_csv, (82, 82));
    for bag in ["sqlite3", "mcap", "sqlite3/bag.db3", "mcap/bag.mcap"] {
        // Without velocities the first pose of each robot and episode is no step, and the last is not before 4 s.
        let (steps, commands) = import(folder.path(), &BAG.replace("BAG", bag)).expect("it is sound");
        assert!((70..=74).contains(&steps) && commands == 82, "{bag}: {steps}");
    }
}

#[test]
fn units_and_columns_of_each_robot_change_nothing() {
    let folder = files();
    let table = folder.path().join("run.csv");
    let steps = |mapping: &str| {
        let path = folder.path().join("mapping.toml");
        std::fs::write(&path, mapping).expect("it can be written");
        murmurate_import::read(&path, &Registry::builtin()).expect("it is sound").steps.steps
    };
    let metres = steps(CSV);
    let text = std::fs::read_to_string(&table).expect("the table is there");
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let scaled = |row: &Vec<&str>, columns: std::ops::Range<usize>, factor: f64| -> Vec<String> {
        row[columns].iter().map(|cell| (cell.parse::<f64>().expect("a number") * factor).to_string()).collect()
    };
    // One row for both robots, in millimetres, degrees and nanoseconds.
    let mut wide = "part,at,x0,y0,u0,v0,a0,p0,q0,x1,y1,u1,v1,a1,p1,q1\n".to_owned();
    for pair in rows.chunks(2) {
        let time = scaled(&pair[0], 1..2, 1e9);
        let of_robot = |row: &Vec<&str>| {
            [scaled(row, 3..7, 1e3), scaled(row, 7..8, 180.0 / std::f64::consts::PI), scaled(row, 8..10, 1e3)].concat()
        };
        let cells = [time, of_robot(&pair[0]), of_robot(&pair[1])].concat();
        wide += &format!("{},{}\n", pair[0][0], cells.join(","));
    }
    std::fs::write(&table, wide).expect("it can be written");
    let mut mapping = CSV.replace("robot = \"robot\"\n", "").replace("\"episode\"", "\"part\"");
    for (from, to) in [
        ("\"m\"", "\"mm\""),
        ("\"rad\"", "\"deg\""),
        ("\"s\"", "\"ns\""),
        ("time_s", "at"),
        ("\"x_m\"", "\"x{robot}\""),
        ("\"y_m\"", "\"y{robot}\""),
        ("\"vx_m_s\"", "\"u{robot}\""),
        ("\"vy_m_s\"", "\"v{robot}\""),
        ("heading_rad", "a{robot}"),
        ("command_x_m_s", "p{robot}"),
        ("command_y_m_s", "q{robot}"),
    ] {
        mapping = mapping.replace(from, to);
    }
    let millimetres = steps(&mapping);
    assert_eq!(metres.len(), millimetres.len());
    for (one, other) in metres.iter().zip(&millimetres) {
        assert_eq!((one.robot, one.episode), (other.robot, other.episode));
        let near = |one: [f64; 2], other: [f64; 2]| (0..2).all(|axis| (one[axis] - other[axis]).abs() < 1e-9);
        assert!(near(one.position, other.position) && near(one.velocity, other.velocity), "{one:?} {other:?}");
        assert!(near(one.command, other.command) && (one.heading - other.heading).abs() < 1e-9, "{one:?} {other:?}");
    }
}

#[test]
fn each_wrong_field_of_a_mapping_is_named() {
    let folder = files();
    for (from, to, words) in [
        ("format = \"csv\"", "format = \"xml\"", &["line 1", "format"][..]),
        ("path = \"run.csv\"\n", "", &["path"]),
        ("run.csv", "none.csv", &["none.csv", "No such file"]),
        ("robots = 2", "robots = 0", &["robots: 0 is not"]),
        ("robots = 2", "robots = [\"1\", \"1\"]", &["robots", "one name"]),
        ("robots = 2", "robots = [\"0\", \"two\"]", &["run.csv", "line 3", "'robot'", "no robot"]),
        ("robots = 2", "robots = true", &["line 3", "a number of robots"]),
        ("period_s = 0.1", "period_s = 0.0", &["period_s: 0 is not"]),
        ("period_s = 0.1", "period_s = 0.05", &["period_s", "every 0.1"]),
        ("episodes = \"episode\"", "episodes = \"part\"", &["run.csv", "episodes", "no column 'part'"]),
        ("episodes = \"episode\"", "episodes = -1.0", &["episodes: -1 is not"]),
        ("episodes = \"episode\"", "episodes = [[2.0, 1.0]]", &["episodes", "[begin, end]"]),
        ("episodes = \"episode\"", "episodes = [[100.0, 200.0]]", &["episodes", "no pose belongs"]),
        ("task = \"passage\"", "task = \"pasage\"", &["task", "pasage"]),
        ("hull_m = 0.16", "hull_m = 0.0", &["hull_m: 0 is not"]),
        ("half_extent_m = [2.0, 3.0]", "half_extent_m = [2.0]", &["line 8", "half_extent_m"]),
        ("length = \"m\"", "length = \"ft\"", &["line 11", "length"]),
        ("turn_rad = 0.5", "turn_rad = nan", &["axes.turn_rad"]),
        ("turn_rad = 0.5", "turn_deg = 0.5", &["line 16", "turn_deg"]),
        ("speed_m_s = 2.5", "speed_m_s = -2.5", &["limits.speed_m_s"]),
        ("x = \"x_m\"\n", "", &["poses.x", "missing"]),
        ("\"x_m\"", "\"x\"", &["run.csv", "poses.x", "no column 'x'", "x_m, y_m"]),
        ("robot = \"robot\"\n", "", &["poses.robot", "{robot}"]),
        ("frame = \"world\"\n", "", &["commands.frame", "\"body\""]),
        ("frame = \"world\"", "frame = \"lab\"", &["frame"]),
        ("yaw = \"heading_rad\"", "topic = \"/odom\"", &["poses.topic", "no topics"]),
        ("format = \"csv\"", "format = \"rosbag2\"", &["episodes", "no columns"]),
    ] {
        let mapping = CSV.replacen(from, to, 1);
        assert_ne!(mapping, CSV, "{from}");
        let why = import(folder.path(), &mapping).expect_err(to);
        assert!(why.contains("mapping.toml") || why.contains(".csv"), "{to}: {why}");
        words.iter().for_each(|word| assert!(why.contains(word), "{to}: '{word}' is not in: {why}"));
    }
    let body = CSV.replace("yaw = \"heading_rad\"\n", "").replace("\"world\"", "\"body\"");
    assert!(import(folder.path(), &body).expect_err("no yaw").contains("commands.frame"));
    for (from, to, words) in [
        ("/r{robot}/pose", "/r{robot}/odom", &["poses.topic", "no topic '/r0/odom'", "/r0/pose"][..]),
        ("/r{robot}/pose", "/r0/pose", &["poses.topic", "{robot}"]),
        ("\"/r{robot}/pose\"", "[\"/r0/pose\"]", &["poses.topic", "1 topics", "2 robots"]),
        ("/r{robot}/pose", "/r{robot}/cmd_vel", &["commands.topic", "a topic of poses, too"]),
        ("robots = 2", "stamps = \"header\"\nrobots = 2", &["message 1 of '/r0/cmd_vel'", "no stamp"]),
        ("robots = 2", "robots = 2\nunits = {}", &["units", "metres"]),
        ("path = \"sqlite3\"", "path = \"sqlite3/metadata.yaml\"", &["metadata.yaml", ".mcap or .db3"]),
        ("path = \"sqlite3\"", "path = \".\"", &["metadata.yaml", "reindex"]),
        ("path = \"sqlite3\"", "path = \"none\"", &["none", "No such file"]),
    ] {
        let mapping = BAG.replace("BAG", "sqlite3").replacen(from, to, 1);
        let why = import(folder.path(), &mapping).expect_err(to);
        words.iter().for_each(|word| assert!(why.contains(word), "{to}: '{word}' is not in: {why}"));
    }
    let of_commands = BAG.replace("BAG", "mcap").replace("/pose", "/cmd_vel").replace("[commands]\n", "#");
    let of_commands = of_commands.replacen("#topic", "#", 1);
    let why = import(folder.path(), &of_commands).expect_err("it has no poses");
    assert!(why.contains("poses.topic") && why.contains("the type geometry_msgs/msg/Twist"), "{why}");
}

/// Changes bytes of a file in one of several ways.
fn mutated(bytes: &[u8], stream: &mut murmurate::random::Stream) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let at = stream.random_range(0..bytes.len());
    match stream.random_range(0..6) {
        0 => bytes.truncate(at),
        1 => bytes[at] ^= 1 << stream.random_range(0..8),
        2 => bytes[at] = stream.random(),
        3 => {
            bytes.remove(at);
        }
        4 => bytes.insert(at, stream.random()),
        _ => {
            let end = (at + stream.random_range(1..64)).min(bytes.len());
            bytes[at..end].fill(stream.random());
        }
    }
    bytes
}

/// Imports a run, one of whose files is mutated again and again. Returns how many mutations were refused.
fn refused(folder: &Path, mapping: &str, file: &str, count: u32) -> u32 {
    let path = folder.join("mapping.toml");
    std::fs::write(&path, mapping).expect("it can be written");
    let file: PathBuf = folder.join(file);
    let whole = std::fs::read(&file).expect("the file is there");
    let mut stream = Seed::of_run(7).stream("lab files");
    let mut refused = 0;
    for _ in 0..count {
        std::fs::write(&file, mutated(&whole, &mut stream)).expect("it can be written");
        if let Err(why) = imported(&path) {
            assert!(why.contains(&*folder.to_string_lossy()), "it names no file: {why}");
            refused += 1;
        }
    }
    std::fs::write(&file, whole).expect("it can be written");
    assert!(imported(&path).is_ok());
    refused
}

#[test]
fn a_hundred_mutations_of_each_file_are_read_or_refused_in_one_line() {
    let folder = files();
    let bag = |name: &str| BAG.replace("BAG", name);
    for (mapping, file, least) in [
        (CSV.to_owned(), "mapping.toml", 100),
        (CSV.to_owned(), "run.csv", 40),
        (bag("sqlite3"), "sqlite3/bag.db3", 10),
        (bag("sqlite3"), "sqlite3/metadata.yaml", 1),
        (bag("mcap"), "mcap/bag.mcap", 100),
        (bag("mcap"), "mcap/metadata.yaml", 1),
    ] {
        let refused = refused(folder.path(), &mapping, file, 200);
        assert!(refused >= least, "{file}: {refused} of 200 were refused");
    }
}

#[test]
fn wrong_cells_are_named_by_line_and_column() {
    let folder = files();
    let table = folder.path().join("run.csv");
    let whole = std::fs::read_to_string(&table).expect("the table is there");
    let line: Vec<&str> = whole.lines().nth(4).expect("five lines").split(',').collect();
    for (at, cell, words) in [
        (1, "noon", &["line 5", "'time_s'", "no time"][..]),
        (1, "", &["line 5", "'time_s'", "empty"]),
        (1, "1e300", &["line 5", "'time_s'", "no time"]),
        (2, "7", &["line 5", "'robot'"]),
        (3, "NaN", &["line 5", "'x_m'", "no number"]),
        (4, "1e9", &["line 5", "'y_m'", "no number"]),
        (5, "", &["line 5", "'vx_m_s'", "empty"]),
        (8, "fast,", &["line 5", "11 cells", "10"]),
    ] {
        let mut cells = line.clone();
        cells[at] = cell;
        std::fs::write(&table, whole.replacen(&line.join(","), &cells.join(","), 1)).expect("it can be written");
        let why = import(folder.path(), CSV).expect_err(cell);
        words.iter().for_each(|word| assert!(why.contains(word), "'{cell}': '{word}' is not in: {why}"));
    }
    // Of two columns of one name it is not known which is meant.
    std::fs::write(&table, whole.replacen("heading_rad", "x_m", 1)).expect("it can be written");
    let why = import(folder.path(), &CSV.replace("yaw = \"heading_rad\"\n", "")).expect_err("two columns");
    assert!(why.contains("poses.x") && why.contains("two columns"), "{why}");
    // A robot that was not seen has no position.
    let mut cells = line.clone();
    cells[3] = "";
    std::fs::write(&table, whole.replacen(&line.join(","), &cells.join(","), 1)).expect("it can be written");
    assert_eq!(import(folder.path(), CSV), Ok((81, 82)));
}

#[test]
fn long_poses_go_with_commands_in_columns_of_each_robot_and_a_task_file_is_beside_the_mapping() {
    let folder = files();
    std::fs::write(folder.path().join("told.csv"), "at,u0,v0,u1,v1\n0.0,1.0,0.0,0.0,1.0\n1.0,0.0,0.0,0.0,0.0\n")
        .expect("it can be written");
    let wide = "path = \"told.csv\"\ntime = \"at\"\nx = \"u{robot}\"\ny = \"v{robot}\"\n";
    let mapping = CSV.replace("x = \"command_x_m_s\"\ny = \"command_y_m_s\"\n", wide);
    assert_eq!(import(folder.path(), &mapping), Ok((82, 4)));
    let why = import(folder.path(), &CSV.replace("\"passage\"", "\"own.toml\"")).expect_err("no task file");
    assert!(why.contains(&*folder.path().join("own.toml").to_string_lossy()), "{why}");
}
