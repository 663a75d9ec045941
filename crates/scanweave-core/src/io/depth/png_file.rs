//! PNG files whose size is checked against their bytes before anything is allocated.

use std::io::Cursor;

/// Bytes that deflate makes of one at most: 258 of a repetition that takes two bits.
const LARGEST_EXPANSION: usize = 1032;

/// A reader that stands before the pixels.
pub(super) type Reader<'a> = png::Reader<Cursor<&'a [u8]>>;

/// Bytes of all pixels by the header.
///
/// # Errors
/// Why it is damaged: one that states more pixels than its bytes can hold is.
pub(super) fn stated_bytes(bytes: &[u8]) -> Result<u64, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    stated(&mut decoder, bytes)
}

fn stated(decoder: &mut png::Decoder<Cursor<&[u8]>>, bytes: &[u8]) -> Result<u64, String> {
    let info = decoder.read_header_info().map_err(|e| e.to_string())?;
    let (width, height) = (info.width, info.height);
    let stated = info.raw_row_length().checked_mul(height as usize);
    match stated.filter(|stated| *stated <= bytes.len().saturating_mul(LARGEST_EXPANSION)) {
        Some(stated) => Ok(stated as u64),
        None => Err(format!(
            "its header states {width}x{height} pixels, more than {} bytes can hold",
            bytes.len()
        )),
    }
}

/// Reads the header.
///
/// # Errors
/// Those of [`stated_bytes`].
pub(super) fn open(bytes: &[u8], transformations: png::Transformations) -> Result<Reader<'_>, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(transformations);
    // Before `read_info`, which allocates a row.
    stated(&mut decoder, bytes)?;
    decoder.read_info().map_err(|e| e.to_string())
}

/// Width, height and the channels of all pixels, row by row.
///
/// # Errors
/// Why it is damaged.
pub(super) fn pixels(reader: &mut Reader<'_>) -> Result<(usize, usize, Vec<u8>), String> {
    let size = reader.output_buffer_size().ok_or_else(|| "too large".to_owned())?;
    let mut buffer = vec![0; size];
    let info = reader.next_frame(&mut buffer).map_err(|e| e.to_string())?;
    buffer.truncate(info.buffer_size());
    Ok((info.width as usize, info.height as usize, buffer))
}
