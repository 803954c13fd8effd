//! Checks whether this machine is a container or WSL2, whose own networks multicast does not leave.

use std::path::Path;

use murmurate::fitness::{Finding, Fitness};

/// Signs that this machine is a container or WSL2.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Signs {
    /// File that a container runtime has left, if there is one.
    pub file: Option<&'static str>,
    /// Control groups of the first process; empty if they cannot be read.
    pub cgroup: String,
    /// Version of the kernel, as in `/proc/version`.
    pub kernel: String,
    /// Whether an interface `loopback0` is there, which WSL2 adds in mirrored mode.
    pub loopback0: bool,
}

/// Kind of network that the machine may be in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// A container, known by the named sign.
    Container(&'static str),
    /// WSL2, in mirrored mode or not.
    Wsl { mirrored: bool },
}

impl Signs {
    /// Reads the signs below `root`, which is `/` outside of tests.
    pub fn read(root: &Path) -> Signs {
        let text = |path: &str| std::fs::read_to_string(root.join(path)).unwrap_or_default();
        // Docker's, and that of Podman and Buildah.
        let known = ["/.dockerenv", "/run/.containerenv"];
        Signs {
            file: known.into_iter().find(|path| root.join(&path[1..]).exists()),
            cgroup: text("proc/1/cgroup"),
            kernel: text("proc/version"),
            loopback0: root.join("sys/class/net/loopback0").exists(),
        }
    }

    fn place(&self) -> Option<Place> {
        let words = ["docker", "containerd", "kubepods", "libpod", "/lxc"];
        let grouped = words.iter().any(|word| self.cgroup.contains(word));
        if let Some(sign) = self.file.or(grouped.then_some("/proc/1/cgroup")) {
            return Some(Place::Container(sign));
        }
        self.kernel.to_lowercase().contains("microsoft").then_some(Place::Wsl { mirrored: self.loopback0 })
    }
}

/// Returns what the place of the machine means for multicast on the interface `interface`; `None` outside of containers
/// and WSL2. `paired` says whether the interface is the end of a pair whose other end is elsewhere, as in a container
/// with a network of its own.
pub fn finding(signs: &Signs, interface: &str, paired: bool) -> Option<Finding> {
    let warn = |found: String, advice: &str| Finding {
        fitness: Fitness::Warn,
        what: "container",
        found,
        advice: advice.to_owned(),
    };
    Some(match signs.place()? {
        Place::Container(sign) if paired => warn(
            format!(
                "in a container ({sign}), and '{interface}' is one end of a pair: multicast stays behind its bridge"
            ),
            "start it with --network host, or give the link peers instead of a group",
        ),
        Place::Container(sign) => {
            Finding::ok("container", format!("in a container ({sign}), with '{interface}' of the machine itself"))
        }
        Place::Wsl { mirrored: false } => warn(
            format!("in WSL2, and '{interface}' is behind its address translation, which multicast does not pass"),
            "write networkingMode=mirrored below [wsl2] in .wslconfig, or give the link peers instead of a group",
        ),
        Place::Wsl { mirrored: true } => warn(
            format!("in WSL2 with '{interface}' mirrored: multicast is reported to arrive on some machines alone"),
            "see below whether others are heard; if not, give the link peers instead of a group",
        ),
    })
}

/// Returns whether an interface is the end of a pair whose other end is elsewhere: its link has another index than it
/// has. `None` if there is no such interface.
pub fn is_paired(interface: &str) -> Option<bool> {
    let folder = Path::new("/sys/class/net").join(interface);
    let number = |name| std::fs::read_to_string(folder.join(name)).ok().map(|text| text.trim().to_owned());
    Some(number("iflink")? != number("ifindex")?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn docker() -> Signs {
        Signs { file: Some("/.dockerenv"), ..Signs::default() }
    }

    #[test]
    fn an_ordinary_machine_has_no_finding() {
        let signs =
            Signs { cgroup: "0::/init.scope".to_owned(), kernel: "Linux version 6.1 (gcc)".to_owned(), ..docker() };
        assert_eq!(finding(&Signs { file: None, ..signs }, "eth0", true), None);
    }

    #[test]
    fn a_container_with_a_network_of_its_own_is_warned_of() {
        let found = finding(&docker(), "eth0", true).expect("a finding");
        assert_eq!(found.fitness, Fitness::Warn);
        assert!(found.found.contains("/.dockerenv") && found.advice.contains("--network host"), "{found:?}");
    }

    #[test]
    fn a_container_with_the_network_of_the_machine_is_fit() {
        let found = finding(&docker(), "wlan0", false).expect("a finding");
        assert_eq!(found.fitness, Fitness::Ok);
    }

    #[test]
    fn control_groups_of_a_runtime_are_those_of_a_container() {
        for group in ["0::/kubepods/besteffort/pod1", "12:cpu:/docker/0123", "0::/../libpod-5e.scope"] {
            let signs = Signs { cgroup: group.to_owned(), ..Signs::default() };
            assert!(finding(&signs, "eth0", true).is_some(), "{group}");
        }
    }

    #[test]
    fn wsl2_is_known_by_its_kernel_and_its_mode_by_loopback0() {
        let nat = Signs { kernel: "Linux version 5.15.153.1-microsoft-standard-WSL2".to_owned(), ..Signs::default() };
        let found = finding(&nat, "eth0", false).expect("a finding");
        assert!(found.advice.contains("networkingMode=mirrored"), "{found:?}");
        let found = finding(&Signs { loopback0: true, ..nat }, "eth0", false).expect("a finding");
        assert!(found.found.contains("mirrored") && found.fitness == Fitness::Warn, "{found:?}");
    }

    #[test]
    fn signs_are_read_below_a_root() {
        let root = tempfile::tempdir().expect("a folder");
        assert_eq!(Signs::read(root.path()), Signs::default());
        std::fs::create_dir_all(root.path().join("run")).expect("a folder");
        std::fs::write(root.path().join("run/.containerenv"), "").expect("a file");
        assert_eq!(Signs::read(root.path()).file, Some("/run/.containerenv"));
    }
}
