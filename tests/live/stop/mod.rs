//! The emergency stop: `stop`, `stop --rearm` and `resume` against teams of real processes. Each host has a network
//! namespace, frames are lost, and the operator's machine has only the link of the stop. Also with malicious members,
//! relays that delay commands, and wrong clocks.
//!
//! `MURMURATE_STOPS=20` stops each team 20 times; 'just full-stop' includes the long tests.

mod members;
mod relay;
mod team;

use crate::alone;
use crate::crew::report;
use crate::program::skip::skip;
use team::{CONFIRMED_S, Case, STANDS, Stopped, WORST_S};

/// Whether the long tests run; prints a notice if not.
fn in_full(what: &str) -> bool {
    let full = std::env::var_os("MURMURATE_STOPS").is_some();
    if !full {
        skip("long", &format!("{what}, which 'just full-stop' runs"));
    }
    full
}

fn stops() -> usize {
    std::env::var("MURMURATE_STOPS").map_or(2, |often| often.parse().expect("MURMURATE_STOPS is a number"))
}

/// Stops a team many times; returns the number of stops and of late ones.
fn stops_in_time(case: &Case) -> Option<(usize, usize)> {
    let _alone = alone();
    let mut team = case.start()?;
    let all: Vec<Stopped> = (0..stops()).map(|number| team.cycle(number)).collect();
    let is_late =
        |stop: &Stopped| stop.stood > STANDS + stop.machine || stop.took_s > CONFIRMED_S + stop.machine.as_secs_f64();
    let late = all.iter().filter(|stop| is_late(stop)).count();
    let worst_s = all.iter().map(|stopped| stopped.took_s).fold(0.0, f64::max);
    let machine = all.iter().map(|stopped| stopped.machine).max().unwrap_or_default();
    let stood = all.iter().map(|stopped| stopped.stood).max().unwrap_or_default();
    report(&format!(
        "{} {}: {} stops, {late} late; motors stood after {stood:.0?} at most, confirmed after {worst_s:.3} s at most; \
         of these up to {machine:.0?} are the machine's",
        case.file,
        if case.unicast { "unicast" } else { "as it is" },
        all.len()
    ));
    assert!(worst_s <= WORST_S + machine.as_secs_f64(), "a stop took {worst_s} s, up to {machine:?} by the machine");
    Some((all.len(), late))
}

#[test]
fn a_stop_of_the_onboard_team_on_its_own_radios_is_confirmed_and_holds_until_a_resume() {
    let Some((_, late)) =
        stops_in_time(&Case { mode: "onboard-adhoc", file: "onboard-wlan", unicast: false, relayed: false })
    else {
        return;
    };
    assert_eq!(late, 0);
}

#[test]
fn a_stop_of_the_centralized_team_with_unicast_links_is_confirmed_and_holds_until_a_resume() {
    let Some((_, late)) =
        stops_in_time(&Case { mode: "centralized", file: "centralized", unicast: true, relayed: false })
    else {
        return;
    };
    assert_eq!(late, 0);
}

#[test]
fn a_stop_of_every_team_file_is_confirmed_and_holds_until_a_resume() {
    if !in_full("ten teams") {
        return;
    }
    let files = [
        ("centralized", "centralized"),
        ("offboard", "offboard"),
        ("onboard-adhoc", "onboard-adhoc"),
        ("onboard-infra", "onboard-infra"),
        ("onboard-adhoc", "onboard-wlan"),
    ];
    let (mut all, mut late) = (0, 0);
    for (mode, file) in files {
        for unicast in [false, true] {
            let Some(done) = stops_in_time(&Case { mode, file, unicast, relayed: false }) else { return };
            (all, late) = (all + done.0, late + done.1);
        }
    }
    report(&format!("{late} of {all} stops were late"));
    // Of 200 stops 198 must be in time.
    assert!(late * 100 <= all, "{late} of {all} stops were late");
}
