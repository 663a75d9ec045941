//! The number types that PLY, PCD and NPY share.

/// Type of one binary number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F16,
    F32,
    F64,
}

/// Byte order of binary numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Endian {
    Little,
    Big,
}

impl Scalar {
    /// Bytes of one number.
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 | Scalar::F16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }

    /// The number at the start of `bytes`; NaN when there are too few bytes.
    #[inline]
    pub(super) fn read(self, bytes: &[u8], endian: Endian) -> f64 {
        macro_rules! number {
            ($t:ty) => {
                match (bytes.first_chunk(), endian) {
                    (Some(b), Endian::Little) => <$t>::from_le_bytes(*b) as f64,
                    (Some(b), Endian::Big) => <$t>::from_be_bytes(*b) as f64,
                    (None, _) => f64::NAN,
                }
            };
        }
        match self {
            Scalar::I8 => number!(i8),
            Scalar::U8 => number!(u8),
            Scalar::I16 => number!(i16),
            Scalar::U16 => number!(u16),
            Scalar::I32 => number!(i32),
            Scalar::U32 => number!(u32),
            Scalar::I64 => number!(i64),
            Scalar::U64 => number!(u64),
            Scalar::F16 => match (bytes.first_chunk(), endian) {
                (Some(b), Endian::Little) => half(u16::from_le_bytes(*b)),
                (Some(b), Endian::Big) => half(u16::from_be_bytes(*b)),
                (None, _) => f64::NAN,
            },
            Scalar::F32 => number!(f32),
            Scalar::F64 => number!(f64),
        }
    }
}

/// The value of a 16-bit float (IEEE 754 binary16): a sign, five bits of exponent, ten of fraction.
fn half(bits: u16) -> f64 {
    let fraction = f64::from(bits & 0x3ff);
    let size = match i32::from(bits >> 10 & 0x1f) {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1.0 + fraction / 1024.0) * 2f64.powi(exponent - 15),
    };
    if bits >> 15 == 1 { -size } else { size }
}

/// A number of a format in which only blanks stand between numbers: a comma in one is its decimal mark,
/// which programs write that follow the language of the system.
pub(super) fn parse_between_blanks(token: &str) -> Option<f64> {
    parse_number(token).or_else(|| {
        let (whole, fraction) = token.split_once(',')?;
        let digits = whole.ends_with(|c: char| c.is_ascii_digit())
            && fraction.starts_with(|c: char| c.is_ascii_digit());
        // A second mark leaves a text that is no number.
        if digits { format!("{whole}.{fraction}").parse().ok() } else { None }
    })
}

/// A number as text files write it, including the spellings of "not a number" of C and C++ runtimes.
pub(super) fn parse_number(token: &str) -> Option<f64> {
    if let Ok(v) = token.parse() {
        return Some(v);
    }
    // "-nan(ind)", "nan(snan)", "1.#QNAN", "-1.#IND", "1.#INF"
    let lower = token.to_ascii_lowercase();
    let bare = lower.trim_start_matches(['+', '-']);
    (bare.starts_with("nan(") || bare.starts_with("1.#")).then_some(f64::NAN)
}

/// A count with its unit, for messages: "1 point", "3 points".
pub(super) fn counted(n: usize, unit: &str) -> String {
    format!("{n} {unit}{}", if n == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_floats_are_those_of_the_standard() {
        // Examples of IEEE 754 binary16: one, its successor, -2, the largest, the smallest normal and
        // subnormal, a third.
        for (bits, value) in [
            (0x3c00, 1.0),
            (0x3c01, 1.000_976_562_5),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0400, 6.103_515_625e-5),
            (0x0001, 5.960_464_477_539_063e-8),
            (0x3555, 0.333_251_953_125),
        ] {
            assert_eq!(half(bits), value, "{bits:x}");
        }
        assert_eq!(Scalar::F16.read(&[0x00, 0x7c], Endian::Little), f64::INFINITY);
        assert!(Scalar::F16.read(&[0x7e, 0x00], Endian::Big).is_nan());
        assert!(Scalar::F16.read(&[0x7e], Endian::Big).is_nan());
    }
}
