//! House rules that a program can check, from the source text alone.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Maximum length of a line \[characters\].
const WIDTH: usize = 120;
/// Maximum length of a source file without its unit tests \[lines\].
const LENGTH: usize = 420;

/// Maximum length of a function, from the line with its name to its last one \[lines\].
const FUNCTION: usize = 70;

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

/// Folders of the packages' sources: that of the library, and those of the crates above it.
fn packages() -> Vec<String> {
    let crates = fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("crates")).expect("a folder of packages");
    let name = |entry: io::Result<fs::DirEntry>| entry.expect("a readable folder").file_name();
    let mut all: Vec<String> = crates.map(|entry| format!("crates/{}/src", name(entry).to_string_lossy())).collect();
    all.sort();
    all.insert(0, "src".to_owned());
    all
}

/// Sources of all packages.
fn library() -> Vec<Source> {
    packages().iter().flat_map(|folder| sources(folder)).collect()
}

/// Returns the files at and below the paths `places` of the repository, sorted, with these endings. What a package
/// contains by a link is left out: it is read where it is.
fn files(places: &[&str], endings: &[&str]) -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut paths: Vec<PathBuf> = places.iter().map(|place| root.join(place)).collect();
    let mut found = Vec::new();
    while let Some(path) = paths.pop() {
        let about = path.symlink_metadata().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        if about.is_dir() {
            let entries = fs::read_dir(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            paths.extend(entries.map(|entry| entry.expect("a readable folder").path()));
        } else if about.is_file() && path.extension().is_some_and(|ending| endings.iter().any(|one| ending == *one)) {
            let relative = path.strip_prefix(root).expect("it is below the root");
            let text = fs::read_to_string(&path).expect("source is text");
            found.push(Source { path: relative.to_string_lossy().replace('\\', "/"), text });
        }
    }
    found.sort_by(|one, other| one.path.cmp(&other.path));
    found
}

/// Sources of all packages, and of further folders.
fn library_and(folders: &[&str]) -> Vec<Source> {
    library().into_iter().chain(folders.iter().flat_map(|folder| sources(folder))).collect()
}

fn sources(folder: &str) -> Vec<Source> {
    let found = files(&[folder], &["rs"]);
    assert!(!found.is_empty(), "there is source in {folder}");
    found
}

/// Returns the rooms of the library at the root, each after those that it may use: the table of ARCHITECTURE.md. The
/// order of the packages is kept by their manifests.
fn rooms() -> Vec<String> {
    let page = files(&["ARCHITECTURE.md"], &["md"]).remove(0).text;
    let (_, table) = page.split_once("| rooms | what they hold |").expect("a table of rooms");
    let rows = table.lines().skip(2).take_while(|line| line.starts_with("| `"));
    let cells = rows.filter_map(|row| row.split('|').nth(1));
    cells.flat_map(|cell| cell.split('`').skip(1).step_by(2)).map(str::to_owned).collect()
}

/// Files with nothing but declarations of their submodules, or a call into one.
const DOORS: [&str; 3] = ["murmurate::bin::murmurate", "murmurate", "murmurate::net"];

/// Module of a package, and the modules of all packages that it uses.
struct Module {
    /// Full path, such as `murmurate_record::writer`.
    name: String,
    uses: BTreeSet<String>,
}

/// Returns the module path of a source file.
fn module_of(path: &str) -> String {
    let (package, rest) = match path.strip_prefix("crates/") {
        Some(path) => {
            let (package, rest) = path.split_once("/src/").expect("it is in the sources of a package");
            (format!("murmurate_{package}"), rest)
        }
        None => ("murmurate".to_owned(), path.strip_prefix("src/").expect("it is in the sources of the library")),
    };
    let name = format!("{package}::{}", rest.trim_end_matches(".rs").replace('/', "::"));
    name.strip_suffix("::mod").or(name.strip_suffix("::lib")).map_or(name.clone(), str::to_owned)
}

/// Returns code without comments and without the content of its strings.
fn bare(code: &str) -> String {
    let mut bare = String::new();
    for line in code.lines() {
        let mut outside = true;
        let mut before = ' ';
        let mut characters = line.chars().peekable();
        while let Some(character) = characters.next() {
            if outside && character == '/' && characters.peek() == Some(&'/') {
                break;
            }
            if character == '"' && before != '\\' && !(before == '\'' && characters.peek() == Some(&'\'')) {
                outside = !outside;
            } else if outside {
                bare.push(character);
            }
            before = if before == '\\' && character == '\\' { ' ' } else { character };
        }
        bare.push('\n');
    }
    bare
}

/// Adds the paths of a use, such as `a::{b, c::{self, d}}` after `front`, to `found`. Returns what follows it.
fn paths<'a>(front: &str, mut rest: &'a str, found: &mut Vec<String>) -> &'a str {
    let mut path = front.to_owned();
    loop {
        let word: usize = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        if word > 0 {
            path = if &rest[..word] == "self" { path } else { format!("{path}::{}", &rest[..word]) };
            rest = &rest[word..];
            if let Some(further) = rest.strip_prefix("::") {
                rest = further;
                continue;
            }
            found.push(path);
            return rest;
        }
        let Some(mut list) = rest.strip_prefix('{') else {
            found.push(path);
            return rest;
        };
        loop {
            list = list.trim_start_matches(|c: char| c.is_whitespace() || c == ',' || c == '*');
            if let Some(end) = list.strip_prefix('}') {
                return end;
            }
            let before = list.len();
            list = paths(&path, list, found);
            // A new name, as in `a as b`, is no path.
            list = list.trim_start();
            if let Some(renamed) = list.strip_prefix("as ") {
                list = renamed.trim_start_matches(|c: char| c.is_alphanumeric() || c == '_');
            }
            if list.len() == before || list.is_empty() {
                return list;
            }
        }
    }
}

/// Returns all modules of all packages. A used path counts as its longest prefix that is a module.
fn modules() -> Vec<Module> {
    let library = library();
    let names: BTreeSet<String> = library.iter().map(|source| module_of(&source.path)).collect();
    let packages: BTreeSet<&str> = names.iter().map(|name| name.split("::").next().unwrap_or_default()).collect();
    let module = |source: &Source| {
        let own = module_of(&source.path);
        let package = own.split("::").next().unwrap_or_default().to_owned();
        let parent = own.rsplit_once("::").map_or("", |(parent, _)| parent).to_owned();
        let code = bare(source.code());
        let mut found = Vec::new();
        for (at, _) in code.match_indices("::") {
            let before = &code[..at];
            let word = before.rfind(|c: char| !c.is_alphanumeric() && c != '_').map_or(0, |end| end + 1);
            // Further parts of a path were read with its first one.
            if before[..word].ends_with("::") {
                continue;
            }
            let (mut front, mut rest) = match &before[word..] {
                "crate" => (package.clone(), &code[at + 2..]),
                "self" => (own.clone(), &code[at + 2..]),
                "super" => (parent.clone(), &code[at + 2..]),
                name if packages.contains(name) => (name.to_owned(), &code[at + 2..]),
                _ => continue,
            };
            while let Some(further) = rest.strip_prefix("super::") {
                front = front.rsplit_once("::").map_or("", |(parent, _)| parent).to_owned();
                rest = further;
            }
            paths(&front, rest, &mut found);
        }
        let longest = |path: String| {
            let mut path = path.as_str();
            while !path.is_empty() && !names.contains(path) {
                path = path.rsplit_once("::").map_or("", |(front, _)| front);
            }
            path.to_owned()
        };
        let uses = found.into_iter().map(longest).filter(|path| !path.is_empty() && *path != own).collect();
        Module { name: own, uses }
    };
    library.iter().map(module).collect()
}

#[test]
fn uses_are_found_in_lists_and_not_in_comments() {
    let mut found = Vec::new();
    paths("a", "b::{self, c::{D, e as f}, g::*};", &mut found);
    assert_eq!(found, ["a::b", "a::b::c::D", "a::b::c::e", "a::b::g"]);
    assert_eq!(
        bare("x // crate::y\n\"crate::z \\\" w\" '\"' v").split_whitespace().collect::<Vec<_>>(),
        ["x", "'\"'", "v"]
    );
}

/// Returns the index of the room of a module of the library; `None` for one of another package.
fn room(rooms: &[String], module: &str) -> Option<usize> {
    let module = module.strip_prefix("murmurate::")?;
    let within = |room: &str| module == room || module.starts_with(&format!("{room}::"));
    let all = rooms.iter().enumerate().filter(|(_, room)| within(room));
    all.max_by_key(|(_, room)| room.len()).map(|(at, _)| at)
}

#[test]
fn no_room_uses_one_that_comes_after_it() {
    let (mut uses, rooms) = (0, rooms());
    assert!(rooms.len() > 20, "{rooms:?}");
    let modules = modules();
    let library = modules.iter().filter(|module| module.name.starts_with("murmurate::"));
    for module in library.filter(|module| !DOORS.contains(&module.name.as_str())) {
        let own =
            room(&rooms, &module.name).unwrap_or_else(|| panic!("ARCHITECTURE.md has no room for {}", module.name));
        for used in &module.uses {
            let Some(other) = room(&rooms, used) else { continue };
            uses += 1;
            assert!(other <= own, "{} uses {used}, which comes after it", module.name);
        }
    }
    assert!(uses > 1000, "the test has seen {uses} uses");
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

/// Files with actors that do input and output, and those that run actors.
const AT_THE_EDGE: [&str; 16] = [
    "crates/crazyflie/src/absent.rs",
    "crates/crazyflie/src/worker.rs",
    "crates/devices/src/gpsd/worker.rs",
    "crates/devices/src/natnet/worker.rs",
    "crates/devices/src/robomaster/sockets.rs",
    "crates/devices/src/robomaster/worker.rs",
    "crates/mavlink/src/absent.rs",
    "crates/mavlink/src/sockets.rs",
    "crates/mavlink/src/worker.rs",
    "crates/ros2/src/supervisor.rs",
    "crates/view/src/",
    "crates/wifi/src/ask.rs",
    "crates/zenoh/src/session.rs",
    "src/edge/",
    "src/localization/odometry.rs",
    "src/runtime/",
];

/// Words that only some files may contain, with these files or the folders that they are in.
const CONFINED: [(&str, &[&str]); 12] = [
    ("unsafe", &["crates/train/src/matrix.rs"]),
    ("actix", &AT_THE_EDGE),
    ("tokio", &AT_THE_EDGE),
    (
        "Instant",
        &[
            "crates/devices/src/robomaster/worker.rs",
            "crates/devices/src/natnet/worker.rs",
            "crates/zenoh/src/session.rs",
            "crates/mavlink/src/worker.rs",
            "crates/ros2/src/",
            "src/edge/",
            "src/runtime/real.rs",
            "crates/view/src/",
            "src/live/",
            "crates/lab/src/machine/",
            "crates/launch/src/",
            "crates/record/src/writer.rs",
            "crates/cli/src/",
            "crates/robot/src/",
        ],
    ),
    (
        "SystemTime",
        &[
            "crates/lab/src/machine/",
            "crates/mavlink/src/worker.rs",
            "crates/ros2/src/dds.rs",
            "crates/cli/src/",
            "crates/robot/src/",
        ],
    ),
    (
        "std::fs",
        &[
            "crates/digest/src/",
            "src/config/regular.rs",
            "crates/lab/src/machine/",
            "crates/record/src/chosen.rs",
            "crates/record/src/file.rs",
            "crates/replay/src/files.rs",
            "crates/ros2/src/node.rs",
            "src/edge/exclusive.rs",
            "crates/cli/src/",
            "crates/robot/src/",
        ],
    ),
    (
        "std::env",
        &[
            "crates/digest/src/",
            "crates/replay/src/files.rs",
            "crates/ros2/src/",
            "src/edge/exclusive.rs",
            "crates/cli/src/",
            "crates/robot/src/",
        ],
    ),
    ("thread_rng", &[]),
    ("rand::rng()", &[]),
    ("HashMap", &[]),
    // Only their folder names the transports.
    (
        "Udp",
        &[
            "crates/crazyflie/src/worker.rs",
            "crates/zenoh/src/route.rs",
            "crates/devices/src/robomaster/sockets.rs",
            "crates/devices/src/robomaster/worker.rs",
            "crates/devices/src/natnet/worker.rs",
            "crates/mavlink/src/sockets.rs",
            "crates/mavlink/src/worker.rs",
            "src/net/transport/",
        ],
    ),
    ("udp::", &["src/net/transport/"]),
];

/// Checks words that only some files may contain.
#[test]
fn access_to_the_machine_is_confined_to_its_files() {
    for source in library() {
        for (word, places) in CONFINED {
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
    let places = ["crates/report/src/", "crates/study/src/", "crates/cli/src/", "crates/robot/src/"];
    for source in library().iter().filter(|source| !places.iter().any(|place| source.path.starts_with(place))) {
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
                "crates/study/src/columns.rs",
                "crates/study/src/commbench/matrix.rs",
                "crates/study/src/published.rs",
                "crates/study/src/network/growth.rs",
                // Defaults of flags.
                "crates/cli/src/sim/mod.rs",
                "crates/cli/src/sim/setup.rs",
                "crates/cli/src/task.rs",
                // A command has the name of a mode.
                "crates/cli/src/lib.rs",
            ],
        ),
        (&["\"wires\"", "\"infra\"", "\"loopback\"", "\"ad-hoc\""], &[presets]),
    ];
    for source in library() {
        for (words, places) in rules {
            for word in words.iter().filter(|_| !places.contains(&&*source.path)) {
                let named = source.lines_with(word);
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

/// Files with attempts that are repeated after a pause: at interfaces, names, sockets, sessions and connections. The
/// benchmark keeps a pace.
const RETRIES: [&str; 5] = [
    "benches/record.rs",
    "crates/robot/src/stop.rs",
    "src/net/transport/link_watch.rs",
    "src/net/transport/netlink.rs",
    "src/net/transport/udp/keeper.rs",
];

#[test]
fn no_code_sleeps_or_is_left_undone() {
    let here = "tests/tidy.rs";
    for source in library_and(&["tests", "benches", "examples"]).iter().filter(|source| source.path != here) {
        for word in ["thread::sleep", "todo!", "unimplemented!", "#[ignore"] {
            assert_eq!(source.lines_with(word), Vec::<String>::new(), "'{word}'");
        }
        // A thread that nobody unparks sleeps. It may, between two attempts at what gives no notice.
        if !(RETRIES.contains(&&*source.path) || source.code().contains("unpark()")) {
            assert_eq!(source.lines_with("park_timeout"), Vec::<String>::new(), "nobody wakes it");
        }
        for mark in ["TODO", "FIXME", "XXX"] {
            assert!(!source.text.contains(mark), "{}: {mark}", source.path);
        }
    }
}

/// Shortest limit of a wait that only what hangs can reach \[s\].
const HANGS_S: u64 = 20;

#[test]
fn no_test_judges_the_wall_clock() {
    let mut seen = 0;
    for source in library_and(&["tests", "benches"]) {
        for line in source.text.lines().filter(|line| line.contains("assert")) {
            // The limit of a time that has passed. Constants with names say what they are.
            let Some((_, limit)) = line.split_once("elapsed()").and_then(|(_, rest)| rest.split_once(" < ")) else {
                continue;
            };
            seen += 1;
            let limit = limit.trim_start_matches("Duration::from_secs(");
            let digits = limit.len() - limit.trim_start_matches(|c: char| c.is_ascii_digit()).len();
            let seconds = limit[..digits].parse().unwrap_or(HANGS_S);
            let hangs = !limit.starts_with("Duration::") && (seconds >= HANGS_S || limit[digits..].starts_with(" * "));
            assert!(hangs, "{}: {}: see tests/program/lateness.rs", source.path, line.trim());
        }
    }
    assert!(seen > 3, "the test has seen {seen} limits");
}

#[test]
fn files_have_a_description_and_a_readable_size() {
    for source in library_and(&["tests", "benches", "examples"]) {
        assert!(source.text.starts_with("//!"), "{}: the first line describes the file", source.path);
        for (index, line) in source.text.lines().enumerate() {
            let width = line.chars().count();
            assert!(width <= WIDTH, "{}:{}: {width} characters", source.path, index + 1);
        }
        let length = source.code().lines().count();
        assert!(length <= LENGTH || source.path.starts_with("tests/"), "{}: {length} lines", source.path);
    }
}

/// Returns the name and the length \[lines\] of every function in formatted code: its end is the next line with the
/// indentation of its beginning that closes a block or a declaration.
fn functions(code: &str) -> Vec<(&str, usize)> {
    let lines: Vec<&str> = code.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let Some((front, rest)) = line.split_once("fn ") else { continue };
        let qualifier = |word: &str| word.starts_with("pub") || ["const", "async", "unsafe", "extern"].contains(&word);
        let named = rest.starts_with(|c: char| c.is_ascii_lowercase() || c == '_');
        if !(named && front.split_whitespace().all(qualifier)) {
            continue;
        }
        let name = rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default();
        let indent = line.len() - line.trim_start().len();
        let closes = |line: &&str| {
            let (front, rest) = line.split_at_checked(indent).unwrap_or((line, ""));
            let outer = front.trim().is_empty() && !rest.starts_with(' ');
            outer && (rest.starts_with('}') || rest.ends_with(';'))
        };
        let short = line.ends_with('}') || line.ends_with(';');
        let more = if short { 0 } else { lines[at + 1..].iter().take_while(|line| !closes(line)).count() + 1 };
        found.push((name, 1 + more));
    }
    found
}

#[test]
fn functions_are_counted_from_their_name_to_their_closing_brace() {
    let code = "pub fn a() {}\n    const fn b(\n        c: fn(u8),\n    ) -> u8 {\n        {\n        }\n    }\n\
        fn d();\nfn e(\n);\n// a fn f() {\n";
    assert_eq!(functions(code), [("a", 1), ("b", 6), ("d", 1), ("e", 2)]);
}

#[test]
fn functions_have_a_readable_size() {
    let (mut seen, mut long) = (0, Vec::new());
    for source in library_and(&["python/src", "benches", "examples"]) {
        for (name, length) in functions(source.code()) {
            seen += 1;
            if length > FUNCTION {
                long.push(format!("{}: {name} has {length} lines", source.path));
            }
        }
    }
    assert!(long.is_empty(), "functions of more than {FUNCTION} lines:\n{}", long.join("\n"));
    assert!(seen > 2000, "the test has seen {seen} functions");
}

#[test]
fn the_digest_of_the_program_has_that_of_every_package() {
    let program = files(&["crates/cli/src/lib.rs"], &["rs"]).remove(0).text;
    for package in packages().iter().filter_map(|folder| folder.strip_prefix("crates/")?.strip_suffix("/src")) {
        // Its own is in a variable; that of the digest itself is of no run.
        let named = program.contains(&format!("murmurate_{package}::DIGEST"));
        assert!(named || ["cli", "digest"].contains(&package), "DIGESTS lacks {package}");
    }
}

#[test]
fn the_map_has_every_package() {
    let map = files(&["ARCHITECTURE.md"], &["md"]).remove(0).text;
    let rows: Vec<&str> = map.lines().filter_map(|line| line.split('|').nth(1)).collect();
    for package in packages().iter().filter_map(|folder| folder.strip_suffix("/src")) {
        let named = format!("`{package}`");
        assert!(rows.iter().any(|row| row.contains(&named)), "the table of packages lacks {package}");
    }
}

#[test]
fn the_list_of_pages_has_every_page() {
    let list = files(&["docs/README.md"], &["md"]).remove(0).text;
    let pages = files(&["docs"], &["md"]).into_iter().map(|page| page.path).filter(|path| path != "docs/README.md");
    let absent: Vec<String> =
        pages.filter(|path| !list.contains(&format!("]({})", path.trim_start_matches("docs/")))).collect();
    assert!(absent.is_empty(), "docs/README.md lacks {absent:?}: they would have no place on the site");
}

#[test]
fn programs_have_names_of_their_own() {
    let mut names: Vec<String> = Vec::new();
    for manifest in files(&["Cargo.toml", "crates"], &["toml"]) {
        let programs = manifest.text.split("[[bin]]").skip(1);
        let named = programs.filter_map(|program| program.split('"').nth(1).map(str::to_owned));
        names.extend(named);
    }
    let all = names.len();
    names.sort_unstable();
    names.dedup();
    assert!(all >= 2 && names.len() == all, "`cargo run` does not know which of {names:?} is meant");
}

/// Returns the files of this repository that a line of text names. `yours` in a path stands for a user's own.
fn paths_in(line: &str) -> impl Iterator<Item = &str> {
    let word = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    let words = line.split(move |c: char| !word(c)).map(|path| path.trim_end_matches(['.', '/']));
    let folders = ["src/", "crates/", "tests/", "benches/", "docs/", "policies/", "teams/", "packaging/"];
    let ours = move |path: &&str| folders.iter().any(|folder| path.starts_with(folder)) && !path.contains("yours");
    let whole = |path: &&str| [".rs", ".md", ".toml", ".py", ".sh"].iter().any(|ending| path.ends_with(ending));
    words.filter(ours).filter(whole)
}

#[test]
fn paths_that_comments_and_pages_name_are_there() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut seen, mut absent) = (0, Vec::new());
    let places = [
        "src",
        "crates",
        "tests",
        "benches",
        "examples",
        "docs",
        "README.md",
        "ARCHITECTURE.md",
        "CONTRIBUTING.md",
        "CHANGELOG.md",
        "SECURITY.md",
    ];
    for Source { path: file, text } in files(&places, &["rs", "md"]) {
        if file == "tests/tidy.rs" {
            continue;
        }
        let commented = |line: &&str| !file.ends_with(".rs") || line.trim_start().starts_with("//");
        for path in text.lines().filter(commented).flat_map(paths_in) {
            seen += 1;
            if !root.join(path).exists() {
                absent.push(format!("{file} names {path}"));
            }
        }
    }
    assert!(absent.is_empty(), "these are not there:\n{}", absent.join("\n"));
    assert!(seen > 100, "the test has seen {seen} paths");
}
