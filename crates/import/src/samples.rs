//! Samples of a run, in one form for all kinds of files: poses and commands of each robot, and receipts.

use murmurate_record::receipt::Receipt;

/// Most poses, commands and receipts together that are read of a run.
pub const MOST: usize = 20_000_000;

/// Pose of a robot at one time, on the axes of the run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Time \[ns\].
    pub at_ns: i64,
    /// Position \[m\].
    pub position: [f64; 2],
    /// Heading \[rad\]; `None` if it is not known.
    pub yaw: Option<f64>,
    /// Velocity \[m/s\] on the axes of the run; `None` if it is not measured.
    pub velocity: Option<[f64; 2]>,
    /// Whether the robot touches something.
    pub touches: bool,
    /// Number of the value in the column of episodes, in the order of appearance; 0 without such a column, `None` for
    /// an empty cell.
    pub label: Option<u32>,
}

/// Command of a robot, from its time on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Time \[ns\].
    pub at_ns: i64,
    /// Commanded velocity \[m/s\], on the axes of the run or of the robot.
    pub velocity: [f64; 2],
}

/// All that the files of a run hold.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Poses of each robot, by its id.
    pub poses: Vec<Vec<Pose>>,
    /// Commands of each robot, by its id; empty lists if there are none.
    pub commands: Vec<Vec<Command>>,
    /// Messages between robots.
    pub receipts: Vec<Receipt>,
    /// Number of all of them, as they were read.
    count: usize,
}

impl Samples {
    /// Returns the samples of `robots` robots, of which nothing is known yet.
    pub fn of(robots: usize) -> Samples {
        Samples { poses: vec![Vec::new(); robots], commands: vec![Vec::new(); robots], ..Samples::default() }
    }

    /// Counts one more sample, and returns whether it may be read.
    pub fn count(&mut self) -> bool {
        self.count += 1;
        self.count <= MOST
    }
}
