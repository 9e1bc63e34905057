//! The filter problem that all libraries solve: seven states, two wheels, gyro and accelerometer.

/// Period, s.
pub const T: f32 = 0.001;
/// Distance between the wheels, m.
pub const TRACK: f32 = 0.324;
/// Variances of left wheel, right wheel, gyro, accelerometer.
pub const R: [f32; 4] = [4e-4, 4e-4, 2.5e-5, 1e-2];
/// Slip in any direction (m/√s) and in heading (rad/√s).
pub const SLIP: f32 = 1e-3;
/// Jerk, m/s³/√Hz.
pub const JERK: f32 = 1.0;
/// Yaw jerk, rad/s³/√Hz.
pub const YAW_JERK: f32 = 6.0;
/// Process noise: slip, and jerks that are constant over a step.
pub const Q: [[f32; 7]; 7] = {
    let mut q = [[0.0; 7]; 7];
    let (slip, half) = (T * SLIP * SLIP, 0.5 * T);
    let (jerk, yaw_jerk) = (T * JERK * JERK, T * YAW_JERK * YAW_JERK);
    q[0][0] = slip;
    q[1][1] = slip;
    q[2][2] = slip;
    q[3][3] = jerk * half * half;
    q[3][5] = jerk * half;
    q[5][3] = jerk * half;
    q[5][5] = jerk;
    q[4][4] = yaw_jerk * half * half;
    q[4][6] = yaw_jerk * half;
    q[6][4] = yaw_jerk * half;
    q[6][6] = yaw_jerk;
    q
};
/// First state.
pub const X0: [f32; 7] = [0.1, -0.2, 0.3, 0.2, 0.1, 0.0, 0.0];
/// Its covariance, diagonal.
pub const P0: [f32; 7] = [1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-2, 1e-2];
/// Steps of a run.
pub const STEPS: u32 = 100;

/// What the sensors say at step `k`.
pub fn measurement(k: u32) -> [f32; 4] {
    let wave = 0.01 * ((k * 37 % 64) as f32 - 32.0) / 32.0;
    let (v, omega) = (0.2 + wave, 0.1 - wave);
    [
        v - 0.5 * TRACK * omega,
        v + 0.5 * TRACK * omega,
        omega,
        wave,
    ]
}

/// Motion of one step: state after it, and the entries of the Jacobian that are neither zero nor
/// one: of x and of y by φ, v, ω, v̇, ω̇. Every library gets the same.
pub fn motion(x: &[f32; 7]) -> ([f32; 7], [[f32; 5]; 2]) {
    const HALF: f32 = 0.5 * T * T;
    let [px, py, phi, v, omega, v_dot, omega_dot] = *x;
    let ds = v * T + v_dot * HALF;
    let turn = omega * T + omega_dot * HALF;
    let (s, c) = core_algos::math::trig::sin_cos(phi + 0.5 * turn);
    let (dx, dy) = (ds * c, ds * s);
    let next = [
        px + dx,
        py + dy,
        phi + turn,
        v + v_dot * T,
        omega + omega_dot * T,
        v_dot,
        omega_dot,
    ];
    let (half, quarter) = (0.5 * T, 0.5 * HALF);
    let by_x = [-dy, c * T, -dy * half, c * HALF, -dy * quarter];
    let by_y = [dx, s * T, dx * half, s * HALF, dx * quarter];
    (next, [by_x, by_y])
}

/// The same Jacobian, whole.
pub fn jacobian([by_x, by_y]: [[f32; 5]; 2]) -> [[f32; 7]; 7] {
    let mut a = [[0.0; 7]; 7];
    for (i, row) in a.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    a[0][2..].copy_from_slice(&by_x);
    a[1][2..].copy_from_slice(&by_y);
    a[2][4] = T;
    a[2][6] = 0.5 * T * T;
    a[3][5] = T;
    a[4][6] = T;
    a
}

/// What each sensor sees of the state.
pub const H: [[f32; 7]; 4] = [
    [0.0, 0.0, 0.0, 1.0, -0.5 * TRACK, 0.0, 0.0],
    [0.0, 0.0, 0.0, 1.0, 0.5 * TRACK, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
];
