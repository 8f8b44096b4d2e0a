//! 3 x 3 matrices and rotation vectors, as much as rectification needs.

/// A column vector.
pub type Vector3 = [f64; 3];
/// Rows of a 3 x 3 matrix.
pub type Matrix3 = [[f64; 3]; 3];

pub(crate) const IDENTITY: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

pub(crate) fn dot(a: Vector3, b: Vector3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn norm(a: Vector3) -> f64 {
    dot(a, a).sqrt()
}

pub(crate) fn cross(a: Vector3, b: Vector3) -> Vector3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn scaled(a: Vector3, factor: f64) -> Vector3 {
    a.map(|value| value * factor)
}

/// A vector turned by a matrix.
pub fn apply(m: &Matrix3, v: Vector3) -> Vector3 {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// Rows as columns: the inverse of a rotation.
pub fn transposed(m: &Matrix3) -> Matrix3 {
    std::array::from_fn(|row| std::array::from_fn(|column| m[column][row]))
}

/// `a b`: turned by `b`, then by `a`.
pub fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    let b = transposed(b);
    std::array::from_fn(|row| std::array::from_fn(|column| dot(a[row], b[column])))
}

pub(crate) fn determinant(m: &Matrix3) -> f64 {
    dot(m[0], cross(m[1], m[2]))
}

/// Rotation by `|v|` radians about `v` (Rodrigues' formula).
pub fn rotation_of(v: Vector3) -> Matrix3 {
    let angle = norm(v);
    if angle < 1e-15 {
        return IDENTITY;
    }
    let [x, y, z] = scaled(v, 1.0 / angle);
    let (sin, cos) = angle.sin_cos();
    let rest = 1.0 - cos;
    [
        [cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin],
        [y * x * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin],
        [z * x * rest - y * sin, z * y * rest + x * sin, cos + z * z * rest],
    ]
}

/// Axis times angle of a rotation; its inverse is [`rotation_of`].
pub fn vector_of(m: &Matrix3) -> Vector3 {
    let axis = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
    let sin = norm(axis) / 2.0;
    let cos = (m[0][0] + m[1][1] + m[2][2] - 1.0) / 2.0;
    let angle = sin.atan2(cos);
    if sin > 1e-9 {
        return scaled(axis, angle / (2.0 * sin));
    }
    if cos > 0.0 {
        return scaled(axis, 0.5);
    }
    // Half a turn: the axis is the longest column of R + I.
    let columns = transposed(&std::array::from_fn(|r| std::array::from_fn(|c| m[r][c] + IDENTITY[r][c])));
    let longest = columns.into_iter().max_by(|a, b| norm(*a).total_cmp(&norm(*b))).unwrap_or([1.0, 0.0, 0.0]);
    scaled(longest, std::f64::consts::PI / norm(longest).max(1e-300))
}
