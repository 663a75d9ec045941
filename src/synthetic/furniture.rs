//! Where furniture stands in a room.

use super::building::{Door, Room, WALK_INSET_M, tint};
use super::pieces::{
    Piece, bed, boxes, cabinet, chair, clutter, desk, dining, floor_lamp, plant, shelf, sideboard, sofa,
    table,
};
use super::shape::{Primitive, Shape};
use nalgebra::{Isometry3, Rotation2, UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Free depth in front of a door, metres from the wall's middle line.
const DOOR_CLEAR_M: f64 = 1.25;

/// A rectangle on the floor.
#[derive(Debug, Clone, Copy)]
struct Footprint {
    center: Vector2<f64>,
    half: Vector2<f64>,
    yaw: f64,
}

impl Footprint {
    fn axes(&self) -> [Vector2<f64>; 2] {
        let r = Rotation2::new(self.yaw);
        [r * Vector2::x(), r * Vector2::y()]
    }

    fn reach(&self, axis: &Vector2<f64>) -> f64 {
        self.axes().iter().zip(self.half.iter()).map(|(a, h)| a.dot(axis).abs() * h).sum()
    }

    /// Separating axes: convex shapes are apart exactly if some edge normal separates them.
    fn meets(&self, other: &Self) -> bool {
        self.axes()
            .iter()
            .chain(&other.axes())
            .all(|a| (self.center - other.center).dot(a).abs() < self.reach(a) + other.reach(a))
    }

    fn within(&self, low: &Vector2<f64>, high: &Vector2<f64>) -> bool {
        let reach = Vector2::new(self.reach(&Vector2::x()), self.reach(&Vector2::y()));
        let (a, b) = (self.center - reach, self.center + reach);
        a.x >= low.x && a.y >= low.y && b.x <= high.x && b.y <= high.y
    }
}

/// All furniture of a room.
pub(super) fn furnish(room: &Room, doors: &[Door], rng: &mut ChaCha8Rng) -> Vec<Primitive> {
    let mut taken: Vec<Footprint> = room
        .doors
        .iter()
        .map(|&d| {
            let d = doors[d];
            let across = 0.5 * d.width + 0.1;
            let half = if d.toward.x > 0.5 { [DOOR_CLEAR_M, across] } else { [across, DOOR_CLEAR_M] };
            Footprint { center: d.center, half: Vector2::from(half), yaw: 0.0 }
        })
        .collect();
    let mut solids = Vec::new();
    let size = room.size();
    let perimeter = 2.0 * (size.x + size.y);
    for _ in 0..(perimeter * rng.random_range(0.9..1.3)) as usize {
        along_wall(room, &mut taken, &mut solids, rng);
    }
    for _ in 0..(size.x * size.y * rng.random_range(0.15..0.35)) as usize + 1 {
        free_standing(room, &mut taken, &mut solids, rng);
    }
    for _ in 0..(perimeter * 0.6) as usize {
        on_wall(room, doors, &mut solids, rng);
    }
    solids
}

/// Pose of a piece at a wall: `at` metres along `side`, its back at the wall's face.
fn at_wall(room: &Room, side: usize, at: f64, up: f64) -> Isometry3<f64> {
    let (start, along, _) = room.side(side);
    let yaw = along.y.atan2(along.x);
    Isometry3::from_parts((start + along * at).push(up).into(), UnitQuaternion::new(Vector3::z() * yaw))
}

/// One piece with its back to a wall, if a free place is found for it.
fn along_wall(room: &Room, taken: &mut Vec<Footprint>, solids: &mut Vec<Primitive>, rng: &mut ChaCha8Rng) {
    let kind = rng.random_range(0..9);
    // Width, depth, and whether it is too tall to stand before a window.
    let (width, depth, tall) = match kind {
        0 => (rng.random_range(0.6..1.3), rng.random_range(0.26..0.4), true), // shelf
        1 => (rng.random_range(0.5..1.6), rng.random_range(0.4..0.62), true), // cabinet
        2 => (rng.random_range(0.8..1.8), rng.random_range(0.35..0.55), false), // sideboard
        3 => (rng.random_range(1.3..2.1), rng.random_range(0.75..0.95), false), // sofa
        4 => (rng.random_range(0.9..1.6), rng.random_range(1.9..2.1), false), // bed
        5 => (rng.random_range(1.0..1.6), rng.random_range(0.55..0.75), false), // desk
        6 => (0.45, 0.45, true),                                              // floor lamp
        7 => (rng.random_range(0.5..1.0), rng.random_range(0.4..0.7), false), // collection of scans of boxes
        _ => (rng.random_range(0.35..0.6), rng.random_range(0.35..0.6), false), // plant
    };
    for _ in 0..8 {
        let side = rng.random_range(0..4);
        let (start, along, length) = room.side(side);
        let at = rng.random_range(0.5 * width + 0.02..length - 0.5 * width - 0.02);
        let inward = Vector2::new(-along.y, along.x);
        let gap = rng.random_range(0.02..0.06);
        let footprint = Footprint {
            center: start + along * at + inward * (gap + 0.5 * depth),
            half: Vector2::new(0.5 * width, 0.5 * depth),
            yaw: along.y.atan2(along.x),
        };
        let hides = |w: &&(usize, f64, f64, f64)| w.0 == side && (w.1 - at).abs() < 0.5 * (w.2 + width);
        if taken.iter().any(|t| t.meets(&footprint)) || (tall && room.windows.iter().any(|w| hides(&w))) {
            continue;
        }
        taken.push(footprint);
        let mut base = at_wall(room, side, at, 0.0);
        base *= Isometry3::translation(0.0, gap, 0.0);
        let mut piece = Piece { base, solids };
        match kind {
            0 => shelf(&mut piece, width, depth, rng),
            1 => cabinet(&mut piece, width, depth, rng),
            2 => sideboard(&mut piece, width, depth, rng),
            3 => sofa(&mut piece, width, depth, rng),
            4 => bed(&mut piece, width, depth, rng),
            5 => desk(&mut piece, width, depth, rng),
            6 => floor_lamp(&mut piece, depth, rng),
            7 => boxes(&mut piece, width, depth, rng),
            _ => plant(&mut piece, width.min(depth), rng),
        }
        return;
    }
}

/// One low piece away from the walls, turned at random.
fn free_standing(room: &Room, taken: &mut Vec<Footprint>, solids: &mut Vec<Primitive>, rng: &mut ChaCha8Rng) {
    let kind = rng.random_range(0..5);
    let (width, depth): (f64, f64) = match kind {
        0 => (rng.random_range(1.5..2.2), rng.random_range(1.5..2.0)), // table with chairs
        1 => (rng.random_range(0.6..1.2), rng.random_range(0.4..0.7)), // coffee table
        2 => (0.6, 0.6),                                               // armchair or chair
        3 => (rng.random_range(0.3..0.6), rng.random_range(0.3..0.6)), // stool, plant
        _ => (rng.random_range(0.5..0.9), rng.random_range(0.4..0.6)), // boxes
    };
    for _ in 0..10 {
        let f = Vector2::new(rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        let footprint = Footprint {
            center: room.low + f.component_mul(&room.size()),
            half: Vector2::new(0.5 * width, 0.5 * depth),
            yaw: rng.random_range(0.0..std::f64::consts::TAU),
        };
        let margin = Vector2::repeat(0.05);
        if !footprint.within(&(room.low + margin), &(room.high - margin))
            || taken.iter().any(|t| t.meets(&footprint))
        {
            continue;
        }
        taken.push(footprint);
        let turn = UnitQuaternion::new(Vector3::z() * footprint.yaw);
        let mut base = Isometry3::from_parts(footprint.center.push(0.0).into(), turn);
        base *= Isometry3::translation(0.0, -0.5 * depth, 0.0);
        let mut piece = Piece { base, solids };
        match kind {
            0 => dining(&mut piece, width, depth, rng),
            1 => table(&mut piece, [0.0, 0.5 * depth], [width, depth], 0.45, rng),
            2 => {
                let turn = rng.random_range(-0.5..0.5);
                chair(&mut piece, [0.0, 0.5 * depth], turn, rng);
            }
            3 => plant(&mut piece, width.min(depth), rng),
            _ => boxes(&mut piece, width, depth, rng),
        }
        return;
    }
}

/// Something flat on a wall: picture, clock, board with things on it, radiator, pillar.
fn on_wall(room: &Room, doors: &[Door], solids: &mut Vec<Primitive>, rng: &mut ChaCha8Rng) {
    let side = rng.random_range(0..4);
    let (start, along, length) = room.side(side);
    let width = rng.random_range(0.25..1.0);
    let at = rng.random_range(0.5 * width..length - 0.5 * width);
    let blocked = |center: f64, other: f64| (center - at).abs() < 0.5 * (other + width) + 0.05;
    let inward = Vector2::new(-along.y, along.x);
    let before_door = room.doors.iter().map(|&d| doors[d]).any(|d| {
        let off = d.center - start;
        off.dot(&inward).abs() < 0.3 && d.toward.dot(&inward).abs() > 0.5 && blocked(off.dot(&along), d.width)
    });
    let window = room.windows.iter().find(|w| w.0 == side && blocked(w.1, w.2));
    if before_door {
        return;
    }
    let mut piece = Piece { base: at_wall(room, side, at, 0.0), solids };
    let color = tint(rng, [130, 110, 100], 90);
    if let Some(w) = window {
        // Under a window there is room for a radiator.
        let ribs = (width / 0.07) as usize;
        for k in 0..ribs {
            let x = -0.5 * width + 0.07 * (k as f64 + 0.5);
            piece.block([x, 0.06, 0.12], [0.045, 0.08, w.3 - 0.3], [230, 228, 220]);
        }
        return;
    }
    match rng.random_range(0..5) {
        0 => {
            let up = rng.random_range(1.2..1.5);
            piece.block([0.0, 0.02, up], [width, 0.04, rng.random_range(0.25..0.8)], color);
        }
        1 => {
            let turn = Vector3::x() * std::f64::consts::FRAC_PI_2;
            let shape = Shape::Cylinder { radius: 0.5 * width.min(0.5), half_height: 0.025 };
            piece.add(shape, [0.0, 0.025, rng.random_range(1.5..1.9)], turn, color);
        }
        2 | 3 => {
            let depth = rng.random_range(0.15..0.28);
            let up = rng.random_range(1.1..1.8);
            piece.block([0.0, 0.5 * depth, up], [width, depth, 0.03], color);
            clutter(&mut piece, [0.0, 0.5 * depth, up + 0.03], [width, depth], 0.3, rng);
        }
        _ => {
            let depth = rng.random_range(0.05..0.3);
            piece.block([0.0, 0.5 * depth, 0.0], [0.5 * width, depth, room.height], tint(rng, [205; 3], 20));
        }
    }
}

/// Furniture that rises into the walker's height must stay within the strip along the walls.
const _: () = assert!(WALK_INSET_M >= 0.95);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_meet_exactly_when_they_share_area() {
        let a = Footprint { center: Vector2::zeros(), half: Vector2::new(1.0, 0.5), yaw: 0.0 };
        let at =
            |x: f64, yaw: f64| Footprint { center: Vector2::new(x, 0.0), half: Vector2::repeat(0.5), yaw };
        assert!(a.meets(&at(1.4, 0.0)) && !a.meets(&at(1.6, 0.0)));
        // Turned by 45° its corner reaches √½ instead of ½.
        let diagonal = std::f64::consts::FRAC_PI_4;
        assert!(a.meets(&at(1.6, diagonal)) && !a.meets(&at(1.75, diagonal)));
        assert!(at(1.0, diagonal).within(&Vector2::new(0.2, -1.0), &Vector2::new(1.8, 1.0)));
        assert!(!at(1.0, diagonal).within(&Vector2::new(0.4, -1.0), &Vector2::new(1.8, 1.0)));
    }
}
