//! The output folder of a registration: what `scanweave register` and the Python package write.

mod exports;
mod stages;

pub use exports::{Exports, GraphFormat, Registration, TrajectoryFormat};
pub use stages::{StageFolder, kept_features};

use crate::config::Config;
use crate::files::{self, FolderLock, is_same_place};
use crate::geometry::RigidMotion;
use crate::pipeline::{Run, Stopwatch};
use crate::report::{html, protocol};
use crate::result::{self, Document, MergedCloud, RunIdentity, RunReport, ScanSize};
use crate::scan::{PointCloud, Scan, ScanId};
use crate::{Error, Monitor, Result, io};
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Written last: a folder that has it holds a whole result.
pub const POSES: &str = "poses.json";
/// The effective settings.
pub const CONFIG: &str = "config.toml";
/// Predicted and verified overlap of every pair.
pub const OVERLAP: &str = "overlap.csv";
/// Evidence, sizes and times.
pub const REPORT: &str = "report.json";
/// The result as a page.
pub const PAGE: &str = "report.html";
/// The result as a page to print and sign.
pub const PROTOCOL: &str = "registration.html";

const STAGE: &str = "writing the result";

/// A folder that is, or is going to be, a result.
#[derive(Debug)]
pub struct ResultFolder {
    path: PathBuf,
    /// Other runs are kept out for as long as this value lives.
    lock: FolderLock,
}

/// The documents of a finished result.
#[derive(Debug)]
pub struct Written {
    /// `poses.json`.
    pub poses: Document,
    /// `report.json`.
    pub report: RunReport,
}

impl ResultFolder {
    /// Makes the folder and locks it, before hours are spent.
    ///
    /// # Errors
    /// [`Error::OutputExists`] without `force` where it holds a result, [`Error::OutputInUse`], [`Error::Write`].
    pub fn open(path: &Path, force: bool) -> Result<Self> {
        // Before anything is looked for: another run may be about to write it.
        let lock = FolderLock::take(path)?;
        if path.join(POSES).exists() && !force {
            return Err(Error::OutputExists { path: path.to_path_buf() });
        }
        Ok(Self { path: path.to_path_buf(), lock })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Declines scans that this run would write over, or remove as files of an older result.
    ///
    /// # Errors
    /// [`Error::File`] for the first of them.
    pub fn refuse_inputs(&self, scans: &[Scan]) -> Result<()> {
        let of_component = |c| {
            let clouds = [("trajectory", "log"), ("merged", "ply")].map(|(s, e)| numbered(s, c, e));
            clouds.into_iter().chain(exports::files(c))
        };
        let own: BTreeSet<String> = (0..=scans.len())
            .flat_map(of_component)
            .chain([POSES, CONFIG, OVERLAP, REPORT, PAGE].map(str::to_owned))
            .collect();
        for path in scans.iter().filter_map(|s| s.path.as_deref()) {
            let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
            if own.contains(&name)
                && is_same_place(path, &self.path.join(path.file_name().unwrap_or_default()))
            {
                return Err(Error::file(
                    path,
                    "a scan with the name of a file of the result",
                    "scans that the result does not replace",
                    "choose another folder with --output, or rename the scan",
                ));
            }
        }
        Ok(())
    }

    /// Where features are kept for the next run.
    pub fn cache(&self) -> PathBuf {
        self.path.join("cache")
    }

    /// Writes everything into a hidden folder beside the old result, and then puts it in its place,
    /// poses.json last: until the new result is whole, the old one is. `clock` has the stages before the run.
    ///
    /// # Errors
    /// [`Error::Write`], or the user asked to stop.
    pub fn write(
        &self,
        scans: &[Scan],
        run: &Run,
        config: &Config,
        exports: &Exports,
        clock: Stopwatch,
        monitor: &dyn Monitor,
    ) -> Result<Written> {
        let staging = self.lock.stage()?;
        let result = NewResult { place: staging.path(), scans, run, config, monitor };
        let written = result.write(exports, clock).map_err(|e| staging.meant(e))?;
        monitor.check(STAGE)?;
        staging.publish(POSES, || self.remove_old_result(run.reconstruction.components()))?;
        Ok(written)
    }

    /// A result that is being replaced must not pass for whole meanwhile, nor leave the files of components
    /// that the new one, which has `components`, does not replace.
    fn remove_old_result(&self, components: usize) -> Result<()> {
        let remove = |name: &str| {
            let path = self.path.join(name);
            match std::fs::remove_file(&path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::write(&path, e)),
                result => Ok(result.is_ok()),
            }
        };
        // Files for other programs go first, and only with a result: without one, an images.txt is not ours.
        if self.path.join(POSES).exists() {
            remove_each(0, &exports::files, &remove)?;
        }
        remove(POSES)?;
        let of_component =
            |n| [("trajectory", "log"), ("merged", "ply")].map(|(s, e)| numbered(s, n, e)).to_vec();
        remove_each(components.max(1), &of_component, &remove)
    }
}

/// A result on its way into the folder `place`.
struct NewResult<'a> {
    place: &'a Path,
    scans: &'a [Scan],
    run: &'a Run,
    config: &'a Config,
    monitor: &'a dyn Monitor,
}

impl NewResult<'_> {
    fn write(&self, exports: &Exports, mut clock: Stopwatch) -> Result<Written> {
        let Self { place, scans, run, config, monitor } = *self;
        monitor.check(STAGE)?;
        clock.stages.extend(run.timings.iter().cloned());
        let mut poses = Document::new(scans, &run.reconstruction, run.scale.inlier_radius_m);
        let settings = config.to_toml()?;
        let id = result::run_id(&poses, &settings);
        clock.time("writing", || -> Result<()> {
            let clouds = self.write_clouds(&id)?;
            self.write_overlaps(&poses)?;
            let registration = Registration {
                inlier_radius_m: run.scale.inlier_radius_m,
                pose_graph: run.pose_graph.as_ref(),
            };
            exports.write(place, &poses, &registration)?;
            self.write_text(CONFIG, &settings)?;
            let written = clouds.into_iter().chain([OVERLAP, CONFIG].map(str::to_owned));
            let files = result::digests_of_files(place, written)?;
            poses.run = Some(RunIdentity { id: id.clone(), files });
            Ok(())
        })?;
        let mut report = report(scans, run, config, &poses, clock);
        let mut clock = Stopwatch::default();
        clock.time("page", || self.write_pages(&poses, &report, &settings))?;
        report.add_times(clock.stages);
        self.write_text(REPORT, &report.to_json())?;
        self.write_text(POSES, &poses.to_json())?;
        Ok(Written { poses, report })
    }

    fn write_pages(&self, poses: &Document, report: &RunReport, settings: &str) -> Result<()> {
        let Self { scans, run, config, monitor, .. } = *self;
        monitor.check(STAGE)?;
        let page = html_page(scans, run, poses, report, settings)?;
        monitor.check(STAGE)?;
        self.write_text(PAGE, &page)?;
        let reference = config.output.reference.as_deref();
        let input = protocol::Input { poses, run: report, reference };
        self.write_text(PROTOCOL, &protocol::page(&input))
    }

    fn write_overlaps(&self, poses: &Document) -> Result<()> {
        let Self { run, monitor, .. } = *self;
        let written = files::write(&self.place.join(OVERLAP), |out| {
            result::write_overlaps_csv(out, &run.similarity, poses, monitor)
        });
        // A user who asks to stop is no failure to write.
        monitor.check(STAGE)?;
        written
    }

    /// A trajectory and a merged cloud for every component; the first carries no number. Returns the names.
    fn write_clouds(&self, id: &str) -> Result<Vec<String>> {
        let Self { place, scans, run, config, monitor } = *self;
        let mut written = Vec::new();
        let voxel_m = config.output.merged_voxel_m.unwrap_or(0.5 * run.scale.voxel_m) as f32;
        for component in 0..run.reconstruction.components().max(1) {
            monitor.check(STAGE)?;
            let cloud = MergedCloud::new(scans, &run.reconstruction, component, voxel_m);
            let scan: Vec<i32> = cloud.scan.iter().map(|&s| s as i32).collect();
            let names = [("merged", "ply"), ("trajectory", "log")].map(|(s, e)| numbered(s, component, e));
            io::write_ply(
                place.join(&names[0]),
                &io::PlyCloud {
                    points: &cloud.points,
                    origin_m: cloud.origin_m,
                    colors: cloud.colors.as_deref(),
                    scans: Some(&scan),
                    run: Some(id),
                    ..io::PlyCloud::default()
                },
            )?;
            let poses: Vec<_> = placed_in(run, component).collect();
            io::write_log_trajectory(place.join(&names[1]), &poses)?;
            written.extend(names);
        }
        Ok(written)
    }

    fn write_text(&self, name: &str, text: &str) -> Result<()> {
        files::write(&self.place.join(name), |out| out.write_all(text.as_bytes()))
    }
}

impl Written {
    /// Both documents in one, for `--json`.
    pub fn to_json(&self, folder: &Path) -> String {
        let document = serde_json::json!({
            "output": folder.display().to_string(),
            "poses": self.poses,
            "report": self.report,
        });
        format!("{document:#}\n")
    }
}

/// The `poses.json` of a result, which is declined where its folder holds files of another run too.
///
/// # Errors
/// [`Error::File`] for a folder without a whole result or with files of several, [`Error::Read`].
pub fn load_poses(folder: &Path) -> Result<Document> {
    let poses = load_poses_for_pages(folder)?;
    result::check_pages(&poses, folder, &[PAGE, PROTOCOL])?;
    Ok(poses)
}

/// [`load_poses`] whatever the pages show, which are made anew.
///
/// # Errors
/// As [`load_poses`].
pub fn load_poses_for_pages(folder: &Path) -> Result<Document> {
    let is_there = |name: &&str| folder.join(name).exists();
    if let (false, Some(name)) = (is_there(&POSES), [OVERLAP, REPORT, PAGE].iter().find(|n| is_there(n))) {
        return Err(Error::file(
            folder,
            format!("{name} and no {POSES}, which is written last"),
            "a whole result",
            "the run that was to write it did not end: register again",
        ));
    }
    let poses = Document::load(&folder.join(POSES))?;
    let merged: Vec<String> = (0..poses.components.len()).map(|c| numbered("merged", c, "ply")).collect();
    result::check_folder(&poses, folder, REPORT, &merged)?;
    Ok(poses)
}

/// The merged clouds of a result with so many components.
pub fn merged_files(folder: &Path, components: usize) -> Vec<PathBuf> {
    (0..components).map(|c| folder.join(numbered("merged", c, "ply"))).collect()
}

/// Removes the files of component after component from the first, as long as there are any.
fn remove_each(
    first: usize,
    files: &dyn Fn(usize) -> Vec<String>,
    remove: &dyn Fn(&str) -> Result<bool>,
) -> Result<()> {
    for component in first.. {
        let removed = files(component).iter().map(|name| remove(name)).collect::<Result<Vec<bool>>>()?;
        if component > 0 && !removed.contains(&true) {
            break;
        }
    }
    Ok(())
}

/// `merged.ply` of the first component, `merged_1.ply` of the second.
pub fn numbered(stem: &str, component: usize, extension: &str) -> String {
    match component {
        0 => format!("{stem}.{extension}"),
        n => format!("{stem}_{n}.{extension}"),
    }
}

/// The page of a registration that is not written into a folder.
///
/// # Errors
/// Settings that TOML has no spelling for.
pub fn page(scans: &[Scan], run: &Run, config: &Config) -> Result<String> {
    let poses = Document::new(scans, &run.reconstruction, run.scale.inlier_radius_m);
    let clock = Stopwatch { stages: run.timings.clone() };
    let report = report(scans, run, config, &poses, clock);
    html_page(scans, run, &poses, &report, &config.to_toml()?)
}

fn html_page(
    scans: &[Scan],
    run: &Run,
    poses: &Document,
    report: &RunReport,
    settings: &str,
) -> Result<String> {
    let clouds: Vec<&PointCloud> = scans.iter().map(|s| &s.cloud).collect();
    html::page(&html::Input {
        poses,
        run: report,
        config: settings,
        similarity: Some(&run.similarity),
        clouds: &clouds,
        sources: &vec![html::PointSource::Scan; scans.len()],
        surfaces: &run.surfaces,
        frames: &run.frames,
        truth: None,
    })
}

fn placed_in(run: &Run, component: usize) -> impl Iterator<Item = (ScanId, RigidMotion)> {
    let outcomes = run.reconstruction.outcomes.iter().enumerate();
    outcomes.filter_map(move |(scan, outcome)| {
        let placement = outcome.placement().filter(|p| p.component == component)?;
        Some((ScanId(scan), placement.world_from_scan))
    })
}

fn report(scans: &[Scan], run: &Run, config: &Config, poses: &Document, clock: Stopwatch) -> RunReport {
    let size = |i: usize| ScanSize {
        points: scans[i].cloud.len(),
        dropped_rows: scans[i].cloud.dropped_rows,
        stray_points: scans[i].cloud.stray_points,
        surface_points: run.surfaces[i].len(),
        keypoints: run.features[i].len(),
        features_reused: run.reused[i],
    };
    RunReport {
        generator: poses.generator.clone(),
        run_id: poses.run.as_ref().map(|run| run.id.clone()),
        seed: config.seed,
        preset: config.preset.clone(),
        threads: rayon::current_num_threads(),
        scale: run.scale,
        overlap_head: run.head.to_string(),
        method: config.method_name(),
        registered_pairs: run.pose_graph.as_ref().map(|g| g.registered_pairs),
        pair_seconds: run.pose_graph.as_ref().map(|g| g.registration_seconds),
        edges: run.pose_graph.as_ref().map(|g| g.edges.len()),
        placed: run.reconstruction.placed(),
        declined: scans.len() - run.reconstruction.placed(),
        components: run.reconstruction.components(),
        evidence: result::rows(poses),
        sizes: (0..scans.len()).map(size).collect(),
        total_seconds: clock.stages.iter().map(|t| t.seconds).sum(),
        timings: clock.stages,
        peak_memory_bytes: result::peak_memory_bytes(),
    }
}
