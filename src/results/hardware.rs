//! Hardware of the real robots in a run: last battery charge and temperature, and faults of each.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::messages::ids::RobotId;
use crate::messages::wire::{Hardware, Health};

/// Condition of one real robot's hardware, and its faults since its host was started.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotHardware {
    /// Id of the robot.
    pub robot: RobotId,
    /// Whether the robot's driver last reported it as ready. A report after the run has the state in which the host
    /// ended.
    pub(crate) ready: bool,
    /// Last known charge of the battery \[%\]; `None` if it was never reported.
    pub(crate) battery: Option<u8>,
    /// Last known temperature \[°C\]; `None` if it was never reported.
    pub(crate) temperature_c: Option<i16>,
    /// Number of faults: times that the robot became faulty, that it fell silent after it had been ready, or that the
    /// reason changed.
    pub(crate) faults: u64,
    /// Reason of the last fault; without a fault, the reason why the robot has not been ready so far. `None` if there
    /// is none.
    pub(crate) last_fault: Option<String>,
}

impl RobotHardware {
    /// Returns the condition of a robot of which the driver has reported nothing yet.
    pub fn new(robot: RobotId) -> RobotHardware {
        RobotHardware { robot, ready: false, battery: None, temperature_c: None, faults: 0, last_fault: None }
    }

    /// Updates the condition with a report of the robot's driver.
    pub fn note(&mut self, hardware: &Hardware) {
        self.battery = hardware.battery.or(self.battery);
        self.temperature_c = hardware.temperature.map(|temperature| temperature.degrees()).or(self.temperature_c);
        let ready = hardware.health == Health::Ready;
        if !ready {
            let why = match (&hardware.reason, hardware.health) {
                (Some(reason), _) => reason.text().to_owned(),
                (None, Health::Silent) => "silent".to_owned(),
                (None, _) => "faulty".to_owned(),
            };
            // A robot that is not ready yet after the start is still connecting; this is not a fault.
            let was_ready = self.ready || self.faults > 0;
            let faulty = hardware.health == Health::Faulty;
            // Numbers in a reason may change all the time, so only the words before them are compared.
            let new = self.ready || self.last_fault.as_deref().is_none_or(|last| words_of(last) != words_of(&why));
            self.faults += u64::from(new && (was_ready || faulty));
            self.last_fault = Some(why);
        } else if self.faults == 0 {
            self.last_fault = None;
        }
        self.ready = ready;
    }

    /// Merges the conditions that several processes reported: for each robot the last known values and the sum of its
    /// faults. `all` is in the order in which the processes were started.
    pub fn joined<'a>(all: impl Iterator<Item = &'a RobotHardware>) -> Vec<RobotHardware> {
        let mut robots: BTreeMap<RobotId, RobotHardware> = BTreeMap::new();
        for later in all {
            let known = robots.entry(later.robot).or_insert_with(|| RobotHardware::new(later.robot));
            *known = RobotHardware {
                robot: later.robot,
                ready: later.ready,
                battery: later.battery.or(known.battery),
                temperature_c: later.temperature_c.or(known.temperature_c),
                faults: known.faults + later.faults,
                last_fault: later.last_fault.clone().or(known.last_fault.take()),
            };
        }
        robots.into_values().collect()
    }

    /// Describes the hardware as text, such as `battery 87 %, 41 °C, 1 fault: bumper pressed`.
    pub fn words(&self) -> String {
        let battery = self.battery.map(|battery| format!("battery {battery} %"));
        let temperature = self.temperature_c.map(|degrees| format!("{degrees} \u{b0}C"));
        let faults = match (self.faults, &self.last_fault) {
            (0, Some(why)) => format!("never ready: {why}"),
            (0, None) => "no fault".to_owned(),
            (1, Some(why)) => format!("1 fault: {why}"),
            (faults, why) => format!("{faults} faults, the last: {}", why.as_deref().unwrap_or("unknown")),
        };
        let state = (!self.ready && self.faults > 0).then(|| "not ready".to_owned());
        let all: Vec<String> = battery.into_iter().chain(temperature).chain(state).chain([faults]).collect();
        all.join(", ")
    }
}

/// Returns the part of a reason before its first digit.
fn words_of(reason: &str) -> Option<&str> {
    reason.split(|c: char| c.is_ascii_digit()).next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_counted_when_they_begin_and_a_slow_start_is_none() {
        let mut robot = RobotHardware::new(RobotId(2));
        robot.note(&Hardware::of(Health::Silent).because("no connection yet"));
        assert_eq!((robot.faults, robot.words().as_str()), (0, "never ready: no connection yet"));
        robot.note(&Hardware { battery: Some(80), ..Hardware::of(Health::Ready) });
        assert_eq!(robot.words(), "battery 80 %, no fault");
        for charge in [20, 19, 18] {
            let why = format!("battery {charge} %, least 20 %");
            robot.note(&Hardware { battery: Some(charge), ..Hardware::of(Health::Faulty).because(&why) });
        }
        robot.note(&Hardware::of(Health::Silent).because("it does not answer"));
        assert_eq!((robot.faults, robot.battery), (2, Some(18)));
        assert_eq!(robot.words(), "battery 18 %, not ready, 2 faults, the last: it does not answer");
        let mut restarted = RobotHardware::new(RobotId(2));
        restarted.note(&Hardware { battery: Some(95), ..Hardware::of(Health::Ready) });
        let joined = RobotHardware::joined([&robot, &restarted].into_iter());
        assert_eq!(joined[0].words(), "battery 95 %, 2 faults, the last: it does not answer");
        let mut flat = RobotHardware::new(RobotId(0));
        flat.note(&Hardware { battery: Some(3), ..Hardware::of(Health::Faulty).because("battery 3 %") });
        assert_eq!(flat.words(), "battery 3 %, not ready, 1 fault: battery 3 %");
    }
}
