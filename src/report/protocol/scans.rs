//! The tables of scans: where they stand, how precisely, and which were declined.

use super::Input;
use super::network::Network;
use super::precision::{Deviations, LIMIT_DEG, in_words};
use super::table::{self, NONE, Table, heading, millimetres, paragraph, probability};
use crate::geometry::motion_from_matrix;
use crate::result::{Document, Entry, EntryOutcome, Pose};
use crate::scan::Doubt;
use nalgebra::{Matrix4, Point3};
use std::path::{Path, PathBuf};

/// One table of placed scans a component.
pub(super) fn placed(input: &Input<'_>, network: &Network<'_>, out: &mut String) {
    let head = [
        ("No.", true),
        ("Scan", false),
        ("File", false),
        ("Points", true),
        ("Centre X (m)", true),
        ("Y (m)", true),
        ("Z (m)", true),
        ("Probability", true),
        ("Pairs", true),
        ("Overlap (%)", true),
        ("Cloud to cloud (mm)", true),
        ("Parent", false),
        ("Doubts", false),
    ];
    heading("Placed scans", out);
    let folder = common_folder(input.poses);
    if !folder.as_os_str().is_empty() {
        paragraph(&format!("Files are in {}.", folder.display()), out);
    }
    let mut at_origin = false;
    for (number, component) in input.poses.components.iter().enumerate() {
        let mut table = Table::new(caption(number, component.scans.len()), &head);
        for (id, entry, pose) in members(input, network, &component.scans) {
            let (centre, known) = centre(pose);
            at_origin |= !known;
            let place = |axis: usize| {
                let text = table::coordinate(centre[axis], input.run.scale.inlier_radius_m);
                if known { text } else { text + " *" }
            };
            let (overlap, distance_m) = network.agreement(id);
            let doubts: Vec<&str> = pose.doubts.iter().map(doubt).collect();
            table.row([
                id.to_string(),
                entry.name.clone(),
                file(entry, &folder),
                points(input, id),
                place(0),
                place(1),
                place(2),
                pose.evidence.and_then(|e| e.probability).map_or(NONE.to_owned(), probability),
                network.touching[id].to_string(),
                overlap.map_or(NONE.to_owned(), table::percent),
                distance_m.map_or(NONE.to_owned(), millimetres),
                pose.parent.map_or("pivot".to_owned(), |p| name(input, p)),
                doubts.join(", "),
            ]);
        }
        table.write(out);
    }
    if input.poses.components.is_empty() {
        paragraph("No scan is placed.", out);
    }
    if at_origin {
        paragraph("* The centre is not known: this is where the origin of the file's coordinates lies.", out);
    }
    paragraph(
        "Pairs: other scans that it touches. Overlap: the largest with another. Cloud to cloud: the median over \
         its pairs. Ambiguous: another pose is not ruled out. Poorly localised: the stated deviation of the centre is \
         above the inlier radius, or that of the rotation above 5 degrees.",
        out,
    );
}

/// One table of stated deviations a component, with the rule of its words.
pub(super) fn precision(input: &Input<'_>, network: &Network<'_>, out: &mut String) {
    let head = [
        ("No.", true),
        ("Scan", false),
        ("Along X (mm)", true),
        ("Y (mm)", true),
        ("Z (mm)", true),
        ("About X (deg)", true),
        ("Y (deg)", true),
        ("Z (deg)", true),
        ("Least held along", true),
        ("Deviation there (mm)", true),
        ("Strength", false),
    ];
    let tau = input.run.scale.inlier_radius_m;
    heading("Stated standard deviations", out);
    for (number, component) in input.poses.components.iter().enumerate() {
        let mut table = Table::new(caption(number, component.scans.len()), &head);
        for (id, entry, pose) in members(input, network, &component.scans) {
            let mut cells = vec![id.to_string(), entry.name.clone()];
            match Deviations::of(pose.pose_uncertainty.as_deref()) {
                Some(d) if !(d.is_zero() && pose.parent.is_none()) => {
                    cells.extend(d.along_m.map(millimetres));
                    cells.extend(d.about_rad.map(table::degrees));
                    let (direction, deviation) = d.least_held;
                    cells.push(format!(
                        "({}, {}, {})",
                        part(direction.x),
                        part(direction.y),
                        part(direction.z)
                    ));
                    cells.push(millimetres(deviation));
                    cells.push(in_words(&d.strengths(tau)));
                }
                stated => {
                    cells.extend((0..8).map(|_| NONE.to_owned()));
                    let words = if stated.is_some() { "pivot: others refer to it" } else { "not measured" };
                    cells.push(words.to_owned());
                }
            }
            table.row(cells);
        }
        table.write(out);
    }
    let text = format!(
        "Relative to the pivot, in the component's frame; along the axes for the scan's centre. Rule for the \
         strength: a deviation below a tenth of the limit is held, up to the limit weakly held, above it not \
         held. The limit is the inlier radius \u{3c4} = {} m along an axis and {LIMIT_DEG} degrees about one. Not \
         measured: the result states no covariance. Least held: the direction, as a unit vector, along which the \
         position of the centre is least certain.",
        table::significant(tau)
    );
    paragraph(&text, out);
}

/// The scans without a pose.
pub(super) fn declined(input: &Input<'_>, out: &mut String) {
    let head = [("No.", true), ("Scan", false), ("File", false), ("Points", true), ("Reason", false)];
    let mut table = Table::new("", &head);
    let folder = common_folder(input.poses);
    let mut any = false;
    for (id, entry) in input.poses.scans.iter().enumerate() {
        if let EntryOutcome::Declined { explanation, .. } = &entry.outcome {
            any = true;
            let cells = [
                id.to_string(),
                entry.name.clone(),
                file(entry, &folder),
                points(input, id),
                explanation.clone(),
            ];
            table.row(cells);
        }
    }
    heading("Declined scans", out);
    if any {
        table.write(out);
    } else {
        paragraph("None.", out);
    }
}

/// Where the scan's centre lies in its component, and whether that is known; else where the origin of its
/// file's coordinates lies.
pub(super) fn centre(pose: &Pose) -> (Point3<f64>, bool) {
    let matrix = Matrix4::from_fn(|r, c| pose.world_from_scan[r][c]);
    let motion = motion_from_matrix(&matrix, 1e-6).map(|m| m.0);
    let centre = pose.pose_uncertainty.as_ref().and_then(|u| u.centre);
    match (centre, motion) {
        (Some(centre), Some(motion)) => (motion * centre, true),
        _ => (Point3::new(matrix[(0, 3)], matrix[(1, 3)], matrix[(2, 3)]), false),
    }
}

/// Name of a scan, for a number that may be none.
pub(super) fn name(input: &Input<'_>, scan: usize) -> String {
    input.poses.scans.get(scan).map_or_else(|| format!("scan {scan}"), |e| e.name.clone())
}

fn caption(number: usize, scans: usize) -> String {
    format!("Component {}, {scans} scan{}", number + 1, if scans == 1 { "" } else { "s" })
}

/// The placed ones of these scans.
fn members<'a>(
    input: &Input<'a>,
    network: &Network<'a>,
    scans: &[usize],
) -> Vec<(usize, &'a Entry, &'a Pose)> {
    let of = |&id: &usize| Some((id, input.poses.scans.get(id)?, network.poses.get(id).copied().flatten()?));
    scans.iter().filter_map(of).collect()
}

/// The file within `folder`, and which scan of it, counted from 1 as names do.
fn file(entry: &Entry, folder: &Path) -> String {
    let Some(file) = entry.file.as_deref() else { return NONE.to_owned() };
    let within = Path::new(file).strip_prefix(folder).unwrap_or(Path::new(file)).display();
    entry.part.map_or(within.to_string(), |part| format!("{within} #{}", part + 1))
}

/// The innermost folder that all files are in; empty where there is none.
fn common_folder(poses: &Document) -> PathBuf {
    let mut folders = poses.scans.iter().filter_map(|e| Path::new(e.file.as_deref()?).parent());
    let Some(first) = folders.next() else { return PathBuf::new() };
    let shared = |a: &Path, b: &Path| {
        a.components().zip(b.components()).take_while(|(x, y)| x == y).map(|(x, _)| x).collect::<PathBuf>()
    };
    folders.fold(first.to_path_buf(), |folder, other| shared(&folder, other))
}

fn points(input: &Input<'_>, scan: usize) -> String {
    input.run.sizes.get(scan).map_or(NONE.to_owned(), |s| s.points.to_string())
}

fn doubt(doubt: &Doubt) -> &'static str {
    match doubt {
        Doubt::Ambiguous => "ambiguous",
        Doubt::PoorlyLocalised => "poorly localised",
        _ => "doubtful",
    }
}

/// A part of a unit vector, without a negative zero.
fn part(value: f64) -> String {
    let text = format!("{value:.2}");
    if text == "-0.00" { "0.00".to_owned() } else { text }
}
