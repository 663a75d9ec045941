//! Files that are damaged a little: the same number gives the same damage everywhere.

/// Numbers that are drawn one after the other (SplitMix64: Steele, Lea & Flood, OOPSLA 2014).
pub struct Draw(u64);

impl Draw {
    /// Of case number `case` of the document of this name.
    pub fn of(name: &str, case: u64) -> Self {
        let seed = name.bytes().fold(0u64, |seed, byte| seed.wrapping_mul(31).wrapping_add(byte.into()));
        let mut draw = Self(seed ^ case.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        draw.next();
        draw
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// A number below `end`, or zero where there is none.
    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }

    fn one_of<'a, T: ?Sized>(&mut self, all: &[&'a T]) -> &'a T {
        all[self.below(all.len())]
    }

    /// A stretch of so many bytes at most.
    fn stretch(&mut self, length: usize, most: usize) -> std::ops::Range<usize> {
        let start = self.below(length + 1);
        let size = self.below(most.min(length - start) + 1);
        start..start + size
    }
}

/// Words that stand for numbers in text.
const NUMBERS: &[&str] = &[
    "0",
    "-0",
    "-1",
    "1",
    "255",
    "256",
    "65536",
    "2147483647",
    "2147483648",
    "-2147483648",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "1000000000000",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "1e39",
    "1e999",
    "0.1",
    ".",
    "-",
    "1e",
    "1,5",
    "1.2.3",
    "0x10",
    "",
];
/// Bytes that mean something in one format or another.
const BYTES: &[u8] = b"\0\x01\x7f\x80\xff \n\r\t,;:.-+#/\"'{}[]<>=eE09";
/// Numbers of four and eight bytes.
const INTEGERS: &[u64] = &[
    0,
    1,
    2,
    7,
    255,
    256,
    1023,
    1024,
    65_535,
    65_536,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    1 << 32,
    1 << 40,
    i64::MAX as u64,
    1 << 63,
    u64::MAX,
    0x7ff0_0000_0000_0000,
    0x7ff8_0000_0000_0000,
    0x7f80_0000,
    0x7fc0_0000,
];

/// One to eight changes to one of `seeds`.
pub fn mutated(seeds: &[&[u8]], draw: &mut Draw) -> Vec<u8> {
    let mut bytes = draw.one_of(seeds).to_vec();
    let changes = 1 << draw.below(4);
    for _ in 0..1 + draw.below(changes) {
        change(&mut bytes, seeds, draw);
    }
    bytes
}

fn change(bytes: &mut Vec<u8>, seeds: &[&[u8]], draw: &mut Draw) {
    // The beginning decides more than the rest: half of the changes are made there.
    const BEGINNING: usize = 512;
    let end = if draw.below(2) == 0 { bytes.len().min(BEGINNING) } else { bytes.len() };
    let at = draw.below(end);
    match draw.below(11) {
        0 => bytes.iter_mut().skip(at).take(1).for_each(|b| *b ^= 1 << draw.below(8)),
        1 => bytes.iter_mut().skip(at).take(1).for_each(|b| *b = BYTES[draw.below(BYTES.len())]),
        2 => put_integer(bytes, at, draw),
        3 => bytes.truncate(at),
        4 => drop(bytes.drain(draw.stretch(end, 64))),
        5 => {
            let copied = bytes[draw.stretch(end, 64)].to_vec();
            bytes.splice(at..at, copied);
        }
        6 => {
            let other = draw.one_of(seeds);
            let copied = &other[draw.stretch(other.len(), 256)];
            bytes.splice(at..at, copied.iter().copied());
        }
        7 => {
            let other = draw.one_of(seeds);
            bytes.truncate(at);
            bytes.extend(&other[draw.below(other.len())..]);
        }
        8 => bytes.insert(at, BYTES[draw.below(BYTES.len())]),
        _ => put_number(bytes, at, draw),
    }
}

fn put_integer(bytes: &mut [u8], at: usize, draw: &mut Draw) {
    let value = INTEGERS[draw.below(INTEGERS.len())];
    let size = [1, 2, 4, 8][draw.below(4)];
    let mut stored = value.to_le_bytes()[..size].to_vec();
    if draw.below(3) == 0 {
        stored.reverse();
    }
    bytes.iter_mut().skip(at).zip(stored).for_each(|(byte, new)| *byte = new);
}

/// Another number in place of the next one that is written in digits.
fn put_number(bytes: &mut Vec<u8>, at: usize, draw: &mut Draw) {
    let digit = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'+' | b'e');
    let Some(start) = bytes[at..].iter().position(|b| b.is_ascii_digit()).map(|k| at + k) else { return };
    let start = start - bytes[..start].iter().rev().take_while(|b| digit(b)).count();
    let length = bytes[start..].iter().take_while(|b| digit(b)).count();
    bytes.splice(start..start + length, draw.one_of(NUMBERS).bytes());
}
