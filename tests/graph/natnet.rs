//! The source `natnet`: every bitstream from the encoder of a fake tracker, damaged datagrams, lost and exchanged
//! bodies, and the worker against the fake on the loopback interface.

#[path = "../peers/natnet.rs"]
pub mod fake;

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread;
use std::time::{Duration, Instant};

use fake::{Body, Scene, Setup, Tally, Version};
use murmurate::actor::Core;
use murmurate::actors::localizer::{self, Localizer};
use murmurate::edge::{self, Settings};
use murmurate::localization::plausibility::Limits;
use murmurate::localization::screen::Screen;
use murmurate::localization::{In, Out, Source};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::place::Whereabouts;
use murmurate::messages::wire::{Reading, Wire};
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::time::{Span, Time};
use murmurate_devices::natnet;
use murmurate_devices::natnet::frame::FrameLayout;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use crate::common::{HANGS, ends};

/// All bitstreams that are decoded. 4.2 to 4.4 are known from here alone.
const VERSIONS: [Version; 7] = [[3, 0], [3, 1], [4, 0], [4, 1], [4, 2], [4, 3], [4, 4]];

fn settings(text: &str) -> Settings {
    let table = format!("server = '127.0.0.1'\n{text}").parse().expect("it is TOML");
    Settings { name: "natnet".to_owned(), table }
}

fn source(text: &str, robots: u16) -> Box<dyn Source> {
    let robots: Vec<RobotId> = (0..robots).map(RobotId).collect();
    (natnet::make(&settings(text), &robots).unwrap_or_else(|error| panic!("{error}")).source)()
}

/// Robots 0 and 1 by their names, ten frames into a run: 0 moves along the tracker's x axis at 0.5 m/s.
fn scene(frame: i32) -> Scene {
    let stamp_s = f64::from(frame) * 0.01;
    let x = (0.5 * stamp_s) as f32;
    let bodies =
        vec![Body::standing("robot-0", 7, [x, 0.1, 0.0], 0.5), Body::standing("robot-1", 8, [2.0, 0.1, -3.0], 0.0)];
    Scene { number: frame, stamp_s, models_changed: false, bodies, extras: 3 }
}

fn take(source: &mut dyn Source, datagram: &[u8]) -> Vec<Out> {
    let mut out = Vec::new();
    source.take(Time::ZERO, In::Packet(datagram), &mut out);
    out
}

fn readings(out: &[Out]) -> Vec<&Reading> {
    out.iter().filter_map(|said| if let Out::Reading(reading) = said { Some(reading) } else { None }).collect()
}

fn refused(out: &[Out]) -> Vec<&'static str> {
    let why = |said: &Out| match said {
        Out::Refused(why) | Out::RefusedOf(_, why) => Some(*why),
        Out::Lost(..) => None,
        Out::Reading(_) => None,
    };
    out.iter().filter_map(why).collect()
}

/// Feeds the model definitions and frames of one bitstream. Returns what was said to each frame.
fn feed(source: &mut dyn Source, version: Version, frames: impl Iterator<Item = Scene>) -> Vec<Vec<Out>> {
    let mut model = None;
    let mut one = |scene: Scene| {
        if model.replace(scene.bodies.len()).is_none() {
            assert_eq!(take(source, &fake::model(version, &scene.bodies, scene.extras)), []);
        }
        take(source, &fake::frame(version, &scene))
    };
    frames.map(&mut one).collect()
}

#[test]
fn every_bitstream_is_read_with_and_without_a_description_of_its_server() {
    for version in VERSIONS {
        for (described, extras) in [(true, 0), (true, 3), (false, 0), (false, 3)] {
            let mut source = source("rate_hz = 1000.0", 2);
            if described {
                assert_eq!(take(&mut *source, &fake::server_info(version, true, 1511)), []);
            }
            let all = feed(&mut *source, version, (0..10).map(|frame| Scene { extras, ..scene(frame) }));
            let last = readings(all.last().unwrap());
            let [moving, standing] = last[..] else { panic!("{version:?} {described} {extras}: {all:?}") };
            assert_eq!((moving.robot, moving.stamp_ns), (RobotId(0), 90_000_000));
            assert!((moving.pose.position - Vec2::new(0.045, 0.0)).norm() < 1e-6, "{moving:?}");
            assert!((moving.twist.velocity - Vec2::new(0.5, 0.0)).norm() < 1e-4, "{moving:?}");
            assert!((moving.pose.heading.unwrap() - 0.5).abs() < 1e-5, "{moving:?}");
            assert!(moving.twist.yaw_rate.unwrap().abs() < 1e-5 && moving.deviation.position_m == Some(2e-4));
            assert!((standing.pose.position - Vec2::new(2.0, 3.0)).norm() < 1e-6, "y is up: {standing:?}");
        }
    }
}

#[test]
fn a_unicast_server_may_send_an_older_bitstream_than_its_own() {
    for (announced, sent) in [([4, 4], [3, 1]), ([3, 1], [4, 1]), ([4, 0], [4, 1])] {
        let mut source = source("rate_hz = 1000.0", 2);
        take(&mut *source, &fake::server_info(announced, false, 1511));
        let all = feed(&mut *source, sent, (0..10).map(scene));
        assert!(all.iter().all(|out| refused(out).is_empty()) && !readings(&all[9]).is_empty(), "{all:?}");
    }
}

#[test]
fn a_frame_of_4_0_may_have_a_precise_stamp_or_none() {
    for precise in [false, true] {
        let mut datagram = fake::frame([4, 0], &scene(3));
        let stamp = datagram.len() - 14..datagram.len() - 6;
        datagram.splice(stamp, vec![0xff; if precise { 8 } else { 0 }]);
        let payload = &datagram[4..];
        let (frame, layout) = natnet::frame::decode(payload, FrameLayout::Plain).expect("a frame");
        assert_eq!((frame.models_changed, frame.bodies.len(), layout), (false, 2, FrameLayout::Plain));
        let found = natnet::frame::decode(payload, FrameLayout::Sized).expect("found by its length");
        assert_eq!(found, (frame, FrameLayout::Plain));
    }
}

#[test]
fn a_datagram_that_is_cut_anywhere_is_refused() {
    for version in VERSIONS {
        for datagram in [fake::frame(version, &scene(1)), fake::model(version, &scene(1).bodies, 2)] {
            for length in 0..datagram.len() {
                let mut source = source("", 2);
                take(&mut *source, &fake::server_info(version, true, 1511));
                let out = take(&mut *source, &datagram[..length]);
                assert_eq!(refused(&out).len(), 1, "{version:?} at {length}: {out:?}");
                // A frame of 4.0 that has lost up to as much as the precise stamp is a frame without one.
                if version == [4, 0] && datagram[0] == 7 && length + 8 >= datagram.len() {
                    continue;
                }
                // The payload is cut, and its header says so.
                let payload = (length.max(4) - 4) as u16;
                let mut cut = datagram[..length.max(4)].to_vec();
                cut[2..4].copy_from_slice(&payload.to_le_bytes());
                let out = take(&mut *source, &cut);
                assert!(readings(&out).is_empty() && !out.is_empty(), "{version:?} at {length}: {out:?}");
            }
        }
    }
}

fn mutate(random: &mut Stream, datagram: &mut Vec<u8>) {
    for _ in 0..random.random_range(1..6) {
        let at = random.random_range(0..datagram.len());
        match random.random_range(0..4) {
            0 => datagram[at] = random.random(),
            1 => datagram[at] ^= 1 << random.random_range(0..8),
            2 => {
                let extreme = [i32::MAX, i32::MIN, -1, 0, 1 << 20][random.random_range(0..5)].to_le_bytes();
                let end = (at + 4).min(datagram.len());
                datagram[at..end].copy_from_slice(&extreme[..end - at]);
            }
            _ => {
                datagram.truncate(random.random_range(0..=datagram.len()));
                datagram.push(random.random());
            }
        }
    }
    if random.random() && datagram.len() >= 4 {
        let payload = (datagram.len() - 4) as u16;
        datagram[2..4].copy_from_slice(&payload.to_le_bytes());
    }
}

/// Feeds mutated datagrams for a time or a number of rounds. Nothing panics, and all readings are sound.
fn fuzz(seed: u64, rounds: u64, limit: Duration) -> (u64, BTreeMap<&'static str, u64>) {
    let (begun, mut random) = (Instant::now(), Seed::of_run(seed).stream("mutation"));
    let (mut done, mut said, mut source) = (0, BTreeMap::new(), source("rate_hz = 1000.0", 2));
    while done < rounds && begun.elapsed() < limit {
        let version = VERSIONS[random.random_range(0..VERSIONS.len())];
        let frame = Scene { extras: random.random_range(0..4), ..scene(done as i32) };
        let mut datagram = match random.random_range(0..8) {
            0 => fake::server_info(version, random.random(), 1511),
            1 | 2 => fake::model(version, &frame.bodies, frame.extras),
            _ => fake::frame(version, &frame),
        };
        if random.random_range(0..8) > 0 {
            mutate(&mut random, &mut datagram);
        }
        for out in take(&mut *source, &datagram) {
            let why = match out {
                Out::Refused(why) | Out::RefusedOf(_, why) => why,
                Out::Lost(..) => panic!("{out:?}"),
                Out::Reading(reading) => {
                    assert_eq!(Wire::Reading(reading.clone()).check(), Ok(()), "{reading:?}");
                    "reading"
                }
            };
            *said.entry(why).or_default() += 1;
        }
        done += 1;
    }
    (done, said)
}

/// `FUZZ_S=60 cargo test --test graph -- --nocapture mutated` does it for a minute, and says what was refused.
#[test]
fn mutated_datagrams_never_panic_and_give_sound_readings() {
    let limit_s = std::env::var("FUZZ_S").ok().map(|seconds| seconds.parse().expect("a time"));
    let rounds = if limit_s.is_some() { u64::MAX } else { 20_000 };
    let (done, said) = fuzz(2, rounds, Duration::from_secs(limit_s.unwrap_or(600)));
    println!("{done} datagrams: {said:?}");
    assert!(done >= 20_000 && said["reading"] > 0 && said.len() > 5, "{done} {said:?}");
}

#[test]
fn a_lost_body_and_a_repeated_or_late_frame_give_no_reading() {
    let mut source = source("rate_hz = 1000.0", 2);
    feed(&mut *source, [4, 1], (0..10).map(scene));
    let mut lost = scene(10);
    lost.bodies[1].tracked = false;
    // A lost body may keep any pose.
    lost.bodies[1].rotation = [0.0; 4];
    lost.bodies[1].position = [f32::NAN; 3];
    let out = take(&mut *source, &fake::frame([4, 1], &lost));
    assert_eq!(readings(&out).iter().map(|reading| reading.robot).collect::<Vec<_>>(), [RobotId(0)]);
    assert!(matches!(out[1], Out::RefusedOf(RobotId(1), "the tracker has lost its rigid body")), "{out:?}");
    for again in [scene(10), Scene { number: 11, ..scene(10) }, Scene { number: 10, ..scene(11) }, scene(8)] {
        let out = take(&mut *source, &fake::frame([4, 1], &again));
        assert!(readings(&out).is_empty() && refused(&out).len() == 1, "{out:?}");
    }
    let out = take(&mut *source, &fake::frame([4, 1], &scene(11)));
    assert_eq!(readings(&out).len(), 2);
    let absent = Scene { bodies: scene(12).bodies.split_off(1), ..scene(12) };
    assert_eq!(readings(&take(&mut *source, &fake::frame([4, 1], &absent))).len(), 1, "it has left the frame");
}

#[test]
fn a_body_without_a_pose_costs_itself_alone() {
    let bad: [fn(&mut Body); 4] = [
        |body| body.rotation = [0.0; 4],
        |body| body.rotation = [0.0, 0.0, 0.5, 0.5],
        |body| body.position[1] = f32::NAN,
        |body| body.rotation[3] = f32::INFINITY,
    ];
    for version in VERSIONS {
        for spoil in bad {
            let mut source = source("rate_hz = 1000.0", 2);
            let foreign = |frame| {
                let mut scene = scene(frame);
                let mut other = Body::standing("other", 99, [0.0; 3], 0.0);
                spoil(&mut other);
                scene.bodies.insert(0, other);
                scene
            };
            let all = feed(&mut *source, version, (0..10).map(foreign));
            assert!(all.iter().all(|out| refused(out).is_empty()) && readings(&all[9]).len() == 2, "{all:?}");
            let own = |frame| {
                let mut scene = scene(frame);
                spoil(&mut scene.bodies[1]);
                scene
            };
            let all = feed(&mut *source, version, (10..20).map(own));
            assert!(all.iter().all(|out| readings(out).len() == 1 && matches!(out[1], Out::RefusedOf(RobotId(1), _))));
            let all = feed(&mut *source, version, (20..30).map(scene));
            assert_eq!(readings(&all[9]).len(), 2, "it is back");
        }
    }
}

#[test]
fn a_rotation_that_is_nearly_of_unit_length_is_one() {
    let mut source = source("rate_hz = 1000.0", 2);
    let scaled = |frame| {
        let mut scene = scene(frame);
        scene.bodies[0].rotation = scene.bodies[0].rotation.map(|number| 0.99 * number);
        scene.bodies[1].rotation = scene.bodies[1].rotation.map(|number| 0.91 * number);
        scene
    };
    let all = feed(&mut *source, [4, 1], (0..10).map(scaled));
    let last = readings(&all[9]);
    assert!((last[0].pose.heading.unwrap() - 0.5).abs() < 1e-5 && last.len() == 2, "{last:?}");
}

#[test]
fn robots_that_cannot_be_told_apart_have_no_readings() {
    let why = |text: &str, scene: fn(i32) -> Scene| {
        let mut source = source(&format!("rate_hz = 1000.0\n{text}"), 2);
        let all = feed(&mut *source, [4, 1], (0..10).map(scene));
        let said = refused(&all[9]);
        (readings(&all[9]).iter().map(|reading| reading.robot.0).collect::<Vec<_>>(), said.join("; "))
    };
    let (robots, said) = why("bodies = { 0 = 8 }", scene);
    assert!(robots.is_empty() && said.contains("another robot has the same rigid body"), "{robots:?} {said}");
    let (robots, said) = why("", |frame| {
        let mut scene = scene(frame);
        scene.bodies.push(Body::standing("robot-0", 7, [-1.0; 3], 0.0));
        scene
    });
    assert!(robots == [1] && said.contains("two rigid bodies in a frame have its ID"), "{robots:?} {said}");
    let (robots, _) = why("", |frame| {
        let mut scene = scene(frame);
        scene.bodies.push(Body::standing("robot-0", 9, [-1.0; 3], 0.0));
        scene
    });
    assert_eq!(robots, [1], "two bodies have the name of robot 0");
}

#[test]
fn a_tracker_that_is_started_again_is_read_again() {
    let mut source = source("rate_hz = 1000.0", 2);
    feed(&mut *source, [4, 1], (1000..1010).map(scene));
    let all = feed(&mut *source, [4, 1], (0..10).map(scene));
    assert!(all.iter().all(|out| refused(out).is_empty()));
    assert_eq!((readings(&all[0]).len(), readings(&all[9]).len()), (0, 2));
}

#[test]
fn exchanged_ids_are_refused_and_the_right_ones_accepted_again() {
    let (robots, mut out) = ([RobotId(0), RobotId(1)].map(|robot| (robot, Limits::default())), Vec::new());
    let screen = Screen::new(HostId(0), robots.into_iter().collect());
    let mut localizer = Localizer::new(source("rate_hz = 1000.0", 2), Rc::from([])).screened(screen);
    let model = fake::model([4, 1], &scene(0).bodies, 3);
    localizer.handle(Time::ZERO, localizer::In::Packet(model.into()), &mut out);
    let mut take = |frame: i32, scene: &Scene| {
        let now = Time::ZERO + Span::from_millis(10 * frame as u64);
        localizer.handle(now, localizer::In::Packet(fake::frame([4, 1], scene).into()), &mut out);
        let readings = out.iter().filter(|said| matches!(said, localizer::Out::Reading(_))).count();
        let located = out.drain(..).filter_map(|said| match said {
            localizer::Out::Located(located) => Some(located.robots),
            localizer::Out::Reading(_) => None,
        });
        (readings, located.flatten().collect::<Vec<_>>())
    };
    let mut lost = Vec::new();
    (0..10).for_each(|frame| drop(take(frame, &scene(frame))));
    let swapped = |frame| {
        let mut scene = scene(frame);
        (scene.bodies[0].id, scene.bodies[1].id) = (8, 7);
        scene
    };
    for frame in 10..500 {
        let (readings, located) = take(frame, &swapped(frame));
        assert_eq!(readings, 0, "{frame}");
        lost.extend(located);
    }
    assert!(lost.contains(&(RobotId(0), Whereabouts::Exchanged)), "{lost:?}");
    assert!(lost.contains(&(RobotId(1), Whereabouts::Exchanged)), "{lost:?}");
    // Without readings the guard has stopped both robots.
    let back = |frame| Scene { number: frame, stamp_s: f64::from(frame) * 0.01, ..scene(10) };
    let counted: Vec<usize> = (500..700).map(|frame| take(frame, &back(frame)).0).collect();
    assert!(counted[..100].iter().all(|readings| *readings == 0), "they have to stay there");
    assert!(counted[110..].iter().all(|readings| *readings == 2), "{counted:?}");
}

#[test]
fn names_follow_the_model_definitions() {
    let mut source = source("bodies = { 0 = 'jackal', 1 = 8 }\nrate_hz = 1000.0", 2);
    let all = feed(&mut *source, [4, 0], (0..10).map(scene));
    assert!(readings(&all[9]).iter().all(|reading| reading.robot == RobotId(1)), "no body is called jackal");
    let renamed = |frame| {
        let mut scene = scene(frame);
        scene.bodies[0].name = "jackal".to_owned();
        scene
    };
    let all = feed(&mut *source, [4, 0], (10..20).map(renamed));
    assert_eq!(readings(&all[9]).len(), 2);
    // The tracker gives the name to another body: the history of the old one is forgotten.
    let moved = |frame| {
        let mut scene = renamed(frame);
        scene.bodies[0].id = 9;
        scene.bodies[0].position[0] += 1.0;
        scene
    };
    let all = feed(&mut *source, [4, 0], (20..30).map(moved));
    assert!(all.iter().all(|out| refused(out).is_empty()) && readings(&all[9]).len() == 2, "{all:?}");
}

#[test]
fn the_trackers_axes_are_turned_into_the_teams() {
    let half = std::f32::consts::FRAC_PI_4;
    let pose = |text: &str, position, rotation| {
        let mut source = source(&format!("rate_hz = 1000.0\nbodies = {{ 0 = 7 }}\n{text}"), 1);
        let body = Body { position, rotation, ..Body::standing("robot-0", 7, [0.0; 3], 0.0) };
        let frames = (0..10).map(|frame| Scene { bodies: vec![body.clone()], ..scene(frame) });
        let all = feed(&mut *source, [4, 1], frames);
        let reading = readings(&all[9]).first().copied().cloned().expect("a reading");
        (reading.pose.position, reading.pose.heading)
    };
    let near = |(position, heading): (Vec2, Option<f32>), x: f32, y: f32, angle: f32| {
        let heading: f32 = heading.expect("a heading");
        assert!((position - Vec2::new(x, y)).norm() < 1e-5 && (heading - angle).abs() < 1e-5, "{position:?} {heading}");
    };
    // A quarter turn to the left about y, which is up, and about z.
    near(pose("", [1.0, 5.0, -2.0], [0.0, half.sin(), 0.0, half.cos()]), 1.0, 2.0, 2.0 * half);
    near(pose("up = 'z'", [1.0, 2.0, 5.0], [0.0, 0.0, half.sin(), half.cos()]), 1.0, 2.0, 2.0 * half);
    let turned = "up = 'z'\nyaw_rad = 1.5707963267948966\norigin_m = [10.0, 20.0]";
    near(pose(turned, [1.0, 2.0, 5.0], [0.0, 0.0, 0.0, 1.0]), 8.0, 21.0, 2.0 * half);
    // Rolled by 20 degrees, the heading stays; a body that stands on end has none.
    let (sin, cos) = 10.0_f32.to_radians().sin_cos();
    near(pose("up = 'z'", [1.0, 2.0, 0.0], [sin, 0.0, 0.0, cos]), 1.0, 2.0, 0.0);
    assert_eq!(pose("up = 'z'", [1.0, 2.0, 0.0], [0.0, half.sin(), 0.0, half.cos()]).1, None);
}

#[test]
fn readings_keep_to_their_rate() {
    for (tracker_hz, rate_hz, least, most) in [(100.0, 50.0, 98, 101), (240.0, 50.0, 97, 101), (30.0, 50.0, 57, 60)] {
        let mut source = source(&format!("rate_hz = {rate_hz:.1}"), 1);
        let frames = 0..(2.0 * tracker_hz) as i32;
        let all = feed(
            &mut *source,
            [4, 1],
            frames.map(|frame| Scene { stamp_s: f64::from(frame) / tracker_hz, ..scene(frame) }),
        );
        let count = all.iter().map(|out| readings(out).len()).sum::<usize>();
        assert!((least..=most).contains(&count), "{tracker_hz} Hz: {count} in 2 s");
    }
}

/// Runs the worker against the fake until it has given so many readings of each robot, for 10 s at most.
fn listen(setup: Setup, text: &str, change_at: Option<u64>) -> (Tally, BTreeMap<u16, u64>, Vec<&'static str>) {
    let stop = Arc::new(AtomicBool::new(false));
    let (stopped, served) = (Arc::clone(&stop), setup.clone());
    let server = thread::spawn(move || {
        fake::serve(&served, &stopped, |stamp_s, frames| {
            let mut scene = Scene { stamp_s, number: frames as i32, extras: 1, ..scene(0) };
            if change_at.is_some_and(|at| frames >= at) {
                scene.models_changed = change_at == Some(frames);
                scene.bodies[0].id = 70;
            }
            Some(scene)
        })
        .expect("its ports are free")
    });
    let parts = natnet::make(&settings(text), &[RobotId(0), RobotId(1)]).unwrap_or_else(|error| panic!("{error}"));
    let (mut source, worker) = ((parts.source)(), parts.worker);
    let (mut gate, worker) = edge::start(worker, "source").expect("a thread");
    let (begun, mut counts, mut whys) = (Instant::now(), BTreeMap::<u16, u64>::new(), Vec::new());
    let (wanted, mut restarted) = (100 + change_at.unwrap_or(0), false);
    while counts.get(&0).is_none_or(|count| *count < wanted) && begun.elapsed() < HANGS {
        let (bell, mut out) = (gate.bell(), Vec::new());
        poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::from(100u16)).expect("it polls");
        gate.take(|packet| source.take(Time::ZERO, In::Packet(&packet), &mut out));
        readings(&out).iter().for_each(|reading| *counts.entry(reading.robot.0).or_default() += 1);
        if !restarted && counts.get(&0).is_some_and(|count| *count >= 50) {
            // Its actor is started anew, and the worker goes on.
            (source, restarted) = ((parts.source)(), true);
        }
        whys.extend(refused(&out));
    }
    drop(gate);
    ends(worker, "natnet");
    stop.store(true, Ordering::Relaxed);
    (server.join().expect("it does not panic"), counts, whys)
}

fn setup(ports: u16, group: Option<Ipv4Addr>) -> Setup {
    Setup {
        address: Ipv4Addr::LOCALHOST,
        command_port: ports,
        data_port: ports + 1,
        group,
        version: [4, 4],
        period: Duration::from_millis(4),
    }
}

#[test]
fn the_worker_hears_a_group_and_asks_again_when_models_change() {
    let group = Ipv4Addr::new(239, 255, 42, 98);
    let text = "command_port = 21510\ndata_port = 21511\ngroup = '239.255.42.98'\ninterface = 'lo'\nrate_hz = 1000.0";
    let (tally, counts, whys) = listen(setup(21510, Some(group)), text, Some(400));
    assert!(counts[&0] >= 500 && counts[&1] >= 499, "{counts:?} {whys:?}");
    // A third time where the answer took longer than the worker waits, on a busy machine.
    let asked = tally.requests.get(&4).copied();
    assert!(asked.is_some_and(|asked| (2..=4).contains(&asked)), "model definitions are asked for again: {tally:?}");
    assert!(tally.requests[&0] <= 2 && !tally.requests.contains_key(&10), "{tally:?}");
}

#[test]
fn the_worker_keeps_a_unicast_server_alive() {
    let text = "command_port = 21520\ntransmission = 'unicast'\nrate_hz = 1000.0";
    let (tally, counts, whys) = listen(setup(21520, None), text, None);
    assert!(counts[&0] >= 100 && counts[&1] >= 99 && whys.is_empty(), "{counts:?} {whys:?}");
    assert!(tally.requests[&10] >= 2, "{tally:?}");
}

#[test]
fn a_tracker_that_is_halted_gives_no_readings_and_is_asked_anew_from_new_sockets() {
    let (stop, halt) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let (go_on, told) = channel::<()>();
    let (stopped, halted) = (Arc::clone(&stop), Arc::clone(&halt));
    let server = thread::spawn(move || {
        fake::serve(&setup(21530, None), &stopped, |stamp_s, frames| {
            // It answers no request and sends no frame until the test goes on.
            if halted.swap(false, Ordering::Relaxed) {
                told.recv().expect("the test runs");
            }
            Some(Scene { stamp_s, number: frames as i32, ..scene(0) })
        })
        .expect("its ports are free")
    });
    let text = "command_port = 21530\ntransmission = 'unicast'\nrate_hz = 1000.0";
    let parts = natnet::make(&settings(text), &[RobotId(0), RobotId(1)]).unwrap_or_else(|error| panic!("{error}"));
    let (mut source, (mut gate, worker)) = ((parts.source)(), edge::start(parts.worker, "source").expect("a thread"));
    // Takes what the worker says for so long, or until there is a reading.
    let mut hears = |longest: Duration| {
        let (begun, mut out) = (Instant::now(), Vec::new());
        while begun.elapsed() < longest && readings(&out).is_empty() {
            let bell = gate.bell();
            poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::from(100u16)).expect("it polls");
            gate.take(|packet| source.take(Time::ZERO, In::Packet(&packet), &mut out));
        }
        !readings(&out).is_empty()
    };
    assert!(hears(HANGS));
    halt.store(true, Ordering::Relaxed);
    while halt.load(Ordering::Relaxed) {
        hears(Duration::from_millis(10));
    }
    // Datagrams that it has sent until then.
    while hears(Duration::from_millis(500)) {}
    assert!(!hears(Duration::from_millis(6000)), "no reading is repeated");
    go_on.send(()).expect("it waits");
    assert!(hears(HANGS), "it is heard again");
    drop(gate);
    ends(worker, "natnet");
    stop.store(true, Ordering::Relaxed);
    let tally = server.join().expect("it does not panic");
    assert!(tally.clients.len() >= 2, "the sockets are opened anew after five seconds: {tally:?}");
}
