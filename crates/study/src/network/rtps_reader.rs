//! Reader of RTPS in a network study: OMG DDSI-RTPS 2.5, section 8.4.12, with what Fast DDS 2.9 does where the standard
//! leaves a choice. One reader of a station hears the writers of all others.
//!
//! Sources of the choices, by files of Fast DDS 2.9.1: `WriterProxy.cpp` and `StatefulReader.cpp` (heartbeats,
//! ACKNACKs, samples in order), `DataReaderHistory.cpp` (KEEP_LAST, which is for all writers together without keys).

use std::collections::{BTreeMap, BTreeSet};

use super::case::{History, ReliabilityMode};
use super::endpoint::Output;
use super::rtps_packet::{self, Holds, Packet, Sample};
use murmurate::time::{Span, Time};

/// `heartbeatResponseDelay` of Fast DDS; the standard has 500 ms (8.4.10.1.1).
const HEARTBEAT_RESPONSE_DELAY: Span = Span::from_millis(5);
/// Largest size of the `SequenceNumberSet` of one ACKNACK (9.4.2.6).
const MOST_NAMED: u32 = 256;

/// State that an RTPS reader keeps of one writer.
#[derive(Clone, Debug, Default)]
struct WriterProxy {
    /// Sequence number below which no sample is missing.
    next: u32,
    /// Sequence numbers received from `next` on.
    received: BTreeSet<u32>,
    /// Sequence number after the largest that the writer has sent or announced.
    end: u32,
    /// Time at which the next ACKNACK is due; `None` if none is.
    due: Option<Time>,
}

impl WriterProxy {
    fn advance(&mut self) {
        while self.received.remove(&self.next) {
            self.next += 1;
        }
    }
}

/// RTPS reader of a station.
#[derive(Clone, Debug)]
pub struct RtpsReader {
    station: u16,
    reliability: ReliabilityMode,
    history: History,
    writers: BTreeMap<u16, WriterProxy>,
    /// Samples that wait for an earlier one: publication time, writer and sequence number.
    waiting: BTreeSet<(Time, u16, u32)>,
}

impl RtpsReader {
    /// Returns the reader of the station with the index `station`, for the writers of the stations `writers`.
    pub fn new(
        station: u16,
        writers: impl Iterator<Item = u16>,
        (reliability, history): (ReliabilityMode, History),
    ) -> RtpsReader {
        let writers = writers.map(|writer| (writer, WriterProxy::default())).collect();
        RtpsReader { station, reliability, history, writers, waiting: BTreeSet::new() }
    }

    /// Returns the time of the reader's next ACKNACK.
    pub fn wake_at(&self) -> Option<Time> {
        self.writers.values().filter_map(|writer| writer.due).min()
    }

    /// Handles a sample of `writer`, and delivers what need not wait any more.
    pub fn receive_sample(&mut self, writer: u16, (sequence, published): Sample, out: &mut Vec<Output<Packet>>) {
        let Some(proxy) = self.writers.get_mut(&writer) else { return };
        if sequence < proxy.next || proxy.received.contains(&sequence) {
            return;
        }
        if !matches!(self.reliability, ReliabilityMode::Ack | ReliabilityMode::AckOff) {
            proxy.next = sequence + 1;
            out.push(Output::Deliver { from: writer, sequence });
            return;
        }
        proxy.received.insert(sequence);
        proxy.end = proxy.end.max(sequence + 1);
        proxy.advance();
        if let History::Last(depth) = self.history
            && self.waiting.len() >= depth as usize
        {
            // The newest samples are kept, of all writers together.
            let oldest = *self.waiting.first().expect("a depth is at least 1");
            if published < oldest.0 {
                self.deliver(writer, out);
                return;
            }
            self.waiting.remove(&oldest);
        }
        self.waiting.insert((published, writer, sequence));
        self.deliver(writer, out);
    }

    /// Handles a heartbeat of `writer`: samples below the first number are lost, and those below the second exist.
    pub fn receive_heartbeat(&mut self, now: Time, writer: u16, (first, end): Holds, out: &mut Vec<Output<Packet>>) {
        let positive = self.reliability == ReliabilityMode::Ack;
        let Some(proxy) = self.writers.get_mut(&writer) else { return };
        if first > proxy.next {
            proxy.next = first;
            proxy.received = proxy.received.split_off(&first);
            proxy.advance();
        }
        proxy.end = proxy.end.max(end).max(proxy.next);
        if positive || proxy.next < proxy.end {
            proxy.due = proxy.due.or(Some(now + HEARTBEAT_RESPONSE_DELAY));
        }
        self.deliver(writer, out);
    }

    /// Sends the ACKNACKs that are due at `now`.
    pub fn wake(&mut self, now: Time, out: &mut Vec<Output<Packet>>) {
        let (reader, positive) = (self.station, self.reliability == ReliabilityMode::Ack);
        for (&writer, proxy) in &mut self.writers {
            if proxy.due.is_none_or(|due| due > now) {
                continue;
            }
            proxy.due = None;
            let known = proxy.end.min(proxy.next + MOST_NAMED);
            let missing: Vec<u32> = (proxy.next..known).filter(|number| !proxy.received.contains(number)).collect();
            if positive || !missing.is_empty() {
                let packet = Packet::AckNack { reader, base: proxy.next, missing };
                out.push(Output::Send { to: Some(writer), bytes: packet.bytes(0) + rtps_packet::INFO_DST, packet });
            }
        }
    }

    /// Delivers the samples of `writer` that do not wait for an earlier one.
    fn deliver(&mut self, writer: u16, out: &mut Vec<Output<Packet>>) {
        let next = self.writers[&writer].next;
        self.waiting.retain(|&(_, from, sequence)| {
            let waits = from != writer || sequence >= next;
            if !waits {
                out.push(Output::Deliver { from, sequence });
            }
            waits
        });
    }
}
