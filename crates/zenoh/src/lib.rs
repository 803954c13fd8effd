//! Transport `zenoh`: frames as payloads of a Zenoh session, through routers or between peers. Fields of a team file,
//! and the endpoints that carry datagrams. The session itself is in `session.rs` and `link.rs`, behind the feature
//! `zenoh`; without it, a team file is read and checked, and a link with this transport cannot be opened.
//!
//! Frames to all hosts of a link are published under `murmurate/TEAM/LINK/all`, those to one host under
//! `murmurate/TEAM/LINK/to/HOST`, with its number. Each is best effort, express, of real-time priority, and dropped on
//! congestion. Routers are not trusted: tag, epoch and replay window are those of every other transport.

#![deny(clippy::print_stdout, clippy::print_stderr)]

#[cfg(feature = "zenoh")]
mod link;
#[cfg(feature = "zenoh")]
mod route;
#[cfg(feature = "zenoh")]
mod session;

use std::path::PathBuf;
use std::sync::Arc;

use murmurate::config::ConfigError;
use murmurate::config::fields::FieldType;
#[cfg(feature = "zenoh")]
use murmurate::fitness::Finding;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::transport::{Claim, Endpoint, Entry, Field, Filter, LinkSettings, OpenError, Transport};

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Whether sessions are built in: the feature `zenoh`.
pub const BUILT: bool = cfg!(feature = "zenoh");

/// Registry entry of the transport `zenoh`, which publishes frames in a Zenoh session.
pub const ENTRY: Entry = Entry {
    name: "zenoh",
    about: "through a Zenoh router, or between Zenoh peers",
    fields: &[
        Field::new("mode", FieldType::Choice(&["client", "peer", "router"])),
        Field::new("connect", FieldType::Text),
        Field::new("listen", FieldType::Text),
        Field::new("config", FieldType::Path),
        Field::new("streams", FieldType::Choice(&["refuse", "allow"])),
    ],
    read,
};

/// Error text for a user whose program was built without the feature `zenoh`, but whose team file has a link that needs
/// it.
pub const NOT_BUILT: &str =
    "this program is built without Zenoh; build it by `cargo install --path crates/cli --features zenoh`";

/// Whether an endpoint may be a stream (TCP, or QUIC without datagrams), where a lost packet delays all later frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Streams {
    /// Streams are refused.
    Refuse,
    /// Streams are allowed.
    Allow,
}

/// Configuration of a host's Zenoh session on a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionConfig {
    /// Prefix of the keys under which frames are published: `murmurate`, the team's number and the link's name.
    pub key: String,
    /// Mode of the session: `client`, `peer` or `router`; `None` for that of the file `config`, or
    /// `client` where it has none.
    pub mode: Option<String>,
    /// Endpoints that the session connects to, such as `udp/10.0.0.1:7447`; empty for those of the file `config`.
    pub connect: Vec<String>,
    /// Endpoints at which the session listens; empty for those of the file `config`.
    pub listen: Vec<String>,
    /// Configuration file of Zenoh itself, such as one with certificates.
    pub config: Option<PathBuf>,
    /// Whether endpoints may be streams.
    pub streams: Streams,
    /// Whether the session is that of a guest, which never listens.
    pub guest: bool,
}

impl SessionConfig {
    /// Returns the session of a guest, such as an operator, on the same link: a client of what the host connects to, or
    /// of the host itself if it connects to nothing.
    pub fn of_guest(&self) -> SessionConfig {
        let connect = if self.connect.is_empty() { self.listen.clone() } else { self.connect.clone() };
        let mode = if connect.is_empty() { self.mode.clone() } else { Some("client".to_owned()) };
        SessionConfig { mode, connect, listen: Vec::new(), guest: true, ..self.clone() }
    }

    /// Returns the key of frames to all hosts.
    pub fn key_of_all(&self) -> String {
        format!("{}/all", self.key)
    }

    /// Returns the key of frames to the host with the number `host`.
    pub fn key_of(&self, host: u16) -> String {
        format!("{}/to/{host}", self.key)
    }
}

fn read(settings: &LinkSettings) -> Result<Arc<dyn Endpoint>, ConfigError> {
    let text = |field: &str| settings.find(field).map(|value| value.text().to_owned());
    let streams = if text("streams").as_deref() == Some("allow") { Streams::Allow } else { Streams::Refuse };
    let config = text("config").map(PathBuf::from);
    // A file of Zenoh's own may have a mode.
    let mode = text("mode").or_else(|| config.is_none().then(|| "client".to_owned()));
    let endpoints = |field: &str| {
        // `none` takes back what the table of the whole team says.
        let Some(list) = text(field).filter(|list| list != "none") else { return Ok(Vec::new()) };
        let all: Vec<String> = list.split(',').map(|one| one.trim().to_owned()).collect();
        match all.iter().find_map(|one| check_endpoint(one, streams).err()) {
            Some(why) => Err(settings.wrong(field, why)),
            None => Ok(all),
        }
    };
    let (connect, listen) = (endpoints("connect")?, endpoints("listen")?);
    match mode.as_deref() {
        Some("client") if !listen.is_empty() => {
            return Err(settings.wrong("listen", "a client listens nowhere; leave it out, or choose mode \"router\""));
        }
        Some("client") if connect.is_empty() && config.is_none() => {
            let why = "missing; say where a Zenoh router listens, such as \"udp/10.0.0.1:7447\"";
            return Err(settings.wrong("connect", why));
        }
        Some(mode) if connect.is_empty() && listen.is_empty() && config.is_none() => {
            let why = format!("missing; a {mode} listens somewhere, such as \"udp/0.0.0.0:7447\", or connects");
            return Err(settings.wrong("listen", why));
        }
        _ => {}
    }
    if let Some(odd) = settings.link.chars().find(|letter| "/*$#?".contains(*letter)) {
        let why = format!("'{odd}' in the name of link '{}' means something else in Zenoh's keys", settings.link);
        return Err(settings.wrong("transport", why));
    }
    let key = format!("murmurate/{}/{}", settings.team.unwrap_or_default(), settings.link);
    Ok(Arc::new(SessionConfig { key, mode, connect, listen, config, streams, guest: false }))
}

impl Endpoint for SessionConfig {
    #[cfg(feature = "zenoh")]
    fn open(&self, host: HostId, _: Filter) -> Result<Box<dyn Transport>, OpenError> {
        link::open(self, host)
    }

    #[cfg(not(feature = "zenoh"))]
    fn open(&self, _: HostId, _: Filter) -> Result<Box<dyn Transport>, OpenError> {
        Err(OpenError::Wrong(NOT_BUILT.to_owned()))
    }

    fn for_guest(&self, _: HostId) -> Arc<dyn Endpoint> {
        Arc::new(self.of_guest())
    }

    fn setup(&self, reliability: Reliabilities) -> Setup {
        Setup::relayed(reliability)
    }

    /// A router on this machine may pass frames on to others, so they count as leaving it.
    fn is_local(&self) -> bool {
        false
    }

    fn claim(&self) -> Claim {
        let (field, what) = match &self.listen[..] {
            [] if self.guest => ("connect", format!("{} through {}", self.key, self.connect.join(", "))),
            [] => ("connect", self.key.clone()),
            all => ("listen", all.join(", ")),
        };
        Claim { field, what, on: String::new() }
    }

    /// Frames reach only hosts that listen on the link, so nothing has to be left out.
    fn restricted_to(&self, _: &[HostId]) -> Arc<dyn Endpoint> {
        Arc::new(self.clone())
    }

    #[cfg(feature = "zenoh")]
    fn check(&self, _: HostId, link: &str, _: &dyn Fn(&str) -> Option<usize>) -> Vec<Finding> {
        link::check(self, link)
    }
}

/// Checks that frames through an endpoint, such as `udp/10.0.0.1:7447`, do not wait for lost ones before them. An error
/// says why the endpoint is refused, and which one to take.
pub fn check_endpoint(endpoint: &str, streams: Streams) -> Result<(), String> {
    let Some((protocol, address)) = endpoint.split_once('/').filter(|(_, address)| !address.is_empty()) else {
        return Err(format!("'{endpoint}' is no endpoint of Zenoh, such as udp/10.0.0.1:7447"));
    };
    let metadata = address.split_once('?').map_or("", |(_, after)| after);
    let metadata = metadata.split_once('#').map_or(metadata, |(before, _)| before);
    let datagrams = metadata.split(';').any(|one| one == "mixed_rel=1" || one == "rel=0");
    match protocol {
        "udp" => Ok(()),
        "quic" if datagrams || streams == Streams::Allow => Ok(()),
        "tcp" if streams == Streams::Allow => Ok(()),
        "quic" => Err(format!(
            "'{endpoint}' is a stream, in which a lost packet delays all frames after it; add ?mixed_rel=1, or allow \
             it by streams = \"allow\""
        )),
        "tcp" => Err(format!(
            "'{endpoint}' is a stream, in which a lost packet delays all frames after it; take udp/ or \
             quic/...?mixed_rel=1, or allow it by streams = \"allow\""
        )),
        "tls" => Err(format!("'{endpoint}': TLS is to be had as quic/...?mixed_rel=1, which carries datagrams")),
        other => Err(format!("'{other}' is not built in; there are: udp, quic, tcp")),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use murmurate::config::fields::Value;
    use murmurate::net::transport::settings::FieldValue;

    fn error(fields: &[(&str, &str)]) -> String {
        let value = |text: &str| FieldValue { value: Value::Text(text.to_owned()), place: String::new() };
        let values: BTreeMap<String, FieldValue> =
            fields.iter().map(|(name, text)| ((*name).to_owned(), value(text))).collect();
        let settings = LinkSettings { link: "air", team: Some(7), host: HostId(0), hosts: vec!["a"], values };
        read(&settings).map(drop).map_or_else(|error| error.to_string(), |()| "none".to_owned())
    }

    fn says(fields: &[(&str, &str)], part: &str) {
        let error = error(fields);
        assert!(error.contains(part), "{fields:?}: {error}");
    }

    #[test]
    fn endpoints_in_which_a_lost_packet_delays_later_frames_are_refused_unless_allowed() {
        for sound in ["udp/10.0.0.1:7447", "quic/a:1?mixed_rel=1", "quic/a:1?x=2;mixed_rel=1#iface=b", "quic/a:1?rel=0"]
        {
            assert_eq!(check_endpoint(sound, Streams::Refuse), Ok(()), "{sound}");
        }
        for stream in ["tcp/10.0.0.1:7447", "quic/a:7447", "quic/a:1?mixed_rel=0", "quic/a:1#mixed_rel=1"] {
            let why = check_endpoint(stream, Streams::Refuse).expect_err(stream);
            assert!(why.contains("stream") && why.contains("mixed_rel=1"), "{why}");
            assert_eq!(check_endpoint(stream, Streams::Allow), Ok(()), "{stream}");
        }
        for other in ["tls/a:1", "ws/a:1", "10.0.0.1:7447", "udp/", ""] {
            assert!(check_endpoint(other, Streams::Allow).is_err(), "{other}");
        }
    }

    #[test]
    fn a_session_without_an_endpoint_is_refused_by_its_field() {
        says(&[], "connect: missing");
        says(&[("mode", "router")], "listen: missing");
        says(&[("mode", "client"), ("listen", "udp/[::]:7447")], "a client listens nowhere");
        says(&[("connect", "none")], "missing; say where a Zenoh router listens");
        says(&[("connect", "udp/a:1, tcp/b:1")], "'tcp/b:1' is a stream");
        assert_eq!(error(&[("connect", "udp/a:1, tcp/b:1"), ("streams", "allow")]), "none");
        assert_eq!(error(&[("config", "zenoh.json5")]), "none");
    }

    #[test]
    fn a_guest_is_a_client_of_what_its_host_connects_to_or_of_the_host() {
        let host = |connect: &[&str], listen: &[&str]| SessionConfig {
            key: "murmurate/7/air".to_owned(),
            mode: Some("router".to_owned()),
            connect: connect.iter().map(|one| (*one).to_owned()).collect(),
            listen: listen.iter().map(|one| (*one).to_owned()).collect(),
            config: None,
            streams: Streams::Refuse,
            guest: false,
        };
        let guest = host(&[], &["udp/10.0.0.1:7447"]).of_guest();
        assert_eq!((guest.mode.as_deref(), guest.listen.len()), (Some("client"), 0));
        assert_eq!(guest.connect, ["udp/10.0.0.1:7447"]);
        assert_eq!(host(&["udp/10.0.0.9:1"], &["udp/10.0.0.1:7447"]).of_guest().connect, ["udp/10.0.0.9:1"]);
        assert_eq!(
            (guest.key_of_all(), guest.key_of(3)),
            ("murmurate/7/air/all".into(), "murmurate/7/air/to/3".into())
        );
    }
}
