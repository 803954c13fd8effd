//! Settings of a driver or a source in a deployment.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::config::{self, ConfigError};
use crate::messages::ids::RobotId;

/// Settings of a driver or a source of readings in a deployment: its name, and a table that only the driver or source
/// reads.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Name of the driver or source in the registry.
    pub name: String,
    /// Settings that the driver or source itself defines, as a TOML table.
    #[serde(flatten)]
    pub table: toml::Table,
}

/// Name of the sub-table with the settings of single robots.
const BY_ROBOT: &str = "robot";

impl Settings {
    /// Returns the settings for one robot: those in the sub-table `robot.N` (N is the robot's number), completed by the
    /// settings for all robots. Fails if `robot.N` is no table. A key `robot` whose keys are not all numbers is an
    /// ordinary setting.
    pub(crate) fn for_robot(&self, robot: RobotId) -> Result<Settings, ConfigError> {
        let by_number = |robots: &toml::Table| robots.keys().all(|number| number.parse::<u16>().is_ok());
        let Some(robots) = self.table.get(BY_ROBOT).and_then(toml::Value::as_table).filter(|robots| by_number(robots))
        else {
            return Ok(self.clone());
        };
        let mut merged = self.clone();
        merged.table.remove(BY_ROBOT);
        match robots.get(&robot.0.to_string()) {
            None => {}
            Some(toml::Value::Table(own)) => merged.table.extend(own.clone()),
            Some(_) => {
                let why = format!("it is no table; write robot.{} = {{ ... }}", robot.0);
                return Err(ConfigError::field(BY_ROBOT, why));
            }
        }
        Ok(merged)
    }

    /// Converts the table to the type `T`, which the driver or source defines. An error names the driver or source and
    /// the wrong field, but quotes no value.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        config::from_table(&self.table).map_err(|error| match error {
            ConfigError::Syntax(why) => ConfigError::field(&self.name, why),
            field => field.within(&self.name),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> Settings {
        Settings { name: "arm".to_owned(), table: text.parse().expect("it is TOML") }
    }

    #[test]
    fn a_robot_has_its_own_settings_over_those_of_all() {
        let all = settings("rate = 5\nrobot.1 = { address = \"10.0.0.2\", rate = 7 }");
        assert_eq!(all.for_robot(RobotId(1)).unwrap(), settings("rate = 7\naddress = \"10.0.0.2\""));
        assert_eq!(all.for_robot(RobotId(0)).unwrap(), settings("rate = 5"));
        let own = settings("robot = \"127.0.0.1:7\"");
        assert_eq!(own.for_robot(RobotId(1)).unwrap(), own, "a setting of the driver's own");
        let error = settings("robot.1 = 3").for_robot(RobotId(1)).unwrap_err().to_string();
        assert!(error.contains("robot.1"), "{error}");
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)] // Only the errors of its parser are tested.
    struct Arm {
        rate: u8,
        origin_m: Option<[f32; 2]>,
    }

    #[test]
    fn an_error_names_the_field_of_the_wrong_type() {
        for (text, start) in [
            ("rate = \"fast\"", "arm.rate: invalid type: string, expected u8"),
            ("rate = 300", "arm.rate: "),
            ("rate = 3\norigin_m = [1.0]", "arm.origin_m: "),
            ("rate = 3\ncolour = \"red\"", "arm.colour: unknown field `colour`"),
            ("", "arm: missing field `rate`"),
        ] {
            let error = settings(text).read::<Arm>().unwrap_err().to_string();
            assert!(error.starts_with(start), "{text}: {error}");
        }
    }
}
