//! Medium of a laboratory: the emulated radio channel with Ethernet frames of stations. The same channel runs in
//! simulations. The code is pure: it takes frames and times, and returns deliveries and the time of the next event.

use std::sync::Arc;

use rand::RngExt;

use super::ethernet::{self, Addressee};
use super::file::Laboratory;
use super::path::Path;
use murmurate::net::media::radio::channel::Transmission;
use murmurate::net::media::radio::counts::StationCounts;
use murmurate::net::media::radio::{Channel, Delivery, Destination, RadioCounts, Topology};
use murmurate::random::{Seed, Stream};
use murmurate::time::{Span, Time};

/// Period at which the positions of moving stations are updated.
const MOVE_PERIOD: Span = Span::from_millis(20);

/// Ethernet frame that a station has handed to the medium.
#[derive(Debug, PartialEq, Eq)]
pub struct EthernetFrame {
    /// Number of the frame among those of its station, from zero; retries have the same number.
    pub number: u64,
    /// Time at which the medium has taken the frame.
    pub taken: Time,
    /// The frame's bytes, with the header of Ethernet.
    pub bytes: Box<[u8]>,
}

/// Ethernet frame that was found at a station's interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    /// Number of the station.
    pub station: u16,
    /// The frame's bytes, with the header of Ethernet.
    pub bytes: Vec<u8>,
}

/// Counters of the frames of one station that never came to the channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Refused {
    /// Number of unicast frames whose destination is no station of the laboratory.
    pub unknown: u64,
    /// Number of frames that are too short or too long for Ethernet.
    pub malformed: u64,
}

/// Radio channel of a laboratory, which carries Ethernet frames of stations.
#[derive(Debug)]
pub struct Medium {
    channel: Channel<Arc<EthernetFrame>>,
    stations: u16,
    has_access_point: bool,
    everyone: Arc<[u16]>,
    /// Stations that move, with their paths.
    moving: Vec<(u16, Path)>,
    /// Time at which positions are updated next; `None` if no station moves.
    next_move: Option<Time>,
    /// Time of the channel's last event.
    last_event: Time,
    /// Moments at which frames that were found together have come.
    arrival: Stream,
    taken: Vec<u64>,
    refused: Vec<Refused>,
    deliveries: Vec<Delivery<Arc<EthernetFrame>>>,
}

impl Medium {
    /// Returns the medium of a laboratory at time zero, with nothing under way.
    pub fn new(lab: &Laboratory) -> Medium {
        let seed = Seed::of_run(lab.seed).child("lab");
        let mut channel = Channel::new(lab.radio.clone(), lab.stations, &seed);
        let placed = (0..lab.stations).zip(&lab.paths).filter_map(|(number, path)| Some((number, path.as_ref()?)));
        for (number, path) in placed.clone() {
            channel.place(number, path.at(Time::ZERO));
        }
        let moving: Vec<(u16, Path)> =
            placed.filter(|(_, path)| path.moves()).map(|(number, path)| (number, path.clone())).collect();
        let stations = usize::from(lab.stations);
        Medium {
            channel,
            stations: lab.stations,
            has_access_point: lab.radio.channel == Topology::Infrastructure,
            everyone: (0..lab.stations).collect(),
            next_move: (!moving.is_empty()).then_some(Time::ZERO + MOVE_PERIOD),
            moving,
            last_event: Time::ZERO,
            arrival: seed.stream("arrival"),
            taken: vec![0; stations],
            refused: vec![Refused::default(); stations],
            deliveries: Vec::new(),
        }
    }

    /// Takes an Ethernet frame from a station at time `now`, after what the channel does until then. A frame that no
    /// station can receive is dropped and counted.
    pub fn take(&mut self, now: Time, station: u16, bytes: &[u8]) {
        self.wake(now);
        let refused = &mut self.refused[usize::from(station)];
        let to = match ethernet::addressee(bytes, self.stations) {
            Some(Addressee::Station(to)) => Destination::One(to),
            Some(Addressee::Group) => Destination::Many(Arc::clone(&self.everyone)),
            Some(Addressee::Unknown) => {
                refused.unknown += 1;
                return;
            }
            None => {
                refused.malformed += 1;
                return;
            }
        };
        let taken = &mut self.taken[usize::from(station)];
        let frame = Arc::new(EthernetFrame { number: *taken, taken: now, bytes: bytes.into() });
        *taken += 1;
        self.channel.offer(now, station, to, ethernet::datagram_bytes(bytes), frame);
    }

    /// Takes frames that were found at the interfaces together, at time `now`. They have come within the time `window`
    /// before, in an unknown order: each is taken at a random moment of that time, those of one station in
    /// their order. Taken at one moment instead, frames of two stations would begin in the same slot and collide.
    pub fn take_together(&mut self, now: Time, window: Span, mut found: Vec<Found>) {
        self.wake(now);
        // The channel cannot go back behind what it has done.
        let since = self.last_event.max(Time::from_nanos(now.as_nanos().saturating_sub(window.as_nanos())));
        let most = now.since(since).as_nanos();
        let mut moments: Vec<(u16, u64)> =
            found.iter().map(|one| (one.station, self.arrival.random_range(0..=most))).collect();
        // Both sorts are by station; this one keeps the frames of a station in their order, and that one sorts their
        // moments.
        found.sort_by_key(|one| one.station);
        moments.sort_unstable();
        let mut all: Vec<(u64, Found)> = moments.into_iter().map(|(_, moment)| moment).zip(found).collect();
        all.sort_by_key(|(moment, _)| *moment);
        for (moment, one) in all {
            self.take(since + Span::from_nanos(moment), one.station, &one.bytes);
        }
    }

    /// Returns the time at which `wake` is next due; `None` if nothing is under way.
    pub fn wake_at(&self) -> Option<Time> {
        [self.channel.wake_at(), self.next_move].into_iter().flatten().min()
    }

    /// Runs the channel up to time `now`.
    pub fn wake(&mut self, now: Time) {
        while let Some(due) = self.next_move.filter(|&due| due <= now) {
            self.run_channel(due);
            for (number, path) in &self.moving {
                self.channel.place(*number, path.at(due));
            }
            self.next_move = Some(due + MOVE_PERIOD);
        }
        self.run_channel(now);
    }

    fn run_channel(&mut self, now: Time) {
        while let Some(due) = self.channel.wake_at().filter(|&due| due <= now) {
            self.channel.wake(due, &mut self.deliveries);
            self.last_event = due;
        }
    }

    /// Removes and returns the frames received so far, in the order of their arrival, each with the time at which its
    /// last bit has arrived.
    pub fn deliveries(&mut self) -> impl Iterator<Item = Delivery<Arc<EthernetFrame>>> {
        self.deliveries.drain(..)
    }

    /// Records every transmission from now on, for `transmissions`.
    pub fn record_transmissions(&mut self) {
        self.channel.record_transmissions();
    }

    /// Removes and returns the transmissions recorded so far, in the order of their ends.
    pub fn transmissions(&mut self) -> Vec<Transmission<Arc<EthernetFrame>>> {
        self.channel.transmissions()
    }

    /// Returns the counters of the channel since time zero.
    pub fn counts(&self, now: Time) -> RadioCounts {
        self.channel.counts(now)
    }

    /// Returns the counters of a station, and of its frames that never came to the channel.
    pub fn station_counts(&self, station: u16) -> (StationCounts, Refused) {
        (self.channel.station_counts(station), self.refused[usize::from(station)])
    }

    /// Returns the counters of the access point; `None` without one.
    pub fn access_point_counts(&self) -> Option<StationCounts> {
        self.has_access_point.then(|| self.channel.station_counts(self.stations))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lab(text: &str) -> Laboratory {
        Laboratory::from_toml(text).unwrap()
    }

    fn frame(to: [u8; 6], bytes: usize) -> Vec<u8> {
        [&to[..], &[0; 6], &[8, 0], &vec![7; bytes]].concat()
    }

    /// Runs the medium until nothing is under way, and returns station, number and time of each delivery.
    fn drained(medium: &mut Medium) -> Vec<(u16, u64, Time)> {
        while let Some(due) = medium.wake_at() {
            medium.wake(due);
        }
        medium.deliveries().map(|delivery| (delivery.to, delivery.token.number, delivery.at)).collect()
    }

    #[test]
    fn a_unicast_frame_goes_to_its_station_and_a_group_s_to_all_others() {
        for channel in ["ad-hoc", "infrastructure"] {
            let lab = lab(&format!("stations = 3\n[radio]\nchannel = \"{channel}\"\n"));
            let mut medium = Medium::new(&lab);
            medium.take(Time::ZERO, 0, &frame(ethernet::station(2), 128));
            assert_eq!(drained(&mut medium).iter().map(|(to, ..)| *to).collect::<Vec<_>>(), [2], "{channel}");
            medium.take(Time::ZERO + Span::from_millis(50), 0, &frame([0xff; 6], 128));
            assert_eq!(drained(&mut medium).iter().map(|(to, ..)| *to).collect::<Vec<_>>(), [1, 2], "{channel}");
            let (counts, refused) = medium.station_counts(0);
            assert_eq!((counts.offered, counts.transmissions, refused), (2, 2, Refused::default()));
            let relayed = medium.access_point_counts().map(|counts| counts.transmissions);
            assert_eq!(relayed, (channel == "infrastructure").then_some(2));
        }
    }

    #[test]
    fn a_frame_takes_the_time_of_the_standard() {
        let lab = lab("stations = 2\n[radio]\nchannel = \"ad-hoc\"\n");
        let mut medium = Medium::new(&lab);
        // 26 + 4 bytes of MAC, 8 of LLC and SNAP and 100 of payload at 54 Mbit/s; the medium is idle from AIFS on.
        let idle = Time::ZERO + lab.radio.times().aifs;
        medium.take(idle, 0, &frame(ethernet::station(1), 100));
        let on_air = lab.radio.rate.airtime(138, lab.radio.width_mhz, lab.radio.band);
        assert_eq!(drained(&mut medium), [(1, 0, idle + on_air)]);
    }

    #[test]
    fn frames_for_nobody_are_counted_and_dropped() {
        let mut medium = Medium::new(&lab("stations = 2\n"));
        medium.take(Time::ZERO, 1, &frame([0x52, 0x54, 0, 0, 0, 1], 100));
        medium.take(Time::ZERO, 1, &[0; 5]);
        assert_eq!(drained(&mut medium), []);
        assert_eq!(medium.station_counts(1).1, Refused { unknown: 1, malformed: 1 });
    }

    #[test]
    fn retries_and_losses_count_at_their_station() {
        let mut medium =
            Medium::new(&lab("stations = 2\n[radio]\nchannel = \"ad-hoc\"\nnoise_loss = 1.0\nretries = 3\n"));
        medium.take(Time::ZERO, 0, &frame(ethernet::station(1), 100));
        assert_eq!(drained(&mut medium), []);
        let counts = medium.station_counts(0).0;
        assert_eq!((counts.transmissions, counts.retries, counts.lost_retries), (4, 3, 1));
        let now = Time::ZERO + Span::from_millis(500);
        medium.take(now, 0, &frame([0xff; 6], 100));
        assert_eq!(drained(&mut medium), []);
        assert_eq!(medium.station_counts(0).0.transmissions, 5, "a frame for a group is not sent again");
        assert_eq!(medium.station_counts(1).0.missed_noise, 1);
    }

    #[test]
    fn frames_found_together_have_come_one_after_another() {
        let lab = lab("stations = 6\n[radio]\nchannel = \"ad-hoc\"\n");
        let collided = |window: Span| {
            let mut medium = Medium::new(&lab);
            for turn in 1..500 {
                let found = (0..3).map(|station| Found { station, bytes: frame(ethernet::station(5), 20) });
                medium.take_together(Time::ZERO + Span::from_millis(10 * turn), window, found.collect());
            }
            let counts = medium.counts(Time::ZERO);
            counts.collided as f64 / counts.transmissions as f64
        };
        let (at_once, apart) = (collided(Span::ZERO), collided(Span::from_millis(1)));
        // The three first transmissions collide, and some of the retries.
        assert!(at_once > 0.4 && apart < 0.2, "{at_once}, {apart}");
        // Those of one station stay in their order.
        let mut medium = Medium::new(&lab);
        let sized = |bytes: usize| Found { station: 0, bytes: frame(ethernet::station(5), bytes) };
        medium.take_together(Time::ZERO + Span::from_millis(5), Span::from_millis(1), (30..60).map(sized).collect());
        while let Some(due) = medium.wake_at() {
            medium.wake(due);
        }
        let sizes: Vec<usize> = medium.deliveries().map(|one| one.token.bytes.len()).collect();
        assert!(sizes.len() == 30 && sizes.is_sorted(), "{sizes:?}");
    }

    #[test]
    fn a_moving_station_leaves_the_range() {
        let text = "stations = 2\n[radio]\nchannel = \"ad-hoc\"\nrange_m = 5.0\n[[station]]\nnumber = 0\n\
                    position_m = [0.0, 0.0]\n[[station]]\nnumber = 1\npath = [[1.0, 0.0, 0.0], [2.0, 10.0, 0.0]]\n";
        let mut medium = Medium::new(&lab(text));
        for (ms, heard) in [(100, true), (1400, true), (1600, false), (3000, false)] {
            let now = Time::ZERO + Span::from_millis(ms);
            medium.take(now, 0, &frame([0xff; 6], 100));
            medium.wake(now + Span::from_millis(10));
            assert_eq!(medium.deliveries().count() == 1, heard, "after {ms} ms");
        }
        assert_eq!(medium.station_counts(1).0.missed_range, 2);
    }

    #[test]
    fn the_same_frames_at_the_same_times_have_the_same_deliveries() {
        let lab = lab("stations = 4\npreset = \"paper\"\n");
        let run = || {
            let mut medium = Medium::new(&lab);
            for turn in 0..400u64 {
                let now = Time::ZERO + Span::from_nanos(turn * 1_700_000);
                let to = if turn % 3 == 0 { [0xff; 6] } else { ethernet::station((turn as u16 + 1) % 4) };
                medium.take(now, turn as u16 % 4, &frame(to, 152));
            }
            medium.wake(Time::ZERO + Span::from_millis(1500));
            let all: Vec<_> = medium.deliveries().map(|one| (one.at, one.from, one.to, one.token.number)).collect();
            all
        };
        let all = run();
        assert!(all.len() > 300, "{}", all.len());
        assert_eq!(all, run());
    }
}
