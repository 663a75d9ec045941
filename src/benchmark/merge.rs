//! Joining the cells of several output folders of one suite.

use super::cell::Cell;
use super::plan::Plan;
use super::run::{PLAN, SUITE, cells_folder};
use super::suite::Suite;
use crate::files;
use crate::{Error, Result};
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What was joined.
#[derive(Debug, Clone, PartialEq)]
pub struct Merged {
    /// The suite that all folders belong to.
    pub suite: Suite,
    /// Its cells.
    pub plan: Plan,
    /// Cells that no folder has.
    pub missing: usize,
    /// Digests of the programs that computed the cells.
    pub builds: BTreeSet<String>,
}

/// Brings the cells of `folders`, each the output of a part of the same suite over the same data,
/// into `output`, which may be one of them.
///
/// # Errors
/// Folders of different suites or data, files that cannot be read, output that cannot be written.
pub fn merge(folders: &[PathBuf], output: &Path) -> Result<Merged> {
    let Some(first) = folders.first() else {
        return Err(Error::input("merge", "no folder", "the outputs of a suite's parts", "name them"));
    };
    let (suite_text, plan_text) = (read(&first.join(SUITE))?, read(&first.join(PLAN))?);
    for folder in &folders[1..] {
        for (name, expected, what) in [(SUITE, &suite_text, "suite"), (PLAN, &plan_text, "data or settings")]
        {
            if read(&folder.join(name))? != *expected {
                return Err(Error::file(
                    folder.join(name),
                    format!("another {what}"),
                    format!("the same {what} as in {}", first.display()),
                    "merge only parts of one suite over one data root",
                ));
            }
        }
    }
    let suite = Suite::load(&first.join(SUITE))?;
    let plan: Plan = serde_json::from_str(&plan_text).map_err(|e| {
        let found = format!("text that does not fit ({e})");
        Error::file(first.join(PLAN), found, "a list of cells", "start that part of the suite again")
    })?;
    let cells = cells_folder(output);
    std::fs::create_dir_all(&cells).map_err(|e| Error::write(&cells, e))?;
    for (name, text) in [(SUITE, &suite_text), (PLAN, &plan_text)] {
        files::write(&output.join(name), |out| out.write_all(text.as_bytes()))?;
    }
    let mut merged = Merged { suite, plan, missing: 0, builds: BTreeSet::new() };
    for planned in &merged.plan.cells {
        let name = planned.key.file_name();
        let places = folders.iter().map(|f| cells_folder(f).join(&name)).filter(|p| p.exists());
        let mut found = None;
        for place in places {
            let cell = Cell::read(&place)?;
            if found.is_none() && cell.hash == planned.hash {
                merged.builds.insert(cell.environment.build.clone());
                found = Some(place);
            }
        }
        let Some(place) = found else {
            merged.missing += 1;
            continue;
        };
        let bytes = crate::files::read(&place)?;
        files::write(&cells.join(&name), |out| out.write_all(&bytes))?;
    }
    Ok(merged)
}

fn read(path: &Path) -> Result<String> {
    crate::files::read_text(path)
}
