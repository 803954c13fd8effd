//! Selection of the host that judges episodes, and whether it judges true states or readings.

use super::{Deployment, Host};
use crate::messages::ids::HostId;
use crate::messages::wire::Kind;
use crate::results::episode::Judged;

impl Deployment {
    /// Returns the kind of data from which episodes are judged: true states if one World has all robots of the team,
    /// otherwise readings.
    pub fn judged(&self) -> Judged {
        match self.hosts.iter().any(|host| host.simulates.len() == self.robots) {
            true => Judged::Truth,
            false => Judged::Readings,
        }
    }

    /// Returns the host that judges episodes: the one whose World simulates all robots, or else that of the state
    /// server, which then receives all readings. Panics without a state server, which [`Deployment::check`] excludes.
    pub fn judge(&self) -> HostId {
        let judges = |host: &Host| match self.judged() {
            Judged::Truth => host.simulates.len() == self.robots,
            Judged::Readings => host.state_server,
        };
        let found = self.hosts.iter().position(judges).expect("a checked deployment has a state server");
        HostId(u16::try_from(found).expect("a checked deployment has few hosts"))
    }

    /// Returns the host that judges episodes from readings, and so receives those of all robots; `None` if true states
    /// are judged.
    pub(crate) fn judge_of_readings(&self) -> Option<HostId> {
        (self.judged() == Judged::Readings).then(|| self.judge())
    }

    /// Returns a text to append to the error that no link carries messages of the kind `kind`: it says that the judging
    /// host needs all readings. The text is empty unless `kind` is readings and episodes are judged from them.
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
        // Each World needs the positions of the robots that the other one simulates.
        assert_eq!(Routes::of(&deployment).listeners(Kind::Reading), [0, 1, 2, 3, 4].map(HostId));
        deployment.links[0].carries.retain(|kind| *kind != Kind::Reading);
        let refused = deployment.check().unwrap_err().to_string();
        assert!(refused.starts_with("link.carries: Reading") && refused.contains("'world' judges"), "{refused}");
    }
}
