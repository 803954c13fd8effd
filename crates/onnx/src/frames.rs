//! Frames between a host and the process that computes a policy in Python, as plain bytes.
//!
//! A frame is its length (u32), the number of the call (u32), its kind (u8) and a body; all numbers are little-endian.
//! The host says hello with the contract and the arrays of each call as JSON; the policy answers with what it has.
//! Then a call is a role (u8), the numbers of robots and of places for neighbours (u32 each) and the arrays as 32-bit
//! floats, and its answer the arrays that come out. A call that has failed is answered by a line of text. The number
//! tells a late answer from that of the present call.

use murmurate::messages::ids::RobotId;
use serde::{Deserialize, Serialize};

use crate::Contract;
use crate::engine::Array;
use crate::network::{Port, ports};
use crate::structure::Role;

/// Version of the protocol.
pub const PROTOCOL: u32 = 2;
/// Number of bytes of a frame before its body.
pub const HEAD: usize = 9;
/// Longest frame that is read, without its length \[bytes\].
pub const MAX_FRAME: usize = 64 << 20;

/// Kind of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The host's greeting.
    Hello = 0,
    /// A call of the policy.
    Call = 1,
    /// Answer to a greeting or a call.
    Answer = 2,
    /// Line of text that says why a call has failed.
    Error = 3,
    /// Notice that a robot begins anew.
    Reset = 4,
}

/// Head of a frame that was received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Number of bytes of the body.
    pub body: usize,
    /// Number of the call that it answers.
    pub number: u32,
    /// Kind of the frame: the code of a [`Kind`], or one that has none.
    pub kind: u8,
}

/// First frame of the host: the contract, and the arrays of the calls.
#[derive(Serialize)]
struct Hello<'a> {
    protocol: u32,
    contract: &'a Contract,
    calls: Vec<Calls>,
}

/// Arrays of the calls of one role.
#[derive(Serialize)]
struct Calls {
    role: &'static str,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
}

/// Answer of the policy to the first frame.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Greeting {
    protocol: u32,
    /// Name of the class.
    pub name: String,
    /// Digest of the class's source.
    pub digest: String,
    /// Whether it has the methods `encode` and `act`, and not `step`.
    pub two: bool,
}

/// Returns a frame of this kind for the call `number`. An error says that its body is too long.
pub fn frame(kind: Kind, number: u32, body: &[u8]) -> Result<Vec<u8>, String> {
    let length = HEAD - 4 + body.len();
    let length = u32::try_from(length).ok().filter(|_| length <= MAX_FRAME).ok_or("the inputs are too large")?;
    let mut frame = length.to_le_bytes().to_vec();
    frame.extend_from_slice(&number.to_le_bytes());
    frame.push(kind as u8);
    frame.extend_from_slice(body);
    Ok(frame)
}

/// Reads the head of a frame. An error says that its length is none of a frame.
pub fn head(bytes: [u8; HEAD]) -> Result<Head, String> {
    let [l0, l1, l2, l3, n0, n1, n2, n3, kind] = bytes;
    let length = usize::try_from(u32::from_le_bytes([l0, l1, l2, l3])).unwrap_or(usize::MAX);
    if !(HEAD - 4..=MAX_FRAME).contains(&length) {
        return Err(format!("it has sent a frame of {length} bytes"));
    }
    Ok(Head { body: length + 4 - HEAD, number: u32::from_le_bytes([n0, n1, n2, n3]), kind })
}

/// Returns the body of the host's greeting for a policy of this contract.
pub fn hello(contract: &Contract) -> Result<Vec<u8>, String> {
    let roles = [("step", Role::Step), ("encode", Role::Encode), ("act", Role::Act)];
    let calls = roles.map(|(role, of)| {
        let (inputs, outputs) = ports(contract, of);
        Calls { role, inputs, outputs }
    });
    let hello = Hello { protocol: PROTOCOL, contract, calls: calls.into() };
    serde_json::to_vec(&hello).map_err(|error| error.to_string())
}

/// Reads the answer to the host's greeting. An error is a sentence.
pub fn greeting(body: &[u8]) -> Result<Greeting, String> {
    let greeting: Greeting =
        serde_json::from_slice(body).map_err(|error| format!("it does not greet as a policy does: {error}"))?;
    if greeting.protocol != PROTOCOL {
        let theirs = greeting.protocol;
        return Err(format!("it speaks protocol {theirs}, and this program {PROTOCOL}: install one version of both"));
    }
    Ok(greeting)
}

/// Returns the body of a notice that `robot` begins anew, with a seed for its random numbers.
pub fn reset(robot: RobotId, seed: u64) -> Vec<u8> {
    [&robot.0.to_le_bytes()[..], &seed.to_le_bytes()].concat()
}

/// Returns the body of a call for so many robots, with so many places for neighbours.
pub fn call(role: Role, (robots, places): (usize, usize), inputs: &[Array]) -> Vec<u8> {
    let code = match role {
        Role::Step => 0_u8,
        Role::Encode => 1,
        Role::Act => 2,
        Role::Relay => unreachable!("a policy in Python makes its message in one call"),
    };
    let mut body = vec![code];
    let counts = [robots, places].map(|count| u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
    body.extend_from_slice(counts.as_flattened());
    let floats = inputs.iter().flat_map(|array| &array.values);
    floats.for_each(|float| body.extend_from_slice(&float.to_le_bytes()));
    body
}

/// Reads the outputs of a call for so many robots. An error says that the answer has another size.
pub fn outputs(body: &[u8], robots: usize, outputs: &[Port]) -> Result<Vec<Array>, String> {
    let sizes: Vec<usize> = outputs.iter().map(|port| robots * port.axes.iter().product::<usize>()).collect();
    if body.len() != 4 * sizes.iter().sum::<usize>() {
        return Err(format!("it has answered {} bytes instead of its outputs", body.len()));
    }
    let mut all = body.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
    let array = |(port, size): (&Port, usize)| {
        let shape = std::iter::once(robots).chain(port.axes.iter().copied()).collect();
        Array { shape, values: all.by_ref().take(size).collect() }
    };
    Ok(outputs.iter().zip(sizes).map(array).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_read_as_it_was_written_and_no_length_beyond_the_limit() {
        let frame = frame(Kind::Error, 7, b"why").expect("it is short");
        let (bytes, body) = frame.split_first_chunk::<HEAD>().expect("a head");
        assert_eq!(head(*bytes), Ok(Head { body: 3, number: 7, kind: Kind::Error as u8 }));
        assert_eq!(body, b"why");
        for length in [0_u32, 4, MAX_FRAME as u32 + 1, u32::MAX] {
            let mut bytes = *bytes;
            bytes[..4].copy_from_slice(&length.to_le_bytes());
            assert!(head(bytes).is_err_and(|why| why.contains(&format!("{length} bytes"))), "{length}");
        }
    }

    #[test]
    fn outputs_of_another_size_and_greetings_of_another_version_are_refused() {
        let port = |axes: &[usize]| Port { name: "action".to_owned(), of_neighbours: false, axes: axes.to_vec() };
        let floats = [1.0_f32, 2.0, 3.0, 4.0].map(f32::to_le_bytes).concat();
        let arrays = outputs(&floats, 2, &[port(&[2])]).expect("two robots, two floats each");
        assert_eq!(arrays, [Array { shape: vec![2, 2], values: vec![1.0, 2.0, 3.0, 4.0] }]);
        assert!(outputs(&floats[..15], 2, &[port(&[2])]).is_err_and(|why| why.contains("15 bytes")));
        let said = |protocol: u32| format!("{{\"protocol\":{protocol},\"name\":\"A\",\"digest\":\"\",\"two\":false}}");
        assert_eq!(greeting(said(PROTOCOL).as_bytes()).map(|greeting| greeting.two), Ok(false));
        assert!(greeting(said(1).as_bytes()).is_err_and(|why| why.contains("it speaks protocol 1")));
        assert!(greeting(b"hello").is_err());
    }
}
