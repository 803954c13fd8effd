//! The radio channel under an emulated link. The stations of the channel are the hosts of the link, at the true
//! positions of their robots.

use std::sync::Arc;

use crate::messages::ids::HostId;
use crate::messages::local::Truth;
use crate::messages::wire::Kind;
use crate::net::media::radio::{Channel, Delivery, Destination, Radio, RadioCounts};
use crate::net::protocol::codec::Frame;
use crate::net::protocol::router::Audience;
use crate::net::transport::Transmit;
use crate::random::Seed;
use crate::time::{Span, Time};

/// Period at which a radio link reports its counters of frames and airtime ([`RadioCounts`]).
const COUNTS_PERIOD: Span = Span::from_millis(1000);

/// Frame that a host of an emulated link has handed to the radio channel, with the kind of its first message.
#[derive(Clone, Debug)]
pub struct Sent {
    /// Kind of the frame's first message, by which the link emulator delays or loses the frame.
    pub kind: Kind,
    /// Bytes of the frame.
    pub frame: Frame,
}

/// Radio channel of one emulated link, with one station for each host.
#[derive(Debug)]
pub struct RadioLink {
    channel: Channel<Sent>,
    /// Hosts that are at the position of each robot, by number of the robot; an entry is empty if no host is there.
    hosts_of_robot: Vec<Vec<HostId>>,
    next_counts: Time,
}

impl RadioLink {
    /// Returns a channel with the parameters `radio` and one station per host, which draws random numbers from streams
    /// of `seed`. `robots_of` has one entry per host: the first robot whose agent the host runs, or `None` for a host
    /// without robots.
    ///
    /// A host is at the position of that robot. A host without robots is within range of all, and so is one whose robot
    /// was not located yet.
    pub fn new(radio: Radio, robots_of: &[Option<u16>], seed: &Seed) -> RadioLink {
        let hosts = u16::try_from(robots_of.len()).expect("hosts are counted in u16");
        let robots = robots_of.iter().flatten().max().map_or(0, |&last| usize::from(last) + 1);
        let mut hosts_of_robot = vec![Vec::new(); robots];
        for (host, robot) in (0..hosts).map(HostId).zip(robots_of) {
            robot.iter().for_each(|&robot| hosts_of_robot[usize::from(robot)].push(host));
        }
        RadioLink { channel: Channel::new(radio, hosts, seed), hosts_of_robot, next_counts: Time::ZERO }
    }

    /// Returns the link with walls that weaken frames, as the corners of their outlines \[m\], world frame.
    pub fn walled(mut self, walls: Vec<Vec<[f32; 2]>>) -> RadioLink {
        self.channel.wall_in(walls);
        self
    }

    /// Queues a frame of the host `transmit.from` for transmission at time `now`. `kind` is the kind of the frame's
    /// first message. A frame for one host goes to that host; a frame for all hosts goes to `listeners`, without the
    /// sender.
    pub fn offer(&mut self, now: Time, transmit: &Transmit, kind: Kind, listeners: &Arc<[u16]>) {
        let to = match transmit.audience {
            Audience::Host(to) => Destination::One(to.0),
            Audience::All => Destination::Many(Arc::clone(listeners)),
        };
        let frame = transmit.frame.clone();
        self.channel.offer(now, transmit.from.0, to, frame.len(), Sent { kind, frame });
    }

    /// Updates the hosts' positions from the true positions of their robots, which a simulated world sends after each
    /// step.
    pub fn locate(&mut self, truth: &Truth) {
        for sample in truth.samples.iter() {
            for host in self.hosts_of_robot.get(sample.robot.index()).into_iter().flatten() {
                self.channel.place(host.0, sample.motion.position);
            }
        }
    }

    /// Returns the time at which `wake` is next due, for a transmission or for a report of the counts.
    pub fn wake_at(&self) -> Time {
        self.channel.wake_at().map_or(self.next_counts, |due| due.min(self.next_counts))
    }

    /// Runs the channel up to time `now`, and appends the received frames to `deliveries` in the order of arrival.
    /// Returns the counts of frames and airtime if a report is due (once per second), and `None` otherwise.
    pub fn wake(&mut self, now: Time, deliveries: &mut Vec<Delivery<Sent>>) -> Option<RadioCounts> {
        self.channel.wake(now, deliveries);
        (self.next_counts <= now).then(|| {
            self.next_counts = now.next_on_grid(Span::ZERO, COUNTS_PERIOD);
            self.channel.counts(now)
        })
    }
}
