//! Figures and tables of growing teams in a network study: cost per robot (`growth`) and saturation of one channel
//! (`saturation`).

use super::case::Addressing;
use super::growth::{self, Growth};
use super::saturation::{self, Load};
use murmurate_report::figures::{Figure, FigureError, Line, Panel, Point};

/// Draws the figure of growing teams' cost per robot (messages, datagrams, processor time and others) against the
/// number of robots.
pub fn costs(grown: &[Growth]) -> Result<Figure, FigureError> {
    let mut sizes: Vec<usize> = grown.iter().map(|growth| growth.robots).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let one_host = |mode: &str| grown.iter().any(|growth| growth.mode == mode && growth.deliveries == 0.0);
    let line = |mode: &str, value: fn(&Growth) -> f64| Line {
        name: if one_host(mode) {
            format!("one agent for all robots ({mode})")
        } else {
            format!("a host for each robot ({mode}), frames carry {} m", growth::range_m())
        },
        points: sizes
            .iter()
            .map(|size| grown.iter().find(|growth| growth.mode == mode && growth.robots == *size))
            .map(|growth| growth.map(|growth| Point::exactly(value(growth))))
            .collect(),
    };
    let panel = |title: &str, y: &str, value: fn(&Growth) -> f64| {
        let most = grown.iter().map(value).fold(1.0, f64::max);
        let lines = growth::MODES.iter().map(|mode| line(mode, value)).collect();
        Panel::new(title, y, Some((0.0, 1.1 * most)), lines)
    };
    let panels = [
        panel("messages published", "messages/s", |growth| growth.messages),
        panel("bytes published", "kB/s", |growth| 1e-3 * growth.bytes),
        panel("datagrams received", "datagrams/s", |growth| growth.deliveries),
        panel("processor time, measured", "µs per second", |growth| growth.cpu_us),
    ];
    let title = "Cost per robot";
    let places: Vec<String> = sizes.iter().map(usize::to_string).collect();
    Ok(Figure {
        name: "growth".to_owned(),
        title: title.to_owned(),
        caption: format!(
            "Per robot and simulated second, simulated over {} s at constant density ({} m² per robot). A flat line \
             means that the team's cost is proportional to its size. Processor time was measured when this report was \
             made, and varies from run to run.",
            growth::DURATION_S,
            growth::GROUND_M2
        ),
        svg: murmurate_report::figures::sweep(title, "robots", &places, &panels)?,
    })
}

/// Returns column heads and rows of the table of growing teams' costs per robot.
pub fn of_costs(grown: &[Growth]) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let heads = vec![
        "robots",
        "mode",
        "messages/s",
        "bytes/s",
        "datagrams received/s",
        "airtime of its latents",
        "of all in range",
        "processor time, µs/s",
    ];
    let percent = |share: Option<f64>| share.map_or("-".to_owned(), |share| format!("{:.1} %", 100.0 * share));
    let line = |growth: &Growth| {
        vec![
            growth.robots.to_string(),
            growth.mode.clone(),
            format!("{:.1}", growth.messages),
            format!("{:.0}", growth.bytes),
            format!("{:.0}", growth.deliveries),
            percent(growth.airtime),
            percent(growth.airtime_around),
            format!("{:.0}", growth.cpu_us),
        ]
    };
    (heads, grown.iter().map(line).collect())
}

/// Returns a text on the airtime that a robot's latents take alone and together with those of all robots in range, for
/// the largest team of `grown`; `None` if no team has a radio.
pub fn remark(grown: &[Growth]) -> Option<String> {
    let largest = grown.iter().filter(|growth| growth.airtime.is_some()).max_by_key(|growth| growth.robots)?;
    let (own, around) = (100.0 * largest.airtime?, 100.0 * largest.airtime_around?);
    let change = if around < 100.0 {
        "so the channel suffices, if hidden stations are rare"
    } else {
        "more than the channel has: raise the rate of multicast frames, send less often, or reduce the range"
    };
    Some(format!(
        "A robot's latents take {own:.1} % of the airtime. With a transmission range of {} m it shares the channel \
         with {:.0} others, however large the team is. Together they take {around:.0} %, {change}. Without that limit \
         the team shares one channel, as in the table below.",
        growth::range_m(),
        growth::neighbours_in_range().min(largest.robots as f64 - 1.0),
    ))
}

/// Draws the figure of a radio channel's load and saturation throughput against the number of robots.
pub fn loads(loads: &[Load]) -> Result<Figure, FigureError> {
    let line = |addressing: Addressing, name: &str, value: fn(&Load) -> Option<f64>| Line {
        name: name.to_owned(),
        points: loads
            .iter()
            .filter(|load| load.addressing == addressing)
            .map(|load| value(load).map(Point::exactly))
            .collect(),
    };
    let (multicast, unicast) = (Addressing::Multicast, Addressing::Unicast);
    // Less than one message a second is drawn as one.
    let lines = vec![
        line(multicast, &format!("offered: {} messages a second and robot", saturation::RATE), |load| {
            Some(load.messages_per_s.log10())
        }),
        line(multicast, "saturation by multicast", |load| Some(load.saturation_per_s.max(1.0).log10())),
        line(unicast, &format!("saturation by unicast to {} neighbours", saturation::NEIGHBOURS), |load| {
            Some(load.saturation_per_s.max(1.0).log10())
        }),
    ];
    let collisions = vec![
        line(multicast, "", |_| None),
        line(multicast, "", |load| Some(100.0 * load.collision)),
        line(unicast, "", |load| Some(100.0 * load.collision)),
    ];
    let panels = [
        Panel::new("offered load and saturation throughput", "messages/s, power of ten", None, lines),
        Panel::new("frames that collide at saturation", "collisions [%]", Some((0.0, 100.0)), collisions),
    ];
    let title = "Saturation of one channel";
    let places: Vec<String> = saturation::SIZES.iter().map(usize::to_string).collect();
    Ok(Figure {
        name: "saturation".to_owned(),
        title: title.to_owned(),
        caption: "Offered load of growing teams on one channel, in one hop, and throughput when every station always \
                  has a frame to send (Bianchi's model). Where the first line is above another, the channel is \
                  saturated. A multicast frame that collides is not retransmitted, so the contention window never \
                  grows, and most frames of a large team collide."
            .to_owned(),
        svg: murmurate_report::figures::sweep(title, "robots", &places, &panels)?,
    })
}

/// Returns column heads and rows of the table of load and saturation of one radio channel by growing teams.
pub fn of_loads(loads: &[Load]) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let heads = vec![
        "robots",
        "addressing",
        "messages/s",
        "airtime",
        "through an access point",
        "saturation, messages/s",
        "collisions",
        "",
    ];
    let line = |load: &Load| {
        vec![
            load.robots.to_string(),
            load.addressing.to_string(),
            format!("{:.0}", load.messages_per_s),
            format!("{:.0} %", 100.0 * load.airtime),
            format!("{:.0} %", 100.0 * load.airtime_relayed),
            format!("{:.0}", load.saturation_per_s),
            format!("{:.0} %", 100.0 * load.collision),
            if load.is_full() { "full".to_owned() } else { String::new() },
        ]
    };
    (heads, loads.iter().map(line).collect())
}
