//! Ethernet frames of a laboratory: hardware addresses of the stations, and where a frame goes.

/// Length of the header of an Ethernet frame: two addresses and a type \[bytes\].
pub const HEADER_BYTES: usize = 14;
/// Longest Ethernet frame without a check sequence (IEEE 802.3, 3.2.7) \[bytes\].
pub const MAX_FRAME_BYTES: usize = HEADER_BYTES + 1500;
/// Bytes of the headers of IPv4 and UDP, which a radio's `overhead_bytes` contains \[bytes\].
const IP_AND_UDP_BYTES: usize = 20 + 8;
/// Beginning of every hardware address of a laboratory: locally administered (IEEE 802, 8.4).
const PREFIX: [u8; 4] = [0x02, 0x4d, 0x75, 0x00];
/// Number of the access point in its address.
const ACCESS_POINT: u16 = 0xffff;

/// Hardware address of a network interface.
pub type Mac = [u8; 6];

/// Returns the hardware address of a station's interface.
pub fn station(number: u16) -> Mac {
    let [high, low] = number.to_be_bytes();
    [PREFIX[0], PREFIX[1], PREFIX[2], PREFIX[3], high, low]
}

/// Returns the hardware address of the access point, which is also the identifier of the network (BSSID).
pub fn access_point() -> Mac {
    station(ACCESS_POINT)
}

/// Returns a hardware address as text, such as `02:4d:75:00:00:01`.
pub fn text(mac: Mac) -> String {
    mac.map(|byte| format!("{byte:02x}")).join(":")
}

/// Receivers that the destination address of an Ethernet frame names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Addressee {
    /// The station with this number.
    Station(u16),
    /// All stations: the address is that of a group, or the broadcast address.
    Group,
    /// None of the laboratory's stations.
    Unknown,
}

/// Returns where an Ethernet frame goes among `stations` stations; `None` if it is too short or too long for one.
pub fn addressee(frame: &[u8], stations: u16) -> Option<Addressee> {
    if !(HEADER_BYTES..=MAX_FRAME_BYTES).contains(&frame.len()) {
        return None;
    }
    if frame[0] & 1 == 1 {
        return Some(Addressee::Group);
    }
    let number = u16::from_be_bytes([frame[4], frame[5]]);
    let known = frame.starts_with(&PREFIX) && number < stations;
    Some(if known { Addressee::Station(number) } else { Addressee::Unknown })
}

/// Returns the length of the datagram in an Ethernet frame, as the radio channel counts it: what follows the headers of
/// Ethernet, IPv4 and UDP, in place of which a radio's `overhead_bytes` are transmitted. A packet of another protocol
/// thus has its true length on the air, too, unless it is shorter than those headers.
pub fn datagram_bytes(frame: &[u8]) -> usize {
    frame.len().saturating_sub(HEADER_BYTES + IP_AND_UDP_BYTES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_destination_is_a_station_a_group_or_unknown() {
        let to = |mac: Mac| [&mac[..], &[0; 8]].concat();
        assert_eq!(addressee(&to(station(2)), 3), Some(Addressee::Station(2)));
        assert_eq!(addressee(&to(station(3)), 3), Some(Addressee::Unknown));
        assert_eq!(addressee(&to([0x01, 0x00, 0x5e, 0, 0, 1]), 3), Some(Addressee::Group));
        assert_eq!(addressee(&to([0xff; 6]), 3), Some(Addressee::Group));
        assert_eq!(addressee(&to([0x52, 0x54, 0, 0, 0, 1]), 3), Some(Addressee::Unknown));
        assert_eq!(addressee(&[0; 13], 3), None);
        assert_eq!(addressee(&[0; MAX_FRAME_BYTES + 1], 3), None);
        assert_eq!(text(station(258)), "02:4d:75:00:01:02");
    }

    #[test]
    fn a_udp_datagram_has_the_length_of_its_payload() {
        assert_eq!(datagram_bytes(&[0; 14 + 28 + 152]), 152);
        assert_eq!(datagram_bytes(&[0; 42]), 0, "a request of address resolution has 28 bytes after the header");
    }
}
