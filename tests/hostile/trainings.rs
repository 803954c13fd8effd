//! Readers of trainings and of studies, given any bytes. They panic where one of them does.

use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{self, Settings};
use murmurate_study::columns::Column;
use murmurate_study::conditions::Deployed;
use murmurate_study::record::TrialRecord;
use murmurate_study::results::Results;
use murmurate_study::{Identity, Job, PolicyUnderTest, Study, handling, pages, table};
use murmurate_train::config::Config;
use murmurate_train::imitation;
use murmurate_train::trainer::Trainer;

/// A training's configuration.
pub fn training(bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes).is_ok_and(|text| Config::from_toml(text).is_ok())
}

/// A training's checkpoint.
pub fn checkpoint(bytes: &[u8]) -> bool {
    Trainer::resume(bytes, &Registry::builtin()).is_ok()
}

/// The checkpoint of a training by imitation.
pub fn imitation(bytes: &[u8]) -> bool {
    imitation::trainer::Trainer::resume(bytes, &Registry::builtin()).is_ok()
}

/// A study with one trial of one episode.
pub fn study() -> Study {
    let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
    let tested = PolicyUnderTest {
        policy: "orca".to_owned(),
        model: Model::Orca,
        digest: String::new(),
        handling: &handling::PRESETS[0],
    };
    Study {
        name: "modes",
        columns: vec![Column::of_table("onboard-adhoc").expect("it is a column")],
        policies: vec![tested],
        conditions: Deployed::shared(),
        layouts: Layouts::of_scenario(&*passage, 0, 1),
        repeats: 1,
        seed: 0,
        command: "none".to_owned(),
        build: "none".to_owned(),
        scenario: passage,
        settings: Settings::default(),
    }
}

thread_local! {
    static STUDY: Study = study();
}

/// The journal of a study: the record of a finished trial, or the identity of the study. A record that belongs to
/// the study goes into its table, its figures and its page.
pub fn journal(bytes: &[u8]) -> bool {
    STUDY.with(|study| {
        if let Ok(identity) = serde_json::from_slice::<Identity>(bytes) {
            let _ = study.identity().difference(&identity);
        }
        let Ok(record) = serde_json::from_slice::<TrialRecord>(bytes) else { return false };
        let job = Job { column: 0, policy: 0, repeat: 0 };
        if !record.belongs_to(study, job) {
            return false;
        }
        let results = Results::of(study, &[(job, record)]);
        let figures = pages::figures(study, &results).expect("figures are drawn");
        let page = pages::page(study, &results, &figures);
        page.len() > table::text(study, &results).len()
    })
}
