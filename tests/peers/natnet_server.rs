//! Fake tracker for other people's clients: `natnet_server 4.1 10 [multicast|unicast] [ADDRESS]` serves two bodies at
//! 100 Hz for 10 s, on the loopback interface unless another address of this machine is given. `robot-0` (ID 7) goes
//! round; `robot-1` (ID 8) is lost in every second second.

#[path = "natnet.rs"]
mod natnet;

use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use natnet::{Body, Scene, Setup};

fn main() {
    let mut arguments = std::env::args().skip(1);
    let version = arguments.next().expect("a bitstream, as 4.1");
    let version: Vec<u8> = version.split('.').map(|number| number.parse().expect("a number")).collect();
    let seconds: f64 = arguments.next().expect("a time [s]").parse().expect("a number");
    let unicast = arguments.next().is_some_and(|word| word == "unicast");
    let address = arguments.next().map_or(Ipv4Addr::LOCALHOST, |text| text.parse().expect("an IPv4 address"));
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
        let yaw = stamp_s as f32;
        let mut other = Body::standing("robot-1", 8, [2.0, 0.1, 3.0], 0.0);
        other.tracked = (stamp_s as u64).is_multiple_of(2);
        let bodies = vec![Body::standing("robot-0", 7, [yaw.cos(), 0.1, -yaw.sin()], yaw), other];
        Some(Scene { number: number as i32, stamp_s, models_changed: false, bodies, extras: 0 })
    });
    println!("{:?}", tally.expect("the ports 1510 and 1511 are free"));
}
