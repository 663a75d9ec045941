//! The header of an NPY array: a Python dictionary with the type, the order and the shape.
//!
//! Read here rather than through `ndarray-npy`, which reserves whatever shape a header claims and needs
//! the number type to be known before.

use super::scalar::{Endian, Scalar};

/// A header longer than this is none. NumPy itself refuses ones above 10 000 bytes.
const HEADER_LIMIT_BYTES: usize = 1 << 20;
/// Tuples and lists in one another are no deeper than this in types that anybody writes.
const DEPTH_LIMIT: usize = 16;

/// What messages call the type of an array with fields.
pub(super) const STRUCTURED: &str = "structured";

/// One field of an element: some numbers of one type.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Field {
    /// Empty for the elements of a plain array.
    pub name: String,
    /// `None` for what is no real number: text, complex numbers, padding.
    pub scalar: Option<Scalar>,
    pub endian: Endian,
    /// Byte of an element at which it begins.
    pub offset: usize,
    pub count: usize,
}

/// What a header says.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    /// The type as it is written, for messages.
    pub descr: String,
    pub fields: Vec<Field>,
    pub element_bytes: usize,
    pub column_major: bool,
    pub shape: Vec<usize>,
}

impl Header {
    /// Elements of the array, unless they are too many to count.
    pub(super) fn elements(&self) -> Option<usize> {
        // A zero anywhere means none, however large the others are.
        if self.shape.contains(&0) {
            return Some(0);
        }
        self.shape.iter().try_fold(1usize, |n, &d| n.checked_mul(d))
    }

    pub(super) fn data_bytes(&self) -> Option<usize> {
        self.elements()?.checked_mul(self.element_bytes)
    }

    /// The type of a plain array of numbers.
    pub(super) fn plain(&self) -> Option<(Scalar, Endian)> {
        match &self.fields[..] {
            [field] if field.name.is_empty() && field.count == 1 => Some((field.scalar?, field.endian)),
            _ => None,
        }
    }
}

/// Bytes before the data, of which the first twelve are enough to tell; `None` for what is no NPY.
pub(super) fn length(bytes: &[u8]) -> Option<usize> {
    let rest = bytes.strip_prefix(b"\x93NUMPY")?;
    let length = match *rest.first()? {
        1 => 10 + usize::from(u16::from_le_bytes(*rest.get(2..4)?.first_chunk()?)),
        _ => (u32::from_le_bytes(*rest.get(2..6)?.first_chunk()?) as usize).checked_add(12)?,
    };
    (length <= HEADER_LIMIT_BYTES).then_some(length)
}

/// The header, and what follows it; `None` for what is no NPY.
pub(super) fn parse(bytes: &[u8]) -> Option<(Header, &[u8])> {
    let length = length(bytes)?;
    let (head, data) = bytes.split_at_checked(length)?;
    let from = if head.get(6) == Some(&1) { 10 } else { 12 };
    let text = std::str::from_utf8(head.get(from..)?).ok()?;
    let Literal::Dict(entries) = (Parser { rest: text }).value(0)? else { return None };
    let entry = |key: &str| entries.iter().find(|(k, _)| k == key).map(|(_, v)| v);
    let Literal::List(shape) = entry("shape")? else { return None };
    let shape = shape.iter().map(Literal::size).collect::<Option<Vec<usize>>>()?;
    let descr = entry("descr")?;
    let mut fields = Vec::new();
    let element_bytes = add_fields(descr, "", 0, 1, &mut fields, 0)?;
    let header = Header {
        descr: match descr {
            Literal::Text(text) => text.clone(),
            _ => STRUCTURED.to_owned(),
        },
        fields,
        element_bytes,
        column_major: matches!(entry("fortran_order"), Some(Literal::Word(w)) if w == "True"),
        shape,
    };
    Some((header, data))
}

/// Adds the fields of a type that begins at byte `offset` and is there `count` times; returns its bytes.
fn add_fields(
    descr: &Literal,
    name: &str,
    offset: usize,
    count: usize,
    fields: &mut Vec<Field>,
    depth: usize,
) -> Option<usize> {
    if depth > DEPTH_LIMIT {
        return None;
    }
    match descr {
        Literal::Text(code) => {
            let (scalar, endian, bytes) = type_of(code)?;
            fields.push(Field { name: name.to_owned(), scalar, endian, offset, count });
            bytes.checked_mul(count)
        }
        Literal::List(members) => {
            let mut bytes = 0usize;
            let first = fields.len();
            for member in members {
                let Literal::List(parts) = member else { return None };
                let name = match parts.first()? {
                    Literal::Text(name) => name,
                    // A title before the name.
                    Literal::List(pair) => match pair.get(1)? {
                        Literal::Text(name) => name,
                        _ => return None,
                    },
                    _ => return None,
                };
                let count = match parts.get(2) {
                    None => 1,
                    Some(Literal::List(shape)) => {
                        shape.iter().try_fold(1usize, |n, d| n.checked_mul(d.size()?))?
                    }
                    Some(single) => single.size()?,
                };
                let at = offset.checked_add(bytes)?;
                bytes = bytes.checked_add(add_fields(parts.get(1)?, name, at, count, fields, depth + 1)?)?;
            }
            // Structures in a row: the numbers of one field do not lie side by side.
            if count != 1 {
                fields[first..].iter_mut().for_each(|f| f.scalar = None);
            }
            bytes.checked_mul(count)
        }
        _ => None,
    }
}

/// The number type of a code such as `<f4`, if it is a real number, and its bytes.
fn type_of(code: &str) -> Option<(Option<Scalar>, Endian, usize)> {
    let endian = if code.starts_with('>') { Endian::Big } else { Endian::Little };
    let code = code.trim_start_matches(['<', '>', '|', '=']);
    let kind = code.chars().next()?;
    // A unit may follow, as in 'M8[ns]'.
    let digits = code[kind.len_utf8()..].split('[').next()?;
    let size: usize = digits.parse().ok()?;
    let scalar = match (kind, size) {
        ('f', 2) => Scalar::F16,
        ('f', 4) => Scalar::F32,
        ('f', 8) => Scalar::F64,
        ('i', 1) => Scalar::I8,
        ('u' | 'b', 1) => Scalar::U8,
        ('i', 2) => Scalar::I16,
        ('u', 2) => Scalar::U16,
        ('i', 4) => Scalar::I32,
        ('u', 4) => Scalar::U32,
        ('i', 8) => Scalar::I64,
        ('u', 8) => Scalar::U64,
        // Text of NumPy takes four bytes a character.
        ('U', characters) => return Some((None, endian, characters.checked_mul(4)?)),
        _ => return Some((None, endian, size)),
    };
    Some((Some(scalar), endian, size))
}

/// A Python literal, as far as headers need it. Tuples count as lists.
#[derive(Debug, Clone, PartialEq)]
enum Literal {
    Text(String),
    /// A number, `True`, `False` or `None`.
    Word(String),
    List(Vec<Literal>),
    Dict(Vec<(String, Literal)>),
}

impl Literal {
    fn size(&self) -> Option<usize> {
        match self {
            // Python 2 wrote `3L`.
            Literal::Word(word) => word.trim_end_matches('L').parse().ok(),
            _ => None,
        }
    }
}

struct Parser<'a> {
    rest: &'a str,
}

impl Parser<'_> {
    fn skip(&mut self, symbol: char) -> bool {
        self.rest = self.rest.trim_start();
        let after = self.rest.strip_prefix(symbol);
        self.rest = after.unwrap_or(self.rest);
        after.is_some()
    }

    fn value(&mut self, depth: usize) -> Option<Literal> {
        if depth > DEPTH_LIMIT {
            return None;
        }
        self.rest = self.rest.trim_start();
        let first = self.rest.chars().next()?;
        match first {
            '\'' | '"' => {
                let (text, rest) = self.rest[1..].split_once(first)?;
                self.rest = rest;
                Some(Literal::Text(text.to_owned()))
            }
            '(' | '[' => {
                self.skip(first);
                let close = if first == '(' { ')' } else { ']' };
                let mut items = Vec::new();
                while !self.skip(close) {
                    items.push(self.value(depth + 1)?);
                    if !self.skip(',') {
                        return self.skip(close).then_some(Literal::List(items));
                    }
                }
                Some(Literal::List(items))
            }
            '{' => {
                self.skip(first);
                let mut entries = Vec::new();
                while !self.skip('}') {
                    let Literal::Text(key) = self.value(depth + 1)? else { return None };
                    if !self.skip(':') {
                        return None;
                    }
                    entries.push((key, self.value(depth + 1)?));
                    if !self.skip(',') {
                        return self.skip('}').then_some(Literal::Dict(entries));
                    }
                }
                Some(Literal::Dict(entries))
            }
            _ => {
                let end = self.rest.find(|c: char| !(c.is_ascii_alphanumeric() || "+-._".contains(c)));
                let (word, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
                self.rest = rest;
                (!word.is_empty()).then(|| Literal::Word(word.to_owned()))
            }
        }
    }
}
