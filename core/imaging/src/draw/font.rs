//! A stroke font of our own, drawn on a grid of 5 columns and 9 rows.
//!
//! Each glyph is a list of strokes; a stroke is a run of points, two digits each: column 0..=4, row 0..=8. Row 0 is the
//! top of capitals, row 2 the top of small letters, row 6 the base line, row 8 the lowest descender.

/// Columns from one glyph's start to the next one's.
pub const ADVANCE: f32 = 6.0;
/// Rows from the top of capitals to the lowest descender.
pub const HEIGHT: f32 = 8.0;

/// Strokes of the printable ASCII characters, from space on.
const GLYPHS: [&str; 95] = [
    "",
    "2024 2626",
    "1012 3032",
    "1016 3036 0242 0444",
    "413010010213334445361605 2026",
    "4006 0010110100 3545463635",
    "4612112031320405162644",
    "2022",
    "30121436",
    "10323416",
    "2125 0244 0442",
    "2125 0343",
    "252617",
    "1333",
    "2626",
    "4006",
    "103041453616050110 3214",
    "112026 1636",
    "01103041420646",
    "0110304142334445361605 1333",
    "36300444",
    "400002324345361605",
    "413010010516364544331304",
    "004016",
    "103041423313020110 1304051636454433",
    "051636454130100102133342",
    "2222 2525",
    "2222 252617",
    "410345",
    "0242 0444",
    "014305",
    "01103041422324 2626",
    "32221314243432 34444130100105163646",
    "062046 1434",
    "003041423303 3344453606 0006",
    "4130100105163645",
    "00204244260600",
    "40000646 0333",
    "400006 0333",
    "41301001051636454323",
    "0006 4046 0343",
    "1030 2026 1636",
    "4045361605",
    "0006 400346",
    "000646",
    "0600234046",
    "06004640",
    "103041453616050110",
    "06003041423303",
    "103041453616050110 3446",
    "06003041423303 2346",
    "413010010213334445361605",
    "0040 2026",
    "000516364540",
    "002640",
    "0016223640",
    "0046 4006",
    "002340 2326",
    "00400646",
    "30101636",
    "0046",
    "10303616",
    "022042",
    "0747",
    "1021",
    "12324346 441405163645",
    "0006 0312324345361605",
    "4332120305163645",
    "4046 4332120305163645",
    "04444332120305163645",
    "40302126 0232",
    "4247381807 4332120305163645",
    "0006 0312324346",
    "2020 2226",
    "3030 32372818",
    "0006 420446",
    "10202536",
    "0602 03122326 23324346",
    "0602 0312324346",
    "123243453616050312",
    "0208 0312324345361605",
    "4248 4332120305163645",
    "0206 03123243",
    "43321203143445361605",
    "20253645 0242",
    "0205163645 4246",
    "022642",
    "0216243642",
    "0246 4206",
    "0226 4218",
    "02420646",
    "30212213242536",
    "2027",
    "10212233242516",
    "03123342",
];

/// Strokes of a character; a box stands for what is not printable ASCII.
pub fn strokes(character: char) -> impl Iterator<Item = &'static [u8]> {
    let index = (character as u32).wrapping_sub(32) as usize;
    let glyph = GLYPHS.get(index).copied().unwrap_or("0040460600");
    glyph.split(' ').map(str::as_bytes).filter(|s| !s.is_empty())
}

/// Grid position of each point of a stroke.
pub fn points(stroke: &[u8]) -> impl Iterator<Item = (f32, f32)> {
    stroke.as_chunks::<2>().0.iter().map(|[x, y]| (f32::from(x - b'0'), f32::from(y - b'0')))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_glyph_is_on_the_grid_and_no_two_are_alike() {
        for (i, g) in GLYPHS.iter().enumerate() {
            for stroke in g.split(' ').filter(|s| !s.is_empty()) {
                assert!(stroke.len() % 2 == 0 && stroke.len() >= 4, "glyph {i}: {stroke}");
                assert!(points(stroke.as_bytes()).all(|(x, y)| x <= 4.0 && y <= 8.0), "glyph {i}: {stroke}");
            }
            for (j, h) in GLYPHS.iter().enumerate().take(i) {
                assert!(g != h, "glyphs {:?} and {:?}", (32 + i as u8) as char, (32 + j as u8) as char);
            }
        }
    }
}
