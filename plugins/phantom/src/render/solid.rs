//! Solids drawn in front of the tissue: tapered capsules, optionally flattened, intersected exactly.

/// Colour and finish of a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paint {
    /// Albedo: blue, green, red.
    pub albedo: [f32; 3],
    /// 0 plastic, 1 polished steel.
    pub metal: f32,
}

/// Two balls and the cone that wraps them, mm.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Centre and radius of the first ball.
    pub a: [f64; 3],
    /// Radius of the first ball.
    pub radius_a: f64,
    /// Centre and radius of the second ball.
    pub b: [f64; 3],
    /// Radius of the second ball.
    pub radius_b: f64,
    /// Unit direction along which the part is squeezed, and its thickness there relative to a round one, 0..=1.
    pub flat: ([f64; 3], f64),
    /// Finish.
    pub paint: Paint,
    /// Number of the instrument it belongs to, from 1.
    pub id: u8,
}

/// Entry point of a ray into a part.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Entry parameter: multiple of the ray's direction.
    pub t: f64,
    /// Outward normal, not normalised.
    pub normal: [f64; 3],
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn add(a: [f64; 3], b: [f64; 3], scale: f64) -> [f64; 3] {
    [a[0] + b[0] * scale, a[1] + b[1] * scale, a[2] + b[2] * scale]
}

/// A part prepared for rays from the origin.
#[derive(Clone, Copy, Debug)]
pub struct Solid {
    /// The part.
    pub part: Part,
    /// Extra scale along the flat direction that undoes the squeeze.
    stretch: f64,
    /// From the first ball's centre to the origin, unsqueezed.
    o: [f64; 3],
    /// Unit vector along the axis.
    u: [f64; 3],
    length: f64,
    /// Sine and squared cosine of the cone's half angle; the sine is 1 or more if one ball contains the other.
    sine: f64,
    cos2: f64,
    /// Position of the origin along the axis, radius of the cone there, and the constant term of its equation.
    s: f64,
    m: f64,
    c: f64,
}

impl Solid {
    /// Precomputes what all rays share.
    pub fn new(part: Part) -> Self {
        let (n, thickness) = part.flat;
        let stretch = 1.0 / thickness - 1.0;
        let round = |v: [f64; 3]| add(v, n, dot(v, n) * stretch);
        let (o, axis) = (round(part.a.map(|v| -v)), round(add(part.b, part.a, -1.0)));
        let length = dot(axis, axis).sqrt();
        let u = if length > 0.0 { axis.map(|v| v / length) } else { [0.0, 0.0, 1.0] };
        let sine = if length > 0.0 { (part.radius_a - part.radius_b) / length } else { 1.0 };
        let (cos2, s) = (1.0 - sine * sine, dot(o, u));
        let m = part.radius_a - sine * s;
        let c = cos2 * (dot(o, o) - s * s) - m * m;
        Self { part, stretch, o, u, length, sine, cos2, s, m, c }
    }

    /// First entry of the ray from the origin along `d`, with `t > 0`.
    pub fn enter(&self, d: [f64; 3]) -> Option<Entry> {
        let (part, u, o) = (&self.part, self.u, self.o);
        let n = part.flat.0;
        // Undo the squeeze about `a`: the part becomes round, and `t` stays what it is.
        let d = add(d, n, dot(d, n) * self.stretch);
        let (dd, du, od) = (dot(d, d), dot(d, u), dot(o, d));
        let mut second = part.radius_b > part.radius_a;
        if self.sine.abs() < 1.0 {
            // The cone: distance from the axis times the cosine, plus place on the axis times the sine, is radius_a.
            let a = self.cos2 * (dd - du * du) - self.sine * self.sine * du * du;
            let b = self.cos2 * (od - self.s * du) + self.m * self.sine * du;
            let root = b * b - a * self.c;
            if a > 1e-12 {
                // The cone holds both balls: a ray that misses it misses all, and a ray that enters it outside the stretch
                // between the circles of contact enters by the ball on that side.
                if root < 0.0 {
                    return None;
                }
                let t = (-b - root.sqrt()) / a;
                let place = self.s + t * du;
                let (low, high) = (part.radius_a * self.sine, self.length + part.radius_b * self.sine);
                if place >= low && place <= high {
                    let radial = add(add(o, d, t), u, -place);
                    let inv = (self.cos2 / dot(radial, radial).max(1e-24)).sqrt();
                    return self.entry(t, add(u.map(|v| v * self.sine), radial, inv));
                }
                second = place > high;
            } else {
                // Along the axis, through the ends: the ball that faces the ray.
                second = du < 0.0;
            }
        }
        let (along, radius) = if second { (self.length, part.radius_b) } else { (0.0, part.radius_a) };
        let from = add(o, u, -along);
        let half = dot(from, d);
        let root = half * half - dd * (dot(from, from) - radius * radius);
        if root < 0.0 {
            return None;
        }
        let t = (-half - root.sqrt()) / dd;
        self.entry(t, add(from, d, t))
    }

    fn entry(&self, t: f64, normal: [f64; 3]) -> Option<Entry> {
        let n = self.part.flat.0;
        (t > 1e-6).then(|| Entry { t, normal: add(normal, n, dot(normal, n) * self.stretch) })
    }
}

impl Part {
    /// Whether a ray within `spread` (radians) of the unit direction `d` can hit the part. May return true wrongly, never false.
    pub fn near(&self, d: [f64; 3], spread: f64) -> bool {
        let axis = add(self.b, self.a, -1.0);
        // Closest points of the half line t * d and the segment a + s * axis, by two rounds of projection from
        // the exact solution for lines.
        let (aa, ad, sd) = (dot(axis, axis), dot(axis, d), dot(self.a, d));
        let denominator = aa - ad * ad;
        let mut s = if denominator > 1e-9 { (ad * sd - dot(self.a, axis)) / denominator } else { 0.0 };
        s = s.clamp(0.0, 1.0);
        let mut t = (sd + s * ad).max(0.0);
        if aa > 0.0 {
            s = ((t * ad - dot(self.a, axis)) / aa).clamp(0.0, 1.0);
            t = (sd + s * ad).max(0.0);
        }
        let gap = add(add(self.a, axis, s), d, -t);
        let reach = dot(self.a, self.a).max(dot(self.b, self.b)).sqrt();
        let radius = self.radius_a.max(self.radius_b);
        dot(gap, gap).sqrt() <= radius + (reach + radius) * spread
    }
}
