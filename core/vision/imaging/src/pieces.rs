//! Pieces of a grid: cells that hang together over their four neighbours.

/// Finds the cells that hang together with `start`, which is not visited yet, in a grid of so many columns and rows: `piece` gets their indices, and
/// they are visited from here on. `is_linked` tells whether two neighbours hang together.
pub fn grow(
    start: usize,
    (columns, rows): (usize, usize),
    is_visited: &mut [bool],
    piece: &mut Vec<usize>,
    is_linked: impl Fn(usize, usize) -> bool,
) {
    piece.clear();
    piece.push(start);
    is_visited[start] = true;
    let mut next = 0;
    while let Some(&from) = piece.get(next) {
        next += 1;
        let (column, row) = (from % columns, from / columns);
        let around = [
            (column > 0).then(|| from - 1),
            (column + 1 < columns).then(|| from + 1),
            (row > 0).then(|| from - columns),
            (row + 1 < rows).then(|| from + columns),
        ];
        for to in around.into_iter().flatten() {
            if !is_visited[to] && is_linked(from, to) {
                is_visited[to] = true;
                piece.push(to);
            }
        }
    }
}
