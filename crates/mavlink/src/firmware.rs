//! Firmware of autopilots: the numbers and names of modes, and what its parameters say of the end of setpoints.

use mavlink::dialects::common::{HEARTBEAT_DATA, MavAutopilot, MavType};

use super::settings::{Firmware, Vehicle};

/// Names of PX4's main modes, from number 1 (`px4_custom_mode.h`).
const PX4_MODES: [&str; 10] =
    ["MANUAL", "ALTITUDE", "POSITION", "AUTO", "ACRO", "OFFBOARD", "STABILIZED", "RATTITUDE", "SIMPLE", "TERMINATION"];
/// Names of the sub-modes of PX4's mode AUTO, from number 1.
const PX4_AUTO: [&str; 9] =
    ["READY", "TAKEOFF", "LOITER", "MISSION", "RTL", "LAND", "RTGS", "FOLLOW_TARGET", "PRECLAND"];
/// Numbers and names of modes of ArduPilot's rovers (`Rover/mode.h`).
const ROVER_MODES: [(u32, &str); 13] = [
    (0, "MANUAL"),
    (1, "ACRO"),
    (3, "STEERING"),
    (4, "HOLD"),
    (5, "LOITER"),
    (6, "FOLLOW"),
    (7, "SIMPLE"),
    (8, "DOCK"),
    (9, "CIRCLE"),
    (10, "AUTO"),
    (11, "RTL"),
    (12, "SMART_RTL"),
    (15, "GUIDED"),
];
/// Numbers and names of modes of ArduPilot's copters (`ArduCopter/mode.h`).
const COPTER_MODES: [(u32, &str); 15] = [
    (0, "STABILIZE"),
    (1, "ACRO"),
    (2, "ALT_HOLD"),
    (3, "AUTO"),
    (4, "GUIDED"),
    (5, "LOITER"),
    (6, "RTL"),
    (7, "CIRCLE"),
    (9, "LAND"),
    (11, "DRIFT"),
    (13, "SPORT"),
    (16, "POSHOLD"),
    (17, "BRAKE"),
    (18, "THROW"),
    (21, "SMART_RTL"),
];

/// Mode of an autopilot, as `custom_mode` of HEARTBEAT and CURRENT_MODE has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode(pub u32);

/// Parameters of MAV_CMD_DO_SET_MODE: main mode and sub-mode.
pub type ModeParameters = [f32; 2];

impl Mode {
    /// Returns the mode in which the autopilot follows setpoints: OFFBOARD or GUIDED.
    pub fn followed(firmware: Firmware, vehicle: Vehicle) -> Mode {
        Mode(match (firmware, vehicle) {
            (Firmware::Px4, _) => 6 << 16,
            (Firmware::ArduPilot, Vehicle::Rover) => 15,
            (Firmware::ArduPilot, Vehicle::Copter) => 4,
        })
    }

    /// Returns the mode in which the autopilot lands a copter where it is.
    pub fn landing(firmware: Firmware) -> Mode {
        Mode(match firmware {
            Firmware::Px4 => 4 << 16 | 6 << 24,
            Firmware::ArduPilot => 9,
        })
    }

    /// Whether two modes are the same; of OFFBOARD of PX4 the sub-mode does not count.
    pub fn is(self, other: Mode, firmware: Firmware) -> bool {
        let main = |mode: Mode| mode.0 >> 16 & 0xff;
        match firmware {
            Firmware::ArduPilot => self == other,
            Firmware::Px4 if main(other) == 4 => self.0 >> 16 == other.0 >> 16,
            Firmware::Px4 => main(self) == main(other),
        }
    }

    /// Returns the parameters of the command that asks for the mode.
    pub fn parameters(self, firmware: Firmware) -> ModeParameters {
        match firmware {
            Firmware::Px4 => [(self.0 >> 16 & 0xff) as f32, (self.0 >> 24) as f32],
            Firmware::ArduPilot => [self.0 as f32, 0.0],
        }
    }

    /// Returns the name of the mode as the firmware's ground stations show it; its number if it has none here.
    pub fn name(self, firmware: Firmware, vehicle: Vehicle) -> String {
        let nth = |names: &[&str], number: u32| {
            number.checked_sub(1).and_then(|at| names.get(at as usize)).map(|name| (*name).to_owned())
        };
        let of =
            |modes: &[(u32, &str)]| modes.iter().find(|(number, _)| *number == self.0).map(|(_, n)| (*n).to_owned());
        let name = match (firmware, vehicle) {
            (Firmware::Px4, _) => match (self.0 >> 16 & 0xff, self.0 >> 24) {
                (4, sub) => nth(&PX4_AUTO, sub).map(|sub| format!("AUTO.{sub}")),
                (main, _) => nth(&PX4_MODES, main),
            },
            (Firmware::ArduPilot, Vehicle::Rover) => of(&ROVER_MODES),
            (Firmware::ArduPilot, Vehicle::Copter) => of(&COPTER_MODES),
        };
        name.unwrap_or_else(|| format!("number {}", self.0))
    }
}

/// Returns the reason for which an autopilot is none of this firmware and kind of vehicle, by its heartbeat; `None`
/// if it is.
pub fn mismatch(heartbeat: &HEARTBEAT_DATA, firmware: Firmware, vehicle: Vehicle) -> Option<String> {
    let is = match heartbeat.autopilot {
        MavAutopilot::MAV_AUTOPILOT_PX4 => Some(Firmware::Px4),
        MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA => Some(Firmware::ArduPilot),
        _ => None,
    };
    if is != Some(firmware) {
        let is = is.map_or("neither PX4 nor ArduPilot".to_owned(), |is| format!("{is:?}"));
        return Some(format!("its firmware is {is}, and `autopilot` is another"));
    }
    let is = match heartbeat.mavtype {
        MavType::MAV_TYPE_GROUND_ROVER | MavType::MAV_TYPE_SURFACE_BOAT => Some(Vehicle::Rover),
        MavType::MAV_TYPE_QUADROTOR
        | MavType::MAV_TYPE_COAXIAL
        | MavType::MAV_TYPE_HELICOPTER
        | MavType::MAV_TYPE_HEXAROTOR
        | MavType::MAV_TYPE_OCTOROTOR
        | MavType::MAV_TYPE_TRICOPTER
        | MavType::MAV_TYPE_DODECAROTOR => Some(Vehicle::Copter),
        _ => None,
    };
    let words = match is {
        Some(is) if is == vehicle => return None,
        Some(Vehicle::Rover) => "a rover",
        Some(Vehicle::Copter) => "a copter",
        None => "neither rover nor copter",
    };
    Some(format!("it is {words}, and `vehicle` is another"))
}

/// Returns the names of the parameters that say what the autopilot does when setpoints end.
pub fn parameters(firmware: Firmware, vehicle: Vehicle) -> &'static [&'static str] {
    match (firmware, vehicle) {
        (Firmware::Px4, _) => &["COM_OF_LOSS_T", "COM_OBL_RC_ACT", "COM_RC_OVERRIDE"],
        (Firmware::ArduPilot, Vehicle::Rover) => &["FS_GCS_ENABLE", "FS_ACTION", "FS_TIMEOUT"],
        (Firmware::ArduPilot, Vehicle::Copter) => &["GUID_TIMEOUT", "FS_GCS_ENABLE", "FS_GCS_TIMEOUT"],
    }
}

/// Returns the name that stands for a value, from the table `names` of the firmware's documentation.
fn named(value: f64, names: &[&str]) -> String {
    let at = if value >= 0.0 { value as usize } else { usize::MAX };
    names.get(at).map_or_else(|| format!("{value}"), |name| format!("{value}: {name}"))
}

/// Returns what the autopilot does when setpoints end, as its parameters say; `value` gives the value of a parameter,
/// `None` if the autopilot has not told it.
pub fn when_setpoints_end(firmware: Firmware, vehicle: Vehicle, value: impl Fn(&str) -> Option<f64>) -> String {
    let said = |name: &str, names: &[&str]| match value(name) {
        Some(value) => format!("{name} {}", named(value, names)),
        None => format!("{name} not told"),
    };
    match (firmware, vehicle) {
        (Firmware::Px4, _) => {
            let loss = value("COM_OF_LOSS_T").map_or("some time".to_owned(), |s| format!("{s} s"));
            let actions = ["Position", "Altitude", "Stabilized", "Return", "Land", "Hold", "Terminate", "Disarm"];
            let override_bits = ["off", "in AUTO", "in OFFBOARD", "in AUTO and OFFBOARD"];
            format!(
                "when setpoints end, PX4 leaves OFFBOARD after {loss} (COM_OF_LOSS_T), then {}; the pilot's sticks \
                 take over: {}",
                said("COM_OBL_RC_ACT", &actions),
                said("COM_RC_OVERRIDE", &override_bits)
            )
        }
        (Firmware::ArduPilot, Vehicle::Rover) => {
            let action = ["nothing", "RTL", "Hold", "SmartRTL or RTL", "SmartRTL or Hold", "Terminate"];
            format!(
                "when setpoints end, ArduPilot stops the rover after 3 s (not a parameter); without this host's \
                 heartbeat: {}, {}, after {}",
                said("FS_GCS_ENABLE", &["off", "on", "on, not in AUTO"]),
                said("FS_ACTION", &action),
                said("FS_TIMEOUT", &[])
            )
        }
        (Firmware::ArduPilot, Vehicle::Copter) => {
            let enable = ["off", "RTL", "(of old)", "SmartRTL or RTL", "SmartRTL or Land", "Land"];
            let timeout = value("GUID_TIMEOUT").map_or("some time".to_owned(), |s| format!("{s} s"));
            format!(
                "when setpoints end, ArduPilot hovers after {timeout} (GUID_TIMEOUT); without this host's heartbeat: \
                 {}, after {}",
                said("FS_GCS_ENABLE", &enable),
                said("FS_GCS_TIMEOUT", &[])
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Firmware::{ArduPilot, Px4};

    #[test]
    fn modes_have_the_names_of_ground_stations() {
        let name = |mode, firmware, vehicle| Mode(mode).name(firmware, vehicle);
        assert_eq!(name(6 << 16, Px4, Vehicle::Rover), "OFFBOARD");
        assert_eq!(name(4 << 16 | 5 << 24, Px4, Vehicle::Rover), "AUTO.RTL");
        assert_eq!(name(1 << 16, Px4, Vehicle::Copter), "MANUAL");
        assert_eq!((name(0, Px4, Vehicle::Rover), name(99 << 16, Px4, Vehicle::Rover)).0, "number 0");
        assert_eq!(name(4, ArduPilot, Vehicle::Rover), "HOLD");
        assert_eq!(name(4, ArduPilot, Vehicle::Copter), "GUIDED");
        assert_eq!(name(77, ArduPilot, Vehicle::Copter), "number 77");
    }

    #[test]
    fn the_mode_that_follows_setpoints_is_told_from_all_others() {
        for firmware in [Px4, ArduPilot] {
            for vehicle in [Vehicle::Rover, Vehicle::Copter] {
                let own = Mode::followed(firmware, vehicle);
                let same = (0..16).flat_map(|main| (0..10).map(move |sub| (main, sub)));
                let modes = same.map(|(main, sub)| match firmware {
                    Px4 => Mode(main << 16 | sub << 24),
                    ArduPilot => Mode(main),
                });
                let found: Vec<Mode> = modes.filter(|mode| mode.is(own, firmware)).collect();
                assert!(found.iter().all(|mode| mode.name(firmware, vehicle) == own.name(firmware, vehicle)));
                assert!(!found.is_empty());
            }
        }
        assert!(!Mode(4 << 16 | 5 << 24).is(Mode::landing(Px4), Px4), "RTL is not LAND");
        assert_eq!(Mode::landing(Px4).parameters(Px4), [4.0, 6.0]);
        assert_eq!(Mode::followed(Px4, Vehicle::Rover).parameters(Px4), [6.0, 0.0]);
    }

    #[test]
    fn parameters_say_in_words_when_setpoints_end() {
        let px4 = |name: &str| [("COM_OF_LOSS_T", 0.5), ("COM_OBL_RC_ACT", 4.0)].into_iter().find(|p| p.0 == name);
        let text = when_setpoints_end(Px4, Vehicle::Rover, |name| Some(px4(name)?.1));
        assert!(text.contains("after 0.5 s (COM_OF_LOSS_T), then COM_OBL_RC_ACT 4: Land"), "{text}");
        assert!(text.contains("COM_RC_OVERRIDE not told"), "{text}");
        let text = when_setpoints_end(ArduPilot, Vehicle::Copter, |_| Some(5.0));
        assert!(text.contains("hovers after 5 s (GUID_TIMEOUT)") && text.contains("FS_GCS_ENABLE 5: Land"), "{text}");
        let text = when_setpoints_end(ArduPilot, Vehicle::Rover, |_| Some(-1.0));
        assert!(text.contains("after 3 s") && text.contains("FS_ACTION -1"), "{text}");
    }
}
