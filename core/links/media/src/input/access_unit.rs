//! Checks of an access unit without decoding: whether it is damaged, and whether decoding can begin with it.

/// Separation of the codec's units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// H.264.
    H264,
    /// H.265.
    H265,
}

/// Units of an access unit: after start codes, or each after its length of `length_bytes` bytes.
fn units(bytes: &[u8], length_bytes: Option<usize>) -> Vec<&[u8]> {
    let mut found = Vec::new();
    match length_bytes {
        Some(length_bytes) => {
            let mut rest = bytes;
            while let Some((length, behind)) = rest.split_at_checked(length_bytes) {
                let length = length.iter().fold(0_usize, |sum, byte| sum << 8 | usize::from(*byte));
                let unit = behind.get(..length).unwrap_or(behind);
                found.push(unit);
                rest = &behind[unit.len()..];
            }
        }
        None => {
            let starts: Vec<usize> = (0..bytes.len().saturating_sub(3))
                .filter(|at| bytes[*at..*at + 3] == [0, 0, 1])
                .map(|at| at + 3)
                .collect();
            for (index, start) in starts.iter().enumerate() {
                let end = starts.get(index + 1).map_or(bytes.len(), |next| next - 3);
                found.push(&bytes[*start..end]);
            }
        }
    }
    found
}

/// Whether a supplemental unit of H.264 announces that decoding can begin exactly here (recovery point, no frames to
/// wait for).
fn is_recovery_point(payload: &[u8]) -> bool {
    let mut rest = payload;
    let number = |rest: &mut &[u8]| {
        let mut sum = 0_usize;
        while let Some((byte, behind)) = rest.split_first() {
            *rest = behind;
            sum += usize::from(*byte);
            if *byte != 0xFF {
                return Some(sum);
            }
        }
        None
    };
    while rest.len() > 2 {
        let (Some(kind), Some(size)) = (number(&mut rest), number(&mut rest)) else { return false };
        let Some((body, behind)) = rest.split_at_checked(size) else { return false };
        // `recovery_frame_cnt` is an Exp-Golomb number: a leading 1 is 0.
        if kind == 6 {
            return body.first().is_some_and(|byte| byte & 0x80 != 0);
        }
        rest = behind;
    }
    false
}

/// Whether an access unit begins a group of images that depends on no earlier data. Images that are shown before it
/// may still depend on earlier data.
pub fn is_key(codec: Codec, bytes: &[u8], length_bytes: Option<usize>) -> bool {
    units(bytes, length_bytes).into_iter().any(|unit| match (codec, unit) {
        (Codec::H264, [header, payload @ ..]) => match header & 0x1F {
            5 => true,
            6 => is_recovery_point(payload),
            _ => false,
        },
        (Codec::H265, [header, ..]) => (16..=21).contains(&(header >> 1 & 0x3F)),
        _ => false,
    })
}

/// Whether an access unit is damaged: its units do not fill it, or contain bytes that the codecs' emulation prevention
/// excludes, as in zeroed and shifted data.
pub fn is_broken(codec: Codec, bytes: &[u8], length_bytes: Option<usize>) -> bool {
    let units = units(bytes, length_bytes);
    let is_filled = length_bytes.is_none_or(|length_bytes| {
        let filled: usize = units.iter().map(|unit| unit.len() + length_bytes).sum();
        let last_length = units.last().map_or(0, |unit| {
            let at = bytes.len().saturating_sub(unit.len() + length_bytes);
            let length = bytes.get(at..at + length_bytes).unwrap_or(&[]);
            length.iter().fold(0_usize, |sum, byte| sum << 8 | usize::from(*byte))
        });
        filled == bytes.len() && units.last().is_none_or(|unit| unit.len() == last_length)
    });
    !is_filled || units.iter().any(|unit| is_unit_broken(codec, unit, length_bytes.is_none()))
}

fn is_unit_broken(codec: Codec, unit: &[u8], may_end_in_zeros: bool) -> bool {
    let header_bytes = match codec {
        Codec::H264 => 1,
        Codec::H265 => 2,
    };
    let mut end = unit.len();
    while may_end_in_zeros && end > 0 && unit[end - 1] == 0 {
        end -= 1;
    }
    let unit = &unit[..end];
    // The first bit is always 0.
    if unit.len() <= header_bytes || unit[0] & 0x80 != 0 {
        return true;
    }
    unit.windows(3).any(|bytes| bytes[0] == 0 && bytes[1] == 0 && bytes[2] <= 2)
}

/// Bytes of the length before each unit, from the codec's configuration record.
pub fn length_bytes(codec: Codec, record: &[u8]) -> usize {
    let at = match codec {
        Codec::H264 => 4,
        Codec::H265 => 21,
    };
    record.get(at).map_or(4, |byte| usize::from(byte & 3) + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_pictures_are_told_from_others() {
        let idr = [0, 0, 0, 1, 0x09, 0x10, 0, 0, 1, 0x65, 1, 2, 3];
        let other = [0, 0, 1, 0x41, 1, 2, 3];
        assert!(is_key(Codec::H264, &idr, None) && !is_key(Codec::H264, &other, None));
        let sized = [0, 0, 0, 2, 0x06, 0xFF, 0, 0, 0, 3, 0x65, 1, 2];
        assert!(is_key(Codec::H264, &sized, Some(4)));
        assert!(!is_key(Codec::H264, &sized[..8], Some(4)));
        // A recovery point with no frame to wait for, and one that waits for five.
        assert!(is_key(Codec::H264, &[0, 0, 1, 0x06, 6, 1, 0xC4, 0x80], None));
        assert!(!is_key(Codec::H264, &[0, 0, 1, 0x06, 6, 1, 0x34, 0x80], None));
        assert!(
            is_key(Codec::H265, &[0, 0, 1, 19 << 1, 1, 7], None)
                && !is_key(Codec::H265, &[0, 0, 1, 1 << 1, 1, 7], None)
        );
        // Nonsense is no key and does no harm.
        for length in 0..idr.len() {
            let _ = is_key(Codec::H264, &idr[..length], Some(4));
            let _ = is_key(Codec::H264, &idr[length..], None);
        }
        let whole = [0, 0, 0, 4, 0x41, 1, 0, 7, 0, 0, 0, 2, 0x06, 0xFF];
        assert!(!is_broken(Codec::H264, &whole, Some(4)) && !is_broken(Codec::H264, &other, None));
        assert!(!is_broken(Codec::H264, &[0, 0, 1, 0x41, 1, 0, 0, 3, 1, 0, 0, 0, 1, 0x41, 9, 0], None));
        for (at, value) in [(3, 5), (4, 0xC1), (5, 0), (11, 200), (11, 1)] {
            let mut broken = whole;
            (broken[at], broken[7]) = (value, if at == 5 { 0 } else { 7 });
            assert!(is_broken(Codec::H264, &broken, Some(4)), "{at}");
        }
        assert!((1..whole.len()).filter(|length| *length != 8).all(|length| is_broken(
            Codec::H264,
            &whole[..length],
            Some(4)
        )));
        assert_eq!(length_bytes(Codec::H264, &[1, 100, 0, 31, 0xFF]), 4);
        assert_eq!(length_bytes(Codec::H264, &[1, 100, 0, 31, 0xFD]), 2);
    }
}
