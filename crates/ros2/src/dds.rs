//! DDS participant of a DDS process (`ros2-node`, the child process of a host that speaks ROS 2), by the crate
//! `rustdds`, which no other file names.
//! QoS: commands RELIABLE, KEEP_LAST 1, VOLATILE, since a best-effort writer never matches a reliable reader.
//! Subscriptions BEST_EFFORT, which match every writer.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rustdds::mio1::{Events, Interest, Poll, Token, Waker, event::Source};
use rustdds::no_key::{DataReaderCdr, DataWriterCdr};
use rustdds::policy::{Durability, History, Liveliness, Reliability};
use rustdds::{
    DataReaderStatus, DataWriterStatus, DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent,
    DomainParticipantStatusListener, EndpointDescription, GUID, QosPolicies, QosPolicyBuilder, StatusEvented, Topic,
    TopicKind,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::messages::{
    BatteryState, Float32MultiArray, Header, LaserScan, Odometry, PoseStamped, PoseWithCovarianceStamped, Stamp, Twist,
    TwistStamped, Typed, Vector3, dds_topic,
};
use super::packet::{Outgoing, Plan, Read, TopicState, Written};
use super::sample::{IntoSample, Sample};

/// Event token of the waker in the `epoll` of a DDS process. The token of each DDS reader is its index.
const WAKER: Token = Token(usize::MAX);
/// Largest number of received messages taken from one topic at a time, so that a flood of them delays no command.
const MOST_SAMPLES: usize = 64;
/// Number of messages that a DDS reader stores until they are taken: those of a tracker at 120 Hz in 0.1 s.
const DEPTH: i32 = 12;
/// Largest number of remote endpoints that are stored for a topic.
const MOST_ENDPOINTS: usize = 256;
/// Longest time that publishing one message may wait for the transport \[ms\]. The longest measured wait, with a halted
/// robot as the subscriber, was 7.6 ms.
const WRITE_MS: i64 = 10;
/// Requested size of the kernel's send and receive buffer of each DDS socket \[bytes\]. The default of `rustdds` is
/// 8 MiB, which is much on a small machine.
const SOCKET_BUFFER: usize = 1 << 20;

/// DDS participant of a DDS process, with publishers and subscribers for the topics of its [`Plan`].
pub struct Dds {
    participant: DomainParticipant,
    listener: DomainParticipantStatusListener,
    poll: Poll,
    events: Events,
    waker: Arc<Waker>,
    writers: Vec<(Outlet, Link)>,
    readers: Vec<(Box<dyn Inlet>, Link)>,
}

/// State of a topic, with its remote endpoints: publishers or subscribers of other programs.
struct Link {
    state: TopicState,
    /// Remote endpoints that DDS has matched. It matches by the topic's name and QoS, so endpoints that use another
    /// message type are included.
    matched: Vec<GUID>,
    /// Remote endpoints that use the topic's name with another message type, or with manual liveliness.
    strangers: Vec<GUID>,
}

/// DDS writer of one published topic, by the type of its messages.
enum Outlet {
    Twist(DataWriterCdr<Twist>),
    /// Writer of `TwistStamped`. The flag is true if messages are stamped with the clock of this machine, false for
    /// stamps of zero.
    TwistStamped(DataWriterCdr<TwistStamped>, bool),
    Odometry(DataWriterCdr<Odometry>),
    Floats(DataWriterCdr<Float32MultiArray>),
}

/// DDS reader of one subscribed topic.
trait Inlet: Send {
    fn source(&mut self) -> &mut dyn Source;
    /// Calls `each` with the content of each received message, or with an error that says what is wrong with it. Takes
    /// at most `MOST_SAMPLES` messages.
    fn take(&mut self, each: &mut dyn FnMut(Result<Sample, String>));
    fn status(&mut self) -> Option<DataReaderStatus>;
    fn type_name(&self) -> &'static str;
}

/// DDS reader of one topic, and the function that reduces a message to its content.
struct Reduced<M: 'static, R> {
    reader: DataReaderCdr<M>,
    reduce: R,
}

impl<M, R> Inlet for Reduced<M, R>
where
    M: Typed + DeserializeOwned + Send + 'static,
    R: Fn(&M) -> Result<Sample, &'static str> + Send,
{
    fn source(&mut self) -> &mut dyn Source {
        &mut self.reader
    }

    fn take(&mut self, each: &mut dyn FnMut(Result<Sample, String>)) {
        // Of several scans the newest one alone counts.
        let mut newest = None;
        for _ in 0..MOST_SAMPLES {
            match self.reader.take_next_sample() {
                Ok(Some(message)) => match (self.reduce)(message.value()) {
                    Ok(scan @ Sample::Scan(_)) => newest = Some(scan),
                    Ok(sample) => each(Ok(sample)),
                    Err(why) => each(Err(format!("a message: {why}"))),
                },
                Ok(None) => break,
                Err(_) => each(Err("a message is not of its type; see what publishes it".to_owned())),
            }
        }
        newest.into_iter().for_each(|scan| each(Ok(scan)));
    }

    fn status(&mut self) -> Option<DataReaderStatus> {
        self.reader.try_recv_status()
    }

    fn type_name(&self) -> &'static str {
        M::TYPE
    }
}

impl Outlet {
    fn status(&self) -> Option<DataWriterStatus> {
        match self {
            Outlet::Twist(writer) => writer.try_recv_status(),
            Outlet::TwistStamped(writer, _) => writer.try_recv_status(),
            Outlet::Odometry(writer) => writer.try_recv_status(),
            Outlet::Floats(writer) => writer.try_recv_status(),
        }
    }

    fn type_name(&self) -> &'static str {
        match self {
            Outlet::Twist(_) => Twist::TYPE,
            Outlet::TwistStamped(..) => TwistStamped::TYPE,
            Outlet::Odometry(_) => Odometry::TYPE,
            Outlet::Floats(_) => Float32MultiArray::TYPE,
        }
    }
}

impl Dds {
    /// Opens a participant with all topics of `plan`, on the network addresses `networks` (empty: on all). The error
    /// says what failed and what to do.
    pub fn open(plan: &Plan, networks: &[IpAddr]) -> Result<Dds, String> {
        let mut builder = DomainParticipantBuilder::new(plan.domain)
            .socket_receive_buffer_size(SOCKET_BUFFER)
            .socket_send_buffer_size(SOCKET_BUFFER);
        if !networks.is_empty() {
            builder = builder.with_only_networks(networks.iter().copied());
        }
        let failed = |what: &str, error: &dyn std::fmt::Debug| format!("{what} failed: {error:?}");
        let participant = builder.build().map_err(|error| {
            let cause = format!("{error:?}");
            format!("no DDS participant in domain {}: {cause}; see `interface`, and ports that are in use", plan.domain)
        })?;
        let poll = Poll::new().map_err(|error| failed("epoll", &error))?;
        let waker = Waker::new(poll.registry(), WAKER).map_err(|error| failed("eventfd", &error))?;
        let (mut writers, mut readers) = (Vec::new(), Vec::new());
        for writer in &plan.writers {
            let outlet = outlet(&participant, &writer.topic, writer.kind)?;
            writers.push((outlet, Link::new(&writer.topic, true)));
        }
        for (index, reader) in plan.readers.iter().enumerate() {
            let mut inlet = inlet(&participant, &reader.topic, reader.kind)?;
            let registered = poll.registry().register(inlet.source(), Token(index), Interest::READABLE);
            registered.map_err(|error| failed("epoll", &error))?;
            readers.push((inlet, Link::new(&reader.topic, false)));
        }
        let listener = participant.status_listener();
        let (events, waker) = (Events::with_capacity(64), Arc::new(waker));
        Ok(Dds { participant, listener, poll, events, waker, writers, readers })
    }

    /// Returns a handle by which another thread makes a blocked call of [`Dds::wait`] return.
    pub fn waker(&self) -> Arc<Waker> {
        Arc::clone(&self.waker)
    }

    /// Blocks until a message arrives, the waker is used, or the time `most` is over.
    pub fn wait(&mut self, most: Duration) {
        // An interrupted wait is as good as one that is over.
        let _ = self.poll.poll(&mut self.events, Some(most));
    }

    /// Takes received messages and calls `each` with the index of the topic in the plan's list `readers` and the
    /// message. A message that cannot be read is recorded as the problem in the topic's state.
    pub fn take(&mut self, mut each: impl FnMut(usize, Sample)) {
        for (index, (inlet, link)) in self.readers.iter_mut().enumerate() {
            inlet.take(&mut |sample| match sample {
                Ok(sample) => each(index, sample),
                Err(why) => (link.state.problem, link.state.refused) = (Some(why), link.state.refused + 1),
            });
        }
    }

    /// Publishes a command for the velocity `[x, y, yaw]` \[m/s, m/s, rad/s\] of a robot along its own axes. `topic` is
    /// an index in the plan's list `writers`.
    pub fn drive(&mut self, topic: usize, [x, y, yaw]: [f64; 3]) {
        let zero = Vector3::default();
        let twist = Twist { linear: Vector3 { x, y, ..zero }, angular: Vector3 { z: yaw, ..zero } };
        // The next command replaces one that finds no room.
        match self.writers.get(topic) {
            Some((Outlet::Twist(writer), _)) => drop(writer.write(twist, None)),
            Some((Outlet::TwistStamped(writer, now), _)) => {
                let stamp = if *now { stamp_of_now() } else { Stamp::default() };
                let header = Header { stamp, frame_id: String::new() };
                drop(writer.write(TwistStamped { header, twist }, None));
            }
            _ => {}
        }
    }

    /// Publishes a message for observers of the team, such as a user of `rviz2`. `topic` is an index in the plan's list
    /// `writers`.
    pub fn publish(&mut self, topic: usize, message: &Outgoing) {
        match (self.writers.get(topic), message) {
            (Some((Outlet::Odometry(writer), link)), Outgoing::Pose(pose)) => {
                let child =
                    link.state.topic.trim_start_matches('/').rsplit_once('/').map_or("robot", |(space, _)| space);
                let mut odometry = pose.to_odometry("map", &format!("{child}/base_link"));
                if odometry.header.stamp == Stamp::default() {
                    odometry.header.stamp = stamp_of_now();
                }
                drop(writer.write(odometry, None));
            }
            (Some((Outlet::Floats(writer), _)), Outgoing::Floats(columns, data)) => {
                let columns = usize::try_from(*columns).unwrap_or(1).max(1);
                let rows = data.len() / columns;
                let array = Float32MultiArray::of_rows(("row", rows), ("column", columns), data.clone());
                drop(writer.write(array, None));
            }
            _ => {}
        }
    }

    /// Whether each topic with velocity commands has at least one subscriber.
    pub fn is_matched(&self) -> bool {
        let is_command = |outlet: &Outlet| matches!(outlet, Outlet::Twist(_) | Outlet::TwistStamped(..));
        self.writers.iter().all(|(outlet, link)| !is_command(outlet) || link.state.peers > 0)
    }

    /// Returns the present state of every topic of the process: the number of remote endpoints, and the newest problem.
    pub fn states(&mut self) -> impl Iterator<Item = &TopicState> {
        self.update();
        self.writers.iter().map(|(_, link)| &link.state).chain(self.readers.iter().map(|(_, link)| &link.state))
    }

    /// Closes the participant and announces to other participants that it leaves.
    pub fn close(self) {
        drop((self.writers, self.readers, self.listener, self.participant));
    }

    fn update(&mut self) {
        for (outlet, link) in &mut self.writers {
            while let Some(status) = outlet.status() {
                match status {
                    DataWriterStatus::PublicationMatched { current, reader, .. } => {
                        link.change(reader, current.count_change() > 0);
                    }
                    DataWriterStatus::OfferedIncompatibleQos { last_policy_id, .. } => {
                        link.state.problem = Some(format!(
                            "a subscriber asks for another QoS policy {last_policy_id:?} and gets nothing; it must \
                             take RELIABLE or BEST_EFFORT, VOLATILE, and no deadline"
                        ));
                    }
                    _ => {}
                }
            }
        }
        for (inlet, link) in &mut self.readers {
            while let Some(status) = inlet.status() {
                match status {
                    DataReaderStatus::SubscriptionMatched { current, writer, .. } => {
                        link.change(writer, current.count_change() > 0);
                    }
                    DataReaderStatus::RequestedIncompatibleQos { last_policy_id, .. } => {
                        link.state.problem = Some(format!(
                            "a publisher offers another QoS policy {last_policy_id:?} and is not heard; it must offer \
                             VOLATILE or more, and no deadline"
                        ));
                    }
                    _ => {}
                }
            }
        }
        while let Some(event) = self.listener.try_recv_status() {
            match event {
                DomainParticipantStatusEvent::ReaderDetected { reader } => {
                    for (outlet, link) in &mut self.writers {
                        link.check_type(outlet.type_name(), &reader);
                        link.check_liveliness(&reader);
                    }
                }
                DomainParticipantStatusEvent::WriterDetected { writer } => {
                    self.readers.iter_mut().for_each(|(inlet, link)| link.check_type(inlet.type_name(), &writer));
                }
                _ => {}
            }
        }
    }
}

impl Link {
    fn new(topic: &str, written: bool) -> Link {
        let state = TopicState { topic: topic.to_owned(), written, peers: 0, problem: None, refused: 0 };
        Link { state, matched: Vec::new(), strangers: Vec::new() }
    }

    fn change(&mut self, endpoint: GUID, matched: bool) {
        self.matched.retain(|other| *other != endpoint);
        if matched && self.matched.len() < MOST_ENDPOINTS {
            self.matched.push(endpoint);
        }
        self.count();
    }

    /// Records `endpoint` as a problem of the topic if it uses the topic's name with a message type other than `ours`.
    fn check_type(&mut self, ours: &str, endpoint: &EndpointDescription) {
        let theirs = &endpoint.type_name;
        if dds_topic(&self.state.topic) != endpoint.topic_name || ours == theirs {
            return;
        }
        // The name comes from outside: it is shortened, and its odd characters are replaced.
        let theirs: String = theirs.chars().take(80).map(|c| if c.is_ascii_graphic() { c } else { '?' }).collect();
        let problem =
            format!("a robot has it as {theirs}, here it is {ours}; set `stamped` for commands, `type` for poses");
        self.leave_out(endpoint, problem);
    }

    /// Records `endpoint` as a problem of the topic if it subscribes with manual liveliness, which the writers of this
    /// process do not offer. `rustdds` 0.15.1 matches it all the same, but other implementations of DDS do not.
    fn check_liveliness(&mut self, endpoint: &EndpointDescription) {
        let automatic = matches!(endpoint.qos.liveliness(), None | Some(Liveliness::Automatic { .. }));
        if dds_topic(&self.state.topic) == endpoint.topic_name && !automatic {
            let why = "a subscriber asks for another QoS policy Liveliness and gets nothing; it must take AUTOMATIC";
            self.leave_out(endpoint, why.to_owned());
        }
    }

    /// Counts `endpoint` no longer as a peer, for the reason `problem`.
    fn leave_out(&mut self, endpoint: &EndpointDescription, problem: String) {
        if self.strangers.len() < MOST_ENDPOINTS && !self.strangers.contains(&endpoint.guid) {
            self.strangers.push(endpoint.guid);
        }
        self.state.problem = Some(problem);
        self.count();
    }

    fn count(&mut self) {
        let peers = self.matched.iter().filter(|endpoint| !self.strangers.contains(endpoint)).count();
        self.state.peers = u32::try_from(peers).unwrap_or(u32::MAX);
    }
}

/// Returns the present time of this machine's clock as the stamp of a ROS message.
fn stamp_of_now() -> Stamp {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Stamp { sec: i32::try_from(now.as_secs()).unwrap_or(i32::MAX), nanosec: now.subsec_nanos() }
}

fn quality(reliability: Reliability, depth: i32) -> QosPolicies {
    QosPolicyBuilder::new()
        .reliability(reliability)
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth })
        .build()
}

/// Creates the DDS topic with messages of the type `M` for a full ROS topic name.
fn topic<M: Typed>(participant: &DomainParticipant, name: &str, quality: &QosPolicies) -> Result<Topic, String> {
    let topic = participant.create_topic(dds_topic(name), M::TYPE.to_owned(), quality, TopicKind::NoKey);
    topic.map_err(|error| format!("{name} cannot be created: {error:?}; start the host again"))
}

fn outlet(participant: &DomainParticipant, name: &str, kind: Written) -> Result<Outlet, String> {
    Ok(match kind {
        Written::Twist => Outlet::Twist(writer(participant, name)?),
        Written::TwistUnstamped => Outlet::TwistStamped(writer(participant, name)?, false),
        Written::TwistStamped => Outlet::TwistStamped(writer(participant, name)?, true),
        Written::Odometry => Outlet::Odometry(writer(participant, name)?),
        Written::Floats => Outlet::Floats(writer(participant, name)?),
    })
}

fn writer<M: Typed + Serialize>(participant: &DomainParticipant, name: &str) -> Result<DataWriterCdr<M>, String> {
    let max_blocking_time = rustdds::Duration::from_millis(WRITE_MS);
    let quality = quality(Reliability::Reliable { max_blocking_time }, 1);
    let topic = topic::<M>(participant, name, &quality)?;
    let publisher = participant.create_publisher(&quality);
    let writer = publisher.and_then(|publisher| publisher.create_datawriter_no_key_cdr::<M>(&topic, Some(quality)));
    writer.map_err(|error| format!("{name} cannot be published: {error:?}; start the host again"))
}

fn inlet(participant: &DomainParticipant, name: &str, kind: Read) -> Result<Box<dyn Inlet>, String> {
    match kind {
        Read::Odometry => reader(participant, name, Odometry::sample),
        Read::PoseStamped => reader(participant, name, PoseStamped::sample),
        Read::PoseWithCovarianceStamped => reader(participant, name, PoseWithCovarianceStamped::sample),
        Read::Battery => reader(participant, name, BatteryState::sample),
        Read::LaserScan(fan) => reader(participant, name, move |scan: &LaserScan| fan.take(scan).map(Sample::Scan)),
    }
}

fn reader<M, R>(participant: &DomainParticipant, name: &str, reduce: R) -> Result<Box<dyn Inlet>, String>
where
    M: Typed + DeserializeOwned + Send + 'static,
    R: Fn(&M) -> Result<Sample, &'static str> + Send + 'static,
{
    let quality = quality(Reliability::BestEffort, DEPTH);
    let topic = topic::<M>(participant, name, &quality)?;
    let subscriber = participant.create_subscriber(&quality);
    let reader = subscriber.and_then(|subscriber| subscriber.create_datareader_no_key_cdr::<M>(&topic, Some(quality)));
    let reader = reader.map_err(|error| format!("{name} cannot be subscribed to: {error:?}; start the host again"))?;
    Ok(Box::new(Reduced { reader, reduce }))
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use rustdds::no_key::{DeserializerAdapter, SerializerAdapter};
    use rustdds::{CDRDeserializerAdapter, CDRSerializerAdapter, RepresentationIdentifier};

    use super::super::messages::{
        Covariance, Dimension, MultiArrayLayout, Pose, PoseWithCovariance, Quaternion, TwistWithCovariance,
    };
    use super::*;

    /// CDR of messages as rclpy Kilted (Fast CDR) writes them: `peers/fixtures.py`.
    const RCLPY: &str = include_str!("../data/ros2_cdr.txt");

    fn bytes_of(name: &str) -> Vec<u8> {
        let line = RCLPY.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')).unwrap();
        let byte = |at: usize| u8::from_str_radix(&line[at..at + 2], 16).unwrap();
        // The first four bytes name the encoding, and are no part of the message.
        (8..line.len()).step_by(2).map(byte).collect()
    }

    fn decoded<M: DeserializeOwned>(bytes: &[u8]) -> Option<M> {
        CDRDeserializerAdapter::from_bytes(bytes, RepresentationIdentifier::CDR_LE).ok()
    }

    /// Checks that the bytes of rclpy are this message, and those of this program have the same length and meaning.
    fn agrees<M: Serialize + DeserializeOwned + PartialEq + Debug>(name: &str, message: M) {
        let theirs = bytes_of(name);
        assert_eq!(decoded::<M>(&theirs).as_ref(), Some(&message), "{name}");
        let ours = CDRSerializerAdapter::<M>::to_bytes(&message).unwrap();
        // Fast CDR does not clear its padding, so the bytes themselves may differ.
        assert_eq!(ours.len(), theirs.len(), "{name}");
        assert_eq!(decoded::<M>(&ours), Some(message), "{name}");
        for end in 0..theirs.len() {
            assert_eq!(decoded::<M>(&theirs[..end]), None, "{name}: {end}");
        }
    }

    fn vector(base: f64) -> Vector3 {
        Vector3 { x: base + 0.25, y: base + 0.5, z: base + 0.75 }
    }

    #[test]
    fn messages_are_read_and_written_as_by_rclpy() {
        let header = Header { stamp: Stamp { sec: 1_700_000_001, nanosec: 123_456_789 }, frame_id: "map".to_owned() };
        let twist = Twist { linear: vector(2.0), angular: vector(3.0) };
        let pose = Pose { position: vector(1.0), orientation: Quaternion { x: 0.1, y: 0.2, z: 0.3, w: 0.9 } };
        let covariance: Covariance = std::array::from_fn(|row| std::array::from_fn(|at| (6 * row + at) as f64 + 0.5));
        let (poses, twists) = (PoseWithCovariance { pose, covariance }, TwistWithCovariance { twist, covariance });
        agrees("Twist", twist);
        agrees("TwistStamped", TwistStamped { header: header.clone(), twist });
        agrees("PoseStamped", PoseStamped { header: header.clone(), pose });
        agrees("PoseWithCovarianceStamped", PoseWithCovarianceStamped { header: header.clone(), pose: poses });
        let child_frame_id = "r1/base_link".to_owned();
        agrees("Odometry", Odometry { header: header.clone(), child_frame_id, pose: poses, twist: twists });
        let battery = BatteryState {
            header: header.clone(),
            voltage: 12.5,
            temperature: 31.0,
            current: -1.5,
            charge: 2.5,
            capacity: 5.0,
            design_capacity: 5.5,
            percentage: 0.5,
            power_supply_status: 2,
            power_supply_health: 1,
            power_supply_technology: 3,
            present: true,
            cell_voltage: vec![4.0, 4.25],
            cell_temperature: vec![30.0],
            location: "rear".to_owned(),
            serial_number: "s-1".to_owned(),
        };
        agrees("BatteryState", battery);
        let header = Header { frame_id: "laser".to_owned(), ..header };
        let scan = LaserScan {
            header,
            angle_min: -1.5,
            angle_max: 1.5,
            angle_increment: 1.5,
            time_increment: 0.25,
            scan_time: 0.125,
            range_min: 0.5,
            range_max: 8.0,
            ranges: vec![1.0, f32::INFINITY, 2.5],
            intensities: vec![10.0],
        };
        agrees("LaserScan", scan);
        let dimension = |label: &str, stride| Dimension { label: label.to_owned(), size: 2, stride };
        let layout = MultiArrayLayout { dim: vec![dimension("row", 4), dimension("column", 2)], data_offset: 0 };
        agrees("Float32MultiArray", Float32MultiArray { layout, data: vec![1.0, 2.0, 3.0, 4.5] });
    }
}
