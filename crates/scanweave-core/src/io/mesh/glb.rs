//! GLB, the binary form of glTF 2.0: the positions of all meshes of its scene, in the scene's frame.

use super::Mesh;
use crate::error::{Error, Result};
use crate::io::scalar::{Endian, Scalar};
use crate::io::vertices::Vertices;
use nalgebra::{Matrix4, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

pub(super) const MAGIC: &[u8] = b"glTF";
const JSON: u32 = 0x4e4f_534a;
const BIN: u32 = 0x004e_4942;
const CUT_SHORT: &str = "copy or export the file again: it is cut short";
const UNPACK: &str = "export it without compression (Draco, meshopt), or as PLY";

/// The parts of the JSON chunk that lead to the positions.
#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Document {
    scene: Option<usize>,
    scenes: Vec<Scene>,
    nodes: Vec<Node>,
    meshes: Vec<MeshEntry>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<BufferView>,
    buffers: Vec<Buffer>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Scene {
    nodes: Vec<usize>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Node {
    mesh: Option<usize>,
    children: Vec<usize>,
    matrix: Option<Box<[f64; 16]>>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct MeshEntry {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Primitive {
    attributes: BTreeMap<String, usize>,
    /// Points where it is zero, lines up to three, else triangles. Some writers put a word there.
    mode: Option<serde_json::Value>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Accessor {
    buffer_view: Option<usize>,
    byte_offset: usize,
    component_type: u32,
    count: usize,
    r#type: String,
    normalized: bool,
    sparse: Option<serde_json::Value>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct BufferView {
    buffer: usize,
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
    extensions: BTreeMap<String, serde_json::Value>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Buffer {
    uri: Option<String>,
}

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let (json, data) = chunks(path, bytes)?;
    let document: Document = serde_json::from_slice(json).map_err(|e| {
        let found = format!("a description that cannot be read ({e})");
        Error::file(path, found, "the JSON of glTF 2.0", "export it again as GLB")
    })?;
    let mut reader = Reader {
        path,
        document: &document,
        data,
        work: 0,
        limit: bytes.len(),
        xyz: Vec::new(),
        rgb: Vec::new(),
        surfaces: false,
    };
    for (node, world_from_node) in document.placed_nodes() {
        let Some(mesh) = node.mesh.and_then(|m| document.meshes.get(m)) else { continue };
        reader.add(mesh, &world_from_node)?;
    }
    Ok(reader.into_mesh())
}

/// The JSON chunk and the binary chunk.
fn chunks<'a>(path: &Path, bytes: &'a [u8]) -> Result<(&'a [u8], &'a [u8])> {
    let number = |at: usize| {
        let bytes = bytes.get(at..)?.first_chunk()?;
        Some(u32::from_le_bytes(*bytes))
    };
    let cut = |expected: &str| Error::file(path, format!("{} bytes", bytes.len()), expected, CUT_SHORT);
    let version = number(4).ok_or_else(|| cut("a GLB header"))?;
    if version != 2 {
        let found = format!("glTF version {version}");
        return Err(Error::file(path, found, "version 2", "export it as glTF 2.0"));
    }
    let (mut json, mut data) = (None, &bytes[..0]);
    let mut at = 12usize;
    while let (Some(length), Some(kind)) = (number(at), number(at + 4)) {
        let chunk = bytes.get(at + 8..).and_then(|rest| rest.get(..length as usize));
        let chunk =
            chunk.ok_or_else(|| cut(&format!("{} bytes as its chunks say", at + 8 + length as usize)))?;
        match kind {
            JSON if json.is_none() => json = Some(chunk),
            BIN if data.is_empty() => data = chunk,
            _ => {}
        }
        at += 8 + chunk.len();
    }
    Ok((json.ok_or_else(|| cut("a JSON chunk"))?, data))
}

impl Node {
    fn parent_from_node(&self) -> Matrix4<f64> {
        if let Some(matrix) = &self.matrix {
            return Matrix4::from_column_slice(&matrix[..]);
        }
        let [x, y, z, w] = self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 0.0).unwrap_or_default();
        Translation3::from(self.translation.unwrap_or_default()).to_homogeneous()
            * rotation.to_homogeneous()
            * Matrix4::new_nonuniform_scaling(&Vector3::from(self.scale.unwrap_or([1.0; 3])))
    }
}

impl Document {
    /// The nodes of the scene with their transforms, each once: a node has one parent.
    fn placed_nodes(&self) -> Vec<(&Node, Matrix4<f64>)> {
        let scene = self.scenes.get(self.scene.unwrap_or(0));
        let roots = scene.map_or_else(|| self.roots(), |s| s.nodes.clone());
        let mut seen = vec![false; self.nodes.len()];
        let mut open: Vec<(usize, Matrix4<f64>)> =
            roots.into_iter().rev().map(|node| (node, Matrix4::identity())).collect();
        let mut placed = Vec::new();
        while let Some((index, world_from_parent)) = open.pop() {
            let Some(node) = self.nodes.get(index) else { continue };
            if std::mem::replace(&mut seen[index], true) {
                continue;
            }
            let world_from_node = world_from_parent * node.parent_from_node();
            open.extend(node.children.iter().rev().map(|&child| (child, world_from_node)));
            placed.push((node, world_from_node));
        }
        placed
    }

    /// Nodes that are nobody's children, for files without a scene.
    fn roots(&self) -> Vec<usize> {
        let mut is_child = vec![false; self.nodes.len()];
        for &child in self.nodes.iter().flat_map(|n| &n.children) {
            is_child.get_mut(child).into_iter().for_each(|c| *c = true);
        }
        (0..self.nodes.len()).filter(|&n| !is_child[n]).collect()
    }
}

/// Gathers vertices.
struct Reader<'a> {
    path: &'a Path,
    document: &'a Document,
    data: &'a [u8],
    /// Vertices and primitives so far. More than the limit are refused, as a mesh may stand in the scene
    /// again and again.
    work: usize,
    limit: usize,
    xyz: Vec<[f64; 3]>,
    rgb: Vec<[u8; 3]>,
    surfaces: bool,
}

/// An accessor whose bytes are there.
struct Values<'a> {
    bytes: &'a [u8],
    scalar: Scalar,
    stride: usize,
    count: usize,
    normalized: bool,
}

/// Types of positions: floats, and those of KHR_mesh_quantization.
const POSITIONS: [Scalar; 5] = [Scalar::F32, Scalar::I8, Scalar::U8, Scalar::I16, Scalar::U16];

impl Values<'_> {
    fn three(&self, row: usize) -> [f64; 3] {
        let number = |k: usize| {
            let bytes = self.bytes.get(row * self.stride + k * self.scalar.size()..).unwrap_or(&[]);
            self.scalar.read(bytes, Endian::Little)
        };
        [number(0), number(1), number(2)]
    }

    /// The same as fractions of the largest number, where they are to be taken so.
    fn position(&self, row: usize) -> [f64; 3] {
        let largest = match self.scalar {
            _ if !self.normalized => return self.three(row),
            Scalar::I8 => 127.0,
            Scalar::U8 => 255.0,
            Scalar::I16 => 32767.0,
            Scalar::U16 => 65535.0,
            _ => 1.0,
        };
        self.three(row).map(|v| (v / largest).max(-1.0))
    }
}

impl<'a> Reader<'a> {
    fn add(&mut self, mesh: &MeshEntry, world_from_node: &Matrix4<f64>) -> Result<()> {
        // Primitives of one mesh often share their vertices and differ in triangles.
        let mut taken = BTreeSet::new();
        for primitive in &mesh.primitives {
            let Some(&position) = primitive.attributes.get("POSITION") else { continue };
            self.surfaces |= primitive.mode.as_ref().is_none_or(|mode| mode.as_u64() > Some(3));
            let is_new = taken.insert(position);
            let positions = self.values(position, &["VEC3"], &POSITIONS)?;
            self.work += if is_new { positions.count } else { 0 } + 1;
            if self.work > self.limit {
                let found = "a mesh that stands in the scene again and again";
                let remedy = "export each of its places as a mesh of its own";
                return Err(Error::file(self.path, found, "not more vertices than bytes", remedy));
            }
            if !is_new {
                continue;
            }
            let before = self.xyz.len();
            self.xyz.extend((0..positions.count).map(|row| {
                let point = world_from_node.transform_point(&Point3::from(positions.position(row)));
                <[f64; 3]>::from(point.coords)
            }));
            let colors = primitive.attributes.get("COLOR_0");
            if let Some(&colors) = colors.filter(|_| self.rgb.len() == before) {
                let types = [Scalar::U8, Scalar::U16, Scalar::F32];
                let colors = self.values(colors, &["VEC3", "VEC4"], &types)?;
                let largest = match colors.scalar {
                    Scalar::U8 => 255.0,
                    Scalar::U16 => 65535.0,
                    _ => 1.0,
                };
                let count = colors.count.min(positions.count);
                let byte = |v: f64| (v / largest * 255.0).round() as u8;
                self.rgb.extend((0..count).map(|row| colors.three(row).map(byte)));
            }
        }
        Ok(())
    }

    /// The bytes of an accessor.
    fn values(&self, index: usize, shapes: &[&str], types: &[Scalar]) -> Result<Values<'a>> {
        let bad = |found: &str, expected: &str, remedy: &str| {
            Error::file(self.path, format!("accessor {index} {found}"), expected, remedy)
        };
        let missing = || bad("that is not there", "an accessor for every attribute", CUT_SHORT);
        let accessor = self.document.accessors.get(index).ok_or_else(missing)?;
        let scalar = match accessor.component_type {
            5120 => Some(Scalar::I8),
            5121 => Some(Scalar::U8),
            5122 => Some(Scalar::I16),
            5123 => Some(Scalar::U16),
            5126 => Some(Scalar::F32),
            _ => None,
        };
        let scalar = scalar.filter(|s| types.contains(s)).ok_or_else(|| {
            let found = format!("of component type {}", accessor.component_type);
            bad(&found, "floats or whole numbers of at most 16 bits (5120 to 5123, 5126)", UNPACK)
        })?;
        if !shapes.contains(&accessor.r#type.as_str()) {
            return Err(bad(&format!("of type {}", accessor.r#type), &shapes.join(" or "), UNPACK));
        }
        let view = accessor.buffer_view.and_then(|v| self.document.buffer_views.get(v));
        let packed = view.is_some_and(|v| v.extensions.keys().any(|name| name.contains("meshopt")));
        let Some(view) = view.filter(|_| !packed && accessor.sparse.is_none()) else {
            return Err(bad("whose values are compressed", "values as they are", UNPACK));
        };
        // Only the first buffer can be the one in the file, and only if it has no address.
        if view.buffer != 0 || self.document.buffers.first().is_none_or(|b| b.uri.is_some()) {
            let remedy = "export it as GLB, which holds everything in one file";
            return Err(bad("whose values lie in another file", "values in the file itself", remedy));
        }
        let element = scalar.size() * if accessor.r#type == "VEC4" { 4 } else { 3 };
        let stride = view.byte_stride.unwrap_or(element).max(element);
        let bytes = self.data.get(view.byte_offset..).and_then(|d| d.get(..view.byte_length));
        let bytes = bytes.and_then(|b| b.get(accessor.byte_offset..)).unwrap_or(&[]);
        let whole = if bytes.len() < element { 0 } else { (bytes.len() - element) / stride + 1 };
        if accessor.count > whole {
            let expected = format!("{} as its description says", accessor.count);
            return Err(bad(&format!("with {whole} values"), &expected, CUT_SHORT));
        }
        Ok(Values { bytes, scalar, stride, count: accessor.count, normalized: accessor.normalized })
    }

    fn into_mesh(self) -> Mesh {
        let rgb = Some(self.rgb).filter(|c| c.len() == self.xyz.len() && !c.is_empty());
        Mesh { vertices: Vertices { xyz: self.xyz, rgb, ..Vertices::default() }, surfaces: self.surfaces }
    }
}
