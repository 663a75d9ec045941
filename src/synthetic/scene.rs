//! A set of solids that rays can be cast into.

use super::shape::Primitive;
use nalgebra::{Point3, Vector3};

/// Most solids a leaf of the hierarchy holds.
const LEAF: usize = 3;

/// Solids under a bounding-volume hierarchy.
#[derive(Debug, Clone)]
pub struct Scene {
    primitives: Vec<Primitive>,
    nodes: Vec<Node>,
}

/// What a ray meets first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Ray parameter of the point.
    pub t: f64,
    /// Outward unit normal.
    pub normal: Vector3<f64>,
    /// Index of the solid.
    pub primitive: usize,
}

#[derive(Debug, Clone, Copy)]
struct Aabb {
    low: Vector3<f64>,
    high: Vector3<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Aabb,
    /// First solid of a leaf, or index of the right child (the left one follows its parent).
    at: u32,
    /// Solids in a leaf, 0 for an inner node.
    count: u32,
}

impl Aabb {
    fn of(p: &Primitive) -> Self {
        let (low, high) = p.bounds();
        Self { low, high }
    }

    fn join(&self, other: &Self) -> Self {
        Self { low: self.low.inf(&other.low), high: self.high.sup(&other.high) }
    }

    fn half_area(&self) -> f64 {
        let e = self.high - self.low;
        e.x * e.y + e.y * e.z + e.z * e.x
    }

    /// Parameter at which the ray enters, if it does before `t_max`.
    #[inline]
    fn enter(&self, origin: &Point3<f64>, inverse: &Vector3<f64>, t_max: f64) -> Option<f64> {
        let (mut enter, mut leave) = (0.0f64, t_max);
        for k in 0..3 {
            let a = (self.low[k] - origin[k]) * inverse[k];
            let b = (self.high[k] - origin[k]) * inverse[k];
            // `max` and `min` ignore the NaN of 0·∞, which leaves the slab open: correct here.
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        (enter <= leave).then_some(enter)
    }
}

impl Scene {
    /// Arranges the solids for ray casting; their order may change.
    pub fn new(primitives: Vec<Primitive>) -> Self {
        let mut entries: Vec<(Aabb, Primitive)> = primitives.into_iter().map(|p| (Aabb::of(&p), p)).collect();
        let mut nodes = Vec::new();
        if !entries.is_empty() {
            build(&mut entries, 0, &mut nodes);
        }
        Self { primitives: entries.into_iter().map(|e| e.1).collect(), nodes }
    }

    /// The solids; [`Hit::primitive`] indexes them.
    pub fn primitives(&self) -> &[Primitive] {
        &self.primitives
    }

    /// First solid entered by `origin + t·direction` with `t` in `(0, t_max)`.
    pub fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>, t_max: f64) -> Option<Hit> {
        let inverse = direction.map(|v| 1.0 / v);
        let mut best: Option<Hit> = None;
        let mut limit = t_max;
        // Every split leaves at least an eighth on either side: 128 levels are out of reach.
        let mut stack = [(0u32, 0.0f64); 128];
        let mut top = 0;
        if let Some(t) = self.nodes.first().and_then(|n| n.bounds.enter(origin, &inverse, limit)) {
            stack[0] = (0, t);
            top = 1;
        }
        while top > 0 {
            top -= 1;
            let (at, t) = stack[top];
            if t >= limit {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                let first = node.at as usize;
                for (i, p) in self.primitives[first..first + node.count as usize].iter().enumerate() {
                    if let Some(e) = p.enter(origin, direction, 0.0, limit) {
                        limit = e.t;
                        best = Some(Hit { t: e.t, normal: e.normal, primitive: first + i });
                    }
                }
                continue;
            }
            let children = [at + 1, node.at];
            let t = children.map(|c| self.nodes[c as usize].bounds.enter(origin, &inverse, limit));
            let near_first = if t[0] <= t[1] { [1, 0] } else { [0, 1] };
            for side in near_first {
                if let Some(t) = t[side] {
                    stack[top] = (children[side], t);
                    top += 1;
                }
            }
        }
        best
    }
}

/// Splits `entries` (which start at index `offset` of the scene) where the surface area
/// heuristic along the widest axis is lowest, and appends the nodes depth first.
fn build(entries: &mut [(Aabb, Primitive)], offset: usize, nodes: &mut Vec<Node>) {
    let bounds = entries[1..].iter().fold(entries[0].0, |a, e| a.join(&e.0));
    let me = nodes.len();
    nodes.push(Node { bounds, at: offset as u32, count: entries.len() as u32 });
    if entries.len() <= LEAF {
        return;
    }
    let center = |e: &(Aabb, Primitive)| e.0.low + e.0.high;
    let first = center(&entries[0]);
    let (low, high) = entries.iter().fold((first, first), |(l, h), e| (l.inf(&center(e)), h.sup(&center(e))));
    let axis = (high - low).imax();
    entries.sort_by(|a, b| center(a)[axis].total_cmp(&center(b)[axis]));
    let n = entries.len();
    let mut right = vec![0.0; n];
    let mut bounds = entries[n - 1].0;
    for i in (1..n).rev() {
        bounds = bounds.join(&entries[i].0);
        right[i] = bounds.half_area() * (n - i) as f64;
    }
    let margin = (n / 8).max(1);
    let (mut split, mut cost, mut bounds) = (n / 2, f64::INFINITY, entries[0].0);
    for i in 1..=n - margin {
        bounds = bounds.join(&entries[i - 1].0);
        let c = bounds.half_area() * i as f64 + right[i];
        if i >= margin && c < cost {
            (split, cost) = (i, c);
        }
    }
    nodes[me].count = 0;
    let (a, b) = entries.split_at_mut(split);
    build(a, offset, nodes);
    nodes[me].at = nodes.len() as u32;
    build(b, offset + split, nodes);
}

#[cfg(test)]
mod tests {
    use super::super::shape::Shape;
    use super::*;
    use nalgebra::Isometry3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_hierarchy_finds_what_trying_every_solid_finds() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut v =
            |s: f64| Vector3::new(rng.random_range(-s..s), rng.random_range(-s..s), rng.random_range(-s..s));
        let solids: Vec<Primitive> = (0..300)
            .map(|i| {
                let shape = match i % 3 {
                    0 => Shape::Box { half: v(0.4).abs() },
                    1 => Shape::Sphere { radius: v(0.3).x.abs() + 0.01 },
                    _ => {
                        Shape::Cylinder { radius: v(0.3).x.abs() + 0.01, half_height: v(0.3).x.abs() + 0.01 }
                    }
                };
                Primitive::new(shape, &Isometry3::new(v(4.0), v(2.0)), [i as u8; 3])
            })
            .collect();
        let scene = Scene::new(solids);
        let mut hits = 0;
        for i in 0..2000 {
            let origin = Point3::from(v(6.0));
            // Every tenth ray is parallel to an axis, where the slab test divides by zero.
            let mut direction = v(1.0);
            if i % 10 == 0 {
                let k = i / 10 % 3;
                direction = Vector3::zeros();
                direction[k] = 1.0;
            }
            let expected = scene
                .primitives()
                .iter()
                .filter_map(|p| p.enter(&origin, &direction, 0.0, 9.0))
                .map(|e| e.t)
                .min_by(f64::total_cmp);
            let found = scene.cast(&origin, &direction, 9.0);
            assert_eq!(found.map(|h| h.t), expected, "ray {i}");
            hits += usize::from(found.is_some());
        }
        assert!(hits > 200, "the rays should meet something: {hits}");
        assert!(Scene::new(Vec::new()).cast(&Point3::origin(), &Vector3::x(), 1.0).is_none());
    }
}
