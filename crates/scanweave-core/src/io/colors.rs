//! Colour channels as files have them.

use super::scalar::Scalar;

/// Turns colour channels of unknown range into bytes, as [`bytes_per_unit`] has it.
pub(super) fn channels_to_bytes(values: &[[f64; 3]]) -> Vec<[u8; 3]> {
    let scale = bytes_per_unit(values.iter().copied());
    // `as u8` saturates and takes NaN to zero.
    values.iter().map(|c| c.map(|v| (v * scale).round() as u8)).collect()
}

/// What takes colour channels of unknown range to bytes: values all in `[0, 1]` are fractions,
/// values up to 255 are bytes, larger ones 16-bit.
pub(super) fn bytes_per_unit(values: impl Iterator<Item = [f64; 3]>) -> f64 {
    let largest = values.flatten().filter(|v| v.is_finite()).fold(0.0, f64::max);
    if largest <= 1.0 {
        255.0
    } else if largest <= 255.0 {
        1.0
    } else {
        255.0 / 65535.0
    }
}

/// Colour channels of a known type as bytes: those of bytes are no fractions, whatever their range.
pub(super) fn channels_of(values: &[[f64; 3]], scalar: Scalar) -> Vec<[u8; 3]> {
    match scalar {
        Scalar::U8 => values.iter().map(|c| c.map(|v| v as u8)).collect(),
        _ => channels_to_bytes(values),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_ranges() {
        assert_eq!(channels_to_bytes(&[[0.0, 0.5, 1.0]]), [[0, 128, 255]]);
        assert_eq!(channels_to_bytes(&[[0.0, 128.0, 255.0]]), [[0, 128, 255]]);
        assert_eq!(channels_to_bytes(&[[0.0, 32896.0, 65535.0]]), [[0, 128, 255]]);
    }
}
