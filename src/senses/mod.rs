//! Senses: sensors of a robot for its surroundings, whose values are arrays that a policy takes by the sense's name. A
//! sense is one module and one line in `REGISTRY`.
//!
//! A sense does no I/O: it computes its values from the true surroundings of a simulated robot, or converts the packets
//! of its worker. It belongs to the host of the robot's Body, and its values travel to the robot's Agent as `Sensed`
//! messages.

pub mod contract;
mod lidar;
mod paced;
mod program;
pub mod rays;
mod relative;
mod task;

use serde::{Deserialize, Serialize};

pub use self::lidar::Scanner;
use self::paced::{Measure, Pace, Simulated};

use self::rays::MAX_RAYS;
use crate::config::ConfigError;
use crate::edge;
use crate::messages::ids::RobotId;
use crate::messages::local::Scene;
use crate::messages::wire::MAX_SENSED;
use crate::observation::sense::WHOLE_RAD;
use crate::observation::{Channel, Sweep, Unit};
use crate::random::Stream;
use crate::scenario::Arena;
use crate::time::Time;

/// Largest number of senses of a robot.
pub const MAX_SENSES: usize = 16;

/// Settings of a sense in a deployment: its kind, and a table that only this kind reads.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Name of the kind of sense in the registry, such as `lidar`.
    pub kind: String,
    /// Settings that the kind of sense itself defines, as a TOML table.
    #[serde(flatten)]
    pub table: toml::Table,
}

impl Settings {
    /// Returns the settings of a sense in a task file, of which `kind` is one entry.
    pub fn of_task(mut table: toml::Table) -> Settings {
        let kind = table.remove("kind").and_then(|kind| kind.as_str().map(str::to_owned)).unwrap_or_default();
        Settings { kind, table }
    }

    /// Returns the table as settings of a part with the sense's `name`, by which errors name the field.
    pub(crate) fn named(&self, name: &str) -> edge::Settings {
        edge::Settings { name: name.to_owned(), table: self.table.clone() }
    }
}

/// Input of a sense.
#[derive(Clone, Copy, Debug)]
pub enum In<'a> {
    /// True poses of all robots, from the World that simulates the robot of the sense.
    Scene(&'a Scene),
    /// Packet from the worker of the sense.
    Packet(&'a [u8]),
}

/// Output of a sense.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Values of the sense, as many as its [`Layout`] says. One that is infinite stands for no echo.
    Values {
        /// Time of measurement \[ns\] on the clock of the sensor.
        stamp_ns: u64,
        /// The values, in the unit of the layout.
        values: Vec<f32>,
    },
    /// Notice that an input could not be used, with the reason.
    Refused(&'static str),
}

/// Sense of one robot: computes its values from the robot's surroundings, or from packets of its worker.
/// Implementations do no I/O.
pub trait Sense {
    /// Handles one input at time `now` and appends values and refusals to `out`.
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>);

    /// Takes the arena of the episode that begins, world frame, in place of that of the `Site` for which the sense was
    /// made. The default does nothing, for senses that do not compute their values from the arena.
    fn enter(&mut self, _arena: &Arena) {}

    /// Returns the time at which `wake` has to be called next; `None` if no call is needed.
    fn wake_at(&self) -> Option<Time> {
        None
    }

    /// Does the work that is due at time `_now` and appends values to `_out`; called at the time that `wake_at` gives.
    fn wake(&mut self, _now: Time, _out: &mut Vec<Out>) {}
}

/// Robot and surroundings for which a sense is made.
pub struct Site<'a> {
    /// Robot that the sense belongs to.
    pub robot: RobotId,
    /// Ground, walls and hulls of the robots.
    pub arena: &'a Arena,
    /// Stream of the random numbers of this sense of this robot.
    pub stream: Stream,
}

/// Form of the values of a sense.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Number of values along each axis of the array.
    pub shape: Vec<usize>,
    /// Unit of all values.
    pub unit: Unit,
    /// Directions and range of the rays, for values that are distances along rays; `None` for others.
    pub sweep: Option<Sweep>,
}

impl Layout {
    /// Returns the number of values.
    pub fn floats(&self) -> usize {
        self.shape.iter().try_fold(1, |product: usize, axis| product.checked_mul(*axis)).unwrap_or(usize::MAX)
    }

    /// Returns the channel of the observation by which a policy takes the sense called `name`, the one with this
    /// `index` among the senses of the robot.
    pub fn channel(&self, name: &str, index: usize) -> Channel {
        Channel::of_sense(name.to_owned(), index, (self.shape.clone(), self.unit), self.sweep)
    }

    /// Returns what is wrong with the form; `None` if it can be sent.
    pub(crate) fn unfit(&self) -> Option<String> {
        let (floats, rays) = (self.floats(), self.sweep.is_some());
        let most = if rays { MAX_RAYS } else { MAX_SENSED };
        let what = if rays { "rays" } else { "values" };
        (!(1..=most).contains(&floats)).then(|| format!("it has {floats} {what}; 1 to {most} can be sent"))
    }
}

/// Function that makes a sense for a robot; called at each start of the actor that uses the sense.
pub type Make = dyn Fn(Site) -> Box<dyn Sense>;

/// Parts of a sense: the form of its values, a constructor of its logic, and the worker that does its I/O.
pub struct Parts {
    /// Form of the values.
    pub layout: Layout,
    /// Makes the sense.
    pub sense: Box<Make>,
    /// Worker that does the I/O of the sense on a thread of its own; `None` for a sense that is simulated, and takes
    /// the scenes of a World.
    pub worker: Option<Box<dyn edge::Worker>>,
}

impl Parts {
    /// Returns the parts of a simulated sense with this form and pace; `measurement` makes its measurement for a robot.
    fn simulated<M: Measure + 'static>(layout: Layout, pace: Pace, measurement: impl Fn(Site) -> M + 'static) -> Parts {
        let sense = move |site: Site| Box::new(Simulated::new(measurement(site), &pace)) as Box<dyn Sense>;
        Parts { layout, sense: Box::new(sense), worker: None }
    }
}

/// Entry of a kind of sense in the registry.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name of the kind of sense, by which a deployment selects it.
    pub name: &'static str,
    /// Description of the kind of sense in one line, for lists of all kinds.
    pub about: &'static str,
    /// Settings of an example, as a TOML table, with which the contract of the kind is tested ([`contract::check`]).
    pub example: &'static str,
    /// Makes the sense of a robot from its settings in a deployment. The error names the wrong setting.
    pub make: fn(&edge::Settings, RobotId) -> Result<Parts, ConfigError>,
}

/// All kinds of senses that this crate contains.
pub const REGISTRY: &[Entry] = &[
    Entry { name: "lidar", about: lidar::ABOUT, example: lidar::EXAMPLE, make: lidar::make },
    Entry { name: "relative", about: relative::ABOUT, example: relative::EXAMPLE, make: relative::make },
    Entry { name: "task", about: task::ABOUT, example: task::EXAMPLE, make: task::make },
    Entry { name: "program", about: program::ABOUT, example: program::EXAMPLE, make: program::make },
];
