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
            Scalar::I16 | Scalar::U16 => 2,
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
            Scalar::F32 => number!(f32),
            Scalar::F64 => number!(f64),
        }
    }
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
