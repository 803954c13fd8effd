//! The checks of `doctor` as a short table: one line for the checks of a link that are fine, and one for all hosts that
//! have the same problem. `--json` has each check by itself.

use super::{Check, Status};

/// Hosts, links and items that share a line.
struct Line<'a> {
    status: Status,
    hosts: Vec<&'a str>,
    links: Vec<&'a str>,
    items: Vec<&'a str>,
    found: &'a str,
    advice: &'a str,
}

/// The link that a check is about, and the item of it; no link for a check of the host itself.
fn link_and_item(what: &str) -> (Option<&str>, &str) {
    let of_link = what.strip_prefix("link ").and_then(|rest| rest.split_once(", "));
    of_link.map_or((None, what), |(link, item)| (Some(link), item))
}

fn insert<'a>(list: &mut Vec<&'a str>, entry: &'a str) {
    if !list.contains(&entry) {
        list.push(entry);
    }
}

/// The lines of a table, in the order of the checks. `hosts` are all hosts that were checked.
pub fn lines(checks: &[Check], hosts: usize) -> Vec<String> {
    let mut lines: Vec<Line> = Vec::new();
    for check in checks {
        let (link, item) = link_and_item(&check.what);
        let fine = check.status == Status::Ok && link.is_some() && !item.starts_with("host ");
        let same = |line: &&mut Line| {
            line.status == check.status
                && line.advice == check.advice
                && match link {
                    // Fine items of one link share a line, whatever was measured; problems if they are the same.
                    Some(link) if fine => line.found.is_empty() && line.links == [link],
                    Some(_) => line.found == check.found && !line.links.is_empty(),
                    None => line.found == check.found && line.items == [item],
                }
        };
        let found = if fine { "" } else { check.found.as_str() };
        let line = match lines.iter_mut().find(same) {
            Some(line) => line,
            None => {
                let (status, advice) = (check.status, check.advice.as_str());
                lines.push(Line { status, hosts: Vec::new(), links: Vec::new(), items: Vec::new(), found, advice });
                lines.last_mut().expect("it was just added")
            }
        };
        insert(&mut line.hosts, &check.host);
        insert(&mut line.items, item);
        link.into_iter().for_each(|link| insert(&mut line.links, link));
    }
    join_links(&mut lines);
    lines.iter().map(|line| line.text(hosts)).collect()
}

/// Joins the lines of links whose items are all the same and fine.
fn join_links(lines: &mut Vec<Line>) {
    let mut at = 1;
    while at < lines.len() {
        let (before, line) = (&lines[..at], &lines[at]);
        let same = |other: &Line| {
            other.found.is_empty() && line.found.is_empty() && other.items == line.items && other.status == line.status
        };
        match before.iter().position(same) {
            Some(first) if !line.links.is_empty() => {
                let line = lines.remove(at);
                line.links.into_iter().for_each(|link| insert(&mut lines[first].links, link));
                line.hosts.into_iter().for_each(|host| insert(&mut lines[first].hosts, host));
            }
            _ => at += 1,
        }
    }
}

impl Line<'_> {
    fn text(&self, hosts: usize) -> String {
        let status = match self.status {
            Status::Ok => "ok  ",
            Status::Warn => "warn",
            Status::Fail => "fail",
        };
        // What is true of every host, or of the machine, needs no names.
        let host = match &self.hosts[..] {
            all if hosts == 1 || all.len() >= hosts || all == ["here"] => String::new(),
            [host] => format!("{host}: "),
            some => format!("{}: ", some.join(", ")),
        };
        let links = match &self.links[..] {
            [] => String::new(),
            [link] => format!("link {link}: "),
            links => format!("links {}: ", links.join(", ")),
        };
        let team: Vec<&str> = self.items.iter().filter_map(|item| item.strip_prefix("host ")).collect();
        let items = match &team[..] {
            hosts if hosts.len() == self.items.len() && hosts.len() > 1 => format!("hosts {}", hosts.join(", ")),
            _ => self.items.join(", "),
        };
        let found = if self.found.is_empty() { String::new() } else { format!(": {}", self.found) };
        let advice = if self.advice.is_empty() { String::new() } else { format!(" \u{2014} {}", self.advice) };
        format!("{status} {host}{links}{items}{found}{advice}")
    }
}

/// The verdict on these lines: whether this machine can be the host, or all hosts of a team that stays on one machine.
pub fn verdict(lines: &[String], hosts: &[&str]) -> String {
    let count = |status: &str| lines.iter().filter(|line| line.starts_with(status)).count();
    let (failed, warned) = (count("fail"), count("warn"));
    let role = match hosts {
        [host] => format!("host '{host}'"),
        hosts => format!("all {} hosts of the team", hosts.len()),
    };
    let plural = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    match (failed, warned) {
        (0, 0) => format!("fit: this machine can be {role}"),
        (0, _) => format!("fit: this machine can be {role}; {} above", plural(warned, "warning")),
        _ => format!("not fit to be {role}: {} failed, {}", plural(failed, "check"), plural(warned, "warning")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(status: Status, host: &str, what: &str, found: &str) -> Check {
        let [host, what, found] = [host, what, found].map(str::to_owned);
        Check { status, host, what, found, advice: String::new() }
    }

    #[test]
    fn what_is_fine_takes_a_line_and_so_do_hosts_with_one_problem() {
        let mut checks = Vec::new();
        for host in ["a", "b"] {
            checks.push(check(Status::Warn, host, "key", "none"));
            for link in ["one", "two"] {
                checks.push(check(Status::Ok, host, &format!("link {link}, MTU"), host));
                checks.push(check(Status::Ok, host, &format!("link {link}, group"), "joined"));
            }
        }
        for link in ["one", "two"] {
            for host in ["a", "b"] {
                checks.push(check(Status::Warn, "here", &format!("link {link}, host {host}"), "not heard"));
            }
        }
        checks.push(check(Status::Fail, "b", "policy", "there is none"));
        let lines = lines(&checks, 2);
        assert_eq!(
            lines,
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
