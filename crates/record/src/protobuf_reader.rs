//! Reads the Protocol Buffers messages of records, field by field.

/// Value of a field of a Protocol Buffers message, by its wire type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// Varint: integer, boolean or enum value.
    Uint(u64),
    /// 64-bit floating-point number.
    Double(f64),
    /// String, byte string or embedded message.
    Bytes(&'a [u8]),
    /// 32-bit integer of fixed size.
    Fixed32(u32),
}

impl<'a> Value<'a> {
    /// Returns the value of a varint or a floating-point number; `None` for bytes and for integers of fixed size.
    pub fn number(self) -> Option<f64> {
        match self {
            Value::Double(number) => Some(number),
            Value::Uint(number) => Some(number as f64),
            _ => None,
        }
    }

    /// Returns the bytes of a string, byte string or embedded message; `None` for other values.
    pub fn bytes(self) -> Option<&'a [u8]> {
        match self {
            Value::Bytes(bytes) => Some(bytes),
            _ => None,
        }
    }
}

/// Iterator over the fields of an encoded Protocol Buffers message, each with its number and value. It ends early at
/// invalid bytes.
pub struct Fields<'a>(pub &'a [u8]);

impl<'a> Iterator for Fields<'a> {
    type Item = (u32, Value<'a>);

    fn next(&mut self) -> Option<(u32, Value<'a>)> {
        let key = self.varint()?;
        let field = u32::try_from(key >> 3).ok()?;
        let value = match key & 7 {
            0 => Value::Uint(self.varint()?),
            1 => Value::Double(f64::from_le_bytes(self.take(8)?.try_into().ok()?)),
            2 => {
                let length = usize::try_from(self.varint()?).ok()?;
                Value::Bytes(self.take(length)?)
            }
            5 => Value::Fixed32(u32::from_le_bytes(self.take(4)?.try_into().ok()?)),
            _ => return None,
        };
        Some((field, value))
    }
}

/// Returns the true states of the robots in a message of the topic `/truth`: for each robot, the numbers of its fields
/// by field number. Fields that are absent are 0.
pub fn truth(message: &[u8]) -> impl Iterator<Item = [f64; 12]> {
    let robots = Fields(message).filter(|(field, _)| *field == 2);
    robots.filter_map(|(_, robot)| robot.bytes()).map(|robot| {
        let mut numbers = [0.0; 12];
        for (field, value) in Fields(robot) {
            if let (Some(place), Some(number)) = (numbers.get_mut(field as usize), value.number()) {
                *place = number;
            }
        }
        numbers
    })
}

impl<'a> Fields<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = *self.take(1)?.first()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_as_in_the_specification_and_damage_ends_them() {
        let bytes = b"\x08\x96\x01\x12\x07testing\x1a\x03\x08\x96\x01";
        let fields: Vec<(u32, Value)> = Fields(bytes).collect();
        let expected = [(1, Value::Uint(150)), (2, Value::Bytes(b"testing")), (3, Value::Bytes(b"\x08\x96\x01"))];
        assert_eq!(fields, expected);
        assert_eq!(Fields(&bytes[..9]).count(), 1);
        assert_eq!(Fields(&[0xff; 12]).count(), 0);
    }
}
