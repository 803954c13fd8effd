//! Form of the key file of one member of a team, a host or an operator: its secret, the public root key of the team,
//! and the list of all members with their public keys. The root's own file, which is kept off the robots, is in `root`.

use std::collections::BTreeMap;

use data_encoding::HEXLOWER;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::codec::MAX_MEMBERS;
use murmurate::net::protocol::member::Member;
use murmurate::net::protocol::roster::Roster;
use serde::Deserialize;

use super::digits::{BYTES, is_guessable, parse};

/// Member of a team as its own key file describes it.
pub struct OwnFile {
    /// Number of the member as a host or an operator.
    pub number: HostId,
    /// Name of the member, as in the team file.
    pub name: String,
    /// Number of the team.
    pub team: u16,
    /// Public root key of the team.
    pub root: [u8; BYTES],
    /// Keys of the member.
    pub member: Member,
}

/// Form of a member's key file (TOML).
#[derive(Deserialize)]
struct Form {
    team: u16,
    number: u16,
    name: String,
    roster: Option<u32>,
    root: Option<String>,
    shared: String,
    secret: String,
    members: Vec<FormMember>,
}

/// Entry of a member in a list of members.
#[derive(Deserialize)]
pub struct FormMember {
    /// Number of the member as a host or an operator.
    pub number: u16,
    /// Name of the member, as in the team file.
    pub name: String,
    /// Public key of the member, as hexadecimal digits; a revoked member in the root's file has none.
    pub public: Option<String>,
}

/// Returns a key from its hexadecimal digits in the field `what` of a key file. An error says what is wrong, and never
/// shows the key.
pub fn key_of(what: &str, digits: &str) -> Result<[u8; BYTES], String> {
    let key = parse(digits.as_bytes()).filter(|key| !is_guessable(key));
    key.ok_or_else(|| format!("has no key as '{what}'"))
}

impl OwnFile {
    /// Reads a member's key file. An error says what is wrong, and never shows a key.
    pub fn parse(text: &str) -> Result<OwnFile, String> {
        // The library's message would show the line, which has a secret.
        let form: Form = toml::from_str(text).map_err(|_| "is no key file of a member".to_owned())?;
        let (shared, secret) = (key_of("shared", &form.shared)?, key_of("secret", &form.secret)?);
        let (Some(number), Some(root)) = (form.roster, &form.root) else {
            return Err("is of a former version, without a root key".to_owned());
        };
        let root = key_of("root", root)?;
        let mut members = BTreeMap::new();
        for member in &form.members {
            let public = key_of("public", member.public.as_deref().unwrap_or(""))?;
            if members.insert(HostId(member.number), public).is_some() {
                return Err(format!("names member {} twice", member.number));
            }
        }
        if members.len() > MAX_MEMBERS {
            return Err(format!("names {} members, and {MAX_MEMBERS} are the most", members.len()));
        }
        let own = HostId(form.number);
        let roster = Roster { number, planned: false, members };
        let member =
            Member::new(form.team, (own, secret), root, (roster, shared)).map_err(|error| error.to_string())?;
        Ok(OwnFile { number: own, name: form.name, team: form.team, root, member })
    }
}

/// Returns the text of the key file of the member `(number, name)` of the team `team` with the secret `secret`. The
/// roster has the names of all its members, and the key `shared` of all.
pub fn text(
    (team, root): (u16, &[u8; BYTES]),
    (number, name, secret): (HostId, &str, &[u8; BYTES]),
    (roster, names, shared): (&Roster, &BTreeMap<HostId, String>, &[u8; BYTES]),
) -> String {
    let mut text = format!(
        "# Secret: the owner of this file is '{name}' of team {team}. Copy it there alone, with mode 0600.\n\
         team = {team}\nnumber = {}\nname = {name:?}\nroster = {}\nroot = \"{}\"\nshared = \"{}\"\nsecret = \"{}\"\n",
        number.0,
        roster.number,
        HEXLOWER.encode(root),
        HEXLOWER.encode(shared),
        HEXLOWER.encode(secret)
    );
    for (number, public) in &roster.members {
        text += &entry(*number, names.get(number).map_or("", String::as_str), Some(public));
    }
    text
}

/// Returns the entry of a member in a list of members. A revoked one has no public key.
pub fn entry(number: HostId, name: &str, public: Option<&[u8; BYTES]>) -> String {
    let public = public.map_or_else(String::new, |public| format!("public = \"{}\"\n", HEXLOWER.encode(public)));
    format!("\n[[members]]\nnumber = {}\nname = {name:?}\n{public}", number.0)
}

#[cfg(test)]
mod tests {
    use murmurate::messages::ids::LinkId;
    use murmurate::net::protocol::codec::{self, Flags, Header};
    use murmurate::net::protocol::key::Key;

    use super::super::root::Root;
    use super::*;

    fn made() -> Vec<String> {
        let members =
            [(HostId(0), "pc".to_owned()), (HostId(1), "robot".to_owned()), (HostId::operator(1), "me".into())];
        let mut drawn = 0u64;
        let mut draw = || {
            drawn += 1;
            Ok(*blake3::hash(&drawn.to_le_bytes()).as_bytes())
        };
        let (_, files) = Root::new(7, &members, &mut draw).expect("keys are drawn");
        files.into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn what_one_member_seals_the_others_open_and_none_of_another_team_does() {
        let keys = |files: &[String]| -> Vec<Key> {
            files.iter().map(|text| Key::of(OwnFile::parse(text).expect("a key file").member)).collect()
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
            (text.replace("root = ", "roots = "), "former version"),
            (text.replace("root = \"", "root = \"0"), "no key as 'root'"),
            (text.replacen("public = ", "publics = ", 1), "no key as 'public'"),
            (text.replacen("\nnumber = 1\nname", "\nnumber = 0\nname", 1), "not that of its own entry"),
        ] {
            let Err(why) = OwnFile::parse(&wrong) else { panic!("{words}") };
            assert!(why.contains(words) && !why.contains(&secret[10..20]), "{why}");
        }
    }
}
