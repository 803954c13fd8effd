//! NatNet datagrams: header, requests of a client, description of the server, and a reader of little-endian fields.
//!
//! Layouts and numbers are those of the manufacturer's sample client for direct depacketisation.

/// NatNet message number of a client's request for the server's description; in unicast it also subscribes to frames.
pub(crate) const CONNECT: u16 = 0;
/// NatNet message number of the datagram in which the server describes itself.
pub(crate) const SERVER_INFO: u16 = 1;
/// NatNet message number of a client's request for model definitions, the names and IDs of rigid bodies.
pub(crate) const REQUEST_MODEL: u16 = 4;
/// NatNet message number of model definitions, the names and IDs of rigid bodies.
pub(crate) const MODEL: u16 = 5;
/// NatNet message number of a frame of motion capture data.
pub const FRAME: u16 = 7;
/// NatNet message number of a client's request that renews its subscription at a unicast server.
pub(crate) const KEEP_ALIVE: u16 = 10;

/// Size of a header \[bytes\]: message number and length of the payload.
const HEADER: usize = 4;
/// Size of the name at the start of a server's or client's description \[bytes\].
const NAME: usize = 256;
/// Size of the payload of CONNECT \[bytes\]: name, two versions, and five bytes of options.
const CONNECT_LENGTH: usize = 270;
/// Offset of the requested bitstream version in the payload of CONNECT \[bytes\], as in the manufacturer's sample.
const BITSTREAM: usize = 265;

/// Error of bytes that are not a valid NatNet message: the reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Malformed(pub &'static str);

/// Error of bytes that end within a field.
const TRUNCATED: Malformed = Malformed("a NatNet packet ends too early");

/// Version of an application or of the NatNet format (bitstream): major and minor number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// Major version number: 3 in version 3.1.
    pub major: u8,
    /// Minor version number: 1 in version 3.1.
    pub minor: u8,
}

impl std::fmt::Display for Version {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}

/// Description that a motion capture server sends of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerInfo {
    /// Name of the server's application.
    pub name: String,
    /// Version of the server's application.
    pub version: Version,
    /// NatNet version of the server. In unicast, the server may send an older bitstream on request.
    pub natnet: Version,
    /// Whether the server sends frames by multicast; `None` if the description does not include it.
    pub multicast: Option<bool>,
}

/// Reader of the little-endian fields of a NatNet message. Each method returns an error if the bytes end too early;
/// none panics.
#[derive(Clone, Copy, Debug)]
pub struct Cursor<'a> {
    rest: &'a [u8],
}

impl<'a> Cursor<'a> {
    /// Returns a reader that begins at the first of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Cursor<'a> {
        Cursor { rest: bytes }
    }

    /// Returns the number of bytes that are not yet read.
    pub fn left(&self) -> usize {
        self.rest.len()
    }

    /// Reads the next `count` bytes; an error if fewer are left.
    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or(TRUNCATED)?;
        self.rest = rest;
        Ok(taken)
    }

    /// Skips `count` elements of `size` bytes each; an error if fewer bytes are left.
    pub fn skip(&mut self, count: usize, size: usize) -> Result<(), Malformed> {
        self.bytes(count.checked_mul(size).ok_or(TRUNCATED)?).map(|_| ())
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or(TRUNCATED)?;
        self.rest = rest;
        Ok(*taken)
    }

    /// Reads the next two bytes as a little-endian i16; an error if fewer are left.
    pub fn i16(&mut self) -> Result<i16, Malformed> {
        self.array().map(i16::from_le_bytes)
    }

    /// Reads the next four bytes as a little-endian i32; an error if fewer are left.
    pub fn i32(&mut self) -> Result<i32, Malformed> {
        self.array().map(i32::from_le_bytes)
    }

    /// Reads the next four bytes as a little-endian i32 that is a count. An error if it is negative, or if fewer bytes
    /// are left.
    pub fn count(&mut self) -> Result<usize, Malformed> {
        usize::try_from(self.i32()?).map_err(|_| Malformed("a count in a NatNet packet is negative"))
    }

    /// Reads the next four bytes as a little-endian f32; an error if fewer are left.
    pub fn f32(&mut self) -> Result<f32, Malformed> {
        self.array().map(f32::from_le_bytes)
    }

    /// Reads the next eight bytes as a little-endian f64; an error if fewer are left.
    pub fn f64(&mut self) -> Result<f64, Malformed> {
        self.array().map(f64::from_le_bytes)
    }

    /// Reads N little-endian values of type f32 and converts them to f64; an error if fewer bytes are left.
    pub fn vector<const N: usize>(&mut self) -> Result<[f64; N], Malformed> {
        let mut vector = [0.0; N];
        for number in &mut vector {
            *number = f64::from(self.f32()?);
        }
        Ok(vector)
    }

    /// Reads a text that ends with a zero byte, and returns the bytes before the zero byte; an error if no zero byte
    /// follows.
    pub fn text(&mut self) -> Result<&'a [u8], Malformed> {
        let end = self.rest.iter().position(|byte| *byte == 0).ok_or(TRUNCATED)?;
        let text = self.bytes(end)?;
        self.skip(1, 1)?;
        Ok(text)
    }
}

/// Splits a datagram into the number of its NatNet message type and its payload. Bytes after the payload are ignored.
pub fn split(datagram: &[u8]) -> Result<(u16, &[u8]), Malformed> {
    let mut reader = Cursor::new(datagram);
    let message = u16::from_le_bytes(reader.array()?);
    let length = usize::from(u16::from_le_bytes(reader.array()?));
    Ok((message, reader.bytes(length)?))
}

/// Decodes the payload of a datagram in which the server describes itself (`SERVER_INFO`).
pub fn server_info(payload: &[u8]) -> Result<ServerInfo, Malformed> {
    let mut reader = Cursor::new(payload);
    let name = reader.bytes(NAME)?.split(|byte| *byte == 0).next().unwrap_or_default();
    let [version, natnet] = [reader.array::<4>()?, reader.array()?].map(|[major, minor, ..]| Version { major, minor });
    // Fields since 3.0: clock frequency (u64), data port (u16), whether frames are sent by multicast (u8), group.
    let connection = reader.skip(1, 10).and_then(|()| reader.array::<1>());
    let name = String::from_utf8_lossy(name).into_owned();
    Ok(ServerInfo { name, version, natnet, multicast: connection.ok().map(|[byte]| byte != 0) })
}

/// Returns the datagram of a request without a payload; `message` is the number of the request's message type.
pub fn request(message: u16) -> Vec<u8> {
    let mut datagram = message.to_le_bytes().to_vec();
    datagram.extend(0u16.to_le_bytes());
    datagram
}

/// Returns the datagram of a CONNECT request, which asks the server for its description and for the bitstream (version
/// of the NatNet format) `bitstream`. Servers use the requested bitstream in unicast only.
pub fn connect(bitstream: Version) -> Vec<u8> {
    let mut datagram = CONNECT.to_le_bytes().to_vec();
    datagram.extend((CONNECT_LENGTH as u16).to_le_bytes());
    datagram.resize(HEADER + CONNECT_LENGTH, 0);
    let name = b"Murmurate";
    datagram[HEADER..HEADER + name.len()].copy_from_slice(name);
    let at = HEADER + BITSTREAM;
    datagram[at..at + 2].copy_from_slice(&[bitstream.major, bitstream.minor]);
    datagram
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_connect_names_the_bitstream_where_servers_look_for_it() {
        let datagram = connect(Version { major: 4, minor: 1 });
        let (message, payload) = split(&datagram).unwrap();
        assert_eq!((message, payload.len()), (CONNECT, 270));
        assert_eq!((payload[264], &payload[265..269]), (0, &[4, 1, 0, 0][..]));
    }

    #[test]
    fn a_description_is_read_with_and_without_its_connection() {
        let mut payload = vec![0; 279];
        payload[..6].copy_from_slice(b"Motive");
        payload[256..264].copy_from_slice(&[3, 1, 0, 0, 4, 1, 0, 0]);
        payload[274] = 1;
        let info = server_info(&payload).unwrap();
        assert_eq!((info.name.as_str(), info.version.to_string()), ("Motive", "3.1".to_owned()));
        assert_eq!((info.natnet, info.multicast), (Version { major: 4, minor: 1 }, Some(true)));
        assert_eq!(server_info(&payload[..264]).unwrap().multicast, None);
        (0..264).for_each(|length| assert!(server_info(&payload[..length]).is_err()));
    }
}
