//! Shards: parts of a study's trials that run on several machines, into one folder.

use std::fmt;
use std::str::FromStr;

/// Part of a study's trials, the `number`-th of `count`, which runs on a machine of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the part, from 1.
    number: usize,
    /// Number of parts.
    count: usize,
}

impl Shard {
    /// Returns true if the trial with the index `trial` belongs to this part. Neighbouring trials, which take equally
    /// long, belong to different parts.
    pub fn has(self, trial: usize) -> bool {
        trial % self.count == self.number - 1
    }
}

impl FromStr for Shard {
    type Err = String;
    fn from_str(text: &str) -> Result<Shard, String> {
        let wrong = || format!("'{text}' is not K/N, such as 1/3 for the first of three parts");
        let (number, count) = text.split_once('/').ok_or_else(wrong)?;
        let shard = Shard { number: number.parse().map_err(|_| wrong())?, count: count.parse().map_err(|_| wrong())? };
        if (1..=shard.count).contains(&shard.number) { Ok(shard) } else { Err(wrong()) }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_trial_belongs_to_one_shard() {
        let shards: Vec<Shard> = (1..=3).map(|number| format!("{number}/3").parse().unwrap()).collect();
        assert!((0..20).all(|trial| shards.iter().filter(|shard| shard.has(trial)).count() == 1));
        assert_eq!(shards[1].to_string(), "2/3");
        for wrong in ["", "1", "0/3", "4/3", "1/0", "a/3", "1/3/5"] {
            assert!(wrong.parse::<Shard>().unwrap_err().contains("K/N"), "{wrong}");
        }
    }
}
