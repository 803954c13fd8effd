//! One station of a radio channel: its transmit queue, contention window and backoff counter.

use std::collections::VecDeque;
use std::sync::Arc;

use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::counts::StationCounts;
use super::{AfterDrop, Counting, Radio};
use crate::random::Stream;
use crate::time::Span;

/// Receivers of a frame on a radio channel, as indices of stations.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "StoredDestination", into = "StoredDestination")]
pub enum Destination {
    /// One station, by unicast: acknowledged, and retransmitted up to the retry limit.
    One(u16),
    /// All stations with these indices except the sender, by multicast: sent once at the basic rate, without
    /// acknowledgement. With an access point, the frame first goes to it by unicast, and the access point multicasts
    /// it.
    Many(Arc<[u16]>),
}

/// Receivers of a frame as they are stored.
#[derive(Serialize, Deserialize)]
enum StoredDestination {
    One(u16),
    Many(Vec<u16>),
}

impl From<Destination> for StoredDestination {
    fn from(to: Destination) -> StoredDestination {
        match to {
            Destination::One(to) => StoredDestination::One(to),
            Destination::Many(all) => StoredDestination::Many(all.to_vec()),
        }
    }
}

impl From<StoredDestination> for Destination {
    fn from(to: StoredDestination) -> Destination {
        match to {
            StoredDestination::One(to) => Destination::One(to),
            StoredDestination::Many(all) => Destination::Many(all.into()),
        }
    }
}

/// Part of a frame's way to its receivers that one transmission covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Hop {
    /// From the sending station directly to the receivers, without an access point.
    Direct,
    /// From the sending station to the access point, which then transmits the frame again.
    Up,
    /// From the access point to the final receivers, the second transmission of a frame.
    Down,
    /// Within another network, which only occupies the medium; the frame has no receiver on this channel.
    Foreign,
    /// From a station or the access point to all, with no payload of a caller: a beacon.
    Beacon,
}

/// Frame in the transmit queue of a station or of the access point.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct QueuedFrame<T> {
    /// Part of the frame's way that its next transmission covers, such as from the station to the access point.
    pub hop: Hop,
    /// Index of the station that offered the frame.
    pub from: u16,
    /// Final receivers of the frame.
    pub to: Destination,
    /// Length of the datagram in the frame \[bytes\].
    pub bytes: usize,
    /// Value that the caller passed with the frame, copied into each delivery; `None` for a frame of another network.
    pub token: Option<T>,
    /// Whether the receiver has the frame already, and its acknowledgement was lost.
    pub received: bool,
}

impl<T> QueuedFrame<T> {
    /// Returns the number of final receivers of the frame that it has not reached; 0 for a frame of another network and
    /// a beacon.
    pub fn copies(&self) -> u64 {
        match &self.to {
            _ if matches!(self.hop, Hop::Foreign | Hop::Beacon) || self.received => 0,
            Destination::One(_) => 1,
            Destination::Many(all) => all.iter().filter(|&&to| to != self.from).count() as u64,
        }
    }

    /// Returns the time that the frame takes on the air, on a channel with the parameters `radio`.
    pub fn airtime(&self, radio: &Radio) -> Span {
        if self.unicast() { radio.frame_airtime(self.bytes) } else { radio.multicast_airtime(self.bytes) }
    }

    /// Returns true if the frame is sent by unicast, and so acknowledged.
    pub fn unicast(&self) -> bool {
        match self.hop {
            Hop::Up | Hop::Foreign => true,
            Hop::Beacon => false,
            Hop::Direct | Hop::Down => matches!(self.to, Destination::One(_)),
        }
    }
}

/// State of one station of a radio channel: its transmit queue, contention window and backoff counter.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Station<T> {
    /// Frames that wait for transmission, the next one first.
    pub queue: VecDeque<QueuedFrame<T>>,
    /// Frame that refills an empty queue if the station is saturated; `None` if it is not.
    pub refill: Option<QueuedFrame<T>>,
    /// Counters of the station.
    pub counts: StationCounts,
    /// Backoff counter: number of slots that the station still waits after the medium becomes idle before it transmits
    /// or, with an empty queue, may transmit a new frame. `None` if no backoff is in progress: a new frame may be sent
    /// at once.
    counter: Option<u64>,
    window: u32,
    failures: u32,
    /// Number of failed transmissions since the window was the smallest, of all frames.
    failed_in_row: u32,
}

/// State of a station that tells how often the frame at the front of its queue was sent.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Attempts {
    window: u32,
    failures: u32,
    failed_in_row: u32,
}

impl<T: Clone> Station<T> {
    /// Makes an idle station with the contention window that the channel's parameters `radio` give.
    pub fn new(radio: &Radio) -> Station<T> {
        Station {
            queue: VecDeque::new(),
            refill: None,
            counts: StationCounts::default(),
            counter: None,
            window: radio.cw_min,
            failures: 0,
            failed_in_row: 0,
        }
    }

    /// Returns the slot, counted since the medium became idle, in which the station transmits if the medium stays idle.
    /// `None` means that the station has nothing to send.
    pub fn slot(&self) -> Option<u64> {
        self.counter.filter(|_| !self.queue.is_empty())
    }

    /// Returns whether a backoff is in progress.
    pub fn counts_down(&self) -> bool {
        self.counter.is_some()
    }

    /// Returns the number of failed transmissions of the frame at the front of the queue.
    pub fn failures(&self) -> u32 {
        self.failures
    }

    /// Schedules the transmission of a frame that came to an empty queue while the medium was idle: in slot number
    /// `slot` since the medium became idle, or later if a backoff is still in progress (IEEE 802.11-2016, 10.3.4.2).
    pub fn ready_at(&mut self, slot: u64) {
        self.counter = Some(self.counter.unwrap_or(0).max(slot));
    }

    /// Schedules the transmission of a frame that came to an empty queue while the medium was busy: draws a backoff,
    /// unless one is still in progress (IEEE 802.11-2016, 10.3.4.2, 10.3.4.3).
    pub fn ready_after(&mut self, stream: &mut Stream) {
        if self.counter.is_none() {
            self.count_from(stream.random());
        }
    }

    /// Updates the station's backoff counter at the start of a transmission on the channel, in slot number `slot` since
    /// the medium became idle. `counting` says whether that slot counts for the backoff, too. Returns true if this
    /// station transmits in that slot, too.
    pub fn pass(&mut self, slot: u64, counting: Counting) -> bool {
        let Some(counter) = self.counter.take() else { return false };
        if counter <= slot {
            return !self.queue.is_empty();
        }
        let left = counter - slot - u64::from(counting == Counting::Edca);
        // Empty queue and counter at zero: the backoff after the last frame is over.
        self.counter = Some(left).filter(|&left| left > 0 || !self.queue.is_empty());
        false
    }

    /// Ends a frame that was acknowledged or is not sent again: the backoff before the next one follows from the random
    /// number `drawn` (IEEE 802.11-2016, 10.3.4.3).
    pub fn done(&mut self, radio: &Radio, drawn: u32) {
        (self.window, self.failed_in_row) = (radio.cw_min, 0);
        self.next_frame(drawn);
    }

    /// Handles a missing acknowledgement: doubles the contention window and puts the frame back at the front of the
    /// queue (IEEE 802.11-2016, 10.3.3, 10.3.4.4). At the retry limit, returns the frame as lost instead; otherwise
    /// `None`. The backoff follows from the random number `drawn`.
    pub fn failed(&mut self, frame: QueuedFrame<T>, radio: &Radio, drawn: u32) -> Option<QueuedFrame<T>> {
        let dropped = self.failures >= radio.retries;
        self.failed_in_row += 1;
        let starts_anew = match radio.after_drop {
            AfterDrop::Reset => dropped,
            AfterDrop::Keep => self.failed_in_row > radio.retries.saturating_add(1),
        };
        if starts_anew {
            (self.window, self.failed_in_row) = (radio.cw_min, 0);
        } else {
            self.window = (2 * self.window + 1).min(radio.cw_max);
        }
        if dropped {
            self.next_frame(drawn);
            return Some(frame);
        }
        self.queue.push_front(frame);
        self.failures += 1;
        self.count_from(drawn);
        None
    }

    /// Returns what `done` forgets of the frame that it ends.
    pub fn attempts(&self) -> Attempts {
        Attempts { window: self.window, failures: self.failures, failed_in_row: self.failed_in_row }
    }

    /// Undoes `done`, before which `attempts` was so.
    pub fn restore(&mut self, attempts: Attempts) {
        Attempts { window: self.window, failures: self.failures, failed_in_row: self.failed_in_row } = attempts;
    }

    fn next_frame(&mut self, drawn: u32) {
        self.failures = 0;
        self.count_from(drawn);
        if self.queue.is_empty() {
            self.queue.extend(self.refill.clone());
        }
    }

    /// Sets the backoff counter to a number of the contention window, each as likely as the others: its size is a power
    /// of two.
    fn count_from(&mut self, drawn: u32) {
        self.counter = Some((u64::from(drawn) * (u64::from(self.window) + 1)) >> u32::BITS);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> QueuedFrame<u8> {
        QueuedFrame { hop: Hop::Direct, from: 0, to: Destination::One(1), bytes: 100, token: Some(0), received: false }
    }

    #[test]
    fn a_backoff_counter_is_frozen_while_the_medium_is_busy() {
        for (counting, left) in [(Counting::Dcf, 6), (Counting::Edca, 5)] {
            let mut station = Station::new(&Radio::default());
            station.queue.push_back(frame());
            station.ready_at(10);
            assert!(!station.pass(4, counting));
            assert_eq!(station.slot(), Some(left));
            assert!(station.pass(left, counting), "its own slot");
        }
    }

    #[test]
    fn a_contention_window_doubles_up_to_its_maximum_and_a_frame_is_dropped_at_the_retry_limit() {
        let radio = Radio { cw_max: 63, retries: 3, ..Radio::default() };
        let mut station = Station::new(&radio);
        let mut windows = Vec::new();
        for _ in 0..3 {
            assert!(station.failed(frame(), &radio, 0).is_none());
            windows.push(station.window);
            station.queue.clear();
        }
        assert_eq!(windows, [31, 63, 63]);
        assert!(station.failed(frame(), &radio, 0).is_some(), "once and three times more");
        assert_eq!((station.window, station.failures), (15, 0));
    }

    #[test]
    fn a_window_that_is_kept_outlives_a_dropped_frame() {
        let radio = Radio { retries: 1, after_drop: AfterDrop::Keep, ..Radio::default() };
        let mut station = Station::new(&radio);
        let mut windows = Vec::new();
        for _ in 0..4 {
            station.failed(frame(), &radio, 0);
            windows.push(station.window);
            station.queue.clear();
        }
        assert_eq!(windows, [31, 63, 15, 31], "the third failure in a row is one more than a frame may have");
        station.done(&radio, 0);
        assert_eq!(station.window, 15);
    }

    #[test]
    fn a_backoff_has_every_number_of_the_window() {
        let radio = Radio::default();
        let mut station = Station::new(&radio);
        station.queue.push_back(frame());
        for number in 0..16_u32 {
            for drawn in [number << 28, number << 28 | 0x0fff_ffff] {
                station.done(&radio, drawn);
                assert_eq!(station.slot(), Some(u64::from(number)));
            }
        }
    }

    #[test]
    fn every_frame_is_followed_by_a_backoff() {
        let radio = Radio { cw_min: 1023, ..Radio::default() };
        let mut station = Station::<u8>::new(&radio);
        station.done(&radio, 1 << 31);
        assert_eq!(station.slot(), None, "there is nothing to send");
        let counter = station.counter.unwrap();
        assert_eq!(counter, 512);
        station.ready_at(3);
        assert_eq!(station.counter, Some(counter), "a frame that comes early waits for the backoff");
        station.ready_at(2000);
        assert_eq!(station.counter, Some(2000), "one that comes late does not");
    }
}
