//! Writes Protocol Buffers messages with the few field types that records use, and descriptors of message types.

/// Encoder of one Protocol Buffers message; it contains the bytes written so far. Numbers with the default value 0 are
/// left out, as in proto3.
#[derive(Default)]
pub struct Message(pub Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn key(&mut self, field: u32, wire_type: u32) {
        self.varint(u64::from(field << 3 | wire_type));
    }

    /// Writes an unsigned integer, a boolean or an enum value as the field with the number `field`, as a varint.
    pub fn uint(&mut self, field: u32, value: u64) {
        if value != 0 {
            self.key(field, 0);
            self.varint(value);
        }
    }

    /// Writes a 64-bit floating-point number as the field with the number `field`.
    pub fn double(&mut self, field: u32, value: f64) {
        if value != 0.0 {
            self.key(field, 1);
            self.0.extend(value.to_le_bytes());
        }
    }

    /// Writes a 32-bit unsigned integer of fixed size as the field with the number `field`.
    pub fn fixed32(&mut self, field: u32, value: u32) {
        if value != 0 {
            self.key(field, 5);
            self.0.extend(value.to_le_bytes());
        }
    }

    /// Writes a string as the field with the number `field`.
    pub fn text(&mut self, field: u32, value: &str) {
        self.bytes(field, value.as_bytes());
    }

    /// Writes a byte string as the field with the number `field`.
    pub fn bytes(&mut self, field: u32, value: &[u8]) {
        self.key(field, 2);
        self.varint(value.len() as u64);
        self.0.extend_from_slice(value);
    }

    /// Writes an embedded message as the field with the number `field`; `write` adds the fields of the embedded
    /// message.
    pub fn message(&mut self, field: u32, write: impl FnOnce(&mut Message)) {
        self.key(field, 2);
        // Most messages are shorter than 128 bytes, and their length takes one byte.
        self.0.push(0);
        let at = self.0.len();
        write(self);
        let length = self.0.len() - at;
        if length < 0x80 {
            self.0[at - 1] = length as u8;
            return;
        }
        let mut prefix = Message::default();
        prefix.varint(length as u64);
        self.0.splice(at - 1..at, prefix.0);
    }
}

/// Type of a field of a Protocol Buffers message.
#[derive(Clone, Copy)]
pub enum Type {
    /// 64-bit floating-point number.
    Double,
    /// Boolean.
    Bool,
    /// String.
    Text,
    /// Byte string.
    Bytes,
    /// 32-bit unsigned integer of fixed size.
    Fixed32,
    /// 32-bit unsigned integer as a varint.
    Uint32,
    /// Embedded message of the type with this name.
    One(&'static str),
    /// Repeated embedded message of the type with this name.
    Many(&'static str),
    /// Value of the enumeration with this name.
    Enum(&'static str),
}

/// Definition of a Protocol Buffers message type: its name, and its fields with name, number and type.
pub type MessageType = (&'static str, &'static [(&'static str, u32, Type)]);
/// Definition of a Protocol Buffers enumeration: its name, and the names of its values from 0.
pub type EnumType = (&'static str, &'static [&'static str]);

/// Returns descriptions of the message types and enumerations of a Protocol Buffers package, as an encoded
/// `FileDescriptorSet`. It includes the types of `google.protobuf` that they use.
pub fn describe(package: &str, messages: &[MessageType], enums: &[EnumType]) -> Vec<u8> {
    let mut set = Message::default();
    set.message(1, |file| well_known(file, "Timestamp", "google/protobuf/timestamp.proto"));
    set.message(1, |file| well_known(file, "Duration", "google/protobuf/duration.proto"));
    set.message(1, |file| {
        file.text(1, &format!("{package}.proto"));
        file.text(2, package);
        file.text(3, "google/protobuf/timestamp.proto");
        file.text(3, "google/protobuf/duration.proto");
        for (name, fields) in messages {
            file.message(4, |message| {
                message.text(1, name);
                fields.iter().for_each(|(name, number, of)| message.message(2, |one| field(one, name, *number, *of)));
            });
        }
        for (name, values) in enums {
            file.message(5, |entry| {
                entry.text(1, name);
                for (number, value) in (0..).zip(*values) {
                    entry.message(2, |one| {
                        one.text(1, value);
                        // Proto3 needs the number of an enum value even if it is 0.
                        one.key(2, 0);
                        one.varint(number);
                    });
                }
            });
        }
        file.text(12, "proto3");
    });
    set.0
}

fn field(out: &mut Message, name: &str, number: u32, of: Type) {
    const OPTIONAL: u64 = 1;
    const REPEATED: u64 = 3;
    let (label, kind, type_name) = match of {
        Type::Double => (OPTIONAL, 1, None),
        Type::Bool => (OPTIONAL, 8, None),
        Type::Text => (OPTIONAL, 9, None),
        Type::Bytes => (OPTIONAL, 12, None),
        Type::Fixed32 => (OPTIONAL, 7, None),
        Type::Uint32 => (OPTIONAL, 13, None),
        Type::One(name) => (OPTIONAL, 11, Some(name)),
        Type::Many(name) => (REPEATED, 11, Some(name)),
        Type::Enum(name) => (OPTIONAL, 14, Some(name)),
    };
    out.text(1, name);
    out.uint(3, u64::from(number));
    out.uint(4, label);
    out.uint(5, kind);
    type_name.into_iter().for_each(|name| out.text(6, name));
}

/// Writes the file descriptor of the type `Timestamp` or `Duration` of `google.protobuf`: seconds and nanoseconds.
fn well_known(file: &mut Message, name: &str, path: &str) {
    const INT64: u64 = 3;
    const INT32: u64 = 5;
    file.text(1, path);
    file.text(2, "google.protobuf");
    file.message(4, |message| {
        message.text(1, name);
        for (name, number, kind) in [("seconds", 1, INT64), ("nanos", 2, INT32)] {
            message.message(2, |one| {
                one.text(1, name);
                one.uint(3, number);
                one.uint(4, 1);
                one.uint(5, kind);
            });
        }
    });
    file.text(12, "proto3");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_as_in_the_specification() {
        // The example of the Protobuf encoding guide: field 1 is 150, field 2 "testing", field 3 a message with field 1
        // 150.
        let mut message = Message::default();
        message.uint(1, 150);
        message.text(2, "testing");
        message.message(3, |inner| inner.uint(1, 150));
        let expected = b"\x08\x96\x01\x12\x07testing\x1a\x03\x08\x96\x01";
        assert_eq!(message.0, expected);
    }

    #[test]
    fn a_long_message_has_its_length_before_it() {
        let mut message = Message::default();
        message.message(1, |inner| inner.bytes(2, &[9; 300]));
        assert_eq!(message.0[..3], [0x0a, 0xaf, 0x02]);
        assert_eq!(message.0.len(), 3 + 303);
    }
}
