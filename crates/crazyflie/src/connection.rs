//! Connecting to a Crazyflie: protocol version, tables of contents, and the log blocks that this driver needs.
//! Questions are repeated until they are answered, since links lose packets.

use std::collections::{BTreeMap, VecDeque};

use murmurate::time::Time;

use crate::packet::{Packet, port};
use crate::requests;
use crate::toc::{Fetch, Kept, REPEAT, Toc};
use crate::{estimate, status};

/// Log blocks of this driver: the estimate, and the condition.
pub const ESTIMATE_BLOCK: u8 = 1;
/// See [`ESTIMATE_BLOCK`].
pub const STATUS_BLOCK: u8 = 2;
/// Period of the block with the condition \[10 ms\].
const STATUS_PERIOD: u8 = 10;
/// First protocol version with tables of more than 255 entries, which all firmware since 2018 has.
const LEAST_PROTOCOL: u8 = 4;
/// Answer of the firmware to a log block that it has already.
const EXISTS: u8 = 17;
/// Parameters that say whether the robot has a deck that measures its height above the ground.
pub const DECKS: [&str; 4] = ["deck.bcFlow2", "deck.bcZRanger2", "deck.bcFlow", "deck.bcZRanger"];

/// Question to the robot that is repeated until it is answered.
#[derive(Clone, Debug)]
struct Ask {
    packet: Packet,
    /// Number of bytes at the beginning of the data that the answer repeats.
    same: usize,
    sent: Option<Time>,
}

impl Ask {
    fn new(packet: Packet, same: usize) -> Ask {
        Ask { packet, same, sent: None }
    }

    fn is_answered_by(&self, packet: &Packet) -> bool {
        (packet.port, packet.channel) == (self.packet.port, self.packet.channel)
            && packet.data.len() > self.same.min(1)
            && packet.data.get(..self.same) == Some(&self.packet.data[..self.same])
    }
}

/// Connection with a robot, from nothing to log blocks that arrive.
#[derive(Clone, Debug, Default)]
pub struct Connection {
    /// Version of the robot's protocol; zero before it is known.
    pub protocol: u8,
    /// Period of the block with the estimate \[10 ms\].
    period: u8,
    asks: VecDeque<Ask>,
    fetch: Option<Fetch>,
    log: Toc,
    params: Toc,
    /// Values of parameters that were asked for, by their names.
    values: BTreeMap<&'static str, u8>,
    /// Whether all is set up.
    ready: bool,
    /// Reason for which this robot cannot be flown; `None` if there is none.
    pub fault: Option<String>,
}

impl Connection {
    /// Begins to connect; the estimate comes with a period \[10 ms\].
    pub fn new(period: u8) -> Connection {
        Connection { period, asks: [Ask::new(requests::version(), 1)].into(), ..Connection::default() }
    }

    /// Whether the robot is set up: its log blocks were started.
    pub fn is_ready(&self) -> bool {
        self.ready
    }

    /// Whether the robot has a deck that measures its height.
    pub fn measures_height(&self) -> bool {
        self.values.values().any(|value| *value != 0)
    }

    /// Asks the robot to set a parameter to a value of its type, if its firmware has the parameter.
    pub fn set(&mut self, name: &str, value: f32) {
        let Some((number, kind)) = self.params.find(name) else { return };
        let bytes = match kind {
            0x06 => value.to_le_bytes().to_vec(),
            0x08 => vec![value as u8],
            0x00 => (value as i8).to_le_bytes().to_vec(),
            0x09 => (value as u16).to_le_bytes().to_vec(),
            _ => return,
        };
        self.asks.push_back(Ask::new(requests::write_parameter(number, &bytes), 2));
    }

    /// Whether questions or orders to the robot have no answer yet.
    pub fn is_asking(&self) -> bool {
        !self.asks.is_empty()
    }

    /// Returns the questions that are due at `now`.
    pub fn due(&mut self, now: Time) -> Vec<Packet> {
        if let Some(fetch) = &mut self.fetch {
            return fetch.due(now);
        }
        let Some(ask) = self.asks.front_mut() else { return Vec::new() };
        if ask.sent.is_some_and(|sent| now.since(sent) < REPEAT) {
            return Vec::new();
        }
        ask.sent = Some(now);
        vec![ask.packet.clone()]
    }

    /// Takes a packet of the robot. Tables that are read whole are added to `kept`.
    pub fn take(&mut self, packet: &Packet, kept: &mut Kept) {
        match &mut self.fetch {
            Some(fetch) if packet.channel == 0 && packet.port == fetch.port => match fetch.take(&packet.data, kept) {
                Ok(Some(toc)) => self.fetched(toc),
                Ok(None) => {}
                Err(why) => self.fault = Some(why.to_owned()),
            },
            Some(_) => {}
            None => {
                let answered = self.asks.front().filter(|ask| ask.is_answered_by(packet)).cloned();
                if let Some(ask) = answered {
                    self.asks.pop_front();
                    self.answered(&ask, packet);
                }
            }
        }
        self.ready |= self.asks.is_empty() && self.fetch.is_none() && self.fault.is_none();
    }

    fn answered(&mut self, ask: &Ask, packet: &Packet) {
        let data = &packet.data;
        match (packet.port, packet.channel, &data[..]) {
            (port::PLATFORM, 1, [0, protocol, ..]) => {
                self.protocol = *protocol;
                if *protocol < LEAST_PROTOCOL {
                    self.fault = Some(format!("its firmware speaks protocol version {protocol}: update it"));
                } else {
                    self.asks.push_back(Ask::new(requests::reset_logs(), 1));
                }
            }
            (port::LOG, 1, [5, ..]) => self.fetch = Some(Fetch::new(port::LOG)),
            (port::LOG, 1, [_, _, code, ..]) if *code != 0 && *code != EXISTS => {
                self.fault = Some(format!("it refuses log block {}: error {code}", data[1]));
            }
            (port::PARAM, 1, [_, _, _, value, ..]) => {
                let name = DECKS.iter().find(|name| {
                    self.params.find(name).is_some_and(|(number, _)| number.to_le_bytes() == ask.packet.data[..2])
                });
                self.values.extend(name.map(|name| (*name, *value)));
            }
            _ => {}
        }
    }

    fn fetched(&mut self, toc: Toc) {
        let port = self.fetch.take().map_or(port::LOG, |fetch| fetch.port);
        if port == port::LOG {
            (self.log, self.fetch) = (toc, Some(Fetch::new(port::PARAM)));
            return;
        }
        self.params = toc;
        for number in DECKS.iter().filter_map(|name| self.params.find(name)).map(|(number, _)| number) {
            self.asks.push_back(Ask::new(requests::read_parameter(number), 2));
        }
        // Newer firmware has it always on, and has no such parameter.
        self.set("commander.enHighLevel", 1.0);
        // The extended Kalman filter, which takes positions from outside.
        self.set("stabilizer.estimator", 2.0);
        self.block(ESTIMATE_BLOCK, self.period, &estimate::VARIABLES);
        self.block(STATUS_BLOCK, STATUS_PERIOD, &status::VARIABLES);
    }

    /// Asks for a log block of variables, each with the type in which it is sent.
    fn block(&mut self, block: u8, period: u8, variables: &[(&str, u8)]) {
        let mut found = Vec::new();
        for (name, kind) in variables {
            match self.log.find(name) {
                Some((number, _)) => found.push((*kind, number)),
                None => {
                    self.fault = Some(format!("its firmware has no log variable {name}: update it"));
                    return;
                }
            }
        }
        self.asks.push_back(Ask::new(requests::create_block(block, &found), 2));
        self.asks.push_back(Ask::new(requests::start_block(block, period), 2));
    }
}
