//! Geometry of the strip's ends, and plane vectors.

pub type Vec3 = [f64; 3];
pub type Mat3 = [[f64; 3]; 3];

/// Clamps of a strip on its axles. Constant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clamps {
    /// Direction (cos, sin) of the rear clamp, and of the strip that starts there, in the rear
    /// axle's frame.
    pub root: [f64; 2],
    /// Length of the rigid part between the rear axle and the strip, m.
    pub root_length: f64,
    /// Direction of the front clamp in the front axle's frame.
    pub tip: [f64; 2],
    /// Length of the rigid part between the strip and the front axle, m.
    pub tip_length: f64,
    /// Strip's end in the front axle's frame, m.
    pub tip_place: [f64; 2],
    /// Angle of the front clamp minus angle of the rear clamp, rad.
    pub twist: f64,
}

impl Clamps {
    /// Clamps with rigid parts of `length` (m) at angles `angle` (rad), each rear, front.
    pub fn new(length: [f64; 2], angle: [f64; 2]) -> Self {
        let tip = direction(angle[1]);
        Self {
            root: direction(angle[0]),
            root_length: length[0],
            tip,
            tip_length: length[1],
            tip_place: tip.map(|v| -length[1] * v),
            twist: angle[1] - angle[0],
        }
    }
}

/// Positions of two neighbouring axles, front and rear, and the end of the strip between them. The
/// root frame has its origin at the midpoint of the rear axle and its x axis along the rear clamp.
#[derive(Clone, Copy, Debug, Default)]
pub struct Geometry {
    /// Direction of the rear axle, (cos, sin).
    pub rear: [f64; 2],
    /// Direction of the front axle, (cos, sin).
    pub front: [f64; 2],
    /// Front axle's midpoint in the rear axle's frame, m.
    pub position: [f64; 2],
    /// Front axle's direction in the rear axle's frame.
    pub turn: [f64; 2],
    /// Strip's end in the root frame, m.
    pub end: [f64; 2],
    /// Strip's end in the front axle's frame, m.
    pub tip: [f64; 2],
    /// Direction of the rear clamp in the rear axle's frame.
    pub root: [f64; 2],
}

impl Geometry {
    /// Geometry from the axles' directions, and the front axle's midpoint and direction in the rear axle's frame.
    #[inline(always)]
    pub fn new(
        clamps: &Clamps,
        [front, rear]: [[f64; 2]; 2],
        position: [f64; 2],
        turn: [f64; 2],
    ) -> Self {
        let tip = clamps.tip_place;
        let [x, y] = rotate(&tip, turn);
        Self {
            rear,
            front,
            position,
            turn,
            end: unrotate(&[position[0] + x, position[1] + y], clamps.root),
            tip,
            root: clamps.root,
        }
    }

    /// Geometry after the axles have moved for `time` (s) at velocities `v` (axles' frames at the start) and turned by
    /// `turns` (cos, sin).
    #[inline(always)]
    pub fn moved(&self, clamps: &Clamps, v: &[Vec3; 2], turns: [[f64; 2]; 2], time: f64) -> Self {
        let [f, r] = v;
        let front = rotate(&[f[0], f[1]], self.turn);
        let position = [
            self.position[0] + time * (front[0] - r[0]),
            self.position[1] + time * (front[1] - r[1]),
        ];
        let position = unrotate(&position, turns[1]);
        let turn = unrotate(&rotate(&self.turn, turns[0]), turns[1]);
        Self::new(clamps, [self.front, self.rear], position, turn)
    }

    /// Rate of the strip's end in the root frame for body velocities of the axles.
    #[inline(always)]
    pub fn rate(&self, v: &[Vec3; 2]) -> Vec3 {
        let [f, r] = v;
        let tip = [f[0] - self.tip[1] * f[2], f[1] + self.tip[0] * f[2]];
        let [x, y] = rotate(&tip, self.turn);
        let [x, y] = unrotate(&[x - r[0], y - r[1]], self.root);
        [x + self.end[1] * r[2], y - self.end[0] * r[2], f[2] - r[2]]
    }

    /// Transpose of [`Self::rate`]: loads of the wrench `w` in the axles' coordinates.
    #[inline(always)]
    pub fn transpose(&self, w: &Vec3) -> [Vec3; 2] {
        let force = rotate(&[w[0], w[1]], self.root);
        let [forward, left] = unrotate(&force, self.turn);
        [
            [
                forward,
                left,
                w[2] + self.tip[0] * left - self.tip[1] * forward,
            ],
            [
                -force[0],
                -force[1],
                self.end[1] * w[0] - self.end[0] * w[1] - w[2],
            ],
        ]
    }
}

#[inline(always)]
pub fn rotate(v: &[f64; 2], [c, s]: [f64; 2]) -> [f64; 2] {
    [c * v[0] - s * v[1], s * v[0] + c * v[1]]
}

#[inline(always)]
pub fn unrotate(v: &[f64; 2], [c, s]: [f64; 2]) -> [f64; 2] {
    [c * v[0] + s * v[1], c * v[1] - s * v[0]]
}

#[inline(always)]
pub fn turned(v: &Vec3, direction: [f64; 2]) -> Vec3 {
    let [x, y] = rotate(&[v[0], v[1]], direction);
    [x, y, v[2]]
}

#[inline(always)]
pub fn unturned(v: &Vec3, direction: [f64; 2]) -> Vec3 {
    let [x, y] = unrotate(&[v[0], v[1]], direction);
    [x, y, v[2]]
}

/// (cos, sin) of a small angle.
#[inline(always)]
pub fn small_turn(a: f64) -> [f64; 2] {
    if a.abs() < 0.1 {
        let z = a * a;
        [
            1.0 - z * (0.5 - z * (1.0 / 24.0 - z * (1.0 / 720.0 - z / 40_320.0))),
            a * (1.0 - z * (1.0 / 6.0 - z * (1.0 / 120.0 - z * (1.0 / 5040.0 - z / 362_880.0)))),
        ]
    } else {
        direction(a)
    }
}

#[inline(always)]
pub fn direction(a: f64) -> [f64; 2] {
    let (s, c) = libm::sincos(a);
    [c, s]
}

#[inline(always)]
pub fn times(m: &Mat3, v: &Vec3) -> Vec3 {
    [
        m[0][0] * v[0] + m[0][1] * v[1] + m[0][2] * v[2],
        m[1][0] * v[0] + m[1][1] * v[1] + m[1][2] * v[2],
        m[2][0] * v[0] + m[2][1] * v[1] + m[2][2] * v[2],
    ]
}

#[inline(always)]
pub fn add(a: &Vec3, k: f64, b: &Vec3) -> Vec3 {
    [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]]
}

#[inline(always)]
pub fn scaled(k: f64, v: &Vec3) -> Vec3 {
    [k * v[0], k * v[1], k * v[2]]
}

/// Inverse, by cofactors: the matrices here are far from singular.
#[inline(always)]
pub fn inverse(m: &Mat3) -> Mat3 {
    let cofactor = |i: usize, j: usize| {
        let (a, b) = ((i + 1) % 3, (i + 2) % 3);
        let (c, d) = ((j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let (x, y, z) = (cofactor(0, 0), cofactor(0, 1), cofactor(0, 2));
    let r = 1.0 / (m[0][0] * x + m[0][1] * y + m[0][2] * z);
    [
        [r * x, r * cofactor(1, 0), r * cofactor(2, 0)],
        [r * y, r * cofactor(1, 1), r * cofactor(2, 1)],
        [r * z, r * cofactor(1, 2), r * cofactor(2, 2)],
    ]
}

#[inline(always)]
pub fn sum<const N: usize>(a: &[Vec3; N], b: &[Vec3; N]) -> [Vec3; N] {
    let mut sum = *a;
    for i in 0..N {
        sum[i] = add(&a[i], 1.0, &b[i]);
    }
    sum
}

#[inline(always)]
pub fn minus<const N: usize>(a: &[Vec3; N], b: &[Vec3; N]) -> [Vec3; N] {
    let mut difference = *a;
    for i in 0..N {
        difference[i] = add(&a[i], -1.0, &b[i]);
    }
    difference
}

#[inline(always)]
pub fn product(a: &Mat3, b: &Mat3) -> Mat3 {
    let mut product = *a;
    for (row, a) in product.iter_mut().zip(a) {
        for n in 0..3 {
            row[n] = a[0] * b[0][n] + a[1] * b[1][n] + a[2] * b[2][n];
        }
    }
    product
}
