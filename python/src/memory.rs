//! A `MemoryError` before too much is allocated, where an allocation that fails would end the process.

use std::fs::read_to_string;

use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;

/// Checks that this much memory can be had \[bytes\]. If not, it is a `MemoryError` that begins with `what`.
pub fn ensure(what: &str, needed: u64) -> PyResult<()> {
    let gib = |bytes: u64| bytes as f64 / f64::from(1 << 30);
    let refused = |why: String| PyMemoryError::new_err(format!("{what} need {:.1} GiB of memory; {why}", gib(needed)));
    if let Some(free) = available().filter(|free| needed > *free) {
        return Err(refused(format!("{:.1} GiB are free", gib(free))));
    }
    // A limit of the process (ulimit -v) or of the system's own is found by asking for it. Nothing is written to it.
    let mut probe: Vec<u8> = Vec::new();
    let asked = usize::try_from(needed).is_ok_and(|needed| probe.try_reserve_exact(needed).is_ok());
    std::hint::black_box(&mut probe);
    if asked { Ok(()) } else { Err(refused("the system does not give them".to_owned())) }
}

/// Returns how much memory this machine has free for the process \[bytes\]: that of the system, or what is left of the
/// limit of its control group, whichever is less. `None` where that is not known.
fn available() -> Option<u64> {
    let lines = read_to_string("/proc/meminfo").ok()?;
    let free = lines.lines().find_map(|line| line.strip_prefix("MemAvailable:")?.trim().strip_suffix(" kB"));
    let free = free?.parse::<u64>().ok()? * 1024;
    let number = |file: String| read_to_string(file).ok()?.trim().parse::<u64>().ok();
    let groups = read_to_string("/proc/self/cgroup").unwrap_or_default();
    let group = groups.lines().find_map(|line| line.strip_prefix("0::")).unwrap_or("/").trim_end_matches('/');
    let folder = format!("/sys/fs/cgroup{group}");
    let limit = number(format!("{folder}/memory.max")).zip(number(format!("{folder}/memory.current")));
    // What a group has in its caches is given back, so its use is no more than an estimate.
    Some(limit.map_or(free, |(most, used)| free.min(most.saturating_sub(used))))
}
