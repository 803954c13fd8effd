//! Lost packets, a driver that ends or hangs, a robot that restarts.

use murmurate::drivers::Vertical;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::wire::{Flight, Health};

use crate::bench::Bench;
use crate::firmware::Firmware;
use crate::firmware::airframe::{LEVELS_S, SHUTS_DOWN_S};

fn robot() -> Firmware {
    Firmware::new(1.0, -2.0, 1.0)
}

#[test]
fn a_flight_survives_the_loss_of_1_to_20_percent_of_all_packets() {
    for loss in [0.01, 0.05, 0.1, 0.2] {
        let mut bench = Bench::new("", robot());
        bench.loss = loss;
        bench.until(8000, |bench| bench.conditions.last().is_some_and(|(_, told)| told.health == Health::Ready));
        // Its estimator begins anew by parameters, which are repeated until they are answered.
        bench.run(4000);
        bench.order(Vertical::Rise { height_m: 0.5 });
        bench.until(4000, |bench| bench.state() == Some(Flight::Flying));
        bench.command = Some(Vec2::new(0.1, 0.1));
        bench.run(10_000);
        let gap = bench.robot.setpoints.windows(2).map(|pair| pair[1].0 - pair[0].0).fold(0.0, f64::max);
        assert!(gap < LEVELS_S, "{loss}: {gap} s without a setpoint");
        assert_eq!(bench.condition().health, Health::Ready, "{loss}");
        bench.order(Vertical::Land);
        bench.until(5000, |bench| bench.state() == Some(Flight::Grounded));
        assert!(bench.robot.air.at[2] < 0.05 && !bench.robot.air.crashed, "{loss}: {:?}", bench.robot.air);
    }
}

#[test]
fn when_the_driver_is_gone_the_firmware_levels_the_robot_and_switches_it_off_in_its_time() {
    for moment in 0..20 {
        let mut bench = Bench::aloft("", robot());
        bench.command = Some(Vec2::new(0.2, 0.0));
        bench.run(100 + 37 * moment);
        bench.runs = false;
        let last = bench.robot.air.low.expect("it is driven").0;
        let gone = bench.until(3000, |bench| !bench.robot.air.motors);
        let off = bench.robot.air.now - last;
        assert!((off - SHUTS_DOWN_S).abs() < 0.03, "off {off} s after its last setpoint");
        assert!((1950..2050).contains(&gone), "{gone} ms");
        // The worker, which is another thread, would have made it land long before.
        let lands = bench.lands_ms.expect("it is in the air");
        assert!(lands <= (last * 1000.0) as u64 + 450, "{lands}");
    }
}

#[test]
fn a_robot_that_restarts_in_the_air_is_found_on_the_ground_and_can_rise_again() {
    let mut bench = Bench::aloft("", robot());
    bench.robot = robot();
    bench.until(3000, |bench| bench.state() == Some(Flight::Grounded));
    bench.until(3000, |bench| bench.condition().health == Health::Ready);
    let read = bench.robot.entries_read;
    assert_eq!(read, 0, "its tables are known by their CRC");
    bench.rise();
}

#[test]
fn a_driver_that_begins_while_its_robot_is_in_the_air_makes_it_land() {
    let flying = Bench::aloft("", robot()).robot;
    let mut bench = Bench::new("", flying);
    bench.until(1500, |bench| bench.state() == Some(Flight::Landing));
    bench.until(4000, |bench| bench.state() == Some(Flight::Grounded));
    assert!(!bench.robot.air.crashed && bench.robot.air.at[2] < 0.05);
}

#[test]
fn noise_is_refused_and_counted_and_harms_nothing() {
    let mut bench = Bench::aloft("", robot());
    let before = bench.refused;
    let mut out = Vec::new();
    for noise in [&b""[..], b"Z", b"C", &[b'C'; 40], b"C\x5e\x01", b"C\x5e\x01\0\0\0\xff\xff", b"C\x5e\x02\0\0\0\x01"] {
        bench.driver.receive(bench.now(), noise, &mut out);
    }
    let refused = out.iter().filter(|out| matches!(out, murmurate::drivers::Out::Refused(_))).count();
    assert_eq!((refused, before), (7, 0));
    bench.run(1000);
    assert_eq!(bench.state(), Some(Flight::Flying));
}
