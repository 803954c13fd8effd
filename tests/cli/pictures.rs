//! Pictures of an episode: complete files that load no other, the same for the same run; and refusals.

use std::path::Path;

use crate::program::{refuses, run, text};
use tempfile::TempDir;

/// Size limit of a picture of one episode of the passage \[bytes\].
const LARGEST: usize = 300_000;

/// Runs `sim` with these flags and one that names a file; returns the file and stdout.
fn drawn(folder: &Path, flag: &str, name: &str, flags: &[&str]) -> (String, String) {
    let path = folder.join(name);
    let path = path.to_str().expect("the path is text");
    let output = run(&[&["sim", "--repeats", "1", "--json", "--quiet", flag, path], flags].concat());
    assert!(output.status.success(), "{flags:?}: {}", text(&output.stderr));
    (std::fs::read_to_string(path).expect("the picture is there"), text(&output.stdout))
}

/// Checks that all tags are closed in order, except those of HTML that have no end tag.
fn closes(file: &str) {
    let mut open: Vec<&str> = Vec::new();
    for tag in file.split('<').skip(1).map(|after| after.split('>').next().expect("a tag ends")) {
        let name = tag.split([' ', '\n']).next().expect("a tag has a name").trim_end_matches('/');
        if let Some(closed) = name.strip_prefix('/') {
            assert_eq!(open.pop(), Some(closed), "</{closed}>");
        } else if !tag.ends_with('/') && !["!DOCTYPE", "meta", "input"].contains(&name) {
            assert_eq!(tag.matches('"').count() % 2, 0, "<{tag}>");
            open.push(name);
        }
    }
    assert!(open.is_empty(), "not closed: {open:?}");
}

fn loads_nothing(file: &str) {
    let rest = file.replace("http://www.w3.org/2000/svg", "");
    for word in ["http", "src=", "href", "url(", "@import", "fetch("] {
        assert!(!rest.contains(word), "'{word}' is in the file");
    }
}

/// Checks that an SVG file is well-formed XML; returns the document.
fn svg(file: &str, look: impl FnOnce(&roxmltree::Document)) {
    let document = roxmltree::Document::parse(file).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(document.root_element().tag_name().name(), "svg");
    assert!(!file.contains("<script"), "no script");
    look(&document);
}

/// Returns the page without its script.
fn markup(page: &str) -> String {
    let parts: Vec<&str> = page.split("<script").collect();
    assert_eq!(parts.len(), 3, "the data and the script");
    let after = |part: &str| part.split_once("</script>").expect("it is closed").1.to_owned();
    parts[0].to_owned() + &after(parts[1]) + &after(parts[2])
}

/// Returns the data in a page.
fn data(page: &str) -> serde_json::Value {
    let after = page.split_once("id=\"data\">").expect("the data").1;
    serde_json::from_str(after.split_once("</script>").expect("its end").0).expect("JSON")
}

#[test]
fn an_episode_is_a_page_that_loads_no_file_and_is_reproducible() {
    let folder = TempDir::new().expect("a temporary folder");
    let flags = ["--mode", "onboard-adhoc", "--episodes", "2", "--delay-ms", "60", "--loss", "0.3", "--episode", "2"];
    let (page, said) = drawn(folder.path(), "--animate", "episode.html", &flags);
    assert!(page.len() <= LARGEST, "{} bytes", page.len());
    loads_nothing(&page);
    closes(&markup(&page));
    assert!(page.contains("<title>5 robots, scenario passage, mode onboard-adhoc</title>"));
    let data = data(&page);
    let frames = data["times"].as_array().expect("times").len();
    assert!(frames > 60, "{frames} frames");
    assert_eq!(data["paths"].as_array().expect("paths").len(), 5);
    assert_eq!(data["walls"].as_array().expect("walls").len(), 2);
    let heard: Vec<&str> =
        data["links"].as_array().expect("links").iter().filter_map(|link| link[3].as_str()).collect();
    // 60 ms are between 3 and 4 of the 24 steps of the policy's hold time of 0.4 s: no message is younger.
    let youngest = heard.iter().flat_map(|ages| ages.to_lowercase().into_bytes()).filter(|age| *age != b'.').min();
    assert!(youngest.is_some_and(|age| (b'd'..=b'f').contains(&age)), "{youngest:?}");
    let (again, unchanged) = drawn(folder.path(), "--animate", "again.html", &flags);
    assert!(page == again, "the same run makes the same file");
    // Drawing does not change the run.
    let trace = |said: &str| serde_json::from_str::<serde_json::Value>(said).expect("JSON")["trace_hash"].clone();
    let plain = run(&[&["sim", "--repeats", "1", "--json", "--quiet"], &flags[..flags.len() - 2]].concat());
    assert_eq!((trace(&said), trace(&unchanged)), (trace(&text(&plain.stdout)), trace(&said)));
}

#[test]
fn both_svg_pictures_are_well_formed_and_show_every_robot() {
    let folder = TempDir::new().expect("a temporary folder");
    let flags = ["--mode", "offboard", "--episodes", "1"];
    for (flag, name) in [("--animate", "moves.svg"), ("--svg", "still.svg")] {
        let (file, _) = drawn(folder.path(), flag, name, &flags);
        assert!(file.len() <= LARGEST, "{name}: {} bytes", file.len());
        loads_nothing(&file);
        svg(&file, |document| {
            let count = |name: &str| document.descendants().filter(|node| node.tag_name().name() == name).count();
            assert_eq!(count("title"), 1);
            let numbers = document.descendants().filter(|node| node.attribute("class") == Some("number"));
            let mut numbers: Vec<&str> = numbers.filter_map(|node| node.text()).collect();
            numbers.sort_unstable();
            numbers.dedup();
            assert_eq!(numbers, ["0", "1", "2", "3", "4"]);
            assert_eq!(count("animateTransform"), if flag == "--animate" { 5 } else { 0 });
        });
        assert!(file.contains("Success: all have arrived after "));
    }
}

#[test]
fn a_failure_of_a_large_team_is_drawn_at_its_place() {
    let folder = TempDir::new().expect("a temporary folder");
    let flags = ["--scenario", "swap", "--robots", "20", "--policy", "orca", "--episodes", "1", "--comm-range-m", "0"];
    let flags = [&flags[..], &["--contacts", "judge", "--wall-radius-m", "0.3", "--mode", "sim"]].concat();
    let (still, _) = drawn(folder.path(), "--svg", "still.svg", &flags);
    svg(&still, |document| {
        let rings = document.descendants().filter(|node| node.attribute("class") == Some("ring")).count();
        assert_eq!(rings, 1, "deaf robots collide");
    });
    assert!(still.contains("Failure: robots "), "it says who");
    let (page, _) = drawn(folder.path(), "--animate", "page.html", &flags);
    assert_eq!(data(&page)["rings"].as_array().expect("rings").len(), 1);
    let (moves, _) = drawn(folder.path(), "--animate", "moves.svg", &flags);
    svg(&moves, |_| ());
    assert!(page.len() <= LARGEST && moves.len() <= LARGEST, "{} and {} bytes", page.len(), moves.len());
}

#[test]
fn lines_that_are_not_drawn_are_not_explained() {
    let folder = TempDir::new().expect("a temporary folder");
    for (mode, lines) in [("sim", false), ("offboard", true)] {
        let flags = ["--mode", mode, "--episodes", "1"];
        let (page, _) = drawn(folder.path(), "--animate", &format!("{mode}.html"), &flags);
        assert_eq!(data(&page)["links"].as_array().expect("links").is_empty(), !lines, "{mode}");
        assert!(page.contains("find(\"lines\").hidden = data.links.length === 0"));
        let (moves, _) = drawn(folder.path(), "--animate", &format!("{mode}.svg"), &flags);
        assert_eq!(moves.contains("heard, new to"), lines, "{mode}");
    }
}

#[test]
fn impossible_pictures_are_refused_before_the_run() {
    let folder = TempDir::new().expect("a temporary folder");
    let path = folder.path().join("episode.gif");
    let path = path.to_str().expect("the path is text");
    refuses(&["sim", "--animate", path], &["--animate", "episode.gif", ".html or .svg"]);
    refuses(&["sim", "--animate", "episode"], &["--animate", "'episode'", ".html"]);
    refuses(&["sim", "--svg", "episode.html"], &["--svg", "episode.html", ".svg"]);
    refuses(&["sim", "--svg", "/nowhere/at/all.svg"], &["/nowhere/at/all.svg"]);
    let html = path.replace(".gif", ".html");
    refuses(&["sim", "--animate", &html, "--episodes", "2", "--episode", "3"], &["--episode", "2, from 1"]);
    refuses(&["sim", "--animate", &html, "--episode", "0"], &["--episode", "count from 1"]);
    refuses(&["sim", "--episode", "1"], &["--episode", "--animate"]);
    refuses(&["sim", "--animate", "one.svg", "--svg", "one.svg"], &["--svg", "--animate", "its own"]);
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0, "nothing is left behind");
}

#[test]
fn the_first_failed_episode_is_listed_and_can_be_shown() {
    let folder = TempDir::new().expect("a temporary folder");
    let plan = folder.path().join("crash.toml");
    let crash =
        "[[actor]]\nactor = \"controller\"\nrobot = 2\nfault = \"crash\"\nepisode = 1\nat_s = 2.0\nfor_s = 3.0\n";
    std::fs::write(&plan, crash).expect("a temporary file");
    let plan = plan.to_str().expect("the path is text");
    let run_of = ["--mode", "offboard", "--episodes", "3", "--faults", plan];
    let (failed, json) = drawn(folder.path(), "--svg", "failed.svg", &[&run_of[..], &["--episode", "failed"]].concat());
    let (second, _) = drawn(folder.path(), "--svg", "second.svg", &[&run_of[..], &["--episode", "2"]].concat());
    assert_eq!(failed, second);
    assert!(
        failed.contains("Aborted after") && failed.contains("robot 2 has not been heard for 1 s"),
        "it names the robot"
    );
    let json: serde_json::Value = serde_json::from_str(&json).expect("one JSON object");
    let reason = serde_json::json!({"cause": "missing", "robot": 2, "others": 0});
    let expected = serde_json::json!([{"repeat": 0, "episode": 1, "verdict": "aborted", "reason": reason}]);
    assert_eq!(json["failed"], expected, "in JSON, episodes count from 0");
    let output = run(&[&["sim", "--repeats", "1"], &run_of[..]].concat());
    let table = text(&output.stdout);
    assert!(table.contains("1 aborted") && table.contains("in   episode 2\n"), "{table}");
    assert!(table.contains("aborted   episode 2: robot 2 has not been heard for 1 s\n"), "{table}");
    assert!(table.contains("controller of robot 2: crash 2.0 s into episode 2, for 3.0 s"), "{table}");
    let picture = folder.path().join("none.svg");
    let none = ["sim", "--episodes", "1", "--repeats", "1", "--episode", "failed", "--svg"];
    let output = run(&[&none[..], &[picture.to_str().expect("the path is text")]].concat());
    assert!(output.status.success() && text(&output.stderr).contains("no episode of the first repeat failed"));
    assert!(!picture.exists());
    refuses(&["sim", "--svg", "a.svg", "--episode", "last"], &["--episode", "last", "failed"]);
}
