//! The checks as a short table: one line for all checks of a link without defects, and one for all hosts
//! that have the same problem. `--json` lists each check.

use super::finding::{Check, Subject};
use murmurate::config::shown::{self, counted};
use murmurate::fitness::Fitness;

/// Line of the table that `doctor` prints: one check, or several with the same result that differ in their host, their
/// link or the property that was checked.
pub struct Line<'a> {
    status: Fitness,
    /// Hosts that were checked.
    hosts: Vec<&'a str>,
    links: Vec<&'a str>,
    /// Names of what was checked: of things such as `key`, of properties of a link such as its MTU, or of the hosts
    /// that were heard on a link.
    items: Vec<&'a str>,
    peers: bool,
    /// Text that says what the checks observed; `None` for properties of links without defects.
    found: Option<&'a str>,
    advice: &'a str,
}

fn insert<'a>(list: &mut Vec<&'a str>, entries: &[&'a str]) {
    for entry in entries {
        if !list.contains(entry) {
            list.push(entry);
        }
    }
}

impl<'a> Line<'a> {
    fn of(check: &'a Check) -> Line<'a> {
        let Check { status, host, what, found, advice } = check;
        let (links, item, peers) = match what {
            Subject::General(item) => (Vec::new(), item, false),
            Subject::Link { link, item } => (vec![&**link], item, false),
            Subject::Peer { link, host } => (vec![&**link], host, true),
        };
        let fine = *status == Fitness::Ok && matches!(what, Subject::Link { .. });
        let found = (!fine).then_some(&**found);
        Line { status: *status, hosts: vec![host], links, items: vec![item], peers, found, advice }
    }

    /// Returns true if another line has the same severity, observation and advice, and is about the same kind of thing
    /// (a heard host or not).
    fn is_like(&self, other: &Line) -> bool {
        (self.status, self.found, self.advice, self.peers) == (other.status, other.found, other.advice, other.peers)
    }

    fn join(&mut self, other: &Line<'a>) {
        insert(&mut self.hosts, &other.hosts);
        insert(&mut self.links, &other.links);
        insert(&mut self.items, &other.items);
    }

    /// Returns the text of the line, for a table about `hosts` hosts. A line about all of these hosts, or about the
    /// machine, names no host.
    pub fn text(&self, hosts: usize) -> String {
        let status = match self.status {
            Fitness::Ok => "ok  ",
            Fitness::Warn => "warn",
            Fitness::Fail => "fail",
        };
        // Findings about every host, or about the machine, name no host.
        let host = match &self.hosts[..] {
            all if hosts == 1 || all.len() >= hosts || all == ["here"] => String::new(),
            some => format!("{}: ", some.join(", ")),
        };
        let links = match &self.links[..] {
            [] => String::new(),
            [link] => format!("link {link}: "),
            links => format!("links {}: ", links.join(", ")),
        };
        let noun = match (self.peers, self.items.len()) {
            (false, _) => "",
            (true, 1) => "host ",
            (true, _) => "hosts ",
        };
        let found = self.found.map_or(String::new(), |found| format!(": {found}"));
        let advice = if self.advice.is_empty() { String::new() } else { format!(" \u{2014} {}", self.advice) };
        shown::value(format!("{status} {host}{links}{noun}{}{found}{advice}", self.items.join(", ")))
    }
}

/// Returns the lines of the table of `doctor`, in the order of the checks. Checks that differ only in their property,
/// their link or their host are merged into one line.
pub fn lines(checks: &[Check]) -> Vec<Line<'_>> {
    let by_link = gather(checks.iter().map(Line::of), |line, other| {
        line.is_like(other) && line.links == other.links && (!line.links.is_empty() || line.items == other.items)
    });
    gather(by_link.into_iter(), |line, other| line.is_like(other) && line.items == other.items)
}

/// Merges each line into the first earlier one for which `joins` returns `true`.
fn gather<'a>(all: impl Iterator<Item = Line<'a>>, joins: impl Fn(&Line, &Line) -> bool) -> Vec<Line<'a>> {
    let mut lines: Vec<Line> = Vec::new();
    for line in all {
        match lines.iter_mut().find(|other| joins(&line, other)) {
            Some(other) => other.join(&line),
            None => lines.push(line),
        }
    }
    lines
}

/// Returns the last line of the output of `doctor`. It says whether this machine can be the hosts named in `hosts`, one
/// or all of a team, and how many checks failed or gave a warning.
pub fn verdict(lines: &[Line], hosts: &[&str]) -> String {
    let count = |status| lines.iter().filter(|line| line.status == status).count();
    let (failed, warned) = (count(Fitness::Fail), count(Fitness::Warn));
    let role = match hosts {
        [host] => format!("host '{host}'"),
        hosts => format!("all {} hosts of the team", hosts.len()),
    };
    match (failed, warned) {
        (0, 0) => format!("fit: this machine can be {role}"),
        (0, _) => format!("fit: this machine can be {role}; {} above", counted(warned, "warning")),
        _ => format!("not fit to be {role}: {} failed, {}", counted(failed, "check"), counted(warned, "warning")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(status: Fitness, host: &str, what: Subject, found: &str) -> Check {
        Check { status, host: host.to_owned(), what, found: found.to_owned(), advice: String::new() }
    }

    fn item(link: &str, item: &str) -> Subject {
        Subject::Link { link: link.to_owned(), item: item.to_owned() }
    }

    #[test]
    fn what_is_fine_takes_a_line_and_so_do_hosts_with_one_problem() {
        let mut checks = Vec::new();
        for host in ["a", "b"] {
            checks.push(check(Fitness::Warn, host, Subject::General("key".to_owned()), "none"));
            for link in ["one", "two"] {
                checks.push(check(Fitness::Ok, host, item(link, "MTU"), host));
                checks.push(check(Fitness::Ok, host, item(link, "group"), "joined"));
            }
        }
        for link in ["one", "two"] {
            for host in ["a", "b"] {
                checks.push(check(
                    Fitness::Warn,
                    "here",
                    Subject::Peer { link: link.to_owned(), host: host.to_owned() },
                    "not heard",
                ));
            }
        }
        checks.push(check(Fitness::Fail, "b", Subject::General("policy".to_owned()), "there is none"));
        let lines = lines(&checks);
        assert_eq!(
            lines.iter().map(|line| line.text(2)).collect::<Vec<_>>(),
            [
                "warn key: none",
                "ok   links one, two: MTU, group",
                "warn links one, two: hosts a, b: not heard",
                "fail b: policy: there is none",
            ]
        );
        assert_eq!(verdict(&lines, &["a", "b"]), "not fit to be all 2 hosts of the team: 1 check failed, 2 warnings");
        assert_eq!(verdict(&lines[1..2], &["a"]), "fit: this machine can be host 'a'");
    }
}
