//! A part of the work of a stage.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// A part of the work of a stage, which several processes share out: number `index`, from 0, of `count`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Which part.
    pub index: usize,
    /// Of how many.
    pub count: usize,
}

impl Shard {
    /// Everything.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// The items of this shard out of so many: a contiguous stretch, no two stretches differing by more than
    /// one item.
    pub fn range(self, items: usize) -> Range<usize> {
        let count = self.count.max(1) as u128;
        let start = |index: u128| (index * items as u128 / count).min(items as u128) as usize;
        start(self.index as u128)..start(self.index as u128 + 1)
    }
}

/// As it is written: `index/count`.
impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((index, count)) if index < count => Ok(Self { index, count }),
            _ => Err("expected I/N with I from 0 to N - 1, as in 0/4"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_share_out_every_item_once() {
        for (items, count) in [(0, 3), (2, 5), (10, 3), (90, 7)] {
            let all: Vec<usize> = (0..count).flat_map(|index| Shard { index, count }.range(items)).collect();
            assert_eq!(all, (0..items).collect::<Vec<_>>());
            let sizes = (0..count).map(|index| Shard { index, count }.range(items).len());
            let (low, high) = (sizes.clone().min().unwrap(), sizes.max().unwrap());
            assert!(high - low <= 1);
        }
        let last = Shard { index: usize::MAX - 1, count: usize::MAX };
        assert_eq!(last.range(10), 9..10);
    }

    #[test]
    fn a_shard_is_read_as_it_is_written() {
        assert_eq!("2/4".parse(), Ok(Shard { index: 2, count: 4 }));
        assert_eq!(Shard { index: 2, count: 4 }.to_string(), "2/4");
        for bad in ["4/4", "1", "1/0", "0/0", "-1/2", "a/b", "1/2/3", "", "1 / 2"] {
            assert!(bad.parse::<Shard>().is_err(), "{bad}");
        }
    }
}
