//! Network namespaces of stations, with the TAP interface in each.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;
use nix::poll::{PollTimeout, poll};
use nix::sched::{CloneFlags, setns};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tappers::{Interface, Tap};

use super::error::{Context, LabError, Result, failed};
use super::needs;
use crate::ethernet;
use crate::file::{CABLE, Laboratory};

/// Longest time for the programs of a laboratory to end after they were asked to.
const GRACE: Duration = Duration::from_secs(1);
/// Longest time for the cable's carrier to be reported.
const CARRIER: Duration = Duration::from_secs(5);
/// Folder in which `ip` keeps the names of network namespaces.
const FOLDER: &str = "/run/netns";

/// Returns whether there is a network namespace with this name.
pub fn exists(name: &str) -> bool {
    Path::new(FOLDER).join(name).exists()
}

/// Runs `ip` with these arguments, and with `lines` as its input.
fn ip(args: &[&str], lines: &str) -> Result<String> {
    let mut command = Command::new("ip");
    command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().context("cannot start 'ip' (package iproute2)")?;
    child.stdin.take().expect("it is piped").write_all(lines.as_bytes()).context("'ip' reads no commands")?;
    let output = child.wait_with_output().context("cannot wait for 'ip'")?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let why = String::from_utf8_lossy(&output.stderr).trim().replace('\n', "; ");
    failed(format!("'ip {}' has failed: {why}", args.join(" ")))
}

/// Returns a command that runs the words added to it in a network namespace.
pub fn command(name: &str) -> Command {
    let mut command = Command::new("ip");
    command.args(["netns", "exec", name]);
    command
}

/// Makes a network namespace.
pub fn add(name: &str) -> Result<()> {
    ip(&["netns", "add", name], "").map(drop)
}

/// Removes those of these network namespaces that exist, after the processes in them were asked to end; those that do
/// not end within [`GRACE`] are killed. Interfaces in a namespace vanish with it.
pub fn remove(names: &[String]) -> Result<()> {
    let there: Vec<&String> = names.iter().filter(|name| exists(name)).collect();
    let running = || there.iter().map(|name| processes(name)).collect::<Result<Vec<_>>>().map(|all| all.concat());
    let signal_all = |signal| -> Result<bool> {
        let all = running()?;
        for pid in &all {
            // One that has ended meanwhile is what is wanted.
            let _ = kill(*pid, signal);
        }
        Ok(!all.is_empty())
    };
    if signal_all(Signal::SIGTERM)? {
        let began = Instant::now();
        while began.elapsed() < GRACE && !running()?.is_empty() {
            // It ends with a timeout, or a signal.
            let _ = poll(&mut [], PollTimeout::from(20u16));
        }
        signal_all(Signal::SIGKILL)?;
    }
    there.iter().try_for_each(|name| ip(&["netns", "del", name], "").map(drop))
}

/// Returns the processes that run in a network namespace, without this one.
fn processes(name: &str) -> Result<Vec<Pid>> {
    let text = ip(&["netns", "pids", name], "")?;
    let own = Pid::this();
    Ok(text.lines().filter_map(|line| line.trim().parse().ok()).map(Pid::from_raw).filter(|pid| *pid != own).collect())
}

/// Calls `work` on a thread of its own within a network namespace, and returns its result. Sockets and interfaces that
/// it opens belong to that namespace.
pub fn inside<T: Send, E: From<LabError> + Send>(
    name: &str,
    work: impl FnOnce() -> Result<T, E> + Send,
) -> Result<T, E> {
    let space = needs::open(&format!("{FOLDER}/{name}"))?;
    let enter = || {
        setns(space, CloneFlags::CLONE_NEWNET).with_context(|| format!("cannot enter the namespace '{name}'"))?;
        work()
    };
    thread::scope(|scope| scope.spawn(enter).join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
}

/// Switches IPv6 off in the namespace of this process, unless the laboratory has it. It speaks on the channel by
/// itself: router solicitations, and reports of multicast groups. With it, addresses hold at once: a check for
/// duplicates would go over a channel that loses frames.
fn set_ipv6(lab: &Laboratory, space: &str) -> Result<()> {
    let of = |scope: &str, name: &str, value: &str| {
        let set = std::fs::write(format!("/proc/sys/net/ipv6/conf/{scope}/{name}"), value);
        match set {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound && !lab.ipv6 => Ok(()),
            Err(error) => failed(format!("cannot set {name} of IPv6 in the namespace '{space}': {error}")),
            Ok(()) => Ok(()),
        }
    };
    if lab.ipv6 {
        return of("default", "accept_dad", "0");
    }
    of("all", "disable_ipv6", "1")
}

/// Makes a station in its namespace, which exists already: a TAP interface with address and routes, and the loopback
/// interface. Returns the TAP, which does not block. The interface vanishes with it.
pub fn make_station(lab: &Laboratory, station: u16) -> Result<Tap> {
    let space = lab.namespace(station);
    let tap = inside(&space, || {
        set_ipv6(lab, &space)?;
        let name = Interface::new(&lab.interface).context("not an interface's name")?;
        let mut tap = Tap::new_named(name).context("cannot make a TAP interface")?;
        tap.set_nonblocking(true).context("cannot make a TAP interface non-blocking")?;
        Ok(tap)
    })?;
    let (interface, address) = (&lab.interface, lab.address(station));
    let mac = ethernet::text(ethernet::station(station));
    let mut lines = format!(
        "link set lo up\nlink set dev {interface} address {mac}\naddr add {address}/24 dev {interface}\n\
         link set {interface} up\nroute add 224.0.0.0/4 dev {interface}\n"
    );
    if lab.static_arp {
        for other in (0..lab.stations).filter(|other| *other != station) {
            let (address, mac) = (lab.address(other), ethernet::text(ethernet::station(other)));
            lines += &format!("neigh add {address} lladdr {mac} dev {interface} nud permanent\n");
        }
    }
    ip(&["-n", &space, "-batch", "-"], &lines)?;
    Ok(tap)
}

/// Makes the cable between all stations: a bridge in a namespace of its own, with a port to each station.
pub fn make_cable(lab: &Laboratory) -> Result<()> {
    let hub = lab.cable_namespace();
    // Without snooping, multicast frames go to every port.
    let mut lines = "link add bridge type bridge mcast_snooping 0\nlink set bridge up\n".to_owned();
    for station in 0..lab.stations {
        let space = lab.namespace(station);
        lines += &format!("link add port{station} type veth peer name {CABLE} netns {space}\n");
        lines += &format!("link set port{station} master bridge up\n");
    }
    ip(&["-n", &hub, "-batch", "-"], &lines)?;
    for station in 0..lab.stations {
        let address = lab.cable_address(station).expect("there is a cable");
        let lines = format!("addr add {address}/24 dev {CABLE}\nlink set {CABLE} up\n");
        ip(&["-n", &lab.namespace(station), "-batch", "-"], &lines)?;
    }
    (0..lab.stations).try_for_each(|station| inside(&lab.namespace(station), wait_for_cable))
}

/// Waits until the cable's interface has its carrier, which the kernel reports up to a second late. Before, a program
/// would take it for one that is down.
fn wait_for_cable() -> Result<()> {
    let began = Instant::now();
    while began.elapsed() < CARRIER {
        let mut all = getifaddrs().context("cannot list the interfaces of a station")?;
        if all.any(|one| one.interface_name == CABLE && one.flags.contains(InterfaceFlags::IFF_RUNNING)) {
            return Ok(());
        }
        // It ends with a timeout, or a signal.
        let _ = poll(&mut [], PollTimeout::from(20u16));
    }
    failed(format!("the cable of a station has no carrier after {} s", CARRIER.as_secs()))
}
