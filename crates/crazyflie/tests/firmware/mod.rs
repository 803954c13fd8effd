//! A fake Crazyflie without I/O: it takes and gives packets of CRTP, and flies a coarse model of itself.
//!
//! It was written from what PyPI's `cflib` sends and reads, apart from the driver's codec, and is judged by it
//! (`cflib_client.py`). Its time-outs are those of the firmware: level after 0.5 s without a setpoint, off after 2 s.

pub mod airframe;

use std::collections::BTreeMap;

use airframe::{Airframe, Setpoint};

/// Log variables: group, name, type (1 u8, 2 u16, 4 i8, 7 float).
const LOGS: [(&str, &str, u8); 12] = [
    ("gyro", "x", 7),
    ("pm", "vbat", 7),
    ("pm", "batteryLevel", 1),
    ("pm", "state", 4),
    ("stateEstimate", "x", 7),
    ("stateEstimate", "y", 7),
    ("stateEstimate", "z", 7),
    ("stateEstimate", "vx", 7),
    ("stateEstimate", "vy", 7),
    ("stateEstimate", "vz", 7),
    ("stateEstimate", "yaw", 7),
    ("supervisor", "info", 2),
];
/// Parameters: group, name, type (8 u8, 6 float; 0x40 read only), value at the start.
const PARAMS: [(&str, &str, u8, f32); 9] = [
    ("deck", "bcFlow2", 0x48, 1.0),
    ("commander", "enHighLevel", 0x08, 0.0),
    ("kalman", "resetEstimation", 0x08, 0.0),
    ("kalman", "initialX", 0x06, 0.0),
    ("kalman", "initialY", 0x06, 0.0),
    ("kalman", "initialZ", 0x06, 0.0),
    ("kalman", "initialYaw", 0x06, 0.0),
    ("stabilizer", "estimator", 0x08, 1.0),
    ("ring", "effect", 0x08, 6.0),
];
/// Further entries of both tables, so that they are as long as a small firmware's.
const MORE: u16 = 60;
/// Names of the numbers of errors.
const NO_SUCH: u8 = 2;
const EXISTS: u8 = 17;

#[derive(Clone, Debug, Default)]
struct Block {
    variables: Vec<(u8, u16)>,
    /// Period \[s\], zero if it is not started, and the time of the next packet.
    period: f64,
    next: f64,
}

/// A fake Crazyflie.
#[derive(Clone, Debug)]
pub struct Firmware {
    pub air: Airframe,
    pub protocol: u8,
    pub battery: u8,
    /// Low-level setpoints with their times.
    pub setpoints: Vec<(f64, Setpoint)>,
    /// Orders to the high-level commander (their first byte), with their times.
    pub orders: Vec<(f64, u8)>,
    /// Poses from outside: their number, and the last position.
    pub poses: (u64, [f32; 3]),
    pub entries_read: u64,
    pub cuts: u64,
    pub refused: u64,
    values: Vec<f32>,
    blocks: BTreeMap<u8, Block>,
}

fn float(data: &[u8], k: usize) -> f32 {
    f32::from_le_bytes(data[4 * k..4 * k + 4].try_into().expect("four bytes"))
}

impl Firmware {
    /// Makes a robot that was switched on at a place, looking along a heading \[rad\].
    pub fn new(x: f64, y: f64, yaw: f64) -> Firmware {
        let values = PARAMS.iter().map(|param| param.3).chain([0.0; MORE as usize]).collect();
        Firmware {
            air: Airframe::new(x, y, yaw),
            protocol: 12,
            battery: 90,
            setpoints: Vec::new(),
            orders: Vec::new(),
            poses: (0, [0.0; 3]),
            entries_read: 0,
            cuts: 0,
            refused: 0,
            values,
            blocks: BTreeMap::new(),
        }
    }

    /// Sets a parameter by its name, as a deck that is fitted does.
    pub fn set(&mut self, name: &str, value: f32) {
        let number = PARAMS.iter().position(|param| param.1 == name).expect("there is one");
        self.values[number] = value;
    }

    fn bits(&self) -> u16 {
        let air = &self.air;
        let bits = [true, true, true, air.may_fly(), air.flies(), air.tumbled, air.locked, air.crashed, air.is_led()];
        bits.iter().enumerate().map(|(k, bit)| u16::from(*bit) << k).sum()
    }

    /// Moves on by a time \[s\]; returns the packets that the robot sends by itself.
    pub fn step(&mut self, dt: f64) -> Vec<Vec<u8>> {
        self.air.step(dt);
        let (now, mut packets) = (self.air.now, Vec::new());
        let due: Vec<u8> =
            self.blocks.iter().filter(|(_, b)| b.period > 0.0 && b.next <= now).map(|(id, _)| *id).collect();
        for id in due {
            let block = self.blocks.get_mut(&id).expect("it is there");
            block.next = (block.next + block.period).max(now);
            let stamp = ((now * 1000.0) as u32).to_le_bytes();
            let mut data = vec![0x5e, id, stamp[0], stamp[1], stamp[2]];
            for (kind, number) in block.variables.clone() {
                let value = self.value(number);
                match kind {
                    1 | 4 => data.push(value as u8),
                    2 => data.extend((value as u16).to_le_bytes()),
                    _ => data.extend((value as f32).to_le_bytes()),
                }
            }
            packets.push(data);
        }
        packets
    }

    fn value(&self, number: u16) -> f64 {
        let Some((group, name, _)) = LOGS.get(usize::from(number)) else { return 0.0 };
        let air = &self.air;
        match (*group, *name) {
            ("pm", "vbat") => 3.0 + 0.012 * f64::from(self.battery),
            ("pm", "batteryLevel") => f64::from(self.battery),
            ("stateEstimate", "x") => air.estimate[0],
            ("stateEstimate", "y") => air.estimate[1],
            ("stateEstimate", "z") => air.estimate[2],
            ("stateEstimate", "vx") => air.velocity[0],
            ("stateEstimate", "vy") => air.velocity[1],
            ("stateEstimate", "vz") => air.velocity[2],
            ("stateEstimate", "yaw") => air.estimated_yaw.to_degrees(),
            ("supervisor", "info") => f64::from(self.bits()),
            _ => 0.0,
        }
    }

    /// Takes a packet; returns the answers.
    pub fn take(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let Some((header, data)) = bytes.split_first() else { return Vec::new() };
        let (port, channel) = (header >> 4, header & 3);
        let with = |data: Vec<u8>| vec![[&[port << 4 | 0x0c | channel][..], &data].concat()];
        match (port, channel, data) {
            (15, 3, _) => with(Vec::new()),
            (15, 0, echo) => with(echo.to_vec()),
            (15, 1, _) => with(b"Bitcraze Crazyflie\0".to_vec()),
            (13, 1, [0]) => with(vec![0, self.protocol]),
            (4, 0, [1]) => with(vec![1, 0]),
            (2 | 5, 0, request) => self.contents(port, request).map(with).unwrap_or_default(),
            (5, 1, request) => self.logging(request).map(with).unwrap_or_default(),
            (2, 1 | 2, request) => self.parameter(channel, request).map(with).unwrap_or_default(),
            (9, 0, [0x0c]) => with([&[0x8c][..], &self.bits().to_le_bytes()].concat()),
            (9, 1, [1, arm]) => with(vec![0x81, 1, *arm]),
            _ => {
                self.orders(port, channel, data);
                Vec::new()
            }
        }
    }

    fn contents(&mut self, port: u8, request: &[u8]) -> Option<Vec<u8>> {
        let own = if port == 5 { LOGS.len() } else { PARAMS.len() } as u16;
        match request {
            [3] => {
                let (length, crc) = ((own + MORE).to_le_bytes(), 0xc0de_0000 + u32::from(port));
                Some([&[3][..], &length, &crc.to_le_bytes(), &[16, 128]].concat())
            }
            [2, a, b] => {
                self.entries_read += 1;
                let number = u16::from_le_bytes([*a, *b]);
                let place = usize::from(number);
                let (group, name, kind) = match port {
                    5 => LOGS.get(place).map(|log| (log.0, log.1.to_owned(), log.2)),
                    _ => PARAMS.get(place).map(|param| (param.0, param.1.to_owned(), param.2)),
                }
                .unwrap_or(("more", format!("m{number}"), if port == 5 { 7 } else { 6 }));
                let text = [group.as_bytes(), &[0], name.as_bytes(), &[0]].concat();
                (number < own + MORE).then(|| [&[2, *a, *b, kind][..], &text].concat())
            }
            _ => None,
        }
    }

    fn logging(&mut self, request: &[u8]) -> Option<Vec<u8>> {
        let answer = match request {
            [5] => {
                self.blocks.clear();
                vec![5, 0, 0]
            }
            [6 | 7, id, variables @ ..] => {
                let code = if request[0] == 6 && self.blocks.contains_key(id) { EXISTS } else { 0 };
                if code == 0 {
                    let each = |v: &[u8]| (v[0] & 0x0f, u16::from_le_bytes([v[1], v[2]]));
                    let block = self.blocks.entry(*id).or_default();
                    block.variables.extend(variables.chunks_exact(3).map(each));
                }
                vec![request[0], *id, code]
            }
            [3, id, period] => match self.blocks.get_mut(id) {
                Some(block) => {
                    (block.period, block.next) = (f64::from(*period) * 0.01, self.air.now);
                    vec![3, *id, 0]
                }
                None => vec![3, *id, NO_SUCH],
            },
            [4, id] => {
                self.blocks.get_mut(id).into_iter().for_each(|block| block.period = 0.0);
                vec![4, *id, 0]
            }
            [2, id] => vec![2, *id, if self.blocks.remove(id).is_some() { 0 } else { NO_SUCH }],
            _ => return None,
        };
        Some(answer)
    }

    fn parameter(&mut self, channel: u8, request: &[u8]) -> Option<Vec<u8>> {
        let [a, b, value @ ..] = request else { return None };
        let number = usize::from(u16::from_le_bytes([*a, *b]));
        let is_byte = PARAMS.get(number).is_some_and(|param| param.2 & 0x0f == 8);
        if channel == 1 {
            let held = *self.values.get(number)?;
            let bytes = if is_byte { vec![held as u8] } else { held.to_le_bytes().to_vec() };
            return Some([&[*a, *b, 0][..], &bytes].concat());
        }
        let set = if is_byte { f32::from(*value.first()?) } else { float(value.get(..4)?, 0) };
        *self.values.get_mut(number)? = set;
        if PARAMS.get(number).is_some_and(|param| param.1 == "resetEstimation") && set == 1.0 {
            let [x, y, z, yaw] = std::array::from_fn(|k| f64::from(self.values[3 + k]));
            self.air.begin([x, y, z], yaw);
        }
        Some(request.to_vec())
    }

    /// Takes what has no answer.
    fn orders(&mut self, port: u8, channel: u8, data: &[u8]) {
        let number = |k: usize| data.get(1 + 4 * k..5 + 4 * k).map_or(f64::NAN, |data| f64::from(float(data, 0)));
        let now = self.air.now;
        match (port, channel, data) {
            (7, 0, [10, ..]) if data.len() == 17 => {
                let velocity = [number(0), number(1)];
                let setpoint = Setpoint::Hover { velocity, yaw_rate: number(2), height: number(3) };
                self.setpoints.push((now, setpoint));
                self.air.takes(setpoint);
            }
            (7, 0, [8, ..]) if data.len() == 17 => {
                let velocity = [number(0), number(1), number(2)];
                let setpoint = Setpoint::World { velocity, yaw_rate: number(3) };
                self.setpoints.push((now, setpoint));
                self.air.takes(setpoint);
            }
            (7, 0, [0]) => self.air.off(),
            (7, 1, [0, ..]) => self.air.low = None,
            (8, 0, [kind @ (7 | 8), _, rest @ ..]) if rest.len() == 13 => {
                self.orders.push((now, *kind));
                let lasts = f32::from_le_bytes(rest[9..13].try_into().expect("four bytes"));
                self.air.goes(f64::from(float(rest, 0)), f64::from(lasts));
            }
            (8, 0, [3, _]) => {
                self.orders.push((now, 3));
                self.air.off();
            }
            (6, 0, _) if data.len() == 12 => self.pose([0, 1, 2].map(|k| float(data, k)), None),
            (6, 1, [8, rest @ ..]) if rest.len() == 28 => {
                let yaw = 2.0 * f64::from(float(rest, 5)).atan2(f64::from(float(rest, 6)));
                self.pose([0, 1, 2].map(|k| float(rest, k)), Some(yaw));
            }
            (9, 1, [3]) | (6, 1, [3]) => {
                self.cuts += 1;
                self.air.locked = true;
                self.air.off();
            }
            // The setpoint of the gamepad, which clients send when they leave.
            (3, 0, _) => {}
            _ => self.refused += 1,
        }
    }

    fn pose(&mut self, position: [f32; 3], yaw: Option<f64>) {
        self.poses = (self.poses.0 + 1, position);
        self.air.told(position.map(f64::from), yaw);
    }
}
