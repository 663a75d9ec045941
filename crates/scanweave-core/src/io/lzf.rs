//! LZF decompression, as used by PCD's `binary_compressed`.
//!
//! The stream is a sequence of literal runs (control byte below 32: that many
//! plus one bytes follow) and back references (three bits of length, thirteen
//! of distance; length seven takes another byte).

/// Decompresses to exactly `length` bytes; `Err` holds how many could be recovered.
pub(super) fn decompress(input: &[u8], length: usize) -> Result<Vec<u8>, usize> {
    // LZF expands at most 264 bytes from 3, so a lying length cannot make us reserve more than this.
    let mut out: Vec<u8> = Vec::with_capacity(length.min(input.len().saturating_mul(88)));
    let mut at = 0;
    while let Some(&control) = input.get(at) {
        at += 1;
        let control = usize::from(control);
        if control < 32 {
            let run = input.get(at..at + control + 1).ok_or(out.len())?;
            out.extend_from_slice(run);
            at += run.len();
        } else {
            let mut run = control >> 5;
            if run == 7 {
                run += usize::from(*input.get(at).ok_or(out.len())?);
                at += 1;
            }
            let low = usize::from(*input.get(at).ok_or(out.len())?);
            at += 1;
            let distance = ((control & 31) << 8 | low) + 1;
            let from = out.len().checked_sub(distance).ok_or(out.len())?;
            // Byte by byte: the source may overlap what is being written.
            for k in from..from + run + 2 {
                out.push(out[k]);
            }
        }
        if out.len() > length {
            return Err(out.len());
        }
    }
    if out.len() == length { Ok(out) } else { Err(out.len()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_and_overlapping_references() {
        // "ab" literal, then 6 bytes from distance 2: worked by hand from the format.
        assert_eq!(decompress(&[1, b'a', b'b', 4 << 5, 1], 8), Ok(b"abababab".to_vec()));
        // Length seven takes another byte: 7 + 3 + 2 = 12 bytes from distance 1.
        assert_eq!(decompress(&[0, b'z', 7 << 5, 3, 0], 13), Ok(vec![b'z'; 13]));
    }

    #[test]
    fn damaged_streams_say_how_far_they_went() {
        assert_eq!(decompress(&[5, b'a'], 6), Err(0));
        assert_eq!(decompress(&[0, b'a', 1 << 5, 9], 9), Err(1), "a reference before the start");
        assert_eq!(decompress(&[1, b'a', b'b'], 3), Err(2));
        assert_eq!(decompress(&[1, b'a', b'b'], 1), Err(2));
        assert_eq!(decompress(&[0, b'a', 7 << 5], usize::MAX), Err(1));
    }
}
