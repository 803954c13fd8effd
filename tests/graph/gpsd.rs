//! The source `gpsd`: its worker against a fake of gpsd on the loopback interface.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use murmurate::edge::{self, Gate, Running, Settings};
use murmurate::localization::{In, Out, Source};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use murmurate::time::Time;
use murmurate_devices::gpsd;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use crate::common::{HANGS, ends};

/// Waits for a client and reads its request.
fn accept(listener: &TcpListener) -> TcpStream {
    let (mut stream, _) = listener.accept().expect("a client");
    stream.write_all(b"{\"class\":\"VERSION\",\"release\":\"3.22\"}\r\n").expect("it reads");
    let mut request = String::new();
    BufReader::new(&stream).read_line(&mut request).expect("a request");
    assert_eq!(request, "?WATCH={\"enable\":true,\"json\":true};\n");
    stream
}

fn fix(stream: &mut TcpStream, second: u32) {
    let line = format!(
        "{{\"class\":\"TPV\",\"mode\":3,\"status\":3,\"time\":\"2026-11-22T12:00:{second:02}.000Z\",\"lat\":52.2053,\
         \"lon\":0.1218,\"altHAE\":58.0,\"track\":90.0,\"speed\":0.5}}\r\n"
    );
    stream.write_all(line.as_bytes()).expect("it reads");
}

/// Returns the next reading.
fn next(gate: &mut Gate, source: &mut dyn Source) -> Reading {
    let begun = Instant::now();
    while begun.elapsed() < HANGS {
        let (bell, mut out) = (gate.bell(), Vec::new());
        poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::from(100u16)).expect("it polls");
        gate.take(|packet| source.take(Time::ZERO, In::Packet(&packet), &mut out));
        match out.pop() {
            None => {}
            Some(Out::Reading(reading)) => return reading,
            Some(other) => panic!("{other:?}"),
        }
    }
    panic!("no reading");
}

/// Starts the source with its worker, against a gpsd of this listener.
fn employ(listener: &TcpListener) -> (Box<dyn Source>, Gate, Running) {
    let address = listener.local_addr().expect("bound");
    let table = format!("address = '{address}'\norigin_latitude_deg = 52.2053\norigin_longitude_deg = 0.1218");
    let settings = Settings { name: "gpsd".to_owned(), table: table.parse().expect("it is TOML") };
    let parts = gpsd::make(&settings, &[RobotId(2)]).unwrap_or_else(|error| panic!("{error}"));
    let (gate, worker) = edge::start(parts.worker, "source").expect("a thread");
    ((parts.source)(), gate, worker)
}

#[test]
fn the_worker_subscribes_and_comes_back_after_gpsd_has_ended() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let (mut source, mut gate, worker) = employ(&listener);
    let mut stream = accept(&listener);
    fix(&mut stream, 1);
    let reading = next(&mut gate, &mut *source);
    assert_eq!((reading.robot, reading.stamp_ns % 1_000_000_000_000), (RobotId(2), 801_000_000_000));
    drop(stream);
    let mut stream = accept(&listener);
    fix(&mut stream, 2);
    assert_eq!(next(&mut gate, &mut *source).stamp_ns - reading.stamp_ns, 1_000_000_000);
    drop(gate);
    ends(worker, "gpsd");
}

#[test]
fn a_gpsd_that_is_halted_gives_no_readings_and_is_asked_anew_after_five_seconds() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let (mut source, mut gate, worker) = employ(&listener);
    let mut halted = accept(&listener);
    fix(&mut halted, 1);
    let reading = next(&mut gate, &mut *source);
    // It keeps the connection, and says nothing more.
    let silent = Instant::now();
    let mut other = accept(&listener);
    assert!(silent.elapsed() >= Duration::from_millis(4900), "a receiver may be slow: {:?}", silent.elapsed());
    gate.take(|packet| assert!(packet.starts_with(b"{\"class\":\"VERSION\""), "no reading is repeated"));
    fix(&mut other, 7);
    assert_eq!(next(&mut gate, &mut *source).stamp_ns - reading.stamp_ns, 6_000_000_000);
    // Output of the halted one, once it goes on, arrives nowhere.
    let mut rest = Vec::new();
    assert!(halted.read_to_end(&mut rest).is_ok() && rest.is_empty(), "its connection is closed");
    // One that is halted does not keep its host from ending.
    drop(gate);
    ends(worker, "gpsd");
}

#[test]
fn one_source_is_of_one_robot() {
    let table = "origin_latitude_deg = 52.2053\norigin_longitude_deg = 0.1218".parse().expect("it is TOML");
    let settings = Settings { name: "gpsd".to_owned(), table };
    for robots in [&[][..], &[RobotId(0), RobotId(1)]] {
        let error = gpsd::make(&settings, robots).err().expect("it is refused").to_string();
        assert!(error.contains("one robot"), "{error}");
    }
}
