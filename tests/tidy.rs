//! The house rules that a machine can check: reads the source, and nothing but the source.

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

/// The layer of a module; a module may use its own layer and those below.
fn layer(module: &str) -> Option<u8> {
    let layers: [(&str, u8); 33] = [
        ("config", 0),
        ("time", 0),
        ("random", 0),
        ("messages", 0),
        ("cells", 0),
        ("net::transport", 4),
        ("actors::shell", 4),
        ("actors::clock", 4),
        ("actors::drive", 4),
        ("actors::real", 4),
        ("actors::graph", 5),
        ("actors::leading", 5),
        ("actors::process", 5),
        ("actors::sockets", 5),
        ("actors::host", 5),
        ("actors::operator", 5),
        ("actors", 2),
        ("train", 2),
        ("scenario", 1),
        ("world", 1),
        ("policy", 1),
        ("safety", 1),
        ("net", 1),
        ("report::cost", 1),
        ("report::episode", 1),
        ("report::event", 1),
        ("report::statistics", 1),
        ("report::trial", 1),
        ("report", 1),
        ("deploy", 3),
        ("trial", 6),
        ("study", 7),
        ("lib", 8),
    ];
    layers.iter().find(|(name, _)| module == *name || module.starts_with(&format!("{name}::"))).map(|(_, layer)| *layer)
}

#[test]
fn nothing_uses_a_layer_above_its_own() {
    let mut uses = 0;
    for source in sources("src").iter().filter(|source| !source.path.starts_with("src/bin/")) {
        let own =
            source.path.trim_start_matches("src/").trim_end_matches(".rs").trim_end_matches("/mod").replace('/', "::");
        let own_layer =
            layer(&own).unwrap_or_else(|| panic!("{} belongs to no layer; add it to this test", source.path));
        let parent = own.rsplit_once("::").map_or("", |(parent, _)| parent);
        let folder = if source.path.ends_with("/mod.rs") { own.as_str() } else { parent };
        for line in source.code().lines().map(str::trim).filter(|line| !line.starts_with("//")) {
            assert!(!line.contains("crate::{"), "{}: one path a use, so that a reader sees the layers", source.path);
            let absolute = line.replace("use super::", &format!("use crate::{folder}::")).replace("::::", "::");
            for used in absolute.split("crate::").skip(1) {
                let name: String = used.chars().take_while(|c| c.is_alphanumeric() || *c == '_' || *c == ':').collect();
                let Some(used_layer) = layer(name.trim_end_matches(':')) else { continue };
                uses += 1;
                let above = format!("{} (layer {own_layer}) uses {name} (layer {used_layer})", source.path);
                assert!(used_layer <= own_layer, "{above}");
                let apart = own.starts_with("train") && name.starts_with("actors");
                assert!(!apart, "{}: training knows no actor", source.path);
            }
        }
    }
    assert!(uses > 100, "the test has seen {uses} uses");
}

/// Words that only some files may name.
#[test]
fn what_touches_the_machine_is_in_its_place() {
    let rules: [(&str, &[&str]); 10] = [
        ("unsafe", &["src/train/matrix.rs"]),
        ("actix", &["src/actors/shell.rs"]),
        ("tokio", &["src/actors/shell.rs", "src/actors/drive.rs", "src/actors/real.rs", "src/bin/"]),
        ("Instant", &["src/actors/real.rs", "src/bin/"]),
        ("SystemTime", &["src/bin/"]),
        ("std::fs", &["src/bin/"]),
        ("std::env", &["src/bin/"]),
        ("thread_rng", &[]),
        ("rand::rng()", &[]),
        ("HashMap", &[]),
    ];
    for source in sources("src") {
        for (word, places) in rules {
            if !places.iter().any(|place| source.path.starts_with(place)) {
                assert_eq!(source.lines_with(word), Vec::<String>::new(), "'{word}' has no business there");
            }
        }
    }
}

#[test]
fn nothing_sleeps_and_nothing_is_left_for_later() {
    let here = "tests/tidy.rs";
    let all = ["src", "tests", "benches"].into_iter().flat_map(sources).filter(|source| source.path != here);
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
    for source in ["src", "tests", "benches"].into_iter().flat_map(sources) {
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
