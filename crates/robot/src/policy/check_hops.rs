//! The table of `murmurate policy check` for a policy file of format 2.

use super::facts::{Facts, drawn, lines, list, made, observation, probe, state};
use murmurate::policy::hops::action::Action;
use murmurate::policy::hops::manifest::{
    Aggregation, Cell, Deviation, Distribution, EdgeFeature, Hop, Layers, Manifest, Memory,
};

/// Returns the table of `policy check` for a policy of several hops: the properties of its file, as text.
pub(super) fn table(facts: &Facts<Manifest>) -> String {
    let manifest = facts.manifest;
    let edge = manifest.edge.iter().map(|feature| match feature {
        EdgeFeature::Age => "age of the message [s]",
        EdgeFeature::RelativePosition => "the neighbour's position - the own [m]",
        EdgeFeature::Distance => "distance [m]",
        EdgeFeature::RelativeVelocity => "the neighbour's velocity - the own [m/s]",
    });
    let distribution = match manifest.distribution {
        Distribution::DiagonalNormal => "diagonal normal distribution",
        Distribution::TanhNormal => "tanh-normal distribution",
    };
    let deviation = match manifest.deviation {
        Deviation::Log => "of log deviations",
        Deviation::BiasedSoftplus => "of deviations by biased softplus",
    };
    let hops = manifest.hops.len();
    let mut rows = vec![
        ("scenario", manifest.scenario.clone()),
        ("architecture", format!("format 2, hops: {hops}; {} parameters", facts.parameters)),
        ("encoder", widths(&manifest.encoder)),
    ];
    rows.extend(manifest.memory.map(|Memory { cell: Cell::Gru, floats, after_gap_s }| {
        ("memory", format!("gated recurrent unit; {}", state(Some((floats, after_gap_s)))))
    }));
    let names: Vec<String> = (0..hops).map(|at| format!("hop {at}")).collect();
    rows.extend(names.iter().map(String::as_str).zip(manifest.hops.iter().map(hop)));
    rows.extend([
        ("decoder", format!("{}; {distribution} {deviation}", widths(&manifest.decoder))),
        ("observation", observation(&manifest.observation)),
        ("edge", list(edge.collect())),
        (
            "action",
            format!(
                "{}, policy frame, at most {} along each axis, {} times a second; {}",
                match manifest.action {
                    Action::Velocity => "velocity [m/s]",
                    Action::Acceleration => "acceleration [m/s2] of the measured velocity",
                },
                manifest.limit_m_s,
                manifest.rate_hz,
                drawn(manifest.draw)
            ),
        ),
        (
            "messages",
            format!(
                "{} floats ({} bytes), used within {} m for {} s",
                facts.latent_bytes / 4,
                facts.latent_bytes,
                manifest.radius_m,
                manifest.hold_s
            ),
        ),
        ("probe", probe(facts)),
        ("made by", made(manifest.training.as_ref())),
        ("digest", facts.digest.to_owned()),
    ]);
    lines(&facts.file, &rows)
}

fn hop(hop: &Hop) -> String {
    let aggregation = match hop.aggregation {
        Aggregation::Sum => "sum",
        Aggregation::Mean => "mean",
        Aggregation::Max => "max",
        Aggregation::Softmax => "softmax",
        Aggregation::DotProduct => "dot product",
    };
    let heads = hop.heads.map_or(String::new(), |heads| format!(" with {heads} heads"));
    let own = if hop.self_loop.is_some() { ", with the robot itself" } else { "" };
    let networks = hop.networks().into_iter().filter_map(|(name, layers)| Some(format!("{name} {}", widths(layers?))));
    let networks: Vec<String> = networks.collect();
    format!(
        "{aggregation}{heads}{own}; {}",
        if networks.is_empty() { "no network".to_owned() } else { networks.join(", ") }
    )
}

fn widths(layers: &Layers) -> String {
    layers.widths.iter().map(usize::to_string).collect::<Vec<_>>().join("-")
}
