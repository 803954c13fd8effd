//! Network interfaces of this machine, and the choice of one for a link. Reads only from the kernel.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV6};

use nix::ifaddrs::getifaddrs;
use nix::net::if_::{InterfaceFlags, if_nametoindex};

/// Name of the loopback interface.
pub(crate) const LOOPBACK: &str = "lo";
/// Value for a network interface in a team file that selects the only interface that is suitable.
pub(crate) const AUTO: &str = "auto";

/// Groups that a user may take in place of one of the other family.
const GROUP_V4: &str = "239.255.77.1:7700";
const GROUP_V6: &str = "[ff02::4d75]:7700";

/// Network interface of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Interface {
    /// Name of the interface.
    pub name: String,
    /// Number of the interface in the kernel.
    pub index: u32,
    /// Whether the interface is up and has a carrier.
    pub up: bool,
    /// Whether the interface is a loopback interface.
    pub loopback: bool,
    /// IPv4 addresses of the interface.
    pub v4: Vec<Ipv4Addr>,
    /// IPv6 addresses of the interface.
    pub v6: Vec<Ipv6Addr>,
}

/// Reason why no interface can be used for a link.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum InterfaceError {
    /// The kernel does not list the interfaces.
    #[error("cannot list the network interfaces: {0}")]
    Unknown(String),
    /// This machine has no network interface with the configured name.
    #[error("there is no network interface '{name}'; there are: {known}")]
    Missing {
        /// Configured name.
        name: String,
        /// List of the existing interfaces.
        known: String,
    },
    /// The configured network interface is down.
    #[error("the network interface '{name}' is down; there are: {known}")]
    Down {
        /// Configured name.
        name: String,
        /// List of the existing interfaces.
        known: String,
    },
    /// The configured interface has no address of the required family.
    #[error("the network interface '{name}' has no {family} address{advice}; there are: {known}")]
    Address {
        /// Configured name.
        name: String,
        /// Required family: IPv4 or IPv6.
        family: &'static str,
        /// Advice if the interface has an address of the other family; otherwise empty.
        advice: String,
        /// List of the existing interfaces.
        known: String,
    },
    /// The interface is configured as `auto`, and several network interfaces are suitable, or none.
    #[error("'auto' finds {found} interfaces that are up and no loopback; name one of: {known}")]
    Ambiguous {
        /// Number of suitable interfaces.
        found: usize,
        /// List of the existing interfaces.
        known: String,
    },
}

impl InterfaceError {
    /// Whether the cause may be over in a moment, without a person: an interface that comes up, or its address. Several
    /// interfaces in place of one stay.
    pub(crate) fn may_pass(&self) -> bool {
        !matches!(self, InterfaceError::Ambiguous { found: 1.., .. })
    }
}

impl Interface {
    /// Returns the addresses of a family.
    pub fn addresses(&self, v6: bool) -> Vec<IpAddr> {
        if v6 {
            self.v6.iter().copied().map(IpAddr::V6).collect()
        } else {
            self.v4.iter().copied().map(IpAddr::V4).collect()
        }
    }
}

/// Returns all network interfaces of this machine, sorted by name. Fails if the kernel does not list them.
pub fn interfaces() -> Result<Vec<Interface>, InterfaceError> {
    let mut all: BTreeMap<String, Interface> = BTreeMap::new();
    for address in getifaddrs().map_err(|errno| InterfaceError::Unknown(errno.to_string()))? {
        let name = address.interface_name;
        let flags = address.flags;
        let index = if_nametoindex(name.as_str()).unwrap_or(0);
        let entry = all.entry(name.clone()).or_insert(Interface {
            name,
            index,
            up: flags.contains(InterfaceFlags::IFF_UP | InterfaceFlags::IFF_RUNNING),
            loopback: flags.contains(InterfaceFlags::IFF_LOOPBACK),
            v4: Vec::new(),
            v6: Vec::new(),
        });
        if let Some(address) = address.address {
            if let Some(v4) = address.as_sockaddr_in() {
                entry.v4.push(v4.ip());
            } else if let Some(v6) = address.as_sockaddr_in6() {
                entry.v6.push(v6.ip());
            }
        }
    }
    Ok(all.into_values().collect())
}

/// Lists the interfaces in an error.
fn known(all: &[Interface]) -> String {
    let one = |interface: &Interface| {
        let addresses = interface.v4.iter().map(|v4| IpAddr::V4(*v4)).chain(interface.v6.iter().map(|v6| (*v6).into()));
        let mut words: Vec<String> = addresses.map(|address| address.to_string()).collect();
        if !interface.up {
            words.insert(0, "down".to_owned());
        }
        format!("{} ({})", interface.name, words.join(" "))
    };
    all.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// Returns the interface called `name` among `all`, or the only suitable one if `name` is `auto`; of several, that with
/// the name `used`, which is in use already. It must be up and have an IPv6 address if `v6` is set, otherwise an IPv4
/// address; an error says what is missing.
pub fn find(all: &[Interface], name: &str, v6: bool, used: Option<&str>) -> Result<Interface, InterfaceError> {
    let fits = |interface: &&Interface| interface.up && !interface.loopback && !interface.addresses(v6).is_empty();
    let known = || known(all);
    if name == AUTO {
        let mut found: Vec<&Interface> = all.iter().filter(fits).collect();
        if let Some(same) = found.iter().find(|interface| used == Some(&interface.name)) {
            return Ok((*same).clone());
        }
        return match (found.pop(), found.len()) {
            (Some(only), 0) => Ok(only.clone()),
            (one, others) => {
                Err(InterfaceError::Ambiguous { found: others + usize::from(one.is_some()), known: known() })
            }
        };
    }
    let named = all.iter().find(|interface| interface.name == name);
    let named = named.ok_or_else(|| InterfaceError::Missing { name: name.to_owned(), known: known() })?;
    if !named.up {
        return Err(InterfaceError::Down { name: name.to_owned(), known: known() });
    }
    if named.addresses(v6).is_empty() {
        let (family, advice) = match (v6, named.addresses(!v6).is_empty()) {
            (true, true) => ("IPv6", String::new()),
            (false, true) => ("IPv4", String::new()),
            (true, false) => ("IPv6", format!(", but IPv4: an IPv4 group, such as {GROUP_V4}, would do on all hosts")),
            (false, false) => ("IPv4", format!(", but IPv6: group = \"{GROUP_V6}\" would do on all hosts")),
        };
        return Err(InterfaceError::Address { name: name.to_owned(), family, advice, known: known() });
    }
    Ok(named.clone())
}

/// Returns an address with the interface of this number as its scope if it is an IPv6 address of the link.
pub fn within(at: SocketAddr, index: u32) -> SocketAddr {
    match at {
        SocketAddr::V6(v6) if v6.ip().is_multicast() || v6.ip().is_unicast_link_local() => {
            SocketAddrV6::new(*v6.ip(), v6.port(), 0, index).into()
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interface(name: &str, up: bool, v4: &[Ipv4Addr]) -> Interface {
        Interface { name: name.to_owned(), index: 1, up, loopback: name == "lo", v4: v4.to_vec(), v6: Vec::new() }
    }

    #[test]
    fn the_machine_has_a_loopback() {
        let all = interfaces().unwrap();
        let lo = all.iter().find(|interface| interface.loopback).expect("every machine has one");
        assert!(lo.index > 0);
    }

    #[test]
    fn what_cannot_be_used_is_refused_and_the_others_are_named() {
        let one = Ipv4Addr::new(10, 0, 0, 1);
        let all = [
            interface("lo", true, &[Ipv4Addr::LOCALHOST]),
            interface("wlan0", true, &[one]),
            interface("eth0", false, &[one]),
            interface("bare", true, &[]),
        ];
        assert_eq!(find(&all, "wlan0", false, None).unwrap().name, "wlan0");
        assert_eq!(find(&all, AUTO, false, None).unwrap().name, "wlan0");
        let said = |name: &str, v6| find(&all, name, v6, None).unwrap_err().to_string();
        assert!(said("wlan7", false).contains("no network interface 'wlan7'; there are: lo (127.0.0.1), wlan0 (10.0"));
        assert!(said("eth0", false).contains("'eth0' is down"));
        assert!(said("bare", false).contains("no IPv4 address"));
        assert!(said("wlan0", true).contains("no IPv6 address"));
        assert!(said(AUTO, true).contains("finds 0 interfaces"));
        let two = [interface("a", true, &[one]), interface("b", true, &[one])];
        let many = find(&two, AUTO, false, None).unwrap_err();
        assert!(many.to_string().contains("finds 2 interfaces") && !many.may_pass(), "a person has to choose: {many}");
        assert_eq!(find(&two, AUTO, false, Some("b")).unwrap().name, "b", "the one in use stays");
    }

    #[test]
    fn what_may_be_over_in_a_moment_is_told_from_what_a_person_has_to_mend() {
        let all = [interface("eth0", false, &[]), interface("bare", true, &[])];
        for name in ["wlan7", "eth0", "bare", AUTO] {
            let error = find(&all, name, false, None).unwrap_err();
            assert!(error.may_pass(), "{error}");
        }
    }

    #[test]
    fn an_interface_without_an_address_of_the_family_names_the_group_of_the_other_that_would_do() {
        let six = Interface { v6: vec!["fe80::1".parse().unwrap()], ..interface("w0", true, &[]) };
        let four = interface("w1", true, &[Ipv4Addr::new(10, 0, 0, 1)]);
        let all = [six, four];
        let said = |name: &str, v6| find(&all, name, v6, None).unwrap_err().to_string();
        assert!(said("w0", false).contains("no IPv4 address, but IPv6: group = \"[ff02::4d75]:7700\" would do"));
        assert!(said("w1", true).contains("no IPv6 address, but IPv4: an IPv4 group, such as 239.255.77.1:7700"));
    }
}
