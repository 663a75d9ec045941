//! Checksums of formats whose readers look no further where these do not fit.

/// Bytes of a page of E57, the last four of which are its checksum.
const PAGE: usize = 1024;

/// An E57 file with the checksum of every page made anew.
pub fn page_sums(bytes: &[u8]) -> Vec<u8> {
    let mut all = bytes.to_vec();
    for page in all.chunks_exact_mut(PAGE) {
        let (content, sum) = page.split_at_mut(PAGE - 4);
        sum.copy_from_slice(&crc(content, 0x82f6_3b78).to_be_bytes());
    }
    all
}

/// A PNG with the checksum of every chunk made anew; of other images the bytes themselves.
pub fn png_sums(bytes: &[u8]) -> Vec<u8> {
    let mut all = bytes.to_vec();
    let mut at = 8;
    while bytes.starts_with(b"\x89PNG")
        && let Some(&length) = all.get(at..).and_then(|rest| rest.first_chunk::<4>())
    {
        let end = at.saturating_add(8).saturating_add(u32::from_be_bytes(length) as usize);
        let Some(content) = all.get(at + 4..end) else { break };
        let sum = crc(content, 0xedb8_8320).to_be_bytes();
        let Some(place) = all.get_mut(end..end + 4) else { break };
        place.copy_from_slice(&sum);
        at = end + 4;
    }
    all
}

/// An archive of one file that is not compressed.
pub fn zipped(name: &str, content: &[u8]) -> Vec<u8> {
    archive(&[(name, content)])
}

/// An archive of files that are not compressed.
pub fn archive(files: &[(&str, &[u8])]) -> Vec<u8> {
    let (mut all, mut directory) = (Vec::new(), Vec::new());
    for (name, content) in files {
        let size = (content.len() as u32).to_le_bytes();
        // Version, flags, method, time, date; checksum, packed and unpacked size, lengths of name and rest.
        let about = [
            &[20, 0, 0, 0, 0, 0, 0, 0, 0x21, 0][..],
            &crc(content, 0xedb8_8320).to_le_bytes(),
            &size,
            &size,
            &(name.len() as u16).to_le_bytes(),
            &[0, 0],
        ]
        .concat();
        let place = (all.len() as u32).to_le_bytes();
        // Length of the comment, disk, attributes, then where the file begins.
        let rest = [&[0; 10][..], &place].concat();
        directory.extend([b"PK\x01\x02\x14\0", &about[..], &rest, name.as_bytes()].concat());
        all.extend([b"PK\x03\x04", &about[..], name.as_bytes(), content].concat());
    }
    let count = (files.len() as u16).to_le_bytes();
    let [length, start] = [directory.len(), all.len()].map(|n| (n as u32).to_le_bytes());
    all.extend(directory);
    all.extend([b"PK\x05\x06\0\0\0\0", &count[..], &count, &length, &start, &[0, 0]].concat());
    all
}

/// The checksum of 32 bits by a polynomial, the lowest bit of which stands first.
fn crc(bytes: &[u8], polynomial: u32) -> u32 {
    let table: [u32; 256] = std::array::from_fn(|byte| {
        (0..8).fold(byte as u32, |s, _| if s & 1 == 1 { s >> 1 ^ polynomial } else { s >> 1 })
    });
    !bytes.iter().fold(u32::MAX, |sum, byte| sum >> 8 ^ table[((sum ^ u32::from(*byte)) & 255) as usize])
}
