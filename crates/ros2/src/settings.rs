//! Checks and defaults of those settings in team files that the ROS 2 driver, the ROS 2 source and the observation of a
//! team in ROS 2 have in common.

use murmurate::config::ConfigError;

use super::messages::check_topic;

/// Largest DDS domain (`ROS_DOMAIN_ID`) whose UDP ports are below 65536 (RTPS 2.5, 9.6.2.3).
const MAX_DOMAIN: u16 = 232;
/// Range of the setting for the memory that a DDS process may use \[MiB\]. A running process takes 12 MiB of memory,
/// and more of address space.
const MEMORY_MIB: std::ops::RangeInclusive<u32> = 64..=4096;

/// Returns the default of the setting for the memory that a DDS process may use: 192 \[MiB\].
pub fn memory_mib() -> u32 {
    192
}

/// Returns `true`, the default of settings that are on unless the user switches them off.
pub fn yes() -> bool {
    true
}

/// Returns an error if the program was built without the feature `ros2`, so that a driver, source or sense for ROS 2 is
/// refused. `field` is that of its settings which names ROS 2.
pub fn check_built(field: &str) -> Result<(), ConfigError> {
    if super::BUILT { Ok(()) } else { Err(ConfigError::field(field, super::NOT_BUILT)) }
}

/// Checks settings of a DDS participant: its domain, network interface and memory limit \[MiB\]. The error names the
/// wrong setting.
pub fn check_participant(domain: u16, interface: Option<&str>, memory_mib: u32) -> Result<(), ConfigError> {
    if domain > MAX_DOMAIN {
        let reason = format!("{domain} is not a DDS domain; it is ROS_DOMAIN_ID of the robots, from 0 to {MAX_DOMAIN}");
        return Err(ConfigError::field("domain", reason));
    }
    if interface.is_some_and(|name| name.is_empty() || name.len() > 45) {
        let reason = "it is no interface; name one, such as \"wlan0\", or its address, or leave it out for all";
        return Err(ConfigError::field("interface", reason));
    }
    if !MEMORY_MIB.contains(&memory_mib) {
        let reason = format!("{memory_mib} is not from 64 to 4096 MiB; leave it out for {}", self::memory_mib());
        return Err(ConfigError::field("memory_mib", reason));
    }
    Ok(())
}

/// Makes the full ROS name of a topic: `topic` itself if it begins with a slash, otherwise the name within `namespace`.
/// The error names the setting `field`.
pub fn full_topic(field: &str, namespace: &str, topic: &str) -> Result<String, ConfigError> {
    let full = if topic.starts_with('/') { topic.to_owned() } else { format!("{namespace}/{topic}") };
    check_topic(&full).map_err(|why| ConfigError::field(field, format!("topic '{full}': {why}")))?;
    Ok(full)
}

/// Checks the ROS namespace of a robot, such as `/r1`. An empty one is allowed and means no namespace. The error names
/// the setting `namespace`.
pub fn check_namespace(namespace: &str) -> Result<(), ConfigError> {
    if namespace.is_empty() {
        return Ok(());
    }
    check_topic(namespace).map_err(|why| ConfigError::field("namespace", format!("'{namespace}': {why}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_no_participant_has_are_refused_by_name() {
        assert!(check_participant(0, None, 192).is_ok() && check_participant(232, Some("wlan0"), 64).is_ok());
        let wrong = |domain, interface, memory| check_participant(domain, interface, memory).unwrap_err().to_string();
        assert!(wrong(233, None, 192).starts_with("domain: "));
        assert!(wrong(0, Some(""), 192).starts_with("interface: "));
        assert!(wrong(0, None, 63).starts_with("memory_mib: "));
    }

    #[test]
    fn topics_are_within_the_namespace_unless_they_begin_with_a_slash() {
        assert_eq!(full_topic("odom", "/r1", "odom").unwrap(), "/r1/odom");
        assert_eq!(full_topic("odom", "/r1", "/tracker/r1").unwrap(), "/tracker/r1");
        assert_eq!(full_topic("odom", "", "odom").unwrap(), "/odom");
        assert!(full_topic("odom", "/r1", "").unwrap_err().to_string().starts_with("odom: topic '/r1/'"));
        assert!(check_namespace("").is_ok() && check_namespace("/r1").is_ok() && check_namespace("r1").is_err());
    }
}
