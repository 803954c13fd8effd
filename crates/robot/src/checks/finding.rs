//! Results of checks: severity, what was checked, what was observed, and advice.

use std::fmt;

use murmurate::fitness::Fitness;
use serde::{Serialize, Serializer};

/// Result of one check.
#[derive(Debug, Serialize)]
pub struct Check {
    /// Severity of the result.
    pub status: Fitness,
    /// Name of the host to which the check belongs; "here" for a check of the machine.
    pub host: String,
    /// Thing that was checked, such as the key, a link or a robot.
    pub what: Subject,
    /// Text that says what the check observed.
    pub found: String,
    /// Advice on what to do; empty if there is nothing to do.
    pub advice: String,
}

/// Thing that a check is about, displayed as `key`, `link infra, MTU` or `link infra, host world`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Subject {
    /// Any thing but a link, by name, such as `key`, `policy` or a robot.
    General(String),
    /// Property `item` of the link `link` on this machine, such as its MTU.
    Link {
        /// Name of the link.
        link: String,
        /// What of it was checked.
        item: String,
    },
    /// The host `host` as this machine hears it on the link `link`.
    Peer {
        /// Name of the link.
        link: String,
        /// Name of the host that is heard.
        host: String,
    },
}

impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Subject::General(what) => f.write_str(what),
            Subject::Link { link, item } => write!(f, "link {link}, {item}"),
            Subject::Peer { link, host } => write!(f, "link {link}, host {host}"),
        }
    }
}

impl Serialize for Subject {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Result of a check, before it is known for which host it was made: severity, subject, observation, advice.
pub(super) type Found = (Fitness, Subject, String, String);

impl Check {
    /// Returns a result as one of the host with this name.
    pub(super) fn of(host: &str, (status, what, found, advice): Found) -> Check {
        Check { status, host: host.to_owned(), what, found, advice }
    }
}
