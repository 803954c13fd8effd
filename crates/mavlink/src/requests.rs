//! Requests that are repeated until the autopilot has answered: rates of messages, and parameters.

use std::collections::BTreeMap;

use mavlink::dialects::common::{MavParamType, PARAM_VALUE_DATA};
use murmurate::time::{Span, Time};

use super::firmware;
use super::settings::{Firmware, Vehicle};

/// Period of the requests for rates of messages. An autopilot that was restarted has forgotten them.
const RATES: Span = Span::from_millis(5000);
/// Period of the requests for parameters that are not answered.
const PARAMETERS: Span = Span::from_millis(500);
/// Number of requests for each parameter, after which it counts as unknown.
const MOST: u32 = 6;

/// Requests to one autopilot.
#[derive(Clone, Debug)]
pub struct Requests {
    firmware: Firmware,
    vehicle: Vehicle,
    /// Time at which rates are asked for next.
    rates: Time,
    /// Time at which parameters are asked for next.
    parameters: Time,
    /// Number of times that they were asked for.
    asked: u32,
    values: BTreeMap<&'static str, f64>,
    /// Whether what the parameters say was told.
    told: bool,
}

/// Requests that are due.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Due {
    /// Whether rates of messages are to be asked for.
    pub rates: bool,
    /// Parameters to ask for.
    pub parameters: Vec<&'static str>,
}

impl Requests {
    /// Makes the requests to an autopilot; all are due at once.
    pub fn new(firmware: Firmware, vehicle: Vehicle) -> Requests {
        let (rates, parameters) = (Time::ZERO, Time::ZERO);
        Requests { firmware, vehicle, rates, parameters, asked: 0, values: BTreeMap::new(), told: false }
    }

    /// Begins anew, with an autopilot that was restarted.
    pub fn begin_again(&mut self) {
        *self = Requests { told: self.told, ..Requests::new(self.firmware, self.vehicle) };
    }

    fn missing(&self) -> Vec<&'static str> {
        let names = firmware::parameters(self.firmware, self.vehicle).iter();
        names.filter(|name| !self.values.contains_key(*name)).copied().collect()
    }

    fn asks(&self) -> bool {
        !self.told && self.asked <= MOST
    }

    /// Returns the time at which a request is due next.
    pub fn wake_at(&self) -> Time {
        if self.asks() { self.rates.min(self.parameters) } else { self.rates }
    }

    /// Returns what is due at `now`, and counts it as asked for.
    pub fn wake(&mut self, now: Time) -> Due {
        let mut due = Due::default();
        if self.rates <= now {
            (self.rates, due.rates) = (now + RATES, true);
        }
        if self.asks() && self.parameters <= now {
            (self.parameters, self.asked) = (now + PARAMETERS, self.asked + 1);
            if self.asked <= MOST {
                due.parameters = self.missing();
            }
        }
        due
    }

    /// Takes the value of a parameter. One that was not asked for does not count.
    pub fn take(&mut self, value: &PARAM_VALUE_DATA) {
        let id = value.param_id.to_str().unwrap_or_default();
        let names = firmware::parameters(self.firmware, self.vehicle);
        if let Some(name) = names.iter().find(|name| **name == id) {
            self.values.insert(name, number(self.firmware, value));
        }
    }

    /// Returns what the autopilot does when setpoints end, once: when all parameters are known, or are not answered.
    pub fn finding(&mut self) -> Option<String> {
        if self.told || !(self.missing().is_empty() || self.asked > MOST) {
            return None;
        }
        self.told = true;
        Some(firmware::when_setpoints_end(self.firmware, self.vehicle, |name| self.values.get(name).copied()))
    }
}

/// Returns a parameter's value. PX4 puts the bytes of whole numbers into the field of a float; ArduPilot converts them.
fn number(firmware: Firmware, value: &PARAM_VALUE_DATA) -> f64 {
    let bits = value.param_value.to_bits();
    match (firmware, value.param_type) {
        (Firmware::Px4, MavParamType::MAV_PARAM_TYPE_INT32) => f64::from(bits.cast_signed()),
        (Firmware::Px4, MavParamType::MAV_PARAM_TYPE_UINT32) => f64::from(bits),
        // To the digits that a person has set.
        _ => value.param_value.to_string().parse().unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink::types::CharArray;

    fn value(name: &str, param_value: f32, param_type: MavParamType) -> PARAM_VALUE_DATA {
        PARAM_VALUE_DATA { param_id: CharArray::from(name), param_value, param_type, ..Default::default() }
    }

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn parameters_are_asked_for_until_they_are_known_and_told_once() {
        let mut requests = Requests::new(Firmware::Px4, Vehicle::Rover);
        let due = requests.wake(at(0));
        assert_eq!((due.rates, due.parameters.len()), (true, 3));
        assert_eq!(requests.wake(at(100)), Due::default());
        requests.take(&value("COM_OF_LOSS_T", 0.3, MavParamType::MAV_PARAM_TYPE_REAL32));
        requests.take(&value("COM_OBL_RC_ACT", f32::from_bits(5), MavParamType::MAV_PARAM_TYPE_INT32));
        requests.take(&value("SYS_AUTOSTART", 1.0, MavParamType::MAV_PARAM_TYPE_REAL32));
        assert_eq!(requests.wake(at(500)).parameters, ["COM_RC_OVERRIDE"]);
        assert_eq!(requests.finding(), None);
        requests.take(&value("COM_RC_OVERRIDE", f32::from_bits(1), MavParamType::MAV_PARAM_TYPE_INT32));
        let text = requests.finding().expect("all are known");
        assert!(text.contains("after 0.3 s") && text.contains("COM_OBL_RC_ACT 5: Hold"), "{text}");
        assert_eq!(requests.finding(), None, "it was told");
        assert_eq!(requests.wake_at(), at(5000), "rates alone");
        assert!(requests.wake(at(5000)).rates);
    }

    #[test]
    fn an_autopilot_that_does_not_answer_is_told_as_such_after_six_requests() {
        let mut requests = Requests::new(Firmware::ArduPilot, Vehicle::Copter);
        let mut asked = 0;
        for k in 0..100 {
            asked += usize::from(!requests.wake(at(500 * k)).parameters.is_empty());
            if let Some(text) = requests.finding() {
                assert_eq!((asked, k), (6, 6));
                assert!(text.contains("FS_GCS_ENABLE not told"), "{text}");
                return;
            }
        }
        panic!("it is never told");
    }
}
