//! `murmurate launch --lab`: a team whose hosts are stations of a laboratory.

use std::path::Path;

use anyhow::Result;

use super::{Args, Place, run_team};
use crate::lab;
use murmurate::config::shown::counted;
use murmurate::deploy::LinkMedium;
use murmurate::registry::Registry;
use murmurate_lab::file::{CABLE, Laboratory};
use murmurate_lab::machine::{Running, needs};
use murmurate_robot::output::{talk, talk_lines};
use murmurate_robot::{BadInput, Ended};

/// Runs the team with each host in the station of its number, and the live page, if there is one, in the station after
/// the last host. Prints the counters of the laboratory at the end.
pub fn run(args: &Args, file: &Path, registry: &Registry) -> Result<Ended> {
    let laboratory = lab::read(file)?;
    let mut team = args.team.clone();
    let read = team.read(registry)?;
    let (hosts, deployment) = (read.hosts().count(), read.deployment());
    if hosts > usize::from(laboratory.stations) {
        let why =
            format!("the team has {}, and the lab {}", counted(hosts, "host"), counted(laboratory.stations, "station"));
        return Err(BadInput(why).into());
    }
    if args.page.watch && hosts == usize::from(laboratory.stations) {
        let (file, more) = (file.display(), hosts + 1);
        let why = format!(
            "--watch needs a station of its own beside the {}: set 'stations = {more}' in '{file}'",
            counted(hosts, "host")
        );
        return Err(BadInput(why).into());
    }
    for link in &deployment.links {
        let interface = interface(&laboratory, link.medium).ok_or_else(|| {
            BadInput(format!(
                "the link '{}' is no radio, and the lab has no cable for it: set 'cable = \"10.78.0.0\"' in '{}'",
                link.name,
                file.display()
            ))
        })?;
        team.set_interface(&link.name, interface);
    }
    needs::check()?;
    // The team is checked before anything is made.
    let checked = team.read(registry)?;
    for host in checked.hosts() {
        team.for_host(&checked, host)?;
    }
    let running = Running::start(&laboratory, None, talk)?;
    let names: Vec<String> = (0..laboratory.stations).map(|station| laboratory.namespace(station)).collect();
    let before = |_: &str, number: usize| ["ip", "netns", "exec", &names[number]].map(str::to_owned).to_vec();
    let place = Place { before: &before, page: args.page.watch.then(|| names[hosts].as_str()) };
    let ended = run_team(args, &team, &place, registry);
    let report = running.end()?;
    if !args.quiet || report.lateness.late > 0 {
        talk_lines(&report.to_string());
    }
    ended
}

/// Returns the interface of a link in every station: the radio's, or the cable's if there is one.
fn interface(lab: &Laboratory, medium: LinkMedium) -> Option<&str> {
    match medium.topology() {
        Some(_) => Some(&lab.interface),
        None => lab.cable.map(|_| CABLE),
    }
}
