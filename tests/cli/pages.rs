//! The pages of `docs/` and the README: their commands run, their files are valid, their links lead somewhere, and the
//! pages that are read first have short sentences.
//!
//! Commands are lines of `sh` blocks that begin with one of `PREFIXES`. Each page has a folder of its own, with the
//! files that `Sandbox::new` puts there and those that the page shows. A page shows a file by naming it in code style,
//! as in `crash.toml`, in the paragraph before a block.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use murmurate_train::config::Config;
use tempfile::TempDir;

use crate::program::{murmurate, run, text};

const PREFIXES: [&str; 3] = ["murmurate ", "cargo run --release -- ", "cargo run --release --example "];

/// Commands that are neither run nor checked with `config check`, each with the reason. Their flags are checked against
/// the help.
const NOT_RUN: &[(&str, &str)] = &[
    (
        "murmurate study network --live team.toml --coordinator 10.0.0.9:7790 --medium wifi --out room",
        "waits for the hosts of a team",
    ),
    (
        "murmurate study network --live team.toml --coordinator 10.0.0.9:7790 --host robot-0",
        "waits for its coordinator",
    ),
    (
        "murmurate study network --rows room/rows.json --fit my-room.toml --medium wifi",
        "a fit takes minutes; tests/cli/study_network.rs has one",
    ),
    ("murmurate replay runs/team", "needs the records of a team in real time; tests/record has some"),
    ("murmurate replay runs/watched --watch", "serves its page until Ctrl-C; tests/page/replay.rs has one"),
    ("murmurate study twin runs/team --out runs/twin", "needs the records of a team; tests/record/twin.rs has some"),
    (
        "murmurate sim --deployment runs/twin/deployment.toml --conditions runs/twin/conditions.toml",
        "needs the files of a twin; tests/record/twin.rs has some",
    ),
    ("murmurate key spread team.toml keys/2.roster", "needs a team that runs; tests/live/rosters.rs has one"),
    ("murmurate record import lab.toml -o runs/lab.mcap", "needs a mapping of the reader's; another one is run"),
    ("murmurate study twin runs/lab.mcap", "needs a run of the reader's; tests/record/lab_run.rs has some"),
    ("murmurate replay runs/lab.mcap --watch", "serves its page until Ctrl-C; tests/page/replay.rs has one"),
    ("murmurate record merge runs/team -o runs/team.mcap", "needs the records of a team in real time"),
];

/// Subcommands that run until they are ended, or need a team that runs. Their flags are checked against the help, and
/// their team file with `config check`.
const LIVE: [&str; 8] = ["host", "launch", "doctor", "stop", "resume", "watch", "place", "cut"];

/// Pages that a new reader reads first.
const FIRST: [&str; 6] = [
    "README.md",
    "docs/what-it-is.md",
    "docs/first-ten-minutes.md",
    "docs/evaluate.md",
    "docs/training.md",
    "docs/bring-your-policy.md",
];
/// Longest sentence of these \[words\].
const WORDS: usize = 30;
/// Longest README \[lines\].
const README_LINES: usize = 120;

pub struct Page {
    /// Path from the root of the repository.
    name: String,
    pub text: String,
}

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn page(name: &str) -> Page {
    let text = fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    Page { name: name.to_owned(), text }
}

/// The pages of a folder, sorted.
fn folder(name: &str) -> Vec<Page> {
    let entries = fs::read_dir(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    let names = entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|file| file.ends_with(".md")).collect();
    names.sort();
    names.iter().map(|file| page(&format!("{name}/{file}"))).collect()
}

/// The pages whose commands are to work: READMEs and `docs/` without the lab notes.
pub fn pages() -> Vec<Page> {
    ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "policies/README.md"]
        .map(page)
        .into_iter()
        .chain(folder("docs"))
        .collect()
}

/// A fenced block.
struct Block<'a> {
    language: &'a str,
    /// The paragraph before it.
    before: String,
    text: String,
}

impl Page {
    fn blocks(&self) -> Vec<Block<'_>> {
        let (mut blocks, mut before, mut open): (Vec<Block>, String, Option<Block>) = Default::default();
        for line in self.text.lines() {
            match (line.strip_prefix("```"), open.as_mut()) {
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (Some(language), None) => {
                    open = Some(Block { language, before: std::mem::take(&mut before), text: String::new() });
                }
                (None, Some(block)) => block.text += &format!("{line}\n"),
                (None, None) if line.is_empty() && before.ends_with('\n') => {}
                (None, None) if line.is_empty() => before.push('\n'),
                (None, None) if before.ends_with('\n') => before = line.to_owned(),
                (None, None) => before += &format!(" {line}"),
            }
        }
        assert!(open.is_none(), "{}: a block has no end", self.name);
        blocks
    }

    /// Commands in order, on one line each, without comments.
    fn commands(&self) -> Vec<String> {
        let scripts = self.blocks().into_iter().filter(|block| block.language == "sh");
        let lines = scripts.flat_map(|block| {
            let joined = block.text.replace("\\\n", " ");
            joined.lines().map(str::to_owned).collect::<Vec<_>>()
        });
        let plain = lines.map(|line| {
            let line = line.split_once(" #").map_or(line.as_str(), |(command, _)| command);
            line.split_whitespace().collect::<Vec<_>>().join(" ")
        });
        plain.filter(|line| PREFIXES.iter().any(|prefix| line.starts_with(prefix))).collect()
    }

    /// Text outside of fenced blocks.
    fn prose(&self) -> String {
        let mut inside = false;
        let lines = self.text.lines().filter(|line| {
            let fence = line.starts_with("```");
            inside ^= fence;
            !fence && !inside
        });
        lines.collect::<Vec<_>>().join("\n")
    }
}

impl Block<'_> {
    /// The file that it shows: the one code span of the paragraph before it that is a file name.
    fn file(&self) -> Option<&str> {
        let ending = format!(".{}", self.language);
        let spans = self.before.split('`').skip(1).step_by(2);
        let mut files = spans.filter(|span| span.ends_with(&ending) && !span.contains([' ', '/', '<']));
        files.next().filter(|_| files.next().is_none() && ["toml", "py"].contains(&self.language))
    }
}

/// The folder in which the commands of a page run.
struct Sandbox(TempDir);

impl Sandbox {
    fn new(page: &Page) -> Sandbox {
        let sandbox = Sandbox(TempDir::new().expect("a temporary folder"));
        for name in ["teams", "tests", "policies", "examples"] {
            std::os::unix::fs::symlink(root().join(name), sandbox.at(name)).expect("a link");
        }
        fs::copy(root().join("teams/onboard-wlan.toml"), sandbox.at("team.toml")).expect("the team file");
        sandbox.run(&["key", "new", "--out", "team.key"]).expect("a key");
        let weights = root().join("policies/passage-published.safetensors");
        fs::copy(weights, sandbox.at("weights.safetensors")).expect("a policy file");
        sandbox.write("my-room.toml", "noise_loss = 0.05\n");
        sandbox.write("small.toml", &small_training());
        sandbox.write("small-imitation.toml", &small_imitation("imitation", 20));
        sandbox.write("small-coverage.toml", &small_imitation("coverage", 2));
        for block in page.blocks() {
            if let Some(file) = block.file() {
                sandbox.write(file, &block.text);
            }
        }
        sandbox
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, content: &str) {
        fs::write(self.at(name), content).expect("a temporary file");
    }

    /// Runs the program to its end and returns what it prints; unless it succeeds, what went wrong.
    fn run(&self, args: &[impl AsRef<str>]) -> Result<String, String> {
        let args: Vec<&str> = args.iter().map(AsRef::as_ref).collect();
        let output = murmurate(&args).current_dir(self.0.path()).output().expect("the program starts");
        if output.status.success() {
            return Ok(text(&output.stdout));
        }
        Err(format!("as {args:?}: {}", text(&output.stderr)))
    }
}

/// A training configuration that takes no time.
fn small_training() -> String {
    let mut config = Config::preset("robust").expect("it is a preset");
    // Those of its groups; the default team of a task file may be another.
    config.robots = Some(5);
    (config.ppo.environments, config.ppo.decisions, config.ppo.minibatch) = (40, 4, 80);
    (config.policy.encoder, config.policy.update) = (vec![6, 6], vec![8]);
    config.policy.message = vec![8, 8];
    toml::to_string(&config).expect("a configuration is TOML")
}

/// A training by imitation that takes little time, from the preset of this name.
fn small_imitation(preset: &str, robots: usize) -> String {
    let mut config = murmurate_train::imitation::config::Config::preset(preset).expect("it is a preset");
    (config.robots, config.imitation.episodes) = (Some(robots), 1);
    (config.policy.message, config.policy.update) = (vec![4], vec![4]);
    // Ten seconds are one decision where a preset holds them at all.
    config.imitation.repeat = if config.imitation.repeat > 1 { 200 } else { 1 };
    toml::to_string(&config).expect("a configuration is TOML")
}

/// Arguments of a command, which can be changed.
#[derive(Clone)]
struct Args(Vec<String>);

impl Args {
    fn of(command: &str) -> Args {
        Args(command.split(' ').map(str::to_owned).collect())
    }

    fn value(&self, flag: &str) -> Option<&str> {
        let at = self.0.iter().position(|arg| arg == flag)?;
        self.0.get(at + 1).map(String::as_str)
    }

    fn has(&self, flag: &str) -> bool {
        self.0.iter().any(|arg| arg == flag)
    }

    /// Without a flag that has a value, however often it is there.
    fn without(mut self, flag: &str) -> Args {
        while let Some(at) = self.0.iter().position(|arg| arg == flag) {
            self.0.drain(at..at + 2);
        }
        self
    }

    fn with(self, flag: &str, value: &str) -> Args {
        let mut args = self.without(flag);
        args.0.extend([flag.to_owned(), value.to_owned()]);
        args
    }

    fn quiet(mut self) -> Args {
        if !self.has("--quiet") {
            self.0.push("--quiet".to_owned());
        }
        self
    }

    /// The same command with less to do.
    fn bounded(self) -> Args {
        match (self.0[0].as_str(), self.0.get(1).map(String::as_str)) {
            ("sim", _) => {
                let large = self.value("--robots").is_some_and(|robots| robots.len() > 2);
                let large = large || self.value("--scenario") == Some("flocking");
                let few = if large { self.with("--robots", "20") } else { self };
                let first = if few.has("--episode") { few.with("--episode", "1") } else { few };
                // A plan may name the second episode.
                let episodes = if first.has("--faults") { "2" } else { "1" };
                first.with("--episodes", episodes).with("--repeats", "1").quiet()
            }
            ("study", Some("network")) => {
                let one = self.with("--rates", "60").with("--retries", "1").with("--teams", "none");
                one.with("--seconds", "1").quiet()
            }
            ("study", Some("commbench")) => {
                let few = self.with("--tasks", "passage").with("--channels", "iid-30");
                few.with("--episodes", "1").quiet()
            }
            ("study", Some("sweep")) => self.with("--episodes", "1").with("--repeats", "1").quiet(),
            ("study", _) => self.with("--layouts", "1").with("--repeats", "1").quiet(),
            ("train", _) if self.has("--print-config") => self,
            ("train", Some(name @ ("flocking" | "coverage"))) => {
                let config = if name == "coverage" { "small-coverage.toml" } else { "small-imitation.toml" };
                let small = self.without("--preset").without("--robots").with("--config", config);
                small.without("--minutes").with("--steps", "100").quiet()
            }
            ("train", _) => {
                let small = self.without("--preset").without("--robots").with("--config", "small.toml");
                small.without("--minutes").with("--steps", "160").quiet()
            }
            ("key", Some("new")) => {
                let mut args = self;
                args.0.push("--force".to_owned());
                args
            }
            _ => self,
        }
    }
}

/// Whether the help of a command lists subcommands.
fn has_subcommands(command: &str) -> bool {
    text(&run(&[command, "--help"]).stdout).contains("\nCommands:\n")
}

/// Checks that the help of a subcommand has all flags of a command.
fn check_flags(args: &Args) -> Result<(), String> {
    let depth = if has_subcommands(&args.0[0]) { 2 } else { 1 };
    let words = args.0.iter().take(depth).filter(|arg| !arg.starts_with('-'));
    let names: Vec<&str> = words.map(String::as_str).chain(["--help"]).collect();
    let output = run(&names);
    if !output.status.success() {
        return Err(format!("there is no {names:?}"));
    }
    let help = text(&output.stdout);
    let known: BTreeSet<&str> = help.split_whitespace().map(|word| word.trim_end_matches(',')).collect();
    // What follows is another program's.
    let mut own = args.0.iter().take_while(|arg| *arg != "--");
    match own.find(|arg| arg.starts_with("--") && !known.contains(arg.as_str())) {
        Some(flag) => Err(format!("{names:?} has no {flag}")),
        None => Ok(()),
    }
}

/// Runs a command of a page, or checks as much of it as can be checked.
fn check(sandbox: &Sandbox, command: &str, done: &Mutex<BTreeSet<String>>) -> Result<(), String> {
    if let Some(example) = command.strip_prefix(PREFIXES[2]) {
        let is_there = root().join(format!("examples/{example}.rs")).is_file();
        return if is_there { Ok(()) } else { Err("there is no such example".to_owned()) };
    }
    let arguments = PREFIXES[..2].iter().find_map(|prefix| command.strip_prefix(prefix)).expect("it has a prefix");
    let (arguments, into) = arguments.split_once(" > ").map_or((arguments, None), |(args, file)| (args, Some(file)));
    let args = Args::of(arguments);
    if args.0[0] == "lab" || args.has("--lab") {
        // tests/lab runs them, where there are the feature, namespaces and interfaces.
        return if cfg!(feature = "lab") { check_flags(&args) } else { Ok(()) };
    }
    if NOT_RUN.iter().any(|(text, _)| *text == command) {
        return check_flags(&args);
    }
    if LIVE.contains(&args.0[0].as_str()) {
        check_flags(&args)?;
        let mut checked = vec!["config".to_owned(), "check".to_owned(), args.0[1].clone()];
        for flag in ["--host", "--robot", "--set", "--interface", "--key-file"] {
            checked.extend(args.value(flag).into_iter().flat_map(|value| [flag.to_owned(), value.to_owned()]));
        }
        return sandbox.run(&checked).map(|_| ());
    }
    if args.0[0] == "train" && args.has("--out") {
        // Its own configuration, which is too large to be trained here.
        let own = args.clone().without("--out").without("--minutes").without("--steps").without("--from");
        let own = own.0.into_iter().filter(|arg| arg != "--resume").chain(["--print-config".to_owned()]);
        sandbox.run(&own.collect::<Vec<_>>())?;
    }
    let writes = into.is_some() || args.has("--out");
    let bounded = args.bounded();
    if !writes && !done.lock().expect("no test panicked").insert(bounded.0.join(" ")) {
        return Ok(());
    }
    let said = sandbox.run(&bounded.0)?;
    if let Some(file) = into {
        sandbox.write(file, &said);
    }
    Ok(())
}

#[test]
fn every_command_of_the_pages_works() {
    let (pages, done, next, wrong) = (pages(), Mutex::default(), AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work = || {
        while let Some(page) = pages.get(next.fetch_add(1, Ordering::Relaxed)) {
            let commands = page.commands();
            let sandbox = (!commands.is_empty()).then(|| Sandbox::new(page));
            for (command, sandbox) in commands.iter().zip(sandbox.iter().cycle()) {
                if let Err(why) = check(sandbox, command, &done) {
                    wrong.lock().expect("no test panicked").push(format!("{}: {command}\n{why}", page.name));
                }
            }
        }
    };
    thread::scope(|scope| {
        scope.spawn(work);
        work();
    });
    let wrong = wrong.into_inner().expect("no test panicked");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let all: Vec<String> = pages.iter().flat_map(Page::commands).collect();
    assert!(all.len() > 50, "the pages have {} commands", all.len());
    for (command, reason) in NOT_RUN {
        assert!(all.iter().any(|other| other == command), "no page has '{command}' ({reason}); take it off the list");
    }
}

#[test]
fn every_flag_of_a_command_in_the_text_exists() {
    let mut seen = BTreeSet::new();
    for page in pages() {
        let prose = page.prose();
        for span in prose.split('`').skip(1).step_by(2) {
            let span = span.split_whitespace().collect::<Vec<_>>().join(" ");
            let short = ["sim --", "study ", "train --", "launch --"].iter().any(|start| span.starts_with(start));
            let command = span.strip_prefix("murmurate ").or(short.then_some(&span));
            let Some(command) = command.filter(|command| !command.starts_with('-') && seen.insert(command.to_string()))
            else {
                continue;
            };
            if !cfg!(feature = "lab") && command.contains("lab") {
                continue;
            }
            let checked = check_flags(&Args::of(command));
            assert!(checked.is_ok(), "{}: `{span}`: {checked:?}", page.name);
        }
    }
    assert!(seen.len() > 20, "the text has {} commands", seen.len());
}

#[test]
fn team_files_and_fault_plans_of_the_pages_are_valid() {
    let mut checked = 0;
    for page in pages() {
        for block in page.blocks().iter().filter(|block| block.language == "toml") {
            let line = |start: &str| block.text.lines().any(|line| line.starts_with(start));
            let args = if line("team =") {
                "config check shown.toml"
            } else if line("fault = \"flat\"") {
                // Only robots that fly have a battery.
                "sim --deployment flies.toml --faults shown.toml --episodes 2 --repeats 1 --quiet"
            } else if line("fault =") {
                "sim --mode onboard-adhoc --faults shown.toml --episodes 2 --repeats 1 --quiet"
            } else {
                continue;
            };
            let sandbox = Sandbox::new(&page);
            sandbox.write("shown.toml", &block.text);
            let preset = sandbox.run(&["deployment", "onboard-adhoc"]).expect("it is a preset");
            sandbox.write("flies.toml", &format!("{preset}\n[body]\nheight_m = 1.0\n"));
            let ran = sandbox.run(&args.split(' ').collect::<Vec<_>>());
            assert!(ran.is_ok(), "{}:\n{}\n{ran:?}", page.name, block.text);
            checked += 1;
        }
    }
    assert!(checked >= 4, "{checked} blocks were checked");
}

/// The anchors of a page's headings, as GitHub makes them.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let anchor = |heading: &str| -> String {
        let kept = heading.to_lowercase().replace(' ', "-");
        kept.chars().filter(|c| c.is_alphanumeric() || *c == '-' || *c == '_').collect()
    };
    headings.map(anchor).collect()
}

#[test]
fn every_link_of_the_pages_leads_to_a_file_and_a_heading() {
    let all: Vec<Page> = pages().into_iter().chain(folder("docs/evidence")).chain([page("ARCHITECTURE.md")]).collect();
    let mut known: BTreeMap<PathBuf, BTreeSet<String>> = BTreeMap::new();
    let mut links = 0;
    for page in &all {
        let prose = page.prose();
        let targets = prose.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target);
        for target in targets.filter(|target| !target.contains("://")) {
            links += 1;
            // A package of a registry does not contain other packages.
            if target.contains("tests/stranger") && !root().join("tests/stranger").exists() {
                continue;
            }
            let of = format!("{}: ({target})", page.name);
            let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
            let here = root().join(&page.name);
            let path = if file.is_empty() { here } else { here.parent().expect("a folder").join(file) };
            let path = path.canonicalize().unwrap_or_else(|e| panic!("{of}: {e}"));
            if !anchor.is_empty() {
                let read = || Page { name: of.clone(), text: fs::read_to_string(&path).expect("a page") };
                let anchors = known.entry(path.clone()).or_insert_with(|| anchors(&read().prose()));
                assert!(anchors.contains(anchor), "{of}: there are {anchors:?}");
            }
        }
    }
    assert!(links > 100, "the pages have {links} links");
}

/// Paragraphs, items and cells of a page, each as its words.
fn paragraphs(prose: &str) -> Vec<String> {
    let mut found = vec![String::new()];
    for line in prose.lines() {
        let (item, number) = (line.trim_start(), line.trim_start().split_once(". "));
        let numbered = number.is_some_and(|(number, _)| number.parse::<u32>().is_ok());
        if line.starts_with('|') {
            found.extend(line.replace("\\|", "/").split('|').map(str::to_owned));
            found.push(String::new());
        } else if item.is_empty() || item.starts_with(['#', '!']) || item.starts_with("- ") || numbered {
            found.push(item.to_owned());
        } else if line.starts_with("    ") && !item.starts_with('-') {
            found.push(String::new());
        } else {
            *found.last_mut().expect("there is one") += &format!(" {item}");
        }
    }
    found
}

/// Sentences of a page without addresses of links.
fn sentences(page: &Page) -> Vec<String> {
    let mut sentences = Vec::new();
    for paragraph in paragraphs(&page.prose()) {
        let mut parts = paragraph.split("](");
        let mut plain = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            plain += part.split_once(')').map_or(part, |(_, rest)| rest);
        }
        let mut sentence = Vec::new();
        for word in plain.split_whitespace().filter(|word| *word != "-") {
            sentence.push(word);
            if word.trim_end_matches([')', '"', '*', '`', ']']).ends_with(['.', '!', '?']) {
                sentences.push(std::mem::take(&mut sentence).join(" "));
            }
        }
        sentences.push(sentence.join(" "));
    }
    sentences
}

#[test]
fn the_readme_is_one_page_and_what_is_read_first_has_short_sentences() {
    let lines = page("README.md").text.lines().count();
    assert!(lines <= README_LINES, "README.md has {lines} lines");
    let mut long = Vec::new();
    for page in FIRST.map(page) {
        let words = |sentence: &String| sentence.split(' ').count() > WORDS;
        let found = sentences(&page);
        assert!(found.len() > 20, "{} has {} sentences", page.name, found.len());
        long.extend(found.into_iter().filter(words).map(|sentence| format!("{}: {sentence}", page.name)));
    }
    assert!(long.is_empty(), "sentences of more than {WORDS} words:\n{}", long.join("\n"));
}
