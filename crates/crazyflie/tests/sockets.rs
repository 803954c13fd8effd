//! The worker over a socket: it carries packets, and makes a robot land whose driver is silent or whose host ends.

use std::net::UdpSocket;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use murmurate::edge::{self, Gate, Running, Settings};
use murmurate::messages::ids::RobotId;
use murmurate::time::Span;
use murmurate_crazyflie::ENTRY;
use murmurate_crazyflie::link::{FromWorker, ToWorker};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

/// Longest wait for what has to come: only a worker that hangs takes so long.
const HANGS: Duration = Duration::from_secs(60);
/// Packets of the high-level commander and of the end of setpoints begin with these bytes.
const LAND: [u8; 2] = [0x8c, 8];
const END_SETPOINTS: [u8; 2] = [0x7d, 0];

fn worker(robot: &UdpSocket) -> (Gate, Running) {
    let table = format!("uri = 'udp://{}'", robot.local_addr().expect("it is bound")).parse().expect("TOML");
    let parts = (ENTRY.make)(&Settings { name: "crazyflie".to_owned(), table }, RobotId(0)).expect("it is sound");
    edge::start(parts.worker.expect("it has one"), "a robot").expect("there are threads left")
}

fn robot() -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("there are ports");
    socket.set_read_timeout(Some(HANGS)).expect("it can be set");
    socket
}

/// Sends a packet until the robot hears it, since the worker's socket opens a moment after its start.
fn greet(gate: &mut Gate, robot: &UdpSocket, hold: Span) -> std::net::SocketAddr {
    robot.set_read_timeout(Some(Duration::from_millis(20))).expect("it can be set");
    let began = Instant::now();
    loop {
        gate.send(ToWorker { hold, landing: Span::from_millis(1500), crtp: &[0xdd, 0] }.encode());
        let mut bytes = [0; 64];
        if let Ok((2, from)) = robot.recv_from(&mut bytes) {
            assert_eq!(bytes[..2], [0xdd, 0]);
            robot.set_read_timeout(Some(HANGS)).expect("it can be set");
            return from;
        }
        assert!(began.elapsed() < HANGS, "it is never heard");
    }
}

fn next(robot: &UdpSocket) -> Vec<u8> {
    let mut bytes = [0; 64];
    let length = robot.recv(&mut bytes).expect("something comes");
    bytes[..length].to_vec()
}

/// Returns the first packets after those of the greeting.
fn landing(robot: &UdpSocket) -> [Vec<u8>; 2] {
    let first = std::iter::from_fn(|| Some(next(robot))).find(|bytes| bytes[0] != 0xdd).expect("it goes on");
    [first, next(robot)]
}

#[test]
fn packets_are_carried_both_ways_and_strangers_are_not_heard() {
    let (robot, stranger) = (robot(), robot());
    let (mut gate, running) = worker(&robot);
    let at = greet(&mut gate, &robot, Span::ZERO);
    stranger.send_to(&[0xdd, 0, 99], at).expect("it is sent");
    robot.send_to(&[0xdd, 0, 12], at).expect("it is sent");
    let mut heard = Vec::new();
    while heard.is_empty() {
        let bell = gate.bell();
        let longest = PollTimeout::try_from(HANGS).expect("a minute");
        assert_eq!(poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], longest), Ok(1));
        gate.take(|packet| heard.push(packet));
    }
    assert_eq!(heard, [FromWorker::Crtp(&[0xdd, 0, 12]).encode()]);
    drop(gate);
    assert!(running.join(HANGS));
}

#[test]
fn a_robot_whose_driver_is_silent_is_made_to_land_in_time_and_again() {
    let robot = robot();
    let (mut gate, running) = worker(&robot);
    greet(&mut gate, &robot, Span::from_millis(400));
    let began = Instant::now();
    let [first, second] = landing(&robot);
    let took = began.elapsed();
    assert!(took >= Duration::from_millis(300) && took < Duration::from_secs(2), "{took:?}");
    assert_eq!((&first[..2], &second[..2]), (&END_SETPOINTS[..], &LAND[..]));
    assert_eq!(next(&robot)[..2], END_SETPOINTS, "it may have been lost");
    drop(gate);
    assert!(running.join(HANGS));
}

#[test]
fn a_host_that_ends_makes_its_robot_land_and_one_on_the_ground_is_left_alone() {
    let robot = robot();
    let (mut gate, running) = worker(&robot);
    greet(&mut gate, &robot, Span::from_millis(60_000));
    drop(gate);
    assert_eq!(landing(&robot)[1][..2], LAND);
    assert!(running.join(HANGS));
    let grounded = self::robot();
    let (mut gate, running) = worker(&grounded);
    greet(&mut gate, &grounded, Span::ZERO);
    drop(gate);
    assert!(running.join(HANGS));
    grounded.set_nonblocking(true).expect("it can be set");
    let mut bytes = [0; 64];
    while let Ok(length) = grounded.recv(&mut bytes) {
        assert_eq!(bytes[..length], [0xdd, 0], "nothing but the greeting");
    }
}
