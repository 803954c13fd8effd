//! Messages of the topic `/truth`: the true states of all simulated robots at a time, as Protobuf.

use foxglove::Encode;
use foxglove::messages::{PoseInFrame, Timestamp};
use prost::Message;
use prost::encoding::{DecodeContext, WireType, decode_key, skip_field};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

/// True states of all simulated robots at a time.
#[derive(Clone, PartialEq, Message)]
pub struct Truth {
    /// Time since 1970 or the start of the simulation.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Robots, in the order of their ids.
    #[prost(message, repeated, tag = "2")]
    pub robots: Vec<TrueRobot>,
}

/// True state of a simulated robot. Positions and velocities are in the world frame.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct TrueRobot {
    /// Id of the robot.
    #[prost(uint32, tag = "1")]
    pub robot: u32,
    /// Position along x \[m\].
    #[prost(double, tag = "2")]
    pub x: f64,
    /// Position along y \[m\].
    #[prost(double, tag = "3")]
    pub y: f64,
    /// Velocity along x \[m/s\].
    #[prost(double, tag = "4")]
    pub velocity_x: f64,
    /// Velocity along y \[m/s\].
    #[prost(double, tag = "5")]
    pub velocity_y: f64,
    /// Heading \[rad\], counter-clockwise from x.
    #[prost(double, tag = "6")]
    pub heading: f64,
    /// Yaw rate \[rad/s\].
    #[prost(double, tag = "7")]
    pub yaw_rate: f64,
    /// Commanded velocity along x \[m/s\].
    #[prost(double, tag = "8")]
    pub command_x: f64,
    /// Commanded velocity along y \[m/s\].
    #[prost(double, tag = "9")]
    pub command_y: f64,
    /// Whether the robot touches another one.
    #[prost(bool, tag = "10")]
    pub touches_robot: bool,
    /// Whether the robot touches a wall.
    #[prost(bool, tag = "11")]
    pub touches_wall: bool,
}

/// Reads the robots of an encoded [`Truth`]. Invalid bytes end it early.
///
/// One robot is decoded at a time: all at once, those of an attacker's message would take forty times its size.
pub fn robots(mut message: &[u8]) -> impl Iterator<Item = TrueRobot> {
    std::iter::from_fn(move || {
        loop {
            match decode_key(&mut message).ok()? {
                (2, WireType::LengthDelimited) => return TrueRobot::decode_length_delimited(&mut message).ok(),
                (tag, wire) => skip_field(wire, tag, &mut message, DecodeContext::default()).ok()?,
            }
        }
    })
}

/// Returns the description of [`Truth`] as an encoded `FileDescriptorSet`, with the types that it uses.
pub fn schema() -> Vec<u8> {
    const TIMESTAMP: &str = "google/protobuf/timestamp.proto";
    let field = |name: &str, number, kind: Type| FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        ..FieldDescriptorProto::default()
    };
    let numbers = ["x", "y", "velocity_x", "velocity_y", "heading", "yaw_rate", "command_x", "command_y"];
    let numbers = (2..).zip(numbers).map(|(number, name)| field(name, number, Type::Double));
    let contacts = [field("touches_robot", 10, Type::Bool), field("touches_wall", 11, Type::Bool)];
    let mut timestamp = field("timestamp", 1, Type::Message);
    timestamp.type_name = Some(".google.protobuf.Timestamp".to_owned());
    let mut robots = field("robots", 2, Type::Message);
    robots.type_name = Some(".murmurate.Robot".to_owned());
    robots.label = Some(Label::Repeated.into());
    let message =
        |name: &str, field| DescriptorProto { name: Some(name.to_owned()), field, ..DescriptorProto::default() };
    let robot = [field("robot", 1, Type::Uint32)].into_iter().chain(numbers).chain(contacts).collect();
    let known = PoseInFrame::get_schema().expect("Foxglove describes its types").data;
    let mut set = FileDescriptorSet::decode(&*known).expect("the description is valid");
    set.file.retain(|file| file.name() == TIMESTAMP);
    set.file.push(FileDescriptorProto {
        name: Some("murmurate.proto".to_owned()),
        package: Some("murmurate".to_owned()),
        dependency: vec![TIMESTAMP.to_owned()],
        message_type: vec![message("Robot", robot), message("Truth", vec![timestamp, robots])],
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    });
    set.encode_to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_are_read_one_by_one_and_damage_ends_them() {
        let robot = |robot| TrueRobot { robot, x: 0.5, touches_wall: true, ..TrueRobot::default() };
        let truth = Truth { timestamp: Some(Timestamp::new(1, 2)), robots: vec![robot(0), robot(300)] };
        let mut bytes = truth.encode_to_vec();
        // Of a later version: a field that this one does not know.
        bytes.extend(b"\x1a\x03new");
        bytes.extend([0x12, 0]);
        assert_eq!(robots(&bytes).collect::<Vec<_>>(), [robot(0), robot(300), TrueRobot::default()]);
        assert_eq!(robots(&bytes[..20]).count(), 1);
        assert_eq!(robots(&[0xff; 12]).count(), 0);
    }

    #[test]
    fn messages_are_as_in_the_first_version() {
        // Field 2 of a robot is x, and numbers with the value 0 are left out.
        let robot = TrueRobot { robot: 150, x: 1.0, touches_robot: true, ..TrueRobot::default() };
        let truth = Truth { timestamp: Some(Timestamp::new(0, 7)), robots: vec![robot] };
        let expected = b"\x0a\x02\x10\x07\x12\x0e\x08\x96\x01\x11\x00\x00\x00\x00\x00\x00\xf0\x3f\x50\x01";
        assert_eq!(truth.encode_to_vec(), expected);
    }

    #[test]
    fn the_schema_describes_all_fields() {
        let set = FileDescriptorSet::decode(&*schema()).unwrap();
        let names: Vec<&str> = set.file.iter().map(|file| file.name()).collect();
        assert_eq!(names, ["google/protobuf/timestamp.proto", "murmurate.proto"]);
        let numbers: Vec<i32> = set.file[1].message_type[0].field.iter().map(|field| field.number()).collect();
        assert_eq!(numbers, (1..=11).collect::<Vec<i32>>());
    }
}
