//! Furniture-like groups of solids, and where they stand in a room.

use super::building::{Door, Room, WALK_INSET_M, tint};
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

/// Solids in a frame of their own: x to the right, y to the front, z up, origin on the floor.
struct Piece<'a> {
    base: Isometry3<f64>,
    solids: &'a mut Vec<Primitive>,
}

impl Piece<'_> {
    fn add(&mut self, shape: Shape, at: [f64; 3], turn: Vector3<f64>, color: [u8; 3]) {
        let pose = self.base * Isometry3::new(Vector3::from(at), turn);
        self.solids.push(Primitive::new(shape, &pose, color));
    }

    /// Box with its lower face's middle at `at`, full `size`.
    fn block(&mut self, at: [f64; 3], size: [f64; 3], color: [u8; 3]) {
        self.turned(at, size, 0.0, color);
    }

    fn turned(&mut self, at: [f64; 3], size: [f64; 3], yaw: f64, color: [u8; 3]) {
        let half = 0.5 * Vector3::from(size);
        self.add(Shape::Box { half }, [at[0], at[1], at[2] + half.z], Vector3::z() * yaw, color);
    }

    /// Upright cylinder with its foot at `at`.
    fn post(&mut self, at: [f64; 3], radius: f64, height: f64, color: [u8; 3]) {
        let shape = Shape::Cylinder { radius, half_height: 0.5 * height };
        self.add(shape, [at[0], at[1], at[2] + 0.5 * height], Vector3::zeros(), color);
    }

    fn ball(&mut self, at: [f64; 3], radius: f64, color: [u8; 3]) {
        self.add(Shape::Sphere { radius }, at, Vector3::zeros(), color);
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
        7 => (rng.random_range(0.5..1.0), rng.random_range(0.4..0.7), false), // pile of boxes
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

/// Small things on a board of `size` with its middle at `at`, no higher than `height`.
fn clutter(piece: &mut Piece<'_>, at: [f64; 3], size: [f64; 2], height: f64, rng: &mut ChaCha8Rng) {
    let mut x = -0.5 * size[0] + 0.03;
    while x < 0.5 * size[0] - 0.08 {
        let color = tint(rng, [125, 115, 110], 110);
        let room = (0.5 * size[0] - x).min(0.35);
        let depth = size[1] * rng.random_range(0.4..0.9);
        let tall = height * rng.random_range(0.3..0.95);
        let y = at[1] + 0.5 * (size[1] - depth) * rng.random_range(-0.9..0.9);
        let width: f64 = match rng.random_range(0..6) {
            0 | 1 => {
                let w = rng.random_range(0.05..0.3f64).min(room);
                piece.block([at[0] + x + 0.5 * w, y, at[2]], [w, depth, tall], color);
                w
            }
            2 => {
                let r = rng.random_range(0.03..0.09f64).min(0.5 * room).min(0.5 * size[1]);
                piece.post([at[0] + x + r, at[1], at[2]], r, tall, color);
                2.0 * r
            }
            3 => {
                let r = rng.random_range(0.03..0.1f64).min(0.5 * room).min(0.5 * height).min(0.5 * size[1]);
                piece.ball([at[0] + x + r, at[1], at[2] + r], r, color);
                2.0 * r
            }
            4 => {
                let w = rng.random_range(0.08..0.22f64).min(0.7 * room);
                let d = w.min(0.7 * size[1]);
                let yaw = rng.random_range(-0.7..0.7);
                piece.turned([at[0] + x + 0.6 * w, at[1], at[2]], [w, d, 0.6 * tall], yaw, color);
                1.3 * w
            }
            _ => rng.random_range(0.05..0.3), // a gap
        };
        x += width + rng.random_range(0.005..0.06);
    }
}

fn shelf(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let color = tint(rng, [150, 115, 80], 60);
    let height = rng.random_range(1.0..2.1);
    let boards = rng.random_range(3..7usize);
    for x in [-0.5 * w + 0.01, 0.5 * w - 0.01] {
        p.block([x, 0.5 * d, 0.0], [0.02, d, height], color);
    }
    if rng.random_bool(0.6) {
        p.block([0.0, 0.005, 0.0], [w, 0.01, height], color);
    }
    let mut at = 0.06;
    for k in 0..boards {
        p.block([0.0, 0.5 * d, at], [w - 0.04, d, 0.022], color);
        let next = 0.06 + (height - 0.09) * (k + 1) as f64 / boards as f64 + rng.random_range(-0.05..0.05);
        clutter(p, [0.0, 0.5 * d, at + 0.022], [w - 0.06, d], (next - at - 0.05).max(0.05), rng);
        at = next;
    }
    p.block([0.0, 0.5 * d, height - 0.022], [w, d, 0.022], color);
}

fn cabinet(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let color = tint(rng, [190, 170, 140], 60);
    let height = rng.random_range(1.2..2.2);
    p.block([0.0, 0.5 * d, 0.08], [w, d, height - 0.08], color);
    p.block([0.0, 0.5 * d - 0.03, 0.0], [w - 0.05, d - 0.06, 0.08], [60; 3]);
    let doors = rng.random_range(1..4usize);
    for k in 0..doors {
        let (x, step) = (-0.5 * w + w * (k as f64 + 0.5) / doors as f64, w / doors as f64);
        let low = 0.1 + rng.random_range(0.0..0.3) * height;
        p.block([x, d + 0.01, low], [step - 0.03, 0.02, height - low - 0.02], tint(rng, color, 15));
        p.block([x + 0.35 * step, d + 0.035, 0.5 * height], [0.02, 0.03, 0.15], [90; 3]);
    }
    let top = (2.35 - height).min(0.35);
    if rng.random_bool(0.7) {
        clutter(p, [0.0, 0.5 * d, height], [w, 0.8 * d], top, rng);
    }
}

fn sideboard(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let color = tint(rng, [120, 90, 70], 60);
    let height = rng.random_range(0.5..0.9);
    p.block([0.0, 0.5 * d, 0.1], [w, d, height - 0.1], color);
    for x in [-0.5 * w + 0.05, 0.5 * w - 0.05] {
        p.block([x, 0.5 * d, 0.0], [0.05, d - 0.06, 0.1], [50; 3]);
    }
    let drawers = rng.random_range(2..5usize);
    for k in 0..drawers {
        let z = 0.12 + (height - 0.14) * k as f64 / drawers as f64;
        let tall = (height - 0.14) / drawers as f64 - 0.02;
        p.block([0.0, d + 0.008, z], [w - 0.04, 0.016, tall], tint(rng, color, 12));
    }
    if rng.random_bool(0.5) {
        // A screen: black gloss that often returns nothing.
        let (sw, sh) = (w * rng.random_range(0.5..0.8), rng.random_range(0.35..0.6));
        p.block([0.0, 0.4 * d, height], [0.3, 0.18, 0.02], [30; 3]);
        p.block([0.0, 0.4 * d, height + 0.06], [sw, 0.05, sh], [20; 3]);
        if let Some(last) = p.solids.last_mut() {
            last.dropout = 0.6;
        }
    } else {
        clutter(p, [0.0, 0.5 * d, height], [w, 0.8 * d], 0.45, rng);
    }
}

fn sofa(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let color = tint(rng, [110, 110, 125], 80);
    let (seat, back, arm) =
        (rng.random_range(0.36..0.46), rng.random_range(0.7..0.95), rng.random_range(0.12..0.24));
    p.block([0.0, 0.5 * d, 0.08], [w, d, seat - 0.08], color);
    p.block([0.0, 0.1, 0.08], [w, 0.2, back - 0.08], color);
    let left_only = rng.random_bool(0.3);
    for (k, x) in [-0.5 * (w - arm), 0.5 * (w - arm)].into_iter().enumerate() {
        if k == 0 || !left_only {
            p.block([x, 0.5 * d, 0.08], [arm, d, seat + 0.1], color);
        }
    }
    for _ in 0..rng.random_range(1..4) {
        let x = rng.random_range(-0.35..0.35) * w;
        let half = Vector3::new(rng.random_range(0.15..0.25), 0.06, rng.random_range(0.14..0.22));
        let lean = Vector3::new(rng.random_range(0.2..0.5), rng.random_range(-0.3..0.3), 0.0);
        p.add(Shape::Box { half }, [x, 0.32, seat + half.z], lean, tint(rng, [160, 120, 90], 80));
    }
}

fn bed(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let color = tint(rng, [140, 100, 70], 50);
    let height = rng.random_range(0.3..0.5);
    p.block([0.0, 0.5 * d, 0.05], [w, d, height - 0.2], color);
    p.block([0.0, 0.5 * d, height - 0.15], [w - 0.06, d - 0.06, 0.15], tint(rng, [225, 225, 230], 20));
    p.block([0.0, 0.03, 0.0], [w, 0.06, rng.random_range(0.7..1.1)], color);
    for x in [-0.25 * w, 0.25 * w] {
        let tilt = Vector3::new(rng.random_range(0.1..0.4), 0.0, rng.random_range(-0.3..0.3));
        let half = Vector3::new(0.2 * w, 0.18, 0.06);
        p.add(Shape::Box { half }, [x, 0.3, height + 0.08], tilt, tint(rng, [235, 230, 225], 15));
    }
    let cover = rng.random_range(0.4..0.7) * d;
    p.block([0.0, d - 0.5 * cover, height - 0.1], [w + 0.03, cover, 0.16], tint(rng, [110, 120, 150], 80));
    let lump = rng.random_range(0.1..0.2);
    p.ball([rng.random_range(-0.3..0.3) * w, 0.65 * d, height], lump, tint(rng, [110, 120, 150], 60));
}

/// A table top with four legs around `at`.
fn table(p: &mut Piece<'_>, at: [f64; 2], size: [f64; 2], height: f64, rng: &mut ChaCha8Rng) {
    let color = tint(rng, [165, 125, 85], 60);
    p.block([at[0], at[1], height - 0.035], [size[0], size[1], 0.035], color);
    let inset = rng.random_range(0.03..0.1);
    for (sx, sy) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
        let foot = [at[0] + sx * (size[0] - 2.0 * inset), at[1] + sy * (size[1] - 2.0 * inset), 0.0];
        if rng.random_bool(0.5) {
            p.post(foot, 0.03, height - 0.03, color);
        } else {
            p.block(foot, [0.06, 0.06, height - 0.03], color);
        }
    }
    let tall = (0.95 - height).clamp(0.08, 0.3);
    clutter(p, [at[0], at[1], height], [0.85 * size[0], 0.5 * size[1]], tall, rng);
}

fn desk(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let height = rng.random_range(0.68..0.78);
    table(p, [0.0, 0.5 * d], [w, d], height, rng);
    let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    p.block([side * (0.5 * w - 0.22), 0.5 * d, 0.05], [0.38, d - 0.1, 0.55], tint(rng, [120; 3], 60));
    // A screen on a foot, turned a little.
    let (x, yaw) = (-side * rng.random_range(0.0..0.25) * w, rng.random_range(-0.4..0.4));
    p.post([x, 0.15, height], 0.1, 0.015, [40; 3]);
    p.turned([x, 0.15, height + 0.1], [rng.random_range(0.4..0.6), 0.04, 0.33], yaw, [35; 3]);
}

fn chair(p: &mut Piece<'_>, at: [f64; 2], yaw: f64, rng: &mut ChaCha8Rng) {
    let color = tint(rng, [135, 100, 75], 70);
    let base = p.base * Isometry3::new(Vector3::new(at[0], at[1], 0.0), Vector3::z() * yaw);
    let mut c = Piece { base, solids: &mut *p.solids };
    let (s, seat, back) =
        (rng.random_range(0.36..0.45), rng.random_range(0.42..0.48), rng.random_range(0.75..0.95));
    c.block([0.0, 0.0, seat - 0.04], [s, s, 0.04], color);
    for (sx, sy) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
        let height = if sy < 0.0 { back } else { seat - 0.04 };
        c.block([sx * (s - 0.04), sy * (s - 0.04), 0.0], [0.04, 0.04, height], color);
    }
    let rest = rng.random_range(0.1..0.3);
    c.block([0.0, -0.5 * s + 0.02, back - rest], [s - 0.08, 0.025, rest], color);
}

/// A table in the middle of a `w × d` rectangle and chairs around it, one of them pulled away.
fn dining(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let size = [w - 0.35, d - 1.0];
    let y = 0.5 * d;
    if rng.random_bool(0.3) {
        let radius = 0.5 * size[1].max(0.8);
        let color = tint(rng, [165, 125, 85], 60);
        p.post([0.0, y, 0.7], radius, 0.03, color);
        p.post([0.0, y, 0.0], 0.06, 0.7, color);
        p.post([0.0, y, 0.0], 0.25, 0.03, color);
        clutter(p, [0.0, y, 0.73], [radius, 0.7 * radius], 0.22, rng);
    } else {
        table(p, [0.0, y], size, rng.random_range(0.7..0.78), rng);
    }
    let reach = 0.5 * d - 0.27;
    for (x, side) in [(-0.25, -1.0), (0.25, -1.0), (-0.25, 1.0), (0.25, 1.0)] {
        if rng.random_bool(0.75) {
            let turn = if side < 0.0 { 0.0 } else { std::f64::consts::PI };
            let at = [x * size[0] + rng.random_range(-0.06..0.06), y + side * reach];
            chair(p, at, turn + rng.random_range(-0.35..0.35), rng);
        }
    }
}

fn floor_lamp(p: &mut Piece<'_>, d: f64, rng: &mut ChaCha8Rng) {
    let height = rng.random_range(1.3..1.7);
    let color = tint(rng, [90; 3], 40);
    p.post([0.0, 0.5 * d, 0.0], 0.14, 0.03, color);
    p.post([0.0, 0.5 * d, 0.0], 0.018, height, color);
    let shade = tint(rng, [235, 220, 180], 20);
    if rng.random_bool(0.5) {
        p.post([0.0, 0.5 * d, height], rng.random_range(0.12..0.2), 0.28, shade);
    } else {
        p.ball([0.0, 0.5 * d, height], rng.random_range(0.1..0.17), shade);
    }
}

fn boxes(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let (mut z, mut w, mut d2) = (0.0, w, d);
    for _ in 0..rng.random_range(1..4) {
        let height = rng.random_range(0.15..0.3);
        let yaw = if z > 0.0 { rng.random_range(-0.4..0.4) } else { 0.0 };
        p.turned([0.0, 0.5 * d, z], [w, d2, height], yaw, tint(rng, [170, 130, 90], 60));
        z += height;
        w *= rng.random_range(0.55..0.85);
        d2 *= rng.random_range(0.55..0.85);
    }
}

fn plant(p: &mut Piece<'_>, w: f64, rng: &mut ChaCha8Rng) {
    let y = 0.5 * w;
    let (r, h) = (0.4 * w, rng.random_range(0.2..0.4));
    p.post([0.0, y, 0.0], r, h, tint(rng, [160, 90, 60], 50));
    for _ in 0..rng.random_range(3..7) {
        let leaf = rng.random_range(0.06..0.14);
        let at = [
            rng.random_range(-0.6..0.6) * r,
            y + rng.random_range(-0.6..0.6) * r,
            (h + rng.random_range(0.05..0.5)).min(0.9 - leaf),
        ];
        p.ball(at, leaf, tint(rng, [70, 130, 60], 40));
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
