//! Preparation of a recorded host for its replay: team, policy and key from the record's files and from flags.

use std::path::Path;

use anyhow::Result;

use super::{Args, confine, sorted};
use murmurate::deploy::team::Team;
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::scenario::TaskFile;
use murmurate::scenario::task_file::is_task_file;
use murmurate_record::identity::Identity;
use murmurate_record::reader::Opened;
use murmurate_replay::files::Files;
use murmurate_replay::host::{Access, Prepared};
use murmurate_robot::output::{read_text, talk};
use murmurate_robot::{BadInput, bad, host, key, team};

/// Builds a host from its record for a replay, with the attached files `files`, and returns it with the name of its
/// policy. The tags of datagrams are checked with the team's key, or replaced by the record's list of valid ones. The
/// flag `--policy` replaces the policy.
pub fn prepare(
    args: &Args,
    (path, opened): (&Path, Opened),
    files: &Files,
    registry: &Registry,
) -> Result<(Prepared, String)> {
    let Opened { identity, messages, attached } = opened;
    let confined = confine(files, args.policy.as_deref());
    let team = team_of(&identity, files, registry, |team_args| {
        team_args.set.extend(args.policy.iter().map(|policy| format!("policy={}", policy.display())));
    })?;
    let of = identity.host.as_ref().expect("the caller has seen a host");
    // The path of the key file in the record is not used: the record may be from an untrusted source.
    let given = args.key_file.as_deref().filter(|_| of.keyed).map(key::read).transpose()?.map(|file| file.own_key());
    let Some(access) = Access::of(of, &attached, given, team.confidential) else {
        let path = path.display();
        return bad(format!("'{path}' is of a team with a key, which is in no record: give it with --key-file"));
    };
    if access.trusts {
        talk(&format!("warning: '{}': no tag is checked; what its list says of them is trusted", path.display()));
    }
    let policy = team::policy(&team, registry)?;
    drop(confined);
    // The recorded answers are those of the recorded policy.
    let models = match args.policy {
        Some(_) => policy.models.map(Model::computed_inline),
        None => policy.models,
    };
    let prepared = Prepared::new((path, identity, messages), (&team, models), access, registry);
    Ok((prepared.map_err(sorted)?, policy.name))
}

/// Returns the configuration of the team as the recorded host had it, from the files and arguments in its record.
/// `change` may first change the flags that override fields of the team file.
pub fn team_of(
    identity: &Identity,
    files: &Files,
    registry: &Registry,
    change: impl FnOnce(&mut team::TeamArgs),
) -> Result<Team> {
    let mut team_args = host::of_record(&files.in_place(&identity.arguments))?;
    change(&mut team_args);
    let folder = identity.arguments.iter().find_map(|argument| {
        let named = files.team_file().is_some_and(|name| name == argument);
        named.then(|| Path::new(argument).parent().unwrap_or(Path::new("")).to_owned())
    });
    let file = team_args.read_as_of(&with_tasks(registry, files), folder.as_deref(), &identity.variables)?;
    let name = identity.host.as_ref().map_or("", |host| &host.name);
    let id = file.host_named(name).map_err(|error| BadInput(error.to_string()))?;
    let mut team = team_args.for_host(&file, id)?;
    let of_roles = team.deployment.roles.values_mut().map(|role| &mut role.policy);
    for policy in [&mut team.policy].into_iter().chain(of_roles).flatten() {
        if let Some(extracted) = files.extracted(policy) {
            *policy = extracted.to_owned();
        }
    }
    Ok(team)
}

/// Returns the registry with the task files among the files of a record, under the paths that they had.
fn with_tasks(registry: &Registry, files: &Files) -> Registry {
    let texts = files.files.iter().filter(|(name, _)| is_task_file(name));
    let texts = texts.filter_map(|(name, path)| Some((name, read_text(path, "task file").ok()?)));
    // Team files and others end with the same letters.
    let tasks = texts.filter_map(|(name, text)| Some((name, TaskFile::read(&text).ok()?)));
    tasks.fold(registry.clone(), |registry, (name, file)| registry.with_task(name, file))
}
