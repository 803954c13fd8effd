//! Machines as network namespaces, with networks between them. Needs root and `ip`, and `nft` for lost frames. Dropping
//! the lab removes everything.

use std::io::Write;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::program::skip::skip;

/// Machine: its name, and the name and network of each interface.
pub type Machine = (String, Vec<(String, String)>);

/// Namespaces of this process: one per machine, and one with a bridge per network.
pub struct Lab {
    prefix: String,
    machines: Vec<Machine>,
    networks: Vec<String>,
}

impl Lab {
    /// Builds the lab; `None`, with a notice, where that is not permitted.
    pub fn build(tag: &str, machines: Vec<Machine>) -> Option<Lab> {
        let mut networks: Vec<String> =
            machines.iter().flat_map(|(_, on)| on.iter().map(|(_, to)| to.clone())).collect();
        networks.sort();
        networks.dedup();
        // Several tests of one process may have labs at the same time.
        static LABS: AtomicUsize = AtomicUsize::new(0);
        let number = LABS.fetch_add(1, Ordering::Relaxed);
        let lab = Lab { prefix: format!("{tag}{}-{number}", std::process::id()), machines, networks };
        for (at, network) in lab.networks.iter().enumerate() {
            let hub = lab.space(network);
            if !lab.ip(&["netns", "add", &hub]) {
                assert!(at == 0, "a namespace cannot be made");
                skip("namespaces", "network namespaces need root and the program 'ip'");
                return None;
            }
            // Without snooping, multicast frames go to every port.
            assert!(lab.ip(&["-n", &hub, "link", "add", "bridge", "type", "bridge", "mcast_snooping", "0"]));
            assert!(lab.ip(&["-n", &hub, "link", "set", "bridge", "up"]));
        }
        for (number, (name, interfaces)) in lab.machines.iter().enumerate() {
            let space = lab.space(name);
            assert!(lab.ip(&["netns", "add", &space]));
            assert!(lab.ip(&["-n", &space, "link", "set", "lo", "up"]));
            // IPv6 addresses are usable at once, without duplicate address detection, which takes a second.
            lab.run(name, "sh", &["-c", "echo 0 > /proc/sys/net/ipv6/conf/default/accept_dad"]);
            for (interface, network) in interfaces {
                let (hub, port) = (lab.space(network), format!("port{number}"));
                let pair = ["-n", &space, "link", "add", interface, "type", "veth"];
                assert!(lab.ip(&[&pair[..], &["peer", "name", &port, "netns", &hub]].concat()));
                assert!(lab.ip(&["-n", &hub, "link", "set", &port, "master", "bridge", "up"]));
                let address = format!("{}/24", lab.address(name, network));
                assert!(lab.ip(&["-n", &space, "addr", "add", &address, "dev", interface]));
                assert!(lab.ip(&["-n", &space, "link", "set", interface, "up"]));
            }
        }
        lab.settle();
        Some(lab)
    }

    /// Returns the IPv4 address of a machine on a network.
    pub fn address(&self, machine: &str, network: &str) -> String {
        let number = self.machines.iter().position(|(name, _)| name == machine).expect("it is in the lab");
        let subnet = self.networks.iter().position(|name| name == network).expect("it is in the lab");
        format!("10.80.{}.{}", subnet + 1, number + 10)
    }

    /// Waits until every interface has its carrier, which the kernel reports up to a second late.
    fn settle(&self) {
        let deadline = Instant::now() + Duration::from_secs(10);
        for (name, interfaces) in &self.machines {
            for (interface, _) in interfaces {
                let up = || {
                    let output = Command::new("ip").args(["-n", &self.space(name), "link", "show", interface]).output();
                    String::from_utf8_lossy(&output.expect("it was there before").stdout).contains("state UP")
                };
                while !up() {
                    assert!(Instant::now() < deadline, "{name} has no carrier on {interface}");
                }
            }
        }
    }

    /// Returns the namespace of a machine or a network.
    pub fn space(&self, name: &str) -> String {
        format!("{}-{name}", self.prefix)
    }

    /// Returns a command on a machine.
    pub fn command(&self, machine: &str, program: &str) -> Command {
        on(&self.space(machine), program)
    }

    fn run(&self, machine: &str, program: &str, args: &[&str]) -> bool {
        let status = self.command(machine, program).args(args).stdin(Stdio::null()).stderr(Stdio::null()).status();
        status.is_ok_and(|status| status.success())
    }

    /// Runs `ip` with these arguments; returns whether it succeeds.
    pub fn ip(&self, args: &[&str]) -> bool {
        let status = Command::new("ip").args(args).stdin(Stdio::null()).stderr(Stdio::null()).status();
        status.is_ok_and(|status| status.success())
    }

    /// Makes every interface lose this share of arriving frames, independently, except for address resolution. Returns
    /// whether that is possible here.
    pub fn lose(&self, percent: u32) -> bool {
        self.machines.iter().all(|(name, interfaces)| {
            let mut rules = "table netdev lossy\ndelete table netdev lossy\ntable netdev lossy {\n".to_owned();
            for (interface, _) in interfaces {
                rules += &format!(
                    "chain {interface} {{ type filter hook ingress device \"{interface}\" priority 0;\n\
                     meta l4proto udp numgen random mod 100 < {percent} drop\n}}\n"
                );
            }
            rules += "}\n";
            let nft = self.command(name, "nft").args(["-f", "-"]).stdin(Stdio::piped()).stderr(Stdio::null()).spawn();
            let Ok(mut nft) = nft else { return false };
            let written = nft.stdin.take().expect("it is piped").write_all(rules.as_bytes());
            nft.wait().is_ok_and(|status| status.success()) && written.is_ok()
        })
    }
}

/// Returns a command in a namespace.
pub fn on(space: &str, program: &str) -> Command {
    let mut command = Command::new("ip");
    // The variables of the tests are not fields of a team file.
    command.args(["netns", "exec", space, program]).env_remove("MURMURATE_STOPS");
    command
}

impl Drop for Lab {
    fn drop(&mut self) {
        for name in self.machines.iter().map(|(name, _)| name).chain(&self.networks) {
            self.ip(&["netns", "del", &self.space(name)]);
        }
    }
}
