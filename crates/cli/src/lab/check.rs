//! `murmurate lab check`: measures the accuracy of a laboratory on this machine. The same datagrams go over the channel
//! in real time and in virtual time, and at saturation the throughput is compared with Bianchi's model.

use anyhow::Result;

use murmurate::net::media::radio::{PRESETS, Radio, Topology};
use murmurate::time::Span;
use murmurate_lab::file::Laboratory;
use murmurate_lab::load::{Cast, Load};
use murmurate_lab::machine::accuracy::{self, Accuracy, HEADING};
use murmurate_lab::machine::needs;
use murmurate_robot::output::{print, talk};
use murmurate_robot::{BadInput, Ended};

/// Flags of `murmurate lab check`.
#[derive(clap::Args)]
#[command(after_help = "Bars: the share delivered within 2 points, p50 and p90 of the delays within 10 % or 0.5 ms, \
    throughput at saturation within 5 % of the model, at most 1 % of the frames late. Exit codes: 0 all are met; 1 one \
    is not, or the machine lacks what a lab needs; 2 a flag is wrong.")]
pub struct Args {
    /// Numbers of stations
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "5,10")]
    stations: Vec<u16>,
    /// Loads in percent of what the saturated channel delivers; above 100 %, of what it takes from the queues, which
    /// are then full, and throughput is compared with the model
    #[arg(long, value_name = "PERCENT", value_delimiter = ',', default_value = "30,50,70,90,250")]
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
    let mut radio =
        Radio::preset(&args.preset).ok_or_else(|| BadInput(format!("--preset: there are {}", PRESETS.join(", "))))?;
    radio.channel = Topology::AdHoc;
    if args.fast_multicast {
        radio.basic_rate = radio.rate;
    }
    let casts: Vec<Cast> = [Cast::Unicast, Cast::Multicast]
        .into_iter()
        .filter(|cast| args.casts.iter().any(|asked| asked == cast.name()))
        .collect();
    if casts.len() != args.casts.len() {
        return Err(BadInput("--casts: there are unicast and multicast, each once".to_owned()).into());
    }
    if let Some(wrong) = args.loads.iter().find(|load| !(1..=1000).contains(*load)) {
        return Err(BadInput(format!("--loads: {wrong} is not 1 to 1000")).into());
    }
    needs::check()?;
    if !args.json {
        print(HEADING)?;
    }
    let mut all_met = true;
    for &stations in &args.stations {
        for &cast in &casts {
            for &percent in &args.loads {
                let row = measure(args, stations, &radio, cast, percent)?;
                print(&if args.json { serde_json::to_string(&row)? } else { row.to_string() })?;
                all_met &= row.met;
            }
        }
    }
    Ok(if all_met { Ended::Done } else { Ended::Unfit })
}

/// Makes a laboratory, and compares one load on it with virtual time.
fn measure(args: &Args, stations: u16, radio: &Radio, cast: Cast, percent: u32) -> Result<Accuracy> {
    let text = format!("name = \"labcheck-{}-\"\nstations = {stations}\nstatic_arp = true\n", std::process::id());
    let mut lab = Laboratory::from_toml(&text).map_err(|error| BadInput(format!("--stations: {error}")))?;
    lab.radio = radio.clone();
    let lasts = Span::from_secs(f64::from(args.seconds));
    let load = Load { cast, share: f64::from(percent) / 100.0, bytes: usize::from(args.bytes), lasts };
    Ok(accuracy::measure(&lab, &load, talk)?)
}
