//! Rows of the tables as cases of the channel, and the bars that each must meet.

use std::collections::BTreeMap;

use murmurate::messages::geometry::Vec2;
use murmurate::net::media::radio::{
    Adaptation, AfterDrop, Channel, Destination, Fading, Powers, Radio, Recovery, Topology,
};
use murmurate::random::Seed;
use murmurate::time::{Span, Time};

use crate::run::{Case, Measured};
use crate::table::{Row, places, rows};

/// Returns the name of a rate of ns-3 as that of this program.
fn rate(name: &str) -> String {
    let digits: String = name.trim_end_matches("Mbps").chars().filter(char::is_ascii_digit).collect();
    if name.starts_with("Dsss") { format!("dsss-{digits}") } else { format!("ofdm-{digits}") }
}

/// Returns the channel of the reference runs.
fn radio(row: &Row) -> Radio {
    let fast = rate(row.text("rate"));
    // ns-3 acknowledges at the highest mandatory rate up to that of the frame.
    let ack = match fast.as_str() {
        "ofdm-6" => "ofdm-6",
        "ofdm-12" => "ofdm-12",
        _ => "ofdm-24",
    };
    Radio {
        channel: Topology::AdHoc,
        rate: fast.parse().expect("a rate"),
        basic_rate: rate(row.text("basic")).parse().expect("a rate"),
        ack_rate: ack.parse().expect("a rate"),
        retries: row.number("retries") as u32,
        after_error: Recovery::Difs,
        after_drop: AfterDrop::Keep,
        ..Radio::default()
    }
}

/// Checks, says and counts the rows whose figures miss their bars.
struct Verdict {
    missed: Vec<String>,
    all: usize,
    /// Largest difference of each figure that has a bar: of times \[ms\] as a share, of shares themselves.
    largest: BTreeMap<String, f64>,
}

impl Verdict {
    fn new() -> Verdict {
        Verdict { missed: Vec::new(), all: 0, largest: BTreeMap::new() }
    }

    fn row(&mut self, label: &str, figures: &[(&str, f64, f64, bool)]) {
        self.all += 1;
        let told: Vec<String> = figures
            .iter()
            .map(|(name, ours, theirs, good)| {
                format!("{name} {ours:.4} ({theirs:.4}){}", if *good { "" } else { " MISSED" })
            })
            .collect();
        for (name, ours, theirs, _) in figures {
            let apart = if name.ends_with("ms") { ours / theirs - 1.0 } else { ours - theirs };
            let largest = self.largest.entry((*name).to_owned()).or_default();
            *largest = largest.max(apart.abs());
        }
        let line = format!("{label:70} {}", told.join("  "));
        println!("{line}");
        if figures.iter().any(|(.., good)| !good) {
            self.missed.push(line);
        }
    }

    fn end(self) {
        println!("{} of {} rows within their bars", self.all - self.missed.len(), self.all);
        println!("largest differences: {:.4?}", self.largest);
        assert!(self.missed.is_empty(), "{} rows:\n{}", self.missed.len(), self.missed.join("\n"));
    }
}

/// Returns whether a delay is within 10 % or 0.1 ms.
fn near(ours: f64, theirs: f64) -> bool {
    (ours - theirs).abs() <= (0.1 * theirs).max(0.1)
}

fn figures<'a>(ours: &Measured, row: &Row, names: [&'a str; 3]) -> Vec<(&'a str, f64, f64, bool)> {
    let theirs = |column: &str| row.number(column);
    let [delivered, p50, p90] = names;
    vec![
        (delivered, ours.delivered, theirs(delivered), (ours.delivered - theirs(delivered)).abs() <= 0.02),
        (p50, ours.p50_ms, theirs(p50), near(ours.p50_ms, theirs(p50))),
        (p90, ours.p90_ms, theirs(p90), near(ours.p90_ms, theirs(p90))),
    ]
}

/// Returns the flows of stations that all multicast.
fn all(stations: usize) -> Vec<(u16, Option<u16>)> {
    (0..stations as u16).map(|station| (station, None)).collect()
}

/// Returns the flows of stations each of which sends to the next one.
fn round(stations: u16) -> Vec<(u16, Option<u16>)> {
    (0..stations).map(|from| (from, Some((from + 1) % stations))).collect()
}

#[test]
fn hidden_stations() {
    let mut verdict = Verdict::new();
    for row in rows("hidden.csv") {
        let place = row.text("place").split(' ').next().expect("a place").to_owned();
        let (places, unicast) = (places(&place), row.text("cast") == "unicast");
        let flows = if unicast {
            let pair = |flow: &str| {
                let (from, to) = flow.split_once(':').expect("from:to");
                (from.parse().expect("a station"), Some(to.parse().expect("a station")))
            };
            row.text("flows").split(' ').map(pair).collect()
        } else {
            all(places.len())
        };
        let case = Case {
            radio: Radio {
                range_m: Some(row.number("rx_m") as f32),
                sense_m: Some(row.number("cs_m") as f32),
                ..radio(&row)
            },
            places,
            flows,
            load_per_s: row.number("load_per_station_s"),
            bytes: 200,
            warm_s: 1.0,
            seconds: row.number("seconds"),
            wanted_m: 30.0,
        };
        let ours = case.mean(6);
        let label = format!(
            "{place} {} {} {} sensed {}",
            row.text("case"),
            row.text("rate"),
            row.text("basic"),
            row.text("cs_m")
        );
        let mut all = figures(&ours, &row, ["delivered", "p50_ms", "p90_ms"]);
        all.push(("arrived/s", ours.arrived_per_s, row.number("arrived_s"), true));
        all.push(("sent/s", ours.transmitted_per_s, row.number("tx_s"), true));
        if row.text("basic").starts_with("Dsss") && !unicast && row.text("cs_m") == "30" {
            // ns-3 reads frames of DSSS among others of the same code: an upper bound.
            all[0].3 = ours.delivered <= row.number("delivered") + 0.02;
        }
        if unicast {
            let theirs = row.number("retry_share");
            all.push(("retries", ours.retries, theirs, (ours.retries - theirs).abs() <= 0.02));
        }
        verdict.row(&label, &all);
    }
    verdict.end();
}

#[test]
fn fields() {
    let mut verdict = Verdict::new();
    for row in rows("field_today.csv") {
        let places = places(row.text("place"));
        for sense in ["30", "55"] {
            let case = Case {
                radio: Radio {
                    channel: Topology::AdHoc,
                    basic_rate: row.text("basic").parse().expect("a rate"),
                    range_m: Some(30.0),
                    sense_m: Some(sense.parse().expect("a distance")),
                    after_error: Recovery::Difs,
                    ..Radio::default()
                },
                flows: all(places.len()),
                places: places.clone(),
                load_per_s: row.number("load_hz"),
                bytes: 200,
                warm_s: 1.0,
                seconds: row.number("seconds"),
                wanted_m: 30.0,
            };
            let ours = case.mean(12);
            let names = match sense {
                "30" => ["ns3_cs30_delivered", "ns3_cs30_p50_ms", "ns3_cs30_p90_ms"],
                _ => ["ns3_cs55_delivered", "ns3_cs55_p50_ms", "ns3_cs55_p90_ms"],
            };
            let mut all = figures(&ours, &row, names);
            let (place, hz) = (row.text("place"), row.text("load_hz"));
            if row.text("basic") == "dsss-1" && sense == "30" {
                all[0].3 = ours.delivered <= row.number(names[0]) + 0.02;
            }
            if (place, hz, sense, row.text("basic")) == ("field20-1", "60", "55", "dsss-1") {
                // Saturated: delays are those of queues, and have no bar.
                all.truncate(1);
            }
            verdict.row(&format!("{place} {} {hz} Hz sensed {sense}", row.text("basic")), &all);
        }
    }
    verdict.end();
}

#[test]
fn capture() {
    let mut verdict = Verdict::new();
    for row in rows("capture.csv") {
        let offset_us = row.number("stronger_starts_us_later");
        // With frames that begin within a preamble, ns-3 leaves the power of the earlier one out.
        let turns = row.text("frame_capture_model") == "1" && row.text("mode").contains("54");
        if offset_us == 2.0 || offset_us == 10.0 && turns {
            continue;
        }
        let weaker_dbm = row.number("weaker_dbm");
        let strong_dbm = weaker_dbm + row.number("difference_db");
        let powers = Powers { tx_dbm: 16.02, sense_dbm: 0.0, ..Powers::default() };
        let distance = |dbm: f64| 10.0_f64.powf((powers.tx_dbm - powers.reference_db - dbm) / 30.0) as f32;
        let mode = rate(row.text("mode"));
        let radio = Radio {
            channel: Topology::AdHoc,
            basic_rate: mode.parse().expect("a rate"),
            slot_us: 1,
            capture: row.text("frame_capture_model") == "1",
            powers: Some(powers.clone()),
            ..Radio::default()
        };
        let mut channel: Channel<()> = Channel::new(radio, 3, &Seed::of_run(1));
        channel.place(0, Vec2::new(distance(strong_dbm), 0.0));
        channel.place(1, Vec2::new(-distance(weaker_dbm), 0.0));
        channel.place(2, Vec2::zeros());
        let tries = 300;
        let mut arrived = Vec::new();
        for number in 1..=tries {
            let begin = Time::ZERO + Span::from_millis(50 * number);
            let us = |us: f64| Span::from_nanos((1000.0 * us) as u64);
            let mut offers = [(begin + us(offset_us.max(0.0)), 0), (begin + us((-offset_us).max(0.0)), 1)];
            offers.sort_unstable();
            for (now, from) in offers {
                channel.wake(now, &mut arrived);
                // 236 bytes of data and 24 of the header; 66 come with the datagram.
                channel.offer(now, from, Destination::Many(vec![2].into()), 260 - 66, ());
            }
        }
        channel.wake(Time::ZERO + Span::from_millis(100 * tries), &mut arrived);
        let read = |from: u16| arrived.iter().filter(|one| one.from == from).count() as f64 / tries as f64;
        let bar = |ours: f64, theirs: f64| {
            let interval = 1.96 * ((theirs * (1.0 - theirs) + ours * (1.0 - ours)) / tries as f64).sqrt();
            (ours - theirs).abs() <= interval.max(0.03)
        };
        let (stronger, weaker) = (row.number("stronger_read"), row.number("weaker_read"));
        verdict.row(
            &format!(
                "{mode} capture {} {offset_us} us {} dB",
                row.text("frame_capture_model"),
                row.text("difference_db")
            ),
            &[
                ("stronger", read(0), stronger, bar(read(0), stronger)),
                ("weaker", read(1), weaker, bar(read(1), weaker)),
            ],
        );
    }
    verdict.end();
}

/// Returns the powers of a row with path loss.
fn powers(row: &Row) -> Powers {
    Powers {
        tx_dbm: 16.02,
        shadowing_db: row.number("sigma_db"),
        fading: if row.number("nakagami") > 0.0 { Fading::Rayleigh } else { Fading::None },
        ..Powers::default()
    }
}

#[test]
fn distances() {
    let mut verdict = Verdict::new();
    for (table, detect_dbm) in [("distance.csv", -82.0), ("distance_sensitive.csv", -105.0)] {
        for row in rows(table) {
            let distance: f32 = row.text("place").trim_end_matches(" m").parse().expect("a distance");
            let detect_db = match detect_dbm {
                -82.0 => 4.0,
                _ if row.text("basic").starts_with("Dsss") => -8.0,
                _ => 0.0,
            };
            let case = Case {
                radio: Radio {
                    powers: Some(Powers { detect_dbm, detect_db, sense_dbm: detect_dbm, ..powers(&row) }),
                    ..radio(&row)
                },
                places: vec![[0.0, 0.0], [distance, 0.0]],
                flows: vec![(0, None)],
                load_per_s: row.number("load_per_station_s"),
                bytes: 200,
                warm_s: 1.0,
                seconds: row.number("seconds"),
                wanted_m: f32::INFINITY,
            };
            let (ours, theirs) = (case.mean(4).delivered, row.number("delivered"));
            let label = format!(
                "{table} {distance} m {} shadowing {} fading {}",
                row.text("basic"),
                row.text("sigma_db"),
                row.text("nakagami")
            );
            verdict.row(&label, &[("delivered", ours, theirs, (ours - theirs).abs() <= 0.03)]);
        }
    }
    verdict.end();
}

#[test]
fn rate_adaptation() {
    let mut verdict = Verdict::new();
    for row in rows("adaptation.csv") {
        let minstrel = row.text("manager") == "minstrel";
        let adaptation = if minstrel { Adaptation::Minstrel } else { Adaptation::Fixed };
        let near = row.text("place") == "circle 1 m";
        let stations = row.number("n") as u16;
        let radio = if near {
            Radio { adaptation, noise_loss: row.number("noise"), ..radio(&row) }
        } else {
            let powers = Powers { detect_dbm: -105.0, detect_db: 0.0, sense_dbm: -105.0, ..powers(&row) };
            Radio { adaptation, powers: Some(powers), ..radio(&row) }
        };
        let distance: f32 = row.text("place").trim_end_matches(" m").parse().unwrap_or(1.0);
        let case = Case {
            radio,
            places: if near { vec![[0.0, 0.0]; usize::from(stations)] } else { vec![[0.0, 0.0], [distance, 0.0]] },
            flows: if near { round(stations) } else { vec![(0, Some(1))] },
            load_per_s: row.number("load_per_station_s"),
            bytes: 200,
            warm_s: 2.0,
            seconds: row.number("seconds"),
            wanted_m: f32::INFINITY,
        };
        let ours = case.mean(4);
        let theirs = row.number("arrived_s");
        let wide = row.number("arrived_s_ci95");
        let light = row.number("load_per_station_s") < 200.0;
        let mut all = Vec::new();
        if light && minstrel {
            let all_come = row.number("delivered");
            all.push(("delivered", ours.delivered, all_come, ours.delivered >= all_come - 0.01));
            all.push(("p99", ours.p99_ms, row.number("p99_ms"), true));
        } else if minstrel {
            let good = (ours.arrived_per_s - theirs).abs() <= (0.15 * theirs).max(wide);
            all.push(("arrived/s", ours.arrived_per_s, theirs, good));
            all.push(("p99", ours.p99_ms, row.number("p99_ms"), true));
        } else {
            let theirs = row.number("delivered");
            let good = (ours.delivered - theirs).abs() <= (0.15 * theirs).max(row.number("delivered_ci95")).max(0.03);
            all.push(("delivered", ours.delivered, theirs, good));
        }
        all.push(("retries", ours.retries, row.number("retry_share"), true));
        all.push(("sent/s", ours.transmitted_per_s, row.number("tx_s"), true));
        let label = format!("{} shadowing {} fading {}", row.text("case"), row.text("sigma_db"), row.text("nakagami"));
        verdict.row(&label, &all);
    }
    verdict.end();
}

#[test]
fn one_hop() {
    let mut verdict = Verdict::new();
    for row in rows("one_hop.csv") {
        let (stations, unicast) = (row.number("n") as u16, row.text("cast") == "unicast");
        let case = Case {
            radio: Radio {
                channel: Topology::AdHoc,
                rate: row.text("rate").parse().expect("a rate"),
                basic_rate: row.text("basic").parse().expect("a rate"),
                retries: row.number("retries") as u32,
                ..Radio::default()
            },
            places: vec![[0.0, 0.0]; usize::from(stations)],
            flows: if unicast { round(stations) } else { all(usize::from(stations)) },
            load_per_s: row.number("load_per_station_s"),
            bytes: 200,
            warm_s: 1.0,
            seconds: row.number("seconds"),
            wanted_m: f32::INFINITY,
        };
        let shared = case.mean(5);
        let space = Case { radio: Radio { sense_m: Some(1.0), ..case.radio.clone() }, ..case }.mean(5);
        let theirs = row.number("murmurate_delivered");
        verdict.row(
            &format!("{} {stations} {} %", row.text("case"), row.text("load_percent")),
            &[
                ("delivered", shared.delivered, theirs, (shared.delivered - theirs).abs() < 0.01),
                ("with space", space.delivered, shared.delivered, space.delivered == shared.delivered),
                ("p90", space.p90_ms, shared.p90_ms, space.p90_ms == shared.p90_ms),
            ],
        );
    }
    verdict.end();
}
