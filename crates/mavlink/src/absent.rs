//! Driver and source of a program without MAVLink: settings are checked, and a host that has them does not start.

use actix::Recipient;
use murmurate::config::ConfigError;
use murmurate::drivers::{self, Command, Driver, Limits};
use murmurate::edge::{Input, Seat, Settings, Worker};
use murmurate::localization::{self, In, Source};
use murmurate::messages::ids::RobotId;
use murmurate::time::Time;

use super::settings::{DriverConfig, SourceConfig};

/// Value of a type that has none, since this program has no MAVLink.
struct Absent {
    speed_m_s: f32,
}

impl Driver for Absent {
    fn limits(&self) -> Limits {
        Limits { speed_m_s: self.speed_m_s }
    }

    fn drive(&mut self, _: Time, _: &Command, _: &mut Vec<drivers::Out>) {}

    fn receive(&mut self, _: Time, _: &[u8], out: &mut Vec<drivers::Out>) {
        out.push(drivers::Out::Refused(super::NOT_BUILT));
    }
}

impl Source for Absent {
    fn take(&mut self, _: Time, _: In, out: &mut Vec<localization::Out>) {
        out.push(localization::Out::Refused(super::NOT_BUILT));
    }
}

impl Worker for Absent {
    fn check(&self) -> Result<(), ConfigError> {
        Err(ConfigError::field("name", super::NOT_BUILT))
    }

    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.serve(|| drop)
    }
}

/// Checks the settings of a driver; an error names the wrong one.
pub fn make_driver(settings: &Settings, _: RobotId) -> Result<drivers::Parts, ConfigError> {
    let speed_m_s = DriverConfig::read(settings)?.speed_m_s;
    Ok(drivers::Parts {
        driver: Box::new(move || Box::new(Absent { speed_m_s })),
        worker: Some(Box::new(Absent { speed_m_s })),
    })
}

/// Checks the settings of a source; an error names the wrong one.
pub fn make_source(settings: &Settings, robots: &[RobotId]) -> Result<localization::Parts, ConfigError> {
    super::only(robots)?;
    SourceConfig::read(settings)?;
    let absent = || Absent { speed_m_s: 0.0 };
    Ok(localization::Parts { source: Box::new(move || Box::new(absent())), worker: Box::new(absent()) })
}
