//! Chassis and hardware limits of the robots in a deployment, with their checks, and checks of its real robots.

use std::rc::Rc;

use super::{Deployment, Host};
use crate::chassis::{Chassis, Settings};
use crate::config::ConfigError;
use crate::flight;
use crate::messages::ids::RobotId;
use crate::safety::hardware::HardwareLimits;
use crate::world::{self, Placement};

impl Deployment {
    /// Checks that every robot is simulated, as a simulation under virtual time requires. An error names the field of a
    /// host with a real robot.
    pub fn check_simulated(&self) -> Result<(), ConfigError> {
        let real = |host: &&Host| !host.actuates.is_empty() || !host.localizes.is_empty();
        self.hosts.iter().find(real).map_or(Ok(()), |host| {
            let why = format!("'{}' has real robots, which only the command 'host' drives and measures", host.name);
            Err(ConfigError::field("host.actuates and host.localizes", why))
        })
    }

    /// Checks that the deployment does not place real robots at their starts, since they have to drive there. An error
    /// names the field `placement`.
    pub(super) fn check_placement(&self) -> Result<(), ConfigError> {
        let real = self.hosts.iter().find(|host| !host.actuates.is_empty());
        match real.filter(|_| self.placement == Placement::Exact) {
            None => Ok(()),
            Some(host) => {
                let why =
                    format!("'exact' places simulated robots only, and '{}' has real ones; write 'drive'", host.name);
                Err(ConfigError::field("placement", why))
            }
        }
    }

    /// Returns the chassis (drive and limits of speed) of a robot. Panics if its settings are invalid, which
    /// `Deployment::check` excludes.
    pub fn chassis(&self, robot: RobotId) -> Chassis {
        self.body_settings(robot).chassis().expect("a checked deployment has sound chassis")
    }

    /// Returns the limits of battery charge and temperature of a robot. Panics if its settings are invalid, which
    /// `Deployment::check` excludes.
    pub fn hardware_limits(&self, robot: RobotId) -> HardwareLimits {
        HardwareLimits::of(&self.body_settings(robot)).expect("a checked deployment has sound limits")
    }

    /// Returns the settings of a robot's flight; `None` for a robot on the ground. Panics if its settings are
    /// invalid, which `Deployment::check` excludes.
    pub fn flight(&self, robot: RobotId) -> Option<flight::Settings> {
        self.body_settings(robot).flight().expect("a checked deployment has sound flights")
    }

    /// Returns the simulated robots that have a height, and so fly.
    pub(super) fn flying(&self) -> Vec<RobotId> {
        let simulated = self.hosts.iter().flat_map(|host| &host.simulates).map(|robot| RobotId(*robot));
        simulated.filter(|robot| self.body_settings(*robot).height_m.is_some()).collect()
    }

    /// Checks that a robot has a height exactly if its driver, of this name, `flies`. An error names the field.
    pub(super) fn check_flight(&self, robot: RobotId, (flies, driver): (bool, &str)) -> Result<(), ConfigError> {
        let why = match (flies, self.body_settings(robot).height_m.is_some()) {
            (true, false) => format!("missing: {robot} flies by its driver '{driver}'; say at which height"),
            (false, true) => format!("{robot} has one, and its driver '{driver}' does not fly; leave it out"),
            _ => return Ok(()),
        };
        Err(ConfigError::field("body.height_m", why))
    }

    fn body_settings(&self, robot: RobotId) -> Settings {
        let own = self.bodies.get(&robot.0.to_string());
        let of_role = self.role_of(robot).map_or_else(|| self.body.clone(), |(_, role)| role.body.or(&self.body));
        own.map_or_else(|| of_role.clone(), |own| own.or(&of_role))
    }

    /// Returns the chassis (drive and limits of speed) of all robots, indexed by robot. Panics if settings are invalid,
    /// which `Deployment::check` excludes.
    pub fn team_chassis(&self) -> Rc<[Chassis]> {
        RobotId::team(self.robots).map(|robot| self.chassis(robot)).collect()
    }

    /// Checks that the plant supports the drive, holonomic or differential, of every simulated robot. An error names
    /// the robot.
    pub(crate) fn check_drives(&self, plant: &world::Entry) -> Result<(), ConfigError> {
        let mut simulated = self.hosts.iter().flat_map(|host| &host.simulates);
        let other = |robot: &&u16| !plant.drives.contains(&self.chassis(RobotId(**robot)).drive);
        simulated.find(other).map_or(Ok(()), |robot| {
            let why = format!("'{}' does not simulate the drive of robot {robot}; take another plant", plant.name);
            Err(ConfigError::field("plant", why))
        })
    }

    /// Checks the chassis and hardware limits of all robots. An error names the field.
    pub(super) fn check_bodies(&self) -> Result<(), ConfigError> {
        let team = |number: &String| number.parse::<usize>().is_ok_and(|robot| robot < self.robots);
        if let Some(number) = self.bodies.keys().find(|number| !team(number)) {
            let why = format!("there is no robot {number}; the team has 0 to {}", self.robots - 1);
            return Err(ConfigError::field("bodies", why));
        }
        let check = |settings: &Settings| {
            settings.chassis().and_then(|_| HardwareLimits::of(settings)).and_then(|_| settings.flight()).map(drop)
        };
        for (number, robot) in self.bodies.keys().filter_map(|number| Some((number, number.parse().ok()?))) {
            check(&self.body_settings(RobotId(robot))).map_err(|error| error.within(&format!("bodies.{number}")))?;
        }
        for (name, role) in &self.roles {
            check(&role.body.or(&self.body)).map_err(|error| error.within("body").within(name).within("roles"))?;
        }
        let own = |robot: &RobotId| {
            let of_role = self.role_of(*robot).is_some_and(|(_, role)| !role.body.is_empty());
            of_role || self.bodies.contains_key(&robot.0.to_string())
        };
        // If every robot has settings of its own, the common ones need not be complete.
        match RobotId::team(self.robots).all(|robot| own(&robot)) {
            true => Ok(()),
            false => check(&self.body).map_err(|error| error.within("body")),
        }
    }
}

impl Host {
    /// Checks that the host has a driver exactly if it actuates robots, and a source of readings exactly if it
    /// localizes robots. An error names the field.
    pub(super) fn check_devices(&self) -> Result<(), ConfigError> {
        for (robots, settings, role, what) in [
            (&self.actuates, &self.driver, "actuates", "driver"),
            (&self.localizes, &self.source, "localizes", "source"),
        ] {
            if robots.is_empty() != settings.is_none() {
                let why = match settings {
                    None => format!("missing: '{}' {role} robots; write {what} = {{ name = ... }}", self.name),
                    Some(_) => format!("'{}' {role} no robot; name some, or leave it out", self.name),
                };
                return Err(ConfigError::field(format!("host.{what}"), why));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chassis::DriveKind;
    use crate::messages::geometry::limit_below;

    #[test]
    fn a_robot_that_differs_takes_the_rest_from_all_and_wrong_ones_are_refused_by_name() {
        let mut deployment = Deployment::preset("offboard", 3).unwrap();
        deployment.body.speed_m_s = Some(0.3);
        let wheels = Settings { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Settings::default() };
        deployment.bodies.insert("2".to_owned(), wheels);
        assert_eq!(deployment.check(), Ok(()));
        let [first, last] = [0, 2].map(|robot| deployment.chassis(RobotId(robot)));
        let most = limit_below(0.3);
        assert_eq!((first.drive, first.speed_m_s), (DriveKind::Holonomic, most));
        assert_eq!((last.drive, last.speed_m_s), (DriveKind::Differential, most));
        assert_eq!(Deployment::from_toml(&deployment.to_toml()), Ok(deployment.clone()));
        deployment.body.battery_least = Some(0.2);
        assert_eq!(deployment.hardware_limits(RobotId(2)).battery_least, Some(20));
        deployment.bodies.insert("0".to_owned(), Settings { temperature_most_c: Some(999.0), ..Settings::default() });
        assert!(deployment.check().unwrap_err().to_string().contains("bodies.0.temperature_most_c"));
        deployment.bodies.remove("0");
        deployment.bodies.insert("3".to_owned(), Settings::default());
        assert!(deployment.check().unwrap_err().to_string().contains("no robot 3"));
        deployment.bodies.remove("3");
        deployment.bodies.insert("1".to_owned(), Settings { speed_m_s: Some(0.0), ..Settings::default() });
        assert!(deployment.check().unwrap_err().to_string().contains("bodies.1"));
    }
}
