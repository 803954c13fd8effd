//! Writer of RTPS in a network study: OMG DDSI-RTPS 2.5, section 8.4.9, with what Fast DDS 2.9 does where the standard
//! leaves a choice. Durability is VOLATILE, publication synchronous, and every participant has one writer.
//!
//! Sources of the choices, by files of Fast DDS 2.9.1: `StatefulWriter.cpp` (heartbeats, responses to ACKNACKs, removal
//! of acknowledged samples), `ReaderProxy.cpp` (states of a sample), `DataWriterHistory.cpp` (KEEP_LAST),
//! `RTPSParticipantImpl.cpp` (addresses of an endpoint).

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use super::case::{Addressing, History, ReliabilityMode};
use super::endpoint::Output;
use super::rtps_packet::{self, Holds, Packet, Sample};
use murmurate::time::{Span, Time};

/// `heartbeatPeriod` of Fast DDS.
const HEARTBEAT_PERIOD: Span = Span::from_millis(3000);
/// `nackResponseDelay` of Fast DDS; the standard has 200 ms (8.4.7.1.1).
const NACK_RESPONSE_DELAY: Span = Span::from_millis(5);
/// Bytes after which a sample carries a heartbeat although the history is not full: the send buffer of a socket, by
/// Linux's `net.core.wmem_default` \[bytes\].
const SEND_BUFFER: usize = 212_992;

/// State that an RTPS writer keeps of one reader. The states of a sample in Fast DDS are here: requested, unsent
/// (during a response only), and otherwise unacknowledged, because `nackSupressionDuration` is 0.
#[derive(Clone, Debug, Default)]
struct ReaderProxy {
    /// Sequence number below which no sample is expected to be acknowledged any more.
    low: u32,
    requested: BTreeSet<u32>,
}

/// RTPS writer of a station.
#[derive(Clone, Debug)]
pub struct RtpsWriter {
    station: u16,
    payload: usize,
    addressing: Addressing,
    reliability: ReliabilityMode,
    history: History,
    /// Number of the first kept sample, and the publication times of all kept ones.
    first: u32,
    kept: VecDeque<Time>,
    readers: BTreeMap<u16, ReaderProxy>,
    response: Option<Time>,
    heartbeat: Option<Time>,
    since_heartbeat: usize,
}

impl RtpsWriter {
    /// Returns the writer of the station with the index `station`, for the readers of the stations `readers` and
    /// samples of `payload` bytes.
    pub fn new(
        station: u16,
        readers: impl Iterator<Item = u16>,
        payload: usize,
        addressing: Addressing,
        (reliability, history): (ReliabilityMode, History),
    ) -> RtpsWriter {
        RtpsWriter {
            station,
            payload,
            addressing,
            reliability,
            history,
            first: 0,
            kept: VecDeque::new(),
            readers: readers.map(|reader| (reader, ReaderProxy::default())).collect(),
            response: None,
            heartbeat: None,
            since_heartbeat: 0,
        }
    }

    /// Returns the time of the writer's next timer.
    pub fn wake_at(&self) -> Option<Time> {
        self.response.into_iter().chain(self.heartbeat).min()
    }

    /// Publishes the sample `sequence`, which follows the last one.
    pub fn publish(&mut self, now: Time, sequence: u32, out: &mut Vec<Output<Packet>>) {
        assert_eq!(sequence, self.end(), "numbers follow each other");
        self.send_to_all(Packet::Data(self.station, vec![(sequence, now)]), out);
        if !self.reliable() {
            self.first = sequence + 1;
            return;
        }
        if self.is_full() {
            self.remove_first();
        }
        self.kept.push_back(now);
        self.accompany(out);
        self.start_heartbeats(now);
    }

    /// Sends a heartbeat to all readers after a sample, if the history is full or the send buffer's size was sent since
    /// the last one. It has a datagram of its own: a heartbeat is also for the reader of the own station, samples are
    /// not, and Fast DDS ends a datagram where the receivers change (`select_all_readers_nts`).
    fn accompany(&mut self, out: &mut Vec<Output<Packet>>) {
        self.since_heartbeat += rtps_packet::data_bytes(self.payload, 1);
        if self.is_full() || self.since_heartbeat > SEND_BUFFER {
            self.send_heartbeat(out);
        }
    }

    fn send_heartbeat(&mut self, out: &mut Vec<Output<Packet>>) {
        self.since_heartbeat = 0;
        self.send_to_all(Packet::Heartbeat(self.station, self.holds()), out);
    }

    fn start_heartbeats(&mut self, now: Time) {
        self.heartbeat = self.heartbeat.or(Some(now + HEARTBEAT_PERIOD));
    }

    /// Handles an ACKNACK of `reader`: it has all samples below `base` and requests those of `missing`.
    pub fn receive_acknack(&mut self, now: Time, reader: u16, (base, missing): (u32, &[u32])) {
        let holds = self.first..self.end();
        let Some(proxy) = self.readers.get_mut(&reader) else { return };
        proxy.low = proxy.low.max(base);
        let before = proxy.requested.len();
        // Requests for samples that are no longer kept have no answer: the next heartbeat's first number is one.
        proxy.requested.extend(missing.iter().filter(|sequence| holds.contains(sequence)));
        let low = proxy.low;
        proxy.requested.retain(|sequence| *sequence >= low);
        if proxy.requested.len() > before {
            self.response = self.response.or(Some(now + NACK_RESPONSE_DELAY));
        }
        self.remove_acknowledged();
    }

    /// Handles the timers that have expired at `now`.
    pub fn wake(&mut self, now: Time, out: &mut Vec<Output<Packet>>) {
        if self.response.is_some_and(|due| due <= now) {
            self.response = None;
            self.respond(now, out);
        }
        if self.heartbeat.is_some_and(|due| due <= now) {
            // The period goes on while a reader has not acknowledged a sample.
            let open = self.readers.values().any(|reader| reader.low < self.end());
            self.heartbeat = open.then_some(now + HEARTBEAT_PERIOD);
            if open && !self.kept.is_empty() {
                self.send_heartbeat(out);
            }
        }
    }

    /// Retransmits all requested samples. One timer serves all readers, so that a sample goes to all that have
    /// requested it; samples for the same readers share a datagram, unless a heartbeat to all goes between them.
    fn respond(&mut self, now: Time, out: &mut Vec<Output<Packet>>) {
        let mut order: Vec<u32> = Vec::new();
        let mut wanted: BTreeMap<u32, Vec<u16>> = BTreeMap::new();
        for (reader, proxy) in &mut self.readers {
            for sequence in std::mem::take(&mut proxy.requested) {
                let readers = wanted.entry(sequence).or_default();
                if readers.is_empty() {
                    order.push(sequence);
                }
                readers.push(*reader);
            }
        }
        let mut batch: Option<(Vec<u16>, Vec<Sample>)> = None;
        order.retain(|sequence| (self.first..self.end()).contains(sequence));
        for sequence in order {
            let readers = wanted.remove(&sequence).expect("it is wanted");
            let sample = (sequence, self.kept[(sequence - self.first) as usize]);
            match &mut batch {
                Some((to, samples)) if *to == readers => samples.push(sample),
                _ => {
                    let before = batch.replace((readers, vec![sample]));
                    self.flush(before, out);
                }
            }
            if self.is_full() {
                self.flush(batch.take(), out);
            }
            self.accompany(out);
        }
        self.flush(batch, out);
        self.start_heartbeats(now);
    }

    /// Sends retransmitted samples to their readers in one datagram.
    fn flush(&self, batch: Option<(Vec<u16>, Vec<Sample>)>, out: &mut Vec<Output<Packet>>) {
        if let Some((readers, samples)) = batch {
            self.send(&readers, Packet::Data(self.station, samples), out);
        }
    }

    fn send_to_all(&self, packet: Packet, out: &mut Vec<Output<Packet>>) {
        let readers: Vec<u16> = self.readers.keys().copied().collect();
        self.send(&readers, packet, out);
    }

    /// Sends a datagram to readers. With multicast they have the group's address alone, as those of Fast DDS that are
    /// given a multicast locator and no unicast one: then even what one of them has requested goes to all. Samples for
    /// a single reader name its participant (INFO_DST).
    fn send(&self, readers: &[u16], packet: Packet, out: &mut Vec<Output<Packet>>) {
        let named = readers.len() == 1 && matches!(packet, Packet::Data(..));
        let bytes = packet.bytes(self.payload) + if named { rtps_packet::INFO_DST } else { 0 };
        if self.addressing == Addressing::Multicast {
            out.push(Output::Multicast { bytes, packet });
            return;
        }
        out.extend(readers.iter().map(|&to| Output::Send { to: Some(to), bytes, packet: packet.clone() }));
    }

    fn end(&self) -> u32 {
        self.first + self.kept.len() as u32
    }

    fn holds(&self) -> Holds {
        (self.first, self.end())
    }

    fn reliable(&self) -> bool {
        matches!(self.reliability, ReliabilityMode::Ack | ReliabilityMode::AckOff)
    }

    fn is_full(&self) -> bool {
        matches!(self.history, History::Last(depth) if self.kept.len() >= depth as usize)
    }

    /// Removes the oldest sample: no reader is expected to acknowledge it any more.
    fn remove_first(&mut self) {
        self.kept.pop_front();
        self.first += 1;
        for proxy in self.readers.values_mut() {
            proxy.low = proxy.low.max(self.first);
            proxy.requested.remove(&(self.first - 1));
        }
    }

    /// Removes the samples that all readers have acknowledged, as a writer with VOLATILE durability does.
    fn remove_acknowledged(&mut self) {
        let acknowledged = self.readers.values().map(|reader| reader.low).min().unwrap_or(self.first);
        while self.first < acknowledged && !self.kept.is_empty() {
            self.remove_first();
        }
    }
}
