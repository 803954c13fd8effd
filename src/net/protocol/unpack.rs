//! Decoder of message bodies: the subset of MessagePack that the encoder uses.
//!
//! Numbers are unsigned, of any width; structs, tuples and lists are arrays; floats are byte strings
//! (`messages::floats`). A struct may have more fields than this version knows, of any form, which are passed over, and
//! fewer if its type states what they are then. All other forms are refused. A general decoder would put several times
//! as much code in the path of every datagram.

use std::fmt;

use serde::de::{self, DeserializeSeed, Deserializer, SeqAccess, Visitor};

/// Decoder of a message body; holds the bytes that are not read yet.
pub struct Reader<'de>(pub &'de [u8]);

/// Error while a message body is decoded. It has no details, because the sender gets no reply.
#[derive(Debug)]
pub struct Unreadable;

impl fmt::Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the bytes are not what was to be read")
    }
}

impl std::error::Error for Unreadable {}

impl de::Error for Unreadable {
    fn custom<T: fmt::Display>(_: T) -> Unreadable {
        Unreadable
    }

    fn invalid_type(_: de::Unexpected<'_>, _: &dyn de::Expected) -> Unreadable {
        Unreadable
    }

    fn invalid_value(_: de::Unexpected<'_>, _: &dyn de::Expected) -> Unreadable {
        Unreadable
    }

    fn invalid_length(_: usize, _: &dyn de::Expected) -> Unreadable {
        Unreadable
    }
}

impl<'de> Reader<'de> {
    const NIL: u8 = 0xc0;
    const FALSE: u8 = 0xc2;
    const TRUE: u8 = 0xc3;
    const BIN_8: u8 = 0xc4;
    const BIN_32: u8 = 0xc6;
    const UINT_8: u8 = 0xcc;
    const UINT_64: u8 = 0xcf;
    const ARRAY_16: u8 = 0xdc;
    const ARRAY_32: u8 = 0xdd;

    fn take(&mut self, count: usize) -> Result<&'de [u8], Unreadable> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(Unreadable)?;
        self.0 = rest;
        Ok(taken)
    }

    fn marker(&mut self) -> Result<u8, Unreadable> {
        self.take(1).map(|byte| byte[0])
    }

    /// Reads a big-endian unsigned number of `1 << log` bytes.
    fn plain(&mut self, log: u8) -> Result<u64, Unreadable> {
        Ok(self.take(1 << log)?.iter().fold(0, |sum, byte| sum << 8 | u64::from(*byte)))
    }

    #[inline(never)]
    fn number(&mut self) -> Result<u64, Unreadable> {
        match self.marker()? {
            small @ 0..=0x7f => Ok(small.into()),
            marker @ Reader::UINT_8..=Reader::UINT_64 => self.plain(marker - Reader::UINT_8),
            _ => Err(Unreadable),
        }
    }

    #[inline(never)]
    fn bytes(&mut self) -> Result<&'de [u8], Unreadable> {
        let length = match self.marker()? {
            marker @ Reader::BIN_8..=Reader::BIN_32 => self.plain(marker - Reader::BIN_8)?,
            _ => return Err(Unreadable),
        };
        self.take(usize::try_from(length).map_err(|_| Unreadable)?)
    }

    /// Reads the length of an array.
    #[inline(never)]
    fn array(&mut self) -> Result<usize, Unreadable> {
        match self.marker()? {
            marker @ 0x90..=0x9f => Ok(usize::from(marker & 0x0f)),
            marker @ Reader::ARRAY_16..=Reader::ARRAY_32 => {
                let length = self.plain(marker - Reader::ARRAY_16 + 1)?;
                usize::try_from(length).map_err(|_| Unreadable)
            }
            _ => Err(Unreadable),
        }
    }

    fn elements<V: Visitor<'de>>(&mut self, left: usize, visitor: V) -> Result<V::Value, Unreadable> {
        let mut elements = Elements { reader: self, left };
        let value = visitor.visit_seq(&mut elements)?;
        // What is left are fields of a later version.
        let left = elements.left;
        self.skip(left)?;
        Ok(value)
    }

    /// Passes over so many values of any form, with all that they contain. Takes no more than the bytes that there are:
    /// each value has one at least.
    #[cold]
    fn skip(&mut self, values: usize) -> Result<(), Unreadable> {
        let mut left = values as u64;
        while left > 0 {
            let marker = self.marker()?;
            let (bytes, inside) = match marker {
                0x00..=0x7f | 0xe0..=0xff | Reader::NIL | Reader::FALSE | Reader::TRUE => (0, 0),
                0xc1 => return Err(Unreadable),
                0x80..=0x8f => (0, 2 * u64::from(marker & 0x0f)),
                0x90..=0x9f => (0, u64::from(marker & 0x0f)),
                0xa0..=0xbf => (u64::from(marker & 0x1f), 0),
                Reader::BIN_8..=Reader::BIN_32 => (self.plain(marker - Reader::BIN_8)?, 0),
                0xc7..=0xc9 => (1 + self.plain(marker - 0xc7)?, 0),
                0xca => (4, 0),
                0xcb => (8, 0),
                Reader::UINT_8..=Reader::UINT_64 => (1 << (marker - Reader::UINT_8), 0),
                0xd0..=0xd3 => (1 << (marker - 0xd0), 0),
                0xd4..=0xd8 => (1 + (1 << (marker - 0xd4)), 0),
                0xd9..=0xdb => (self.plain(marker - 0xd9)?, 0),
                Reader::ARRAY_16..=Reader::ARRAY_32 => (0, self.plain(marker - Reader::ARRAY_16 + 1)?),
                0xde..=0xdf => (0, 2 * self.plain(marker - 0xde + 1)?),
            };
            self.take(usize::try_from(bytes).map_err(|_| Unreadable)?)?;
            left += inside;
            left -= 1;
        }
        Ok(())
    }
}

/// Elements of an array that are not read yet.
struct Elements<'r, 'de> {
    reader: &'r mut Reader<'de>,
    left: usize,
}

impl<'de> SeqAccess<'de> for Elements<'_, 'de> {
    type Error = Unreadable;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Unreadable> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        seed.deserialize(&mut *self.reader).map(Some)
    }

    fn size_hint(&self) -> Option<usize> {
        // An element takes at least a byte, so a forged length reserves no memory.
        Some(self.left.min(self.reader.0.len()))
    }
}

impl<'de> Deserializer<'de> for &mut Reader<'de> {
    type Error = Unreadable;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unreadable> {
        Err(Unreadable)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        match self.marker()? {
            Reader::FALSE => visitor.visit_bool(false),
            Reader::TRUE => visitor.visit_bool(true),
            _ => Err(Unreadable),
        }
    }

    fn deserialize_u8<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        visitor.visit_u64(self.number()?)
    }

    fn deserialize_u16<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        visitor.visit_u64(self.number()?)
    }

    fn deserialize_u32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        visitor.visit_u64(self.number()?)
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        visitor.visit_u64(self.number()?)
    }

    fn deserialize_bytes<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        visitor.visit_borrowed_bytes(self.bytes()?)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        if self.0.first() == Some(&Reader::NIL) {
            self.take(1)?;
            return visitor.visit_none();
        }
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value, Unreadable> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        let length = self.array()?;
        self.elements(length, visitor)
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Unreadable> {
        let length = self.array()?;
        self.elements(length, visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Unreadable> {
        self.deserialize_tuple(fields.len(), visitor)
    }

    serde::forward_to_deserialize_any! {
        i8 i16 i32 i64 i128 u128 f32 f64 char str string byte_buf unit unit_struct tuple_struct map enum identifier
        ignored_any
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    /// Decodes bytes that contain exactly one value.
    fn read<T: for<'a> Deserialize<'a>>(bytes: &[u8]) -> Option<T> {
        let mut reader = Reader(bytes);
        T::deserialize(&mut reader).ok().filter(|_| reader.0.is_empty())
    }

    type Body = (u16, bool, Option<u64>, Vec<(u8, u32)>);

    #[test]
    fn what_is_written_is_read_whatever_the_widths() {
        for wide in [0, 127, 128, 255, 256, 65_535] {
            let list = (0..20).map(|n| (n, u32::MAX >> n)).collect();
            let body: Body = (wide, wide % 2 == 0, Some(u64::from(wide) << 40).filter(|n| *n > 0), list);
            let bytes = rmp_serde::to_vec(&body).unwrap();
            assert_eq!(read::<Body>(&bytes), Some(body));
            assert!((0..bytes.len()).all(|cut| read::<Body>(&bytes[..cut]).is_none()), "cut off");
        }
        assert_eq!(read::<u16>(&[0xcf, 0, 0, 0, 0, 0, 0, 0, 7]), Some(7), "in more bytes than it takes");
    }

    #[test]
    fn fields_of_a_later_version_are_passed_over_in_whatever_form_and_within_the_bytes_that_there_are() {
        assert_eq!(read::<(u8, u8)>(&[0x93, 1, 2, 3]), Some((1, 2)));
        assert_eq!(read::<(u8, u8)>(&[0xdc, 0, 2, 1, 2]), Some((1, 2)), "in more bytes than it takes");
        let deep = (0..100).fold(rmpv::Value::Nil, |inner, _| rmpv::Value::Array(vec![inner]));
        let forms = [
            rmpv::Value::from(-5),
            rmpv::Value::from(-70_000),
            rmpv::Value::from(u64::MAX),
            rmpv::Value::F32(1.5),
            rmpv::Value::F64(1.5),
            rmpv::Value::from("a text"),
            rmpv::Value::from("x".repeat(300)),
            rmpv::Value::Binary(vec![1; 300]),
            rmpv::Value::Ext(7, vec![1; 4]),
            rmpv::Value::Ext(7, vec![1; 5]),
            rmpv::Value::Map(vec![(rmpv::Value::from("key"), rmpv::Value::Array(vec![rmpv::Value::Nil; 20]))]),
            deep,
        ];
        for form in forms {
            let mut bytes = vec![0x93, 1, 2];
            rmpv::encode::write_value(&mut bytes, &form).unwrap();
            assert_eq!(read::<(u8, u8)>(&bytes), Some((1, 2)), "{form}");
            assert!((3..bytes.len()).all(|cut| read::<(u8, u8)>(&bytes[..cut]).is_none()), "{form}, cut off");
        }
        assert_eq!(read::<(u8, u8)>(&[0xdd, 255, 255, 255, 255, 1, 2, 3]), None, "as many as were made up");
        assert_eq!(read::<(u8, u8)>(&[0x93, 1, 2, 0xc6, 255, 255, 255, 255]), None, "as long as was made up");
    }

    #[test]
    fn what_is_written_otherwise_is_refused() {
        assert_eq!(read::<u16>(&[0xce, 0, 1, 0, 0]), None, "too large");
        assert_eq!(read::<u16>(&[0xff]), None, "below zero");
        assert_eq!(read::<(u8, u8)>(&[0x91, 1]), None, "too short");
        assert_eq!(read::<(u8, u8)>(&[0xc4, 2, 1, 2]), None, "bytes are no tuple");
        assert_eq!(read::<Vec<u8>>(&[0xdd, 255, 255, 255, 255, 1]), None, "a length that is made up");
        assert_eq!(read::<f32>(&[0xca, 0, 0, 0, 0]), None, "floats travel as bytes");
    }
}
