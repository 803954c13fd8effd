//! Report of a twin: its figures and its page.

use super::comparison::Row;
use super::links::Crossing;
use super::observed::Run;
use super::predict::Predicted;
use murmurate::config::shown::counted;
use murmurate::results::listening::Listening;
use murmurate::time::Span;
use murmurate_report::figures::page::{self, Part};
use murmurate_report::figures::{DelayColumn, Figure, FigureError, Makespans};

/// Texts and numbers for the report page of a twin.
#[derive(Clone, Debug)]
pub struct Words {
    /// Name of the run and of its team.
    pub title: String,
    /// Command that repeats the report.
    pub command: String,
    /// Number of episodes to which the model was fitted, and number of episodes that it predicted.
    pub episodes: [usize; 2],
    /// Number of repeats of the prediction.
    pub repeats: usize,
    /// Notes for the report on what the records contain and what they do not.
    pub notes: Vec<String>,
}

/// Draws the figures of a prediction beside the measured run: makespans, and ages of messages. `first` is the first
/// episode of `run` that was predicted. Without predictions they are the delays of messages, if any crossed hosts.
pub fn figures(run: &Run, first: usize, predicted: &[Predicted]) -> Result<Vec<Figure>, FigureError> {
    if predicted.is_empty() {
        return arrivals(run, first);
    }
    let simulated = predicted.iter().flat_map(|one| &one.episodes);
    let measured = run.episodes[first..].iter();
    let rows = [
        Makespans {
            name: "predicted".to_owned(),
            values_s: simulated.clone().filter_map(|episode| episode.makespan_s).collect(),
            episodes: simulated.count(),
        },
        Makespans {
            name: "measured".to_owned(),
            values_s: measured.clone().filter_map(|episode| episode.makespan_s).collect(),
            episodes: measured.count(),
        },
    ];
    let caption = "The area under a line is the share of successes; dashed: medians.";
    let mut all = vec![Figure {
        name: "makespans".to_owned(),
        title: "Makespan".to_owned(),
        caption: caption.to_owned(),
        svg: murmurate_report::figures::makespans("Makespan", &rows, "predicted")?,
    }];
    let ages = |ages_s: &mut dyn Iterator<Item = f64>| {
        let mut listening = Listening::default();
        for age_s in ages_s {
            listening.age.add(Span::from_secs(age_s.max(0.0)));
            (listening.due, listening.heard) = (listening.due + 1, listening.heard + 1);
        }
        listening
    };
    let simulated = predicted.iter().flat_map(|one| &one.decisions).flat_map(|one| one.ages_s.iter().copied());
    let measured = run.decisions[first..].iter().flat_map(|one| one.ages_s.iter().copied());
    let both = [ages(&mut { simulated }), ages(&mut { measured })];
    if both.iter().all(|listening| listening.due > 0) {
        let heard = [("predicted", &both[0]), ("measured", &both[1])];
        let heard = heard.map(|(name, listening)| DelayColumn { name, listening });
        let caption = "From the publication of a message to a control step that uses it, over all messages in use.";
        all.push(Figure {
            name: "ages".to_owned(),
            title: "Ages of messages at decisions".to_owned(),
            caption: caption.to_owned(),
            svg: murmurate_report::figures::ages("Ages of messages at decisions", &heard)?,
        });
    }
    Ok(all)
}

/// Draws the delays of the messages that were sent before the episode `first`, to which the model was fitted, and of
/// those after. There is no figure without messages, nor if by different clocks some arrive before they were sent.
fn arrivals(run: &Run, first: usize) -> Result<Vec<Figure>, FigureError> {
    let took = |crossing: &Crossing| crossing.took_ns.map(|took_ns| u64::try_from(took_ns).ok());
    if run.crossings.is_empty() || run.crossings.iter().any(|crossing| took(crossing) == Some(None)) {
        return Ok(Vec::new());
    }
    let mut halves = [Listening::default(); 2];
    for crossing in &run.crossings {
        let listening = &mut halves[usize::from(crossing.episode as usize >= first)];
        listening.due += 1;
        if let Some(took_ns) = took(crossing).flatten() {
            listening.arrived += 1;
            listening.delay.add(Span::from_nanos(took_ns));
        }
    }
    let columns = [("fitted", &halves[0]), ("the other episodes", &halves[1])];
    let columns = columns.map(|(name, listening)| DelayColumn { name, listening });
    Ok(vec![Figure {
        name: "delays".to_owned(),
        title: "Delays of messages".to_owned(),
        caption:
            "Of each message and receiver, by the clocks of the files. A line that ends below 1 has lost the rest."
                .to_owned(),
        svg: murmurate_report::figures::arrivals("Delays of messages", &columns)?,
    }])
}

/// Returns the report page as HTML.
pub fn page(words: &Words, rows: &[Row], figures: &[Figure]) -> String {
    let [fitted, predicted] = words.episodes;
    let outside = rows.iter().filter(|row| !row.agrees).count();
    let verdict = match outside {
        0 if rows.is_empty() => "Nothing was fitted, so nothing is compared.".to_owned(),
        0 => "Every measurement agrees with its prediction.".to_owned(),
        1 => "One measurement lies outside its bar.".to_owned(),
        more => format!("{more} measurements lie outside their bars."),
    };
    let told = if words.repeats == 0 {
        format!(
            "The model was fitted to the first {fitted} episodes. Beside it stands the same fit to the other \
             {predicted}. {verdict}"
        )
    } else {
        format!(
            "The model was fitted to the first {fitted} episodes. It was then run {} with the layouts of the \
         other {predicted}, and its results stand beside what was measured in those. {verdict}",
            counted(words.repeats, "time")
        )
    };
    let mut parts = vec![
        Part::Text(told),
        Part::Table(Row::HEADS.to_vec(), rows.iter().map(|row| row.cells().to_vec()).collect()),
        Part::Text(
            "Intervals of predictions: of success, that of the binomial distribution for as many episodes; of \
             makespans and ages, that of single repeats; of lag and links, the bootstrap over the fitted episodes. \
             Intervals of measurements: Wilson's for success, else the bootstrap over the predicted episodes. Lag and \
             links were measured by the same fit on the predicted episodes."
                .to_owned(),
        ),
    ];
    parts.extend(figures.iter().map(Part::Figure));
    parts.push(Part::Heading("Notes".to_owned()));
    parts.extend(words.notes.iter().cloned().map(Part::Text));
    parts.push(Part::Heading("Command".to_owned()));
    parts.push(Part::Verbatim(words.command.clone()));
    page::page(&words.title, &parts)
}
