//! `replay --policy`: gives the recorded inputs of a host to another policy, and compares its actions with the recorded
//! actions.

use std::fmt::Write as _;

use anyhow::{Context, Result};

use super::{Args, sorted, stamp};
use murmurate::config::shown;
use murmurate_record::actions::{RobotDifference, StepDifference};
use murmurate_replay::host::{self, Prepared};
use murmurate_robot::output::{print, stamp_as_recorded};
use murmurate_robot::whole_file::WholeFile;

/// Runs the host `name` again with its recorded inputs and another policy, and prints by how much the actions of each
/// robot differ from the recorded ones. Also writes the files of the flags `--steps` and `--svg`.
pub fn show(args: &Args, name: &str, (prepared, policy): (Prepared, String)) -> Result<()> {
    let compared = host::actions(prepared, stamp);
    stamp_as_recorded(None);
    let (steps, robots) = compared.map_err(sorted)?;
    if let Some(path) = &args.steps {
        let mut file = WholeFile::create(path)?;
        write_steps(&mut file, &steps).context("cannot write the steps")?;
        file.keep()?;
    }
    if let Some(path) = &args.svg {
        let of = |robot: u16| {
            let own = steps.iter().filter(|step| step.robot == robot);
            (robot, own.map(|step| (step.at_s, step.size())).collect())
        };
        let lines: Vec<(u16, Vec<(f64, f64)>)> = robots.iter().map(|robot| of(robot.robot)).collect();
        let title = format!("Actions of {policy} beside those of the record, {name}");
        let mut file = WholeFile::create(path)?;
        let svg = murmurate_report::figures::actions(&title, &lines)?;
        file.writer().write_all(svg.as_bytes()).context("cannot write the figure")?;
        file.keep()?;
    }
    if args.json {
        let said = serde_json::json!({ "host": name, "policy": policy, "robots": robots });
        return print(&said.to_string());
    }
    print(&table(name, &policy, &robots))
}

fn table(host: &str, policy: &str, robots: &[RobotDifference]) -> String {
    let mut text = format!("host {}, policy {} on the recorded inputs", shown::value(host), shown::value(policy));
    if robots.is_empty() {
        text.push_str("\n  this host has published no motor commands");
    }
    for robot in robots {
        let first = robot.first_s.map_or("none differs".to_owned(), |at_s| format!("the first differs at {at_s:.3} s"));
        let RobotDifference { robot, steps, mean_m_s, most_m_s, unpaired, .. } = robot;
        let steps = shown::counted(steps, "step");
        let _ = write!(
            text,
            "\n  robot {robot:<3} {steps}: {first}; difference {mean_m_s:.3} m/s in the mean, {most_m_s:.3} at \
             the most"
        );
        if *unpaired > 0 {
            let _ = write!(text, "; {} of only one of both", shown::counted(unpaired, "step"));
        }
    }
    text
}

/// Writes the differences of all steps as CSV.
fn write_steps(file: &mut WholeFile, steps: &[StepDifference]) -> Result<(), csv::Error> {
    const COLUMNS: [&str; 7] =
        ["time_s", "robot", "recorded_x_m_s", "recorded_y_m_s", "replayed_x_m_s", "replayed_y_m_s", "difference_m_s"];
    let mut rows = csv::Writer::from_writer(file);
    rows.write_record(COLUMNS)?;
    for step in steps {
        let StepDifference { at_s, robot, recorded: [a, b], replayed: [x, y] } = step;
        let numbers = [a, b, x, y].map(|speed| speed.to_string());
        let ends = [at_s.to_string(), robot.to_string(), step.size().to_string()];
        rows.write_record(ends[..2].iter().chain(&numbers).chain(&ends[2..]))?;
    }
    Ok(rows.flush()?)
}
