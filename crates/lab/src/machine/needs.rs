//! Requirements of a laboratory on the machine, checked before anything is made.

use std::fs::{File, OpenOptions};
use std::io::ErrorKind;
use std::process::{Command, Stdio};

use super::error::{Context, LabError, Result, failed};

/// Device of which TAP interfaces are made.
const TUN: &str = "/dev/net/tun";
/// Capabilities that namespaces and interfaces need: name, and number in `linux/capability.h`.
const CAPABILITIES: [(&str, u32); 2] = [("CAP_NET_ADMIN", 12), ("CAP_SYS_ADMIN", 21)];

/// Fails, naming what is missing, if this process may not make network namespaces and TAP interfaces.
pub fn check() -> Result<()> {
    capabilities()?;
    let found = Command::new("ip").arg("-V").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if found.is_err() {
        return failed("a lab needs the program 'ip': install the package iproute2".to_owned());
    }
    match OpenOptions::new().read(true).write(true).open(TUN) {
        Ok(_) => Ok(()),
        Err(error) if error.kind() == ErrorKind::NotFound => Err(LabError::Failed(format!(
            "there is no {TUN}, of which TAP interfaces are made: load the module with 'modprobe tun'; give a \
             container the device with '--device {TUN}'"
        ))),
        Err(error) => failed(format!(
            "{TUN} cannot be opened ({error}): the kernel has no TUN/TAP driver, or a container is not given the device"
        )),
    }
}

/// Fails, naming the missing ones, if this process lacks a capability that a lab needs.
pub fn capabilities() -> Result<()> {
    let status = std::fs::read_to_string("/proc/self/status").context("cannot read /proc/self/status")?;
    let missing = missing(&status);
    if missing.is_empty() {
        return Ok(());
    }
    failed(format!(
        "a lab makes network namespaces and TAP interfaces, for which this process lacks {}: run it as root ('sudo')",
        missing.join(" and ")
    ))
}

/// Returns the needed capabilities that a process with this content of `/proc/self/status` lacks.
fn missing(status: &str) -> Vec<&'static str> {
    let line = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let effective = line.and_then(|digits| u64::from_str_radix(digits.trim(), 16).ok()).unwrap_or(0);
    CAPABILITIES.iter().filter(|(_, bit)| effective >> bit & 1 == 0).map(|(name, _)| *name).collect()
}

/// Opens a file of the machine's, for a namespace or a device.
pub(super) fn open(path: &str) -> Result<File> {
    File::open(path).with_context(|| format!("cannot open '{path}'"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_capabilities_are_named() {
        assert_eq!(missing("Name:\tx\nCapEff:\t000001ffffffffff\n"), Vec::<&str>::new());
        assert_eq!(missing("CapEff:\t0000000000000000\n"), ["CAP_NET_ADMIN", "CAP_SYS_ADMIN"]);
        assert_eq!(missing("CapEff:\t0000000000001000\n"), ["CAP_SYS_ADMIN"]);
    }
}
