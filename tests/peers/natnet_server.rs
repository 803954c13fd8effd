//! Fake tracker for other people's clients: `natnet_server 4.1 10 [multicast|unicast] [ADDRESS]` serves two bodies at
//! 100 Hz for 10 s, on the loopback interface unless another address of this machine is given. `robot-0` (ID 7) goes
//! round; `robot-1` (ID 8) is lost in every second second. With a further word `lines` it serves the robots of lines of
//! its input, as a source `program` says them: robot N as the body `robot-N` (ID N + 1).

#[path = "natnet.rs"]
mod natnet;

use std::collections::BTreeMap;
use std::io::BufRead;
use std::net::Ipv4Addr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use natnet::{Body, Scene, Setup};

/// Bodies by the numbers of their robots.
type Bodies = Arc<Mutex<BTreeMap<i32, Body>>>;

/// Returns the bodies of the lines that come, which another thread reads.
fn told() -> Bodies {
    let bodies = Bodies::default();
    let told = Arc::clone(&bodies);
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            let line: serde_json::Value = serde_json::from_str(&line).expect("a line is JSON");
            let number = |name: &str| line[name].as_f64().unwrap_or(0.0) as f32;
            let robot = line["robot"].as_i64().expect("a robot") as i32;
            // The tracker's y axis points up.
            let place = [number("x"), 0.1, -number("y")];
            let body = Body::standing(&format!("robot-{robot}"), robot + 1, place, number("heading"));
            told.lock().expect("no thread panics with it").insert(robot, body);
        }
    });
    bodies
}

/// Returns the two bodies that move by themselves.
fn own(stamp_s: f64) -> Vec<Body> {
    let yaw = stamp_s as f32;
    let mut other = Body::standing("robot-1", 8, [2.0, 0.1, 3.0], 0.0);
    other.tracked = (stamp_s as u64).is_multiple_of(2);
    vec![Body::standing("robot-0", 7, [yaw.cos(), 0.1, -yaw.sin()], yaw), other]
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let version = arguments.next().expect("a bitstream, as 4.1");
    let version: Vec<u8> = version.split('.').map(|number| number.parse().expect("a number")).collect();
    let seconds: f64 = arguments.next().expect("a time [s]").parse().expect("a number");
    let unicast = arguments.next().is_some_and(|word| word == "unicast");
    let address = arguments.next().map_or(Ipv4Addr::LOCALHOST, |text| text.parse().expect("an IPv4 address"));
    let lines = arguments.next().is_some_and(|word| word == "lines").then(told);
    let setup = Setup {
        address,
        command_port: 1510,
        data_port: 1511,
        group: (!unicast).then_some(Ipv4Addr::new(239, 255, 42, 99)),
        version: [version[0], version[1]],
        period: Duration::from_millis(10),
    };
    let stop = Arc::new(AtomicBool::new(false));
    let tally = natnet::serve(&setup, &stop, |stamp_s, number| {
        stop.store(stamp_s >= seconds, Ordering::Relaxed);
        let bodies = match &lines {
            Some(told) => told.lock().expect("no thread panics with it").values().cloned().collect(),
            None => own(stamp_s),
        };
        Some(Scene { number: number as i32, stamp_s, models_changed: false, bodies, extras: 0 })
    });
    println!("{:?}", tally.expect("the ports 1510 and 1511 are free"));
}
