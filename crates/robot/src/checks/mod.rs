//! Checks whether this machine can be a host of a team, with advice where it cannot. Nothing is printed: a check is a
//! value.
//!
//! Local checks come first, then reception from other hosts. For this it sends link reports under ids of its own, so
//! that running robots are not disturbed. The drivers, the source and the senses of the host are checked last, unless
//! the host is running and uses them.

mod bench;
mod contained;
mod devices;
mod finding;
mod listen;
mod local;
mod notes;
mod senses;
mod table;
mod ways;
mod wiggle;

pub use finding::{Check, Subject};
pub use notes::{Notes, Warnings};

use anyhow::Result;
use murmurate::deploy::Host;
use murmurate::deploy::team::Team;
use murmurate::fitness::Fitness;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::registry::Registry;

use crate::team;
use finding::Found;
use listen::Reception;

/// Function that asks whether the robots of a host may be driven.
pub type Confirm<'a> = dyn Fn(&Team) -> Result<bool> + 'a;

/// Parameters of the checks: hosts, times, and functions for questions and progress.
pub struct Examination<'a> {
    /// Settings of each host that this machine is to be.
    pub teams: &'a [Team],
    /// Returns the settings of all hosts of the team; called if they are needed.
    pub all: &'a dyn Fn() -> Result<Vec<Team>>,
    /// Parts that policies, drivers and the like are looked up in.
    pub registry: &'a Registry,
    /// Time to listen to other hosts, and then to the devices of this one \[s\]; with 0 these checks are left out.
    pub listen_s: f64,
    /// Asks whether the robots of a host may be driven 10 cm and back; `None` if none is to be driven.
    pub confirm: Option<&'a Confirm<'a>>,
    /// Called with a line of text when a robot begins to drive.
    pub tell: fn(&str),
}

/// Results of all checks.
#[derive(Debug)]
pub struct Report {
    /// Each check with its result.
    pub checks: Vec<Check>,
    /// Whether the checks were interrupted by Ctrl-C or SIGTERM.
    pub interrupted: bool,
}

impl Report {
    /// Returns whether no check has failed.
    pub fn is_fit(&self) -> bool {
        self.checks.iter().all(|check| check.status != Fitness::Fail)
    }

    /// Returns the lines of the table of the results for the hosts with these names, with the verdict at the end.
    /// Checks that differ only in their property, their link or their host share a line.
    pub fn lines(&self, hosts: &[&str]) -> Vec<String> {
        let lines = table::lines(&self.checks);
        let verdict = table::verdict(&lines, hosts);
        lines.iter().map(|line| line.text(hosts.len())).chain([verdict]).collect()
    }
}

/// Returns the deployment's entry of the host `team.host`.
pub fn host_of(team: &Team) -> &Host {
    &team.deployment.hosts[usize::from(team.host.0)]
}

/// Makes the checks. Fails if one cannot be made.
pub fn examine(examination: &Examination) -> Result<Report> {
    let &Examination { teams, listen_s, .. } = examination;
    let mut checks: Vec<Check> = Vec::new();
    for team in teams {
        let found = local::check(team, examination.registry).into_iter();
        checks.extend(found.map(|found| Check::of(&host_of(team).name, found)));
    }
    let mut report = Report { checks, interrupted: false };
    let sound = report.is_fit();
    if examination.confirm.is_some() && !sound {
        let found = wiggle::failed("not begun: a check before it has failed", "");
        report.checks.push(Check::of("here", found));
    }
    if listen_s > 0.0 && sound {
        let heard = listen::listen(teams, &(examination.all)()?, listen_s)?;
        report.checks.extend(heard.found.iter().cloned().map(|found| Check::of("here", found)));
        let mut places = Vec::new();
        for team in teams {
            let (found, end) = look(examination, team, &heard, &mut places)?;
            report.checks.extend(found.into_iter().map(|found| Check::of(&host_of(team).name, found)));
            if let bench::End::Interrupted = end {
                report.interrupted = true;
                break;
            }
            if !heard.hosts.contains(&team.host) {
                let found = senses::look(team, examination.registry, listen_s)?;
                report.checks.extend(found.into_iter().map(|found| Check::of(&host_of(team).name, found)));
            }
        }
        report.checks.extend(devices::at_one_place(&places).into_iter().map(|found| Check::of("here", found)));
    }
    Ok(report)
}

/// Checks the drivers and the source of the host `team.host`, and drives its robots if that is wanted. Returns the
/// findings, and why the check ended.
///
/// The devices are not opened if the host is running already, according to `heard`. Where robots are to be driven, they
/// are not opened either if `heard` has a reason why no robot may be driven, or if the user does not confirm the drive.
/// Where the source has measured robots is appended to `places`.
fn look(
    examination: &Examination,
    team: &Team,
    heard: &Reception,
    places: &mut Vec<(RobotId, Vec2)>,
) -> Result<(Vec<Found>, bench::End)> {
    let (host, registry) = (host_of(team), examination.registry);
    let wiggles = examination.confirm.is_some() && !host.actuates.is_empty();
    let done = |found: Vec<Found>| Ok((found, bench::End::Done));
    if host.actuates.is_empty() && host.localizes.is_empty() {
        return done(Vec::new());
    }
    if heard.hosts.contains(&team.host) {
        let said = format!("host '{}' is running, and its devices are its own", host.name);
        let status = if wiggles { Fitness::Fail } else { Fitness::Warn };
        let what = if wiggles { "wiggle" } else { "devices" };
        let advice = "end it to check them here".to_owned();
        return done(vec![(status, Subject::General(what.to_owned()), said, advice)]);
    }
    let mut plan = None;
    if let Some(confirm) = examination.confirm.filter(|_| wiggles) {
        if let Some(why) = &heard.hindrance {
            return done(vec![wiggle::failed(&format!("refused: {why}"), "")]);
        }
        if !confirm(team)? {
            return done(vec![wiggle::failed("not confirmed: no robot has moved", "")]);
        }
        plan = Some((wiggle::config(team, registry)?, listen::operator(team)?));
    }
    let (seen, end) = bench::look(team, registry, examination.listen_s, plan, examination.tell)?;
    let scenario = team::scenario(team, registry)?;
    let mut found = seen.findings(team, examination.listen_s, scenario.arena().half_extent);
    places.extend(seen.places());
    let localizes = !host.localizes.is_empty();
    found.extend(seen.results.iter().map(|(robot, verdict)| wiggle::finding(*robot, verdict, localizes)));
    if let bench::End::Team(why) = &end {
        found.push(wiggle::failed(&format!("ended, and all robots stand: {why}"), ""));
    }
    Ok((found, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_failed_check_makes_a_machine_unfit_and_the_table_says_so() {
        let check = |status| {
            let what = Subject::General("key".to_owned());
            Check { status, host: "here".to_owned(), what, found: "x".to_owned(), advice: String::new() }
        };
        let report = |checks| Report { checks, interrupted: false };
        let fit = report(vec![check(Fitness::Ok), check(Fitness::Warn)]);
        assert!(fit.is_fit());
        assert_eq!(
            fit.lines(&["a"]),
            ["ok   key: x", "warn key: x", "fit: this machine can be host 'a'; 1 warning above"]
        );
        let unfit = report(vec![check(Fitness::Fail)]);
        assert!(!unfit.is_fit());
        assert_eq!(unfit.lines(&["a"])[1], "not fit to be host 'a': 1 check failed, 0 warnings");
    }
}
