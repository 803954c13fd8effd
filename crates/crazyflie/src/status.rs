//! Condition of a Crazyflie: its battery, and what its supervisor says.

use murmurate::messages::wire::{Hardware, Health};

/// Log variables of the block with the condition, each with the type in which it is sent: a charge \[%\], a state of
/// the power (int8), and the bits of the supervisor (uint16).
pub const VARIABLES: [(&str, u8); 3] = [("pm.batteryLevel", 1), ("pm.state", 4), ("supervisor.info", 2)];

/// State of the power in which the firmware calls the battery low, and the one in which it switches itself off.
const LOW_POWER: i8 = 3;
const SHUTDOWN: i8 = 4;

/// Bits of the supervisor.
const CAN_BE_ARMED: u16 = 1 << 0;
const IS_ARMED: u16 = 1 << 1;
const CAN_FLY: u16 = 1 << 3;
const IS_FLYING: u16 = 1 << 4;
const IS_TUMBLED: u16 = 1 << 5;
const IS_LOCKED: u16 = 1 << 6;
const IS_CRASHED: u16 = 1 << 7;
const HIGH_LEVEL_FLIES: u16 = 1 << 8;

/// Condition of a robot, as its log block says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    battery: u8,
    power: i8,
    bits: u16,
}

impl Status {
    /// Decodes the content of a log block; `None` if it is too short.
    pub fn decode(data: &[u8]) -> Option<Status> {
        let [battery, power, low, high, ..] = data else { return None };
        Some(Status {
            battery: (*battery).min(100),
            power: i8::from_le_bytes([*power]),
            bits: u16::from_le_bytes([*low, *high]),
        })
    }

    /// Whether the supervisor sees the robot fly.
    pub fn is_flying(&self) -> bool {
        self.bits & IS_FLYING != 0
    }

    /// Whether the high-level commander flies the robot; false in firmware that does not say so.
    pub fn is_led(&self) -> bool {
        self.bits & HIGH_LEVEL_FLIES != 0
    }

    /// Whether the robot has to be armed before it flies, and takes it.
    pub fn is_to_be_armed(&self) -> bool {
        self.bits & CAN_BE_ARMED != 0 && self.bits & IS_ARMED == 0
    }

    /// Returns why the robot may not fly; `None` if it may. `arms` says whether the driver arms it when it rises.
    fn fault(&self, arms: bool) -> Option<&'static str> {
        match () {
            () if self.bits & IS_LOCKED != 0 => Some("its supervisor has locked it: switch it off and on"),
            () if self.bits & IS_CRASHED != 0 => Some("it has crashed, says its supervisor"),
            () if self.bits & IS_TUMBLED != 0 => Some("it has tumbled, says its supervisor"),
            () if self.power == LOW_POWER || self.power == SHUTDOWN => Some("its battery is low, says its firmware"),
            () if self.bits & CAN_FLY != 0 || self.is_flying() => None,
            () if !self.is_to_be_armed() => Some("it cannot fly, says its supervisor"),
            () if !arms => Some("it is not armed: arm it, or set arm = true"),
            () => None,
        }
    }

    /// Returns the condition of the robot for its Body.
    pub fn hardware(&self, arms: bool) -> Hardware {
        let fault = self.fault(arms);
        let health = if fault.is_some() { Health::Faulty } else { Health::Ready };
        Hardware { battery: Some(self.battery), ..Hardware::of(health) }.because(fault.unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(power: u8, bits: u16, arms: bool) -> (Health, String) {
        let [low, high] = bits.to_le_bytes();
        let hardware = Status::decode(&[87, power, low, high]).expect("it is whole").hardware(arms);
        assert_eq!(hardware.battery, Some(87));
        (hardware.health, hardware.reason.map_or(String::new(), |reason| reason.text().to_owned()))
    }

    #[test]
    fn each_flag_of_the_supervisor_that_forbids_flight_is_a_fault_with_its_reason() {
        for (bits, named) in [
            (CAN_FLY | IS_TUMBLED, "tumbled"),
            (CAN_FLY | IS_CRASHED, "crashed"),
            (CAN_FLY | IS_LOCKED | IS_TUMBLED, "locked"),
            (IS_ARMED, "cannot fly"),
            (CAN_BE_ARMED, "not armed"),
            (IS_FLYING | IS_TUMBLED, "tumbled"),
        ] {
            let (health, reason) = said(0, bits, false);
            assert!(health == Health::Faulty && reason.contains(named), "{bits:#x}: {reason}");
        }
        assert!(said(3, CAN_FLY, false).1.contains("battery"));
        for (bits, arms) in [(CAN_FLY, false), (CAN_FLY | IS_ARMED, false), (IS_FLYING, false), (CAN_BE_ARMED, true)] {
            assert_eq!(said(0, bits, arms), (Health::Ready, String::new()), "{bits:#x}");
        }
        assert_eq!(Status::decode(&[87, 0, 1]), None);
    }
}
