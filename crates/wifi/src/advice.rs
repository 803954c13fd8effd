//! Faults of a Wi-Fi card for a link, each with the command that mends it.
//!
//! Sources of the rules: `net/wireless/nl80211.c` (`nl80211_set_mcast_rate`: for IBSS, mesh point and OCB alone),
//! `net/mac80211/ibss.c` (long slots in each IBSS at 2.4 GHz), hostapd's `hostapd.conf`, and the threads that
//! `docs/wifi.md` names.

use murmurate::deploy::LinkMedium;
use murmurate::fitness::{Finding, Fitness};

use crate::card::{Card, Mode, Peer};

/// Share of the time from which on a busy channel is warned of: multicast collides often then, and unicast waits.
const BUSY: f64 = 0.6;
/// Share of retries from which on a peer is warned of, and number of frames from which on it is judged.
const RETRIES: f64 = 0.3;
const FRAMES: u32 = 100;
/// Power below which a peer is warned of \[dBm\]: 54 Mbit/s needs some -70, and a body between costs 10 dB.
const WEAK_DBM: i8 = -75;
/// Time after which a peer that was not heard is not counted \[ms\].
const SILENT_MS: u32 = 10_000;

/// Returns what is found of the card of `interface` for a link over `medium`, first what matters most.
pub fn findings(card: &Card, interface: &str, medium: LinkMedium) -> Vec<Finding> {
    let mut all = vec![mode(card, interface, medium)];
    all.extend(power_save(card, interface));
    all.extend(country(card));
    all.extend(multicast(card, interface));
    all.extend(card.load.and_then(|load| load.share()).map(busy));
    all.push(peers(card));
    all
}

fn warn(what: &'static str, found: String, advice: String) -> Finding {
    Finding { fitness: Fitness::Warn, what, found, advice }
}

/// Returns the mode of the interface, and whether it suits the link.
fn mode(card: &Card, interface: &str, medium: LinkMedium) -> Finding {
    let network = card.network.as_ref().map_or(String::new(), |name| format!(" of '{name}'"));
    let at = card.frequency_mhz.map_or(", on no channel".to_owned(), |mhz| format!(" at {mhz} MHz"));
    let found = format!("{}{network}{at}", card.mode);
    if medium != LinkMedium::AdHoc {
        let advice = "connect it (nmcli device wifi connect NAME, or wpa_supplicant)".to_owned();
        return match card.frequency_mhz {
            Some(_) => Finding::ok("Wi-Fi", found),
            None => warn("Wi-Fi", found, advice),
        };
    }
    let is_direct = [Mode::AdHoc, Mode::MeshPoint, Mode::Outside].contains(&card.mode);
    if is_direct && card.frequency_mhz.is_some() {
        return Finding::ok("Wi-Fi", found);
    }
    let why = match card.mode {
        _ if is_direct => "it is in no network",
        Mode::Station if card.frequency_mhz.is_some() => "frames go through an access point",
        _ => "robots do not hear each other in this mode",
    };
    let direct = [Mode::AdHoc, Mode::MeshPoint].into_iter().find(|mode| card.modes.contains(mode));
    let (why, advice) = match direct {
        Some(mode) if is_direct || card.has_beside(mode, Mode::Station) => (why, joins(mode, interface)),
        // Seen on a Raspberry Pi: raspberrypi/firmware#990.
        Some(mode) => (why, format!("end wpa_supplicant (or give it p2p_disabled=1), then {}", joins(mode, interface))),
        None => ("the card knows neither IBSS nor mesh points", "use a card with ath9k, ath10k or mt76".to_owned()),
    };
    warn("Wi-Fi", format!("{found}: {why}"), advice)
}

/// Returns the command by which an interface joins a network in which robots hear each other.
fn joins(mode: Mode, interface: &str) -> String {
    let (of, join) = if mode == Mode::MeshPoint {
        ("mp", "mesh join NAME freq 2412")
    } else {
        ("ibss", "ibss join NAME 2412 HT20 fixed-freq basic-rates 6,12,24 mcast-rate 24")
    };
    format!(
        "ip link set {interface} down && iw dev {interface} set type {of} && ip link set {interface} up && iw dev \
         {interface} {join}"
    )
}

fn power_save(card: &Card, interface: &str) -> Option<Finding> {
    Some(match card.power_save? {
        false => Finding::ok("power saving", "off".to_owned()),
        true => warn(
            "power saving",
            "on: frames wait until the card wakes".to_owned(),
            format!("iw dev {interface} set power_save off"),
        ),
    })
}

/// Returns the country whose rules hold, and warns if none is set.
fn country(card: &Card) -> Option<Finding> {
    let letters = card.country.as_deref()?;
    Some(match letters {
        "00" => warn(
            "country",
            "none is set: channels at 5 GHz are for listening alone".to_owned(),
            "iw reg set DE, with the letters of yours; for good raspi-config, or cfg80211.ieee80211_regdom=DE"
                .to_owned(),
        ),
        _ => Finding::ok("country", letters.to_owned()),
    })
}

/// Returns what is known of the rate of multicast, which can be set and not be read.
fn multicast(card: &Card, interface: &str) -> Option<Finding> {
    let (found, advice) = match card.mode {
        Mode::AdHoc if card.is_low_band() => (
            "an IBSS at 2.4 GHz: 1 Mbit/s unless it was joined with another rate, and slots of 20 us",
            format!("iw dev {interface} set mcast_rate 24; a channel at 5 GHz has 6 Mbit/s and slots of 9 us"),
        ),
        Mode::AdHoc | Mode::Outside => return None,
        Mode::MeshPoint if card.forwards == Some(true) => (
            "a mesh point that forwards: each state is sent on by all",
            format!("iw dev {interface} set mesh_param mesh_fwding 0, and iw dev {interface} set mcast_rate 24"),
        ),
        Mode::Station => (
            "by the access point, at its lowest basic rate, and held back while any station sleeps",
            "on the access point: basic_rates without 1 to 11 Mbit/s, dtim_period=1; iw's mcast_rate does not work here"
                .to_owned(),
        ),
        _ => return None,
    };
    Some(warn("multicast", found.to_owned(), advice))
}

fn busy(share: f64) -> Finding {
    let found = format!("{:.0} % busy", 100.0 * share);
    if share < BUSY {
        return Finding::ok("channel", found);
    }
    warn("channel", found, "take another channel, or a higher rate of multicast, or fewer states a second".to_owned())
}

/// Returns how many peers are heard, and the worst of them.
fn peers(card: &Card) -> Finding {
    let heard: Vec<&Peer> =
        card.peers.iter().filter(|peer| peer.silent_ms.is_none_or(|silent_ms| silent_ms < SILENT_MS)).collect();
    let weakest = heard.iter().filter_map(|peer| Some((peer.signal_dbm?, *peer))).min_by_key(|(dbm, _)| *dbm);
    let power = weakest.map_or(String::new(), |(dbm, peer)| format!(", the weakest {} with {dbm} dBm", name(peer)));
    let rate = heard.iter().filter_map(|peer| peer.rate_mbit_s).min_by(f64::total_cmp);
    let rate = rate.map_or(String::new(), |rate| format!(", the slowest {rate} Mbit/s"));
    let found = format!("{} heard{power}{rate}", heard.len());
    let share = |peer: &Peer| f64::from(peer.retries) / f64::from(peer.sent.max(1));
    let retried = heard.iter().find(|peer| peer.sent >= FRAMES && share(peer) > RETRIES);
    if let Some(peer) = retried {
        let found = format!(
            "{found}; of {} frames to {} {:.0} % were sent again, {} given up",
            peer.sent,
            name(peer),
            100.0 * share(peer),
            peer.failed
        );
        return warn(
            "peers",
            found,
            "look for hidden stations, another network on the channel, and antennas".to_owned(),
        );
    }
    match weakest {
        Some((dbm, _)) if dbm < WEAK_DBM => warn("peers", found, "bring it nearer, or turn its antenna".to_owned()),
        _ => Finding::ok("peers", found),
    }
}

fn name(peer: &Peer) -> String {
    peer.address.map(|byte| format!("{byte:02x}")).join(":")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::card::{Combination, Load};

    fn card() -> Card {
        Card {
            mode: Mode::AdHoc,
            network: Some("team".to_owned()),
            frequency_mhz: Some(5180),
            power_save: Some(false),
            country: Some("DE".to_owned()),
            forwards: None,
            modes: vec![Mode::AdHoc, Mode::Station],
            combinations: vec![Combination {
                limits: vec![(1, vec![Mode::AdHoc]), (4, vec![Mode::Station, Mode::MeshPoint])],
                most: 4,
                channels: 1,
            }],
            load: Some(Load { active_ms: 10_000, busy_ms: 1000 }),
            peers: vec![Peer { address: [2, 0, 0, 0, 0, 1], signal_dbm: Some(-50), ..Peer::default() }],
        }
    }

    fn of(card: &Card, medium: LinkMedium) -> Vec<(Fitness, &'static str, String, String)> {
        let all = findings(card, "wlan0", medium).into_iter();
        all.map(|finding| (finding.fitness, finding.what, finding.found, finding.advice)).collect()
    }

    #[test]
    fn a_sound_card_is_told_and_not_warned_of() {
        let all = of(&card(), LinkMedium::AdHoc);
        assert!(all.iter().all(|(fitness, ..)| *fitness == Fitness::Ok), "{all:?}");
        assert_eq!(all[0].2, "IBSS of 'team' at 5180 MHz");
        assert_eq!(all.last().expect("peers").2, "1 heard, the weakest 02:00:00:00:00:01 with -50 dBm");
    }

    #[test]
    fn a_station_of_an_access_point_is_no_end_of_an_ad_hoc_link() {
        let station = Card { mode: Mode::Station, ..card() };
        let all = of(&station, LinkMedium::AdHoc);
        assert!(all[0].0 == Fitness::Warn && all[0].3.contains("iw dev wlan0 set type ibss"), "{all:?}");
        let alone = Card { combinations: Vec::new(), ..station.clone() };
        assert!(of(&alone, LinkMedium::AdHoc)[0].3.contains("p2p_disabled"));
        let unable = Card { modes: vec![Mode::Station], ..station.clone() };
        assert!(of(&unable, LinkMedium::AdHoc)[0].2.contains("neither IBSS"));
        let monitor = Card { mode: Mode::Monitor, ..card() };
        assert!(of(&monitor, LinkMedium::AdHoc)[0].2.contains("do not hear each other"));
        assert_eq!(of(&station, LinkMedium::AccessPoint)[0].0, Fitness::Ok);
    }

    #[test]
    fn what_costs_time_on_the_air_is_warned_of_with_the_command() {
        let warned = |card: &Card, what: &str| {
            let found = of(card, LinkMedium::AdHoc).into_iter().find(|(_, of, ..)| *of == what).expect("it is checked");
            assert_eq!(found.0, Fitness::Warn, "{found:?}");
            found.3
        };
        assert_eq!(
            warned(&Card { power_save: Some(true), ..card() }, "power saving"),
            "iw dev wlan0 set power_save off"
        );
        assert!(warned(&Card { country: Some("00".to_owned()), ..card() }, "country").contains("iw reg set"));
        assert!(warned(&Card { frequency_mhz: Some(2412), ..card() }, "multicast").contains("mcast_rate 24"));
        let mesh = Card { mode: Mode::MeshPoint, forwards: Some(true), ..card() };
        assert!(warned(&mesh, "multicast").contains("mesh_fwding 0"));
        assert!(warned(&Card { mode: Mode::Station, ..card() }, "multicast").contains("dtim_period=1"));
        let load = Some(Load { active_ms: 10_000, busy_ms: 7000 });
        assert!(warned(&Card { load, ..card() }, "channel").contains("another channel"));
        let peer = Peer { sent: 200, retries: 100, failed: 3, signal_dbm: Some(-50), ..Peer::default() };
        assert!(warned(&Card { peers: vec![peer], ..card() }, "peers").contains("hidden"));
        let peer = Peer { signal_dbm: Some(-80), ..Peer::default() };
        assert!(warned(&Card { peers: vec![peer], ..card() }, "peers").contains("nearer"));
    }

    #[test]
    fn a_country_that_the_kernel_does_not_tell_is_not_judged() {
        let all = of(&Card { country: None, ..card() }, LinkMedium::AdHoc);
        assert!(all.iter().all(|(_, what, ..)| *what != "country"), "{all:?}");
    }

    #[test]
    fn peers_that_are_silent_do_not_count() {
        let peer = Peer { signal_dbm: Some(-80), silent_ms: Some(20_000), ..Peer::default() };
        assert_eq!(of(&Card { peers: vec![peer], ..card() }, LinkMedium::AdHoc).last().expect("peers").2, "0 heard");
    }
}
