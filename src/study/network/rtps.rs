//! A station that speaks as the reliable mode of RTPS does: OMG DDSI-RTPS 2.5, section 8.4, one stateful writer (8.4.9)
//! and a stateful reader (8.4.12) for each other station. What the standard leaves open is as in Fast DDS.
//!
//! Every sample carries a heartbeat, as Fast DDS does once the writer's history is full; a heartbeat is answered by an
//! ACKNACK after `heartbeatResponseDelay`; what is asked for leaves again after `nackResponseDelay`, to the one who
//! asked; what is no longer kept is declared irrelevant. Readers hand samples on in order (8.7.2.2.1, reliable).
//! Not modelled: discovery, fragments, liveliness.

use std::collections::{BTreeMap, BTreeSet};

use super::case::{Assurance, History};
use super::endpoint::{Endpoint, Said};
use crate::time::{Span, Time};

/// `heartbeatPeriod` of Fast DDS.
const HEARTBEAT_PERIOD: Span = Span::from_millis(3000);
/// `nackResponseDelay` of Fast DDS; the standard has 200 ms (8.4.7.1.1).
const NACK_RESPONSE_DELAY: Span = Span::from_millis(5);
/// `heartbeatResponseDelay` of Fast DDS; the standard has 500 ms (8.4.10.1.1).
const HEARTBEAT_RESPONSE_DELAY: Span = Span::from_millis(5);
/// The most numbers that one ACKNACK or GAP names: a `SequenceNumberSet` (9.4.2.6).
const MOST_NAMED: usize = 256;

/// Bytes of the parts of an RTPS message (9.4.4, 9.4.5), submessage headers of 4 bytes included: the header, the
/// timestamp and destination that go before, a DATA without its payload but with the encapsulation of 4 (10.2), a
/// HEARTBEAT, and an ACKNACK and a GAP without their bitmaps.
const HEADER: usize = 20;
const INFO_TS: usize = 12;
const INFO_DST: usize = 16;
const DATA: usize = 24 + 4;
const HEARTBEAT: usize = 32;
const ACKNACK: usize = 28;
const GAP: usize = 32;

/// From which number to below which a writer holds samples.
pub type Holds = (u32, u32);

/// What is on its way.
#[derive(Clone, Debug)]
pub enum Packet {
    /// A writer's sample of this number, with a heartbeat.
    Data(u16, u32, Holds),
    /// A writer's heartbeat alone, or its GAP.
    Heartbeat(u16, Holds),
    /// A reader has everything below this number, and asks for those.
    AckNack(u16, u32, Vec<u32>),
}

/// What a writer knows of one reader.
#[derive(Clone, Debug, Default)]
struct ReaderProxy {
    /// Everything below is acknowledged.
    acked: u32,
    requested: BTreeSet<u32>,
    due: Option<Time>,
}

/// What a reader knows of one writer.
#[derive(Clone, Debug, Default)]
struct WriterProxy {
    /// The next number that is to be handed on.
    next: u32,
    /// What came early.
    waiting: BTreeSet<u32>,
    /// The newest number that is known to be there.
    last: Option<u32>,
    /// When it is answered.
    due: Option<Time>,
}

/// One station.
pub struct Rtps {
    station: u16,
    payload: usize,
    positive: bool,
    history: History,
    /// What the writer holds: from the first of these numbers to below the second.
    first: u32,
    end: u32,
    readers: BTreeMap<u16, ReaderProxy>,
    writers: BTreeMap<u16, WriterProxy>,
    heartbeat: Option<Time>,
}

impl Rtps {
    /// A station among others, with messages of so many bytes.
    pub fn new(station: u16, stations: u16, payload: usize, reliability: Assurance, history: History) -> Rtps {
        let others = || (0..stations).filter(move |other| *other != station);
        Rtps {
            station,
            payload,
            positive: reliability == Assurance::Ack,
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

    /// Forgets what need not be kept.
    fn trim(&mut self) {
        match self.history {
            History::Last(depth) => self.first = self.first.max(self.end.saturating_sub(depth)),
            // A reader that never acknowledges would have to be waited for: only a limit of resources ends that.
            History::All if self.positive => {
                let acked = self.readers.values().map(|reader| reader.acked).min().unwrap_or(self.end);
                self.first = self.first.max(acked);
            }
            History::All => {}
        }
    }

    /// A writer holds these: what is below the first is not to be waited for.
    fn hear_heartbeat(&mut self, now: Time, writer: u16, (first, end): (u32, u32), out: &mut Vec<Said<Packet>>) {
        let positive = self.positive;
        let Some(proxy) = self.writers.get_mut(&writer) else { return };
        proxy.last = proxy.last.max(end.checked_sub(1));
        let from = |sequence| Said::Hear { from: writer, sequence };
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

    fn acknowledge(&mut self, writer: u16, out: &mut Vec<Said<Packet>>) {
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
        out.push(Said::Send { to: Some(writer), bytes, packet });
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

    fn repair(&mut self, reader: u16, out: &mut Vec<Said<Packet>>) {
        let proxy = self.readers.get_mut(&reader).expect("it was due");
        proxy.due = None;
        let requested = std::mem::take(&mut proxy.requested);
        let to = Some(reader);
        if requested.iter().any(|sequence| *sequence < self.first) {
            let packet = Packet::Heartbeat(self.station, (self.first, self.end));
            out.push(Said::Send { to, bytes: HEADER + INFO_DST + GAP, packet });
        }
        for sequence in requested.into_iter().filter(|sequence| (self.first..self.end).contains(sequence)) {
            let (bytes, packet) = self.data(sequence);
            out.push(Said::Send { to, bytes: bytes + INFO_DST, packet });
        }
    }
}

impl Endpoint for Rtps {
    type Packet = Packet;

    fn publish(&mut self, now: Time, sequence: u32, out: &mut Vec<Said<Packet>>) {
        assert_eq!(sequence, self.end, "numbers follow each other");
        self.end += 1;
        self.trim();
        let (bytes, packet) = self.data(sequence);
        out.push(Said::Send { to: None, bytes, packet });
        self.heartbeat = self.heartbeat.or(Some(now + HEARTBEAT_PERIOD));
    }

    fn receive(&mut self, now: Time, packet: &Packet, out: &mut Vec<Said<Packet>>) {
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

    fn wake(&mut self, now: Time, out: &mut Vec<Said<Packet>>) {
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
            // Without acknowledgements it cannot know better than to go on.
            let open = !self.positive || self.readers.values().any(|reader| reader.acked < self.end);
            self.heartbeat = open.then_some(now + HEARTBEAT_PERIOD);
            if open {
                let packet = Packet::Heartbeat(self.station, (self.first, self.end));
                out.push(Said::Send { to: None, bytes: HEADER + INFO_TS + HEARTBEAT, packet });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(said: &[Said<Packet>]) -> Vec<u32> {
        said.iter()
            .filter_map(|said| if let Said::Hear { sequence, .. } = said { Some(*sequence) } else { None })
            .collect()
    }

    fn sent(said: &mut Vec<Said<Packet>>) -> Vec<Packet> {
        let sent = |said| if let Said::Send { packet, .. } = said { Some(packet) } else { None };
        said.drain(..).filter_map(sent).collect()
    }

    #[test]
    fn a_later_sample_waits_for_an_earlier_one_that_is_repaired() {
        let station = |station| Rtps::new(station, 2, 152, Assurance::Ack, History::All);
        let (mut writer, mut reader) = (station(0), station(1));
        let ms = |ms| Time::ZERO + Span::from_millis(ms);
        let mut said = Vec::new();
        writer.publish(ms(0), 0, &mut said);
        writer.publish(ms(1), 1, &mut said);
        let packets = sent(&mut said);
        reader.receive(ms(2), &packets[1], &mut said);
        assert!(heard(&said).is_empty(), "the first one is missing");
        assert_eq!(reader.wake_at(), Some(ms(7)));
        reader.wake(ms(7), &mut said);
        let asks = sent(&mut said);
        let [Packet::AckNack(1, 0, missing)] = &asks[..] else { panic!("{asks:?}") };
        assert_eq!(missing, &[0]);
        writer.receive(ms(8), &asks[0], &mut said);
        assert_eq!(writer.wake_at(), Some(ms(13)));
        writer.wake(ms(13), &mut said);
        let repair = sent(&mut said);
        reader.receive(ms(14), &repair[0], &mut said);
        assert_eq!(heard(&said), [0, 1], "in order");
    }

    #[test]
    fn what_is_no_longer_kept_is_not_waited_for() {
        let station = |station| Rtps::new(station, 2, 152, Assurance::AckOff, History::Last(1));
        let (mut writer, mut reader) = (station(0), station(1));
        let mut said = Vec::new();
        writer.publish(Time::ZERO, 0, &mut said);
        writer.publish(Time::ZERO, 1, &mut said);
        let packets = sent(&mut said);
        reader.receive(Time::ZERO, &packets[1], &mut said);
        assert_eq!(heard(&said), [1]);
        assert_eq!(reader.wake_at(), None, "nothing is missing, and nothing is acknowledged");
    }
}
