//! House rules that a program can check, from the source text alone.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Maximum length of a line \[characters\].
const WIDTH: usize = 120;
/// Maximum length of a source file without its unit tests \[lines\].
const LENGTH: usize = 420;

struct Source {
    /// Path relative to the repository, with forward slashes.
    path: String,
    text: String,
}

impl Source {
    /// Returns the text before the unit tests.
    fn code(&self) -> &str {
        self.text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default()
    }

    /// Returns the lines of code that contain `word`, without comments.
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

/// Rooms of the library, each after those that it may use.
const ROOMS: [&str; 35] = [
    "time",
    "random",
    "config",
    "messages",
    "actor",
    "cells",
    "chassis",
    "hearing",
    "faults",
    "scenario",
    "policy",
    "world",
    "safety",
    "edge",
    "ros2",
    "drivers",
    "estimation",
    "localization",
    "net::protocol",
    "net::transport",
    "registry",
    "net::media",
    "lab",
    "report",
    "actors",
    "train",
    "deploy",
    "runtime",
    "graph",
    "record",
    "trial",
    "view",
    "live",
    "study",
    "program",
];

/// Files with nothing but declarations of their submodules, or a call into one.
const DOORS: [&str; 3] = ["bin::murmurate", "lib", "net"];

/// Module of the library, and the modules that it uses.
struct Module {
    name: String,
    uses: Vec<String>,
}

/// Returns all modules of the library. A used path counts as its longest prefix that is a module.
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

/// Returns the index of a module's room.
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
fn no_files_use_each_other_in_a_cycle() {
    let mut modules = modules();
    let related = |one: &str, other: &str| one.starts_with(&format!("{other}::"));
    for module in &mut modules {
        let name = module.name.clone();
        // A folder's `mod.rs` and the modules in it may use each other.
        module.uses.retain(|used| !related(used, &name) && !related(&name, used));
    }
    // A module that uses no remaining one, or that no remaining one uses, is in no cycle.
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
    assert!(left.is_empty(), "these files form cycles, or lie between two cycles:\n{}", left.join("\n"));
}

/// Checks words that only some files may contain.
#[test]
fn access_to_the_machine_is_confined_to_its_files() {
    let rules: [(&str, &[&str]); 12] = [
        ("unsafe", &["src/train/matrix.rs"]),
        ("actix", &["src/runtime/shell.rs"]),
        ("tokio", &["src/runtime/", "src/edge/", "src/program/"]),
        (
            "Instant",
            &[
                "src/drivers/robomaster/worker.rs",
                "src/localization/natnet/worker.rs",
                "src/net/transport/zenoh/session.rs",
                "src/ros2/",
                "src/runtime/real.rs",
                "src/view/",
                "src/live/",
                "src/record/writer.rs",
                "src/program/",
            ],
        ),
        ("SystemTime", &["src/ros2/dds.rs", "src/program/"]),
        ("std::fs", &["src/config/regular.rs", "src/record/file.rs", "src/ros2/node.rs", "src/program/"]),
        ("std::env", &["src/ros2/", "src/program/"]),
        ("thread_rng", &[]),
        ("rand::rng()", &[]),
        ("HashMap", &[]),
        // Only their folder names the transports.
        ("Udp", &["src/drivers/robomaster/worker.rs", "src/localization/natnet/worker.rs", "src/net/transport/"]),
        ("udp::", &["src/net/transport/"]),
    ];
    for source in sources("src") {
        for (word, places) in rules {
            if !places.iter().any(|place| source.path.starts_with(place)) {
                assert_eq!(source.lines_with(word), Vec::<String>::new(), "'{word}' is not allowed there");
            }
        }
    }
}

/// Checks the use of transcendental functions, which differ between platforms, unlike `libm`. Only reports, studies and
/// output may use those of the platform, because no trace depends on them.
#[test]
fn no_trace_depends_on_the_platform_s_mathematics() {
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

/// Checks that modes and links are data: only their presets name them, and studies those presets that they run.
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
                // Default of a flag.
                "src/program/sim/mod.rs",
            ],
        ),
        (&["\"wires\"", "\"infra\"", "\"loopback\"", "\"ad-hoc\""], &[presets]),
    ];
    for source in sources("src") {
        for (words, places) in rules {
            for word in words.iter().filter(|_| !places.contains(&&*source.path)) {
                let mut named = source.lines_with(word);
                // One feature of the crate has the name of a mode.
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
fn no_code_sleeps_or_is_left_undone() {
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
fn files_have_a_description_and_a_readable_size() {
    for source in ["src", "tests", "benches", "examples"].into_iter().flat_map(sources) {
        assert!(source.text.starts_with("//!"), "{}: the first line describes the file", source.path);
        for (index, line) in source.text.lines().enumerate() {
            let width = line.chars().count();
            assert!(width <= WIDTH, "{}:{}: {width} characters", source.path, index + 1);
        }
        let length = source.code().lines().count();
        assert!(length <= LENGTH || source.path.starts_with("tests/"), "{}: {length} lines", source.path);
    }
}

#[test]
fn every_module_has_a_line_in_the_architecture() {
    let map =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    for source in sources("src").iter().filter(|source| !source.path.ends_with("mod.rs")) {
        let name = source.path.rsplit('/').next().unwrap_or_default();
        assert!(map.contains(name), "ARCHITECTURE.md has no line for {}", source.path);
    }
}
