//! Colours of a depth image's pixels from the colour image beside it.

use super::image_size::same_aspect;
use super::png_file;
use crate::files;
use crate::io::scan_file::{Note, ReadOptions};
use crate::io::unpack_limit::UnpackLimit;
use std::path::Path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Pixels that a byte of a JPEG stands for at most: a block of 8×8 takes a bit or more.
const LARGEST_JPEG_EXPANSION: usize = 8 * 64;

const TOO_LARGE: &str = "more pixels than a file of its size may unpack to";

/// A colour image of 8 bits a channel.
#[derive(Debug, PartialEq)]
struct ColorImage {
    width: usize,
    height: usize,
    /// `[height·width]`, row-major.
    rgb: Vec<[u8; 3]>,
}

/// A colour for every pixel of a depth image of this size, and what is worth saying of it.
///
/// The colour image is taken as registered to the depth image: the same view, of the same size or a
/// larger or smaller one. Scans need no colours, so an image that does not fit is no error.
pub(super) fn colors_of(
    path: &Path,
    width: usize,
    height: usize,
    options: &ReadOptions,
) -> (Option<Vec<[u8; 3]>>, Option<Note>) {
    let bytes = files::read(path).map_err(|e| e.to_string());
    let image = match bytes.and_then(|bytes| decode(&bytes, options)) {
        Ok(image) => image,
        Err(found) if found == TOO_LARGE => {
            let text = "colour images that unpack to more than input.unpack_limit_mib allows are left out";
            return (None, Some(Note::warning(text)));
        }
        Err(_) => return (None, Some(Note::warning("colour images that cannot be read are left out"))),
    };
    if (image.width, image.height) == (width, height) {
        return (Some(image.rgb), None);
    }
    let sizes = format!("colour images of {}x{} pixels", image.width, image.height);
    let [own, of_depth] = [[image.width, image.height], [width, height]].map(|s| s.map(|n| n as f64));
    if !same_aspect(own, of_depth) {
        let text = format!("{sizes} are left out: depth images of {width}x{height} are not of that shape");
        return (None, Some(Note::warning(text)));
    }
    let note = format!("{sizes} are scaled to depth images of {width}x{height}, as registered to them");
    (Some(image.scaled_to(width, height)), Some(Note::info(note)))
}

impl ColorImage {
    /// The colour at the centre of every pixel of an image of the same view and another size.
    fn scaled_to(&self, width: usize, height: usize) -> Vec<[u8; 3]> {
        let middle = |i: usize, from: usize, to: usize| ((2 * i + 1) * to / (2 * from)).min(to - 1);
        let columns: Vec<usize> = (0..width).map(|u| middle(u, width, self.width)).collect();
        let rows = (0..height).map(|v| middle(v, height, self.height) * self.width);
        rows.flat_map(|row| columns.iter().map(move |column| self.rgb[row + column])).collect()
    }
}

fn decode(bytes: &[u8], options: &ReadOptions) -> Result<ColorImage, String> {
    let limit = UnpackLimit::of_scan(options, bytes.len() as u64).bytes();
    if bytes.starts_with(b"\x89PNG") { decode_png(bytes, limit) } else { decode_jpeg(bytes, limit) }
}

fn decode_png(bytes: &[u8], limit: u64) -> Result<ColorImage, String> {
    if png_file::stated_bytes(bytes)? > limit {
        return Err(TOO_LARGE.to_owned());
    }
    let mut reader = png_file::open(bytes, png::Transformations::normalize_to_color8())?;
    let channels = reader.output_color_type().0.samples();
    let (width, height, pixels) = png_file::pixels(&mut reader)?;
    let rgb = match channels {
        1 | 2 => pixels.chunks_exact(channels).map(|p| [p[0]; 3]).collect(),
        _ => pixels.chunks_exact(channels).map(|p| [p[0], p[1], p[2]]).collect(),
    };
    Ok(ColorImage { width, height, rgb })
}

fn decode_jpeg(bytes: &[u8], limit: u64) -> Result<ColorImage, String> {
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|e| e.to_string())?;
    let info = decoder.info().ok_or("no header")?;
    let (width, height) = (usize::from(info.width), usize::from(info.height));
    // Before `decode`, which allocates what the header states.
    if width * height > bytes.len() * LARGEST_JPEG_EXPANSION {
        return Err(format!("its header states {width}x{height} pixels, more than its bytes can hold"));
    }
    if (width * height * 3) as u64 > limit {
        return Err(TOO_LARGE.to_owned());
    }
    let pixels = decoder.decode().map_err(|e| e.to_string())?;
    let rgb = pixels.as_chunks::<3>().0.to_vec();
    if width == 0 || rgb.len() != width * height {
        return Err("not as many pixels as its header states".to_owned());
    }
    Ok(ColorImage { width, height, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scaling_takes_the_pixel_at_the_centre() {
        let image = ColorImage { width: 3, height: 1, rgb: vec![[0; 3], [1; 3], [2; 3]] };
        // Centres of 2 pixels on 3: at 0.75 and 2.25 of the length 3.
        assert_eq!(image.scaled_to(2, 1), [[0; 3], [2; 3]]);
        // Centres of 6 on 3: 0.25, 0.75, …, 2.75.
        assert_eq!(image.scaled_to(6, 1), [0u8, 0, 1, 1, 2, 2].map(|v| [v; 3]));
        assert_eq!(image.scaled_to(3, 2), [0u8, 1, 2, 0, 1, 2].map(|v| [v; 3]));
    }

    #[test]
    fn the_limit_of_the_options_counts() {
        // 600 x 600 black pixels: 1.03 MiB, a few hundred bytes when packed.
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 600, 600);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(&vec![0; 600 * 600 * 3]).unwrap();
        let of = |mib| decode(&bytes, &ReadOptions { unpack_limit_mib: Some(mib), ..ReadOptions::default() });
        assert_eq!(of(1).unwrap_err(), TOO_LARGE);
        assert_eq!(of(2).unwrap().rgb.len(), 360_000);
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("c.png");
        std::fs::write(&path, &bytes).unwrap();
        let options = ReadOptions { unpack_limit_mib: Some(1), ..ReadOptions::default() };
        let (colors, note) = colors_of(&path, 600, 600, &options);
        assert!(colors.is_none() && note.unwrap().text.contains("input.unpack_limit_mib"));
    }

    #[test]
    fn a_jpeg_that_states_more_than_its_bytes_can_hold_is_refused_before_decoding() {
        // Start of image, a frame of 16000 x 16000 grey pixels, and the start of a scan.
        let frame = [0xff, 0xc0, 0, 11, 8, 0x3e, 0x80, 0x3e, 0x80, 1, 1, 0x11, 0];
        let scan = [0xff, 0xda, 0, 8, 1, 1, 0, 0, 63, 0, 0xff, 0xd9];
        let bytes = [&[0xff, 0xd8][..], &frame, &scan].concat();
        let error = decode(&bytes, &ReadOptions::default()).unwrap_err();
        assert!(error.contains("states 16000x16000 pixels, more than"), "{error}");
    }
}
