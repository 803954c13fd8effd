//! Worker of a program that was built without the link to a Crazyflie: it says so.

use std::net::SocketAddr;

use actix::Recipient;
use murmurate::config::ConfigError;
use murmurate::edge::{Input, Seat, Worker};
use murmurate::messages::ids::RobotId;

/// Worker that cannot reach its robot.
pub struct Wire {
    /// Robot of the worker.
    pub robot: RobotId,
    /// Address of the robot.
    pub address: SocketAddr,
}

impl Worker for Wire {
    fn check(&self) -> Result<(), ConfigError> {
        let why = "this program is built without Crazyflies; build it by `cargo install --path crates/cli --features \
                   crazyflie`";
        Err(ConfigError::field("driver", format!("{}: {why}", self.robot)))
    }

    fn claim(&self) -> Option<String> {
        Some(format!("address {}", self.address))
    }

    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.serve(|| drop)
    }
}
