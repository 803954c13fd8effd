//! Packets of CRTP: one byte with port and channel, and up to 30 bytes of data.

/// Most bytes of data of a packet, by the firmware's buffers.
pub const MOST_DATA: usize = 30;

/// Ports of the firmware that this driver uses.
pub mod port {
    /// Parameters: table of contents, values.
    pub const PARAM: u8 = 2;
    /// Log variables: table of contents, blocks, their data.
    pub const LOG: u8 = 5;
    /// Poses from outside, for the robot's estimator.
    pub const LOCALIZATION: u8 = 6;
    /// Setpoints of the low-level commander.
    pub const SETPOINT: u8 = 7;
    /// Orders to the high-level commander.
    pub const HIGH_LEVEL: u8 = 8;
    /// Supervisor: arming, emergency stop; since protocol version 12.
    pub const SUPERVISOR: u8 = 9;
    /// Platform: protocol version, arming before protocol version 12.
    pub const PLATFORM: u8 = 13;
}

/// Packet between a host and a Crazyflie.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Port of the firmware, 0 to 15.
    pub port: u8,
    /// Channel of the port, 0 to 3.
    pub channel: u8,
    /// Content, at most [`MOST_DATA`] bytes.
    pub data: Vec<u8>,
}

impl Packet {
    /// Makes a packet for a channel of a port.
    pub fn new(port: u8, channel: u8, data: impl Into<Vec<u8>>) -> Packet {
        Packet { port, channel, data: data.into() }
    }

    /// Returns the packet as bytes. Two bits of the first byte are set for the bootloader of old firmware.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(1 + self.data.len());
        bytes.push((self.port & 0x0f) << 4 | 0x0c | (self.channel & 0x03));
        bytes.extend(&self.data);
        bytes
    }

    /// Decodes a packet; `None` if it is empty or too long.
    pub fn decode(bytes: &[u8]) -> Option<Packet> {
        let (header, data) = bytes.split_first().filter(|(_, data)| data.len() <= MOST_DATA)?;
        Some(Packet::new(header >> 4, header & 0x03, data))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_packet_is_read_back_and_longer_ones_are_refused() {
        for (port, channel) in (0..16).flat_map(|port| (0..4).map(move |channel| (port, channel))) {
            for length in [0, 1, MOST_DATA] {
                let packet = Packet::new(port, channel, vec![7; length]);
                let bytes = packet.encode();
                assert_eq!((Packet::decode(&bytes), bytes[0] & 0x0c), (Some(packet), 0x0c));
            }
        }
        assert_eq!((Packet::decode(&[]), Packet::decode(&[0; MOST_DATA + 2])), (None, None));
    }
}
