//! Reads the records of a run: of all hosts of a team, on a common clock, with a trial of its settings; or that of an
//! imported run, with its mapping.

use std::collections::BTreeSet;
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::record::chosen;
use crate::replay::{confine, of_host};
use murmurate::config::shown::counted;
use murmurate::config::{self, regular};
use murmurate::deploy::Routes;
use murmurate::messages::ids::HostId;
use murmurate::registry::Registry;
use murmurate::trial::Trial;
use murmurate_import::mapping::Mapping;
use murmurate_import::record::Made;
use murmurate_record::clocks::{Alignment, Traffic, align};
use murmurate_record::identity::Identity;
use murmurate_record::reader::{self, ReadError};
use murmurate_replay::files::Files;
use murmurate_robot::{BadInput, bad, team};
use murmurate_study::twin::observed::{Log, ObservedTeam, Run};
use murmurate_study::twin::predict;

/// Recorded run of a team, as read from its records.
pub struct Recorded {
    /// Data of the run: results of episodes, motions of robots, and messages between hosts.
    pub run: Run,
    /// Where it comes from.
    pub origin: Origin,
    /// Notes for the report, such as on records that a crash has cut, and on the uncertainty of the clocks.
    pub notes: Vec<String>,
    /// File name and digest of each record.
    pub digests: Vec<String>,
}

/// Origin of a recorded run.
pub enum Origin {
    /// Hosts of a team of this program: a trial with the settings of the run, under ideal conditions (the fitted model
    /// is not applied yet), and the name of the policy that the robots ran.
    Team(Box<Trial>, String),
    /// Files of another program, which were imported by this mapping, and what was made of them.
    Elsewhere(Box<Mapping>, Made),
}

/// Reads the records of all hosts of a run; `named` has their files or folders. Fails if the record of a host is
/// missing.
pub fn read(named: &[PathBuf], registry: &Registry) -> Result<Recorded> {
    let chosen = chosen::records(named)?.records;
    if let Some((path, _)) = chosen.iter().find(|(_, identity)| identity.imported) {
        return imported(path, chosen.len());
    }
    let wrong = |error: ReadError| BadInput(error.to_string());
    let (mut logs, mut identities, mut notes, mut digests) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut paths = Vec::new();
    for (path, identity) in chosen {
        let Some(host) = &identity.host else {
            return bad(format!(
                "'{}' is the record of a simulation, and only records of hosts have arrivals of messages: a twin is \
                 of a run of hosts, recorded with 'launch --record DIR' or 'host --record DIR'",
                path.display()
            ));
        };
        if identity.excerpt {
            return bad(format!(
                "'{}' has only the seconds around what happened (--record-last): a twin is of whole episodes",
                path.display()
            ));
        }
        let log = Log::read(&path, host.id).map_err(wrong)?;
        if log.has_gaps {
            return bad(format!(
                "'{}' is damaged in its middle: what is lost there would count as lost on its way ('record info' says \
                 where)",
                path.display()
            ));
        }
        if log.traffic.is_encrypted() {
            let record = path.display();
            return bad(format!("what '{record}' has received is encrypted: give copies that 'record share' has made"));
        }
        if !log.complete {
            notes.push(format!("'{}' was cut or is damaged: what is intact counts", path.display()));
        }
        digests.push(digest(&path)?);
        logs.push(log);
        paths.push(path);
        identities.push(identity);
    }
    let (trial, policy) = trial(&paths, &identities, &logs, registry)?;
    if let Some(host) = absent(&trial, &logs) {
        return bad(format!(
            "there is no record of the host '{host}': a twin needs those of all hosts of the run, in one folder or \
             named one after the other"
        ));
    }
    let traffic: Vec<Traffic> = logs.iter_mut().map(|log| std::mem::take(&mut log.traffic)).collect();
    let alignment = align(&traffic);
    notes.extend(of_clocks(&alignment, &identities));
    let routes = Routes::of(&trial.deployment);
    let team = ObservedTeam {
        routes: &routes,
        hosts: trial.deployment.hosts.len(),
        robots: trial.deployment.robots,
        rules: predict::rules(&trial),
        period_ns: trial.models.period().as_nanos() as i64,
    };
    let run = Run::of(&logs, &alignment, &team);
    Ok(Recorded { run, origin: Origin::Team(Box::new(trial), policy), notes, digests })
}

/// Returns notes on the clocks of the hosts: which are not known, and how far the others are.
fn of_clocks(alignment: &Alignment, identities: &[Identity]) -> Vec<String> {
    let mut notes = Vec::new();
    for (identity, _) in identities.iter().zip(&alignment.clocks).filter(|(_, clock)| clock.is_none()) {
        let name = identity.host.as_ref().map_or("", |host| &host.name);
        notes.push(format!("a record of '{name}' is left out: no datagrams join its clock with the others'"));
    }
    let uncertainty = alignment.clocks.iter().flatten().filter_map(|clock| clock.uncertainty_ns()).max().unwrap_or(0);
    notes.push(format!(
        "clocks of the hosts are known to {:.1} ms: a one-way delay may be off by as much, the mean over both \
         directions of a link is not",
        uncertainty as f64 / 1e6
    ));
    notes
}

/// Reads an imported run from its record, which is one of `named` records.
fn imported(path: &Path, named: usize) -> Result<Recorded> {
    let at = path.display();
    if named > 1 {
        return bad(format!("'{at}' is a run from elsewhere, of all its robots: name it alone"));
    }
    let opened = reader::open(path).map_err(|error| BadInput(error.to_string()))?;
    let [(_, text), (_, made), ..] = &opened.attached[..] else {
        return bad(format!("'{at}' has no mapping: import the run again, by 'record import'"));
    };
    let made: Made = serde_json::from_slice(made)
        .map_err(|error| BadInput(format!("'{}' in '{at}': {}", Made::FILE, config::json(&error))))?;
    let mapping = Mapping::of_text(&String::from_utf8_lossy(text));
    let mapping = mapping.map_err(|error| BadInput(format!("the mapping in '{at}': {error}")))?;
    let log = Log::read(path, HostId(0)).map_err(|error| BadInput(error.to_string()))?;
    let mut notes = Vec::new();
    if !log.complete {
        notes.push(format!("'{at}' was cut or is damaged: what is intact counts"));
    }
    let run = Run::imported(&log, mapping.names.len(), mapping.period_ns());
    if run.left_out > 0 {
        let receipts = counted(run.left_out, "receipt");
        notes.push(format!("{receipts} left out: of messages that were sent while no robot was seen in an episode"));
    }
    let ways: BTreeSet<(HostId, HostId)> =
        run.crossings.iter().filter(|one| one.took_ns.is_some()).map(|one| (one.from, one.to)).collect();
    if let Some((from, to)) = ways.iter().find(|(from, to)| !ways.contains(&(*to, *from))) {
        let [from, to] = [from, to].map(|host| mapping.names.get(usize::from(host.0)).map_or("?", |name| name));
        notes.push(format!(
            "messages go from '{from}' to '{to}', and not back: the delay is only right if both of their times are of \
             one clock"
        ));
    }
    Ok(Recorded { run, origin: Origin::Elsewhere(Box::new(mapping), made), notes, digests: vec![digest(path)?] })
}

/// Returns the name of a file and its digest. The file may be longer than memory.
fn digest(path: &Path) -> Result<String> {
    let name = path.file_name().map_or(String::new(), |name| name.to_string_lossy().into_owned());
    let (mut file, mut hasher, mut piece) = (regular::open(path)?, blake3::Hasher::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut piece)? {
            0 => return Ok(format!("{name} {}", hasher.finalize().to_hex())),
            read => hasher.update(&piece[..read]),
        };
    }
}

/// Returns a trial with the settings that the hosts ran, from the team file in the record of the host that judged the
/// episodes; and the policy's name.
fn trial(paths: &[PathBuf], identities: &[Identity], logs: &[Log], registry: &Registry) -> Result<(Trial, String)> {
    let wrong = |error: ReadError| BadInput(error.to_string());
    let Some(judge) = logs.iter().position(Log::has_results) else {
        return bad(
            "no record has the result of an episode: the record of the host that judges is missing, or the run \
                    ended before its first result"
                .to_owned(),
        );
    };
    let (path, identity) = (&paths[judge], &identities[judge]);
    let files = Files::extract(&reader::open(path).map_err(wrong)?)?;
    let _confined = confine(&files, None);
    let team = of_host::team_of(identity, &files, registry, |_| ())?;
    let loaded = team::policy(&team, registry)?;
    if loaded.models.digest() != identity.policy {
        return bad(format!(
            "'{}' is of another policy than '{}' is in this program: use the program that made the record",
            path.display(),
            loaded.name
        ));
    }
    let trial = Trial::of_host(registry, &team, loaded.models).map_err(|error| BadInput(error.to_string()))?;
    Ok((trial, loaded.name))
}

/// Returns the name of a host of the run of which there is no record; `None` if all have one.
fn absent(trial: &Trial, logs: &[Log]) -> Option<String> {
    let has = |number: usize| logs.iter().any(|log| usize::from(log.host.0) == number);
    trial.deployment.hosts.iter().enumerate().find(|(at, _)| !has(*at)).map(|(_, host)| host.name.clone())
}
