//! Check whether a record can be replayed: by its state, by the process that made it, and by its completeness.

use murmurate_record::health::Health;
use murmurate_record::identity::Identity;

/// Kind of records that are to be replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wanted {
    /// Records of hosts and of simulations.
    #[default]
    All,
    /// Records of hosts alone.
    Hosts,
    /// Records of simulations alone.
    Simulations,
}

/// Reason why a record cannot be replayed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Unfit {
    /// Attached files that the replay needs may be lost to damage; the text says where it is.
    LosesFiles(String),
    /// It has the messages that an operator received, and nothing that could run again.
    OfOperator,
    /// It was made of the files of another program, and has nothing that could run again.
    Imported,
    /// It is of a host, and only simulations are wanted.
    OfHost,
    /// It is of a simulation, and only hosts are wanted.
    OfSimulation,
    /// It has only the seconds around triggers, and a replay needs a run from its beginning.
    Excerpt,
    /// It goes on from another file of its record.
    FurtherPart,
}

/// Fails if a record cannot be replayed, or is not of what is wanted.
pub fn check(identity: &Identity, health: &Health, wanted: Wanted) -> Result<(), Unfit> {
    let of_host = identity.host.is_some();
    let why = if health.loses_files {
        Unfit::LosesFiles(health.lines(identity.anchor_ns).join("; "))
    } else if identity.operator {
        Unfit::OfOperator
    } else if identity.imported {
        Unfit::Imported
    } else if wanted == Wanted::Simulations && of_host {
        Unfit::OfHost
    } else if wanted == Wanted::Hosts && !of_host {
        Unfit::OfSimulation
    } else if identity.excerpt {
        Unfit::Excerpt
    } else if identity.part > 0 {
        Unfit::FurtherPart
    } else {
        return Ok(());
    };
    Err(why)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_runs_of_what_is_wanted_are_replayed() {
        let simulation = Identity::here("1f", Vec::new(), "");
        let health = Health::default();
        for (wanted, expected) in
            [(Wanted::All, Ok(())), (Wanted::Simulations, Ok(())), (Wanted::Hosts, Err(Unfit::OfSimulation))]
        {
            assert_eq!(check(&simulation, &health, wanted), expected);
        }
        let of = |change: fn(&mut Identity)| {
            let mut identity = simulation.clone();
            change(&mut identity);
            check(&identity, &health, Wanted::All)
        };
        assert_eq!(of(|identity| identity.operator = true), Err(Unfit::OfOperator));
        assert_eq!(of(|identity| identity.imported = true), Err(Unfit::Imported));
        assert_eq!(of(|identity| identity.excerpt = true), Err(Unfit::Excerpt));
        assert_eq!(of(|identity| identity.part = 2), Err(Unfit::FurtherPart));
        let mut damaged = health.clone();
        damaged.loses_files = true;
        assert!(matches!(check(&simulation, &damaged, Wanted::All), Err(Unfit::LosesFiles(_))));
    }
}
