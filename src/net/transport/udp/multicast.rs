//! Multicast: to a group that all hosts of a link listen to.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use super::socket::{INTERFACE, RECEIVE_BUFFER, SocketConfig, Whom, bound};
use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::net::transport::interface::LOOPBACK;
use crate::net::transport::{Entry, Field, Given, Way};

/// The port of the default groups.
const PORT: u16 = 7700;

/// The transport.
pub const ENTRY: Entry = Entry {
    name: "multicast",
    about: "UDP to a group that all hosts listen to",
    fields: &[
        INTERFACE,
        Field { default: Some(default_group), ..Field::new("group", FieldType::Address) },
        RECEIVE_BUFFER,
    ],
    read,
};

/// The group of a link that names none: one for each link.
fn default_group(at: usize) -> String {
    let last = u8::try_from(at % 254).expect("it is below 254") + 1;
    SocketAddr::new(IpAddr::from([239, 255, 77, last]), PORT).to_string()
}

fn read(given: &Given) -> Result<Arc<dyn Way>, ConfigError> {
    let (interface, receive_buffer_bytes) = bound(given)?;
    let group = given.find("group").map(Value::address).expect("it has a default");
    if !group.ip().is_multicast() {
        let why = format!("{} is no multicast group, such as 239.255.77.1 or ff02::4d75", group.ip());
        return Err(given.wrong("group", why));
    }
    if group.is_ipv6() && interface == LOOPBACK {
        let why = format!("an IPv6 group never arrives on '{LOOPBACK}'; take an IPv4 group there");
        return Err(given.wrong("group", why));
    }
    Ok(Arc::new(SocketConfig { whom: Whom::Group(group), interface, receive_buffer_bytes }))
}

/// The way onto a link by this group on this interface, where no team file says it. The kernel is asked to keep so many
/// bytes of what has arrived.
pub fn way(group: SocketAddr, interface: &str, receive_buffer_bytes: usize) -> Arc<dyn Way> {
    let interface = interface.to_owned();
    Arc::new(SocketConfig { whom: Whom::Group(group), interface, receive_buffer_bytes })
}
