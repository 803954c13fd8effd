//! Packets between the RoboMaster driver, which does no I/O, and its worker, encoded as bytes so that they can be
//! recorded and replayed.

use murmurate::edge::Packet;
pub use murmurate::edge::hold::Hold;

/// Packet from the RoboMaster driver to its worker. The worker numbers its connections with the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToWorker<'a> {
    /// Open a new connection. The old one is closed once the new one is open.
    Open,
    /// Write a line to the robot, if the connection is still the current one. An empty line only sets the validity.
    Write {
        /// Number of the connection to which the line belongs.
        connection: u32,
        /// Validity of the robot's motion after the line.
        hold: Hold,
        /// Text of the line, with the semicolon at its end.
        line: &'a str,
    },
}

/// Packet from the RoboMaster driver's worker to the driver. Connections with the robot are numbered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FromWorker<'a> {
    /// The connection with this number was opened.
    Opened(u32),
    /// The connection with this number could not be opened, or has ended. The bytes are the reason as text.
    Closed(u32, &'a [u8]),
    /// Bytes received on the control connection (answers), with the number of the connection.
    Control(u32, &'a [u8]),
    /// Bytes received on the event connection, with the number of the connection.
    Event(u32, &'a [u8]),
    /// Datagram with the robot's state (a push): its arrival time \[ns\], on the worker's clock, and its content.
    Push(u64, &'a [u8]),
}

impl ToWorker<'_> {
    /// Returns the packet to the worker as bytes.
    pub fn encode(&self) -> Packet {
        match self {
            ToWorker::Open => Box::new([b'O']),
            ToWorker::Write { connection, hold, line } => {
                [b"W", &connection.to_le_bytes()[..], &hold.to_bytes(), line.as_bytes()].concat().into()
            }
        }
    }

    /// Decodes a packet to the worker; `None` if the bytes are not one.
    pub fn decode(packet: &[u8]) -> Option<ToWorker<'_>> {
        match packet {
            [b'O'] => Some(ToWorker::Open),
            [b'W', rest @ ..] => {
                let (connection, rest) = rest.split_first_chunk()?;
                let (hold, line) = rest.split_first_chunk()?;
                let hold = Hold::from_bytes(*hold);
                let line = std::str::from_utf8(line).ok()?;
                Some(ToWorker::Write { connection: u32::from_le_bytes(*connection), hold, line })
            }
            _ => None,
        }
    }
}

impl FromWorker<'_> {
    /// Returns the packet of the worker as bytes.
    pub fn encode(&self) -> Packet {
        let numbered = |tag: u8, connection: &u32, bytes: &[u8]| {
            Packet::from([&[tag], &connection.to_le_bytes()[..], bytes].concat())
        };
        match self {
            FromWorker::Opened(connection) => numbered(b'O', connection, &[]),
            FromWorker::Closed(connection, why) => numbered(b'X', connection, why),
            FromWorker::Control(connection, bytes) => numbered(b'C', connection, bytes),
            FromWorker::Event(connection, bytes) => numbered(b'E', connection, bytes),
            FromWorker::Push(stamp, bytes) => [b"P", &stamp.to_le_bytes()[..], bytes].concat().into(),
        }
    }

    /// Decodes a packet of the worker; `None` if the bytes are not one.
    pub fn decode(packet: &[u8]) -> Option<FromWorker<'_>> {
        let (tag, rest) = packet.split_first()?;
        if *tag == b'P' {
            let (stamp, bytes) = rest.split_first_chunk()?;
            return Some(FromWorker::Push(u64::from_le_bytes(*stamp), bytes));
        }
        let (connection, bytes) = rest.split_first_chunk()?;
        let connection = u32::from_le_bytes(*connection);
        match tag {
            b'O' if bytes.is_empty() => Some(FromWorker::Opened(connection)),
            b'X' => Some(FromWorker::Closed(connection, bytes)),
            b'C' => Some(FromWorker::Control(connection, bytes)),
            b'E' => Some(FromWorker::Event(connection, bytes)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::time::Span;

    #[test]
    fn packets_are_read_back_and_cut_ones_are_refused() {
        let line = "quit seq 7;";
        for hold in [Hold::Keep, Hold::Standing, Hold::For(Span::from_millis(200))] {
            let packet = ToWorker::Write { connection: 9, hold, line };
            let bytes = packet.encode();
            assert_eq!(ToWorker::decode(&bytes), Some(packet));
            (0..13).for_each(|cut| assert_eq!(ToWorker::decode(&bytes[..cut]), None, "{cut}"));
        }
        assert_eq!(ToWorker::decode(&ToWorker::Open.encode()), Some(ToWorker::Open));
        let bytes = b"ok;";
        for packet in [
            FromWorker::Opened(1),
            FromWorker::Closed(u32::MAX, b"refuses TCP port 40923"),
            FromWorker::Control(3, bytes),
            FromWorker::Event(4, bytes),
            FromWorker::Push(5, bytes),
        ] {
            let bytes = packet.encode();
            assert_eq!(FromWorker::decode(&bytes), Some(packet));
            (0..5).for_each(|cut| assert_eq!(FromWorker::decode(&bytes[..cut]), None, "{cut}"));
        }
        assert_eq!(FromWorker::decode(b"Z1234"), None);
    }
}
