//! The output folder of `study twin`: report, table, rows, and the fitted model as files that other commands take.

use std::path::Path;

use anyhow::Result;
use serde::{Deserialize, Serialize};

use super::super::folder::Folder;
use murmurate::deploy::Deployment;
use murmurate::deploy::conditions::Conditions;
use murmurate::trial::Trial;
use murmurate_study::origin;
use murmurate_study::twin::comparison::Row;
use murmurate_study::twin::model::{Fitted, rounded};
use murmurate_study::twin::observed::Run;
use murmurate_study::twin::pages::{self, Words};
use murmurate_study::twin::predict::Predicted;

/// What identifies the twin of a folder, stored in it: a folder with another identity is refused.
#[derive(PartialEq, Serialize, Deserialize)]
struct Identity {
    study: String,
    version: String,
    build: String,
    command: String,
    /// Name and digest of each record to which the twin is fitted.
    records: Vec<String>,
}

/// Opens or creates the output folder of a twin (model of a recorded run). `digests` has the name and digest of each
/// record; `command` is the command line. Fails if the folder belongs to another twin.
pub fn open(path: &Path, digests: &[String], command: &str) -> Result<Folder> {
    let identity = Identity {
        study: "twin".to_owned(),
        version: origin::VERSION.to_owned(),
        build: murmurate_robot::build::digest().to_owned(),
        command: command.to_owned(),
        records: digests.to_vec(),
    };
    Folder::open(path, "figures", &identity, |theirs: &Identity| {
        let differs = |same: bool, what: &str| (!same).then(|| format!("its {what} differ"));
        differs(identity.study == theirs.study, "studies")
            .or(differs(identity.records == theirs.records, "records"))
            .or(differs(identity.command == theirs.command, "flags"))
            .or(differs(identity == *theirs, "version or build"))
    })
}

/// Writes the files of a twin (model of a recorded run) into its folder: rows and table of the comparison, the fitted
/// conditions, the deployment if episodes were predicted, the figures, and the report's page.
///
/// `words` are the page's texts, and `text` is the table. `first` is the index of the first episode of `run` that was
/// predicted, and `predicted` has the results of each repeat of the prediction.
pub fn write(
    folder: &Folder,
    words: &Words,
    (run, first, predicted): (&Run, usize, &[Predicted]),
    (rows, text): (&[Row], &str),
    (conditions, deployment): (&Conditions, Option<&Deployment>),
) -> Result<()> {
    folder.write_json("rows.json", &rows)?;
    folder.write("table.txt", format!("{text}\n").as_bytes())?;
    let head = format!("# Fitted by '{}'.\n", words.command);
    if let Some(deployment) = deployment.filter(|_| !predicted.is_empty()) {
        folder.write("deployment.toml", (head.clone() + &deployment.to_toml()).as_bytes())?;
    }
    folder.write("conditions.toml", (head + &conditions.to_toml()).as_bytes())?;
    let figures = pages::figures(run, first, predicted)?;
    folder.write_page(&figures, &pages::page(words, rows, &figures))
}

/// Returns the fitted model of a team as conditions for other commands: the plant with its lag and slip, and delay and
/// loss of the link that carries latents (`None` if no link does).
pub fn of_team(fitted: &Fitted, twin: &Trial) -> Conditions {
    use murmurate::messages::wire::Kind;
    let carries = |kind: &Kind| *kind == Kind::Latent;
    let link = twin.deployment.links.iter().position(|link| link.carries.iter().any(carries));
    let link = link.map(|at| &twin.deployment.links[at]);
    let slips = fitted.slip.is_some();
    Conditions {
        plant: Some(twin.deployment.plant.clone()),
        lag_s: Some(twin.physics.lag_s),
        slip: slips.then_some(twin.physics.slip),
        slip_s: slips.then_some(twin.physics.slip_s),
        hull_m: twin.deployment.hull_m,
        scale: twin.deployment.scale,
        delay_s: link.map(|link| link.delay_s),
        loss: link.map(|link| link.loss),
    }
}

/// Returns the fitted model of an imported run as conditions for other commands. What was not fitted is left out.
pub fn of_import(fitted: &Fitted, hull_m: Option<f32>) -> Conditions {
    let Fitted { lag_s, slip, all_links, .. } = fitted;
    Conditions {
        // The plant that has a slip.
        plant: slip.map(|_| "rigid".to_owned()),
        lag_s: lag_s.map(|lag_s| rounded(lag_s.value, 1e4) as f32),
        slip: slip.map(|slip| rounded(slip.share.value, 1e4) as f32),
        slip_s: slip.map(|slip| rounded(slip.time_s, 1e3) as f32),
        hull_m,
        scale: None,
        delay_s: all_links.and_then(|link| link.delay_s).map(|delay_s| rounded(delay_s.value, 1e6)),
        loss: all_links.and_then(|link| link.loss).map(|loss| rounded(loss.value.clamp(0.0, 1.0), 1e4)),
    }
}
