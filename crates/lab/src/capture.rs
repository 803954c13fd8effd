//! Transmissions as a capture file: pcap with radiotap headers (<https://www.radiotap.org>), as a monitor of the
//! channel sees them. Wireshark, tshark and tcpdump read it.
//!
//! A frame is a QoS data frame of IEEE 802.11 with the payload of the Ethernet frame behind LLC and SNAP headers (RFC
//! 1042), without a check sequence. A frame that has collided is marked as one whose check sequence is wrong.
//! Acknowledgements and frames of other networks are not in it.

use super::ethernet::{self, HEADER_BYTES, Mac};
use super::medium::EthernetFrame;
use murmurate::net::media::radio::channel::Transmission;
use murmurate::net::media::radio::{Band, Destination, Radio, Topology, Width};
use std::sync::Arc;

/// Link type of IEEE 802.11 with radiotap headers: LINKTYPE_IEEE802_11_RADIOTAP.
const LINK_TYPE: u32 = 127;
/// Magic number of pcap with times in nanoseconds.
const MAGIC_NS: u32 = 0xa1b2_3c4d;
/// Longest packet that a file may hold \[bytes\].
const SNAP_BYTES: u32 = 4096;

// Bits of the radiotap header's field of present fields, in the order of the fields.
const TSFT: u32 = 1 << 0;
const FLAGS: u32 = 1 << 1;
const RATE: u32 = 1 << 2;
const CHANNEL: u32 = 1 << 3;
const MCS: u32 = 1 << 19;
/// Flag of a frame whose check sequence is wrong.
const BAD_FCS: u8 = 0x40;

// Flags of a channel.
const OFDM: u16 = 0x0040;
const CCK: u16 = 0x0020;
const GHZ_2: u16 = 0x0080;
const GHZ_5: u16 = 0x0100;

/// Encoder of transmissions as records of a pcap file.
#[derive(Clone, Debug)]
pub struct Capture {
    radio: Radio,
    /// Time of the laboratory's start \[ns since 1970\].
    began_ns: u64,
}

impl Capture {
    /// Returns an encoder for a channel with the parameters `radio`. `began_ns` is the time of the laboratory's start
    /// \[ns since 1970\].
    pub fn new(radio: &Radio, began_ns: u64) -> Capture {
        Capture { radio: radio.clone(), began_ns }
    }

    /// Returns the beginning of a capture file.
    pub fn header() -> Vec<u8> {
        let mut bytes = MAGIC_NS.to_le_bytes().to_vec();
        // Version 2.4; time zone and accuracy are zero.
        bytes.extend([2, 0, 4, 0]);
        for number in [0, 0, SNAP_BYTES, LINK_TYPE] {
            bytes.extend(number.to_le_bytes());
        }
        bytes
    }

    /// Appends a transmission as a record to `out`.
    pub fn append(&self, sent: &Transmission<Arc<EthernetFrame>>, out: &mut Vec<u8>) {
        let mut packet = self.radiotap(sent);
        self.mac_header(sent, &mut packet);
        let frame = &sent.token.bytes;
        // LLC and SNAP; the type of Ethernet follows with the payload.
        packet.extend([0xaa, 0xaa, 0x03, 0, 0, 0]);
        packet.extend(&frame[HEADER_BYTES - 2..]);
        // A monitor stamps the end of a frame.
        let at = self.began_ns + sent.until.as_nanos();
        for number in [at / 1_000_000_000, at % 1_000_000_000, packet.len() as u64, packet.len() as u64] {
            out.extend((number as u32).to_le_bytes());
        }
        out.extend(packet);
    }

    fn radiotap(&self, sent: &Transmission<Arc<EthernetFrame>>) -> Vec<u8> {
        let radio = &self.radio;
        let rate = if sent.unicast { radio.rate } else { radio.basic_rate };
        let name = rate.to_string();
        let (family, number) = name.split_once('-').unwrap_or((&name, ""));
        let mcs = name.strip_prefix("ht-mcs").and_then(|index| index.parse::<u8>().ok());
        let (mhz, band): (u16, u16) = match radio.band {
            Band::Low => (2437, GHZ_2),
            Band::High => (5180, GHZ_5),
        };
        let kind = if family == "ofdm" || mcs.is_some() { OFDM } else { CCK };
        let flags = if sent.collided { BAD_FCS } else { 0 };
        let present = TSFT | FLAGS | CHANNEL | if mcs.is_some() { MCS } else { RATE };
        let mut body = Vec::new();
        // TSFT is the time at which the frame's first bit arrived at the MAC [us].
        body.extend((sent.since.as_nanos() / 1000).to_le_bytes());
        // Without MCS, the rate takes the byte that would otherwise align the channel.
        let half_mbit = number.parse::<f64>().map_or(0, |mbit| (2.0 * mbit).round() as u8);
        body.extend([flags, if mcs.is_some() { 0 } else { half_mbit }]);
        body.extend(mhz.to_le_bytes());
        body.extend((kind | band).to_le_bytes());
        if let Some(mcs) = mcs {
            // Known: bandwidth, index, guard interval, all of which follow.
            let wide = u8::from(radio.width_mhz == Width::Double);
            body.extend([0x07, wide, mcs]);
        }
        let length = 8 + body.len() as u16;
        let mut header = vec![0, 0];
        header.extend(length.to_le_bytes());
        header.extend(present.to_le_bytes());
        header.extend(body);
        header
    }

    fn mac_header(&self, sent: &Transmission<Arc<EthernetFrame>>, out: &mut Vec<u8>) {
        let frame = &sent.token.bytes;
        let mac = |at: usize| -> Mac { frame[at..at + 6].try_into().expect("the medium takes no shorter frames") };
        let (to, from) = (mac(0), mac(6));
        let bssid = ethernet::access_point();
        let infrastructure = self.radio.channel == Topology::Infrastructure;
        let downlink = infrastructure && sent.by != sent.from;
        // Bits of distribution system, and addresses by IEEE 802.11-2016, Table 9-26.
        let (system, addresses) = match (infrastructure, downlink) {
            (false, _) => (0, [to, from, bssid]),
            (true, false) => (1, [bssid, from, to]),
            (true, true) => (2, [to, bssid, from]),
        };
        let retry = if sent.retry > 0 { 0x08 } else { 0 };
        // A data frame with QoS.
        out.extend([0x88, system | retry]);
        let answer_us = (self.radio.times().acknowledged.as_nanos() / 1000) as u16;
        out.extend(if sent.unicast { answer_us } else { 0 }.to_le_bytes());
        addresses.iter().for_each(|address| out.extend(address));
        // Sequence number of 12 bits behind a fragment number of 4; QoS with the policy «no acknowledgement» for
        // groups.
        out.extend((((sent.token.number & 0xfff) as u16) << 4).to_le_bytes());
        out.extend(if matches!(sent.to, Destination::One(_)) { [0, 0] } else { [0x20, 0] });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::time::Time;

    fn sent(unicast: bool, by: u16) -> Transmission<Arc<EthernetFrame>> {
        let bytes = [&ethernet::station(1)[..], &ethernet::station(0), &[8, 0], &[9; 20]].concat();
        Transmission {
            since: Time::from_nanos(2_000_000),
            until: Time::from_nanos(2_500_000),
            by,
            from: 0,
            to: Destination::One(1),
            unicast,
            retry: 1,
            collided: true,
            token: Arc::new(EthernetFrame { number: 3, taken: Time::ZERO, bytes: bytes.into() }),
        }
    }

    #[test]
    fn a_record_has_a_radiotap_header_and_a_data_frame() {
        let capture = Capture::new(&Radio::default(), 5_000_000_000);
        let mut out = Vec::new();
        capture.append(&sent(true, 0), &mut out);
        let word = |at: usize| u32::from_le_bytes(out[at..at + 4].try_into().unwrap());
        assert_eq!((word(0), word(4)), (5, 2_500_000), "stamped with its end");
        let packet = &out[16..];
        assert_eq!((word(8) as usize, word(12) as usize), (packet.len(), packet.len()));
        let radiotap = usize::from(packet[2]);
        assert_eq!((radiotap, packet[4]), (22, 0x0f));
        assert_eq!(packet[16..18], [BAD_FCS, 108], "54 Mbit/s are 108 halves");
        let frame = &packet[radiotap..];
        assert_eq!(frame[..2], [0x88, 0x09], "QoS data to the access point, a retry");
        assert_eq!(frame[4..10], ethernet::access_point());
        assert_eq!(frame[16..22], ethernet::station(1));
        assert_eq!(frame[22..26], [0x30, 0, 0, 0]);
        assert_eq!(frame[26..34], [0xaa, 0xaa, 3, 0, 0, 0, 8, 0]);
        assert_eq!(frame[34..], [9; 20]);
        assert_eq!(Capture::header().len(), 24);
    }

    #[test]
    fn a_high_throughput_rate_has_its_own_field() {
        let radio = Radio::preset("wifi-n").unwrap();
        let mut out = Vec::new();
        Capture::new(&radio, 0).append(&sent(true, 2), &mut out);
        let packet = &out[16..];
        assert_eq!(usize::from(packet[2]), 25);
        assert_eq!(packet[22..25], [0x07, 0, 7]);
        assert_eq!(packet[25..27], [0x88, 0x0a], "from the access point");
    }
}
