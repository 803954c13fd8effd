//! The wire: every valid message is encoded and decoded unchanged, and everything else is refused.

use std::sync::Arc;

use murmurate::messages::geometry::{Deviation, Motion, Pose, Task, Twist, Vec2};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::place::{Located, Place, PlaceAnswer, Placed, Whereabouts};
use murmurate::messages::trigger::Trigger;
use murmurate::messages::wire::{
    Aloft, Celsius, Condition, Cut, Encoding, Features, Flight, Following, GuardReport, Health, Heartbeat, Hindrance,
    Latent, Leading, MAX_BLOCK, MAX_CONDITIONS, MAX_FEATURES, MAX_HINDRANCES, MAX_MEMBERS, MAX_VALIDITY, MAX_VALUES,
    Mode, MotorCommand, Observe, Phase, Reading, Reason, Release, Round, Seen, Sensed, Signature, Status, Stop,
    Telemetry, Wire,
};
use murmurate::net::protocol::codec::{
    BLOCK_BYTES, Content, DecodeError, EncodeError, Flags, Frame, HEADER_BYTES, Header, MAX_FRAME_BYTES,
    MAX_PLAIN_BYTES, TAG_BYTES, VERSION, decode, encode, is_current, peek,
};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::parts::split;
use murmurate::time::Span;
use proptest::prelude::*;

const HEADER: Header =
    Header { flags: Flags(Flags::DIRECT), team: 7, sender: HostId(3), incarnation: 2, sequence: u32::MAX };

fn send(message: &Wire) -> Frame {
    encode(&HEADER, message).expect("a sound message can be sent")
}

fn motion() -> impl Strategy<Value = Motion> {
    let float = || -1e5f32..1e5;
    (float(), float(), float(), float())
        .prop_map(|(x, y, vx, vy)| Motion { position: Vec2::new(x, y), velocity: Vec2::new(vx, vy) })
}

fn pose() -> impl Strategy<Value = Pose> {
    (motion(), prop::option::of(-3.1f32..3.1)).prop_map(|(motion, heading)| Pose { position: motion.position, heading })
}

fn phase() -> impl Strategy<Value = Phase> {
    (0u8..8).prop_map(Phase::from)
}

fn round() -> impl Strategy<Value = Round> {
    (0..=1u32 << 30, any::<u32>()).prop_map(|(term, episode)| Round { term, episode })
}

fn latch() -> impl Strategy<Value = Latch> {
    let latch = |(number, state): (u64, usize)| [Latch::clear, Latch::held, Latch::engaged][state](number);
    (0..=1u64 << 52, 0usize..3).prop_map(latch)
}

fn robot() -> impl Strategy<Value = RobotId> {
    any::<u16>().prop_map(RobotId)
}

/// Returns placements of robots, and reports of whether the poses of robots are known.
fn placements() -> (impl Strategy<Value = Wire>, impl Strategy<Value = Wire>) {
    let numbers = (any::<u16>(), any::<u32>(), robot());
    let place = (numbers, pose())
        .prop_map(|((by, number, robot), pose)| Wire::Place(Place { by: HostId(by), number, robot, pose }));
    let whereabouts = (robot(), 0u8..5).prop_map(|(robot, n)| (robot, Whereabouts::from(n)));
    let verdict = (0u8..5).prop_map(PlaceAnswer::from);
    let answer = ((any::<u16>(), any::<u32>(), robot()), verdict, prop::option::of(pose()));
    let answer = answer.prop_map(|((by, number, robot), verdict, measured)| Placed {
        by: HostId(by),
        number,
        robot,
        verdict,
        measured,
    });
    let located = (any::<u16>(), prop::collection::vec(whereabouts, 0..=MAX_BLOCK), prop::option::of(answer));
    let located =
        located.prop_map(|(host, robots, answer)| Wire::Located(Located { host: HostId(host), robots, answer }));
    (place, located)
}

/// One of the parts of a latent that travels in parts.
fn part() -> impl Strategy<Value = Wire> {
    let wide = (robot(), round(), phase(), motion(), 1..=6144usize, 0..4usize, any::<u16>(), any::<u32>());
    wide.prop_map(|(robot, round, phase, motion, floats, encoding, message, policy)| {
        let encoding = Encoding::ALL[encoding];
        let mut floats: Vec<f32> = (0..floats).map(|at| at as f32 - 100.5).collect();
        encoding.round(&mut floats);
        let whole = Latent { robot, round, phase, motion, features: Features(floats.into()), part: None };
        let mut parts = split(&whole, encoding, (message, policy), 1024);
        Wire::Latent(parts.swap_remove(usize::from(message) % parts.len()))
    })
}

fn beat() -> impl Strategy<Value = Wire> {
    let beat = (robot(), round(), phase(), latch(), any::<(u16, u32, u32)>());
    beat.prop_map(|(robot, round, phase, latch, (revision, policy, task))| {
        // It is sent with a policy alone.
        let task = if policy == 0 { 0 } else { task };
        Wire::Heartbeat(Heartbeat { revision, policy, task, ..Heartbeat::new(robot, round, phase, latch) })
    })
}

fn message() -> impl Strategy<Value = Wire> {
    let deviation = [0; 4].map(|_| prop::option::of(0f32..1e5));
    let deviation = deviation.prop_map(|[position_m, heading_rad, velocity_m_s, yaw_rate_rad_s]| Deviation {
        position_m,
        heading_rad,
        velocity_m_s,
        yaw_rate_rad_s,
    });
    let yaw_rate = prop::option::of(-1e5f32..1e5);
    let reading = (robot(), any::<u64>(), pose(), motion(), yaw_rate, deviation).prop_map(
        |(robot, stamp_ns, pose, Motion { velocity, .. }, yaw_rate, deviation)| {
            Wire::Reading(Reading { robot, stamp_ns, pose, twist: Twist { velocity, yaw_rate }, deviation })
        },
    );
    let features = prop::collection::vec(-1e3f32..1e3, 0..=MAX_FEATURES).prop_map(|floats| Features(Arc::from(floats)));
    let latent = (robot(), round(), phase(), motion(), features).prop_map(|(robot, round, phase, motion, features)| {
        Wire::Latent(Latent { robot, round, phase, motion, features, part: None })
    });
    let command = (robot(), motion(), 0..=MAX_VALIDITY.as_nanos()).prop_map(|(robot, motion, ns)| {
        Wire::MotorCommand(MotorCommand { robot, velocity: motion.velocity, valid_for: Span::from_nanos(ns) })
    });
    let tasks = prop::collection::vec(motion(), 1..=MAX_BLOCK);
    let mode = (round(), any::<u32>(), phase(), 0u16..1000, tasks, latch());
    let mode = mode.prop_map(|(round, repeat, phase, first, tasks, latch)| {
        let task = |motion: Motion| Task { start: motion.position, goal: motion.velocity };
        let tasks = tasks.into_iter().map(task).collect();
        Wire::Mode(Mode { round, repeat, phase, first: RobotId(first), tasks, latch })
    });
    let stop = (any::<u16>(), latch()).prop_map(|(by, latch)| Wire::Stop(Stop { by: HostId(by), latch }));
    let following = (robot(), prop::option::of(latch()), prop::option::of(latch()))
        .prop_map(|(robot, controller, body)| Following { robot, controller, body });
    let hindrance = (robot(), 0u8..3).prop_map(|(robot, n)| (robot, Hindrance::from(n)));
    let leading = (latch(), prop::collection::vec(hindrance, 0..=MAX_HINDRANCES));
    let leading = leading.prop_map(|(latch, hindrances)| Leading { latch, hindrances });
    let robots = prop::collection::vec(following, 0..=MAX_BLOCK);
    let status = (any::<u16>(), any::<bool>(), robots, prop::option::of(leading), any::<u16>()).prop_map(
        |(host, leaves, robots, leading, revision)| {
            Wire::Status(Status { revision, ..Status::of(HostId(host), leaves, robots, leading) })
        },
    );
    let observe = any::<u16>().prop_map(|by| Wire::Observe(Observe { by: HostId(by) }));
    let seen = (pose(), any::<u32>()).prop_map(|(pose, age_ms)| Seen { pose, age_ms });
    let health = (0u8..3).prop_map(Health::from);
    let temperature = prop::option::of((-40.0f32..215.0).prop_map(|c| Celsius::of(c).expect("it is in range")));
    let body = prop::option::of((health, any::<u8>()));
    let trigger = prop::option::of((0u8..12).prop_map(|n| Trigger::try_from(n).expect("there are twelve")));
    let guard = (any::<u16>(), any::<u16>(), trigger);
    let guard = guard.prop_map(|(acted, late_ticks, last)| GuardReport { acted, late_ticks, last });
    let links = (prop::option::of(guard), prop::option::of(any::<u16>()));
    let condition = (robot(), prop::option::of((phase(), seen)), body, temperature, links);
    let condition = condition.prop_map(|(robot, mind, body, temperature, (guard, link_age_ms))| {
        let (phase, seen) = mind.unzip();
        let (health, battery) = body.unzip();
        Condition { robot, phase, seen, health, battery, temperature, reason: None, guard, link_age_ms, suspect: None }
    });
    let conditions = prop::collection::vec(condition, 0..=MAX_CONDITIONS);
    let telemetry = (any::<u16>(), conditions, "[a-z ]{0,90}", prop::option::of(robot()));
    let telemetry = telemetry.prop_map(|(host, mut robots, text, suspect)| {
        robots.iter_mut().take(1).for_each(|robot| robot.reason = Reason::new(&text));
        robots.iter_mut().take(2).for_each(|robot| robot.suspect = suspect);
        Wire::Telemetry(Telemetry::of(HostId(host), robots))
    });
    let (place, located) = placements();
    let (measured, said) = (prop_oneof![reading, sensed()], prop_oneof![latent, part()]);
    let flight = prop_oneof![aloft(), cut()];
    let ordered = prop_oneof![command, flight];
    prop_oneof![measured, said, ordered, beat(), mode, stop, status, observe, telemetry, place, located, release()]
}

fn aloft() -> impl Strategy<Value = Wire> {
    (robot(), 0..4u8).prop_map(|(robot, flight)| Wire::Aloft(Aloft { robot, flight: Flight::from(flight) }))
}

fn cut() -> impl Strategy<Value = Wire> {
    (any::<u16>(), robot()).prop_map(|(by, robot)| Wire::Cut(Cut { by: HostId(by), robot }))
}

/// Returns values of senses, of which some are no echoes.
fn sensed() -> impl Strategy<Value = Wire> {
    let value = prop_oneof![4 => -1e6f32..=1e6, 1 => Just(f32::INFINITY)];
    let values = prop::collection::vec(value, 1..=3 * MAX_VALUES);
    (robot(), any::<u8>(), any::<u64>(), values, any::<prop::sample::Index>()).prop_map(
        |(robot, sense, stamp_ns, values, at)| {
            let all = Sensed::split(robot, sense, stamp_ns, &values).expect("they can be sent");
            Wire::Sensed(at.get(&all).clone())
        },
    )
}

fn release() -> impl Strategy<Value = Wire> {
    let hosts = prop::collection::vec((any::<u16>().prop_map(HostId), any::<u32>()), 0..=MAX_MEMBERS);
    (any::<u16>(), latch(), hosts, prop::array::uniform32(any::<u8>())).prop_map(|(by, latch, hosts, half)| {
        let signature = Signature(std::array::from_fn(|at| half[at % 32]));
        Wire::Release(Release { by: HostId(by), latch, hosts, signature })
    })
}

fn latent(features: Vec<f32>) -> Wire {
    Wire::Latent(Latent {
        robot: RobotId(u16::MAX),
        round: Round { term: 1 << 30, episode: u32::MAX },
        phase: Phase::Running,
        motion: Motion { position: Vec2::new(1.25, -2.5), velocity: Vec2::new(0.5, 1.5) },
        features: Features(Arc::from(features)),
        part: None,
    })
}

proptest! {
    #[test]
    fn a_valid_message_is_decoded_unchanged(message in message()) {
        let frame = send(&message);
        prop_assert!(frame.len() <= MAX_PLAIN_BYTES);
        prop_assert_eq!(decode(&frame), Ok((HEADER, message.clone())));
    }

    #[test]
    fn a_truncated_or_extended_frame_is_refused(message in message(), extra in any::<u8>()) {
        let frame = send(&message);
        for length in 0..frame.len() {
            prop_assert!(decode(&frame[..length]).is_err(), "the first {length} bytes are no frame");
        }
        let mut longer = frame.to_vec();
        longer.push(extra);
        prop_assert!(decode(&longer).is_err(), "a byte too many");
    }

    #[test]
    fn a_flipped_bit_is_refused_or_gives_another_valid_message(message in message()) {
        let frame = send(&message);
        for bit in 0..frame.len() * 8 {
            let mut turned = frame.to_vec();
            turned[bit / 8] ^= 1 << (bit % 8);
            if let Ok((header, other)) = decode(&turned) {
                prop_assert!(other.check().is_ok());
                // A trigger of a later version reads like none.
                let unknown = !is_current(&turned) || matches!(message, Wire::Telemetry(_));
                prop_assert!(unknown || (header, other) != (HEADER, message.clone()), "bit {bit} counts");
            }
        }
    }

    #[test]
    fn noise_is_refused_and_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..1400), kind in 0u8..9) {
        let _ = decode(&bytes);
        // Noise after a valid header reaches later checks.
        let mut frame = encode(&HEADER, &latent(Vec::new())).expect("a sound message").to_vec();
        frame.truncate(HEADER_BYTES);
        let length = u16::try_from(bytes.len()).expect("a short body").to_le_bytes();
        frame.extend_from_slice(&[kind, length[0], length[1]]);
        frame.extend(bytes);
        if let Ok((_, message)) = decode(&frame) {
            prop_assert!(message.check().is_ok());
        }
    }
}

#[test]
fn invalid_numbers_are_refused_at_both_ends() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 2e6] {
        let message = latent(vec![0.0, bad]);
        assert!(matches!(encode(&HEADER, &message), Err(EncodeError::Unfit(..))));
        // Changed after encoding: the last four bytes are the last feature.
        let mut frame = send(&latent(vec![0.0, 0.0])).to_vec();
        let at = frame.len() - 4;
        frame[at..].copy_from_slice(&bad.to_le_bytes());
        assert!(matches!(decode(&frame), Err(DecodeError::Unfit(..))));
    }
}

#[test]
fn another_version_and_another_kind_are_refused() {
    let frame = send(&latent(vec![0.0; 32]));
    let with = |at: usize, byte: u8| {
        let mut frame = frame.to_vec();
        frame[at] = byte;
        decode(&frame)
    };
    assert_eq!(with(0, VERSION + 1), Err(DecodeError::Version(VERSION + 1)));
    assert_eq!(with(HEADER_BYTES, 200), Err(DecodeError::Link(Content::Other(200))));
    assert_eq!(with(1, 0x81), Err(DecodeError::Flags(0x81)));
    assert_eq!(decode(&[VERSION; 5]), Err(DecodeError::Length(5)));
    assert_eq!(peek(&vec![VERSION; MAX_FRAME_BYTES + 1]), Err(DecodeError::Length(MAX_FRAME_BYTES + 1)));
}

#[test]
fn limits_hold_when_sending() {
    let unfit = |message: Wire| matches!(encode(&HEADER, &message), Err(EncodeError::Unfit(..)));
    assert!(unfit(latent(vec![0.0; MAX_FEATURES + 1])));
    let velocity = Vec2::zeros();
    let valid_for = MAX_VALIDITY + Span::from_nanos(1);
    assert!(unfit(Wire::MotorCommand(MotorCommand { robot: RobotId(0), velocity, valid_for })));
    let mode = |first: u16, count: usize| {
        let task = Task { start: Vec2::zeros(), goal: Vec2::zeros() };
        let tasks = vec![task; count].into();
        let (round, phase, latch) = (Round::default(), Phase::Running, Latch::default());
        Wire::Mode(Mode { round, repeat: 0, phase, first: RobotId(first), tasks, latch })
    };
    assert!(unfit(mode(0, 0)) && unfit(mode(0, MAX_BLOCK + 1)) && unfit(mode(u16::MAX, 2)));
    assert!(send(&mode(1000, MAX_BLOCK)).len() <= MAX_FRAME_BYTES);
    // The largest messages also fit where blocks are encrypted.
    let room = Key::new([7; 32]).confidential().room();
    let longest = [mode(1000, MAX_BLOCK), latent(vec![0.5; 256])].map(|message| send(&message).len());
    assert!(longest.iter().all(|length| *length <= room), "{longest:?} of {room}");
}

#[test]
fn a_published_latent_is_small() {
    // 32 floats, with every integer at its maximum: header, block and body, and the tag of a team with a key.
    let datagram = send(&latent(vec![0.5; 32])).len() + TAG_BYTES;
    const ETHERNET_IP_UDP: usize = 14 + 20 + 8;
    assert!(datagram + ETHERNET_IP_UDP <= 240, "{datagram} bytes");
    const { assert!(HEADER_BYTES + BLOCK_BYTES + TAG_BYTES <= 40, "header and tag take at most 40 bytes") };
}
