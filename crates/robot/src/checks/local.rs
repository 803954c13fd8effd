//! Checks that need neither other hosts nor devices: key, policy, and the links on this machine.

use std::path::Path;

use murmurate::deploy::Link;
use murmurate::deploy::team::Team;
use murmurate::edge::Settings;
use murmurate::fitness::{Finding, Fitness};
use murmurate::messages::ids::HostId;
use murmurate::net::transport::Place;
use murmurate::registry::Registry;
use murmurate::trial::Trial;

use super::contained::{self, Signs};
use super::finding::{Found, Subject};
use crate::policy::{self, LoadedTeam};
use crate::{BadInput, key, own_name, team};

/// Checks key, policy and links of the host `team.host`.
pub fn check(team: &Team, registry: &Registry) -> Vec<Found> {
    let mut found = vec![check_key(team), check_policy(team, registry)];
    for (link, place) in team.deployment.links.iter().zip(&team.links) {
        if let Some(place) = place {
            found.extend(check_link(team.host, &link.name, place));
            found.extend(check_wifi(link, place));
            found.extend(check_contained(&link.name, place));
        }
    }
    found.extend(check_ros(team, &|name| std::env::var(name).ok()));
    found
}

/// Checks the variables of ROS 2 of a host that speaks it; `variable` returns the value of one that is set.
fn check_ros(team: &Team, variable: &dyn Fn(&str) -> Option<String>) -> Vec<Found> {
    let host = &team.deployment.hosts[usize::from(team.host.0)];
    let parts = [&host.driver, &host.source, &host.observe].into_iter().flatten();
    let domain = |settings: &Settings| {
        let domain = settings.table.get("domain").and_then(toml::Value::as_integer).unwrap_or(0);
        u16::try_from(domain).unwrap_or_default()
    };
    let domains: Vec<u16> = parts.filter(|settings| settings.name == "ros2").map(domain).collect();
    if domains.is_empty() {
        return Vec::new();
    }
    let found =
        |Finding { fitness, what, found, advice }: Finding| (fitness, Subject::General(what.to_owned()), found, advice);
    murmurate_ros2::discovery::findings(variable, &domains).into_iter().map(found).collect()
}

fn check_key(team: &Team) -> Found {
    let found =
        |status, found: String, advice: &str| (status, Subject::General("key".to_owned()), found, advice.to_owned());
    match &team.key_file {
        None => found(
            Fitness::Warn,
            "none: every program on this machine can command these robots".to_owned(),
            &format!("make one with '{} key new' and name it as key_file", own_name()),
        ),
        Some(path) => match key::read(path) {
            Ok(file) => {
                let (print, name) = (file.fingerprint(), &*team.deployment.hosts[usize::from(team.host.0)].name);
                // Who listens does so as an operator.
                let operator = file.member().is_some_and(|(number, _)| number.is_operator());
                if let (false, Err(error)) = (operator, file.check_host(team.number, (team.host, name))) {
                    return found(Fitness::Fail, error.to_string(), "");
                }
                let encrypts = if team.confidential { "; datagrams are encrypted" } else { "" };
                let every = format!("fingerprint {print}, which every host of the team must have{encrypts}");
                match file.member() {
                    Some((_, name)) => {
                        let roster = file.roster().unwrap_or(0);
                        let own = format!("it is that of '{name}', who can impersonate no other, by roster {roster}");
                        found(Fitness::Ok, format!("{every}; {own}"), "")
                    }
                    None => found(
                        Fitness::Warn,
                        format!(
                            "{every}; each holder of it can impersonate any host, the state server and an operator"
                        ),
                        &format!("make a file for each member with '{} key new TEAM.toml'", own_name()),
                    ),
                }
            }
            // The error also says what to do.
            Err(error) => found(Fitness::Fail, error.to_string(), ""),
        },
    }
}

fn check_policy(team: &Team, registry: &Registry) -> Found {
    let found = |status, found: String| (status, Subject::General("policy".to_owned()), found, String::new());
    // A key that cannot be read is the finding of its own check.
    let key = team.key_file.as_deref().and_then(|path| key::read(path).ok());
    let key = key.map(|file| file.key().confidential_if(team.confidential));
    let fits = |policy: LoadedTeam| {
        // Whether the team has what its policies take.
        Trial::of_host(registry, team, policy.models.clone()).map_err(|error| BadInput(error.to_string()))?;
        Ok(policy)
    };
    let loaded = team::policy(team, registry).and_then(|policy| policy::room::checked(policy, key.as_ref()));
    match loaded.and_then(fits) {
        Ok(policy) if policy.warnings.is_empty() => found(Fitness::Ok, policy.name),
        Ok(policy) => found(Fitness::Warn, policy.warnings.join("; ")),
        Err(error) => found(Fitness::Fail, error.to_string()),
    }
}

fn check_link(host: HostId, link: &str, place: &Place) -> Vec<Found> {
    let found = |Finding { fitness, what, found, advice }: Finding| {
        (fitness, Subject::Link { link: link.to_owned(), item: what.to_owned() }, found, advice)
    };
    place.endpoint.check(host, link, &mtu).into_iter().map(found).collect()
}

/// Checks the Wi-Fi card of a link, if its interface is one.
fn check_wifi(link: &Link, place: &Place) -> Vec<Found> {
    let Some(interface) = place.endpoint.interface() else { return Vec::new() };
    let found = |Finding { fitness, what, found, advice }: Finding| {
        (fitness, Subject::Link { link: link.name.clone(), item: what.to_owned() }, found, advice)
    };
    let all = match murmurate_wifi::look(interface) {
        Ok(None) => return Vec::new(),
        Ok(Some(card)) => murmurate_wifi::findings(&card, interface, link.medium),
        Err(error) => vec![Finding {
            fitness: Fitness::Warn,
            what: "Wi-Fi",
            found: format!("the kernel tells nothing of '{interface}': {error}"),
            advice: format!("see what 'iw dev {interface} info' says"),
        }],
    };
    all.into_iter().map(found).collect()
}

/// Checks whether multicast of a link can leave this machine, if it is a container or WSL2.
fn check_contained(link: &str, place: &Place) -> Option<Found> {
    let multicast = !place.endpoint.is_local() && place.endpoint.claim().field == "group";
    let interface = place.endpoint.interface().filter(|_| multicast)?;
    let finding = contained::finding(&Signs::read(Path::new("/")), interface, contained::is_paired(interface)?)?;
    let Finding { fitness, what, found, advice } = finding;
    Some((fitness, Subject::Link { link: link.to_owned(), item: what.to_owned() }, found, advice))
}

/// Returns the largest packet of an interface \[bytes\]; `None` if it is unknown.
fn mtu(interface: &str) -> Option<usize> {
    let text = std::fs::read_to_string(Path::new("/sys/class/net").join(interface).join("mtu")).ok()?;
    text.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::deploy::team::TeamFile;

    /// Returns the settings of host 0 of a team on this machine.
    fn team() -> Team {
        let link =
            |name: &str, port: u16| format!("[link.{name}]\ninterface = \"lo\"\ngroup = \"239.255.77.1:{port}\"\n");
        let text = format!("team = 1\nmode = \"centralized\"\n{}{}", link("infra", 7700), link("wires", 7701));
        let file = TeamFile::read(&crate::registry(), &text, Path::new(""), &[], &[]).unwrap();
        file.for_host(HostId(0)).unwrap()
    }

    #[test]
    fn a_missing_key_is_a_warning_and_one_that_cannot_be_read_a_failure() {
        let mut team = team();
        let (status, what, found, advice) = check_key(&team);
        assert_eq!((status, what.to_string()), (Fitness::Warn, "key".to_owned()));
        assert!(found.starts_with("none: ") && advice.contains("key new"), "{found}; {advice}");
        team.key_file = Some("/nowhere/team.key".into());
        let (status, _, found, _) = check_key(&team);
        assert!(status == Fitness::Fail && found.contains("/nowhere/team.key"), "{found}");
    }

    #[test]
    fn variables_of_ros_are_named_on_hosts_that_speak_it_alone() {
        let variable = |name: &str| (name == "ROS_DISCOVERY_SERVER").then(|| "10.0.0.2:11811".to_owned());
        let mut team = team();
        assert!(check_ros(&team, &variable).is_empty());
        let table = "namespace = '/r0'".parse().expect("TOML");
        team.deployment.hosts[0].driver = Some(Settings { name: "ros2".to_owned(), table });
        let found = check_ros(&team, &variable);
        assert!(found.len() == 1 && found[0].1.to_string() == "ROS_DISCOVERY_SERVER", "{found:?}");
    }

    #[test]
    fn a_policy_that_is_not_there_is_a_failure() {
        let mut team = team();
        assert_eq!(check_policy(&team, &crate::registry()).0, Fitness::Ok);
        team.policy = Some("/nowhere/policy.toml".into());
        let (status, _, found, _) = check_policy(&team, &crate::registry());
        assert!(status == Fitness::Fail && found.contains("/nowhere/policy.toml"), "{found}");
    }
}
