//! Packets that a host sends to a Crazyflie, by name: questions, orders, poses.

use crate::packet::{Packet, port};

/// Number of the first protocol version with arming and emergency stop at the supervisor's port.
const SUPERVISED: u8 = 12;

/// Asks for the version of the protocol.
pub fn version() -> Packet {
    Packet::new(port::PLATFORM, 1, [0])
}

/// Ends all log blocks.
pub fn reset_logs() -> Packet {
    Packet::new(port::LOG, 1, [5])
}

/// Asks for the length of a table of contents, and its CRC.
pub fn toc_info(port: u8) -> Packet {
    Packet::new(port, 0, [3])
}

/// Asks for an entry of a table of contents.
pub fn toc_item(port: u8, index: u16) -> Packet {
    let [low, high] = index.to_le_bytes();
    Packet::new(port, 0, [2, low, high])
}

/// Makes a log block of variables, each with its type and number.
pub fn create_block(block: u8, variables: &[(u8, u16)]) -> Packet {
    let each = |&(kind, number): &(u8, u16)| {
        let [low, high] = number.to_le_bytes();
        // Type in which it is fetched, and type in which it is stored.
        [kind | kind << 4, low, high]
    };
    let data: Vec<u8> = [6, block].into_iter().chain(variables.iter().flat_map(each)).collect();
    Packet::new(port::LOG, 1, data)
}

/// Starts a log block with a period \[10 ms\].
pub fn start_block(block: u8, period: u8) -> Packet {
    Packet::new(port::LOG, 1, [3, block, period])
}

/// Asks for the value of a parameter.
pub fn read_parameter(number: u16) -> Packet {
    Packet::new(port::PARAM, 1, number.to_le_bytes())
}

/// Sets the value of a parameter; the bytes are of its type.
pub fn write_parameter(number: u16, value: &[u8]) -> Packet {
    Packet::new(port::PARAM, 2, [&number.to_le_bytes()[..], value].concat())
}

/// Ends the priority of the low-level setpoints at once, so that the high-level commander flies the robot.
pub fn end_setpoints() -> Packet {
    Packet::new(port::SETPOINT, 1, [0, 0, 0, 0, 0])
}

/// Takes off to a height \[m\] within a time \[s\], with the heading that the robot has.
pub fn take_off(height_m: f32, seconds: f32) -> Packet {
    high_level(7, height_m, seconds)
}

/// Lands on the ground within a time \[s\], with the heading that the robot has.
pub fn land(seconds: f32) -> Packet {
    high_level(8, 0.0, seconds)
}

fn high_level(command: u8, height_m: f32, seconds: f32) -> Packet {
    let (all_groups, no_yaw, current_yaw) = (0, 0f32.to_le_bytes(), 1);
    let data = [&[command, all_groups][..], &height_m.to_le_bytes(), &no_yaw, &[current_yaw], &seconds.to_le_bytes()];
    Packet::new(port::HIGH_LEVEL, 0, data.concat())
}

/// Switches the motors off that the high-level commander runs, of a robot on the ground.
pub fn motors_off() -> Packet {
    Packet::new(port::HIGH_LEVEL, 0, [3, 0])
}

/// Arms the robot, in the words of a version of the protocol.
pub fn arm(protocol: u8) -> Packet {
    if protocol >= SUPERVISED {
        Packet::new(port::SUPERVISOR, 1, [1, 1])
    } else {
        Packet::new(port::PLATFORM, 0, [1, 1])
    }
}

/// Emergency stop of the firmware: motors off at once, wherever the robot is.
pub fn cut(protocol: u8) -> Packet {
    if protocol >= SUPERVISED { Packet::new(port::SUPERVISOR, 1, [3]) } else { Packet::new(port::LOCALIZATION, 1, [3]) }
}

/// Tells the robot's estimator a position \[m\].
pub fn position(position_m: [f32; 3]) -> Packet {
    Packet::new(port::LOCALIZATION, 0, floats(&position_m))
}

/// Tells the robot's estimator a position \[m\] and an attitude as a quaternion (x, y, z, w).
pub fn pose(position_m: [f32; 3], quaternion: [f32; 4]) -> Packet {
    let data = [&[8][..], &floats(&position_m), &floats(&quaternion)].concat();
    Packet::new(port::LOCALIZATION, 1, data)
}

/// Returns numbers as bytes.
pub fn floats(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}
