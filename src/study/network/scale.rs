//! How a network study shows growing teams: what a robot costs (`growth`), and where one channel is full
//! (`saturation`). Figures and tables; nothing is reckoned here.

use super::case::Addressing;
use super::growth::{self, Growth};
use super::saturation::{self, Load};
use crate::report::figures::{self, Figure, FigureError, Line, Panel, Point};

/// The figure of what a robot costs.
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
        panel("messages that it says", "messages/s", |growth| growth.messages),
        panel("their bytes", "kB/s", |growth| 1e-3 * growth.bytes),
        panel("datagrams that it takes in", "datagrams/s", |growth| growth.deliveries),
        panel("processor time, measured", "µs for each second", |growth| growth.cpu_us),
    ];
    let title = "What a robot of a team costs";
    let places: Vec<String> = sizes.iter().map(usize::to_string).collect();
    Ok(Figure {
        name: "growth".to_owned(),
        title: title.to_owned(),
        caption: format!(
            "Per robot and second of its time, simulated over {} s at constant density ({} m² a robot). A line that is \
             flat is a team that costs as much as it has robots. Processor time was measured when this report was \
             made, and another time is another figure.",
            growth::LASTS_S,
            growth::GROUND_M2
        ),
        svg: figures::sweep(title, "robots", &places, &panels)?,
    })
}

/// The table of what a robot costs.
pub fn of_costs(grown: &[Growth]) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let heads = vec![
        "robots",
        "mode",
        "messages/s",
        "bytes/s",
        "datagrams taken in/s",
        "airtime of its latents",
        "of all around it",
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

/// What the air around a robot comes to, in a sentence; nothing without a radio.
pub fn remark(grown: &[Growth]) -> Option<String> {
    let largest = grown.iter().filter(|growth| growth.airtime.is_some()).max_by_key(|growth| growth.robots)?;
    let (own, around) = (100.0 * largest.airtime?, 100.0 * largest.airtime_around?);
    let change = if around < 100.0 {
        "so there is room, if stations that do not hear each other are rare"
    } else {
        "more than there is: raise the rate of multicast frames, speak less often, or let frames carry less far"
    };
    Some(format!(
        "A robot's latents take {own:.1} % of the air. Where frames carry {} m, it shares the air with {:.0} others \
         however large the team is: {around:.0} % is taken around it, {change}. Without that limit the team shares \
         one channel, as in the table below.",
        growth::range_m(),
        growth::around().min(largest.robots as f64 - 1.0),
    ))
}

/// The figure of where one channel is full.
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
    // Less than a message a second is none.
    let lines = vec![
        line(multicast, &format!("wanted: {} messages a second and robot", saturation::RATE), |load| {
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
        Panel::new("messages that want and find room", "messages/s, power of ten", None, lines),
        Panel::new("frames that collide at saturation", "collisions [%]", Some((0.0, 100.0)), collisions),
    ];
    let title = "Where one channel is full";
    let places: Vec<String> = saturation::SIZES.iter().map(usize::to_string).collect();
    Ok(Figure {
        name: "saturation".to_owned(),
        title: title.to_owned(),
        caption: "What teams of growing size want to say on one channel, in one hop, and what gets through when \
                  everybody always has something to send (Bianchi's model): where the first line is above another, the \
                  channel is full. A multicast frame that collides is not sent again, so no window grows, and a large \
                  team drowns."
            .to_owned(),
        svg: figures::sweep(title, "robots", &places, &panels)?,
    })
}

/// The table of where one channel is full.
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
