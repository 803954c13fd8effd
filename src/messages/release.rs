//! Release: the signed original of an operator's re-arm or resume, which alone ends an emergency stop or a hold where
//! members have keys of their own.

use std::fmt;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::body::{Body, Unfit};
use super::ids::HostId;
use super::latch::Latch;
use super::leading::Stop;

/// Largest number of hosts and operators of a team whose members have keys of their own, and so of the hosts that a
/// release names.
pub const MAX_MEMBERS: usize = 24;
/// Context of what is signed, so that a signature of something else is never one of a release.
const CONTEXT: &[u8] = b"murmurate 2026-11-28 release";

/// Re-arm or resume of an operator, with its signature. It holds for the runs of the hosts that it names, and for none
/// after them: each host draws its incarnation at random when it starts, so a recorded release ends no later stop. The
/// host of the state server (the team's coordinator) repeats it unchanged, since robots may have missed it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Release {
    /// Operator that has signed.
    pub by: HostId,
    /// Emergency stop state, held or clear, that the operator permits. Its number is that of the state it ends and one.
    pub latch: Latch,
    /// Hosts for which it holds, each with its incarnation.
    pub hosts: Vec<(HostId, u32)>,
    /// Signature by the operator's key of what [`Release::signed`] returns.
    pub signature: Signature,
}

impl Release {
    /// Returns the bytes that an operator signs for the team with the number `team`.
    pub fn signed(team: u16, stop: &Stop, hosts: &[(HostId, u32)]) -> Vec<u8> {
        let mut bytes = CONTEXT.to_vec();
        bytes.extend_from_slice(&team.to_le_bytes());
        bytes.extend_from_slice(&stop.by.0.to_le_bytes());
        bytes.extend_from_slice(&u64::from(stop.latch).to_le_bytes());
        for (host, incarnation) in hosts {
            bytes.extend_from_slice(&host.0.to_le_bytes());
            bytes.extend_from_slice(&incarnation.to_le_bytes());
        }
        bytes
    }

    /// Returns the re-arm or resume itself.
    pub fn stop(&self) -> Stop {
        Stop { by: self.by, latch: self.latch }
    }

    /// Returns whether it holds for this run of the host `host`.
    pub fn names(&self, host: HostId, incarnation: u32) -> bool {
        self.hosts.contains(&(host, incarnation))
    }
}

impl Body for Release {
    fn check(&self) -> Result<(), Unfit> {
        if self.hosts.len() > MAX_MEMBERS { Err(Unfit::Length) } else { Ok(()) }
    }
}

/// Signature by Ed25519 (RFC 8032), 64 bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Signature(pub [u8; 64]);

impl fmt::Debug for Signature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Signature")
    }
}

impl Serialize for Signature {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for Signature {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Signature, D::Error> {
        from.deserialize_bytes(Bytes)
    }
}

/// Reader of the bytes of a signature.
struct Bytes;

impl Visitor<'_> for Bytes {
    type Value = Signature;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("64 bytes: a signature")
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Signature, E> {
        bytes.try_into().map(Signature).map_err(|_| E::invalid_length(bytes.len(), &self))
    }
}
