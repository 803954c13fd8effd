//! Identity of a record: program, arguments, host and seed of the run. It is the metadata `murmurate.run` of the file.
//! A replay starts the same run from it. It never contains a key.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use murmurate::messages::ids::HostId;

/// Name of the MCAP metadata that contains the identity of a record.
pub const METADATA: &str = "murmurate.run";
/// Name of the metadata of a file that was merged of several records: the clock offset of each host.
pub const MERGED: &str = "murmurate.merge";
/// Version of the format of records that this program writes. It reads those before it, too: version 1 has no digests
/// of metadata, and no numbers of refused datagrams.
pub const FORMAT: u32 = 2;

/// Identity of a record: all that a replay needs to start the recorded run again, such as program, arguments, host and
/// seed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Version of the record's format.
    pub format: u32,
    /// Version of the program that made the record.
    pub version: String,
    /// Digest of the sources of the program that made the record. A program with another digest may behave differently.
    pub build: String,
    /// Arguments of the command that was recorded, without the program's name.
    pub arguments: Vec<String>,
    /// Environment variables that override fields of the team file, each with its value.
    pub variables: Vec<(String, String)>,
    /// Wall clock at the start of the run \[ns\] since 1970; 0 in a simulation.
    pub anchor_ns: u64,
    /// Digest of the policy's file; empty for scripted navigation.
    pub policy: String,
    /// Name and version of the engine that computed the policy, and the kind of processor; empty for a policy that
    /// computes the same bits everywhere.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub engine: String,
    /// Index of the recorded repeat, from 0, in a record of a simulation; otherwise 0.
    pub repeat: u32,
    /// The recorded host process; `None` in a record of a simulation or of an operator,
    /// and in an imported one.
    pub host: Option<HostIdentity>,
    /// Column and policy of the trial, in a record of a study; otherwise `None`.
    #[serde(default)]
    pub job: Option<StudyJob>,
    /// Whether an operator recorded the messages that it received. Such a record cannot be replayed.
    #[serde(default)]
    pub operator: bool,
    /// Whether the record was made of the files of another program, by the mapping that is attached. Its true states
    /// are those that were measured, and it cannot be replayed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub imported: bool,
    /// Index of this file among the files of its record, from 0.
    #[serde(default)]
    pub part: u32,
    /// Whether the record has only the seconds before and after triggers, such as an emergency stop. Such a record
    /// cannot be replayed.
    #[serde(default)]
    pub excerpt: bool,
}

/// Place of a recorded trial in its study: its column (conditions) and policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StudyJob {
    /// Index of the column of the study, from 0.
    pub column: usize,
    /// Index of the policy among those that the study compares, from 0.
    pub policy: usize,
}

/// Identity of a recorded host process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HostIdentity {
    /// Name of the host in the deployment.
    pub name: String,
    /// Id of the host in the deployment.
    pub id: HostId,
    /// Incarnation of the process: a random number of this run of the host.
    pub incarnation: u32,
    /// Seed of the link layer's random streams in that process, as 64 hexadecimal digits.
    pub seed: String,
    /// Number of transports (such as sockets) of each link, in the order of the deployment's links.
    pub transports: Vec<usize>,
    /// Whether the team had a key. The key itself is never in a record.
    pub keyed: bool,
    /// Whether the team's members signed what others may pass on, and its operators what ended a stop or a hold.
    #[serde(default)]
    pub signed: bool,
    /// Roster of the team's members with which the process began, as hexadecimal digits of the bytes that the root key
    /// has signed; empty if that was the roster of its key file. It has no key in clear.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub roster: String,
}

impl HostIdentity {
    /// Returns the name of the process: name and incarnation of the host, such as `pc-0000002a`.
    pub fn process_name(&self) -> String {
        format!("{}-{:08x}", self.name, self.incarnation)
    }
}

/// Error: the identity in a file's metadata cannot be used; its text says why.
#[derive(Debug, thiserror::Error)]
#[error("its metadata '{METADATA}' cannot be used: {0}")]
pub struct WrongIdentity(String);

impl Identity {
    /// Returns the identity of a record that this program makes of a simulation. `build` is the digest of the program's
    /// sources, `arguments` are those of the command, `policy` is the digest of the policy's file.
    /// Variables, host and wall clock are empty.
    pub fn here(build: &str, arguments: Vec<String>, policy: &str) -> Identity {
        Identity {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            build: build.to_owned(),
            arguments,
            variables: Vec::new(),
            anchor_ns: 0,
            policy: policy.to_owned(),
            engine: String::new(),
            repeat: 0,
            host: None,
            job: None,
            operator: false,
            imported: false,
            part: 0,
            excerpt: false,
        }
    }

    /// Returns whether the record is of a simulation, which can be run again from its seed.
    pub fn is_of_simulation(&self) -> bool {
        self.host.is_none() && !self.operator && !self.imported
    }

    /// Returns the identity as MCAP metadata: each field as JSON text, strings without quotes.
    pub fn to_metadata(&self) -> BTreeMap<String, String> {
        let serde_json::Value::Object(fields) = serde_json::to_value(self).expect("an identity is JSON") else {
            unreachable!("an identity is an object")
        };
        let text = |value: serde_json::Value| match value {
            serde_json::Value::String(text) => text,
            other => other.to_string(),
        };
        fields.into_iter().map(|(name, value)| (name, text(value))).collect()
    }

    /// Reads the identity from the MCAP metadata of a record. Fails if the record has another format or a field is
    /// wrong.
    pub fn of_metadata(metadata: &BTreeMap<String, String>) -> Result<Identity, WrongIdentity> {
        const TEXTS: [&str; 4] = ["version", "build", "policy", "engine"];
        let format = metadata.get("format").map_or("", String::as_str);
        if !(1..=FORMAT).any(|known| known.to_string() == format) {
            let format: String = format.chars().take(20).collect();
            return Err(WrongIdentity(format!("it has format {format:?}, and this program reads up to {FORMAT}")));
        }
        let mut fields = serde_json::Map::new();
        for (name, value) in metadata {
            let value = if TEXTS.contains(&&**name) {
                serde_json::Value::String(value.clone())
            } else {
                serde_json::from_str(value).map_err(|error| WrongIdentity(format!("field '{name}': {error}")))?
            };
            fields.insert(name.clone(), value);
        }
        let read: Result<Identity, _> = serde_json::from_value(serde_json::Value::Object(fields));
        let identity = read.map_err(|error| WrongIdentity(error.to_string()))?;
        // Wall clocks have 61 bits until the year 2043, so that sums of times do not overflow.
        if identity.anchor_ns >= 1 << 61 {
            return Err(WrongIdentity("its start is no time of a wall clock".to_owned()));
        }
        Ok(identity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_identity_is_read_from_its_metadata_and_another_format_is_refused() {
        let mut identity = Identity::here("1f", vec!["sim".to_owned(), "--seed".to_owned(), "7".to_owned()], "ab12");
        for host in [
            None,
            Some(HostIdentity {
                name: "pc".to_owned(),
                id: HostId(2),
                incarnation: 7,
                seed: "00ff".to_owned(),
                transports: vec![1, 0, 2],
                keyed: true,
                signed: true,
                roster: String::new(),
            }),
        ] {
            identity.host = host;
            identity.engine = if identity.host.is_some() { "an engine 1.0".to_owned() } else { String::new() };
            assert_eq!(Identity::of_metadata(&identity.to_metadata()).unwrap(), identity);
        }
        let mut other = identity.to_metadata();
        other.insert("format".to_owned(), "9".to_owned());
        assert!(Identity::of_metadata(&other).unwrap_err().to_string().contains("format \"9\""));
    }
}
