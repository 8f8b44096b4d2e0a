//! Pieces of a grid: cells that are connected through their four neighbours.

/// Finds the cells connected with `start`, which must not be visited yet, in a grid of this size. Their indices are
/// written to `piece` and marked as visited. `is_linked` says whether two neighbours are connected.
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
