//! Images of sensors with a colour filter per pixel.

/// Columns and rows by which a pattern is shifted from red, green / green, blue.
fn offset(encoding: &str) -> Option<(usize, usize)> {
    Some(match encoding {
        "bayer_rggb8" => (0, 0),
        "bayer_grbg8" => (1, 0),
        "bayer_gbrg8" => (0, 1),
        "bayer_bggr8" => (1, 1),
        _ => return None,
    })
}

/// Whether an encoding is one of 8 bits with a colour filter.
pub fn is_bayer(encoding: &str) -> bool {
    offset(encoding).is_some()
}

/// Blue, green, red of every pixel: the colours that a pixel lacks are the means of its neighbours that have them.
/// `rows` are those of the image.
pub fn colours(encoding: &str, rows: &[&[u8]]) -> Vec<u8> {
    let (dx, dy) = offset(encoding).unwrap_or_default();
    let width = rows.first().map_or(0, |row| row.len());
    let mut out = Vec::with_capacity(3 * width * rows.len());
    for y in 0..rows.len() {
        for x in 0..width {
            // 0 is red, 1 and 2 are green, 3 is blue.
            let filter = |x: usize, y: usize| ((x + dx) & 1) + 2 * ((y + dy) & 1);
            let mut sums = [(0u32, 0u32); 3];
            for row in y.saturating_sub(1)..=(y + 1).min(rows.len() - 1) {
                for column in x.saturating_sub(1)..=(x + 1).min(width - 1) {
                    let channel = [2, 1, 1, 0][filter(column, row)];
                    sums[channel].0 += u32::from(rows[row][column]);
                    sums[channel].1 += 1;
                }
            }
            let own = [2, 1, 1, 0][filter(x, y)];
            sums[own] = (u32::from(rows[y][x]), 1);
            out.extend(sums.map(|(sum, count)| ((sum + count / 2) / count.max(1)) as u8));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_colour_comes_back_from_every_pattern() {
        // Blue, green, red.
        let colour = [30, 120, 200];
        for (encoding, pattern) in [
            ("bayer_rggb8", [[200, 120], [120, 30]]),
            ("bayer_grbg8", [[120, 200], [30, 120]]),
            ("bayer_gbrg8", [[120, 30], [200, 120]]),
            ("bayer_bggr8", [[30, 120], [120, 200]]),
        ] {
            let rows: Vec<Vec<u8>> = (0..5).map(|y| (0..7).map(|x| pattern[y % 2][x % 2]).collect()).collect();
            let rows: Vec<&[u8]> = rows.iter().map(Vec::as_slice).collect();
            assert!(colours(encoding, &rows).as_chunks::<3>().0.iter().all(|pixel| *pixel == colour), "{encoding}");
        }
        assert!(!is_bayer("bayer_rggb16") && !is_bayer("mono8"));
    }

    #[test]
    fn an_edge_stays_where_it_is() {
        let rows: [&[u8]; 2] = [&[0, 0, 100, 100], &[0, 0, 100, 100]];
        let gray: Vec<u8> = colours("bayer_rggb8", &rows).as_chunks::<3>().0.iter().map(|pixel| pixel[1]).collect();
        assert_eq!((gray[0], gray[3], gray[4], gray[7]), (0, 100, 0, 100));
    }
}
