//! Furniture-like groups of solids.

use super::building::tint;
use super::shape::{Primitive, Shape};
use nalgebra::{Isometry3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Solids in a frame of their own: x to the right, y to the front, z up, origin on the floor.
pub(super) struct Piece<'a> {
    pub base: Isometry3<f64>,
    pub solids: &'a mut Vec<Primitive>,
}

impl Piece<'_> {
    pub fn add(&mut self, shape: Shape, at: [f64; 3], turn: Vector3<f64>, color: [u8; 3]) {
        let pose = self.base * Isometry3::new(Vector3::from(at), turn);
        self.solids.push(Primitive::new(shape, &pose, color));
    }

    /// Box with its lower face's middle at `at`, full `size`.
    pub fn block(&mut self, at: [f64; 3], size: [f64; 3], color: [u8; 3]) {
        self.turned(at, size, 0.0, color);
    }

    pub fn turned(&mut self, at: [f64; 3], size: [f64; 3], yaw: f64, color: [u8; 3]) {
        let half = 0.5 * Vector3::from(size);
        self.add(Shape::Box { half }, [at[0], at[1], at[2] + half.z], Vector3::z() * yaw, color);
    }

    /// Upright cylinder with its foot at `at`.
    pub fn post(&mut self, at: [f64; 3], radius: f64, height: f64, color: [u8; 3]) {
        let shape = Shape::Cylinder { radius, half_height: 0.5 * height };
        self.add(shape, [at[0], at[1], at[2] + 0.5 * height], Vector3::zeros(), color);
    }

    pub fn ball(&mut self, at: [f64; 3], radius: f64, color: [u8; 3]) {
        self.add(Shape::Sphere { radius }, at, Vector3::zeros(), color);
    }
}

/// Small things on a board of `size` with its middle at `at`, no higher than `height`.
pub(super) fn clutter(
    piece: &mut Piece<'_>,
    at: [f64; 3],
    size: [f64; 2],
    height: f64,
    rng: &mut ChaCha8Rng,
) {
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

pub(super) fn shelf(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
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

pub(super) fn cabinet(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
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

pub(super) fn sideboard(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
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

pub(super) fn sofa(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
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

pub(super) fn bed(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
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
pub(super) fn table(p: &mut Piece<'_>, at: [f64; 2], size: [f64; 2], height: f64, rng: &mut ChaCha8Rng) {
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

pub(super) fn desk(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
    let height = rng.random_range(0.68..0.78);
    table(p, [0.0, 0.5 * d], [w, d], height, rng);
    let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    p.block([side * (0.5 * w - 0.22), 0.5 * d, 0.05], [0.38, d - 0.1, 0.55], tint(rng, [120; 3], 60));
    // A screen on a foot, turned a little.
    let (x, yaw) = (-side * rng.random_range(0.0..0.25) * w, rng.random_range(-0.4..0.4));
    p.post([x, 0.15, height], 0.1, 0.015, [40; 3]);
    p.turned([x, 0.15, height + 0.1], [rng.random_range(0.4..0.6), 0.04, 0.33], yaw, [35; 3]);
}

pub(super) fn chair(p: &mut Piece<'_>, at: [f64; 2], yaw: f64, rng: &mut ChaCha8Rng) {
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
pub(super) fn dining(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
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

pub(super) fn floor_lamp(p: &mut Piece<'_>, d: f64, rng: &mut ChaCha8Rng) {
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

pub(super) fn boxes(p: &mut Piece<'_>, w: f64, d: f64, rng: &mut ChaCha8Rng) {
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

pub(super) fn plant(p: &mut Piece<'_>, w: f64, rng: &mut ChaCha8Rng) {
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
