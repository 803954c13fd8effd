//! Members of a team, hosts and operators, each with one pair of keys of its own (Ed25519, RFC 8032), and the root key
//! that signs their list. Two members have a key that no third has, agreed on from their pairs (X25519, RFC 7748,
//! with the keys in Montgomery's form), so that none can impersonate another. Generation and storage are elsewhere.

use std::collections::BTreeMap;
use std::fmt;

use ed25519_dalek::{SigningKey, VerifyingKey};

use super::codec::Frame;
use super::roster::{self, Head, NONCE_BYTES, Page, Roster, RosterError};
use super::signatures::Signatures;
use super::tags::Bytes;
use crate::messages::ids::HostId;

/// Context string for the derivation of the key of a pair of members, unique to it.
const OF_PAIR: &str = "murmurate 2026-11-28 key of a pair of members";
/// Context string for the derivation of the key by which rosters are encrypted for a member, unique to it.
const OF_ROSTERS: &str = "murmurate 2026-11-28 key of a member's rosters";

/// Member of a team, with its own secret, the public root key, and the roster.
#[derive(Clone)]
pub struct Member {
    team: u16,
    number: HostId,
    secret: Bytes,
    /// Its own public key.
    public: Bytes,
    /// Public root key of the team, and the key by which rosters are encrypted for the member.
    root: Bytes,
    wrap: Bytes,
    /// Key that all members have.
    shared: Bytes,
    roster: Roster,
    /// The roster as the root key has made it; `None` for that of the member's key file.
    sealed: Option<Frame>,
}

/// Reason why keys are not those of a member.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MemberError {
    /// The secret is not that of the member's entry in the roster.
    #[error("has a secret that is not that of its own entry in its list of members")]
    Secret,
    /// One of the public keys is none.
    #[error("has a public key that is none")]
    Public,
}

impl Member {
    /// Creates the member `number` of the team `team` from its secret, the public root key, and a roster with the key
    /// `shared` of all its members.
    ///
    /// # Errors
    /// If the secret is not that of the member in the roster, or a public key is none.
    pub fn new(
        team: u16,
        (number, secret): (HostId, Bytes),
        root: Bytes,
        (roster, shared): (Roster, Bytes),
    ) -> Result<Member, MemberError> {
        if roster.members.get(&number) != Some(&public(&secret)) {
            return Err(MemberError::Secret);
        }
        let all = roster.members.values().chain([&root]);
        if !all.into_iter().all(|key| agreed(&secret, key).is_some()) {
            return Err(MemberError::Public);
        }
        let public = public(&secret);
        let wrap = agreed(&secret, &root).ok_or(MemberError::Public)?;
        let wrap = of_rosters(&wrap, team, &root, (number, &public));
        Ok(Member { team, number, secret, public, root, wrap, shared, roster, sealed: None })
    }

    /// Returns the roster that is in force for the member.
    pub fn roster(&self) -> &Roster {
        &self.roster
    }

    /// Returns the roster in force as the root key has made it; `None` for that of the member's key file.
    pub fn sealed(&self) -> Option<&Frame> {
        self.sealed.as_ref()
    }

    /// Returns the key that all members have.
    pub fn shared(&self) -> Bytes {
        self.shared
    }

    /// Returns the member with the roster in `bytes`.
    ///
    /// # Errors
    /// If the root key has not made it, it is not newer than the present one, or the member is not in it.
    pub fn take(&self, bytes: &[u8]) -> Result<Member, RosterError> {
        let who = (self.team, self.number, &self.public);
        let (roster, shared) = roster::open(bytes, who, self.roster.number, (&self.root, &self.wrap))?;
        if !roster.members.values().all(|key| agreed(&self.secret, key).is_some()) {
            return Err(RosterError::Malformed);
        }
        Ok(Member { roster, shared, sealed: Some(bytes.into()), ..self.clone() })
    }

    /// Checks by the page of a roster that names this member that the root key has made its head.
    pub(super) fn check(&self, head: &Head, page: (usize, &Page)) -> Result<(), RosterError> {
        let who = (self.team, self.number, &self.public);
        roster::open_page(head, page, who, (&self.root, &self.wrap)).map(drop)
    }

    /// Returns whether the root key has made the head of a roster.
    pub(super) fn is_by_root(&self, head: &Head) -> bool {
        head.is_signed(self.team, &self.root)
    }

    /// Returns for each member, this one included, the key that only the two have.
    pub fn pairs(&self) -> BTreeMap<HostId, Bytes> {
        let own = self.public;
        let pairs = self.roster.members.iter().map(|(number, key)| {
            let agreed = agreed(&self.secret, key).expect("it was checked when the roster was taken");
            (*number, of_pair(&agreed, self.team, (self.number, &own), (*number, key)))
        });
        pairs.collect()
    }

    /// Returns the keys by which the member signs, and checks what others have signed.
    pub fn signatures(&self) -> Signatures {
        Signatures::new(Some(self.secret), &self.roster.members).expect("they were checked when the roster was taken")
    }
}

impl fmt::Debug for Member {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Member({})", self.number.0)
    }
}

/// Returns the public key that belongs to a secret one.
pub fn public(secret: &Bytes) -> Bytes {
    SigningKey::from_bytes(secret).verifying_key().to_bytes()
}

/// Makes the roster `roster` of the team `team` by its secret root key, with the key `shared` of all members. The
/// nonce is random. `None` if there are too many members, or the public key of one is none.
pub fn seal_roster(
    (team, roster): (u16, &Roster),
    root: &Bytes,
    shared: &Bytes,
    nonce: [u8; NONCE_BYTES],
) -> Option<Vec<u8>> {
    let root_public = public(root);
    roster::seal((team, roster), root, shared, nonce, |member, key| {
        Some(of_rosters(&agreed(root, key)?, team, &root_public, (member, key)))
    })
}

/// Returns what the owner of a secret key and that of a public one agree on; `None` if the public one is no key, or
/// one of the few that agree on the same with everybody.
fn agreed(secret: &Bytes, public: &Bytes) -> Option<Bytes> {
    let point = VerifyingKey::from_bytes(public).ok().filter(|key| !key.is_weak())?.to_montgomery();
    let scalar = SigningKey::from_bytes(secret).to_scalar_bytes();
    Some(x25519_dalek::x25519(scalar, point.to_bytes()))
}

fn of_pair(agreed: &Bytes, team: u16, one: (HostId, &Bytes), other: (HostId, &Bytes)) -> Bytes {
    let (low, high) = if one.0 <= other.0 { (one, other) } else { (other, one) };
    let mut all = agreed.to_vec();
    all.extend_from_slice(&team.to_le_bytes());
    for (number, public) in [low, high] {
        all.extend_from_slice(&number.0.to_le_bytes());
        all.extend_from_slice(public);
    }
    blake3::derive_key(OF_PAIR, &all)
}

fn of_rosters(agreed: &Bytes, team: u16, root: &Bytes, (number, public): (HostId, &Bytes)) -> Bytes {
    let all = [agreed, &team.to_le_bytes()[..], root, &number.0.to_le_bytes(), public].concat();
    blake3::derive_key(OF_ROSTERS, &all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::ids::LinkId;
    use crate::net::protocol::codec::{self, Flags, Header};
    use crate::net::protocol::key::Key;

    const TEAM: u16 = 7;
    const ROOT: Bytes = [99; 32];
    const OPERATOR: HostId = HostId::operator(1);

    fn secret(member: HostId) -> Bytes {
        *blake3::hash(&member.0.to_le_bytes()).as_bytes()
    }

    fn roster(number: u32, members: &[HostId]) -> Roster {
        let members = members.iter().map(|member| (*member, public(&secret(*member)))).collect();
        Roster { number, planned: false, members }
    }

    fn sealed(number: u32, members: &[HostId]) -> Vec<u8> {
        let shared = [number as u8 + 40; 32];
        seal_roster((TEAM, &roster(number, members)), &ROOT, &shared, [number as u8; 24]).expect("few members")
    }

    fn member(number: HostId, members: &[HostId]) -> Member {
        let first = (roster(1, members), [41; 32]);
        Member::new(TEAM, (number, secret(number)), public(&ROOT), first).expect("it is one of them")
    }

    const ALL: [HostId; 3] = [HostId(0), HostId(1), OPERATOR];

    fn heard(from: &Member, by: &Member) -> bool {
        let flags = Flags::default();
        let mut datagram =
            codec::start(&Header { flags, team: TEAM, sender: from.number, incarnation: 1, sequence: 1 });
        Key::of(from.clone()).seal(&mut datagram, LinkId(0), None);
        Key::of(by.clone()).open(&datagram, LinkId(0), by.number).is_some()
    }

    #[test]
    fn a_removed_member_is_heard_by_no_other_and_hears_none() {
        let before = ALL.map(|number| member(number, &ALL));
        assert!(heard(&before[1], &before[0]) && heard(&before[2], &before[1]));
        let without = sealed(2, &[HostId(0), OPERATOR]);
        let after = [0, 2].map(|at| before[at].take(&without).expect("it is in the roster"));
        assert!(heard(&after[0], &after[1]) && heard(&after[1], &after[0]));
        assert!(!heard(&before[1], &after[0]) && !heard(&after[0], &before[1]));
        assert_eq!(before[1].take(&without).unwrap_err(), RosterError::Absent);
        let back = sealed(3, &ALL);
        let again = [&after[0], &before[1]].map(|member| member.take(&back).expect("it is in the roster"));
        assert!(heard(&again[0], &again[1]) && heard(&again[1], &again[0]));
        for old in [&without, &back] {
            assert_eq!(again[0].take(old).unwrap_err(), RosterError::Known, "an old one or the same again");
        }
    }

    fn is_of_the_root_key_or_none(me: &Member, honest: &[u8]) {
        assert_eq!(me.take(honest).expect("it is whole").shared(), [42; 32]);
        for bit in 0..honest.len() * 8 {
            let mut turned = honest.to_vec();
            turned[bit / 8] ^= 1 << (bit % 8);
            assert!(me.take(&turned).is_err(), "bit {bit}");
        }
        for cut in 0..honest.len() {
            assert_eq!(me.take(&honest[..cut]).unwrap_err(), RosterError::Malformed);
        }
    }

    #[test]
    fn a_roster_is_that_of_the_root_key_of_this_team_for_this_member_or_none() {
        let many: Vec<HostId> = (0..13).map(HostId).collect();
        for members in [&ALL[..], &many] {
            is_of_the_root_key_or_none(&member(HostId(0), members), &sealed(2, members));
        }
        let me = member(HostId(0), &ALL);
        // A member that makes one for the others by its own secret, as if that were the root key.
        let others = seal_roster((TEAM, &roster(2, &ALL)), &secret(HostId(1)), &[1; 32], [1; 24]).expect("few");
        assert_eq!(me.take(&others).unwrap_err(), RosterError::Unsigned);
        let elsewhere = seal_roster((8, &roster(2, &ALL)), &ROOT, &[1; 32], [1; 24]).expect("few");
        assert_eq!(me.take(&elsewhere).unwrap_err(), RosterError::Unsigned);
        // A replaced robot, with the same number and another key.
        let mut replaced = roster(2, &ALL);
        replaced.members.insert(HostId(0), public(&[5; 32]));
        let replaced = seal_roster((TEAM, &replaced), &ROOT, &[1; 32], [1; 24]).expect("few");
        assert_eq!(me.take(&replaced).unwrap_err(), RosterError::Absent);
    }

    #[test]
    fn a_secret_of_another_or_a_weak_key_is_refused() {
        let new = |secret, root, roster| Member::new(TEAM, (HostId(0), secret), root, (roster, [41; 32])).err();
        let good = || roster(1, &ALL);
        assert_eq!(new(secret(HostId(0)), public(&ROOT), good()), None);
        assert_eq!(new(secret(HostId(1)), public(&ROOT), good()), Some(MemberError::Secret));
        let mut neutral = [0; 32];
        neutral[0] = 1;
        assert_eq!(new(secret(HostId(0)), neutral, good()), Some(MemberError::Public));
        let mut weak = good();
        weak.members.insert(HostId(1), neutral);
        assert_eq!(new(secret(HostId(0)), public(&ROOT), weak), Some(MemberError::Public));
    }

    #[test]
    fn the_pages_of_the_largest_roster_fit_into_datagrams_and_a_larger_one_is_not_made() {
        let numbers = |count: usize| (0..count as u16).map(HostId).collect::<Vec<HostId>>();
        for (members, pages) in [(1, 1), (12, 1), (13, 2), (codec::MAX_MEMBERS, 2)] {
            let sheets = roster::pages(&sealed(2, &numbers(members)));
            assert_eq!(sheets.len(), pages);
            let longest = sheets.iter().map(Vec::len).max().expect("there is one");
            assert!(longest + codec::HEADER_BYTES + codec::BLOCK_BYTES <= codec::MAX_FRAME_BYTES, "{longest}");
        }
        let many = roster(2, &numbers(codec::MAX_MEMBERS + 1));
        assert!(seal_roster((TEAM, &many), &ROOT, &[1; 32], [1; 24]).is_none());
    }
}
