//! Signatures of operators: an operator signs its re-arms and resumes, and every host checks them (Ed25519, RFC 8032).
//! Generation and storage of keys are elsewhere.

use std::collections::BTreeMap;
use std::fmt;

use ed25519_dalek::{Signer, SigningKey, VerifyingKey};

use super::codec::Header;
use crate::messages::ids::HostId;
use crate::messages::release::{MAX_MEMBERS, Release, Signature};
use crate::messages::wire::{Stop, Wire};

/// Keys by which the releases of a team's operators are made and checked.
pub struct Signatures {
    /// Secret key of this process, if it is an operator.
    own: Option<SigningKey>,
    operators: Operators,
}

/// Operators whose releases are believed.
enum Operators {
    /// Those with these public keys.
    Known(BTreeMap<HostId, VerifyingKey>),
    /// In a replay without keys: all. One that the recorded host has refused makes such a replay differ.
    Trusted,
}

impl fmt::Debug for Signatures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Signatures")
    }
}

impl Signatures {
    /// Creates the keys of a process: `secret` is that of an operator, which hosts have not, and `operators` has the
    /// public key of each operator. `None` if one of these is no public key.
    pub fn new(secret: Option<[u8; 32]>, operators: &BTreeMap<HostId, [u8; 32]>) -> Option<Signatures> {
        let known = operators.iter().map(|(host, key)| Some((*host, VerifyingKey::from_bytes(key).ok()?)));
        let known = Operators::Known(known.collect::<Option<_>>()?);
        Some(Signatures { own: secret.map(|secret| SigningKey::from_bytes(&secret)), operators: known })
    }

    /// Creates a substitute for the keys in a replay without them, which believes each release in the record.
    pub fn trusting() -> Signatures {
        Signatures { own: None, operators: Operators::Trusted }
    }

    /// Returns the public key that belongs to the secret one of an operator.
    pub fn public(secret: [u8; 32]) -> [u8; 32] {
        SigningKey::from_bytes(&secret).verifying_key().to_bytes()
    }

    /// Returns an order of this process with its signature, for the runs of these hosts. A stop or a question, and what
    /// a process says that is no operator, stays as it is.
    pub(crate) fn signed(&self, team: u16, stop: Stop, hosts: impl Iterator<Item = (HostId, u32)>) -> Wire {
        let Some(own) = self.own.as_ref().filter(|_| stop.releases()) else { return Wire::Stop(stop) };
        let hosts: Vec<(HostId, u32)> = hosts.take(MAX_MEMBERS).collect();
        let signature = Signature(own.sign(&Release::signed(team, &stop, &hosts)).to_bytes());
        Wire::Release(Release { by: stop.by, latch: stop.latch, hosts, signature })
    }

    /// Returns whether the process whose datagrams have the header `me` believes a message: a release only with the
    /// signature of an operator and for this run of the process, and no order without one in the name of an operator.
    pub(crate) fn permit(&self, me: &Header, message: &Wire) -> bool {
        match message {
            Wire::Stop(stop) => !(stop.releases() && stop.by.is_operator()),
            // An operator only shows it.
            Wire::Release(release) => {
                (me.sender.is_operator() || release.names(me.sender, me.incarnation))
                    && self.is_signed(me.team, release)
            }
            _ => true,
        }
    }

    fn is_signed(&self, team: u16, release: &Release) -> bool {
        let known = match &self.operators {
            Operators::Known(known) => known,
            Operators::Trusted => return true,
        };
        let signed = Release::signed(team, &release.stop(), &release.hosts);
        let signature = ed25519_dalek::Signature::from_bytes(&release.signature.0);
        known.get(&release.by).is_some_and(|key| key.verify_strict(&signed, &signature).is_ok())
    }
}

#[cfg(test)]
mod tests {
    use super::super::codec::Flags;
    use super::*;
    use crate::messages::latch::Latch;

    const OPERATOR: HostId = HostId::operator(1);
    const SECRET: [u8; 32] = [7; 32];

    fn of(secret: Option<[u8; 32]>) -> Signatures {
        Signatures::new(secret, &[(OPERATOR, Signatures::public(SECRET))].into()).expect("it is a public key")
    }

    fn me(host: u16, incarnation: u32) -> Header {
        Header { flags: Flags(0), team: 7, sender: HostId(host), incarnation, sequence: 0 }
    }

    fn release(by: HostId, latch: Latch, secret: [u8; 32]) -> Wire {
        of(Some(secret)).signed(7, Stop { by, latch }, [(HostId(0), 5), (HostId(1), 6)].into_iter())
    }

    #[test]
    fn a_release_is_believed_of_its_operator_and_for_the_runs_of_the_hosts_that_it_names() {
        let signed = release(OPERATOR, Latch::held(4), SECRET);
        let host = of(None);
        assert!(host.permit(&me(0, 5), &signed) && host.permit(&me(1, 6), &signed));
        assert!(host.permit(&me(OPERATOR.0, 9), &signed), "operators show it");
        assert!(!host.permit(&me(0, 6), &signed), "after a restart");
        assert!(!host.permit(&me(2, 5), &signed), "of a host that it does not name");
        assert!(!host.permit(&Header { team: 8, ..me(0, 5) }, &signed), "of another team");
        assert!(!host.permit(&me(0, 5), &release(OPERATOR, Latch::held(4), [8; 32])), "with another key");
        assert!(!host.permit(&me(0, 5), &release(HostId::operator(2), Latch::held(4), SECRET)), "of nobody");
        let Wire::Release(signed) = signed else { panic!("an operator signs") };
        let altered = [
            Release { latch: Latch::held(5), ..signed.clone() },
            Release { latch: Latch::clear(4), ..signed.clone() },
            Release { hosts: vec![(HostId(0), 5)], ..signed.clone() },
            Release { hosts: vec![(HostId(0), 5), (HostId(1), 7)], ..signed },
        ];
        for altered in altered {
            assert!(!host.permit(&me(0, 5), &Wire::Release(altered.clone())), "{altered:?}");
        }
    }

    #[test]
    fn what_ends_no_stop_needs_no_signature_and_hosts_sign_nothing() {
        let host = of(None);
        for latch in [Latch::held(4), Latch::clear(5)] {
            let stop = Stop { by: OPERATOR, latch };
            assert!(!host.permit(&me(0, 5), &Wire::Stop(stop)), "an order without a signature");
            assert_eq!(host.signed(7, stop, std::iter::empty()), Wire::Stop(stop));
            assert!(host.permit(&me(0, 5), &Wire::Stop(Stop { by: HostId(3), latch })), "a host ends none anyway");
        }
        for stop in [Stop::engage(OPERATOR, Latch::default()), Stop::ask(OPERATOR)] {
            assert_eq!(of(Some(SECRET)).signed(7, stop, std::iter::empty()), Wire::Stop(stop));
            assert!(host.permit(&me(0, 5), &Wire::Stop(stop)));
        }
    }
}
