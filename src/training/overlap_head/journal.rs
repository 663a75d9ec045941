//! The run's log: one JSON record a line, and a picture of its curves.

use super::validation::Validation;
use crate::files;
use crate::training::run_folder;
use crate::{Error, Result};
use plotters::coord::Shift;
use plotters::prelude::*;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// One line of `metrics.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Record {
    /// A head that was not trained, scored before the first epoch.
    Baseline {
        /// Its name.
        name: String,
        /// Its scores.
        validation: Validation,
    },
    /// An epoch.
    Epoch {
        /// Counted from 1.
        epoch: usize,
        /// Mean loss of its steps.
        loss: f64,
        /// Learning rate.
        learning_rate: f64,
        /// Mean duration of a step, milliseconds.
        step_ms: f64,
        /// Share of the steps' time in which the network waited for its input (crops, dropout, targets).
        outside_share: f64,
        /// Scores, where this epoch was validated.
        validation: Option<Validation>,
    },
}

/// The log of a run, kept whole in memory (a line an epoch) and rewritten as one file, so that it
/// is complete whenever the process ends.
pub(super) struct Journal {
    folder: PathBuf,
    pub records: Vec<Record>,
}

impl Journal {
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_path_buf(), records: Vec::new() }
    }

    /// The log of an interrupted run up to `epoch`; what came after is done again.
    ///
    /// # Errors
    /// When the file is there and cannot be read as a log.
    pub fn resume(folder: &Path, epoch: usize) -> Result<Self> {
        let mut journal = Self::new(folder);
        let path = folder.join(run_folder::METRICS);
        let text = match crate::files::read_text(&path) {
            Ok(text) => text,
            Err(Error::Read { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                return Ok(journal);
            }
            Err(e) => return Err(e),
        };
        for (number, line) in text.lines().enumerate() {
            let record: Record = serde_json::from_str(line).map_err(|e| {
                let found = format!("line {} that cannot be read ({e})", number + 1);
                Error::file(&path, found, "one record a line", "delete the file; training goes on without it")
            })?;
            if !matches!(&record, Record::Epoch { epoch: e, .. } if *e > epoch) {
                journal.records.push(record);
            }
        }
        Ok(journal)
    }

    /// Writes the log, and the picture with it.
    pub fn save(&self) -> Result<()> {
        let mut lines = String::new();
        for record in &self.records {
            let line = serde_json::to_string(record)
                .map_err(|e| Error::write(self.folder.join(run_folder::METRICS), std::io::Error::other(e)))?;
            lines += &line;
            lines.push('\n');
        }
        files::write(&self.folder.join(run_folder::METRICS), |out| out.write_all(lines.as_bytes()))?;
        let path = self.folder.join(run_folder::CURVES);
        let picture = curves(&self.records).map_err(|e| Error::write(&path, std::io::Error::other(e)))?;
        files::write(&path, |out| out.write_all(picture.as_bytes()))
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Series = (String, Vec<(f64, f64)>, RGBColor);

const COLORS: [RGBColor; 4] =
    [RGBColor(31, 119, 180), RGBColor(150, 150, 150), RGBColor(44, 160, 44), RGBColor(214, 39, 40)];

/// Loss, and rank correlation and recall against the untrained heads, over the epochs.
fn curves(records: &[Record]) -> std::result::Result<String, String> {
    let mut loss = Vec::new();
    let (mut spearman, mut recall) = (Vec::new(), Vec::new());
    let mut baselines = Vec::new();
    for record in records {
        match record {
            Record::Baseline { name, validation } => baselines.push((name, validation.mean)),
            Record::Epoch { epoch, loss: value, validation, .. } => {
                loss.push((*epoch as f64, *value));
                if let Some(v) = validation {
                    spearman.push((*epoch as f64, v.mean.spearman));
                    recall.push((*epoch as f64, v.mean.recall_overlap_10));
                }
            }
        }
    }
    let last = loss.last().map_or(1.0, |p| p.0).max(1.0);
    let with_baselines = |own: Vec<(f64, f64)>, get: fn(&super::RetrievalScores) -> f64| {
        let mut all: Vec<Series> = vec![("this head".into(), own, COLORS[0])];
        for ((name, scores), color) in baselines.iter().zip(&COLORS[1..]) {
            all.push(((*name).clone(), vec![(0.0, get(scores)), (last, get(scores))], *color));
        }
        all
    };
    let panels = [
        ("training loss (smooth L1)", vec![("this head".to_owned(), loss, COLORS[0])]),
        ("validation: Spearman of s and overlap", with_baselines(spearman, |s| s.spearman)),
        ("validation: recall at k, overlap above 0.1", with_baselines(recall, |s| s.recall_overlap_10)),
    ];
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (720, 900)).into_drawing_area();
        root.fill(&WHITE).map_err(|e| e.to_string())?;
        for (area, (title, series)) in root.split_evenly((3, 1)).iter().zip(panels) {
            panel(area, title, last, &series).map_err(|e| e.to_string())?;
        }
        root.present().map_err(|e| e.to_string())?;
    }
    Ok(svg)
}

fn panel(
    area: &Area<'_>,
    title: &str,
    last: f64,
    series: &[Series],
) -> std::result::Result<(), Box<dyn std::error::Error>> {
    let values = || series.iter().flat_map(|s| s.1.iter().map(|p| p.1));
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    if !low.is_finite() || !high.is_finite() {
        return Ok(());
    }
    let margin = (0.05 * (high - low)).max(1e-6);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(32)
        .y_label_area_size(56)
        .build_cartesian_2d(0.0..last, low - margin..high + margin)?;
    chart.configure_mesh().x_desc("epoch").light_line_style(WHITE).draw()?;
    for (name, points, color) in series {
        chart
            .draw_series(LineSeries::new(points.iter().copied(), color.stroke_width(2)))?
            .label(name.as_str())
            .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2)));
    }
    if series.len() > 1 {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.2))
            .draw()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn epoch(epoch: usize, validation: Option<Validation>) -> Record {
        Record::Epoch {
            epoch,
            loss: 1.0 / epoch as f64,
            learning_rate: 1e-3,
            step_ms: 1.0,
            outside_share: 0.1,
            validation,
        }
    }

    #[test]
    fn a_resumed_log_ends_at_its_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::new(folder.path());
        let baseline = Record::Baseline { name: "mean pooling".into(), validation: Validation::default() };
        journal.records = vec![baseline.clone(), epoch(1, None), epoch(2, Some(Validation::default()))];
        journal.save().unwrap();
        let resumed = Journal::resume(folder.path(), 1).unwrap();
        assert_eq!(resumed.records, vec![baseline, epoch(1, None)]);
        let svg = std::fs::read_to_string(folder.path().join(run_folder::CURVES)).unwrap();
        assert!(svg.contains("training loss") && svg.contains("mean pooling") && svg.contains("<polyline"));
        std::fs::write(folder.path().join(run_folder::METRICS), "{").unwrap();
        let message = Journal::resume(folder.path(), 1).err().unwrap().to_string();
        assert!(message.contains("line 1"), "{message}");
    }
}
