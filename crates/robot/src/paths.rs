//! Robots' trajectories as CSV, one line per robot and step. Used for finished trials and running teams.

use std::io::Write;

use anyhow::{Context, Result};
use murmurate::report::TrialReport;
use murmurate::results::totals::Step;

use crate::whole_file::WholeFile;

/// Columns of a trajectories file (CSV). Positions and velocities are in the world frame.
const COLUMNS: [&str; 11] = [
    "repeat",
    "episode",
    "phase",
    "time_s",
    "robot",
    "x_m",
    "y_m",
    "vx_m_s",
    "vy_m_s",
    "command_x_m_s",
    "command_y_m_s",
];

/// Writer of robots' trajectories as CSV, with one line for each robot and step.
pub struct Paths<W: Write>(csv::Writer<W>);

impl<W: Write> Paths<W> {
    /// Returns a writer of trajectories to `file`, and writes the header line.
    pub fn new(file: W) -> Result<Paths<W>> {
        let mut rows = csv::Writer::from_writer(file);
        rows.write_record(COLUMNS).context("cannot write the trajectories")?;
        Ok(Paths(rows))
    }

    /// Writes a CSV line for each robot of a step. `repeat` is the index of the step's trial among the repeats, from 0.
    pub fn write(&mut self, repeat: usize, step: &Step) -> Result<()> {
        let (repeat, episode, phase) = (repeat.to_string(), step.episode.to_string(), format!("{:?}", step.phase));
        for sample in &step.samples {
            let (p, v, c) = (sample.motion.position, sample.motion.velocity, sample.command);
            let (time, robot) = (format!("{:.3}", sample.time.as_secs()), sample.robot.0.to_string());
            let numbers = [p.x, p.y, v.x, v.y, c.x, c.y].map(|number| number.to_string());
            let cells = [&repeat, &episode, &phase, &time, &robot].into_iter().chain(&numbers);
            self.0.write_record(cells).context("cannot write the trajectories")?;
        }
        Ok(())
    }

    /// Passes everything written so far to the file.
    pub fn flush(&mut self) -> Result<()> {
        self.0.flush().context("cannot write the trajectories")
    }
}

/// Writes the trajectories of several trials, which are repeats of each other, into one CSV file. `reports` has the
/// report of each, in the order of the repeats.
pub fn write_all(file: &mut WholeFile, reports: &[TrialReport]) -> Result<()> {
    let mut paths = Paths::new(file.writer())?;
    for (repeat, report) in reports.iter().enumerate() {
        report.steps.iter().try_for_each(|step| paths.write(repeat, step))?;
    }
    paths.flush()
}
