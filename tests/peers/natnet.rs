//! Encoder of NatNet, bitstreams 3.0 to 4.4, and a server of a scene: a fake of a tracker, for tests.
//!
//! It is independent of the decoder under test: it shares no code with it. Other people's clients track it
//! (`nn_clients.py`). 4.2 to 4.4 were accepted by no independent client.

#![allow(dead_code)]

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use socket2::{Domain, Protocol, Socket, Type};

/// Time without a request after which a unicast client is forgotten.
const FORGOTTEN: Duration = Duration::from_secs(5);

/// Bitstream, by major and minor number.
pub type Version = [u8; 2];

/// Rigid body of a scene, in the axes of the tracker.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// Name in model definitions.
    pub name: String,
    /// Streaming ID.
    pub id: i32,
    /// Position \[m\].
    pub position: [f32; 3],
    /// Rotation: x, y, z, w.
    pub rotation: [f32; 4],
    /// Mean marker error \[m\].
    pub error_m: f32,
    /// Whether it is tracked.
    pub tracked: bool,
}

/// Scene of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Frame number.
    pub number: i32,
    /// Stamp \[s\].
    pub stamp_s: f64,
    /// Whether model definitions have changed.
    pub models_changed: bool,
    /// Rigid bodies.
    pub bodies: Vec<Body>,
    /// Number of elements of every other section.
    pub extras: i32,
}

impl Body {
    /// Makes a tracked body at a place of a tracker with its y axis up, turned about that axis \[rad\].
    pub fn standing(name: &str, id: i32, position: [f32; 3], yaw: f32) -> Body {
        let rotation = [0.0, (yaw / 2.0).sin(), 0.0, (yaw / 2.0).cos()];
        Body { name: name.to_owned(), id, position, rotation, error_m: 2e-4, tracked: true }
    }
}

/// Writer of little-endian fields.
#[derive(Default)]
struct Writer(Vec<u8>);

impl Writer {
    fn i16(&mut self, number: i16) {
        self.0.extend(number.to_le_bytes());
    }

    fn i32(&mut self, number: i32) {
        self.0.extend(number.to_le_bytes());
    }

    fn f32s(&mut self, numbers: &[f32]) {
        numbers.iter().for_each(|number| self.0.extend(number.to_le_bytes()));
    }

    fn text(&mut self, text: &str) {
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    /// Writes a section: its count, from 4.1 its length, and its elements.
    fn section(&mut self, version: Version, count: i32, write: impl Fn(&mut Writer)) {
        self.i32(count);
        let mut elements = Writer::default();
        write(&mut elements);
        if version >= [4, 1] {
            self.i32(elements.0.len() as i32);
        }
        self.0.extend(elements.0);
    }

    fn body(&mut self, body: &Body) {
        self.i32(body.id);
        self.f32s(&body.position);
        self.f32s(&body.rotation);
        self.f32s(&[body.error_m]);
        self.i16(i16::from(body.tracked));
    }
}

fn message(id: u16, payload: Writer) -> Vec<u8> {
    let length = u16::try_from(payload.0.len()).expect("a scene fits into a datagram");
    [&id.to_le_bytes()[..], &length.to_le_bytes(), &payload.0].concat()
}

/// Encodes a frame of motion capture data as a datagram.
pub fn frame(version: Version, scene: &Scene) -> Vec<u8> {
    let (mut out, extras) = (Writer::default(), scene.extras);
    let bone = Body::standing("", 900, [0.5; 3], 0.0);
    out.i32(scene.number);
    out.section(version, extras, |out| {
        for at in 0..extras {
            out.text("set");
            out.i32(at);
            (0..at).for_each(|_| out.f32s(&[0.1, 0.2, 0.3]));
        }
    });
    out.section(version, extras, |out| (0..extras).for_each(|_| out.f32s(&[1.0, 2.0, 3.0])));
    out.section(version, scene.bodies.len() as i32, |out| scene.bodies.iter().for_each(|body| out.body(body)));
    out.section(version, extras, |out| {
        for at in 0..extras {
            out.i32(100 + at);
            out.i32(2);
            (0..2).for_each(|_| out.body(&bone));
        }
    });
    if version >= [4, 1] {
        out.section(version, extras, |out| {
            for at in 0..extras {
                out.i32(200 + at);
                out.i32(1);
                out.body(&bone);
                out.i32(1);
                labeled_marker(out, at);
            }
        });
    }
    out.section(version, extras, |out| (0..extras).for_each(|at| labeled_marker(out, at)));
    for _ in 0..2 {
        out.section(version, extras, |out| {
            for at in 0..extras {
                out.i32(300 + at);
                out.i32(2);
                for samples in [1, 2] {
                    out.i32(samples);
                    (0..samples).for_each(|_| out.f32s(&[0.25]));
                }
            }
        });
    }
    // Time code, stamp, three stamps in ticks.
    out.i32(0);
    out.i32(0);
    out.0.extend(scene.stamp_s.to_le_bytes());
    (0..3).for_each(|_| out.0.extend(((scene.stamp_s * 1e7) as u64).to_le_bytes()));
    // The precise stamp. The manufacturer's parser reads it from 4.0 on, its comment there says 4.1, and clients of
    // others do not miss it: so 4.0 has it here.
    if version >= [4, 0] {
        out.i32(scene.stamp_s as i32);
        out.i32(0);
    }
    out.i16(if scene.models_changed { 2 } else { 0 });
    out.i32(0);
    message(7, out)
}

fn labeled_marker(out: &mut Writer, at: i32) {
    out.i32((1 << 16) + at);
    out.f32s(&[0.1, 0.2, 0.3, 0.014]);
    out.i16(2);
    out.f32s(&[1e-4]);
}

/// Encodes model definitions as a datagram: `extras` of every other kind, then the bodies, then a camera.
pub fn model(version: Version, bodies: &[Body], extras: i32) -> Vec<u8> {
    let mut out = Writer::default();
    let kinds = if version >= [4, 1] { 5 } else { 4 };
    out.i32(bodies.len() as i32 + kinds * extras + i32::from(extras > 0));
    for _ in 0..extras {
        definition(version, &mut out, 0, |out| {
            out.text("set");
            out.i32(2);
            out.text("a");
            out.text("b");
        });
        definition(version, &mut out, 2, |out| {
            out.text("skeleton");
            out.i32(5);
            out.i32(1);
            body_definition(version, out, "bone", 900);
        });
        for kind in [3, 4] {
            definition(version, &mut out, kind, |out| {
                out.i32(9);
                out.text("serial");
                if kind == 3 {
                    out.f32s(&[0.5; 161]);
                } else {
                    out.text("device");
                }
                out.i32(0);
                out.i32(0);
                out.i32(1);
                out.text("channel");
            });
        }
        if version >= [4, 1] {
            definition(version, &mut out, 6, |out| out.text("asset"));
        }
    }
    for body in bodies {
        definition(version, &mut out, 1, |out| body_definition(version, out, &body.name, body.id));
    }
    if extras > 0 {
        definition(version, &mut out, 5, |out| {
            out.text("camera");
            out.f32s(&[0.0; 7]);
        });
    }
    message(5, out)
}

fn definition(version: Version, out: &mut Writer, kind: i32, write: impl Fn(&mut Writer)) {
    out.i32(kind);
    let mut definition = Writer::default();
    write(&mut definition);
    if version >= [4, 1] {
        out.i32(definition.0.len() as i32);
    }
    out.0.extend(definition.0);
}

fn body_definition(version: Version, out: &mut Writer, name: &str, id: i32) {
    out.text(name);
    out.i32(id);
    out.i32(-1);
    out.f32s(&[0.0; 3]);
    if version >= [4, 2] {
        out.f32s(&[0.0, 0.0, 0.0, 1.0]);
    }
    out.i32(2);
    out.f32s(&[0.1; 6]);
    out.i32(1);
    out.i32(2);
    if version >= [4, 0] {
        out.text("marker one");
        out.text("marker two");
    }
}

/// Encodes a server's description as a datagram.
pub fn server_info(version: Version, multicast: bool, data_port: u16) -> Vec<u8> {
    let mut out = Writer::default();
    out.0.extend(b"fake tracker");
    out.0.resize(256, 0);
    out.0.extend([1, 2, 0, 0, version[0], version[1], 0, 0]);
    out.0.extend(10_000_000u64.to_le_bytes());
    out.0.extend(data_port.to_le_bytes());
    out.0.push(u8::from(multicast));
    out.0.extend([239, 255, 42, 99]);
    message(1, out)
}

/// Addresses and bitstream of a fake server.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Its own address.
    pub address: Ipv4Addr,
    /// Port of commands.
    pub command_port: u16,
    /// Port of frames.
    pub data_port: u16,
    /// Multicast group; none for unicast.
    pub group: Option<Ipv4Addr>,
    /// Bitstream, unless a unicast client asks for another.
    pub version: Version,
    /// Period of frames.
    pub period: Duration,
}

/// Counts of what a server has done.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Number of frames.
    pub frames: u64,
    /// Number of requests of each kind.
    pub requests: BTreeMap<u16, u64>,
    /// Addresses that requests came from.
    pub clients: BTreeSet<SocketAddr>,
}

/// Serves a scene, a function of the time since the start \[s\], until `stop`. A scene of none sends nothing.
pub fn serve(
    setup: &Setup,
    stop: &Arc<AtomicBool>,
    mut scene: impl FnMut(f64, u64) -> Option<Scene>,
) -> io::Result<Tally> {
    let bind = |port: u16| -> io::Result<UdpSocket> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_reuse_address(true)?;
        socket.set_nonblocking(true)?;
        socket.bind(&SocketAddr::from((setup.address, port)).into())?;
        socket.set_multicast_if_v4(&setup.address)?;
        Ok(socket.into())
    };
    let (command, data) = (bind(setup.command_port)?, bind(setup.data_port)?);
    let (begun, mut tally) = (Instant::now(), Tally::default());
    let mut clients: BTreeMap<SocketAddr, (Instant, Version)> = BTreeMap::new();
    let mut bodies = Vec::new();
    let (mut next, mut buffer) = (begun, [0; 2048]);
    while !stop.load(Ordering::Relaxed) {
        // A request is waited for until the next frame is due.
        let wait_ms = next.saturating_duration_since(Instant::now()).as_millis() as u16;
        poll(&mut [PollFd::new(command.as_fd(), PollFlags::POLLIN)], PollTimeout::from(wait_ms))?;
        while let Ok((length, from)) = command.recv_from(&mut buffer) {
            let [id, ..] = *buffer[..length].as_chunks().0 else { continue };
            let id = u16::from_le_bytes(id);
            *tally.requests.entry(id).or_default() += 1;
            tally.clients.insert(from);
            let known = clients.get(&from).map_or(setup.version, |(_, version)| *version);
            let mut version = known;
            let asked = buffer.get(269..271).filter(|asked| setup.group.is_none() && asked[0] != 0 && length >= 271);
            if let (0, Some(&[major, minor])) = (id, asked) {
                // A server knows no bitstream that is newer than its own.
                version = setup.version.min([major, minor]);
            }
            clients.insert(from, (Instant::now(), version));
            let answer = match id {
                0 => server_info(setup.version, setup.group.is_some(), setup.data_port),
                4 => model(version, &bodies, 0),
                2 => [&[3, 0, 4, 0][..], &[0; 4]].concat(),
                _ => continue,
            };
            command.send_to(&answer, from)?;
        }
        clients.retain(|_, (heard, _)| heard.elapsed() < FORGOTTEN);
        if Instant::now() >= next {
            next += setup.period;
            if let Some(scene) = scene(begun.elapsed().as_secs_f64(), tally.frames) {
                tally.frames += 1;
                match setup.group {
                    Some(group) => {
                        data.send_to(&frame(setup.version, &scene), (group, setup.data_port))?;
                    }
                    None => {
                        for (client, (_, version)) in &clients {
                            // The client may be gone.
                            let _ = data.send_to(&frame(*version, &scene), client);
                        }
                    }
                }
                bodies = scene.bodies;
            }
        }
    }
    Ok(tally)
}
