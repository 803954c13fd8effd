//! Connecting, rising, driving, landing, faults: over a network that loses nothing.

use murmurate::drivers::Vertical;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::wire::{Flight, Health};

use crate::bench::Bench;
use crate::firmware::Firmware;
use crate::firmware::airframe::Setpoint;

fn robot() -> Firmware {
    Firmware::new(1.0, -2.0, 1.0)
}

#[test]
fn a_robot_is_connected_begins_where_the_source_sees_it_rises_and_lands() {
    let mut bench = Bench::new("", robot());
    let ready =
        bench.until(2000, |bench| bench.conditions.last().is_some_and(|(_, told)| told.health == Health::Ready));
    assert!(ready < 1000, "{ready} ms");
    bench.run(1000);
    assert_eq!((bench.state(), bench.condition().battery), (Some(Flight::Grounded), Some(90)));
    let odometry = &bench.odometry.last().expect("it measures itself").pose;
    assert!((odometry.position - Vec2::new(1.0, -2.0)).norm() < 0.05, "{odometry:?}");
    assert!((odometry.heading.expect("it has one") - 1.0).abs() < 0.05);

    bench.order(Vertical::Rise { height_m: 0.5 });
    assert_eq!(bench.state(), Some(Flight::Rising));
    let rising = bench.until(4000, |bench| bench.state() == Some(Flight::Flying));
    assert!((1000..2500).contains(&rising) && (bench.robot.air.at[2] - 0.5).abs() < 0.1, "{rising} ms");
    bench.run(5000);
    assert!((bench.robot.air.at[2] - 0.5).abs() < 0.05 && bench.robot.air.hardest == 0.0, "it hovers");

    bench.order(Vertical::Land);
    assert_eq!(bench.state(), Some(Flight::Landing));
    bench.until(4000, |bench| bench.state() == Some(Flight::Grounded));
    bench.run(100);
    assert!(!bench.robot.air.motors && bench.robot.air.hardest < 1.2 && bench.lands_ms.is_none());
    assert_eq!((bench.robot.refused, bench.refused, bench.robot.cuts), (0, 0, 0));
    assert!(bench.robot.poses.0 > 300, "the source's poses were sent");
    bench.order(Vertical::Rise { height_m: 0.5 });
    bench.until(4000, |bench| bench.state() == Some(Flight::Flying));
}

#[test]
fn both_setpoints_move_the_robot_along_the_worlds_axes_whatever_its_heading() {
    for setpoint in ["hover", "velocity-world"] {
        for heading in [0.0, 1.2, 3.0, -2.0] {
            let mut bench = Bench::aloft(&format!("setpoint = '{setpoint}'"), Firmware::new(0.5, 0.5, heading));
            // No axis of the world, as of doctor --wiggle: each swapped or mirrored axis gives another direction.
            let velocity = Vec2::new(0.3 * 22.5f32.to_radians().cos(), 0.3 * 22.5f32.to_radians().sin());
            let before = bench.robot.air.at;
            bench.command = Some(velocity);
            bench.run(1000);
            let moved = [0, 1].map(|axis| (bench.robot.air.at[axis] - before[axis]) as f32);
            let off = (Vec2::from(moved) - velocity).norm();
            assert!(off < 0.1, "{setpoint}, {heading}: {moved:?}");
            assert!((bench.robot.air.at[2] - 0.5).abs() < 0.05, "{setpoint}: {:?}", bench.robot.air.at);
        }
    }
}

#[test]
fn the_newest_setpoint_alone_is_repeated_at_its_period_and_a_stop_leaves_at_once() {
    let mut bench = Bench::aloft("setpoint_hz = 20", robot());
    bench.run(1000);
    let before = bench.robot.setpoints.len();
    // Forty commands a second, of which half are never sent.
    for k in 0..40 {
        bench.drive(Vec2::new(0.01 * k as f32, 0.0));
        bench.run(25);
    }
    let sent = &bench.robot.setpoints[before..];
    assert!((18..=22).contains(&sent.len()), "{}", sent.len());
    let speeds: Vec<f64> = sent
        .iter()
        .map(|(_, setpoint)| match setpoint {
            Setpoint::Hover { velocity: [ahead, left], .. } => ahead.hypot(*left),
            Setpoint::World { .. } => panic!("{setpoint:?}"),
        })
        .collect();
    assert!(speeds.windows(2).all(|pair| pair[1] >= pair[0] - 1e-6), "never an older one: {speeds:?}");
    let before = bench.robot.setpoints.len();
    bench.drive(Vec2::zeros());
    bench.run(5);
    assert_eq!(bench.robot.setpoints.len(), before + 1);
    let Some((_, Setpoint::Hover { velocity, .. })) = bench.robot.setpoints.last() else { panic!("it hovers") };
    assert_eq!(*velocity, [0.0, 0.0]);
}

#[test]
fn what_the_supervisor_says_and_a_low_battery_are_reported_within_a_fifth_of_a_second() {
    type Fault = fn(&mut Firmware);
    let faults: [(&str, Fault); 3] = [
        ("tumbled", |robot| robot.air.tumbled = true),
        ("crashed", |robot| robot.air.crashed = true),
        ("locked", |robot| robot.air.locked = true),
    ];
    for (named, fault) in faults {
        let mut bench = Bench::aloft("", robot());
        fault(&mut bench.robot);
        let took = bench.until(1000, |bench| bench.condition().health == Health::Faulty);
        let reason = bench.condition().reason.clone().expect("it has one");
        assert!(took <= 200 && reason.text().contains(named), "{took} ms: {reason}");
        bench.until(1500, |bench| bench.state() == Some(Flight::Grounded));
        bench.order(Vertical::Rise { height_m: 0.5 });
        assert_eq!(bench.state(), Some(Flight::Grounded), "it does not take off");
    }
    let mut bench = Bench::aloft("", robot());
    bench.robot.battery = 7;
    let took = bench.until(1000, |bench| bench.condition().battery == Some(7));
    assert!(took <= 200, "{took} ms");
}

#[test]
fn a_robot_that_is_another_one_unseen_or_without_a_deck_does_not_take_off() {
    let refuses = |bench: &mut Bench| {
        bench.order(Vertical::Rise { height_m: 0.5 });
        bench.run(1000);
        assert!(bench.robot.orders.is_empty() && bench.state() == Some(Flight::Grounded));
    };
    // The source sees it elsewhere, faster than its estimator begins anew: such as another robot under its name.
    let mut bench = Bench::new("", robot());
    bench.run(2500);
    bench.shift = Vec2::new(0.0, 1.5);
    bench.run(20);
    refuses(&mut bench);
    let mut bench = Bench::new("", robot());
    bench.sees = false;
    bench.run(2500);
    refuses(&mut bench);
    let mut bare = robot();
    bare.set("bcFlow2", 0.0);
    let mut bench = Bench::new("", bare.clone());
    bench.run(2500);
    assert!(bench.condition().reason.as_ref().is_some_and(|reason| reason.text().contains("deck")));
    refuses(&mut bench);
    let bench = Bench::aloft("height = 'estimate'", bare);
    assert_eq!(bench.state(), Some(Flight::Flying));
}

#[test]
fn old_firmware_and_a_silent_robot_are_named() {
    let mut old = robot();
    old.protocol = 3;
    let mut bench = Bench::new("", old);
    bench.run(2500);
    let reason = bench.condition().reason.clone().expect("it has one");
    assert!(bench.condition().health == Health::Faulty && reason.text().contains("version 3"), "{reason}");
    let mut bench = Bench::new("", robot());
    bench.loss = 1.0;
    bench.run(2500);
    assert_eq!((bench.condition().health, bench.state()), (Health::Silent, None));
}

#[test]
fn motors_are_cut_by_the_order_for_it_alone() {
    let mut bench = Bench::aloft("", robot());
    bench.order(Vertical::Land);
    bench.until(4000, |bench| bench.state() == Some(Flight::Grounded));
    assert_eq!(bench.robot.cuts, 0);
    let mut bench = Bench::aloft("", robot());
    bench.order(Vertical::Cut);
    bench.run(20);
    assert!(bench.robot.cuts > 0 && !bench.robot.air.motors);
    assert_eq!(bench.state(), Some(Flight::Grounded));
}
