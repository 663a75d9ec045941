//! What a table without names holds in place of coordinates: an index, times, poses.
//!
//! Only what is so in every row of the file counts: a line of an organised scan may run along an axis.

use super::grammar::Grammar;
use nalgebra::{Matrix3, Vector4};

/// Largest deviation of the norm of a written quaternion, or of `RᵀR` from the identity, by rounding.
const ROUNDING: f64 = 5e-3;
/// Largest ratio of two steps between times: rounding to the last digit doubles a short one.
const EVEN_STEPS: f64 = 2.0;
/// Seconds and less since 1970 or 1980 are larger than any coordinate.
const LARGE_TIME: f64 = 1e8;
/// Times of one scan differ by so much of their size at most: a tenth of a year since 1970.
const TIME_SPREAD: f64 = 2e-3;
/// Fewest rows that tell.
const FEWEST: usize = 10;

/// What was seen of the rows so far.
pub(super) struct Watch {
    rows: usize,
    columns: [Column; 3],
    poses: Option<Poses>,
    last_time: f64,
    /// Largest size of the last of seven columns, which is a curvature after a normal if it stays small.
    largest_last: f64,
}

/// How the values of one column follow each other.
#[derive(Clone, Copy)]
struct Column {
    first: f64,
    last: f64,
    by_one: bool,
    never_falls: bool,
    shortest: f64,
    longest: f64,
}

/// How the rows write poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Poses {
    /// t qx qy qz qw.
    Quaternion,
    /// Time before that.
    TimeQuaternion,
    /// A 3×4 matrix, or 4×4.
    Matrix,
}

impl Watch {
    pub(super) fn new(width: usize) -> Self {
        let poses = match width {
            7 => Some(Poses::Quaternion),
            8 => Some(Poses::TimeQuaternion),
            12 | 16 => Some(Poses::Matrix),
            _ => None,
        };
        let column = Column {
            first: f64::NAN,
            last: f64::NAN,
            by_one: true,
            never_falls: true,
            shortest: f64::INFINITY,
            longest: 0.0,
        };
        Self { rows: 0, columns: [column; 3], poses, last_time: f64::NEG_INFINITY, largest_last: 0.0 }
    }

    /// Takes in one more row and its first three numbers.
    #[inline]
    pub(super) fn add(&mut self, first_three: [f64; 3], fields: &[&str], grammar: &Grammar) {
        for (column, value) in self.columns.iter_mut().zip(first_three) {
            column.add(value, self.rows == 0);
        }
        if let Some(poses) = self.poses
            && !self.is_pose(poses, fields, grammar)
        {
            self.poses = None;
        }
        self.rows += 1;
    }

    fn is_pose(&mut self, poses: Poses, fields: &[&str], grammar: &Grammar) -> bool {
        let mut values = [0.0; 16];
        if fields.len() > values.len() {
            return false;
        }
        for (value, field) in values.iter_mut().zip(fields) {
            match grammar.number(field) {
                Some(v) => *value = v,
                None => return false,
            }
        }
        let unit = |at: usize| {
            let q = Vector4::from_column_slice(&values[at..at + 4]);
            (q.norm() - 1.0).abs() < ROUNDING
        };
        match (poses, fields.len()) {
            (Poses::Quaternion, 7) => {
                self.largest_last = self.largest_last.max(values[6].abs());
                unit(3)
            }
            (Poses::TimeQuaternion, 8) => {
                let later = values[0] > self.last_time;
                self.last_time = values[0];
                later && unit(4)
            }
            (Poses::Matrix, 12 | 16) => {
                let r = Matrix3::from_fn(|row, column| values[4 * row + column]);
                let rotation =
                    (r.transpose() * r - Matrix3::identity()).amax() < ROUNDING && r.determinant() > 0.0;
                rotation && (fields.len() == 12 || values[12..] == [0.0, 0.0, 0.0, 1.0])
            }
            _ => false,
        }
    }

    /// How every row writes a pose, if they do.
    pub(super) fn poses(&self) -> Option<&'static str> {
        match self.poses.filter(|_| self.rows > 0)? {
            Poses::Quaternion if self.largest_last < 0.1 => None,
            Poses::Quaternion => Some("tx ty tz qx qy qz qw"),
            Poses::TimeQuaternion => Some("time tx ty tz qx qy qz qw"),
            Poses::Matrix => Some("rotation matrix and translation"),
        }
    }

    /// The first of the three columns that is no coordinate, from zero, and what it looks like.
    pub(super) fn no_coordinate(&self) -> Option<(usize, &'static str)> {
        let said = |(c, column): (usize, &Column)| column.no_coordinate().map(|what| (c, what));
        if self.rows < FEWEST { None } else { self.columns.iter().enumerate().find_map(said) }
    }
}

impl Column {
    #[inline]
    fn add(&mut self, value: f64, first: bool) {
        if first {
            self.first = value;
            self.by_one = value.fract() == 0.0;
        } else if self.never_falls {
            let step = value - self.last;
            self.by_one &= step == 1.0;
            // Not so for NaN either.
            self.never_falls = step >= 0.0;
            self.shortest = self.shortest.min(step);
            self.longest = self.longest.max(step);
        }
        self.last = value;
    }

    fn no_coordinate(&self) -> Option<&'static str> {
        if !self.never_falls || self.longest == 0.0 {
            return None;
        }
        if self.by_one {
            return Some("an index: it counts by one");
        }
        let even = self.shortest > 0.0 && self.longest <= EVEN_STEPS * self.shortest;
        let since_epoch = self.first > LARGE_TIME && self.last - self.first < TIME_SPREAD * self.last;
        if even || since_epoch { Some("times: it grows evenly from row to row") } else { None }
    }
}
