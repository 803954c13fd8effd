//! Every robot's path as CSV, a line a robot and step: of a trial that is over, or of a team that is running.

use std::io::Write;

use crate::report::trial::Step;
use anyhow::{Context, Result};

/// What is in a line.
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

/// A file of paths.
pub struct Paths<W: Write>(csv::Writer<W>);

impl<W: Write> Paths<W> {
    /// Begins it.
    pub fn new(file: W) -> Result<Paths<W>> {
        let mut csv = csv::Writer::from_writer(file);
        csv.write_record(COLUMNS).context("cannot write the trajectories")?;
        Ok(Paths(csv))
    }

    /// The whole team at one instant.
    pub fn write(&mut self, repeat: usize, step: &Step) -> Result<()> {
        for sample in &step.samples {
            let (p, v, c) = (sample.motion.position, sample.motion.velocity, sample.command);
            let phase = format!("{:?}", step.phase);
            let time = format!("{:.3}", sample.time.as_secs());
            let numbers = [p.x, p.y, v.x, v.y, c.x, c.y].map(|float| float.to_string());
            let head = [repeat.to_string(), step.episode.to_string(), phase, time, sample.robot.0.to_string()];
            self.0.write_record(head.iter().chain(&numbers)).context("cannot write the trajectories")?;
        }
        Ok(())
    }

    /// Lets go of what is still here.
    pub fn flush(&mut self) -> Result<()> {
        self.0.flush().context("cannot write the trajectories")
    }
}
