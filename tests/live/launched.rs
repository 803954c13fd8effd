//! A team under `launch`, beside the same team in one process: processes, sockets and real time change little.
//! An episode takes eight seconds of real time; `MURMURATE_LAUNCHED=32` runs so many.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::Arc;

use crate::beside;
use crate::program::{murmurate, text};
use murmurate::deploy::Deployment;
use murmurate::policy::gnn::GnnWeights;
use murmurate::policy::shipped::built_in;
use murmurate::policy::{Model, file};
use murmurate::safety::Safety;
use murmurate::scenario::{self, Settings};
use murmurate::trial::Trial;

const SEED: u64 = 3;
/// Default number of episodes.
const EPISODES: u32 = 3;
/// Number of episodes that may end differently, of up to 32 and of every further 32.
const DIFFERENT: u32 = 2;

/// Returns the verdict and the printed makespan of each episode in one process.
fn simulated(episodes: u32) -> BTreeMap<u32, (String, String)> {
    let scenario = scenario::build("passage", &Settings::default()).expect("the scenario");
    let deployment = Deployment::preset("offboard", scenario.robots()).expect("a preset");
    let file = file::read(built_in("shipped", "passage").expect("it is shipped")).expect("it is sound");
    let draw = file.manifest.draw();
    let trial = Trial::new(deployment, scenario, Model::Gnn(Arc::new(GnnWeights::new(file)), draw));
    let report = Trial { safety: Safety::deployed(), ..trial }.seed(SEED).episodes(episodes).run();
    let told = |episode: &murmurate::results::episode::Episode| {
        let verdict = serde_json::to_value(episode.verdict).expect("it is JSON");
        let verdict = verdict.as_str().expect("it is a word").to_owned();
        let makespan = episode.makespan_s.map_or_else(String::new, |makespan| format!(" in {makespan:.2} s"));
        (episode.episode, (verdict, makespan))
    };
    report.episodes.iter().map(told).collect()
}

/// Returns the same from the log of `launch`.
fn launched(episodes: u32) -> BTreeMap<u32, (String, String)> {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../teams/offboard.toml");
    let set = [
        format!("episodes={episodes}"),
        format!("seed={SEED}"),
        "link.loopback.group=239.255.82.1:41792".to_owned(),
        "link.infra.group=239.255.82.2:41792".to_owned(),
    ];
    let mut args = vec!["launch", file, "--json"];
    args.extend(set.iter().flat_map(|set| ["--set", set]));
    let output = murmurate(&args).env_remove("MURMURATE_LAUNCHED").output().expect("it starts");
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "every process exits cleanly: {said}");
    let told = |line: &str| {
        let (head, tail) = line.strip_prefix("episode ")?.split_once(": ")?;
        let number: u32 = head.split_once(" of ")?.0.parse().ok()?;
        let (verdict, makespan) = tail.split_at(tail.find(" in ").unwrap_or(tail.len()));
        Some((number - 1, (verdict.to_owned(), makespan.to_owned())))
    };
    said.lines().filter_map(told).collect()
}

/// Team of two robots, each simulated by the process that runs its agent.
const APART: &str = r#"
team = 4811
scenario = "passage"
policy = "orca"
episodes = 1

[deployment]
mode = "apart"
robots = 2
placement = "drive"
stepping = "seeded"

[[deployment.host]]
name = "left"
agents = [[0]]
simulates = [0]
state_server = true

[[deployment.host]]
name = "right"
agents = [[1]]
simulates = [1]

[[deployment.link]]
name = "air"
carries = ["reading", "latent", "heartbeat", "mode", "stop"]

[link.air]
interface = "lo"
"#;

/// Settings of the same link with unicast.
const ADDRESSED: &str = r#"
transport = "unicast"
peers = { left = "127.0.0.1:41796", right = "127.0.0.1:41797" }
"#;

/// Output of `launch` for that team: with `--json` or without.
fn launched_apart(name: &str, link: &str, flags: &[&str]) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join(name);
    std::fs::write(&file, format!("{APART}{link}")).expect("it is written");
    let file = file.to_str().expect("its name is text");
    let output = murmurate(&[&["launch", file], flags].concat()).output().expect("it starts");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stdout)
}

#[test]
fn bodies_on_two_hosts_are_judged_from_their_readings() {
    let _beside = beside();
    let said = launched_apart("addressed.toml", ADDRESSED, &["--json"]);
    let summary: serde_json::Value = serde_json::from_str(&said).expect("it is JSON");
    assert_eq!((&summary["judged"], &summary["episodes"]), (&"readings".into(), &1.into()), "{summary}");
    assert_eq!(summary["unseen"], 0, "{summary}");
    assert!(summary["oldest_command_s"].is_null(), "nobody has seen what drives both: {summary}");
    let table = launched_apart("heard.toml", "group = \"239.255.82.3:41793\"\n", &[]);
    assert!(table.contains(" of 1 (95 %") && table.contains("judged       readings"), "{table}");
}

#[test]
fn launch_ends_as_one_process_does() {
    let _beside = beside();
    let episodes = std::env::var("MURMURATE_LAUNCHED").map_or(EPISODES, |given| given.parse().expect("a number"));
    let (real, ideal) = (launched(episodes), simulated(episodes));
    assert_eq!((real.len(), ideal.len()), (episodes as usize, episodes as usize), "every episode has a result");
    let mut different = 0;
    for (episode, ideal) in &ideal {
        let real = &real[episode];
        let mark = if real.0 == ideal.0 { ' ' } else { '!' };
        different += u32::from(real.0 != ideal.0);
        let (ideal, real) = (format!("{}{}", ideal.0, ideal.1), format!("{}{}", real.0, real.1));
        let _ = writeln!(std::io::stderr(), "{mark} episode {episode}: in one process {ideal}, launched {real}");
    }
    let _ = writeln!(std::io::stderr(), "{different} of {episodes} episodes end differently");
    assert!(different <= DIFFERENT * episodes.div_ceil(32), "{different} of {episodes} end differently");
}
