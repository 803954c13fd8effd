//! Keys of the members of a team, hosts and operators: each has a secret of its own, and with each other member a key
//! that only the two have (X25519, RFC 7748). So no member can impersonate another. Operators also sign what ends a
//! stop or a hold (Ed25519, RFC 8032), with a key that is derived from their secret.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use data_encoding::HEXLOWER;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::codec::MAX_MEMBERS;
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::signatures::Signatures;
use serde::Deserialize;
use x25519_dalek::{PublicKey, StaticSecret};

use super::digits::{BYTES, is_guessable, parse, refuse};

/// Context string for the derivation of the key of a pair, unique to it.
const CONTEXT: &str = "murmurate 2026-11-28 key of a pair of members";

/// Context string for the derivation of the secret key with which an operator signs, unique to it.
const SIGNING: &str = "murmurate 2026-11-28 signing key of an operator";

/// Member of a team, as its own key file describes it: what it is, its secret, and the public keys of all members.
pub struct Member {
    /// Number of the member as a host or an operator.
    pub number: HostId,
    /// Name of the member, as in the team file.
    pub name: String,
    team: u16,
    secret: [u8; BYTES],
    publics: BTreeMap<HostId, [u8; BYTES]>,
    /// Public key of each operator, by which hosts check its signatures.
    signers: BTreeMap<HostId, [u8; BYTES]>,
}

/// Form of a member's key file (TOML).
#[derive(Deserialize)]
struct Form {
    team: u16,
    number: u16,
    name: String,
    shared: String,
    secret: String,
    members: Vec<FormMember>,
}

#[derive(Deserialize)]
struct FormMember {
    number: u16,
    public: String,
    /// Public key of signatures, which operators have.
    signs: Option<String>,
}

impl Member {
    /// Reads a member's key file. Returns the bytes that all members have, and the member. An error says what is wrong,
    /// and never shows a key.
    pub fn parse(text: &str) -> Result<([u8; BYTES], Member), String> {
        // The library's message would show the line, which has a secret.
        let form: Form = toml::from_str(text).map_err(|_| "is no key file of a member".to_owned())?;
        let key = |what: &str, digits: &str| {
            let key = parse(digits.as_bytes()).filter(|key| !is_guessable(key));
            key.ok_or_else(|| format!("has no key as '{what}'"))
        };
        let (shared, secret) = (key("shared", &form.shared)?, key("secret", &form.secret)?);
        let (mut publics, mut signers) = (BTreeMap::new(), BTreeMap::new());
        for member in &form.members {
            let number = HostId(member.number);
            match &member.signs {
                Some(signs) => signers.extend([(number, key("signs", signs)?)]),
                None if number.is_operator() => {
                    return Err("is of a former version, in which operators signed nothing".to_owned());
                }
                None => {}
            }
            if publics.insert(number, key("public", &member.public)?).is_some() {
                return Err(format!("names member {} twice", member.number));
            }
        }
        if publics.len() > MAX_MEMBERS {
            return Err(format!("names {} members, and {MAX_MEMBERS} are the most", publics.len()));
        }
        let number = HostId(form.number);
        let own = PublicKey::from(&StaticSecret::from(secret)).to_bytes();
        if publics.get(&number) != Some(&own) {
            return Err("has a secret that is not that of its own entry in its list of members".to_owned());
        }
        let member = Member { number, name: form.name, team: form.team, secret, publics, signers };
        if member.number.is_operator() && member.signers.get(&number) != Some(&Signatures::public(member.signing())) {
            return Err("has a secret that does not sign as its own entry in its list of members says".to_owned());
        }
        member.signatures().ok_or("has no public key as 'signs'")?;
        Ok((shared, member))
    }

    /// Checks that the file, read from `path`, is of the team with this number.
    pub fn check_team(&self, path: &Path, team: u16) -> Result<()> {
        if self.team == team {
            return Ok(());
        }
        refuse(path, &format!("is of team {}, and this is team {team}: name that of this team", self.team))
    }

    /// Returns the secret key with which the member signs if it is an operator.
    fn signing(&self) -> [u8; BYTES] {
        blake3::derive_key(SIGNING, &self.secret)
    }

    /// Returns the keys by which orders are signed and checked; `None` if an operator's is no public key.
    fn signatures(&self) -> Option<Signatures> {
        Signatures::new(self.number.is_operator().then(|| self.signing()), &self.signers)
    }

    /// Returns the member's keys with each member, under the key `shared` of all.
    pub fn key(&self, shared: [u8; BYTES]) -> Key {
        let secret = StaticSecret::from(self.secret);
        let own = (self.number, &self.publics[&self.number]);
        let pairs = self.publics.iter().map(|(number, public)| {
            let common = secret.diffie_hellman(&PublicKey::from(*public));
            let (low, high) = if own.0 <= *number { (own, (*number, public)) } else { ((*number, public), own) };
            let mut all = common.as_bytes().to_vec();
            all.extend_from_slice(&self.team.to_le_bytes());
            for (number, public) in [low, high] {
                all.extend_from_slice(&number.0.to_le_bytes());
                all.extend_from_slice(public);
            }
            (*number, blake3::derive_key(CONTEXT, &all))
        });
        let signatures = self.signatures().expect("they were checked when the file was read");
        Key::of_member(shared, pairs.collect()).with_signatures(signatures)
    }
}

/// Returns the texts of new key files for these members of the team with the number `team`, in the same order. `draw`
/// gives random bytes.
pub fn files(
    team: u16,
    members: &[(HostId, String)],
    mut draw: impl FnMut() -> Result<[u8; BYTES]>,
) -> Result<Vec<String>> {
    let shared = draw()?;
    let secrets = members.iter().map(|_| draw()).collect::<Result<Vec<[u8; BYTES]>>>()?;
    let mut list = String::new();
    for ((number, name), secret) in members.iter().zip(&secrets) {
        let public = PublicKey::from(&StaticSecret::from(*secret));
        let public = HEXLOWER.encode(public.as_bytes());
        list += &format!("\n[[members]]\nnumber = {}\nname = {name:?}\npublic = \"{public}\"\n", number.0);
        if number.is_operator() {
            let signs = Signatures::public(blake3::derive_key(SIGNING, secret));
            list += &format!("signs = \"{}\"\n", HEXLOWER.encode(&signs));
        }
    }
    let file = |((number, name), secret): (&(HostId, String), &[u8; BYTES])| {
        format!(
            "# Secret: who has this file is '{name}' of team {team}. Copy it there alone, with mode 0600.\n\
             team = {team}\nnumber = {}\nname = {name:?}\nshared = \"{}\"\nsecret = \"{}\"\n{list}",
            number.0,
            HEXLOWER.encode(&shared),
            HEXLOWER.encode(secret)
        )
    };
    Ok(members.iter().zip(&secrets).map(file).collect())
}

#[cfg(test)]
mod tests {
    use murmurate::messages::ids::LinkId;
    use murmurate::net::protocol::codec::{self, Flags, Header};

    use super::*;

    fn made() -> Vec<String> {
        let members =
            [(HostId(0), "pc".to_owned()), (HostId(1), "robot".to_owned()), (HostId::operator(1), "me".into())];
        let mut drawn = 0u64;
        let draw = || {
            drawn += 1;
            Ok(*blake3::hash(&drawn.to_le_bytes()).as_bytes())
        };
        files(7, &members, draw).unwrap()
    }

    #[test]
    fn what_one_member_seals_the_others_open_and_none_of_another_team_does() {
        let keys = |files: &[String]| -> Vec<Key> {
            let read = |text: &String| Member::parse(text).map(|(shared, member)| member.key(shared));
            files.iter().map(|text| read(text).unwrap()).collect()
        };
        let ours = keys(&made());
        let header = Header { flags: Flags(0), team: 7, sender: HostId(0), incarnation: 1, sequence: 1 };
        let mut sealed = codec::start(&header);
        ours[0].seal(&mut sealed, LinkId(0), None);
        assert!(ours[1].open(&sealed, LinkId(0), HostId(1)).is_some());
        assert!(ours[2].open(&sealed, LinkId(0), HostId::operator(1)).is_some());
        let other: Vec<String> = made().iter().map(|text| text.replace("team = 7", "team = 8")).collect();
        assert!(keys(&other)[1].open(&sealed, LinkId(0), HostId(1)).is_none(), "the team is in every key");
    }

    #[test]
    fn a_file_that_is_not_whole_is_refused_and_no_error_shows_a_key() {
        let text = made().remove(1);
        let secret = text.lines().find_map(|line| line.strip_prefix("secret = \"")).unwrap().trim_end_matches('"');
        for (wrong, words) in [
            (text.replace(secret, &secret.replace(['a', 'b', 'c'], "d")), "not that of its own entry"),
            (text.replace(secret, &"0".repeat(64)), "no key as 'secret'"),
            (text.replace("shared = ", "shares = "), "no key file"),
            (text.replace(&secret[..9], ""), "no key as 'secret'"),
            (text.replace("number = 0\n", "number = 1\n"), "twice"),
            (text.replace("signs = ", "sings = "), "former version"),
            (text.replace("signs = \"", "signs = \"0"), "no key as 'signs'"),
            (text.replacen("\nnumber = 1\nname", "\nnumber = 0\nname", 1), "not that of its own entry"),
        ] {
            let Err(why) = Member::parse(&wrong) else { panic!("{words}") };
            assert!(why.contains(words) && !why.contains(&secret[10..20]), "{why}");
        }
    }
}
