//! Revisions of the hosts' messages, as the page has been told.

use std::collections::BTreeMap;

use murmurate::messages::ids::HostId;
use murmurate::messages::wire::REVISION;

/// Revision of the messages of each host that has told it.
#[derive(Clone, Debug, Default)]
pub(super) struct Revisions(BTreeMap<HostId, u16>);

impl Revisions {
    /// Takes what a host has told. Returns a line for the log if it is another revision than before, or at first
    /// another than that of this program.
    pub fn told(&mut self, host: HostId, revision: u16) -> Option<String> {
        let known = self.0.insert(host, revision).unwrap_or(REVISION);
        (revision != known).then(|| match revision {
            REVISION => format!("host {} has messages of revision {REVISION} now, as this page", host.0),
            _ => {
                format!("host {} has messages of revision {revision}, this page of {REVISION}: the team stands", host.0)
            }
        })
    }
}
