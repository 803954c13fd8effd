//! `replay --watch` with a real browser: a record with its scrubber, marks and single steps.

use std::path::Path;

use crate::browser::Browser;
use crate::program::{murmurate, refuses, run, text};
use crate::run::{Watched, pictures};

/// Time that the page shows \[ms\] of the record.
const SHOWN: &str = "world.getUint32(4, true)";

/// Runs a command that makes a record in a folder.
fn recorded(command: &[&str], folder: &Path) {
    let output = run(&[command, &["--record", folder.to_str().expect("a path in UTF-8")]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
}

fn watched(records: &Path) -> Watched {
    Watched::of(murmurate(&["replay", records.to_str().expect("a path in UTF-8"), "--watch"]))
}

#[test]
fn a_record_is_shown_at_any_time_with_its_marks_and_links() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let sim = ["sim", "--mode", "offboard", "--episodes", "3", "--repeats", "1", "--seed", "5", "--quiet"];
    let (records, table) = (folder.path().join("records"), folder.path().join("truth.csv"));
    recorded(&[&sim[..], &["--trajectories", table.to_str().expect("a path in UTF-8")]].concat(), &records);
    let page = watched(&records);
    browser.open(&page.url);
    browser.until("scene && scene.record && world && status && status.playback && status.playback.playing");
    assert_eq!(browser.eval("scene.record.marks.filter(m => m.kind === 'success' || m.kind === 'failure').length"), 3);
    assert_eq!(browser.eval("document.getElementById('stop').hidden && scene.hears_links"), true);
    browser.press_space();
    browser.until("!status.playback.playing");

    // Positions at a time are those of the table that the simulation wrote.
    let rows = std::fs::read_to_string(&table).expect("the table");
    let header: Vec<&str> = rows.lines().next().expect("a header").split(',').collect();
    let column = |name: &str| header.iter().position(|column| *column == name).expect("a column of the table");
    let [time, robot, x, y] = ["time_s", "robot", "x_m", "y_m"].map(column);
    let number = |row: &str, at: usize| -> f64 { row.split(',').nth(at).expect("a cell").parse().expect("a number") };
    let times: Vec<f64> = rows.lines().skip(1).map(|row| number(row, time)).collect();
    let end = times.iter().copied().fold(0.0, f64::max);
    for share in [0.7, 0.2, 0.95, 0.4] {
        let nearest = |at: &&f64| ((**at - end * share).abs() * 1e9) as u64;
        let at = *times.iter().min_by_key(nearest).expect("rows");
        browser.eval(&format!("seek({at})"));
        browser.until(&format!("Math.abs({SHOWN} - {}) <= 1", at * 1000.0));
        for row in rows.lines().skip(1).filter(|row| (number(row, time) - at).abs() < 1e-9) {
            let robot = number(row, robot);
            for (place, axis) in [(x, 0), (y, 2)] {
                let script = format!("world.getInt16(HEADER + ROBOT * {robot} + {axis}, true) * scene.scale_m");
                let shown = browser.eval(&script).as_f64().expect("a position");
                assert!((shown - number(row, place)).abs() < 2e-4, "robot {robot} at {at} s: {shown}, {row}");
            }
        }
        assert!(browser.eval("links.m").as_f64().expect("a number") > 0.0, "robots within range at {at} s");
    }
    let before = browser.eval(SHOWN).as_f64().expect("a time");
    browser.eval("document.getElementById('step').click()");
    browser.until(&format!("{SHOWN} > {before}"));
    browser.eval("document.getElementById('step-back').click()");
    browser.until(&format!("{SHOWN} === {before}"));
    browser.eval("document.getElementById('mark-back').click()");
    browser.until(&format!("scene.record.marks.some(m => Math.abs(1000 * m.at_s - {SHOWN}) <= 1)"));
    pictures(&mut browser, "record-");
    // A status on its way while the rate is chosen still has the old rate: it does not take the chosen one back.
    let choose = "(select => { select.value = 10; select.onchange(); showStatus(); return +select.value; })";
    assert_eq!(browser.eval("status.playback.rate"), 1);
    assert_eq!(browser.eval(&format!("{choose}(document.getElementById('rate'))")), 10);
    browser.press_space();
    // The rest takes a second, so a busy browser may see it only when it is over.
    browser.until("status.playback.rate === 10");
    browser.until(&format!("!status.playback.playing && {SHOWN} >= 1000 * scene.record.duration_s - 2"));
    assert_eq!(page.end(), Some(0));
}

#[test]
fn the_records_of_a_real_team_are_shown_as_one() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let team = concat!(env!("CARGO_MANIFEST_DIR"), "/../../teams/onboard-adhoc.toml");
    // No other run of this test has the number.
    let number = format!("team={}", 1000 + (4 * std::process::id() + 2) % 60_000);
    recorded(&["launch", team, "--set", &number, "--set", "episodes=1"], folder.path());
    let page = watched(folder.path());
    browser.open(&page.url);
    browser.until("scene && scene.record && world && status && status.playback");
    assert_eq!(browser.eval("scene.hears_links && scene.record.marks.length >= 1"), true);
    browser.eval("seek(scene.record.marks[0].at_s - 1)");
    browser.until("links.m > 0 && [...links.age].some(age => age < 20)");
    assert_eq!(page.end(), Some(0));

    // One host alone: what it has heard, and no links.
    let mut entries =
        std::fs::read_dir(folder.path()).expect("the folder").map(|entry| entry.expect("an entry").path());
    let one = entries.find(|path| path.to_string_lossy().contains("robot-0")).expect("the record of robot 0");
    let page = watched(&one);
    browser.open(&page.url);
    browser.until("scene && scene.record && world && !scene.hears_links");
    browser.eval("seek(scene.record.duration_s / 2)");
    browser.until("positions(world, 5).every(coordinate => coordinate === coordinate)");
    assert_eq!(page.end(), Some(0));
}

#[test]
fn a_page_of_records_refuses_what_makes_no_sense() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let none = folder.path().to_str().expect("a path in UTF-8");
    refuses(&["replay", none, "--watch"], &["no record"]);
    refuses(&["replay", none, "--listen", "127.0.0.1:0"], &["--watch"]);
    let file = folder.path().join("junk.mcap");
    std::fs::write(&file, b"no record at all").expect("a file");
    refuses(&["replay", file.to_str().expect("a path in UTF-8"), "--watch"], &["junk.mcap"]);
}
