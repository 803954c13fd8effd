//! Limits of a robot's battery charge and temperature. Beyond them, and after an end of its driver, the robot's Body
//! (the actor of its motors) keeps the robot at rest, whatever it is commanded.
//!
//! A robot that was stopped moves again only once the value is better than the limit by a margin. Without the margin, a
//! robot at the limit would start again whenever its motors are off.

use crate::chassis::Settings;
use crate::config::ConfigError;
use crate::messages::wire::{Celsius, Hardware, Health};

/// Recovery margin of the battery \[%\]: a robot that was stopped for its battery moves again at this much above the
/// least permitted charge. The value is a choice of this project. The charge that a battery shows rises by some percent
/// once the motors are off, without being charged.
pub const RECOVERED_PERCENT: u8 = 10;
/// Recovery margin of the temperature \[°C\]: a robot that was stopped for its temperature moves again at this much
/// below the highest permitted temperature. The value is a choice of this project.
pub const RECOVERED_C: i16 = 10;

/// Limits of one robot's battery charge and temperature, beyond which it may not move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HardwareLimits {
    /// Battery charge at or below which the robot is stopped \[%\]; `None` for no limit.
    pub battery_least: Option<u8>,
    /// Temperature at or above which the robot is stopped; `None` for no limit.
    pub temperature_most: Option<Celsius>,
}

impl HardwareLimits {
    /// Returns the limits in a robot's chassis settings (`battery_least` and `temperature_most_c`). A setting that is
    /// left out gives no limit. An error names the setting that is out of range.
    pub fn of(settings: &Settings) -> Result<HardwareLimits, ConfigError> {
        let battery_least = settings.battery_least.map(|least| match least {
            0.0..=1.0 => Ok((least * 100.0).round() as u8),
            _ => Err(ConfigError::field("battery_least", format!("{least} is no share of the charge, 0 to 1"))),
        });
        let temperature_most = settings.temperature_most_c.map(|most| {
            let wrong = || ConfigError::field("temperature_most_c", format!("{most} is not -40 to 215 \u{b0}C"));
            Celsius::of(most).ok_or_else(wrong)
        });
        Ok(HardwareLimits {
            battery_least: battery_least.transpose()?,
            temperature_most: temperature_most.transpose()?,
        })
    }
}

/// Decision of a robot's hardware watch: whether battery, temperature and driver permit motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Permit {
    /// All values that have a limit are known and within it, so the robot may move.
    Granted,
    /// The driver has not yet reported a value that has a limit, so the robot may not move.
    Unknown,
    /// Battery or temperature is beyond its limit, or has not yet recovered by the margin, or the robot's driver has
    /// ended and not called it ready since, so the robot may not move.
    Withdrawn,
}

/// Monitor of one robot's battery charge and temperature, which compares the values that its driver reports with their
/// limits.
#[derive(Clone, Debug)]
pub struct HardwareWatch {
    limits: HardwareLimits,
    battery: Option<u8>,
    temperature: Option<Celsius>,
    low: bool,
    hot: bool,
    /// Whether the robot's driver has ended and has not called the robot ready since.
    ended: bool,
}

impl HardwareWatch {
    /// Makes a monitor with these limits that knows no values yet.
    pub fn new(limits: HardwareLimits) -> HardwareWatch {
        HardwareWatch { limits, battery: None, temperature: None, low: false, hot: false, ended: false }
    }

    /// Notes that the robot's driver has ended, or begins again: what the robot does is not known until the driver
    /// calls it ready.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// Takes the values of battery and temperature that a robot's driver reports. A value that the report leaves out
    /// stays as it was.
    pub fn take(&mut self, hardware: &Hardware) {
        self.ended &= hardware.health != Health::Ready;
        self.battery = hardware.battery.or(self.battery);
        self.temperature = hardware.temperature.or(self.temperature);
        if let (Some(least), Some(charge)) = (self.limits.battery_least, self.battery) {
            let recovered = least.saturating_add(RECOVERED_PERCENT).min(100);
            self.low = charge <= least || (self.low && charge < recovered);
        }
        if let (Some(most), Some(temperature)) = (self.limits.temperature_most, self.temperature) {
            let recovered = most.degrees() - RECOVERED_C;
            self.hot = temperature >= most || (self.hot && temperature.degrees() > recovered);
        }
    }

    /// Returns whether battery, temperature and driver permit the robot to move.
    pub fn permit(&self) -> Permit {
        let known = |limited: bool, known: bool| !limited || known;
        match () {
            () if self.ended || self.low || self.hot => Permit::Withdrawn,
            () if !known(self.limits.battery_least.is_some(), self.battery.is_some()) => Permit::Unknown,
            () if !known(self.limits.temperature_most.is_some(), self.temperature.is_some()) => Permit::Unknown,
            () => Permit::Granted,
        }
    }

    /// Returns the reason why the robot may not move, with what to do, as text for the operator; `None` if it may move.
    pub fn reason(&self) -> Option<String> {
        let HardwareLimits { battery_least, temperature_most } = self.limits;
        match self.permit() {
            Permit::Granted => None,
            Permit::Unknown if battery_least.is_some() && self.battery.is_none() => {
                Some("its driver reports no charge, which battery_least needs".to_owned())
            }
            Permit::Unknown => Some("its driver reports no temperature: leave out temperature_most_c".to_owned()),
            Permit::Withdrawn if self.ended => {
                Some("its driver has ended and is started again; it may move once that reports it as ready".to_owned())
            }
            Permit::Withdrawn => match (self.low, self.battery.zip(battery_least)) {
                (true, Some((charge, least))) => {
                    let enough = least.saturating_add(RECOVERED_PERCENT).min(100);
                    Some(format!("battery {charge} %, least {least} %: charge it to {enough} %"))
                }
                _ => self.temperature.zip(temperature_most).map(|(temperature, most)| {
                    let cool = most.degrees() - RECOVERED_C;
                    let (now, most) = (temperature.degrees(), most.degrees());
                    format!("{now} deg C, at most {most}: let it cool to {cool}")
                }),
            },
        }
    }

    /// Returns the condition to report for the driver's report `hardware`. If a value is beyond its limit and the
    /// driver calls the robot ready, the condition is a fault with the reason. Otherwise it is the driver's own.
    pub fn judged(&self, hardware: Hardware) -> Hardware {
        match self.permit() {
            Permit::Withdrawn if hardware.health == Health::Ready => {
                let why = self.reason().unwrap_or_default();
                Hardware { health: Health::Faulty, ..hardware }.because(&why)
            }
            _ => hardware,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch(battery_least: Option<f32>, temperature_most_c: Option<f32>) -> HardwareWatch {
        let settings = Settings { battery_least, temperature_most_c, ..Settings::default() };
        HardwareWatch::new(HardwareLimits::of(&settings).unwrap())
    }

    fn of(battery: Option<u8>, degrees: Option<f32>) -> Hardware {
        Hardware { battery, temperature: degrees.and_then(Celsius::of), ..Hardware::of(Health::Ready) }
    }

    #[test]
    fn a_robot_that_stands_for_its_battery_has_to_be_charged() {
        let mut watch = watch(Some(0.2), None);
        assert_eq!(watch.permit(), Permit::Unknown);
        let permits = [25, 21, 20, 21, 29, 30, 25].map(|charge| {
            watch.take(&of(Some(charge), None));
            watch.permit() == Permit::Granted
        });
        assert_eq!(permits, [true, true, false, false, false, true, true]);
        watch.take(&of(None, None));
        assert_eq!(watch.permit(), Permit::Granted, "what is left out stays");
        watch.take(&of(Some(3), None));
        let judged = watch.judged(of(Some(3), None));
        assert_eq!(judged.health, Health::Faulty);
        assert_eq!(judged.reason.unwrap().text(), "battery 3 %, least 20 %: charge it to 30 %");
    }

    #[test]
    fn a_hot_robot_has_to_cool() {
        let mut watch = watch(None, Some(70.0));
        let permits = [69.0, 70.0, 65.0, 61.0, 60.0, 69.0].map(|degrees| {
            watch.take(&of(None, Some(degrees)));
            watch.permit() == Permit::Granted
        });
        assert_eq!(permits, [true, false, false, false, true, true]);
        watch.take(&of(None, Some(88.0)));
        assert_eq!(watch.reason().unwrap(), "88 deg C, at most 70: let it cool to 60");
        let silent = Hardware::of(Health::Silent).because("no connection");
        assert_eq!(watch.judged(silent.clone()), silent, "the driver's own fault comes first");
    }

    #[test]
    fn a_robot_whose_driver_has_ended_stands_until_the_driver_calls_it_ready() {
        let mut watch = watch(Some(0.2), None);
        watch.take(&of(Some(50), None));
        watch.end();
        for health in [Health::Silent, Health::Faulty] {
            watch.take(&Hardware { battery: Some(60), ..Hardware::of(health) });
            assert_eq!(watch.permit(), Permit::Withdrawn);
            assert!(watch.reason().unwrap().starts_with("its driver has ended"));
        }
        watch.take(&of(Some(20), None));
        assert!(watch.reason().unwrap().starts_with("battery 20 %"), "it is ready, and its charge is not");
        watch.take(&of(Some(60), None));
        assert_eq!(watch.permit(), Permit::Granted);
    }

    #[test]
    fn without_limits_it_may_always_move_and_wrong_limits_are_named() {
        let mut any = watch(None, None);
        any.take(&of(Some(0), Some(200.0)));
        assert_eq!((any.permit(), any.reason()), (Permit::Granted, None));
        for (settings, field) in [
            (Settings { battery_least: Some(20.0), ..Settings::default() }, "battery_least"),
            (Settings { battery_least: Some(f32::NAN), ..Settings::default() }, "battery_least"),
            (Settings { temperature_most_c: Some(300.0), ..Settings::default() }, "temperature_most_c"),
        ] {
            assert!(HardwareLimits::of(&settings).unwrap_err().to_string().starts_with(field));
        }
    }
}
