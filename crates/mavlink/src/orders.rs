//! Messages to an autopilot: setpoints, commands, requests, and this host's heartbeat.

use mavlink::dialects::common::{
    COMMAND_LONG_DATA, HEARTBEAT_DATA, MavAutopilot, MavCmd, MavFrame, MavMessage, MavModeFlag, MavState, MavType,
    PARAM_REQUEST_READ_DATA, PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use mavlink::types::CharArray;
use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::messages::local::BodyTwist;
use murmurate::time::Time;

use super::axes::{flipped, turned_over};
use super::firmware::Mode;
use super::settings::{AUTOPILOT, DriverConfig, LinkSettings, Setpoints, Vehicle};

/// Numbers of messages that the parts without I/O use. The worker leaves out all others.
pub const WANTED: [u32; 13] = [
    HEARTBEAT,
    SYS_STATUS,
    PARAM_VALUE,
    GPS_RAW_INT,
    ATTITUDE,
    LOCAL_POSITION_NED,
    GLOBAL_POSITION_INT,
    GPS_GLOBAL_ORIGIN,
    COMMAND_ACK,
    BATTERY_STATUS,
    EXTENDED_SYS_STATE,
    STATUSTEXT,
    CURRENT_MODE,
];
/// Number of the message HEARTBEAT.
pub const HEARTBEAT: u32 = 0;
const SYS_STATUS: u32 = 1;
const PARAM_VALUE: u32 = 22;
const GPS_RAW_INT: u32 = 24;
const ATTITUDE: u32 = 30;
const LOCAL_POSITION_NED: u32 = 32;
const GLOBAL_POSITION_INT: u32 = 33;
const GPS_GLOBAL_ORIGIN: u32 = 49;
const COMMAND_ACK: u32 = 77;
const BATTERY_STATUS: u32 = 147;
const EXTENDED_SYS_STATE: u32 = 245;
const STATUSTEXT: u32 = 253;
const CURRENT_MODE: u32 = 436;

/// Rates at which an autopilot's mode is asked for \[Hz\]: a pilot's change of it is known within 50 ms. PX4 says
/// CURRENT_MODE so; ArduPilot says HEARTBEAT at each change.
const MODE_HZ: u8 = 20;
/// Rate of the heartbeat that is asked for \[Hz\].
const HEARTBEAT_HZ: u8 = 5;

/// Value of MAV_CMD_COMPONENT_ARM_DISARM that disarms in the air, too (MAVLink's common messages).
const FORCE: f32 = 21_196.0;

/// Returns this host's heartbeat: that of an onboard computer.
pub fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

fn command(link: &LinkSettings, command: MavCmd, parameters: [f32; 7]) -> MavMessage {
    let [param1, param2, param3, param4, param5, param6, param7] = parameters;
    MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        param1,
        param2,
        param3,
        param4,
        param5,
        param6,
        param7,
        command,
        target_system: link.system,
        target_component: AUTOPILOT,
        confirmation: 0,
    })
}

/// Returns the request for a mode.
pub fn set_mode(config: &DriverConfig, mode: Mode) -> MavMessage {
    let [main, sub] = mode.parameters(config.firmware);
    // The flag of modes that the firmware defines itself.
    command(&config.link, MavCmd::MAV_CMD_DO_SET_MODE, [1.0, main, sub, 0.0, 0.0, 0.0, 0.0])
}

/// Returns the request to arm.
pub fn arm(link: &LinkSettings) -> MavMessage {
    command(link, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
}

/// Returns the request to switch the motors off at once, wherever the vehicle is.
pub fn cut(link: &LinkSettings) -> MavMessage {
    command(link, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, [0.0, FORCE, 0.0, 0.0, 0.0, 0.0, 0.0])
}

/// Returns the request to rise to a height above the ground \[m\], where the vehicle is. (ArduPilot.)
pub fn take_off(link: &LinkSettings, height_m: f32) -> MavMessage {
    command(link, MavCmd::MAV_CMD_NAV_TAKEOFF, [0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0, height_m])
}

/// Returns the requests for a rate of messages: positions and attitudes, modes, and batteries once a second.
pub fn intervals(link: &LinkSettings, position_hz: u8) -> Vec<MavMessage> {
    let interval = |id: u32, hz: f32| {
        let parameters = [id as f32, 1e6 / hz, 0.0, 0.0, 0.0, 0.0, 0.0];
        command(link, MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, parameters)
    };
    let position = f32::from(position_hz);
    let mut all = vec![interval(HEARTBEAT, HEARTBEAT_HZ.into()), interval(CURRENT_MODE, MODE_HZ.into())];
    all.extend([ATTITUDE, LOCAL_POSITION_NED, GLOBAL_POSITION_INT].map(|id| interval(id, position)));
    all.extend([GPS_RAW_INT, EXTENDED_SYS_STATE].map(|id| interval(id, 5.0)));
    all.extend([SYS_STATUS, BATTERY_STATUS].map(|id| interval(id, 1.0)));
    all.push(origin(link));
    all
}

/// Returns the request for the place of the autopilot's origin on the earth.
pub fn origin(link: &LinkSettings) -> MavMessage {
    let parameters = [GPS_GLOBAL_ORIGIN as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    command(link, MavCmd::MAV_CMD_REQUEST_MESSAGE, parameters)
}

/// Returns the request for a parameter's value.
pub fn parameter(link: &LinkSettings, name: &str) -> MavMessage {
    MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
        param_index: -1,
        target_system: link.system,
        target_component: AUTOPILOT,
        param_id: CharArray::from(name),
    })
}

/// Motion that a setpoint asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Velocity in the team's frame \[m/s\].
    pub velocity: Vec2,
    /// The same in the robot's own frame; `None` while its heading is unknown.
    pub body: Option<BodyTwist>,
    /// Speed upwards \[m/s\].
    pub climb_m_s: f32,
}

impl Wanted {
    /// To stand, or to hover.
    pub const STAND: Wanted = Wanted { velocity: Vec2::new(0.0, 0.0), body: None, climb_m_s: 0.0 };
}

/// Returns the setpoint for a motion, within the limits of the settings. What is not finite is standing.
pub fn setpoint(config: &DriverConfig, now: Time, wanted: &Wanted) -> MavMessage {
    let position = PositionTargetTypemask::POSITION_TARGET_TYPEMASK_X_IGNORE
        | PositionTargetTypemask::POSITION_TARGET_TYPEMASK_Y_IGNORE
        | PositionTargetTypemask::POSITION_TARGET_TYPEMASK_Z_IGNORE;
    let acceleration = PositionTargetTypemask::POSITION_TARGET_TYPEMASK_AX_IGNORE
        | PositionTargetTypemask::POSITION_TARGET_TYPEMASK_AY_IGNORE
        | PositionTargetTypemask::POSITION_TARGET_TYPEMASK_AZ_IGNORE;
    let yaw = PositionTargetTypemask::POSITION_TARGET_TYPEMASK_YAW_IGNORE;
    let yaw_rate = PositionTargetTypemask::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE;
    let down = PositionTargetTypemask::POSITION_TARGET_TYPEMASK_VZ_IGNORE;
    let mut setpoint = SET_POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: now.as_nanos().wrapping_div(1_000_000) as u32,
        target_system: config.link.system,
        target_component: AUTOPILOT,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        type_mask: position | acceleration | yaw | yaw_rate,
        ..SET_POSITION_TARGET_LOCAL_NED_DATA::DEFAULT
    };
    if config.vehicle == Vehicle::Rover {
        setpoint.type_mask |= down;
    } else if wanted.climb_m_s.is_finite() {
        setpoint.vz = flipped(wanted.climb_m_s.into()) as f32;
    }
    match config.setpoints {
        Setpoints::World => {
            let velocity = wanted.velocity.capped(config.speed_m_s);
            if velocity.x.is_finite() && velocity.y.is_finite() {
                let to = config.axes.to_autopilot(velocity.x.into(), velocity.y.into());
                (setpoint.vx, setpoint.vy) = (to.north as f32, to.east as f32);
            }
        }
        Setpoints::Body => {
            #[allow(deprecated)] // ArduPilot's rovers know the successor of this frame by no version that is released.
            let own = MavFrame::MAV_FRAME_BODY_NED;
            setpoint.coordinate_frame = own;
            setpoint.type_mask.remove(yaw_rate);
            let twist = wanted.body.filter(|twist| twist.forward.is_finite() && twist.yaw_rate.is_finite());
            if let Some(twist) = twist {
                setpoint.vx = twist.forward.clamp(-config.speed_m_s, config.speed_m_s);
                let rate = twist.yaw_rate.clamp(-config.yaw_rate_rad_s, config.yaw_rate_rad_s);
                setpoint.yaw_rate = turned_over(rate.into()) as f32;
            }
        }
    }
    MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::tests_config;

    fn of(more: &str, wanted: &Wanted) -> SET_POSITION_TARGET_LOCAL_NED_DATA {
        match setpoint(&tests_config(more), Time::ZERO, wanted) {
            MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint) => setpoint,
            other => panic!("{other:?}"),
        }
    }

    fn moving(x: f32, y: f32) -> Wanted {
        let body = Some(BodyTwist { forward: 0.7, left: 0.0, yaw_rate: 0.5 });
        Wanted { velocity: Vec2::new(x, y), body, climb_m_s: 0.25 }
    }

    #[test]
    fn a_velocity_becomes_north_and_east_with_the_mask_of_velocities() {
        let rover = of("", &moving(0.25, -0.5));
        assert_eq!((rover.vx, rover.vy, rover.vz, rover.yaw_rate), (-0.5, 0.25, 0.0, 0.0));
        assert_eq!((rover.type_mask.bits(), rover.coordinate_frame), (3559, MavFrame::MAV_FRAME_LOCAL_NED));
        let copter = of("vehicle = 'copter'", &moving(0.25, -0.5));
        assert_eq!((copter.vx, copter.vy, copter.vz), (-0.5, 0.25, -0.25), "down");
        assert_eq!(copter.type_mask.bits(), 3527);
        assert_eq!((copter.target_system, copter.target_component), (1, 1));
    }

    #[test]
    fn a_differential_drive_gets_its_speed_ahead_and_a_clockwise_yaw_rate() {
        let body = of("autopilot = 'ardupilot'\nsetpoints = 'body'", &moving(0.25, -0.5));
        assert_eq!((body.vx, body.vy, body.yaw_rate), (0.7, 0.0, -0.5));
        #[allow(deprecated)] // The frame that `setpoint` takes for ArduPilot's rovers.
        let own = MavFrame::MAV_FRAME_BODY_NED;
        assert_eq!((body.type_mask.bits(), body.coordinate_frame), (1511, own));
        let unknown = of("autopilot = 'ardupilot'\nsetpoints = 'body'", &Wanted { body: None, ..moving(1.0, 0.0) });
        assert_eq!((unknown.vx, unknown.yaw_rate), (0.0, 0.0), "its heading is unknown");
    }

    #[test]
    fn limits_hold_and_what_is_no_number_stands() {
        let fast = of("", &moving(30.0, 40.0));
        assert!(fast.vx.hypot(fast.vy) <= 1.0 + 1e-6, "{} {}", fast.vx, fast.vy);
        let nan = of("", &moving(f32::NAN, 0.0));
        assert_eq!((nan.vx, nan.vy), (0.0, 0.0));
    }
}
