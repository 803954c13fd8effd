//! Driver `mavlink`: robots with PX4 or ArduPilot.

use murmurate::config::ConfigError;
use murmurate::drivers::Parts;
use murmurate::edge::Settings;
use murmurate::messages::ids::RobotId;

use super::session::Session;
use super::settings::DriverConfig;
use super::worker::Endpoint;

/// Makes the driver of `robot` and its worker; an error names the wrong setting.
pub fn make(settings: &Settings, robot: RobotId) -> Result<Parts, ConfigError> {
    let config = DriverConfig::read(settings)?;
    let worker = Endpoint { link: config.link.clone(), reminders: Vec::new() };
    Ok(Parts {
        driver: Box::new(move || Box::new(Session::new(robot, config.clone()))),
        worker: Some(Box::new(worker)),
    })
}
