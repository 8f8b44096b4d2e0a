//! CRC64 of ECMA-182 in the variant of OpenIGTLink: most significant bit first, start 0, no final inversion.

/// The polynomial; x^64 is implied.
const POLYNOMIAL: u64 = 0x42F0_E1EB_A9EA_3693;

/// `TABLES[k][b]`: the CRC of byte `b` followed by `k` zero bytes. Eight tables process eight bytes at a time.
static TABLES: [[u64; 256]; 8] = tables();

const fn tables() -> [[u64; 256]; 8] {
    let mut tables = [[0; 256]; 8];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u64) << 56;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc >> 63 == 1 { crc << 1 ^ POLYNOMIAL } else { crc << 1 };
            bit += 1;
        }
        tables[0][byte] = crc;
        byte += 1;
    }
    let mut byte = 0;
    while byte < 256 {
        let mut k = 1;
        while k < 8 {
            let crc = tables[k - 1][byte];
            tables[k][byte] = crc << 8 ^ tables[0][(crc >> 56) as usize];
            k += 1;
        }
        byte += 1;
    }
    tables
}

/// CRC64 of `bytes`.
pub fn crc64(bytes: &[u8]) -> u64 {
    update(0, bytes)
}

/// CRC64 of the bytes whose CRC is `crc`, followed by `bytes`.
pub fn update(mut crc: u64, bytes: &[u8]) -> u64 {
    let mut chunks = bytes.chunks_exact(8);
    for chunk in &mut chunks {
        let word =
            crc ^ u64::from_be_bytes([chunk[0], chunk[1], chunk[2], chunk[3], chunk[4], chunk[5], chunk[6], chunk[7]]);
        crc = 0;
        for k in 0..8 {
            crc ^= TABLES[k][(word >> (8 * k)) as usize & 0xFF];
        }
    }
    for byte in chunks.remainder() {
        crc = crc << 8 ^ TABLES[0][((crc >> 56) as u8 ^ byte) as usize];
    }
    crc
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_crc_of_the_standard() {
        // CRC-64/ECMA-182 in the catalogue of parametrised CRCs.
        assert_eq!(crc64(b"123456789"), 0x6C40_DF5F_0B49_7347);
        assert_eq!(crc64(b""), 0);
    }

    #[test]
    fn pieces_give_the_same_crc() {
        let bytes: Vec<u8> = (0..1000_u32).map(|k| (k * 31 % 251) as u8).collect();
        for at in [0, 1, 7, 8, 9, 500, 1000] {
            assert_eq!(update(crc64(&bytes[..at]), &bytes[at..]), crc64(&bytes), "split at {at}");
        }
    }
}
