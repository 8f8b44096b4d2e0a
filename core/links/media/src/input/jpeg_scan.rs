//! Reads the entropy-coded data of a JPEG without decoding it.
//!
//! A flipped bit usually produces codes that the tables do not have, blocks with too many coefficients, or a scan with
//! too few or too many blocks. Decoders tolerate all of these. A flipped bit in a coefficient's value is not found
//! here; nothing in a JPEG can show it.

use super::jpeg_error::JpegError;

const MAX_COMPONENTS: usize = 4;

/// Codes of one table: for each length, the first code, the first symbol's index and the number of codes.
#[derive(Clone, Default)]
struct Table {
    /// For the next 9 bits: symbol and length; length 0 for a longer code.
    short: Vec<(u8, u8)>,
    /// By length 1..=16: one past the largest code, aligned to 16 bits.
    limit: [u32; 17],
    offset: [i32; 17],
    symbols: Vec<u8>,
}

const SHORT_BITS: u32 = 9;
/// Bytes of padding that may follow the last code.
const MAX_PADDING: usize = 8;

impl Table {
    fn new(counts: &[u8; 16], symbols: &[u8]) -> Option<Self> {
        let mut table = Self { symbols: symbols.to_vec(), short: vec![(0, 0); 1 << SHORT_BITS], ..Self::default() };
        let (mut code, mut index) = (0_u32, 0_usize);
        for length in 1..=16_u32 {
            let count = u32::from(counts[length as usize - 1]);
            table.offset[length as usize] = index as i32 - code as i32;
            for _ in 0..count {
                if length <= SHORT_BITS {
                    let first = (code << (SHORT_BITS - length)) as usize;
                    let end = first + (1 << (SHORT_BITS - length));
                    table.short.get_mut(first..end)?.fill((*symbols.get(index)?, length as u8));
                }
                (code, index) = (code + 1, index + 1);
            }
            table.limit[length as usize] = code << (16 - length);
            if code > 1 << length {
                return None;
            }
            code <<= 1;
        }
        Some(table)
    }
}

/// One component of the image.
#[derive(Clone, Copy, Default)]
struct Component {
    id: u8,
    columns: usize,
    rows: usize,
    dc: usize,
    ac: usize,
}

/// Bits of a scan.
struct Bits<'b> {
    bytes: &'b [u8],
    at: usize,
    buffer: u64,
    count: u32,
    /// Number of bits that were read beyond the end.
    missing: u32,
}

impl<'b> Bits<'b> {
    fn new(bytes: &'b [u8]) -> Self {
        Self { bytes, at: 0, buffer: 0, count: 0, missing: 0 }
    }

    fn fill(&mut self) {
        while self.count <= 48 {
            let byte = match self.bytes.get(self.at) {
                Some(0xFF) if self.bytes.get(self.at + 1) == Some(&0) => {
                    self.at += 2;
                    0xFF
                }
                Some(0xFF) | None => {
                    self.missing += 8;
                    0
                }
                Some(byte) => {
                    self.at += 1;
                    *byte
                }
            };
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    fn symbol(&mut self, table: &Table) -> Option<u8> {
        if self.count < 32 {
            self.fill();
        }
        let next = (self.buffer >> (self.count - 16)) as u32 & 0xFFFF;
        let (symbol, length) = table.short[(next >> (16 - SHORT_BITS)) as usize];
        if length > 0 {
            self.count -= u32::from(length);
            return Some(symbol);
        }
        let length = (SHORT_BITS as usize + 1..=16).find(|length| next < table.limit[*length])?;
        self.count -= length as u32;
        let index = (next >> (16 - length)) as i32 + table.offset[length];
        table.symbols.get(usize::try_from(index).ok()?).copied()
    }

    fn value(&mut self, bits: u8) -> i32 {
        if bits == 0 {
            return 0;
        }
        if self.count < 32 {
            self.fill();
        }
        self.count -= u32::from(bits);
        let value = (self.buffer >> self.count) as i32 & ((1 << bits) - 1);
        if value < 1 << (bits - 1) { value - (1 << bits) + 1 } else { value }
    }

    /// Whether, at the end of an interval, exactly all bits but padding were read.
    fn is_used_up(&self) -> bool {
        let Some(left) = self.count.checked_sub(self.missing) else { return false };
        // Cameras fill up to a word, with ones or zeros.
        let whole_bytes = (left / 8) as usize;
        let rest = &self.bytes[self.at..];
        let is_padding = |byte: u8| byte == 0 || byte == 0xFF;
        whole_bytes + rest.len() <= MAX_PADDING
            && rest.iter().all(|byte| is_padding(*byte))
            && (0..whole_bytes).all(|index| is_padding((self.buffer >> (self.missing as usize + 8 * index)) as u8))
    }
}

/// The parts of a scan between restart markers, checked to be in order.
fn intervals(scan: &[u8]) -> Option<Vec<&[u8]>> {
    let (mut found, mut start, mut at, mut next) = (Vec::new(), 0, 0, 0xD0);
    while let Some(marker) = scan[at..].iter().position(|byte| *byte == 0xFF) {
        at += marker;
        match scan.get(at + 1) {
            Some(0) => at += 2,
            Some(byte @ 0xD0..=0xD7) if *byte == next => {
                found.push(&scan[start..at]);
                (at, start, next) = (at + 2, at + 2, if next == 0xD7 { 0xD0 } else { next + 1 });
            }
            _ => return None,
        }
    }
    found.push(&scan[start..]);
    Some(found)
}

/// Reads all blocks of a baseline JPEG of one scan, given as its segments (marker and content) and the bytes of its
/// scan. JPEGs of other kinds are accepted and left to the decoder.
///
/// # Errors
/// [`JpegError::Broken`].
pub fn check(segments: &[(u8, &[u8])], scan: &[u8]) -> Result<(), JpegError> {
    let mut frame: Option<(usize, usize, Vec<Component>)> = None;
    let mut dc: [Option<Table>; 4] = Default::default();
    let mut ac: [Option<Table>; 4] = Default::default();
    let mut restart = 0;
    let mut order = Vec::new();
    for (marker, content) in segments {
        match marker {
            0xC0 | 0xC1 => frame = Some(header(content).ok_or(JpegError::Broken { block: 0 })?),
            // Progressive, lossless, arithmetic.
            0xC2 | 0xC3 | 0xC5..=0xC7 | 0xC9..=0xCB | 0xCD..=0xCF => return Ok(()),
            0xC4 => tables(content, &mut dc, &mut ac).ok_or(JpegError::Broken { block: 0 })?,
            0xDD => restart = content.get(..2).map_or(0, |word| usize::from(word[0]) << 8 | usize::from(word[1])),
            0xDA => {
                let count = content.first().map_or(0, |count| usize::from(*count));
                order = content.get(1..1 + 2 * count).ok_or(JpegError::Broken { block: 0 })?.to_vec();
            }
            _ => {}
        }
    }
    let Some((width, height, components)) = frame else { return Err(JpegError::Broken { block: 0 }) };
    // A scan of some of the components.
    if order.len() / 2 != components.len() {
        return Ok(());
    }
    let mut used = Vec::with_capacity(MAX_COMPONENTS);
    for pair in order.as_chunks::<2>().0 {
        let found = components.iter().find(|component| component.id == pair[0]);
        let component = found.ok_or(JpegError::Broken { block: 0 })?;
        used.push(Component { dc: usize::from(pair[1] >> 4), ac: usize::from(pair[1] & 15), ..*component });
    }
    let most = |size: fn(&Component) -> usize| used.iter().map(size).max().unwrap_or(1);
    let (columns, rows) = (most(|c| c.columns), most(|c| c.rows));
    let units = match used.as_mut_slice() {
        // A single component is not interleaved: its units are blocks.
        [one] => {
            (one.columns, one.rows) = (1, 1);
            width.div_ceil(8) * height.div_ceil(8)
        }
        _ => width.div_ceil(8 * columns) * height.div_ceil(8 * rows),
    };
    let parts = intervals(scan).ok_or(JpegError::Broken { block: 0 })?;
    let per_part = if restart == 0 { units } else { restart };
    if parts.len() != units.div_ceil(per_part.max(1)) {
        return Err(JpegError::Broken { block: 0 });
    }
    for (index, part) in parts.into_iter().enumerate() {
        let first = index * per_part;
        let mut bits = Bits::new(part);
        let mut level = [0_i32; MAX_COMPONENTS];
        for unit in first..units.min(first + per_part) {
            for (number, component) in used.iter().enumerate() {
                let broken = JpegError::Broken { block: unit };
                let (Some(Some(dc)), Some(Some(ac))) = (dc.get(component.dc), ac.get(component.ac)) else {
                    return Err(broken);
                };
                for _ in 0..component.columns * component.rows {
                    block(&mut bits, dc, ac, &mut level[number]).ok_or(broken)?;
                }
            }
            if bits.missing > bits.count {
                return Err(JpegError::Broken { block: unit });
            }
        }
        if !bits.is_used_up() {
            return Err(JpegError::Broken { block: units.min(first + per_part) });
        }
    }
    Ok(())
}

/// Reads one block.
fn block(bits: &mut Bits<'_>, dc: &Table, ac: &Table, level: &mut i32) -> Option<()> {
    let size = bits.symbol(dc)?;
    if size > 11 {
        return None;
    }
    *level += bits.value(size);
    // Levels of eight-bit pictures with the finest quantization; encoders round a little beyond.
    if !(-2100..=2100).contains(level) {
        return None;
    }
    let mut at = 1;
    while at < 64 {
        let symbol = bits.symbol(ac)?;
        let (run, size) = (usize::from(symbol >> 4), symbol & 15);
        match (run, size) {
            (15, 0) => at += 16,
            (_, 0) => return Some(()),
            (_, 11..) => return None,
            _ => {
                at += run + 1;
                bits.value(size);
            }
        }
    }
    (at == 64).then_some(())
}

/// Width, height and components of a frame header.
fn header(content: &[u8]) -> Option<(usize, usize, Vec<Component>)> {
    let word = |at: usize| Some(usize::from(*content.get(at)?) << 8 | usize::from(*content.get(at + 1)?));
    let (height, width, count) = (word(1)?, word(3)?, usize::from(*content.get(5)?));
    if width == 0 || height == 0 || count == 0 || count > MAX_COMPONENTS {
        return None;
    }
    let list = content.get(6..6 + 3 * count)?.as_chunks::<3>().0;
    let components = list.iter().map(|&[id, sampling, _]| {
        let (columns, rows) = (usize::from(sampling >> 4), usize::from(sampling & 15));
        let is_valid = (1..=4).contains(&columns) && (1..=4).contains(&rows);
        is_valid.then_some(Component { id, columns, rows, dc: 0, ac: 0 })
    });
    Some((width, height, components.collect::<Option<Vec<_>>>()?))
}

/// Reads the tables of one segment.
fn tables(content: &[u8], dc: &mut [Option<Table>; 4], ac: &mut [Option<Table>; 4]) -> Option<()> {
    let mut rest = content;
    while let Some((kind, behind)) = rest.split_first() {
        let (counts, behind) = behind.split_first_chunk::<16>()?;
        let total = counts.iter().map(|count| usize::from(*count)).sum();
        let (symbols, behind) = behind.split_at_checked(total)?;
        let list = if kind >> 4 == 0 { &mut *dc } else { &mut *ac };
        *list.get_mut(usize::from(kind & 15))? = Some(Table::new(counts, symbols)?);
        rest = behind;
    }
    Some(())
}
