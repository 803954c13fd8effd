//! Selection of the host that judges a deployment's episodes, and of its data: true states or readings.

use super::{Deployment, Host};
use crate::messages::ids::HostId;
use crate::messages::wire::Kind;
use crate::report::episode::Judged;

impl Deployment {
    /// Source of verdicts: true states if one World simulates all robots, readings otherwise.
    pub fn judged(&self) -> Judged {
        match self.hosts.iter().any(|host| host.simulates.len() == self.robots) {
            true => Judged::Truth,
            false => Judged::Readings,
        }
    }

    /// The host that judges episodes: the one whose World simulates all robots, or else the host of the state server,
    /// which then receives all readings. The deployment must have a state server, as `check` ensures.
    pub fn judge(&self) -> HostId {
        let judges = |host: &Host| match self.judged() {
            Judged::Truth => host.simulates.len() == self.robots,
            Judged::Readings => host.state_server,
        };
        let found = self.hosts.iter().position(judges).expect("a checked deployment has a state server");
        HostId(u16::try_from(found).expect("a checked deployment has few hosts"))
    }

    /// The host that judges episodes from readings and so needs those of all robots; `None` if true states are judged.
    pub fn judge_of_readings(&self) -> Option<HostId> {
        (self.judged() == Judged::Readings).then(|| self.judge())
    }

    /// Explanation for an error, if a kind must cross hosts only for the judge; empty otherwise.
    pub(super) fn needed_by_judge(&self, kind: Kind) -> String {
        match (kind, self.judged()) {
            (Kind::Reading, Judged::Readings) => {
                let judge = &self.hosts[usize::from(self.judge().0)].name;
                format!("; host '{judge}' judges the episodes by all readings")
            }
            _ => String::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deploy::Routes;

    #[test]
    fn readings_go_to_the_host_that_judges_only_where_no_world_has_everyone() {
        let mut deployment = Deployment::preset("onboard-infra", 3).unwrap();
        let world = HostId(3);
        assert_eq!((deployment.judged(), deployment.judge()), (Judged::Truth, world));
        assert_eq!(Routes::of(&deployment).listeners(Kind::Reading), [0, 1, 2].map(HostId));
        deployment.hosts[3].simulates = vec![0];
        deployment.hosts.push(Host { name: "other".to_owned(), simulates: vec![1, 2], ..Host::default() });
        assert_eq!((deployment.judged(), deployment.judge()), (Judged::Readings, world));
        // Each World has to know where the robots of the other are.
        assert_eq!(Routes::of(&deployment).listeners(Kind::Reading), [0, 1, 2, 3, 4].map(HostId));
        deployment.links[0].carries.retain(|kind| *kind != Kind::Reading);
        let refused = deployment.check().unwrap_err().to_string();
        assert!(refused.starts_with("link.carries: Reading") && refused.contains("'world' judges"), "{refused}");
    }
}
