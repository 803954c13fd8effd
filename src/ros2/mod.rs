//! Communication with ROS 2 robots without an installation of ROS: messages, a child process of the host that speaks
//! DDS (the DDS process), the packets between both, and a spare DDS process that can take over at once.
//!
//! `drivers::ros2` and `localization::ros2` use it. DDS itself is in `dds` alone, behind the feature `ros2`.

#[cfg(feature = "ros2")]
mod dds;
pub mod messages;
#[cfg(feature = "ros2")]
pub mod node;
pub mod observe;
pub mod packet;
pub mod pair;
pub mod reading;
pub mod sample;
pub mod settings;
pub mod supervisor;
pub mod topics;

/// Name of the hidden subcommand of this program that runs a DDS process: the child process of a host that connects it
/// to ROS 2.
pub const SUBCOMMAND: &str = "ros2-node";
/// Exit code of a DDS process that has reported to its host why it cannot work.
pub const REFUSED: u8 = 3;
/// Error text for a user whose program was built without the feature `ros2`, but whose deployment has a driver or a
/// source that needs it.
pub const NOT_BUILT: &str = "this program is built without ROS 2; build it by `cargo install --path . --features ros2`";
