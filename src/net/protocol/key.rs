//! Keys of a process, by which its datagrams get their tags (`tags`) and those of others are checked.
//!
//! A team has one key of all its members, or each member has a key with each other one. In the first case any member
//! can impersonate another. In the second none can: what goes to one host has a tag of that pair's key, what goes to
//! all has a short tag for each member. A tag covers the whole datagram, its link and its receiver. The latter two take
//! no bytes in the datagram, but a datagram of one link is not valid on another. With `confidential`, blocks are
//! encrypted (`cipher`), and the tag of a datagram with one tag is that of the cipher. Generation and storage of keys
//! are elsewhere.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use super::cipher::ENCRYPTION_BYTES;
use super::codec::{self, Content, FLAGS_AT, Flags, Frame, HEADER_BYTES};
use super::codec::{MAX_FRAME_BYTES, MAX_PLAIN_BYTES, SHORT_TAG_BYTES, TAG_BYTES};
use super::member::Member;
use super::roster::{self, Collected, Roster, RosterError};
use super::signatures::Signatures;
use super::tags::{Bytes, Pairs, Shared, associated};
use crate::messages::ids::{HostId, LinkId};

/// Secret keys with which a process authenticates datagrams, and encrypts those of a team that asks for it. In a
/// replay, a list of the datagrams that had a valid tag takes their place.
#[derive(Clone)]
pub struct Key {
    secret: Secret,
    accepts: Accepts,
    signatures: Option<Arc<Signatures>>,
    membership: Option<Arc<Membership>>,
    former: Option<Arc<Former>>,
}

/// Roster that is in force for a member.
struct Membership {
    roster: Roster,
    /// The roster as the root key has made it; `None` for that of the member's key file.
    sealed: Option<Frame>,
    /// Keys from which those of the next roster are made; `None` in a replay without them.
    member: Option<Member>,
}

/// Keys of the roster before the present one, while they are valid, too.
struct Former {
    secret: Secret,
    /// Whether datagrams still leave with these keys.
    seals: bool,
}

/// Which datagrams are accepted: the others are those of an attacker, or of a host with another team file.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Accepts {
    InClear,
    Encrypted,
    /// Both: of a record, which says of each datagram how it was sent.
    Either,
}

#[derive(Clone)]
enum Secret {
    /// Key of all members of the team.
    Team(Shared),
    /// Keys of one member.
    Member(Arc<Pairs>),
    /// In a replay: digests of the datagrams whose tags were valid when they were recorded.
    Accepted(Arc<BTreeSet<[u8; 16]>>),
}

impl Secret {
    fn pair(&self, host: HostId) -> Option<&Bytes> {
        match self {
            Secret::Member(member) => member.pairs.get(&host).map(|pair| &pair.bytes),
            Secret::Team(_) | Secret::Accepted(_) => None,
        }
    }
}

impl Key {
    fn with(secret: Secret) -> Key {
        Key { secret, accepts: Accepts::InClear, signatures: None, membership: None, former: None }
    }

    /// Returns the keys of a process of a team whose members sign what others may pass on, and its operators what ends
    /// a stop or a hold.
    pub fn with_signatures(self, signatures: Signatures) -> Key {
        Key { signatures: Some(Arc::new(signatures)), ..self }
    }

    /// Creates the keys of the member `member`: those with each other member, those by which it signs and checks what
    /// others have signed, and what the keys of the next roster are made from.
    pub fn of(member: Member) -> Key {
        let key = Key::of_member(member.shared(), member.pairs()).with_signatures(member.signatures());
        let (roster, sealed) = (member.roster().clone(), member.sealed().cloned());
        Key { membership: Some(Arc::new(Membership { roster, sealed, member: Some(member) })), ..key }
    }

    /// Returns the key of a replay that accepts the rosters among the datagrams that it accepts. `sealed` is the
    /// roster with which the recorded process has begun; `None` if it was that of its key file.
    pub fn with_trusted_rosters(self, sealed: Option<Frame>) -> Key {
        let roster = sealed.as_ref().and_then(|sealed| roster::read(sealed).ok());
        let roster = roster.unwrap_or(Roster { number: 1, ..Roster::default() });
        Key { membership: Some(Arc::new(Membership { roster, sealed, member: None })), ..self }
    }

    /// Returns the roster that is in force; `None` in a team without one.
    pub fn roster(&self) -> Option<&Roster> {
        self.membership.as_ref().map(|membership| &membership.roster)
    }

    /// Returns the roster that is in force as the root key has made it; `None` for that of a key file.
    pub fn sealed_roster(&self) -> Option<&Frame> {
        self.membership.as_ref()?.sealed.as_ref()
    }

    /// Returns the key of this process by the roster `sealed`.
    ///
    /// # Errors
    /// If the root key of the team has not made it, it is not newer than the present one, or the member is not in it.
    pub fn by_roster(&self, sealed: &[u8]) -> Result<Key, RosterError> {
        let membership = self.membership.as_ref().ok_or(RosterError::Absent)?;
        match &membership.member {
            Some(member) => Ok(Key::of(member.take(sealed)?).with_ciphers(self.accepts)),
            None => {
                let roster = roster::read(sealed)?;
                if roster.number <= membership.roster.number {
                    return Err(RosterError::Known);
                }
                let membership = Membership { roster, sealed: Some(sealed.into()), member: None };
                Ok(Key { membership: Some(Arc::new(membership)), former: None, ..self.clone() })
            }
        }
    }

    /// Takes the page of a roster in a datagram that has arrived on the link `link`, beside those that were `collected`
    /// before. Returns the key of this process by that roster; `None` as long as a page is missing. The page that names
    /// this process has to be the first, since the others are checked by it.
    ///
    /// # Errors
    /// As [`Key::by_roster`]; in a replay without keys also if the recorded process has not accepted it.
    pub fn successor(
        &self,
        datagram: &[u8],
        link: LinkId,
        collected: &mut Collected,
    ) -> Result<Option<Key>, RosterError> {
        let (head, index, page) = roster::read_page(codec::roster_of(datagram).ok_or(RosterError::Malformed)?)?;
        let membership = self.membership.as_ref().ok_or(RosterError::Absent)?;
        if head.number <= membership.roster.number || head.number < collected.number() {
            return Err(RosterError::Known);
        }
        if !collected.is_of(&head) {
            match (&membership.member, &self.secret) {
                (Some(member), _) => member.check(&head, (index, &page))?,
                (None, Secret::Accepted(accepted)) if !accepted.contains(&digest(datagram, link)) => {
                    return Err(RosterError::Unsigned);
                }
                (None, _) => {}
            }
            *collected = Collected::of(&head);
        }
        collected.take((index, &page))?.map(|sealed| self.by_roster(&sealed)).transpose()
    }

    /// Takes the page of a roster that does not name this process, beside those that were `collected` before. Returns
    /// the number of the roster if none of its pages does, and the root key has made it: this process was removed. The
    /// signature of another roster than the collected one is only looked at if `checks`.
    pub(super) fn removal(&self, datagram: &[u8], collected: &mut Collected, checks: bool) -> Option<u32> {
        let (head, index, page) = roster::read_page(codec::roster_of(datagram)?).ok()?;
        let member = self.membership.as_ref()?.member.as_ref()?;
        if !collected.is_of(&head) {
            (checks && member.is_by_root(&head)).then(|| *collected = Collected::of(&head))?;
        }
        let sealed = collected.take((index, &page)).ok()??;
        (member.take(&sealed).err() == Some(RosterError::Absent)).then_some(head.number)
    }

    /// Returns this key, which also accepts what has a tag by the keys of `former`, and makes tags by them if `seals`.
    #[must_use]
    pub fn beside(self, former: &Key, seals: bool) -> Key {
        Key { former: Some(Arc::new(Former { secret: former.secret.clone(), seals })), ..self }
    }

    /// Returns this key, which accepts nothing by the keys of a former roster.
    #[must_use]
    pub fn alone(self) -> Key {
        Key { former: None, ..self }
    }

    /// Returns the keys by which messages are signed and checked; `None` in a team whose members sign nothing.
    pub fn signatures(&self) -> Option<&Signatures> {
        self.signatures.as_deref()
    }

    /// Returns the key of this process and the member `host` by which tags are made now; `None` without members' keys.
    pub(super) fn pair(&self, host: HostId) -> Option<&Bytes> {
        let former = self.former.as_ref().filter(|former| former.seals);
        former.map_or(&self.secret, |former| &former.secret).pair(host)
    }

    /// Returns the keys of this process and the member `host` by which tags are accepted.
    pub(super) fn pairs_with(&self, host: HostId) -> impl Iterator<Item = &Bytes> {
        let former = self.former.as_ref().map(|former| &former.secret);
        std::iter::once(&self.secret).chain(former).filter_map(move |secret| secret.pair(host))
    }

    /// Creates the key of a team, known to all its members, from its 32 bytes.
    pub fn new(bytes: Bytes) -> Key {
        Key::with(Secret::Team(Shared::new(bytes)))
    }

    /// Creates the keys of one member of a team whose members cannot impersonate each other: `team` is known to all of
    /// them, `pairs` has for each member, this one included, the key that only the two have.
    ///
    /// # Panics
    /// If there are more members than [`MAX_MEMBERS`](codec::MAX_MEMBERS).
    pub fn of_member(team: Bytes, pairs: BTreeMap<HostId, Bytes>) -> Key {
        assert!(pairs.len() <= codec::MAX_MEMBERS, "the reader of keys checks their number");
        let pairs = pairs.into_iter().map(|(member, pair)| (member, Shared::new(pair))).collect();
        Key::with(Secret::Member(Arc::new(Pairs { team: Shared::new(team), pairs })))
    }

    /// Creates a substitute for a key, for replays of records only: it accepts exactly the datagrams with these
    /// [`digest`]s, and makes tags of zeros. It gives no protection on a link.
    pub fn trusting(accepted: BTreeSet<[u8; 16]>) -> Key {
        Key::with(Secret::Accepted(Arc::new(accepted)))
    }

    /// Returns the key of a team whose datagrams are confidential: it encrypts, and refuses what is not encrypted.
    #[must_use]
    pub fn confidential(self) -> Key {
        self.with_ciphers(Accepts::Encrypted)
    }

    /// Returns the key of a team whose datagrams are confidential if `asked`, as its team file says.
    #[must_use]
    pub fn confidential_if(self, asked: bool) -> Key {
        if asked { self.confidential() } else { self }
    }

    /// Returns the key for records, whose datagrams may be encrypted or not.
    #[must_use]
    pub fn for_records(self) -> Key {
        self.with_ciphers(Accepts::Either)
    }

    fn with_ciphers(self, accepts: Accepts) -> Key {
        if accepts == Accepts::InClear {
            return self;
        }
        let secret = match self.secret {
            Secret::Team(shared) => Secret::Team(shared.with_cipher()),
            Secret::Member(member) => {
                let pairs = member.pairs.iter().map(|(host, pair)| (*host, pair.clone().with_cipher())).collect();
                Secret::Member(Arc::new(Pairs { team: member.team.clone().with_cipher(), pairs }))
            }
            accepted @ Secret::Accepted(_) => accepted,
        };
        Key { secret, accepts, ..self }
    }

    /// Returns whether datagrams are encrypted, and what is not is refused.
    pub fn is_confidential(&self) -> bool {
        self.accepts == Accepts::Encrypted
    }

    /// Returns the length of the largest datagram that may be sealed \[bytes\].
    pub fn room(&self) -> usize {
        let tags = |secret: &Secret| match secret {
            Secret::Member(member) => member.pairs.len() * SHORT_TAG_BYTES + 1,
            Secret::Team(_) | Secret::Accepted(_) => TAG_BYTES,
        };
        let former = self.former.as_ref().map_or(0, |former| tags(&former.secret));
        let room = MAX_PLAIN_BYTES.min(MAX_FRAME_BYTES - tags(&self.secret).max(former));
        room - if self.is_confidential() { ENCRYPTION_BYTES } else { 0 }
    }

    /// Appends the authentication tag to a datagram on the link `link`, for the host `to`, or for all hosts if `to` is
    /// `None`, and encrypts its blocks first if they are confidential. What a member sends to a host that is no member
    /// has a tag of zeros, which no host accepts, and no block if blocks are confidential.
    pub fn seal(&self, datagram: &mut Vec<u8>, link: LinkId, to: Option<HostId>) {
        datagram[FLAGS_AT] |= self.flags(datagram);
        let associated = associated(link, to);
        let former = self.former.as_ref().filter(|former| former.seals);
        match (former.map_or(&self.secret, |former| &former.secret), to) {
            (Secret::Team(team), _) => team.seal(datagram, associated),
            (Secret::Member(member), Some(host)) => match member.pairs.get(&host) {
                Some(pair) => pair.seal(datagram, associated),
                None => {
                    if self.is_confidential() {
                        datagram.truncate(HEADER_BYTES);
                    }
                    datagram.extend_from_slice(&[0; TAG_BYTES]);
                }
            },
            (Secret::Member(member), None) => member.seal(datagram, associated),
            (Secret::Accepted(_), _) => datagram.extend_from_slice(&[0; TAG_BYTES]),
        }
    }

    /// Returns the flags that say how a datagram is sealed.
    fn flags(&self, datagram: &[u8]) -> u8 {
        if !self.is_confidential() {
            return Flags::TAGGED;
        }
        let is_report = matches!(codec::first(datagram), Ok(Content::Report | Content::NumberedReport));
        Flags::TAGGED | Flags::ENCRYPTED | if is_report { Flags::REPORT } else { 0 }
    }

    /// Returns the datagram without its authentication tag, and as it was before it was encrypted; `None` if the tag is
    /// not valid for the link `link` and, in a unicast datagram, for the receiver `here`, or if the datagram is in
    /// clear and this team's are confidential, or the reverse.
    pub fn open<'a>(&self, datagram: &'a [u8], link: LinkId, here: HostId) -> Option<Cow<'a, [u8]>> {
        if datagram.len() < HEADER_BYTES + TAG_BYTES || datagram.len() > MAX_FRAME_BYTES {
            return None;
        }
        let by = |secret| self.open_by(secret, datagram, link, here);
        by(&self.secret).or_else(|| by(&self.former.as_ref()?.secret))
    }

    fn open_by<'a>(&self, secret: &Secret, datagram: &'a [u8], link: LinkId, here: HostId) -> Option<Cow<'a, [u8]>> {
        // The flags are not authenticated yet; they only select the tag to expect.
        let flags = Flags(datagram[FLAGS_AT]);
        let to = flags.has(Flags::DIRECT).then_some(here);
        let associated = associated(link, to);
        match secret {
            Secret::Accepted(accepted) => {
                accepted.contains(&digest(datagram, link)).then(|| codec::untagged(datagram).into())
            }
            _ if !self.takes(flags) => None,
            Secret::Team(team) => team.open(datagram, associated),
            Secret::Member(member) => {
                let pair = member.pairs.get(&codec::peek(datagram).ok()?.sender)?;
                match to {
                    Some(_) => pair.open(datagram, associated),
                    None => member.open(datagram, (associated, here), &pair.bytes),
                }
            }
        }
    }

    /// Returns whether datagrams with these flags are accepted, as far as encryption goes.
    fn takes(&self, flags: Flags) -> bool {
        match self.accepts {
            Accepts::InClear => !flags.has(Flags::ENCRYPTED),
            Accepts::Encrypted => flags.has(Flags::ENCRYPTED),
            Accepts::Either => true,
        }
    }
}

/// Returns a digest of a datagram with its tag and of its link, by which a replay recognizes the datagram.
pub fn digest(datagram: &[u8], link: LinkId) -> [u8; 16] {
    let mut all = datagram.to_vec();
    all.extend_from_slice(&link.0.to_le_bytes());
    let mut short = [0; 16];
    short.copy_from_slice(&blake3::hash(&all).as_bytes()[..16]);
    short
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(secret)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A key as it is, and with encryption.
    fn both(key: Key) -> [Key; 2] {
        [key.clone(), key.confidential()]
    }

    #[test]
    fn a_tag_holds_for_one_key_one_link_and_one_host() {
        for (key, other) in both(Key::new([7; 32])).into_iter().zip(both(Key::new([8; 32]))) {
            holds_for_one_key_one_link_and_one_host(&key, &other);
        }
    }

    fn holds_for_one_key_one_link_and_one_host(key: &Key, other: &Key) {
        let mut sealed = vec![0; HEADER_BYTES];
        sealed[FLAGS_AT] = Flags::DIRECT;
        key.seal(&mut sealed, LinkId(1), Some(HostId(4)));
        assert_eq!(sealed.len(), HEADER_BYTES + if key.is_confidential() { ENCRYPTION_BYTES } else { TAG_BYTES });
        assert!(key.open(&sealed, LinkId(1), HostId(4)).is_some());
        assert!(key.open(&sealed, LinkId(2), HostId(4)).is_none());
        assert!(key.open(&sealed, LinkId(1), HostId(5)).is_none());
        assert!(other.open(&sealed, LinkId(1), HostId(4)).is_none());
        assert!(!format!("{key:?}").contains('7'), "a key is never printed");
    }

    /// Keys of the members of these numbers, in order. A pair's key is made of the two numbers.
    fn members(numbers: &[u16]) -> Vec<Key> {
        let pair = |one: u16, other: u16| {
            let mut bytes = [1; 32];
            bytes[..2].copy_from_slice(&one.min(other).to_le_bytes());
            bytes[2..4].copy_from_slice(&one.max(other).to_le_bytes());
            bytes
        };
        let of = |one: u16| Key::of_member([9; 32], numbers.iter().map(|&n| (HostId(n), pair(one, n))).collect());
        numbers.iter().copied().map(of).collect()
    }

    fn datagram(sender: u16, flags: u8) -> Vec<u8> {
        let flags = Flags(flags);
        let mut plain =
            codec::start(&codec::Header { flags, team: 7, sender: HostId(sender), incarnation: 1, sequence: 1 });
        plain.extend_from_slice(&[5; 40]);
        plain
    }

    #[test]
    fn no_member_makes_what_another_accepts_as_a_thirds() {
        let keys = members(&[0, 1, 2, 0xc001]);
        makes_nothing_that_another_accepts_as_a_thirds(&keys, &Key::new([9; 32]));
        strangers_are_not_heard(&keys, &members(&[2, 9])[1]);
    }

    #[test]
    fn no_member_makes_what_another_accepts_as_a_thirds_if_it_is_confidential() {
        let confidential = |keys: Vec<Key>| keys.into_iter().map(Key::confidential).collect::<Vec<Key>>();
        let keys = confidential(members(&[0, 1, 2, 0xc001]));
        makes_nothing_that_another_accepts_as_a_thirds(&keys, &Key::new([9; 32]).confidential());
        strangers_are_not_heard(&keys, &confidential(members(&[2, 9]))[1]);
    }

    /// Checks the keys of four members, beside one that has the team's key alone.
    fn makes_nothing_that_another_accepts_as_a_thirds(keys: &[Key], team: &Key) {
        let longer = if team.is_confidential() { ENCRYPTION_BYTES } else { 0 };
        for (to, flags) in [(None, 0), (Some(HostId(1)), Flags::DIRECT)] {
            let mut honest = datagram(0, flags);
            let plain = honest.clone();
            keys[0].seal(&mut honest, LinkId(1), to);
            let tags = if to.is_some() { TAG_BYTES.max(longer) } else { longer + 4 * SHORT_TAG_BYTES + 1 };
            assert_eq!(honest.len() - plain.len(), tags);
            let opened = keys[1].open(&honest, LinkId(1), HostId(1)).expect("it is of host 0");
            assert_eq!(opened[HEADER_BYTES..], plain[HEADER_BYTES..]);
            if longer == 0 {
                assert_eq!(codec::untagged(&honest), &*opened, "a record's reader has no key");
            } else {
                assert_eq!(codec::decode(codec::untagged(&honest)).unwrap_err(), codec::DecodeError::Encrypted);
            }
            assert!(keys[1].open(&honest, LinkId(2), HostId(1)).is_none(), "on another link");
            assert_eq!(keys[2].open(&honest, LinkId(1), HostId(2)).is_some(), to.is_none(), "what is for host 1 alone");
            let short = plain.len() + longer;
            let all = (0..honest.len() * 8).all(|bit| {
                let mut turned = honest.clone();
                turned[bit / 8] ^= 1 << (bit % 8);
                // The short tags of others are theirs to check.
                let others = to.is_none() && (short..honest.len() - 1).contains(&(bit / 8));
                let own = (short + SHORT_TAG_BYTES..short + 2 * SHORT_TAG_BYTES).contains(&(bit / 8));
                keys[1].open(&turned, LinkId(1), HostId(1)).is_some() == (others && !own)
            });
            assert!(all, "any flipped bit");
            // Host 2 and the team's key make it in the name of host 0.
            for forger in [&keys[2], team] {
                let mut forged = datagram(0, flags);
                forger.seal(&mut forged, LinkId(1), to);
                assert!(keys[1].open(&forged, LinkId(1), HostId(1)).is_none());
                assert!(keys[3].open(&forged, LinkId(1), HostId(0xc001)).is_none());
            }
            // A part of an honest one, as one for host 1 alone or for all.
            let mut other = honest.clone();
            other[FLAGS_AT] ^= Flags::DIRECT;
            assert!(keys[1].open(&other, LinkId(1), HostId(1)).is_none());
        }
    }

    /// Checks what goes to and comes from hosts that are no members, or the own one. `ninth` has a key with member 2.
    fn strangers_are_not_heard(keys: &[Key], ninth: &Key) {
        let mut own = datagram(1, 0);
        keys[1].seal(&mut own, LinkId(1), None);
        assert!(keys[1].open(&own, LinkId(1), HostId(1)).is_some(), "of another process of the same operator");
        let mut stranger = datagram(7, 0);
        keys[2].seal(&mut stranger, LinkId(1), None);
        assert!(keys[1].open(&stranger, LinkId(1), HostId(1)).is_none(), "of no member");
        let mut unknown = datagram(2, Flags::DIRECT);
        keys[2].seal(&mut unknown, LinkId(1), Some(HostId(9)));
        assert!(ninth.open(&unknown, LinkId(1), HostId(9)).is_none(), "for no member");
        let said = unknown.windows(8).any(|bytes| bytes == [5; 8]);
        assert_eq!(said, !keys[2].is_confidential(), "nothing is said in clear to a host without a key");
    }

    #[test]
    fn what_is_in_clear_is_refused_by_who_encrypts_and_the_reverse_and_a_record_has_either() {
        let of_members = || members(&[0, 1]).swap_remove(0);
        for (key, to) in [(Key::new([7; 32]), None), (of_members(), None), (of_members(), Some(HostId(0)))] {
            let [clear, confidential] = both(key.clone());
            let flags = if to.is_some() { Flags::DIRECT } else { 0 };
            let sealed = |by: &Key| {
                let mut datagram = datagram(0, flags);
                by.seal(&mut datagram, LinkId(1), to);
                datagram
            };
            let (open, secret) = (sealed(&clear), sealed(&confidential));
            let opens = |key: &Key, datagram: &[u8]| key.open(datagram, LinkId(1), HostId(0)).is_some();
            assert!(opens(&clear, &open) && opens(&confidential, &secret));
            assert!(!opens(&clear, &secret) && !opens(&confidential, &open));
            let record = key.for_records();
            assert!(opens(&record, &open) && opens(&record, &secret));
            // Flags that say something else than what was sent.
            for (datagram, key) in [(open, &confidential), (secret, &clear)] {
                let mut lie = datagram.clone();
                lie[FLAGS_AT] ^= Flags::ENCRYPTED;
                assert!(!opens(key, &lie) && !opens(&record, &lie));
            }
        }
    }

    #[test]
    fn the_largest_confidential_datagram_fits_with_the_tags_of_all_members() {
        let numbers: Vec<u16> = (0..codec::MAX_MEMBERS as u16).collect();
        for key in both(members(&numbers).swap_remove(0)) {
            let mut datagram = datagram(0, 0);
            datagram.resize(key.room(), 0);
            key.seal(&mut datagram, LinkId(1), None);
            assert_eq!(datagram.len(), MAX_FRAME_BYTES);
        }
    }
}
