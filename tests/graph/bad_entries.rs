//! Random situations of sources: bad entries, silence, repeated and late packets. A bad entry costs itself alone, and
//! what `doctor` says of the readings is what the host of the robot does with them.

use std::collections::{BTreeMap, BTreeSet};

use murmurate::actor::Core;
use murmurate::actors::cache::{self, Cache};
use murmurate::edge::Settings;
use murmurate::estimation;
use murmurate::fitness::Fitness;
use murmurate::hearing::{CommRange, Handling};
use murmurate::localization::check::{Needs, Track};
use murmurate::localization::{In, Out, Source};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::registry::Registry;
use murmurate::time::{Span, Time};
use murmurate_ros2::packet::{self, FromNode, PoseSample, ReceivedMessage, Sample};

use crate::natnet::fake::{self, Body, Scene};

/// Number of random situations.
const SITUATIONS: u64 = 1000;
/// Length of a situation \[ms\].
const LENGTH_MS: u64 = 4000;
/// Period of control ticks \[ms\].
const TICK_MS: u64 = 50;

/// A source with its robots, the period of its packets and the age at which its robots stop.
struct Kind {
    name: &'static str,
    settings: &'static str,
    robots: u16,
    period_ms: u64,
    own_state: Span,
}

const KINDS: [Kind; 4] = [
    Kind {
        name: "natnet",
        settings: "server = '127.0.0.1'\nbodies = { 0 = 7, 1 = 8 }",
        robots: 2,
        period_ms: 10,
        own_state: Span::from_millis(100),
    },
    Kind {
        name: "gpsd",
        settings: "origin_latitude_deg = 52.2053\norigin_longitude_deg = 0.1218",
        robots: 1,
        period_ms: 100,
        own_state: Span::from_millis(250),
    },
    Kind {
        name: "program",
        settings: "command = ['true']",
        robots: 2,
        period_ms: 20,
        own_state: Span::from_millis(100),
    },
    Kind { name: "ros2", settings: "", robots: 2, period_ms: 20, own_state: Span::from_millis(100) },
];

/// What happens in one situation.
struct Situation<'a> {
    kind: &'a Kind,
    /// Robot with bad entries; that of nobody if it is not one of the source's.
    spoiled: u16,
    /// Packets with a bad entry, by number, each with the kind of its mistake.
    bad: BTreeMap<u64, u32>,
    /// Time in which the source is silent \[ms\].
    silence: std::ops::Range<u64>,
    /// Packets that come twice.
    twice: BTreeSet<u64>,
}

fn situation(random: &mut Stream) -> Situation<'static> {
    let kind = &KINDS[random.random_range(0..KINDS.len())];
    let packets = LENGTH_MS / kind.period_ms;
    let share = [0.0, 0.02, 0.2][random.random_range(0..3)];
    let mut bad = BTreeMap::new();
    for at in 0..packets {
        if random.random::<f64>() < share {
            bad.insert(at, random.random_range(0..8));
        }
    }
    let silence = match random.random_range(0..3) {
        0 => 0..0,
        1 => random.random_range(1000..LENGTH_MS)..LENGTH_MS,
        _ => {
            let begin = random.random_range(500..3000);
            begin..begin + random.random_range(50..1500)
        }
    };
    let twice = (0..packets).filter(|_| random.random::<f64>() < 0.05).collect();
    Situation { kind, spoiled: random.random_range(0..3), bad, silence, twice }
}

fn source(kind: &Kind) -> Box<dyn Source> {
    let settings = Settings { name: kind.name.to_owned(), table: kind.settings.parse().expect("it is TOML") };
    let robots: Vec<RobotId> = (0..kind.robots).map(RobotId).collect();
    (murmurate_ros2::add(murmurate_devices::add(Registry::builtin()))
        .source(&settings, &robots)
        .unwrap_or_else(|error| panic!("{error}"))
        .source)()
}

/// Place of a robot at a time \[ms\]: robot 0 drives at 0.1 m/s.
fn place(robot: u16, ms: u64) -> [f64; 2] {
    if robot == 0 { [1e-4 * ms as f64, 0.0] } else { [1.0, 1.0] }
}

/// Packets of a source at a time \[ms\], with a bad entry of the robot `bad.0` if there is one.
fn packets(kind: &Kind, number: u64, ms: u64, bad: Option<(u16, u32)>) -> Vec<Vec<u8>> {
    let mistake = |robot: u16| bad.filter(|(spoiled, _)| *spoiled == robot).map(|(_, mistake)| mistake);
    match kind.name {
        "natnet" => of_natnet(number, ms, mistake),
        "gpsd" => of_gpsd(ms, mistake),
        "program" => of_program(ms, mistake),
        _ => of_ros2(ms, mistake),
    }
}

fn of_natnet(number: u64, ms: u64, mistake: impl Fn(u16) -> Option<u32>) -> Vec<Vec<u8>> {
    let mut bodies = Vec::new();
    for robot in 0..3 {
        let [x, y] = place(robot, ms);
        let mut body = Body::standing("", [7, 8, 99][usize::from(robot)], [x as f32, 0.1, -y as f32], 0.3);
        match mistake(robot) {
            None => {}
            Some(0 | 1) => body.rotation = [0.0; 4],
            Some(2) => body.rotation = [0.0, 0.0, 0.5, 0.5],
            Some(3) => body.rotation[2] = f32::NAN,
            Some(4 | 5) => body.position[0] = f32::NAN,
            Some(6) => body.position = [f32::MAX; 3],
            Some(_) => body.error_m = f32::INFINITY,
        }
        bodies.push(body);
    }
    let (number, stamp_s) = (number as i32, ms as f64 * 1e-3);
    let scene = Scene { number, stamp_s, models_changed: false, bodies, extras: 1 };
    vec![fake::frame([4, 1], &scene)]
}

fn of_gpsd(ms: u64, mistake: impl Fn(u16) -> Option<u32>) -> Vec<Vec<u8>> {
    // 68.35 km a degree at this latitude.
    let longitude = format!("{:.9}", 0.1218 + place(0, ms)[0] / 68_350.0);
    let time = format!("2026-11-22T12:00:{:06.3}Z", ms as f64 * 1e-3);
    let good = format!(
        "{{\"class\":\"TPV\",\"mode\":3,\"status\":3,\"time\":\"{time}\",\"lat\":52.2053,\"lon\":{longitude},\
         \"altHAE\":50.0,\"track\":0.0,\"speed\":0.1}}"
    );
    let line = match mistake(0) {
        None => good,
        Some(0) => good.replace("52.", "-52."),
        Some(1) => good.replace(&longitude, "NaN"),
        Some(2) => good.replace("\"mode\":3", "\"mode\":1"),
        Some(3) => good.replace("\"speed\":0.1", "\"speed\":1e300"),
        Some(4) => good.replace(&time, "yesterday"),
        Some(5) => good[..good.len() / 2].to_owned(),
        Some(6) => good.replace("\"status\":3", "\"status\":8"),
        Some(_) => good.replace(&format!(",\"lon\":{longitude}"), ""),
    };
    vec![line.into_bytes()]
}

fn of_program(ms: u64, mistake: impl Fn(u16) -> Option<u32>) -> Vec<Vec<u8>> {
    (0..2)
        .map(|robot| {
            let ([x, y], stamp) = (place(robot, ms), ms as f64 * 1e-3);
            let good = format!(
                "{{\"robot\":{robot},\"stamp_s\":{stamp},\"x\":{x},\"y\":{y},\"vx\":0.1,\"vy\":0.0,\
                     \"heading\":0.5}}"
            );
            let line = match mistake(robot) {
                None => good,
                Some(0) => good.replace("\"vx\":0.1", "\"vx\":NaN"),
                Some(1) => good.replace("\"heading\":0.5", "\"heading\":7.0"),
                Some(2) => good.replace("\"vy\":0.0", "\"vy\":1e9"),
                Some(3) => good.replace(",\"vy\":0.0", ""),
                Some(4) => good.replace("0.5}", "0.5,\"colour\":1}"),
                Some(5) => "Traceback (most recent call last):".to_owned(),
                Some(6) => good.replace(&format!("\"stamp_s\":{stamp}"), "\"stamp_s\":-1"),
                Some(_) => good.replace(&format!("\"robot\":{robot}"), "\"robot\":9"),
            };
            line.into_bytes()
        })
        .collect()
}

fn of_ros2(ms: u64, mistake: impl Fn(u16) -> Option<u32>) -> Vec<Vec<u8>> {
    (0..2)
        .map(|robot| {
            let [x, y] = place(robot, ms);
            let stamp_ns = (ms + 1000) * 1_000_000;
            let pose = PoseSample { stamp_ns, x, y, yaw: Some(0.5), ..PoseSample::default() };
            let heard = |topic, pose| {
                packet::encode(&FromNode::Received(ReceivedMessage { topic, sample: Sample::Pose(pose) }))
            };
            match mistake(robot) {
                None => heard(robot, pose),
                Some(0 | 1) => heard(robot, PoseSample { x: 1e9, ..pose }),
                Some(2) => heard(200, pose),
                Some(3) => heard(robot, PoseSample { position_m: Some(-1.0), ..pose }),
                Some(4) => {
                    packet::encode(&FromNode::Received(ReceivedMessage { topic: robot, sample: Sample::Battery(None) }))
                }
                Some(5) => vec![b'x'; 20_000],
                Some(6) => b"{}".to_vec(),
                Some(_) => heard(robot, pose)[..20].to_vec(),
            }
        })
        .collect()
}

/// Runs a situation, with or without its bad entries. Returns the readings of each robot with their arrivals \[ms\].
fn run(situation: &Situation, spoil: bool) -> BTreeMap<RobotId, Vec<(u64, Reading)>> {
    let Situation { kind, spoiled, bad, silence, twice } = situation;
    let (mut source, mut readings) = (source(kind), BTreeMap::<RobotId, Vec<(u64, Reading)>>::new());
    for number in 0..LENGTH_MS / kind.period_ms {
        let ms = number * kind.period_ms;
        if silence.contains(&ms) {
            continue;
        }
        let mistake = bad.get(&number).filter(|_| spoil).map(|mistake| (*spoiled, *mistake));
        for _ in 0..1 + u32::from(twice.contains(&number)) {
            for packet in packets(kind, number, ms, mistake) {
                let mut out = Vec::new();
                source.take(Time::ZERO + Span::from_millis(ms), In::Packet(&packet), &mut out);
                for said in out {
                    if let Out::Reading(reading) = said {
                        readings.entry(reading.robot).or_default().push((ms, reading));
                    }
                }
            }
        }
    }
    readings
}

/// Control ticks of a robot's host, as times \[ms\] and whether the robot knew where it is.
fn ticks(kind: &Kind, robot: RobotId, readings: &[(u64, Reading)]) -> Vec<(u64, bool)> {
    let config = cache::Config {
        robot,
        period: Span::from_millis(TICK_MS),
        phase: Span::ZERO,
        range: CommRange::fixed(2.0),
        hold: Span::from_millis(80),
        handling: Handling::Hold,
        estimator: estimation::REGISTRY[0],
        sensor_delay: Span::ZERO,
        own_age: kind.own_state,
        limit_m_s: 1.5,
        senses: 0,
    };
    let mut cache = Cache::new(config, Seed::of_run(0).stream("cache"));
    let (mut next, mut ticks) = (readings.iter().peekable(), Vec::new());
    for ms in (0..=LENGTH_MS).step_by(TICK_MS as usize) {
        let mut out = Vec::new();
        while let Some((at, reading)) = next.next_if(|(at, _)| *at <= ms) {
            let at = Time::ZERO + Span::from_millis(*at);
            cache.handle(at, cache::In::Reading(reading.clone()), &mut out);
        }
        out.clear();
        cache.wake(Time::ZERO + Span::from_millis(ms), &mut out);
        ticks.push((ms, out.iter().any(|out| matches!(out, cache::Out::Percept(_)))));
    }
    ticks
}

#[test]
fn a_bad_entry_costs_itself_alone_in_every_source() {
    let mut random = Seed::of_run(44).stream("entries");
    let (mut spoiled, mut lost) = (0, 0);
    for number in 0..SITUATIONS {
        let situation = situation(&mut random);
        let (clean, dirty) = (run(&situation, false), run(&situation, true));
        let bad: BTreeSet<u64> = situation.bad.keys().map(|at| at * situation.kind.period_ms).collect();
        for robot in (0..situation.kind.robots).map(RobotId) {
            let all =
                |readings: &BTreeMap<RobotId, Vec<(u64, Reading)>>| readings.get(&robot).cloned().unwrap_or_default();
            let (clean, dirty) = (all(&clean), all(&dirty));
            let name = situation.kind.name;
            if robot.0 != situation.spoiled {
                assert_eq!(clean, dirty, "{name} {number}: {robot} is not concerned");
                continue;
            }
            let kept: BTreeSet<u64> = dirty.iter().map(|(ms, _)| *ms).collect();
            let missing: BTreeSet<u64> = clean.iter().map(|(ms, _)| *ms).filter(|ms| !kept.contains(ms)).collect();
            // A velocity that is a difference needs some poses in a row to begin with.
            let begins = |ms: u64| ms < 200 || (0..200).contains(&ms.wrapping_sub(situation.silence.end));
            let differs = ["natnet", "ros2"].contains(&name);
            let odd: Vec<&u64> = missing.iter().filter(|ms| !(bad.contains(ms) || (differs && begins(**ms)))).collect();
            assert!(odd.is_empty(), "{name} {number}: {robot} lost {odd:?} with {bad:?}");
            for (ms, reading) in &dirty {
                let [x, y] = place(robot.0, *ms);
                let off = reading.pose.position - Vec2::new(x as f32, y as f32);
                assert!(off.norm() < 0.01, "{name} {number}: {robot} is nowhere else: {reading:?}");
            }
            (spoiled, lost) = (spoiled + bad.len(), lost + missing.len());
        }
    }
    assert!(spoiled > 5000 && lost > 2000, "{spoiled} entries were bad, {lost} readings lost");
}

#[test]
fn what_doctor_says_of_readings_is_what_the_host_does_with_them() {
    let mut random = Seed::of_run(45).stream("entries");
    let mut found = BTreeMap::<Fitness, u32>::new();
    for number in 0..SITUATIONS {
        let situation = situation(&mut random);
        let kind = situation.kind;
        for (robot, readings) in run(&situation, true) {
            let needs = Needs { own_state: kind.own_state, half_extent: Vec2::repeat(2.0) };
            let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
            let mut track = Track::new(kind.own_state, at(readings[0].0), readings[0].1.clone());
            readings[1..].iter().for_each(|(ms, reading)| track.note(at(*ms), reading));
            let judgement = track.judge(at(LENGTH_MS), &needs);
            *found.entry(judgement.fitness).or_default() += 1;
            let knows: Vec<(u64, bool)> =
                ticks(kind, robot, &readings).into_iter().filter(|(ms, _)| *ms >= readings[0].0).collect();
            let stands = knows.iter().filter(|(_, knows)| !knows).count();
            let last = knows.iter().rev().take_while(|(_, knows)| !knows).count() as u64 * TICK_MS;
            let context = format!("{} {number}, {robot}: {judgement:?}; stands {stands}, {last} ms", kind.name);
            match judgement.fitness {
                Fitness::Ok => assert_eq!(stands, 0, "{context}"),
                Fitness::Warn => assert!(stands * 2 <= knows.len() + 2 && last <= 500, "{context}"),
                Fitness::Fail => assert!(last >= 200 || stands * 2 + 2 >= knows.len(), "{context}"),
            }
            // A robot that stands at the end for longer than half a second is never called fit.
            assert!(last <= 550 || judgement.fitness == Fitness::Fail, "{context}");
        }
    }
    assert!(found.values().all(|count| *count > 100) && found.len() == 3, "{found:?}");
}
