//! `murmurate lab check`: measures the accuracy of a laboratory on this machine. The same datagrams go over the channel
//! in real time and in virtual time, and at saturation the throughput is compared with Bianchi's model.

use std::path::PathBuf;

use anyhow::Result;

use murmurate::net::media::radio::{PRESETS, Radio, Topology};
use murmurate::time::Span;
use murmurate_lab::file::Laboratory;
use murmurate_lab::load::{Cast, Load};
use murmurate_lab::machine::accuracy::{self, Accuracy, HEADING};
use murmurate_lab::machine::needs;
use murmurate_robot::output::{print, read_text, talk};
use murmurate_robot::{BadInput, Ended};

/// Flags of `murmurate lab check`.
#[derive(clap::Args)]
#[command(after_help = "Bars: the share delivered within 2 points, p50 and p90 of the delays within 10 % or 0.5 ms, \
    throughput at saturation within 5 % of the model, at most 1 % of the frames late. Exit codes: 0 all are met; 1 one \
    is not, or the machine lacks what a lab needs; 2 a flag is wrong.")]
pub struct Args {
    /// Lab file, for its stations with their places and paths, and its radio [default: stations without places]
    #[arg(value_name = "LAB.toml", conflicts_with_all = ["stations", "preset"])]
    file: Option<PathBuf>,
    /// Numbers of stations
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "5,10")]
    stations: Vec<u16>,
    /// Loads in percent of what the saturated channel delivers; above 100 %, of what it takes from the queues, which
    /// are then full, and throughput is compared with the model [default: 30,50,70,90,250; with a file up to 90]
    #[arg(long, value_name = "PERCENT", value_delimiter = ',')]
    loads: Vec<u32>,
    /// Length of each measurement [s]
    #[arg(long, value_name = "S", default_value = "5", value_parser = clap::value_parser!(u16).range(1..=600))]
    seconds: u16,
    /// Channel, ad hoc, with unicast and multicast at the rates of the preset
    #[arg(long, value_name = "NAME", default_value = "wifi")]
    preset: String,
    /// Multicast at the rate of unicast, so that the machine has more to carry
    #[arg(long)]
    fast_multicast: bool,
    /// Length of a datagram [bytes]
    #[arg(long, value_name = "BYTES", default_value = "200", value_parser = clap::value_parser!(u16).range(8..=1472))]
    bytes: u16,
    /// Casts to measure: unicast, multicast or both
    #[arg(long, value_name = "CAST", value_delimiter = ',', default_value = "unicast,multicast")]
    casts: Vec<String>,
    /// Prints JSON, one object a line, instead of the table
    #[arg(long)]
    json: bool,
}

/// Runs `lab check`.
pub fn run(args: &Args) -> Result<Ended> {
    let labs = laboratories(args)?;
    let casts: Vec<Cast> = [Cast::Unicast, Cast::Multicast]
        .into_iter()
        .filter(|cast| args.casts.iter().any(|asked| asked == cast.name()))
        .collect();
    if casts.len() != args.casts.len() {
        return Err(BadInput("--casts: there are unicast and multicast, each once".to_owned()).into());
    }
    let most = if args.file.is_some() { 100 } else { 1000 };
    let loads: Vec<u32> = match (&args.loads[..], &args.file) {
        ([], None) => vec![30, 50, 70, 90, 250],
        ([], Some(_)) => vec![30, 50, 70, 90],
        (given, _) => given.to_vec(),
    };
    if let Some(wrong) = loads.iter().find(|load| !(1..=most).contains(*load)) {
        return Err(BadInput(format!("--loads: {wrong} is not 1 to {most}")).into());
    }
    needs::check()?;
    if !args.json {
        print(HEADING)?;
    }
    let mut all_met = true;
    for lab in &labs {
        for &cast in &casts {
            for &percent in &loads {
                let row = measure(args, lab, cast, percent)?;
                print(&if args.json { serde_json::to_string(&row)? } else { row.to_string() })?;
                all_met &= row.met;
            }
        }
    }
    Ok(if all_met { Ended::Done } else { Ended::Unfit })
}

/// Returns the laboratories to measure: that of the file, or one for each number of stations.
fn laboratories(args: &Args) -> Result<Vec<Laboratory>> {
    let name = format!("labcheck-{}-", std::process::id());
    let fast =
        |radio: Radio| Radio { basic_rate: if args.fast_multicast { radio.rate } else { radio.basic_rate }, ..radio };
    if let Some(file) = &args.file {
        let wrong = |error| BadInput(format!("the lab file '{}': {error}", file.display()));
        let lab = Laboratory::from_toml(&read_text(file, "lab file")?).map_err(wrong)?;
        return Ok(vec![Laboratory { name, static_arp: true, radio: fast(lab.radio.clone()), ..lab }]);
    }
    let preset =
        Radio::preset(&args.preset).ok_or_else(|| BadInput(format!("--preset: there are {}", PRESETS.join(", "))))?;
    let radio = fast(preset.on(Topology::AdHoc));
    let of = |stations: &u16| {
        let text = format!("name = \"{name}\"\nstations = {stations}\nstatic_arp = true\n");
        let lab = Laboratory::from_toml(&text).map_err(|error| BadInput(format!("--stations: {error}")))?;
        Ok(Laboratory { radio: radio.clone(), ..lab })
    };
    args.stations.iter().map(of).collect()
}

/// Starts a laboratory, and compares one load on it with virtual time.
fn measure(args: &Args, lab: &Laboratory, cast: Cast, percent: u32) -> Result<Accuracy> {
    let lasts = Span::from_secs(f64::from(args.seconds));
    let load = Load { cast, share: f64::from(percent) / 100.0, bytes: usize::from(args.bytes), lasts };
    Ok(accuracy::measure(lab, &load, talk)?)
}
