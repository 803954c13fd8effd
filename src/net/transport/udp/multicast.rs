//! Multicast transport: sends to a multicast group that all hosts of a link join.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use super::socket::{Addressing, INTERFACE, RECEIVE_BUFFER, SocketConfig, bound};
use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::net::transport::interface::LOOPBACK;
use crate::net::transport::{Endpoint, Entry, Field, LinkSettings};

/// UDP port of the default groups.
const PORT: u16 = 7700;

/// Registry entry of the transport `multicast`, which sends to a UDP multicast group that all hosts of a link join.
pub(crate) const ENTRY: Entry = Entry {
    name: "multicast",
    about: "UDP to a group that all hosts listen to",
    fields: &[
        INTERFACE,
        Field { default: Some(default_group), ..Field::new("group", FieldType::Address) },
        RECEIVE_BUFFER,
    ],
    read,
};

/// Returns the default group of the link with index `at`; each link has its own.
fn default_group(at: usize) -> String {
    group(at, PORT).to_string()
}

/// Returns the group of the link with index `at` if it names none, with this port.
pub(super) fn group(at: usize, port: u16) -> SocketAddr {
    let last = u8::try_from(at % 254).expect("it is below 254") + 1;
    SocketAddr::new(IpAddr::from([239, 255, 77, last]), port)
}

fn read(settings: &LinkSettings) -> Result<Arc<dyn Endpoint>, ConfigError> {
    read_with(settings, Addressing::Multicast)
}

/// Reads the endpoint of a link that uses a group as `addressing` says.
pub(super) fn read_with(
    settings: &LinkSettings,
    addressing: fn(SocketAddr) -> Addressing,
) -> Result<Arc<dyn Endpoint>, ConfigError> {
    let (interface, receive_buffer_bytes) = bound(settings)?;
    let group = settings.find("group").map(Value::address).expect("it has a default");
    if !group.ip().is_multicast() {
        let why = format!("{} is no multicast group, such as 239.255.77.1 or ff02::4d75", group.ip());
        return Err(settings.wrong("group", why));
    }
    if group.is_ipv6() && interface == LOOPBACK {
        let why = format!("an IPv6 group never arrives on '{LOOPBACK}'; take an IPv4 group there");
        return Err(settings.wrong("group", why));
    }
    Ok(Arc::new(SocketConfig { addressing: addressing(group), interface, receive_buffer_bytes }))
}

/// Returns an endpoint in the multicast group `group` on the named network interface, without a team file.
/// `receive_buffer_bytes` is the size of the receive buffer that is requested from the kernel.
pub fn endpoint(group: SocketAddr, interface: &str, receive_buffer_bytes: usize) -> Arc<dyn Endpoint> {
    let interface = interface.to_owned();
    Arc::new(SocketConfig { addressing: Addressing::Multicast(group), interface, receive_buffer_bytes })
}
