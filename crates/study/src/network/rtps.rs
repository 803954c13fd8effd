//! Station of a network study with RTPS as Fast DDS 2.9 speaks it: one writer (`rtps_writer`), one reader
//! (`rtps_reader`) and announcements. Reliable by OMG DDSI-RTPS 2.5, section 8.4, or best effort.
//!
//! Fragmentation, liveliness and the first phase of discovery are not modelled: all stations know each other.
//! `docs/evidence/lab.md` holds this imitation against Fast DDS on the same channel.

use super::case::{Addressing, History, ReliabilityMode};
use super::endpoint::{Output, StationProtocol};
use super::rtps_packet::Packet;
use super::rtps_reader::RtpsReader;
use super::rtps_writer::RtpsWriter;
use murmurate::time::{Span, Time};

/// Period of a participant's announcements (SPDP, 8.5.3), which go to each known participant by unicast and to all by
/// multicast: `leaseDuration_announcementperiod` of Fast DDS.
pub const ANNOUNCEMENT_PERIOD: Span = Span::from_millis(3000);

/// Station of a network study that uses RTPS.
pub struct Rtps {
    writer: RtpsWriter,
    reader: RtpsReader,
    others: Vec<u16>,
    /// Time of the next announcement.
    announcement: Time,
}

impl Rtps {
    /// Returns the station with the index `station` of `stations` stations, for messages of `payload` bytes.
    /// `reliability` is `Ack` or `AckOff` (reliable, with or without positive acknowledgements) or `BestEffort`;
    /// `history` are the samples that its writer and its reader keep. It announces itself at `announcement` and then
    /// in every period.
    pub fn new(
        (station, stations): (u16, u16),
        payload: usize,
        addressing: Addressing,
        qos: (ReliabilityMode, History),
        announcement: Time,
    ) -> Rtps {
        let others = || (0..stations).filter(move |other| *other != station);
        Rtps {
            writer: RtpsWriter::new(station, others(), payload, addressing, qos),
            reader: RtpsReader::new(station, others(), qos),
            others: others().collect(),
            announcement,
        }
    }
}

impl StationProtocol for Rtps {
    type Packet = Packet;

    fn publish(&mut self, now: Time, sequence: u32, out: &mut Vec<Output<Packet>>) {
        self.writer.publish(now, sequence, out);
    }

    fn receive(&mut self, now: Time, packet: &Packet, out: &mut Vec<Output<Packet>>) {
        match packet {
            Packet::Data(writer, samples) => {
                samples.iter().for_each(|sample| self.reader.receive_sample(*writer, *sample, out));
            }
            Packet::Heartbeat(writer, holds) => self.reader.receive_heartbeat(now, *writer, *holds, out),
            Packet::AckNack { reader, base, missing } => self.writer.receive_acknack(now, *reader, (*base, missing)),
            Packet::Announcement => {}
        }
    }

    fn wake_at(&self) -> Option<Time> {
        [self.reader.wake_at(), self.writer.wake_at(), Some(self.announcement)].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Output<Packet>>) {
        self.reader.wake(now, out);
        self.writer.wake(now, out);
        if self.announcement <= now {
            self.announcement = now + ANNOUNCEMENT_PERIOD;
            let (bytes, packet) = (Packet::Announcement.bytes(0), Packet::Announcement);
            let each = self.others.iter().map(|&to| Output::Send { to: Some(to), bytes, packet: packet.clone() });
            out.extend(each);
            out.push(Output::Multicast { bytes, packet });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::rtps_packet::INFO_DST;
    use super::*;

    fn station(station: u16, addressing: Addressing, history: History) -> Rtps {
        Rtps::new((station, 3), 152, addressing, (ReliabilityMode::Ack, history), Time::MAX)
    }

    fn ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn heard(outputs: &mut Vec<Output<Packet>>) -> Vec<u32> {
        let deliveries = outputs.extract_if(.., |output| matches!(output, Output::Deliver { .. }));
        deliveries.map(|output| if let Output::Deliver { sequence, .. } = output { sequence } else { 0 }).collect()
    }

    /// Returns receiver (`None` for all by multicast), length and content of each datagram.
    fn sent(outputs: &mut Vec<Output<Packet>>) -> Vec<(Option<u16>, usize, Packet)> {
        let sent = |output| match output {
            Output::Send { to, bytes, packet } => Some((to, bytes, packet)),
            Output::Multicast { bytes, packet } => Some((None, bytes, packet)),
            Output::Deliver { .. } => None,
        };
        outputs.drain(..).filter_map(sent).collect()
    }

    #[test]
    fn a_sample_and_a_heartbeat_have_the_lengths_of_fast_dds_and_the_heartbeat_waits_for_a_full_history() {
        let mut writer = station(0, Addressing::Multicast, History::Last(3));
        let mut outputs = Vec::new();
        let mut lengths = Vec::new();
        for sequence in 0..4 {
            writer.publish(ms(0), sequence, &mut outputs);
            lengths.push(sent(&mut outputs).iter().map(|(_, bytes, _)| *bytes).collect::<Vec<_>>());
        }
        assert_eq!(lengths, [vec![272], vec![272], vec![272, 112], vec![272, 112]], "as captured from the real one");
        let asks = Packet::AckNack { reader: 1, base: 1, missing: vec![1] };
        assert_eq!(asks.bytes(152) + INFO_DST, 128);
    }

    #[test]
    fn a_requested_sample_goes_to_all_once_and_a_later_one_waits_for_it() {
        for addressing in [Addressing::Multicast, Addressing::Unicast] {
            let mut writer = station(0, addressing, History::Last(2));
            let mut reader = station(1, addressing, History::Last(2));
            let mut outputs = Vec::new();
            writer.publish(ms(0), 0, &mut outputs);
            writer.publish(ms(1), 1, &mut outputs);
            let packets: Vec<Packet> = sent(&mut outputs).into_iter().map(|(.., packet)| packet).collect();
            let second = packets.iter().find(|packet| matches!(packet, Packet::Data(0, all) if all[0].0 == 1)).unwrap();
            reader.receive(ms(2), second, &mut outputs);
            reader.receive(ms(2), packets.last().unwrap(), &mut outputs);
            assert!(heard(&mut outputs).is_empty(), "the first one is missing");
            assert_eq!(reader.wake_at(), Some(ms(7)));
            reader.wake(ms(7), &mut outputs);
            let [(Some(0), _, asks)] = &sent(&mut outputs)[..] else { panic!("one ACKNACK") };
            assert!(matches!(asks, Packet::AckNack { reader: 1, base: 0, missing } if missing == &[0]), "{asks:?}");
            let also = Packet::AckNack { reader: 2, base: 0, missing: vec![0, 1] };
            writer.receive(ms(8), asks, &mut outputs);
            writer.receive(ms(9), &also, &mut outputs);
            assert_eq!(writer.wake_at(), Some(ms(13)), "one timer for all readers");
            writer.wake(ms(13), &mut outputs);
            let repairs = sent(&mut outputs);
            let kinds: Vec<String> = repairs
                .iter()
                .map(|(to, _, packet)| match packet {
                    Packet::Data(_, samples) => format!("{to:?} data {}", samples[0].0),
                    other => {
                        format!("{to:?} {}", if matches!(other, Packet::Heartbeat(..)) { "heartbeat" } else { "?" })
                    }
                })
                .collect();
            let expected: &[&str] = match addressing {
                Addressing::Multicast => &["None data 0", "None heartbeat", "None data 1", "None heartbeat"],
                Addressing::Unicast => &[
                    "Some(1) data 0",
                    "Some(2) data 0",
                    "Some(1) heartbeat",
                    "Some(2) heartbeat",
                    "Some(2) data 1",
                    "Some(1) heartbeat",
                    "Some(2) heartbeat",
                ],
            };
            assert_eq!(kinds, expected);
            reader.receive(ms(14), &repairs[0].2, &mut outputs);
            assert_eq!(heard(&mut outputs), [0, 1], "in order");
        }
    }

    #[test]
    fn a_reader_does_not_wait_for_samples_that_are_no_longer_kept_and_the_writer_does_not_answer_for_them() {
        let mut writer = station(0, Addressing::Multicast, History::Last(1));
        let mut reader = station(1, Addressing::Multicast, History::Last(1));
        let mut outputs = Vec::new();
        writer.publish(Time::ZERO, 0, &mut outputs);
        writer.publish(Time::ZERO, 1, &mut outputs);
        let packets = sent(&mut outputs);
        reader.receive(Time::ZERO, &packets[2].2, &mut outputs);
        assert!(heard(&mut outputs).is_empty(), "the heartbeat has not come yet");
        reader.receive(Time::ZERO, &packets[3].2, &mut outputs);
        assert_eq!(heard(&mut outputs), [1]);
        writer.receive(ms(1), &Packet::AckNack { reader: 1, base: 0, missing: vec![0] }, &mut outputs);
        assert_eq!(writer.wake_at(), Some(ms(3000)), "the periodic heartbeat alone");
    }

    #[test]
    fn a_waiting_sample_gives_way_to_a_newer_one_of_another_writer() {
        let mut reader = station(2, Addressing::Multicast, History::Last(1));
        let mut outputs = Vec::new();
        reader.receive(ms(1), &Packet::Data(0, vec![(1, ms(0))]), &mut outputs);
        reader.receive(ms(2), &Packet::Data(1, vec![(0, ms(1))]), &mut outputs);
        reader.receive(ms(3), &Packet::Heartbeat(0, (1, 2)), &mut outputs);
        assert_eq!(heard(&mut outputs), [0], "KEEP_LAST 1 is for all writers together");
    }

    #[test]
    fn samples_that_all_readers_have_acknowledged_are_kept_no_longer() {
        let mut writer = station(0, Addressing::Multicast, History::Last(2));
        let mut outputs = Vec::new();
        writer.publish(ms(0), 0, &mut outputs);
        for reader in [1, 2] {
            writer.receive(ms(1), &Packet::AckNack { reader, base: 1, missing: vec![] }, &mut outputs);
        }
        outputs.clear();
        writer.publish(ms(2), 1, &mut outputs);
        assert_eq!(sent(&mut outputs).len(), 1, "the history is not full");
        writer.wake(ms(3000), &mut outputs);
        let [(None, 112, Packet::Heartbeat(0, (1, 2)))] = sent(&mut outputs)[..] else { panic!("a heartbeat") };
    }

    #[test]
    fn with_all_samples_kept_a_heartbeat_follows_once_a_send_buffer_was_sent() {
        let mut writer = station(0, Addressing::Multicast, History::All);
        let mut outputs = Vec::new();
        (0..1200).for_each(|sequence| writer.publish(ms(0), sequence, &mut outputs));
        let all = sent(&mut outputs);
        assert_eq!(all.len(), 1201);
        // 212 992 bytes are 1109 samples of 192 bytes, with INFO_TS and without the header.
        assert!(matches!(all[1110].2, Packet::Heartbeat(0, (0, 1110))), "{:?}", all[1110]);
    }

    #[test]
    fn a_participant_announces_itself_to_each_other_and_to_the_group() {
        let qos = (ReliabilityMode::BestEffort, History::Last(1));
        let mut station = Rtps::new((0, 3), 152, Addressing::Unicast, qos, ms(3));
        let mut outputs = Vec::new();
        assert_eq!(station.wake_at(), Some(ms(3)));
        station.wake(ms(3), &mut outputs);
        let all: Vec<_> = sent(&mut outputs).into_iter().map(|(to, bytes, _)| (to, bytes)).collect();
        assert_eq!(all, [(Some(1), 456), (Some(2), 456), (None, 456)]);
        assert_eq!(station.wake_at(), Some(ms(3003)));
    }
}
