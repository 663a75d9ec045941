//! A building: rooms on a grid, walls with doors and windows.

use super::furniture;
use super::shape::{Primitive, Shape};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Thickness of a wall, metres.
pub(super) const WALL_M: f64 = 0.16;
/// Strip along the walls that the walker keeps out of, metres from the wall's face.
/// Furniture taller than the camera stays within it.
pub(super) const WALK_INSET_M: f64 = 1.0;
/// Top of door openings, metres.
const DOOR_HEIGHT_M: f64 = 2.05;

/// One room: the rectangle between its walls' faces.
#[derive(Debug, Clone)]
pub(super) struct Room {
    pub low: Vector2<f64>,
    pub high: Vector2<f64>,
    pub height: f64,
    /// Doors: index into [`Building::doors`].
    pub doors: Vec<usize>,
    /// Windows: side (0 south, 1 east, 2 north, 3 west), centre along the side, width, sill height.
    pub windows: Vec<(usize, f64, f64, f64)>,
}

/// An opening between two rooms.
#[derive(Debug, Clone, Copy)]
pub(super) struct Door {
    pub rooms: [usize; 2],
    /// Middle of the opening on the wall's middle line.
    pub center: Vector2<f64>,
    /// Unit vector from the first room to the second.
    pub toward: Vector2<f64>,
    pub width: f64,
}

/// Rooms, doors and all solids.
#[derive(Debug, Clone)]
pub(super) struct Building {
    pub rooms: Vec<Room>,
    pub doors: Vec<Door>,
    pub solids: Vec<Primitive>,
}

impl Room {
    /// Middle of the floor.
    pub fn center(&self) -> Vector2<f64> {
        0.5 * (self.low + self.high)
    }

    /// Edge lengths of the floor.
    pub fn size(&self) -> Vector2<f64> {
        self.high - self.low
    }

    /// Start corner, direction along the wall (interior on its left) and length of a side.
    pub fn side(&self, side: usize) -> (Vector2<f64>, Vector2<f64>, f64) {
        let (l, h, s) = (self.low, self.high, self.size());
        match side {
            0 => (l, Vector2::x(), s.x),
            1 => (Vector2::new(h.x, l.y), Vector2::y(), s.y),
            2 => (h, -Vector2::x(), s.x),
            _ => (Vector2::new(l.x, h.y), -Vector2::y(), s.y),
        }
    }
}

/// An opening of a wall in the wall's own coordinates: along, and up, metres.
struct Opening {
    along: [f64; 2],
    up: [f64; 2],
}

/// A random colour near `base`.
pub(super) fn tint(rng: &mut ChaCha8Rng, base: [u8; 3], spread: i32) -> [u8; 3] {
    let shade = rng.random_range(-spread..=spread);
    base.map(|c| (i32::from(c) + shade + rng.random_range(-spread / 3..=spread / 3)).clamp(5, 250) as u8)
}

/// An axis-aligned box between two corners.
fn block(low: Vector3<f64>, high: Vector3<f64>, color: [u8; 3]) -> Primitive {
    let half = 0.5 * (high - low);
    Primitive::new(Shape::Box { half }, &Translation3::from(low + half).into(), color)
}

/// Builds `rooms` furnished rooms.
pub(super) fn build(rooms: usize, rng: &mut ChaCha8Rng) -> Building {
    let columns = (rooms as f64).sqrt().ceil() as usize;
    let rows = rooms.div_ceil(columns);
    let lines = |n: usize, rng: &mut ChaCha8Rng| {
        let mut at = vec![0.0];
        for i in 0..n {
            at.push(at[i] + rng.random_range(3.9..5.6));
        }
        at
    };
    let (xs, ys) = (lines(columns, rng), lines(rows, rng));
    let inset = Vector2::repeat(0.5 * WALL_M);
    let mut building = Building { rooms: Vec::new(), doors: Vec::new(), solids: Vec::new() };
    for i in 0..rooms {
        let (c, r) = (i % columns, i / columns);
        building.rooms.push(Room {
            low: Vector2::new(xs[c], ys[r]) + inset,
            high: Vector2::new(xs[c + 1], ys[r + 1]) - inset,
            height: rng.random_range(2.4..2.9),
            doors: Vec::new(),
            windows: Vec::new(),
        });
    }
    cut_doors(&mut building, columns, rng);
    let wall_color = tint(rng, [205, 200, 190], 25);
    for i in 0..rooms {
        let (c, r) = (i % columns, i / columns);
        let exists = |c: usize, r: usize| c < columns && r * columns + c < rooms;
        // South and west walls belong to this room; north and east ones too where nobody is beyond.
        let outside = [r == 0, !exists(c + 1, r), !exists(c, r + 1), c == 0];
        for (side, outer) in outside.into_iter().enumerate() {
            if outer {
                wall(&mut building, i, side, true, wall_color, rng);
            } else if side == 0 || side == 3 {
                wall(&mut building, i, side, false, wall_color, rng);
            }
        }
    }
    for i in 0..rooms {
        shell(&mut building, i, rng);
        let placed = furniture::furnish(&building.rooms[i], &building.doors, rng);
        building.solids.extend(placed);
    }
    building
}

/// Doors along a random spanning tree of the grid, and in some of the other shared walls.
fn cut_doors(building: &mut Building, columns: usize, rng: &mut ChaCha8Rng) {
    let n = building.rooms.len();
    let mut shared: Vec<(usize, usize)> = Vec::new();
    for i in 0..n {
        if i % columns + 1 < columns && i + 1 < n {
            shared.push((i, i + 1));
        }
        if i + columns < n {
            shared.push((i, i + columns));
        }
    }
    for i in (1..shared.len()).rev() {
        shared.swap(i, rng.random_range(0..=i));
    }
    let mut group: Vec<usize> = (0..n).collect();
    for (a, b) in shared {
        let joins = group[a] != group[b];
        if !joins && !rng.random_bool(0.3) {
            continue;
        }
        let (from, to) = (group[b], group[a]);
        group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
        let (ra, rb) = (&building.rooms[a], &building.rooms[b]);
        let (axis, toward) = if b == a + 1 { (1, Vector2::x()) } else { (0, Vector2::y()) };
        let mut center = 0.5 * (ra.high + rb.low);
        center[axis] = rng.random_range(ra.low[axis] + WALK_INSET_M..ra.high[axis] - WALK_INSET_M);
        let door = Door { rooms: [a, b], center, toward, width: rng.random_range(0.85..1.2) };
        building.rooms[a].doors.push(building.doors.len());
        building.rooms[b].doors.push(building.doors.len());
        building.doors.push(door);
    }
}

/// One wall of a room with its doors, and windows when it is an outer one.
fn wall(
    building: &mut Building,
    room: usize,
    side: usize,
    outer: bool,
    color: [u8; 3],
    rng: &mut ChaCha8Rng,
) {
    let (start, along, length) = building.rooms[room].side(side);
    let inward = Vector2::new(-along.y, along.x);
    let mut openings = Vec::new();
    for &d in &building.rooms[room].doors {
        let door = building.doors[d];
        let off = door.center - start;
        if off.dot(&inward).abs() < WALL_M && door.toward.dot(&inward).abs() > 0.5 {
            let at = off.dot(&along);
            openings.push(Opening {
                along: [at - 0.5 * door.width, at + 0.5 * door.width],
                up: [-0.1, DOOR_HEIGHT_M],
            });
        }
    }
    // Box in wall coordinates: along, depth behind the face (0 at the face), up.
    let piece = |a: [f64; 2], depth: [f64; 2], up: [f64; 2], color| {
        let p = start + along * a[0] - inward * depth[0];
        let q = start + along * a[1] - inward * depth[1];
        block(p.inf(&q).push(up[0]), p.sup(&q).push(up[1]), color)
    };
    let mut solids = Vec::new();
    if outer {
        let mut at = rng.random_range(0.4..1.4);
        while at + 0.8 < length - 0.3 {
            let width = rng.random_range(0.7f64..1.7).min(length - 0.3 - at);
            let (sill, top) = (rng.random_range(0.75..1.05), rng.random_range(1.9..2.2));
            let blind = rng.random_range(0.0..0.5f64).max(0.0) * (top - sill);
            let (span, frame) = ([at, at + width], tint(rng, [225, 225, 220], 15));
            // Glass returns nothing, a blind hangs over a part of it, a board lies on the sill.
            solids.push(piece(span, [0.13, WALL_M], [sill, top], [120, 150, 170]).with_dropout(0.97));
            if rng.random_bool(0.7) {
                solids.push(piece(span, [0.10, 0.12], [top - blind, top], tint(rng, [190, 160, 120], 50)));
            }
            let bars = rng.random_range(1..4);
            for k in 0..=bars {
                let x = at + width * f64::from(k) / f64::from(bars);
                let bar = [(x - 0.03).max(at), (x + 0.03).min(at + width)];
                solids.push(piece(bar, [0.08, 0.14], [sill, top], frame));
            }
            solids.push(piece([at - 0.05, at + width + 0.05], [-0.12, 0.10], [sill - 0.03, sill], frame));
            building.rooms[room].windows.push((side, at + 0.5 * width, width, sill));
            openings.push(Opening { along: span, up: [sill, top] });
            at += width + rng.random_range(0.5..2.2);
        }
    }
    openings.sort_by(|a, b| a.along[0].total_cmp(&b.along[0]));
    let (mut from, depth) = (-WALL_M, [0.0, WALL_M]);
    for o in &openings {
        solids.push(piece([from, o.along[0]], depth, [-0.1, 3.1], color));
        solids.push(piece(o.along, depth, [o.up[1], 3.1], color));
        if o.up[0] > 0.0 {
            solids.push(piece(o.along, depth, [-0.1, o.up[0]], color));
        }
        from = o.along[1];
    }
    solids.push(piece([from, length + WALL_M], depth, [-0.1, 3.1], color));
    building.solids.extend(solids);
}

/// Floor, ceiling, skirting, beams, a shaft in a corner, a lamp.
fn shell(building: &mut Building, index: usize, rng: &mut ChaCha8Rng) {
    let room = &building.rooms[index];
    let (low, high, h) = (room.low, room.high, room.height);
    let margin = Vector2::repeat(0.5 * WALL_M);
    let mut solids = vec![
        block((low - margin).push(-0.1), (high + margin).push(0.0), tint(rng, [140, 105, 75], 45)),
        block((low - margin).push(h), (high + margin).push(h + 0.1), tint(rng, [235, 235, 230], 12)),
    ];
    let (thick, tall) = (rng.random_range(0.012..0.025), rng.random_range(0.05..0.14));
    let skirting = tint(rng, [220, 215, 205], 30);
    for side in 0..4 {
        let (start, along, length) = room.side(side);
        let inward = Vector2::new(-along.y, along.x);
        let mut gaps: Vec<[f64; 2]> = room
            .doors
            .iter()
            .map(|&d| &building.doors[d])
            .filter(|d| (d.center - start).dot(&inward).abs() < WALL_M && d.toward.dot(&inward).abs() > 0.5)
            .map(|d| {
                let at = (d.center - start).dot(&along);
                [at - 0.5 * d.width, at + 0.5 * d.width]
            })
            .collect();
        gaps.push([length, length]);
        gaps.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut from = 0.0;
        for gap in gaps {
            let (p, q) = (start + along * from, start + along * gap[0] + inward * thick);
            solids.push(block(p.inf(&q).push(0.0), p.sup(&q).push(tall), skirting));
            from = gap[1];
        }
    }
    for _ in 0..rng.random_range(0..3) {
        let (axis, drop) = (rng.random_range(0..2usize), rng.random_range(0.06..0.22));
        let width = rng.random_range(0.08..0.3);
        let (mut a, mut b) = (low, high);
        a[axis] = rng.random_range(low[axis] + 0.3..high[axis] - 0.6);
        b[axis] = a[axis] + width;
        solids.push(block(a.push(h - drop), b.push(h), tint(rng, [200, 190, 170], 40)));
    }
    let c = room.center() + Vector2::new(rng.random_range(-0.9..0.9), rng.random_range(-0.9..0.9));
    let hang = rng.random_range(0.0..0.35);
    let radius = rng.random_range(0.1..0.25);
    let at = |z: f64| Isometry3::from_parts(c.push(z).into(), UnitQuaternion::identity());
    let (shape, below) = match rng.random_range(0..3) {
        0 => (Shape::Sphere { radius: 0.7 * radius }, 0.7 * radius),
        1 => (Shape::Cylinder { radius, half_height: 0.06 }, 0.06),
        _ => (Shape::Box { half: Vector3::new(0.6, 0.1, 0.04) }, 0.04),
    };
    let cord = Shape::Cylinder { radius: 0.012, half_height: 0.5 * hang + 0.01 };
    solids.push(Primitive::new(cord, &at(h - 0.5 * hang), [60; 3]));
    solids.push(Primitive::new(shape, &at(h - hang - below), tint(rng, [240, 230, 200], 15)));
    building.solids.extend(solids);
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use rand::SeedableRng;

    fn inside_any(b: &Building, p: &Point3<f64>) -> bool {
        b.solids.iter().any(|s| s.signed_distance(p) < 0.05)
    }

    #[test]
    fn the_walking_space_is_free_and_doors_can_be_walked_through() {
        for seed in 0..12 {
            let b = build(5, &mut ChaCha8Rng::seed_from_u64(seed));
            for room in &b.rooms {
                assert!(!room.doors.is_empty(), "every room can be reached");
                let (l, h) = (room.low.add_scalar(WALK_INSET_M), room.high.add_scalar(-WALK_INSET_M));
                for i in 0..=10 {
                    for j in 0..=10 {
                        let f = Vector2::new(f64::from(i), f64::from(j)) / 10.0;
                        let at = l + f.component_mul(&(h - l));
                        for z in [1.2, 1.45, 1.7] {
                            assert!(!inside_any(&b, &at.push(z).into()), "seed {seed}: {at} {z}");
                        }
                    }
                }
            }
            for door in &b.doors {
                for k in -11..=11 {
                    let at = door.center + door.toward * (0.1 * f64::from(k));
                    assert!(!inside_any(&b, &at.push(1.45).into()), "seed {seed}: door {at}");
                }
            }
        }
    }

    #[test]
    fn rooms_are_closed_but_for_their_openings() {
        // From the middle of a room every ray meets something close (glass is a solid too).
        let b = build(4, &mut ChaCha8Rng::seed_from_u64(5));
        let scene = super::super::scene::Scene::new(b.solids.clone());
        let reach = 2.0 * 2.0 * 5.6 * 1.5;
        for room in &b.rooms {
            let eye = Point3::from(room.center().push(1.4));
            for i in 0..2000 {
                let (a, z) = (f64::from(i) * 2.4, f64::from(i) / 1000.0 - 1.0);
                let d = Vector3::new(a.cos(), a.sin(), z).normalize();
                assert!(scene.cast(&eye, &d, reach).is_some(), "hole in the direction {d}");
            }
        }
    }
}
