//! The house rules that a machine can check: reads the source, and nothing but the source.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Longest line \[characters\].
const WIDTH: usize = 120;
/// Longest source file, its unit tests aside \[lines\].
const LENGTH: usize = 420;

struct Source {
    /// Relative to the repository, with forward slashes.
    path: String,
    text: String,
}

impl Source {
    /// Everything before the unit tests.
    fn code(&self) -> &str {
        self.text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default()
    }

    /// The lines of code that name `word`, comments aside.
    fn lines_with(&self, word: &str) -> Vec<String> {
        let named = |line: &&str| !line.trim_start().starts_with("//") && line.contains(word);
        self.code().lines().filter(named).map(|line| format!("{}: {}", self.path, line.trim())).collect()
    }
}

fn sources(folder: &str) -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    let mut folders = vec![root.join(folder)];
    while let Some(folder) = folders.pop() {
        let mut entries: Vec<PathBuf> = fs::read_dir(&folder)
            .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
            .map(|entry| entry.expect("a readable folder").path())
            .collect();
        entries.sort();
        for path in entries {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                let relative = path.strip_prefix(root).expect("it is below the root");
                let text = fs::read_to_string(&path).expect("source is text");
                found.push(Source { path: relative.to_string_lossy().replace('\\', "/"), text });
            }
        }
    }
    assert!(!found.is_empty(), "there is source in {folder}");
    found
}

/// The rooms of the library, each after all that it may use.
const ROOMS: [&str; 30] = [
    "time",
    "random",
    "config",
    "messages",
    "actor",
    "cells",
    "hearing",
    "faults",
    "scenario",
    "policy",
    "world",
    "safety",
    "edge",
    "drivers",
    "estimation",
    "localization",
    "net::protocol",
    "net::transport",
    "registry",
    "net::media",
    "report",
    "actors",
    "train",
    "deploy",
    "runtime",
    "graph",
    "trial",
    "live",
    "study",
    "program",
];

/// Files that hold nothing but the names of what is below them, or a call into it.
const DOORS: [&str; 3] = ["bin::murmurate", "lib", "net"];

/// A file of the library as a module, and the modules that it uses.
struct Module {
    name: String,
    uses: Vec<String>,
}

/// All modules of the library. A path is followed to the longest part of it that is a module.
fn modules() -> Vec<Module> {
    let library = sources("src");
    let name = |path: &str| {
        let name = path.trim_start_matches("src/").trim_end_matches(".rs").replace('/', "::");
        name.strip_suffix("::mod").map_or(name.clone(), str::to_owned)
    };
    let names: BTreeSet<String> = library.iter().map(|source| name(&source.path)).collect();
    let module = |source: &Source| {
        let own = name(&source.path);
        let parent = own.rsplit_once("::").map_or("", |(parent, _)| parent).to_owned();
        let mut uses = BTreeSet::new();
        for line in source.code().lines().map(str::trim).filter(|line| !line.starts_with("//")) {
            assert!(!line.contains("crate::{"), "{}: one path a use, so that a reader sees the rooms", source.path);
            let absolute = line.replace("self::", &format!("crate::{own}::"));
            let absolute = absolute.replace("super::", &format!("crate::{parent}::")).replace("::::", "::");
            for used in absolute.split("crate::").skip(1) {
                let path: String = used.chars().take_while(|c| c.is_alphanumeric() || *c == '_' || *c == ':').collect();
                let mut path = path.trim_end_matches(':');
                while !path.is_empty() && !names.contains(path) {
                    path = path.rsplit_once("::").map_or("", |(front, _)| front);
                }
                if !path.is_empty() && path != own {
                    uses.insert(path.to_owned());
                }
            }
        }
        Module { name: own, uses: uses.into_iter().collect() }
    };
    library.iter().map(module).collect()
}

/// Where a module's room is in the order.
fn room(module: &str) -> Option<usize> {
    let within = |room: &str| module == room || module.starts_with(&format!("{room}::"));
    ROOMS.iter().enumerate().filter(|(_, room)| within(room)).max_by_key(|(_, room)| room.len()).map(|(at, _)| at)
}

#[test]
fn no_room_uses_one_that_comes_after_it() {
    let mut uses = 0;
    for module in modules().iter().filter(|module| !DOORS.contains(&module.name.as_str())) {
        let own = room(&module.name).unwrap_or_else(|| panic!("{} is in no room; add it to ROOMS", module.name));
        for used in &module.uses {
            let Some(other) = room(used) else { continue };
            uses += 1;
            assert!(other <= own, "{} uses {used}, which comes after it", module.name);
            let apart = ROOMS[own] == "train" && ROOMS[other] == "actors";
            assert!(!apart, "{}: training knows no actor", module.name);
        }
    }
    assert!(uses > 300, "the test has seen {uses} uses");
}

#[test]
fn no_files_go_round_in_circles() {
    let mut modules = modules();
    let related = |one: &str, other: &str| one.starts_with(&format!("{other}::"));
    for module in &mut modules {
        let name = module.name.clone();
        // A folder's own file and what is in it may know each other.
        module.uses.retain(|used| !related(used, &name) && !related(&name, used));
    }
    // Whoever uses nobody that is left, or is used by nobody that is left, is in no circle.
    loop {
        let left: BTreeSet<String> = modules.iter().map(|module| module.name.clone()).collect();
        let used: BTreeSet<String> = modules.iter().flat_map(|module| &module.uses).cloned().collect();
        let before = modules.len();
        modules.retain(|module| used.contains(&module.name) && module.uses.iter().any(|used| left.contains(used)));
        if modules.len() == before {
            break;
        }
    }
    let left: Vec<String> = modules.iter().map(|module| format!("{} uses {:?}", module.name, module.uses)).collect();
    assert!(left.is_empty(), "these files use each other in a circle, or are between two such:\n{}", left.join("\n"));
}

/// Words that only some files may name.
#[test]
fn what_touches_the_machine_is_in_its_place() {
    let rules: [(&str, &[&str]); 12] = [
        ("unsafe", &["src/train/matrix.rs"]),
        ("actix", &["src/runtime/shell.rs"]),
        ("tokio", &["src/runtime/", "src/edge/", "src/program/"]),
        ("Instant", &["src/runtime/real.rs", "src/live/", "src/program/"]),
        ("SystemTime", &["src/program/"]),
        ("std::fs", &["src/program/"]),
        ("std::env", &["src/program/"]),
        ("thread_rng", &[]),
        ("rand::rng()", &[]),
        ("HashMap", &[]),
        // Which transports there are, their folder knows and nobody else.
        ("Udp", &["src/net/transport/"]),
        ("udp::", &["src/net/transport/"]),
    ];
    for source in sources("src") {
        for (word, places) in rules {
            if !places.iter().any(|place| source.path.starts_with(place)) {
                assert_eq!(source.lines_with(word), Vec::<String>::new(), "'{word}' has no business there");
            }
        }
    }
}

/// Transcendental functions of the platform are not the same on all of them; `libm` is. Only what nothing is reckoned
/// from again may use them: reports, studies and output.
#[test]
fn no_trace_hangs_on_the_mathematics_of_the_platform() {
    let functions = [
        "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "exp2",
        "exp_m1", "ln", "ln_1p", "log", "log2", "log10", "powf", "cbrt", "hypot",
    ];
    let places = ["src/report/", "src/study/", "src/program/"];
    for source in sources("src").iter().filter(|source| !places.iter().any(|place| source.path.starts_with(place))) {
        for word in functions.map(|function| format!(".{function}(")).iter().map(String::as_str).chain(["rand_distr"]) {
            assert_eq!(source.lines_with(word), Vec::<String>::new(), "'{word}': take it from libm or random.rs");
        }
    }
}

/// Modes and links are data: only their presets may name them, and studies those presets that they run.
#[test]
fn nothing_asks_for_a_mode_or_a_link_by_name() {
    let presets = "src/deploy/presets.rs";
    let rules: [(&[&str], &[&str]); 2] = [
        (
            &["\"sim\"", "\"centralized\"", "\"offboard\"", "\"onboard-infra\"", "\"onboard-adhoc\""],
            &[
                presets,
                "src/study/columns.rs",
                "src/study/published.rs",
                "src/study/network/growth.rs",
                // The default of a flag.
                "src/program/sim.rs",
            ],
        ),
        (&["\"wires\"", "\"infra\"", "\"loopback\"", "\"ad-hoc\""], &[presets]),
    ];
    for source in sources("src") {
        for (words, places) in rules {
            for word in words.iter().filter(|_| !places.contains(&&*source.path)) {
                let mut named = source.lines_with(word);
                // A feature of the crate has the name of a mode.
                named.retain(|line| !line.contains("feature = "));
                assert_eq!(named, Vec::<String>::new(), "{word} is for the presets to name");
            }
        }
        for asks in ["mode == \"", "match mode {", "mode.as_str()", "mode == BASELINE"] {
            if source.path != presets {
                assert_eq!(source.lines_with(asks), Vec::<String>::new(), "'{asks}' asks for a mode by name");
            }
        }
    }
}

#[test]
fn nothing_sleeps_and_nothing_is_left_for_later() {
    let here = "tests/tidy.rs";
    let all =
        ["src", "tests", "benches", "examples"].into_iter().flat_map(sources).filter(|source| source.path != here);
    for source in all {
        for word in ["thread::sleep", "todo!", "unimplemented!", "#[ignore"] {
            assert_eq!(source.lines_with(word), Vec::<String>::new(), "'{word}'");
        }
        for mark in ["TODO", "FIXME", "XXX"] {
            assert!(!source.text.contains(mark), "{}: {mark}", source.path);
        }
    }
}

#[test]
fn files_say_what_they_are_and_stay_readable() {
    for source in ["src", "tests", "benches", "examples"].into_iter().flat_map(sources) {
        assert!(source.text.starts_with("//!"), "{}: the first line says what lives there", source.path);
        for (index, line) in source.text.lines().enumerate() {
            let width = line.chars().count();
            assert!(width <= WIDTH, "{}:{}: {width} characters", source.path, index + 1);
        }
        let length = source.code().lines().count();
        assert!(length <= LENGTH || source.path.starts_with("tests/"), "{}: {length} lines", source.path);
    }
}

#[test]
fn every_module_has_its_line_in_the_architecture() {
    let map =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    for source in sources("src").iter().filter(|source| !source.path.ends_with("mod.rs")) {
        let name = source.path.rsplit('/').next().unwrap_or_default();
        assert!(map.contains(name), "ARCHITECTURE.md has no line for {}", source.path);
    }
}
