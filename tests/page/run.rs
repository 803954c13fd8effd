//! `sim --watch` and `launch --watch` with a real browser: the emergency stop, a halted program, other pages; and the
//! same report as without a page.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Stdio};

use murmurate_record::reader;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::browser::Browser;
use crate::program::{murmurate, refuses, run, text};

/// A running `sim --watch`, and the address of its page.
pub struct Watched {
    child: Child,
    pub url: String,
}

impl Watched {
    fn start(flags: &[&str]) -> Watched {
        Watched::of(murmurate(&[&["sim", "--watch", "--control", "--quiet"], flags].concat()))
    }

    pub fn of(mut command: std::process::Command) -> Watched {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        let url = loop {
            let before = said.len();
            assert!(lines.read_line(&mut said).unwrap() > 0, "the program ended without an address: {said}");
            if let Some(url) = said[before..].trim().strip_prefix("watch: ") {
                break url.to_owned();
            }
        };
        std::thread::spawn(move || std::io::copy(&mut lines, &mut std::io::sink()));
        Watched { child, url }
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id().cast_signed()), signal).unwrap();
    }

    pub fn end(mut self) -> Option<i32> {
        // It may have been asked to end before.
        let _ = kill(Pid::from_raw(self.child.id().cast_signed()), Signal::SIGINT);
        self.child.wait().unwrap().code()
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        // A test that has failed leaves no team behind.
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            self.signal(Signal::SIGCONT);
            self.signal(Signal::SIGINT);
            let _ = self.child.wait();
        }
    }
}

const STATE: &str = "document.getElementById('state').textContent";
const CONFIRMED: &str = "document.getElementById('confirmed').textContent";

#[test]
fn the_space_bar_stops_the_team_and_a_halted_program_is_grey_within_a_second() {
    let Some(mut browser) = Browser::start() else { return };
    let watched = Watched::start(&["--mode", "offboard", "--episodes", "100"]);
    browser.open(&watched.url);
    browser.until(&format!("{STATE} === 'running' && {CONFIRMED} === '5/5' && murmurate.counts.drawn > 40"));
    assert_eq!(browser.eval("location.hash"), "", "the token leaves the address");
    pictures(&mut browser, "");
    browser.press_space();
    let stopped = browser.until(&format!("{STATE} === 'STOPPED' && {CONFIRMED} === '5/5'"));
    eprintln!("stop seen and confirmed on the page after {stopped:.0} ms");
    pictures(&mut browser, "stopped-");
    browser.until("!document.getElementById('rearm').disabled");
    browser.eval("document.getElementById('rearm').click()");
    browser.until(&format!("{STATE} === 'HELD'"));
    browser.until("!document.getElementById('resume').disabled");
    browser.eval("document.getElementById('resume').click()");
    browser.until(&format!("{STATE} === 'running'"));

    watched.signal(Signal::SIGSTOP);
    // With the longest pause of the page between two looks, which is the browser's own on a busy machine.
    let grey = "new Promise(done => { let late = 0, at = performance.now(); const look = () => { \
                const now = performance.now(); late = Math.max(late, now - at); at = now; \
                document.documentElement.classList.contains('stale') ? done([murmurate.heard(), late]) \
                : setTimeout(look, 4); }; look(); })";
    let grey = browser.eval(grey);
    let [age, late] = [0, 1].map(|at| grey[at].as_f64().unwrap());
    eprintln!("grey {age:.0} ms after the last snapshot, with pauses of {late:.0} ms");
    assert!(age <= 1000.0 + 2.0 * late, "{age} ms, with pauses of {late} ms");
    watched.signal(Signal::SIGCONT);
    browser.until("!document.documentElement.classList.contains('stale')");

    let (host, _) = watched.url.trim_start_matches("http://").split_once('/').unwrap();
    browser.open("data:text/html,<title>another page</title>");
    for path in ["view", "control"] {
        let script = format!(
            "new Promise(done => {{ const w = new WebSocket('ws://{host}/{path}'); w.onopen = () => done('open'); \
             w.onerror = () => done('refused'); }})"
        );
        assert_eq!(browser.eval(&script), "refused");
    }
    let read = format!("fetch('http://{host}/').then(() => 'read', () => 'refused')");
    assert_eq!(browser.eval(&read), "refused");
    assert_eq!(watched.end(), Some(130), "interrupted, with the results until then");
}

/// Writes pictures of the page to the folder that PAGE_PICTURES names, or to a temporary one.
pub fn pictures(browser: &mut Browser, name: &str) {
    let temporary = tempfile::tempdir().unwrap();
    let folder = std::env::var_os("PAGE_PICTURES").map_or(temporary.path().to_owned(), std::path::PathBuf::from);
    for (look, width, height, scheme) in
        [("light", 1280, 800, "light"), ("dark", 1280, 800, "dark"), ("phone", 390, 844, "light")]
    {
        browser.look_like(width, height, scheme);
        let drawn = browser.eval("murmurate.counts.drawn").as_f64().unwrap();
        browser.until(&format!(
            "murmurate.counts.drawn > {} && document.documentElement.dataset.theme === '{scheme}'",
            drawn + 5.0
        ));
        let picture = browser.picture();
        assert!(picture.starts_with(b"\x89PNG") && picture.len() > 5_000, "{} bytes", picture.len());
        std::fs::write(folder.join(format!("{name}{look}.png")), picture).unwrap();
    }
    browser.look_like(1280, 800, "light");
}

#[test]
fn a_trial_that_nobody_touches_has_the_report_of_a_trial_without_a_page() {
    let flags = ["sim", "--mode", "offboard", "--episodes", "2", "--repeats", "1", "--seed", "5", "--json", "--quiet"];
    let report = |more: &[&str]| {
        let output = run(&[&flags[..], more].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        let mut report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        report["wall_s"] = serde_json::Value::Null;
        report
    };
    let alone = report(&[]);
    assert!(alone["trace_hash"].is_string(), "{alone}");
    assert_eq!(alone, report(&["--watch", "--speed", "20"]));
}

#[test]
fn the_page_of_a_real_team_stops_it_and_so_does_a_page_that_joins_later() {
    let Some(mut browser) = Browser::start() else { return };
    let team = concat!(env!("CARGO_MANIFEST_DIR"), "/../../teams/offboard.toml");
    // No other run of this test has the number.
    let number = format!("team={}", 1000 + 4 * std::process::id() % 60_000);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let records = folder.path().to_str().expect("a path in UTF-8");
    let own = ["--set", &number, "--set", "episodes=100", "--control", "--record", records];
    let launched = Watched::of(murmurate(&[&["launch", team, "--watch"], &own[..]].concat()));
    let heard = tempfile::tempdir().expect("a temporary folder");
    let heard = heard.path().to_str().expect("a path in UTF-8");
    let joined = Watched::of(murmurate(&["watch", team, "--set", &number, "--control", "--record", heard]));
    browser.open(&launched.url);
    browser.until(&format!("{STATE} === 'running' && {CONFIRMED} === '5/5' && murmurate.counts.drawn > 40"));
    let note = "document.getElementById('note').textContent.includes('position')";
    browser.until(&format!("!{note}"));
    // What hosts report of their guards and links stands in the rows.
    let cells =
        |at: usize| format!("[...document.getElementById('rows').rows].map(row => row.cells[{at}].textContent)");
    browser.until(&format!("{}.every(late => /^[0-9]+$/.test(late))", cells(4)));
    browser.until(&format!("{}.every(age => /^0\\.[0-9]+ s$/.test(age))", cells(3)));
    let legend = "document.querySelector('.legend')";
    assert_eq!(browser.eval(&format!("{legend}.hidden")), true, "no links are drawn, and none explained");
    pictures(&mut browser, "launch-");
    pause_and_resume(&mut browser);
    let from_a_shell = stop_from_a_shell(&mut browser, team, &number);
    browser.press_space();
    let stopped = browser.until(&format!("{STATE} === 'STOPPED' && {CONFIRMED} === '5/5'"));
    browser.until(&format!("{}.every(guard => guard.startsWith('emergency stops'))", cells(6)));
    eprintln!(
        "launch: stop seen and confirmed on the page after {stopped:.0} ms, 'murmurate stop': {from_a_shell:.0} ms"
    );
    assert!(stopped <= from_a_shell + 1000.0, "with other tests beside it");
    // A stop is repeated for half a second; a re-arm from elsewhere would be overtaken by it.
    browser.until("!status.ordering && !document.getElementById('rearm').disabled");
    browser.open(&joined.url);
    browser.until(&format!("{STATE} === 'STOPPED' && {CONFIRMED} === '5/5'"));
    browser.until("!document.getElementById('rearm').disabled");
    browser.eval("document.getElementById('rearm').click()");
    browser.until(&format!("{STATE} === 'HELD' && !document.getElementById('resume').disabled"));
    browser.eval("document.getElementById('resume').click()");
    browser.until(&format!("{STATE} === 'running'"));
    // A stop that is over is no last action of a guard any more.
    browser.until(&format!("{}.every(guard => !guard.startsWith('emergency'))", cells(6)));
    let notice = "document.getElementById('notice')";
    joined.signal(Signal::SIGINT);
    browser.until(&format!("{notice}.textContent.includes('the team goes on without it')"));
    assert_eq!(browser.eval(&format!("{notice}.className")), "calm", "a normal end is no alarm");
    assert_eq!(joined.end(), Some(0));
    browser.open(&launched.url);
    browser.until(&format!("{STATE} === 'running'"));
    launched.signal(Signal::SIGINT);
    browser.until(&format!("{STATE} === 'over' && {notice}.textContent.includes('was interrupted')"));
    assert_eq!(browser.eval(&format!("{notice}.className")), "calm");
    assert_eq!(launched.end(), Some(130));
    // What the operator has received is shown again, and cannot be run again.
    let again = Watched::of(murmurate(&["replay", heard, "--watch"]));
    browser.open(&again.url);
    browser.until("scene && scene.record && world && !scene.hears_links");
    browser.eval("seek(scene.record.duration_s / 2)");
    browser.until("positions(world, 5).every(coordinate => coordinate === coordinate)");
    assert_eq!(again.end(), Some(0));
    refuses(&["replay", heard], &["operator", "--watch"]);
    assert_eq!(stops_in(folder.path()), BTreeMap::from_iter((0..5).map(|robot| (robot, 3))), "a hold, two stops");
}

/// Stops the team by `murmurate stop`, and lets it go on. Returns the time until all had confirmed \[ms\].
fn stop_from_a_shell(browser: &mut Browser, team: &str, number: &str) -> f64 {
    let shell = |command: &[&str]| {
        let output = run(&[command, &[team, "--set", number, "--json"]].concat());
        assert!(output.status.success(), "{command:?}: {}", text(&output.stderr));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("JSON")
    };
    let stopped = shell(&["stop"]);
    browser.until(&format!("{STATE} === 'STOPPED' && {CONFIRMED} === '5/5'"));
    shell(&["stop", "--rearm"]);
    shell(&["resume"]);
    browser.until(&format!("{STATE} === 'running' && {CONFIRMED} === '5/5'"));
    1000.0 * stopped["took_s"].as_f64().expect("all have confirmed")
}

/// Number of emergency stops of each robot's guard in the records of a folder.
fn stops_in(folder: &Path) -> BTreeMap<u64, u64> {
    let mut stops = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("the folder") {
        let mut opened = reader::open(&entry.expect("an entry").path()).expect("a record");
        while let Some(message) = opened.messages.next_message().expect("a whole record") {
            if message.channel.topic == "/guard" {
                let said: serde_json::Value = serde_json::from_slice(&message.data).expect("JSON");
                let stop = said["stop"].as_u64().expect("a count");
                if stop > 0 {
                    stops.insert(said["robot"].as_u64().expect("a robot"), stop);
                }
            }
        }
    }
    stops
}

/// Pauses a real team after its episode, and lets it go on: no episode is aborted or left out.
fn pause_and_resume(browser: &mut Browser) {
    browser.until("!document.getElementById('pause').disabled");
    let episode = browser.eval("status.episode").as_u64().expect("an episode");
    browser.eval("document.getElementById('pause').click()");
    browser.until(&format!("{STATE} === 'HELD' && {CONFIRMED} === '5/5' && !status.ordering"));
    let next = episode + 1;
    assert_eq!(browser.eval("status.episode").as_u64(), Some(next));
    assert_eq!(browser.eval(&format!("status.success.episodes === {episode}")), true, "it ran to its end");
    browser.eval("document.getElementById('resume').click()");
    browser.until(&format!("{STATE} === 'running' && status.phase === 3 && !status.ordering"));
    assert_eq!(browser.eval("status.episode").as_u64(), Some(next), "the next one is not lost");
    assert_eq!(browser.eval("status.verdicts.aborted === undefined"), true);
}

#[test]
fn flags_of_the_page_are_refused_where_they_make_no_sense() {
    use crate::program::refuses;
    refuses(&["sim", "--control"], &["--control", "--watch"]);
    refuses(&["sim", "--watch", "--repeats", "2"], &["--watch", "--repeats"]);
    refuses(&["sim", "--watch", "--speed", "0"], &["--speed"]);
    refuses(&["sim", "--watch", "--listen", "0.0.0.0:0"], &["--listen", "token"]);
}

/// Figures of the page for large teams: `cargo test --release --test page large -- --nocapture` with PAGE_LARGE=1.
#[test]
fn large_teams_are_drawn_in_time() {
    let teams: &[(&str, &str)] = match std::env::var_os("PAGE_LARGE") {
        Some(_) => &[("20", "60"), ("100", "60"), ("1000", "200")],
        None => &[("20", "60")],
    };
    let Some(mut browser) = Browser::start() else { return };
    for (robots, frames) in teams {
        let watched = Watched::start(&[
            "--mode",
            "offboard",
            "--scenario",
            "swap",
            "--policy",
            "orca",
            "--robots",
            robots,
            "--link-range-m",
            "3",
            "--comm-range-m",
            "2",
            "--episodes",
            "100",
        ]);
        browser.open(&watched.url);
        browser.until(&format!("murmurate.counts.drawn > {frames}"));
        let before = browser.eval("[{...murmurate.counts}, performance.now()]");
        browser.until(&format!("murmurate.counts.snapshots > {}", before[0]["snapshots"].as_f64().unwrap() + 50.0));
        let after = browser.eval("[{...murmurate.counts}, performance.now()]");
        let more = |name: &str| after[0][name].as_f64().unwrap() - before[0][name].as_f64().unwrap();
        let seconds = (after[1].as_f64().unwrap() - before[1].as_f64().unwrap()) / 1000.0;
        let (ms, kb_s) = (more("drawMs") / more("drawn"), more("bytes") / seconds / 1000.0);
        browser.press_space();
        let stopped = browser.until(&format!("{STATE} === 'STOPPED'"));
        let all = browser.until(&format!("{CONFIRMED} === '{robots}/{robots}'"));
        eprintln!(
            "{robots} robots: {ms:.2} ms a drawn frame, {:.1} snapshots/s, {kb_s:.0} kB/s, stop seen after \
             {stopped:.0} ms, confirmed {all:.0} ms later, {}",
            more("snapshots") / seconds,
            browser.eval("document.getElementById('clock').textContent"),
        );
        pictures(&mut browser, &format!("{robots}-"));
        watched.end();
    }
}
