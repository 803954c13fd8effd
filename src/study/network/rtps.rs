//! Station of a network study with the reliable mode of RTPS: OMG DDSI-RTPS 2.5, section 8.4, one stateful writer
//! (8.4.9), and a stateful reader (8.4.12) for each other station. Where the standard leaves a choice, it is that of
//! Fast DDS.
//!
//! Every sample carries a heartbeat, as in Fast DDS once the writer's history is full. A reader answers a heartbeat
//! with an ACKNACK after `heartbeatResponseDelay`. The writer retransmits requested samples to the reader after
//! `nackResponseDelay`; a GAP declares samples irrelevant that it no longer keeps. Readers deliver samples in order
//! (8.7.2.2.1, reliable). Discovery, fragmentation and liveliness are not modelled.

use std::collections::{BTreeMap, BTreeSet};

use super::case::{History, ReliabilityMode};
use super::endpoint::{Endpoint, Output};
use crate::time::{Span, Time};

/// `heartbeatPeriod` of Fast DDS.
const HEARTBEAT_PERIOD: Span = Span::from_millis(3000);
/// `nackResponseDelay` of Fast DDS; the standard has 200 ms (8.4.7.1.1).
const NACK_RESPONSE_DELAY: Span = Span::from_millis(5);
/// `heartbeatResponseDelay` of Fast DDS; the standard has 500 ms (8.4.10.1.1).
const HEARTBEAT_RESPONSE_DELAY: Span = Span::from_millis(5);
/// Largest size of the `SequenceNumberSet` of one ACKNACK or GAP (9.4.2.6).
const MOST_NAMED: usize = 256;

/// Length of the RTPS header \[bytes\] (9.4.4). The following constants are lengths of submessages with their
/// 4-byte headers (9.4.5): DATA includes the encapsulation of 4 bytes (10.2) and excludes the payload; ACKNACK and GAP
/// exclude their bitmaps.
const HEADER: usize = 20;
const INFO_TS: usize = 12;
const INFO_DST: usize = 16;
const DATA: usize = 24 + 4;
const HEARTBEAT: usize = 32;
const ACKNACK: usize = 28;
const GAP: usize = 32;

/// Range of sequence numbers of the samples that an RTPS writer keeps for retransmission: the first, and the one
/// after the last.
pub type Holds = (u32, u32);

/// RTPS message of a station in a network study.
#[derive(Clone, Debug)]
pub enum Packet {
    /// DATA with a HEARTBEAT: index of the writing station, sequence number of the sample, and the range of samples
    /// that the writer keeps.
    Data(u16, u32, Holds),
    /// HEARTBEAT without DATA, or GAP: index of the writing station, and the range of samples that it keeps.
    Heartbeat(u16, Holds),
    /// ACKNACK: index of the reading station, sequence number below which it has all samples, and sequence numbers
    /// that it requests.
    AckNack(u16, u32, Vec<u32>),
}

/// State that an RTPS writer keeps of one reader.
#[derive(Clone, Debug, Default)]
struct ReaderProxy {
    /// Sequence number below which the reader has acknowledged all samples.
    acked: u32,
    requested: BTreeSet<u32>,
    due: Option<Time>,
}

/// State that an RTPS reader keeps of one writer.
#[derive(Clone, Debug, Default)]
struct WriterProxy {
    /// Next sequence number to deliver.
    next: u32,
    /// Sequence numbers received out of order.
    waiting: BTreeSet<u32>,
    /// Largest sequence number that the writer has announced.
    last: Option<u32>,
    /// Time at which the next ACKNACK is due; `None` if none is.
    due: Option<Time>,
}

/// Station of a network study that uses the reliable mode of RTPS.
pub struct Rtps {
    station: u16,
    payload: usize,
    positive: bool,
    history: History,
    /// Range of sequence numbers that the writer keeps, from `first` to below `end`.
    first: u32,
    end: u32,
    readers: BTreeMap<u16, ReaderProxy>,
    writers: BTreeMap<u16, WriterProxy>,
    heartbeat: Option<Time>,
}

impl Rtps {
    /// Returns the station with the index `station` of `stations` stations, for messages of `payload` bytes.
    /// `reliability` is `Ack` or `AckOff` (with or without positive acknowledgements); `history` are the samples that
    /// its writer keeps.
    pub fn new(station: u16, stations: u16, payload: usize, reliability: ReliabilityMode, history: History) -> Rtps {
        let others = || (0..stations).filter(move |other| *other != station);
        Rtps {
            station,
            payload,
            positive: reliability == ReliabilityMode::Ack,
            history,
            first: 0,
            end: 0,
            readers: others().map(|other| (other, ReaderProxy::default())).collect(),
            writers: others().map(|other| (other, WriterProxy::default())).collect(),
            heartbeat: None,
        }
    }

    fn data(&self, sequence: u32) -> (usize, Packet) {
        let bytes = HEADER + INFO_TS + DATA + self.payload + HEARTBEAT;
        (bytes, Packet::Data(self.station, sequence, (self.first, self.end)))
    }

    /// Removes samples from the writer's history that need not be kept: with KEEP_LAST those beyond its depth, with
    /// KEEP_ALL those that all readers have acknowledged.
    fn trim(&mut self) {
        match self.history {
            History::Last(depth) => self.first = self.first.max(self.end.saturating_sub(depth)),
            // A reader that never acknowledges blocks the removal. In DDS, resource limits end this.
            History::All if self.positive => {
                let acked = self.readers.values().map(|reader| reader.acked).min().unwrap_or(self.end);
                self.first = self.first.max(acked);
            }
            History::All => {}
        }
    }

    /// Handles a heartbeat: samples below `first` are irrelevant, and samples below `end` exist.
    fn hear_heartbeat(&mut self, now: Time, writer: u16, (first, end): (u32, u32), out: &mut Vec<Output<Packet>>) {
        let positive = self.positive;
        let Some(proxy) = self.writers.get_mut(&writer) else { return };
        proxy.last = proxy.last.max(end.checked_sub(1));
        let from = |sequence| Output::Deliver { from: writer, sequence };
        while proxy.next < first {
            out.extend(proxy.waiting.remove(&proxy.next).then(|| from(proxy.next)));
            proxy.next += 1;
        }
        while proxy.waiting.remove(&proxy.next) {
            out.push(from(proxy.next));
            proxy.next += 1;
        }
        let misses = proxy.last.is_some_and(|last| proxy.next <= last);
        if positive || misses {
            proxy.due = proxy.due.or(Some(now + HEARTBEAT_RESPONSE_DELAY));
        }
    }

    fn acknowledge(&mut self, writer: u16, out: &mut Vec<Output<Packet>>) {
        let (reader, positive) = (self.station, self.positive);
        let proxy = self.writers.get_mut(&writer).expect("it was due");
        proxy.due = None;
        let known = proxy.last.map_or(proxy.next, |last| last + 1);
        let missing: Vec<u32> = (proxy.next..known).filter(|n| !proxy.waiting.contains(n)).take(MOST_NAMED).collect();
        if missing.is_empty() && !positive {
            return;
        }
        let span = missing.first().zip(missing.last()).map_or(0, |(first, last)| (last - first + 1) as usize);
        let bytes = HEADER + INFO_DST + ACKNACK + 4 * span.min(MOST_NAMED).div_ceil(32);
        let packet = Packet::AckNack(reader, proxy.next, missing);
        out.push(Output::Send { to: Some(writer), bytes, packet });
    }

    fn hear_acknack(&mut self, now: Time, reader: u16, (base, missing): (u32, &[u32])) {
        let Some(proxy) = self.readers.get_mut(&reader) else { return };
        proxy.acked = proxy.acked.max(base);
        proxy.requested.extend(missing);
        if !proxy.requested.is_empty() {
            proxy.due = proxy.due.or(Some(now + NACK_RESPONSE_DELAY));
        }
        self.trim();
    }

    fn repair(&mut self, reader: u16, out: &mut Vec<Output<Packet>>) {
        let proxy = self.readers.get_mut(&reader).expect("it was due");
        proxy.due = None;
        let requested = std::mem::take(&mut proxy.requested);
        let to = Some(reader);
        if requested.iter().any(|sequence| *sequence < self.first) {
            let packet = Packet::Heartbeat(self.station, (self.first, self.end));
            out.push(Output::Send { to, bytes: HEADER + INFO_DST + GAP, packet });
        }
        for sequence in requested.into_iter().filter(|sequence| (self.first..self.end).contains(sequence)) {
            let (bytes, packet) = self.data(sequence);
            out.push(Output::Send { to, bytes: bytes + INFO_DST, packet });
        }
    }
}

impl Endpoint for Rtps {
    type Packet = Packet;

    fn publish(&mut self, now: Time, sequence: u32, out: &mut Vec<Output<Packet>>) {
        assert_eq!(sequence, self.end, "numbers follow each other");
        self.end += 1;
        self.trim();
        let (bytes, packet) = self.data(sequence);
        out.push(Output::Send { to: None, bytes, packet });
        self.heartbeat = self.heartbeat.or(Some(now + HEARTBEAT_PERIOD));
    }

    fn receive(&mut self, now: Time, packet: &Packet, out: &mut Vec<Output<Packet>>) {
        match packet {
            Packet::Data(writer, sequence, holds) => {
                if let Some(proxy) = self.writers.get_mut(writer)
                    && *sequence >= proxy.next
                {
                    proxy.waiting.insert(*sequence);
                }
                self.hear_heartbeat(now, *writer, *holds, out);
            }
            Packet::Heartbeat(writer, holds) => self.hear_heartbeat(now, *writer, *holds, out),
            Packet::AckNack(reader, base, missing) => self.hear_acknack(now, *reader, (*base, missing)),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let readers = self.readers.values().filter_map(|reader| reader.due);
        let writers = self.writers.values().filter_map(|writer| writer.due);
        readers.chain(writers).chain(self.heartbeat).min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Output<Packet>>) {
        let is_due = |due: Option<Time>| due.is_some_and(|due| due <= now);
        let others: Vec<u16> = self.readers.keys().copied().collect();
        for other in others {
            if is_due(self.writers[&other].due) {
                self.acknowledge(other, out);
            }
            if is_due(self.readers[&other].due) {
                self.repair(other, out);
            }
        }
        if is_due(self.heartbeat) {
            // Without positive acknowledgements, heartbeats never end.
            let open = !self.positive || self.readers.values().any(|reader| reader.acked < self.end);
            self.heartbeat = open.then_some(now + HEARTBEAT_PERIOD);
            if open {
                let packet = Packet::Heartbeat(self.station, (self.first, self.end));
                out.push(Output::Send { to: None, bytes: HEADER + INFO_TS + HEARTBEAT, packet });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(outputs: &[Output<Packet>]) -> Vec<u32> {
        outputs
            .iter()
            .filter_map(|outputs| if let Output::Deliver { sequence, .. } = outputs { Some(*sequence) } else { None })
            .collect()
    }

    fn sent(outputs: &mut Vec<Output<Packet>>) -> Vec<Packet> {
        let sent = |outputs| if let Output::Send { packet, .. } = outputs { Some(packet) } else { None };
        outputs.drain(..).filter_map(sent).collect()
    }

    #[test]
    fn a_later_sample_waits_for_the_retransmission_of_an_earlier_one() {
        let station = |station| Rtps::new(station, 2, 152, ReliabilityMode::Ack, History::All);
        let (mut writer, mut reader) = (station(0), station(1));
        let ms = |ms| Time::ZERO + Span::from_millis(ms);
        let mut outputs = Vec::new();
        writer.publish(ms(0), 0, &mut outputs);
        writer.publish(ms(1), 1, &mut outputs);
        let packets = sent(&mut outputs);
        reader.receive(ms(2), &packets[1], &mut outputs);
        assert!(heard(&outputs).is_empty(), "the first one is missing");
        assert_eq!(reader.wake_at(), Some(ms(7)));
        reader.wake(ms(7), &mut outputs);
        let asks = sent(&mut outputs);
        let [Packet::AckNack(1, 0, missing)] = &asks[..] else { panic!("{asks:?}") };
        assert_eq!(missing, &[0]);
        writer.receive(ms(8), &asks[0], &mut outputs);
        assert_eq!(writer.wake_at(), Some(ms(13)));
        writer.wake(ms(13), &mut outputs);
        let repair = sent(&mut outputs);
        reader.receive(ms(14), &repair[0], &mut outputs);
        assert_eq!(heard(&outputs), [0, 1], "in order");
    }

    #[test]
    fn a_reader_does_not_wait_for_samples_that_are_no_longer_kept() {
        let station = |station| Rtps::new(station, 2, 152, ReliabilityMode::AckOff, History::Last(1));
        let (mut writer, mut reader) = (station(0), station(1));
        let mut outputs = Vec::new();
        writer.publish(Time::ZERO, 0, &mut outputs);
        writer.publish(Time::ZERO, 1, &mut outputs);
        let packets = sent(&mut outputs);
        reader.receive(Time::ZERO, &packets[1], &mut outputs);
        assert_eq!(heard(&outputs), [1]);
        assert_eq!(reader.wake_at(), None, "nothing is missing, and nothing is acknowledged");
    }
}
