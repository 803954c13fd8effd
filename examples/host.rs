//! A host in real time: a team of three robots, whose two processes find each other over multicast on the loopback
//! interface. Here each is a thread; on robots, each is a program of its own that does what `host` does.
//!
//!     cargo run --release --example host

use std::error::Error;
use std::path::Path;
use std::thread;

use murmurate::deploy::team::TeamFile;
use murmurate::live::LiveHost;
use murmurate::messages::ids::HostId;
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::report::TrialReport;
use murmurate::trial::Trial;

/// Team file, the same for all hosts. docs/teams.md has every field; a team of more than one machine has a key.
const TEAM: &str = r#"
    team = 4711
    mode = "centralized"
    scenario = "passage"
    robots = 3
    episodes = 1
    seed = 5

    [link.infra]
    interface = "lo"
    group = "239.255.77.21:7721"

    [link.wires]
    interface = "lo"
    group = "239.255.77.22:7721"
"#;

/// Runs one host, from the team file to the end of the last episode.
fn host(id: HostId) -> Result<TrialReport, Box<dyn Error + Send + Sync>> {
    let registry = Registry::builtin();
    let team = TeamFile::read(&registry, TEAM, Path::new(""), &[], &[])?.for_host(id)?;
    let trial = Trial::of_host(&registry, &team, Model::shipped(&team.scenario)?)?;
    println!("host '{}' begins", team.deployment.hosts[usize::from(id.0)].name);
    Ok(LiveHost::open(&team, &trial, None, &registry)?.run_to_the_end())
}

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let hosts = [HostId(0), HostId(1)].map(|id| thread::spawn(move || host(id)));
    for handle in hosts {
        let report = handle.join().expect("a host does not panic")?;
        // The host that judges has the results: that of the World of the whole team, or else of the state server.
        for episode in &report.episodes {
            println!("episode {}: {:?} in real time", episode.episode, episode.verdict);
        }
    }
    Ok(())
}
