//! Small files: whole ones, and ones whose header states far more than they hold.

use ndarray_npy::NpzWriter;
use std::io::{Cursor, Write};
use std::path::Path;
use zip::CompressionMethod;
use zip::write::SimpleFileOptions;

/// Points of the whole files.
const POINTS: usize = 12;

fn rows() -> impl Iterator<Item = [f32; 3]> {
    (0..POINTS).map(|i| [0.5 * (7 * i % POINTS) as f32, 0.5 * (i % 3) as f32, 0.25 * (i % 5) as f32])
}

fn le(rows: impl Iterator<Item = [f32; 3]>) -> Vec<u8> {
    rows.flatten().flat_map(f32::to_le_bytes).collect()
}

fn text(columns: &str) -> String {
    rows().map(|[x, y, z]| format!("{x} {y} {z}{columns}\n")).collect()
}

/// A file whose header is text, followed by `data`.
fn after(header: &str, data: &[u8]) -> Vec<u8> {
    [header.as_bytes(), data].concat()
}

pub fn ply(format: &str, count: &str, properties: &str, data: &[u8]) -> Vec<u8> {
    after(&format!("ply\nformat {format} 1.0\nelement vertex {count}\n{properties}end_header\n"), data)
}

pub const PLY_XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

pub fn pcd(data: &str, count: &str, body: &[u8]) -> Vec<u8> {
    let head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n";
    after(&format!("{head}WIDTH {count}\nHEIGHT 1\nPOINTS {count}\nDATA {data}\n"), body)
}

/// A packed body of so many bytes as it says itself; the packed ones are literals.
pub fn lzf(stated: u32, plain: &[u8]) -> Vec<u8> {
    let stream: Vec<u8> = plain.chunks(32).flat_map(|c| [&[c.len() as u8 - 1][..], c].concat()).collect();
    [&(stream.len() as u32).to_le_bytes()[..], &stated.to_le_bytes(), &stream].concat()
}

pub fn ptx(columns: &str, rows: &str) -> Vec<u8> {
    let head = format!("{columns}\n{rows}\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n");
    after(&format!("{head}1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"), text(" 0.5").as_bytes())
}

pub fn npy(descr: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
}

/// An archive of one entry; zeros are added to its content without being held.
pub fn archive(name: &str, content: &[u8], method: CompressionMethod, zeros: usize) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file(name, SimpleFileOptions::default().compression_method(method)).unwrap();
    zip.write_all(content).unwrap();
    write_repeated(&mut zip, 0, zeros);
    zip.finish().unwrap().into_inner()
}

pub fn gzip(content: &[u8], byte: u8, repeated: usize) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packed.write_all(content).unwrap();
    write_repeated(&mut packed, byte, repeated);
    packed.finish().unwrap()
}

fn write_repeated(sink: &mut impl Write, byte: u8, count: usize) {
    let block = vec![byte; 1 << 16];
    for at in (0..count).step_by(block.len()) {
        sink.write_all(&block[..block.len().min(count - at)]).unwrap();
    }
}

fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut sum = flate2::Crc::new();
    sum.update(kind);
    sum.update(data);
    [&(data.len() as u32).to_be_bytes()[..], kind, data, &sum.sum().to_be_bytes()].concat()
}

/// A 16-bit greyscale PNG with `packed` for its pixels, and so many bytes that are none.
pub fn png(width: u32, height: u32, packed: &[u8], other: usize) -> Vec<u8> {
    let size = [width.to_be_bytes(), height.to_be_bytes()].concat();
    let header = [&size[..], &[16, 0, 0, 0, 0]].concat();
    let chunks = [
        chunk(b"IHDR", &header),
        chunk(b"prVt", &vec![7; other]),
        chunk(b"IDAT", packed),
        chunk(b"IEND", &[]),
    ];
    [b"\x89PNG\r\n\x1a\n".to_vec(), chunks.concat()].concat()
}

/// Pixels of the value 1000, a zero before every row.
pub fn pixels(width: usize, height: usize) -> Vec<u8> {
    let row = [&[0][..], &1000u16.to_be_bytes().repeat(width)].concat();
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    packed.write_all(&row.repeat(height)).unwrap();
    packed.finish().unwrap()
}

pub fn glb(count: usize, length: u32) -> Vec<u8> {
    let json = format!(
        r#"{{"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"buffers":[{{"byteLength":{length}}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
        "bufferViews":[{{"buffer":0,"byteLength":{length}}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3"}}]}}"#
    );
    let json = format!("{json}{}", " ".repeat(json.len().wrapping_neg() % 4));
    let data = le(rows());
    let part = |kind: u32, length: u32, bytes: &[u8]| {
        [&length.to_le_bytes()[..], &kind.to_le_bytes(), bytes].concat()
    };
    let json = part(0x4e4f_534a, json.len() as u32, json.as_bytes());
    [b"glTF\x02\0\0\0\xff\xff\xff\xff".to_vec(), json, part(0x004e_4942, length, &data)].concat()
}

pub fn stl(triangles: u32) -> Vec<u8> {
    let one: Vec<u8> = [&le(rows().take(4))[..], &[0, 0]].concat();
    [&[b' '; 80][..], &triangles.to_le_bytes(), &one, &one].concat()
}

pub fn las(path: &Path, compressed: bool) -> Vec<u8> {
    // The writer packs by the extension.
    let path = &path.with_extension(if compressed { "laz" } else { "las" });
    let mut builder = ::las::Builder::from((1, 2));
    builder.point_format = ::las::point::Format::new(2).unwrap();
    builder.point_format.is_compressed = compressed;
    let mut writer = ::las::Writer::from_path(path, builder.into_header().unwrap()).unwrap();
    for [x, y, z] in rows() {
        let point = ::las::Point { x: x.into(), y: y.into(), z: z.into(), ..Default::default() };
        writer.write_point(::las::Point { color: Some(::las::Color::new(1, 2, 3)), ..point }).unwrap();
    }
    writer.close().unwrap();
    std::fs::read(path).unwrap()
}

/// An E57 file of one scan whose description states so many points.
pub fn e57(path: &Path, count: &str) -> Vec<u8> {
    const NAME: &str = "a scan whose name is long";
    use ::e57::{E57Writer, Record, RecordValue};
    let mut file = E57Writer::from_file(path, "file").unwrap();
    let xyz = vec![Record::CARTESIAN_X_F64, Record::CARTESIAN_Y_F64, Record::CARTESIAN_Z_F64];
    let mut scan = file.add_pointcloud(NAME, xyz).unwrap();
    for row in rows() {
        scan.add_point(row.iter().map(|v| RecordValue::Double(f64::from(*v))).collect()).unwrap();
    }
    scan.finalize().unwrap();
    file.finalize().unwrap();
    let pages = std::fs::read(path).unwrap();
    let mut content: Vec<u8> = pages.chunks(1024).flat_map(|page| &page[..1020]).copied().collect();
    // A longer number and a shorter name: the description keeps its length.
    let mut put = |text: &str, by: &str| {
        let at = content.windows(text.len()).position(|w| w == text.as_bytes()).unwrap();
        content.splice(at..at + text.len(), by.bytes());
    };
    put("recordCount=\"12\"", &format!("recordCount=\"{count}\""));
    put(NAME, &NAME[count.len() - 2..]);
    let with_sum = |page: &[u8]| [page, &crc32c(page).to_be_bytes()].concat();
    content.chunks(1020).flat_map(with_sum).collect()
}

/// The checksum of a page, bit by bit (Castagnoli).
fn crc32c(page: &[u8]) -> u32 {
    !page.iter().fold(u32::MAX, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |s, _| if s & 1 == 1 { s >> 1 ^ 0x82f6_3b78 } else { s >> 1 })
    })
}

/// A JPEG frame of so many grey pixels a side, and the start of a scan.
pub fn jpeg(side: u16) -> Vec<u8> {
    let [high, low] = side.to_be_bytes();
    let frame = [0xff, 0xc0, 0, 11, 8, high, low, high, low, 1, 1, 0x11, 0];
    [&[0xff, 0xd8][..], &frame, &[0xff, 0xda, 0, 8, 1, 1, 0, 0, 63, 0, 0xff, 0xd9]].concat()
}

/// One whole file of every format: its name and its bytes.
pub fn whole(folder: &Path) -> Vec<(&'static str, Vec<u8>)> {
    let data = le(rows());
    let place = folder.join("made");
    let mut npz = NpzWriter::new_compressed(Cursor::new(Vec::new()));
    let points = ndarray::Array2::from_shape_vec((POINTS, 3), rows().flatten().collect::<Vec<f32>>());
    npz.add_array("points", &points.unwrap()).unwrap();
    let ply = ply("binary_little_endian", "12", PLY_XYZ, &data);
    let off = after("OFF\n12 0 0\n", text("").as_bytes());
    let obj: String = text("").lines().map(|line| format!("v {line}\n")).collect();
    vec![
        ("a.pcd", pcd("binary", "12", &data)),
        ("b.pcd", pcd("binary_compressed", "12", &lzf(144, &data))),
        ("a.ptx", ptx("4", "3")),
        ("a.pts", after("12\n", text(" 0.5").as_bytes())),
        ("a.xyz", text("").into_bytes()),
        ("a.npy", npy("'<f4'", "False", "(12, 3)", &data)),
        ("a.npz", npz.finish().unwrap().into_inner()),
        ("a.las", las(&place, false)),
        ("a.laz", las(&place, true)),
        ("a.e57", e57(&place, "12")),
        ("a.glb", glb(POINTS, data.len() as u32)),
        ("a.stl", stl(2)),
        ("a.off", off),
        ("a.obj", obj.into_bytes()),
        ("a.bin", rows().flat_map(|[x, y, z]| [x, y, z, 0.5]).flat_map(f32::to_le_bytes).collect()),
        ("a.png", png(8, 6, &pixels(8, 6), 0)),
        ("a.pgm", after("P5 8 6 65535\n", &1000u16.to_be_bytes().repeat(48))),
        ("a.ply.gz", gzip(&ply, 0, 0)),
        ("a.zip", archive("a.ply", &ply, CompressionMethod::Deflated, 0)),
        ("a.ply", ply),
    ]
}
