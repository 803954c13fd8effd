//! Flags of `murmurate study network`, and creation of a [`Sweep`], the study's settings, from them.

use std::path::{Path, PathBuf};

use anyhow::Result;
use murmurate_study::network::case::{RATES, RETRIES};
use murmurate_study::network::saturation::SIZES;
use murmurate_study::network::{Addressing, History, Medium, NetworkKind, Places, ReliabilityMode, Sweep};
use serde::de::DeserializeOwned;

use crate::study::run::{CommandLine, Run, check_unique};
use murmurate_robot::BadInput;
use murmurate_robot::bad;
use murmurate_robot::output::{read_text, talk};
use murmurate_robot::own_name;

/// Flags of `murmurate study network`.
#[derive(clap::Args)]
pub struct Args {
    /// Medium: a preset (paper, wifi, wifi-n, wifi-slow, wifi-ibss, shaped), a radio file, or a file of shaped links
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "paper")]
    pub medium: String,
    /// Places of the stations: line:GAP, ring:RADIUS or grid:GAP [m], or a file with x and y [m] of one on each line
    #[arg(long, value_name = "FORM:M|FILE", conflicts_with = "live")]
    places: Option<String>,
    /// Message rates, of all stations together [1/s], separated by commas [default: 10,20,60,100,200,300,400,500]
    #[arg(long, value_delimiter = ',')]
    rates: Vec<f64>,
    /// Networks, separated by commas: infrastructure, ad-hoc [default: both]
    #[arg(long, value_delimiter = ',')]
    networks: Vec<String>,
    /// Addressing, separated by commas: unicast, multicast [default: both]
    #[arg(long, value_delimiter = ',')]
    addressing: Vec<String>,
    /// Reliability modes, separated by commas: best-effort, repeat, nack (the project's own), ack (as RTPS), ack-off
    /// (RTPS without positive acknowledgements) [default: all]
    #[arg(long, value_delimiter = ',')]
    reliability: Vec<String>,
    /// Retry limits of unicast frames, separated by commas [default: 1,3,5,7]
    #[arg(long, value_delimiter = ',')]
    pub retries: Vec<u32>,
    /// Number of stations [default: 5, or the hosts of --live]
    #[arg(long)]
    pub stations: Option<u16>,
    /// Payload of a message [bytes]
    #[arg(long, default_value_t = 152)]
    bytes: usize,
    /// History of an RTPS writer: the number of newest samples that it keeps, or 'all'
    #[arg(long, value_name = "N|all", default_value = "1")]
    history: String,
    /// Duration of each case [s]
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
    /// Team sizes for the cost per robot, separated by commas, or 'none' [default: 5,10,20,50,100,200,500,1000; none
    /// with --live or --fit]
    #[arg(long, value_name = "N,N|none", value_delimiter = ',')]
    teams: Vec<String>,
    /// Team file of a measurement between its hosts, on the link that carries latents; the report has measurement and
    /// emulation. Without --host this is the coordinator, which starts each case and writes the report
    #[arg(long, value_name = "TEAM.toml")]
    pub live: Option<PathBuf>,
    /// Host as which this program takes part in a measurement; the coordinator starts each case
    #[arg(long, value_name = "NAME", requires = "live", conflicts_with_all = ["fit", "out", "json"])]
    pub host: Option<String>,
    /// Address at which the coordinator of a measurement listens, and to which its participants connect
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7790", requires = "live")]
    pub coordinator: std::net::SocketAddr,
    /// Sets a field of the team file, such as link.ad-hoc.interface=wlan1; may be given several times
    #[arg(long, value_name = "FIELD=VALUE", requires = "live")]
    pub set: Vec<String>,
    /// Radio file to write: noise loss, background load and rate are fitted to the rows of --rows, or to those measured
    /// by --live
    #[arg(long, value_name = "FILE.toml")]
    pub fit: Option<PathBuf>,
    /// Rows to fit to: output of --json, or rows.json of a report. If some were measured, only those
    #[arg(long, value_name = "FILE.json", requires = "fit", conflicts_with_all = ["live", "out", "teams"])]
    pub rows: Option<PathBuf>,
    /// Flags that all studies share, such as the seed and the output folder.
    #[command(flatten)]
    pub run: Run,
}

/// Parses the names given to a flag, each of which must be one of the values `all`. Returns `all` if none is given.
fn named<T: DeserializeOwned + PartialEq + Clone>(flag: &str, given: &[String], all: &[T]) -> Result<Vec<T>> {
    check_unique(flag, given)?;
    let mut chosen = Vec::new();
    for name in given {
        match serde_json::from_value::<T>(name.as_str().into()) {
            Ok(one) if all.contains(&one) => chosen.push(one),
            _ => return bad(format!("{flag}: there is no '{name}' here; 'study network --help' has all")),
        }
    }
    Ok(if chosen.is_empty() { all.to_vec() } else { chosen })
}

/// Returns places of a form, or those in a file. An error names the flag.
fn places(given: &str) -> Result<Places> {
    if !given.contains(':') {
        if !Path::new(given).exists() {
            return bad(format!(
                "--places: there is no file '{given}'; give it, or line:GAP, ring:RADIUS or grid:GAP [m]"
            ));
        }
        let text = read_text(Path::new(given), "file of places")?;
        return Places::from_text(&text).map_err(|e| BadInput(format!("--places: '{given}': {e}")).into());
    }
    given.parse().or_else(|why| bad(format!("--places: {why}")))
}

/// Returns the medium (a radio, or shaped links) with the name `given`, or from the file with this path. An error names
/// the flag `flag` or the file.
pub fn medium(flag: &str, given: &str) -> Result<Medium> {
    match Medium::named(given) {
        Some(medium) => Ok(medium),
        None if !given.contains(['.', '/']) => {
            let names = Medium::names();
            bad(format!("{flag}: there is no medium '{given}'; there are: {names}, or a file FILE.toml"))
        }
        None => Medium::from_toml(&read_text(Path::new(given), "medium file")?)
            .map_err(|e| BadInput(format!("the medium file '{given}': {e}")).into()),
    }
}

/// Default number of stations that exchange messages.
const STATIONS: u16 = 5;

impl Args {
    /// Prints the path of the radio file that `--fit` has written, and the flags that use it. Prints nothing without
    /// `--fit` or with `--quiet`.
    pub fn print_location(&self) {
        if let (Some(file), false) = (&self.fit, self.run.quiet) {
            talk(&format!("radio in '{0}': use it with 'sim --radio {0}' or 'train --radio {0}'", file.display()));
        }
    }

    /// Returns the parameters of the network study that the flags define. An error names the flag.
    pub fn sweep(&self) -> Result<Sweep> {
        if self.fit.is_some() && self.rows.is_none() && self.live.is_none() {
            return bad("--fit: there are no rows; give --rows FILE.json, or measure with --live TEAM.toml".to_owned());
        }
        let mut sweep = Sweep::whole(medium("--medium", &self.medium)?);
        sweep.networks = match &sweep.medium {
            Medium::Radio(_) => {
                named("--networks", &self.networks, &[NetworkKind::Infrastructure, NetworkKind::AdHoc])?
            }
            Medium::Shaped(_) if !self.networks.is_empty() || !self.retries.is_empty() => {
                return bad("--networks, --retries: shaped links have neither; leave both out".to_owned());
            }
            Medium::Shaped(_) => vec![NetworkKind::Shaped],
        };
        sweep.addressings = named("--addressing", &self.addressing, &[Addressing::Unicast, Addressing::Multicast])?;
        sweep.reliabilities = named("--reliability", &self.reliability, &ReliabilityMode::ALL)?;
        sweep.rates = if self.rates.is_empty() { RATES.to_vec() } else { self.rates.clone() };
        sweep.retries = if self.retries.is_empty() { RETRIES.to_vec() } else { self.retries.clone() };
        check_unique("--rates", &sweep.rates)?;
        check_unique("--retries", &sweep.retries)?;
        sweep.history = match self.history.as_str() {
            "all" => History::All,
            depth => match depth.parse() {
                Ok(depth) => History::Last(depth),
                Err(_) => return bad(format!("--history: '{depth}' is neither a number nor 'all'")),
            },
        };
        (sweep.stations, sweep.bytes, sweep.seconds, sweep.seed) =
            (self.stations.unwrap_or(STATIONS), self.bytes, self.seconds, self.run.seed);
        sweep.places = self.places.as_deref().map(places).transpose()?;
        sweep.check().map_err(|e| BadInput(format!("--{e}")))?;
        Ok(sweep)
    }

    /// Returns the sizes (numbers of robots) of the teams whose cost per robot is to be found, sorted; empty if none is
    /// wanted. An error names the flag.
    pub fn teams(&self) -> Result<Vec<usize>> {
        match self.teams.as_slice() {
            [] if self.live.is_some() || self.fit.is_some() => Ok(Vec::new()),
            [] => Ok(SIZES.to_vec()),
            [none] if none == "none" => Ok(Vec::new()),
            sizes if sizes.iter().any(|size| size == "none") => {
                bad("--teams: 'none' stands alone; give it or sizes".to_owned())
            }
            given => {
                let size = |given: &String| match given.parse::<usize>() {
                    Ok(size) => Ok(size),
                    Err(_) => bad(format!("--teams: '{given}' is not a number of robots")),
                };
                let mut sizes = given.iter().map(size).collect::<Result<Vec<usize>>>()?;
                check_unique("--teams", &sizes)?;
                sizes.sort_unstable();
                Ok(sizes)
            }
        }
    }

    /// Returns the command line that reproduces the study, without flags that do not affect its results.
    pub fn command(&self) -> String {
        let mut command = CommandLine(format!("{} study network", own_name()));
        command.add("medium", Some(self.medium.clone()));
        command.add("places", self.places.clone());
        command.add_all("rates", &self.rates);
        command.add_all("networks", &self.networks);
        command.add_all("addressing", &self.addressing);
        command.add_all("reliability", &self.reliability);
        command.add_all("retries", &self.retries);
        command.add_all("stations", self.stations);
        command.add_all("bytes", [self.bytes]);
        command.add("history", Some(self.history.clone()));
        command.add_all("seconds", [self.seconds]);
        command.add_all("teams", &self.teams);
        let path = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
        command.add("live", path(&self.live));
        command.add("coordinator", self.live.as_ref().map(|_| self.coordinator.to_string()));
        for set in &self.set {
            command.add("set", Some(set.clone()));
        }
        command.add("rows", path(&self.rows));
        command.add("fit", path(&self.fit));
        command.add_all("seed", [self.run.seed]);
        command.0
    }
}
