//! Check that the messages of a policy fit into datagrams beside the tags of a team's members.

use anyhow::Result;

use murmurate::messages::geometry::Motion;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::wire::{Features, Latent, Phase, Round, Wire};
use murmurate::net::protocol::codec::{self, Flags, Header};
use murmurate::net::protocol::key::Key;

use super::LoadedTeam;
use crate::BadInput;

/// Returns policies whose messages fit into datagrams that are sealed with `key`.
///
/// # Errors
/// If they do not fit.
pub fn checked(policy: LoadedTeam, key: Option<&Key>) -> Result<LoadedTeam> {
    let features = policy.models.features();
    // Parts are cut to the room that there is.
    if !policy.models.form().is_in_parts(features) {
        check(&policy.name, features, key)?;
    }
    Ok(policy)
}

fn check(name: &str, features: usize, key: Option<&Key>) -> Result<()> {
    let Some(key) = key else { return Ok(()) };
    let (needs, room) = (bytes(features), key.room());
    if needs <= room {
        return Ok(());
    }
    let most = (0..features).rev().find(|features| bytes(*features) <= room).unwrap_or(0);
    let why = format!(
        "policy '{name}': its messages of {features} floats take {needs} bytes, and beside the tags of all members of \
         this team a datagram has room for {room}: take a policy with at most {most} floats, or fewer members, or one \
         key for all ('key new')"
    );
    Err(BadInput(why).into())
}

/// Returns the length of a datagram with a latent of so many floats, with every integer at its largest.
fn bytes(features: usize) -> usize {
    let round = Round { term: 1 << 30, episode: u32::MAX };
    let latent = Latent {
        robot: RobotId(u16::MAX),
        round,
        phase: Phase::Running,
        motion: Motion::default(),
        features: Features(vec![0.0; features].into()),
        part: None,
    };
    let header = Header { flags: Flags::default(), team: 0, sender: HostId(0), incarnation: 0, sequence: 0 };
    codec::encode(&header, &Wire::Latent(latent)).map_or(usize::MAX, |frame| frame.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_messages_fit_beside_the_tags_of_twelve_members_and_not_beside_those_of_twenty_four() {
        let key = |members: u16| {
            let pairs = (0..members).map(|member| (HostId(member), [member as u8; 32])).collect();
            Key::of_member([1; 32], pairs)
        };
        for key in [Key::new([7; 32]), key(12)].into_iter().flat_map(|key| [key.clone(), key.confidential()]) {
            check("wide", 256, Some(&key)).expect("it fits");
        }
        assert!(check("wide", 256, None).is_ok());
        let large = key(24).confidential();
        let said = check("wide", 256, Some(&large)).expect_err("it does not fit").to_string();
        assert!(said.starts_with("policy 'wide': its messages of 256 floats take 10"), "{said}");
        let most: usize = said
            .split("at most ")
            .nth(1)
            .and_then(|rest| rest.split(' ').next())
            .expect("a number")
            .parse()
            .expect("a number");
        assert!(
            most >= 230
                && check("narrow", most, Some(&large)).is_ok()
                && check("wide", most + 1, Some(&large)).is_err(),
            "{said}"
        );
    }
}
