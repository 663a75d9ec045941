//! Columns of a text file as a user names them: `x=3,y=4,z=5`.

use serde::{Deserialize, Serialize};

/// Columns of a text file, counted from 1, that hold what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TextColumns {
    /// Coordinates x, y, z.
    pub xyz: [usize; 3],
    /// Red, green, blue.
    pub rgb: Option<[usize; 3]>,
    /// Strength of the return.
    pub intensity: Option<usize>,
}

impl TryFrom<String> for TextColumns {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<TextColumns> for String {
    fn from(columns: TextColumns) -> String {
        columns.to_string()
    }
}

impl std::fmt::Display for TextColumns {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.xyz;
        write!(f, "x={x},y={y},z={z}")?;
        if let Some([r, g, b]) = self.rgb {
            write!(f, ",r={r},g={g},b={b}")?;
        }
        self.intensity.map_or(Ok(()), |i| write!(f, ",i={i}"))
    }
}

impl std::str::FromStr for TextColumns {
    type Err = String;

    /// From `x=3,y=4,z=5`, with `r=`, `g=`, `b=` and `i=` where wanted.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const KEYS: [&str; 7] = ["x", "y", "z", "r", "g", "b", "i"];
        let mut found = [None; 7];
        for part in text.split(',') {
            let (key, number) = part.split_once('=').ok_or_else(|| format!("'{part}' is not KEY=NUMBER"))?;
            let key = key.trim().to_ascii_lowercase();
            let place = KEYS.iter().position(|k| *k == key);
            let place = place.ok_or_else(|| format!("'{key}' is none of x, y, z, r, g, b, i"))?;
            let number = number.trim().parse::<usize>().ok().filter(|&n| n > 0);
            let number = number.ok_or_else(|| format!("'{part}': columns are counted from 1"))?;
            if found[place].replace(number).is_some() {
                return Err(format!("{key} is given twice"));
            }
        }
        let three = |k: usize| Some([found[k]?, found[k + 1]?, found[k + 2]?]);
        let xyz = three(0).ok_or("x, y and z are needed, as in x=3,y=4,z=5")?;
        let some_color = found[3..6].iter().any(Option::is_some);
        if some_color && three(3).is_none() {
            return Err("a colour needs r, g and b".to_owned());
        }
        Ok(Self { xyz, rgb: three(3), intensity: found[6] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_read_as_the_help_says() {
        let plain: TextColumns = "x=3,y=4,z=5".parse().unwrap();
        assert_eq!(plain, TextColumns { xyz: [3, 4, 5], rgb: None, intensity: None });
        let full: TextColumns = "Z=1, y=2,x=3,i=9,r=4,g=5,b=6".parse().unwrap();
        assert_eq!(full.to_string(), "x=3,y=2,z=1,r=4,g=5,b=6,i=9");
        assert_eq!(full, TextColumns { xyz: [3, 2, 1], rgb: Some([4, 5, 6]), intensity: Some(9) });
        for (wrong, said) in [
            ("x=1,y=2", "x, y and z are needed"),
            ("x=0,y=1,z=2", "counted from 1"),
            ("x=1,y=2,z=3,r=4", "r, g and b"),
            ("x=1,x=2,z=3", "twice"),
            ("a=1", "none of"),
            ("1,2,3", "KEY=NUMBER"),
        ] {
            let message = wrong.parse::<TextColumns>().unwrap_err();
            assert!(message.contains(said), "{wrong}: {message}");
        }
    }
}
