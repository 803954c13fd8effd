//! Report of a network study: its figures and its page.

use super::case::{Addressing, Case, NetworkKind, ReliabilityMode, Source, Sweep};
use super::growth::Growth;
use super::medium::{Medium, MediumEmulator};
use super::outcome::{Outcome, Row};
use super::table::{self, SHOWN};
use super::{saturation, scale};
use murmurate::net::media::radio::Topology;
use murmurate::random::Seed;
use murmurate::results::listening::Listening;
use murmurate_report::figures::page::{self, Part};
use murmurate_report::figures::{DelayColumn, Figure, FigureError, Line, Pairs, Panel, Point};

/// Result of a case of a network study: its source (emulated or measured), its parameters and its outcome.
pub type Found = (Source, Case, Outcome);

/// Line of a figure: its name, and a predicate that selects the results of the cases drawn on it.
type OnLine = (String, Box<dyn Fn(&Found) -> bool>);

/// Message rates of the paper's two figures \[1/s\]. A report draws the nearest rates of its study.
const DRAWN: [f64; 2] = [60.0, 200.0];

/// Results of a network study, for its report.
pub struct Findings<'a> {
    /// Parameters of the network study.
    pub sweep: &'a Sweep,
    /// Results of all cases.
    pub results: &'a [Found],
    /// Cost per robot of growing teams; empty if it was not computed.
    pub grown: &'a [Growth],
    /// Command that reproduces the study.
    pub command: &'a str,
    /// Notes for the report, such as the uncertainty of clock offsets.
    pub notes: &'a [String],
}

/// Group of lines of a figure, whose cases differ in one parameter.
struct Group {
    name: String,
    title: String,
    lines: Vec<OnLine>,
}

impl Findings<'_> {
    /// Returns the results of all cases as rows.
    pub fn rows(&self) -> Vec<Row> {
        self.results.iter().map(|(source, case, outcome)| Row::of(*source, case, outcome)).collect()
    }

    /// Groups the cases of each network: reliability modes by multicast and by unicast, and RTPS by retry limit.
    fn groups(&self) -> Vec<Group> {
        let mut groups = Vec::new();
        let most = self.sweep.retries.iter().copied().max().unwrap_or(0);
        for &network in &self.sweep.networks {
            for &addressing in &self.sweep.addressings {
                let retried = addressing == Addressing::Unicast && network != NetworkKind::Shaped;
                let with = if retried { format!(", {most} retries") } else { String::new() };
                let mut lines = Vec::new();
                for &reliability in &self.sweep.reliabilities {
                    let is = move |case: &Case| {
                        (case.network, case.addressing, case.reliability) == (network, addressing, reliability)
                            && (!retried || case.retries == most)
                    };
                    self.sources(&mut lines, &reliability.to_string(), is);
                }
                let title = format!("{network}, {addressing}{with}");
                groups.push(Group { name: format!("{network}-{addressing}"), title, lines });
            }
            let unicast = self.sweep.addressings.contains(&Addressing::Unicast);
            let acks = self.sweep.reliabilities.contains(&ReliabilityMode::Ack);
            if network != NetworkKind::Shaped && unicast && acks && self.sweep.retries.len() > 1 {
                let mut lines = Vec::new();
                for &retries in &self.sweep.retries {
                    let is = move |case: &Case| {
                        let Case { addressing, reliability, .. } = case;
                        case.network == network
                            && (*addressing, *reliability) == (Addressing::Unicast, ReliabilityMode::Ack)
                            && case.retries == retries
                    };
                    self.sources(&mut lines, &format!("ack, retry limit {retries}"), is);
                }
                let title = format!("{network}, unicast, ack, by retry limit");
                groups.push(Group { name: format!("{network}-retries"), title, lines });
            }
        }
        groups.retain(|group| !group.lines.is_empty());
        groups
    }

    /// Adds to `lines` one line for the emulated and one for the measured cases that `is` selects, as far as there
    /// are any.
    fn sources(&self, lines: &mut Vec<OnLine>, name: &str, is: impl Fn(&Case) -> bool + Copy + 'static) {
        let live = self.results.iter().any(|(source, ..)| *source == Source::Live);
        for source in Source::ALL {
            if self.results.iter().any(|(other, case, _)| *other == source && is(case)) {
                let name = if live { format!("{name}, {source}") } else { name.to_owned() };
                lines.push((name, Box::new(move |(other, case, _): &Found| *other == source && is(case))));
            }
        }
    }

    /// Returns all figures of the report.
    pub fn figures(&self) -> Result<Vec<Figure>, FigureError> {
        let mut all = Vec::new();
        for group in self.groups() {
            all.push(self.over_rates(&group)?);
            let mut drawn: Vec<f64> = Vec::new();
            for wanted in DRAWN {
                let near = |rate: &&f64| (rate.ln() - wanted.ln()).abs();
                let nearest = self.sweep.rates.iter().min_by(|a, b| near(a).total_cmp(&near(b)));
                drawn.extend(nearest.filter(|rate| !drawn.contains(rate)));
            }
            for rate in drawn {
                all.push(self.delays(&group, rate)?);
            }
        }
        all.extend(self.reach()?);
        if let Medium::Radio(radio) = &self.sweep.medium {
            all.push(scale::loads(&saturation::table(radio, self.datagram_bytes()))?);
        }
        if !self.grown.is_empty() {
            all.push(scale::costs(self.grown)?);
        }
        Ok(all)
    }

    /// Draws who hears whom, if the stations have places.
    fn reach(&self) -> Result<Option<Figure>, FigureError> {
        let (Medium::Radio(radio), Some(places)) = (&self.sweep.medium, &self.sweep.places) else { return Ok(None) };
        let places = places.of(self.sweep.stations);
        let medium = Medium::Radio(radio.on(Topology::AdHoc));
        let mut emulator: MediumEmulator<()> = MediumEmulator::new(medium, self.sweep.stations, &Seed::of_run(0));
        emulator.place(&places);
        let mut pairs = Pairs::default();
        for from in 0..self.sweep.stations {
            for to in emulator.reached(from).into_iter().filter(|to| to.station > from) {
                let pair = (usize::from(from), usize::from(to.station));
                if to.reads { pairs.read.push(pair) } else { pairs.sensed.push(pair) }
            }
        }
        let title = "Who hears whom";
        Ok(Some(Figure {
            name: "reach".to_owned(),
            title: title.to_owned(),
            caption: "By the distances of the radio, without shadowing and fading.".to_owned(),
            svg: murmurate_report::figures::reach(title, &places, &pairs)?,
        }))
    }

    /// Returns the length of a message's datagram without link reports \[bytes\].
    fn datagram_bytes(&self) -> usize {
        self.sweep.bytes + super::traffic::FRAMING_BYTES
    }

    fn over_rates(&self, group: &Group) -> Result<Figure, FigureError> {
        let panel = |(title, value): (&str, fn(&Row) -> Option<f64>)| {
            let line = |(name, is): &OnLine| {
                let at = |rate: &f64| {
                    let found = self.results.iter().find(|result| result.1.rate == *rate && is(result));
                    let value = found.and_then(|(source, case, outcome)| value(&Row::of(*source, case, outcome)))?;
                    Some(Point::exactly(value))
                };
                Line { name: name.clone(), points: self.sweep.rates.iter().map(at).collect() }
            };
            let ends = title.ends_with("[%]").then_some((0.0, 100.0));
            Panel { title: title.to_owned(), y: title.to_owned(), ends, lines: group.lines.iter().map(line).collect() }
        };
        let shown = [SHOWN[0], SHOWN[1], SHOWN[3], SHOWN[4]];
        let places: Vec<String> = self.sweep.rates.iter().map(f64::to_string).collect();
        let panels: Vec<Panel> = shown.into_iter().map(panel).collect();
        Ok(Figure {
            name: format!("rates-{}", group.name),
            title: format!("Over the rate: {}", group.title),
            caption:
                "Horizontal: message rate of all stations together. Above: shares of all expected deliveries that \
                 arrived within 20 ms, and at all. Below: share of time in which the medium was busy; age of the \
                 newest message of another station at the control steps, every 50 ms."
                    .to_owned(),
            svg: murmurate_report::figures::sweep(&group.title, "messages/s", &places, &panels)?,
        })
    }

    fn delays(&self, group: &Group, rate: f64) -> Result<Figure, FigureError> {
        let listening = |outcome: &Outcome| Listening {
            due: outcome.due,
            arrived: outcome.arrived,
            delay: outcome.delays,
            steps: 1,
            heard: outcome.ages.total(),
            age: outcome.ages,
        };
        let lines: Vec<(&String, Listening)> = group
            .lines
            .iter()
            .filter_map(|(name, is)| {
                let found = self.results.iter().find(|result| result.1.rate == rate && is(result));
                found.map(|(_, _, outcome)| (name, listening(outcome)))
            })
            .collect();
        let heard: Vec<DelayColumn> = lines.iter().map(|(name, listening)| DelayColumn { name, listening }).collect();
        let title = format!("{}, {rate} messages/s", group.title);
        Ok(Figure {
            name: format!("delay-{}-{rate}", group.name),
            title: format!("Delays: {title}"),
            caption: "Left: from publication to arrival, as a share of all expected deliveries, so that a curve ends \
                      at what was delivered. Right: from publication of the newest message of another station to each \
                      control step. Dashed: 20 and 50 ms."
                .to_owned(),
            svg: murmurate_report::figures::delays(&title, &heard)?,
        })
    }

    /// Returns the HTML page of the report, which contains the figures.
    pub fn page(&self, figures: &[Figure]) -> String {
        let Sweep { stations, bytes, seconds, history, seed, .. } = self.sweep;
        let mut parts = vec![Part::Text(format!(
            "{stations} stations, each to all others; messages of {bytes} bytes; {seconds} s a case; RTPS history \
             {history}; seed {seed}."
        ))];
        parts.extend(self.notes.iter().cloned().map(Part::Text));
        let rows = self.rows();
        let heads: Vec<String> = table::heads(self.sweep);
        let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
        for source in Source::ALL {
            let rows: Vec<Row> = rows.iter().filter(|row| row.source == source).cloned().collect();
            for shown in SHOWN.into_iter().filter(|_| !rows.is_empty()) {
                parts.push(Part::Heading(format!("{}, {source}", shown.0)));
                parts.push(Part::Table(heads.clone(), table::lines(self.sweep, &rows, shown)));
            }
        }
        if !self.grown.is_empty() {
            let (heads, lines) = scale::of_costs(self.grown);
            parts.push(Part::Heading("Cost per robot of growing teams".to_owned()));
            parts.extend(scale::remark(self.grown).map(Part::Text));
            parts.push(Part::Table(heads, lines));
        }
        if let Medium::Radio(radio) = &self.sweep.medium {
            let bytes = self.datagram_bytes();
            let (heads, lines) = scale::of_loads(&saturation::table(radio, bytes));
            parts.push(Part::Heading("Saturation of one channel".to_owned()));
            parts.push(Part::Text(saturation::advice(radio, bytes)));
            parts.push(Part::Table(heads, lines));
        }
        parts.push(Part::Heading("Figures".to_owned()));
        parts.extend(figures.iter().map(Part::Figure));
        parts.push(Part::Heading("What was run".to_owned()));
        parts.push(Part::Verbatim(self.command.to_owned()));
        parts.push(Part::Verbatim(toml::to_string(&self.sweep.medium).expect("a medium is TOML").trim().to_owned()));
        page::page("murmurate study network", &parts)
    }
}
