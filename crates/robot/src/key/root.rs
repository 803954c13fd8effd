//! The root key of a team, which signs the lists of its members, in a file that is kept off the robots: the secret, the
//! number of the newest roster, and all members that there are or were.

use std::collections::BTreeMap;

use anyhow::Result;
use data_encoding::HEXLOWER;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::member::{public, seal_roster};
use murmurate::net::protocol::roster::{NONCE_BYTES, Roster};
use serde::Deserialize;

use super::digits::BYTES;
use super::member::{self, FormMember, entry, key_of};

/// The root of a team, as its file describes it.
pub struct Root {
    team: u16,
    secret: [u8; BYTES],
    /// Number of the newest roster.
    roster: u32,
    /// Name and public key of each member; a revoked one has no key.
    members: BTreeMap<HostId, (String, Option<[u8; BYTES]>)>,
}

/// Form of the root's file (TOML).
#[derive(Deserialize)]
struct Form {
    team: u16,
    roster: u32,
    /// The secret key. The files of members have the public one, by another name.
    secret_root: String,
    members: Vec<FormMember>,
}

/// Roster that the root has made, and the key file of the member that it has added, if any.
pub struct Changed {
    /// Number of the roster.
    pub number: u32,
    /// The roster as it is sent.
    pub sealed: Vec<u8>,
    /// Text of the key file of the added member.
    pub file: Option<String>,
}

/// Function that draws a key at random.
pub type Draw<'a> = &'a mut dyn FnMut() -> Result<[u8; BYTES]>;

impl Root {
    /// Makes a new root of the team `team` with these members. Returns the name and text of each member's key file,
    /// too, in the same order.
    pub fn new(team: u16, members: &[(HostId, String)], draw: Draw) -> Result<(Root, Vec<(String, String)>)> {
        let (root, shared) = (draw()?, draw()?);
        let secrets = members.iter().map(|_| draw()).collect::<Result<Vec<[u8; BYTES]>>>()?;
        let publics = members.iter().zip(&secrets).map(|((number, _), secret)| (*number, public(secret)));
        let roster = Roster { number: 1, planned: false, members: publics.collect() };
        let names: BTreeMap<HostId, String> = members.iter().cloned().collect();
        let of_team = (team, &public(&root));
        let text = |((number, name), secret): (&(HostId, String), &[u8; BYTES])| {
            (name.clone(), member::text(of_team, (*number, name, secret), (&roster, &names, &shared)))
        };
        let files = members.iter().zip(&secrets).map(text).collect();
        let keyed = |(number, name): (HostId, String)| (number, (name, roster.members.get(&number).copied()));
        let members = names.clone().into_iter().map(keyed).collect();
        Ok((Root { team, secret: root, roster: 1, members }, files))
    }

    /// Reads the root's file. An error says what is wrong, and never shows a key.
    pub fn parse(text: &str) -> Result<Root, String> {
        // The library's message would show the line, which has a secret.
        let form: Form = toml::from_str(text).map_err(|_| "is no root key: name root.key, as 'key new' has made it")?;
        let mut members = BTreeMap::new();
        for member in form.members {
            let public = member.public.as_deref().map(|public| key_of("public", public)).transpose()?;
            members.insert(HostId(member.number), (member.name, public));
        }
        Ok(Root { team: form.team, secret: key_of("secret_root", &form.secret_root)?, roster: form.roster, members })
    }

    /// Returns the text of the root's file.
    pub fn text(&self) -> String {
        let mut text = format!(
            "# Secret: the owner of this file decides on the members of team {}. Keep it off the robots, \
             with mode 0600.\n\
             team = {}\nroster = {}\nsecret_root = \"{}\"\n",
            self.team,
            self.team,
            self.roster,
            HEXLOWER.encode(&self.secret)
        );
        for (number, (name, public)) in &self.members {
            text += &entry(*number, name, public.as_ref());
        }
        text
    }

    /// Returns the names of the members, each with whether it was revoked.
    pub fn members(&self) -> impl Iterator<Item = (&str, bool)> {
        self.members.values().map(|(name, public)| (&**name, public.is_none()))
    }

    fn number_of(&self, name: &str) -> Option<HostId> {
        self.members.iter().find(|(_, (of, _))| of == name).map(|(number, _)| *number)
    }

    /// Removes the member `name`. An error says what is wrong.
    pub fn revoke(&mut self, name: &str) -> Result<(), String> {
        let all = self.members.values().filter(|(_, public)| public.is_some()).count();
        let member = self.number_of(name).and_then(|number| self.members.get_mut(&number));
        let Some((_, public)) = member else { return Err(self.unknown(name)) };
        if all == 1 {
            return Err(format!("has no other member than '{name}'"));
        }
        public.take().map(drop).ok_or_else(|| format!("says that '{name}' was revoked before"))
    }

    /// Adds the member `name` with a new key, in place of a key that it has: one that is or was a member, or a new
    /// operator (`operator-2`). Returns its number and secret. An error says what is wrong.
    pub fn add(&mut self, name: &str, draw: Draw) -> Result<(HostId, [u8; BYTES]), String> {
        let operator = name.strip_prefix("operator-").and_then(|nth| nth.parse().ok()).filter(|nth| *nth > 0);
        let Some(number) = self.number_of(name).or(operator.map(HostId::operator)) else {
            return Err(self.unknown(name));
        };
        let secret = draw().map_err(|error| error.to_string())?;
        self.members.insert(number, (name.to_owned(), Some(public(&secret))));
        Ok((number, secret))
    }

    fn unknown(&self, name: &str) -> String {
        let names: Vec<&str> = self.members().map(|(name, _)| name).collect();
        format!("has no member '{name}', but {}; a new operator is called operator-N", names.join(", "))
    }

    /// Makes the next roster, with a new key of all members. `planned` says that the keys before it stay valid for a
    /// while, and `added` which member is to get a key file. An error says what is wrong.
    pub fn next(&mut self, planned: bool, added: Option<(HostId, [u8; BYTES])>, draw: Draw) -> Result<Changed, String> {
        let mut drawn = || draw().map_err(|error| error.to_string());
        let (shared, nonce) = (drawn()?, drawn()?);
        let nonce = *nonce.first_chunk::<NONCE_BYTES>().expect("a key is longer");
        let number = self.roster.checked_add(1).ok_or("has the last number of a roster: make new keys")?;
        let members = self.members.iter().filter_map(|(number, (_, public))| Some((*number, (*public)?)));
        let roster = Roster { number, planned, members: members.collect() };
        let sealed = seal_roster((self.team, &roster), &self.secret, &shared, nonce);
        let sealed = sealed.ok_or_else(|| format!("has {} members, which are too many", roster.members.len()))?;
        self.roster = number;
        let names: BTreeMap<HostId, String> =
            self.members.iter().map(|(number, (name, _))| (*number, name.clone())).collect();
        let of_team = (self.team, &public(&self.secret));
        let file = added.map(|(number, secret)| {
            let name = names.get(&number).map_or("", String::as_str);
            member::text(of_team, (number, name, &secret), (&roster, &names, &shared))
        });
        Ok(Changed { number, sealed, file })
    }
}

#[cfg(test)]
mod tests {
    use murmurate::net::protocol::roster;

    use super::*;

    fn draw() -> impl FnMut() -> Result<[u8; BYTES]> {
        let mut drawn = 0u64;
        move || {
            drawn += 1;
            Ok(*blake3::hash(&drawn.to_le_bytes()).as_bytes())
        }
    }

    fn made() -> (Root, Vec<(String, String)>) {
        let members = [(HostId(0), "pc".to_owned()), (HostId(1), "robot".to_owned())];
        let operator = (HostId::operator(1), "operator-1".to_owned());
        Root::new(7, &[&members[..], &[operator]].concat(), &mut draw()).expect("keys are drawn")
    }

    #[test]
    fn members_are_removed_and_added_by_name_and_the_file_tells_the_rest() {
        let (root, _) = made();
        let mut root = Root::parse(&root.text()).expect("it is its own text");
        let mut draw = draw();
        assert!(root.revoke("stranger").unwrap_err().contains("pc, robot, operator-1"));
        root.revoke("robot").expect("it is a member");
        assert!(root.revoke("robot").unwrap_err().contains("before"));
        let second = root.next(false, None, &mut draw).expect("few members");
        let listed = |changed: &Changed| roster::read(&changed.sealed).expect("a roster").members;
        assert_eq!((second.number, listed(&second).len(), second.file.is_none()), (2, 2, true));
        let mut root = Root::parse(&root.text()).expect("it is its own text");
        assert!(root.members().any(|member| member == ("robot", true)));
        let added = root.add("robot", &mut draw).expect("it was one");
        let third = root.next(false, Some(added), &mut draw).expect("few members");
        let own = member::OwnFile::parse(third.file.as_deref().expect("it has a file")).expect("a key file");
        assert_eq!((third.number, own.number, own.member.roster().number), (3, HostId(1), 3));
        assert!(root.add("guest", &mut draw).unwrap_err().contains("operator-N"));
        assert_eq!(root.add("operator-2", &mut draw).expect("a new one").0, HostId::operator(2));
        for name in ["pc", "operator-1", "operator-2"] {
            root.revoke(name).expect("it is a member");
        }
        assert!(root.revoke("robot").unwrap_err().contains("no other member"));
    }

    #[test]
    fn the_file_of_a_member_is_no_root_and_that_of_the_root_no_members() {
        let (root, files) = made();
        for (name, text) in &files {
            assert!(Root::parse(text).is_err(), "{name}");
        }
        assert!(member::OwnFile::parse(&root.text()).is_err());
    }
}
