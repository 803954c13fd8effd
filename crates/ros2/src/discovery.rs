//! Variables by which ROS 2 is told how programs find each other, as findings of a machine whose DDS here knows none of
//! them.

use murmurate::fitness::{Finding, Fitness};

/// Returns a finding for each variable of the environment that tells ROS 2 something about discovery which the DDS of
/// this program does not do. `variable` returns the value of one that is set; `domains` are those of the host's robots.
pub fn findings(variable: &dyn Fn(&str) -> Option<String>, domains: &[u16]) -> Vec<Finding> {
    let set = |name: &str| variable(name).map(|value| value.trim().to_owned()).filter(|value| !value.is_empty());
    let mut found = Vec::new();
    let mut warn = |what: &'static str, value: &str, means: &str, advice: &str| {
        let found_text = format!("'{value}' {means}");
        found.push(Finding { fitness: Fitness::Warn, what, found: found_text, advice: advice.to_owned() });
    };
    if let Some(value) = set("ROS_DISCOVERY_SERVER") {
        let means =
            "is not asked: this program finds robots by multicast alone, and those that use a server are not found";
        warn("ROS_DISCOVERY_SERVER", &value, means, "leave it out on the robots of the team");
    }
    if let Some(value) = set("ROS_STATIC_PEERS") {
        let means = "is not used: this program asks no address, and finds robots by multicast alone";
        warn("ROS_STATIC_PEERS", &value, means, "on the robots it helps as docs/ros2.md says");
    }
    match set("ROS_AUTOMATIC_DISCOVERY_RANGE") {
        Some(value) if value != "SUBNET" && value != "SYSTEM_DEFAULT" => {
            let means = "is not obeyed: this program looks for robots on the whole subnet of its interface";
            let advice = "robots with LOCALHOST are found on their own machine alone, robots with OFF nowhere";
            warn("ROS_AUTOMATIC_DISCOVERY_RANGE", &value, means, advice);
        }
        _ => {}
    }
    if let Some(value) = set("RMW_IMPLEMENTATION").filter(|value| value.contains("zenoh")) {
        let means = "is another protocol than DDS: robots on it are not found";
        warn("RMW_IMPLEMENTATION", &value, means, "run the robots on rmw_fastrtps_cpp or rmw_cyclonedds_cpp");
    }
    if let Some(value) = set("ROS_DOMAIN_ID").filter(|value| domains.iter().any(|domain| domain.to_string() != *value))
    {
        let means = "is not used: the domain is the setting 'domain' of the driver, the source or the sense";
        warn("ROS_DOMAIN_ID", &value, means, "set 'domain' to that of the robots");
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(set: &[(&str, &str)], domains: &[u16]) -> Vec<&'static str> {
        let variable = |name: &str| set.iter().find(|(set, _)| *set == name).map(|(_, value)| (*value).to_owned());
        findings(&variable, domains).iter().map(|finding| finding.what).collect()
    }

    #[test]
    fn variables_that_are_not_obeyed_are_named_and_all_others_pass() {
        for (name, value) in [
            ("ROS_DISCOVERY_SERVER", "10.0.0.2:11811"),
            ("ROS_STATIC_PEERS", "10.0.0.3;10.0.0.4"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"),
            ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
            ("ROS_DOMAIN_ID", "7"),
        ] {
            assert_eq!(named(&[(name, value)], &[0]), [name], "{value}");
        }
        for (name, value) in [
            ("ROS_DISCOVERY_SERVER", ""),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
            ("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"),
            ("ROS_DOMAIN_ID", "0"),
            ("ROS_DISTRO", "jazzy"),
        ] {
            assert!(named(&[(name, value)], &[0]).is_empty(), "{name} {value}");
        }
    }
}
