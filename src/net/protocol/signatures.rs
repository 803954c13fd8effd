//! Signatures of members: each one signs what it says to all and others may pass on (`signing`), an operator its
//! re-arms and resumes, and every host checks them (Ed25519, RFC 8032). Generation and storage of keys are elsewhere.

use std::collections::BTreeMap;
use std::fmt;

use ed25519_dalek::{Signer, SigningKey, VerifyingKey};

use crate::messages::ids::HostId;
use crate::messages::release::{MAX_MEMBERS, Release, Signature};
use crate::messages::wire::{Stop, Wire};

/// Keys by which a member signs, and by which what others have signed is checked.
pub struct Signatures {
    /// Secret key of this process; `None` if it signs nothing.
    own: Option<SigningKey>,
    members: Members,
}

/// Members whose signatures are believed.
enum Members {
    /// Those with these public keys.
    Known(BTreeMap<HostId, VerifyingKey>),
    /// In a replay without keys: all. A signature that the recorded host has refused makes such a replay differ.
    Trusted,
}

/// Signed bytes with their signature, and the member that they name as the signer.
pub struct Signed {
    /// Member that has signed.
    pub by: HostId,
    /// Number by which later signatures of the member are told from earlier ones; zero if there is none.
    pub edition: u32,
    /// Signed bytes.
    pub bytes: Vec<u8>,
    /// Signature of them.
    pub signature: [u8; 64],
}

impl Signed {
    /// Returns the signed bytes of a release of the team with the number `team`, in the name of its operator.
    pub fn release(team: u16, release: &Release) -> Signed {
        let bytes = Release::signed(team, &release.stop(), &release.hosts);
        Signed { by: release.by, edition: 0, bytes, signature: release.signature.0 }
    }
}

impl fmt::Debug for Signatures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Signatures")
    }
}

impl Signatures {
    /// Creates the keys of a process: `secret` is its own, if it signs, and `members` has the public key of each host
    /// and operator. `None` if one of these is no public key.
    pub fn new(secret: Option<[u8; 32]>, members: &BTreeMap<HostId, [u8; 32]>) -> Option<Signatures> {
        let known = members.iter().map(|(host, key)| Some((*host, VerifyingKey::from_bytes(key).ok()?)));
        let members = Members::Known(known.collect::<Option<_>>()?);
        Some(Signatures { own: secret.map(|secret| SigningKey::from_bytes(&secret)), members })
    }

    /// Creates a substitute for the keys in a replay without them, which believes each signature in the record.
    pub fn trusting() -> Signatures {
        Signatures { own: None, members: Members::Trusted }
    }

    /// Returns the signature of this process; `None` if it signs nothing.
    pub(super) fn sign(&self, bytes: &[u8]) -> Option<[u8; 64]> {
        self.own.as_ref().map(|own| own.sign(bytes).to_bytes())
    }

    /// Returns an order of an operator with its signature, for the runs of these hosts. A stop or a question, and what
    /// a host says, stays as it is.
    pub(crate) fn signed(&self, team: u16, stop: Stop, hosts: impl Iterator<Item = (HostId, u32)>) -> Wire {
        if !(stop.releases() && stop.by.is_operator()) {
            return Wire::Stop(stop);
        }
        let hosts: Vec<(HostId, u32)> = hosts.take(MAX_MEMBERS).collect();
        let Some(signature) = self.sign(&Release::signed(team, &stop, &hosts)) else { return Wire::Stop(stop) };
        Wire::Release(Release { by: stop.by, latch: stop.latch, hosts, signature: Signature(signature) })
    }

    /// Whether each signature is believed, in a replay without keys.
    pub(super) fn are_trusted(&self) -> bool {
        matches!(self.members, Members::Trusted)
    }

    /// Returns whether the signature is that of the member.
    pub(super) fn verify(&self, signed: &Signed) -> bool {
        let known = match &self.members {
            Members::Known(known) => known,
            Members::Trusted => return true,
        };
        let signature = ed25519_dalek::Signature::from_bytes(&signed.signature);
        known.get(&signed.by).is_some_and(|key| key.verify_strict(&signed.bytes, &signature).is_ok())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::latch::Latch;

    #[test]
    fn operators_alone_sign_releases() {
        let (operator, host) = (HostId::operator(1), HostId(3));
        let of = |secret: Option<[u8; 32]>| Signatures::new(secret, &BTreeMap::new()).expect("there is no wrong key");
        let own = of(Some([7; 32]));
        for latch in [Latch::held(4), Latch::clear(5)] {
            let [by_operator, by_host] = [operator, host].map(|by| Stop { by, latch });
            assert!(matches!(own.signed(7, by_operator, std::iter::empty()), Wire::Release(_)));
            assert_eq!(own.signed(7, by_host, std::iter::empty()), Wire::Stop(by_host));
            assert_eq!(of(None).signed(7, by_operator, std::iter::empty()), Wire::Stop(by_operator), "it cannot");
        }
        for stop in [Stop::engage(operator, Latch::default()), Stop::ask(operator)] {
            assert_eq!(own.signed(7, stop, std::iter::empty()), Wire::Stop(stop));
        }
    }
}
