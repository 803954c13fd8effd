//! Binary format of the turns of a host's event loop: the time of each, and its inputs in order. A replay of the host
//! needs nothing else. Little-endian; docs/record.md has the layout.

use std::net::{IpAddr, SocketAddr};

use xxhash_rust::xxh3::Xxh3;

use murmurate::edge::Packet;
use murmurate::graph::inputs::{DeviceId, Input};
use murmurate::messages::ids::{LinkId, RobotId};
use murmurate::net::protocol::codec::Frame;
use murmurate::net::protocol::counts::Refusal;
use murmurate::time::Time;

/// Turn of a host's event loop: one pass over all pending inputs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Turn {
    /// Time of the turn on the host's clock, since the start of the run.
    pub now: Time,
    /// Digest of the datagrams that were sent in the turn, in order; 0 if there were none.
    pub sent: u64,
    /// Inputs of the turn in the order of their arrival. Orders from the host's own process come last.
    pub inputs: Vec<Input>,
}

impl Turn {
    /// Returns the datagrams among the inputs, with their tags.
    pub fn frames(self) -> impl Iterator<Item = Frame> {
        self.inputs
            .into_iter()
            .filter_map(|input| if let Input::Frame(_, frame, _) = input { Some(frame) } else { None })
    }
}

/// Running digest of the datagrams that a host sends in one turn.
#[derive(Default)]
pub struct SentDigest(Option<Xxh3>);

impl SentDigest {
    /// Adds a sent datagram and the link on which it was sent.
    pub fn add(&mut self, link: LinkId, frame: &[u8]) {
        let digest = self.0.get_or_insert_default();
        digest.update(&link.0.to_le_bytes());
        digest.update(&(frame.len() as u64).to_le_bytes());
        digest.update(frame);
    }

    /// Returns the digest of the datagrams added so far, 0 if there is none, and starts the digest of the next turn.
    pub fn take(&mut self) -> u64 {
        self.0.take().map_or(0, |digest| digest.digest().max(1))
    }
}

const FRAME: u8 = 1;
const DROPPED: u8 = 2;
const DRIVER: u8 = 3;
const SOURCE: u8 = 4;
const DRIVER_ENDED: u8 = 5;
const SOURCE_ENDED: u8 = 6;
const LEAVE: u8 = 7;
const STOP: u8 = 8;
const REFUSED: u8 = 9;
const KEPT: u8 = 10;
const AGENT: u8 = 11;
const AGENT_ENDED: u8 = 12;
const SENSE: u8 = 13;
const SENSE_ENDED: u8 = 14;

/// Appends the beginning of an encoded turn to `out`: its time, and the digest of the datagrams sent in it.
pub fn begin(out: &mut Vec<u8>, now: Time, sent: u64) {
    out.extend(now.as_nanos().to_le_bytes());
    out.extend(sent.to_le_bytes());
}

/// Appends an input to the encoded turn in `out`.
pub fn add(out: &mut Vec<u8>, input: &Input) {
    match input {
        Input::Frame(link, frame, from) => {
            out.push(FRAME);
            out.extend(link.0.to_le_bytes());
            address(out, *from);
            block(out, frame);
        }
        Input::Dropped(link, count) => {
            out.push(DROPPED);
            out.extend(link.0.to_le_bytes());
            out.extend(count.to_le_bytes());
        }
        Input::Refused(link, cause, count) => {
            out.push(REFUSED);
            out.extend(link.0.to_le_bytes());
            let number = Refusal::ALL.iter().position(|one| one == cause).expect("all are in it");
            out.push(u8::try_from(number).expect("there are few"));
            out.extend(count.to_le_bytes());
        }
        Input::Packet(DeviceId::Driver(robot), packet) => {
            out.push(DRIVER);
            out.extend(robot.0.to_le_bytes());
            block(out, packet);
        }
        Input::Packet(DeviceId::Source, packet) => {
            out.push(SOURCE);
            block(out, packet);
        }
        Input::Ended(DeviceId::Driver(robot)) => {
            out.push(DRIVER_ENDED);
            out.extend(robot.0.to_le_bytes());
        }
        Input::Ended(DeviceId::Source) => out.push(SOURCE_ENDED),
        Input::Packet(DeviceId::Agent(robot), packet) => {
            out.push(AGENT);
            out.extend(robot.0.to_le_bytes());
            block(out, packet);
        }
        Input::Ended(DeviceId::Agent(robot)) => {
            out.push(AGENT_ENDED);
            out.extend(robot.0.to_le_bytes());
        }
        Input::Packet(DeviceId::Sense(robot, sense), packet) => {
            out.push(SENSE);
            out.extend(robot.0.to_le_bytes());
            out.push(*sense);
            block(out, packet);
        }
        Input::Ended(DeviceId::Sense(robot, sense)) => {
            out.push(SENSE_ENDED);
            out.extend(robot.0.to_le_bytes());
            out.push(*sense);
        }
        Input::Leave => out.push(LEAVE),
        Input::Stop => out.push(STOP),
        Input::Kept(number) => {
            out.push(KEPT);
            out.extend(number.to_le_bytes());
        }
    }
}

fn address(out: &mut Vec<u8>, from: Option<SocketAddr>) {
    match from {
        None => out.push(0),
        Some(from) => {
            match from.ip() {
                IpAddr::V4(ip) => {
                    out.push(4);
                    out.extend(ip.octets());
                }
                IpAddr::V6(ip) => {
                    out.push(6);
                    out.extend(ip.octets());
                }
            }
            out.extend(from.port().to_le_bytes());
        }
    }
}

fn block(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend(u32::try_from(bytes.len()).expect("a packet is below 4 GB").to_le_bytes());
    out.extend_from_slice(bytes);
}

/// Latest time of a turn \[ns\]: a hundred years. Later ones are damage, and no sum of times overflows.
const LATEST: u64 = 1 << 61;

/// Decodes a turn of a host's event loop; `None` if the bytes are invalid.
pub fn read(bytes: &[u8]) -> Option<Turn> {
    let mut rest = bytes;
    let now = Some(u64_of(&mut rest)?).filter(|now| *now < LATEST).map(Time::from_nanos)?;
    let sent = u64_of(&mut rest)?;
    let mut inputs = Vec::new();
    while !rest.is_empty() {
        inputs.push(input(&mut rest)?);
    }
    Some(Turn { now, sent, inputs })
}

fn input(rest: &mut &[u8]) -> Option<Input> {
    let robot = |rest: &mut &[u8]| Some(DeviceId::Driver(RobotId(u16_of(rest)?)));
    let agent = |rest: &mut &[u8]| Some(DeviceId::Agent(RobotId(u16_of(rest)?)));
    let sense = |rest: &mut &[u8]| Some(DeviceId::Sense(RobotId(u16_of(rest)?), *take(rest, 1)?.first()?));
    Some(match *take(rest, 1)?.first()? {
        FRAME => {
            let link = LinkId(u16_of(rest)?);
            let from = match *take(rest, 1)?.first()? {
                0 => None,
                kind => {
                    let ip: IpAddr = match kind {
                        4 => <[u8; 4]>::try_from(take(rest, 4)?).ok()?.into(),
                        6 => <[u8; 16]>::try_from(take(rest, 16)?).ok()?.into(),
                        _ => return None,
                    };
                    Some(SocketAddr::new(ip, u16_of(rest)?))
                }
            };
            Input::Frame(link, Frame::from(block_of(rest)?), from)
        }
        DROPPED => Input::Dropped(LinkId(u16_of(rest)?), Some(u64_of(rest)?).filter(|count| *count < 1 << 48)?),
        REFUSED => {
            let link = LinkId(u16_of(rest)?);
            let cause = *Refusal::ALL.get(usize::from(*take(rest, 1)?.first()?))?;
            Input::Refused(link, cause, Some(u64_of(rest)?).filter(|count| *count < 1 << 48)?)
        }
        DRIVER => Input::Packet(robot(rest)?, Packet::from(block_of(rest)?)),
        SOURCE => Input::Packet(DeviceId::Source, Packet::from(block_of(rest)?)),
        DRIVER_ENDED => Input::Ended(robot(rest)?),
        SOURCE_ENDED => Input::Ended(DeviceId::Source),
        AGENT => Input::Packet(agent(rest)?, Packet::from(block_of(rest)?)),
        AGENT_ENDED => Input::Ended(agent(rest)?),
        SENSE => Input::Packet(sense(rest)?, Packet::from(block_of(rest)?)),
        SENSE_ENDED => Input::Ended(sense(rest)?),
        LEAVE => Input::Leave,
        STOP => Input::Stop,
        KEPT => Input::Kept(u32_of(rest)?),
        _ => return None,
    })
}

fn take<'a>(rest: &mut &'a [u8], length: usize) -> Option<&'a [u8]> {
    let (taken, left) = rest.split_at_checked(length)?;
    *rest = left;
    Some(taken)
}

fn u16_of(rest: &mut &[u8]) -> Option<u16> {
    Some(u16::from_le_bytes(take(rest, 2)?.try_into().ok()?))
}

fn u32_of(rest: &mut &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(take(rest, 4)?.try_into().ok()?))
}

fn u64_of(rest: &mut &[u8]) -> Option<u64> {
    Some(u64::from_le_bytes(take(rest, 8)?.try_into().ok()?))
}

fn block_of<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = u32_of(rest)?;
    take(rest, length as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_is_read_as_it_was_written_and_no_part_of_it_is_a_turn_with_all_inputs() {
        let frame = |bytes: &[u8]| Frame::from(bytes);
        let inputs = vec![
            Input::Frame(LinkId(1), frame(b"abc"), Some("10.0.0.7:4000".parse().unwrap())),
            Input::Frame(LinkId(2), frame(b""), Some("[fe80::1]:9".parse().unwrap())),
            Input::Frame(LinkId(0), frame(&[7; 1400]), None),
            Input::Dropped(LinkId(3), 9),
            Input::Refused(LinkId(1), Refusal::Auth, 20_000),
            Input::Refused(LinkId(4), Refusal::DuplicateId, 1),
            Input::Packet(DeviceId::Driver(RobotId(4)), b"xy"[..].into()),
            Input::Packet(DeviceId::Source, b"z"[..].into()),
            Input::Ended(DeviceId::Driver(RobotId(5))),
            Input::Ended(DeviceId::Source),
            Input::Packet(DeviceId::Agent(RobotId(2)), b"step"[..].into()),
            Input::Ended(DeviceId::Agent(RobotId(2))),
            Input::Packet(DeviceId::Sense(RobotId(3), 1), b"scan"[..].into()),
            Input::Ended(DeviceId::Sense(RobotId(3), 1)),
            Input::Stop,
            Input::Kept(7),
            Input::Leave,
        ];
        let turn = Turn { now: Time::from_nanos(77), sent: 5, inputs };
        let mut bytes = Vec::new();
        begin(&mut bytes, turn.now, turn.sent);
        turn.inputs.iter().for_each(|input| add(&mut bytes, input));
        assert_eq!(read(&bytes), Some(turn.clone()));
        for cut in 0..bytes.len() {
            assert!(read(&bytes[..cut]).is_none_or(|part| part.inputs.len() < turn.inputs.len()), "{cut}");
        }
        bytes.push(200);
        assert_eq!(read(&bytes), None);
    }
}
