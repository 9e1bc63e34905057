//! A brushed DC motor with gear, as seen from its two terminals and from the wheel.
//!
//! `L di/dt + R i = v − k ω`; the torque at the wheel is `k i` (friction and inertia belong to the plant). Between two
//! changes of voltage and speed the current is an exponential, evaluated in closed form: no time step is needed.

characteristics! {
    /// Constants of a motor, referred to the wheel.
    ///
    /// Default: a 12 V gear motor with 2.5 N m stall torque and 20 rad/s no-load speed.
    pub struct MotorConfig {
        /// Resistance of winding, brushes and leads, Ω.
        pub resistance_ohm: f64 = 2.88;
        /// Inductance of the winding, H.
        pub inductance_h: f64 = 2.3e-3;
        /// Torque at the wheel per current, N m/A. Equal to the back EMF per wheel speed, V s/rad: gear ratio times the
        /// motor constant.
        pub constant_nm_a: f64 = 0.6;
    }
}

/// Exact integrals of a motor's current over an interval.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Work {
    /// Duration of the interval, s.
    pub span_s: f64,
    /// Charge through the motor, ∫ i dt, A s.
    pub charge_as: f64,
    /// ∫ i² dt, A² s; times the resistance, heat in J.
    pub square_a2s: f64,
    /// Charge from the positive side of the supply, A s; negative into the supply.
    pub supplied_as: f64,
}

impl Work {
    /// Mean motor current over the interval, A.
    pub fn mean_current_a(&self) -> f64 {
        self.mean(self.charge_as)
    }

    /// Mean current out of the supply, A.
    pub fn mean_supplied_a(&self) -> f64 {
        self.mean(self.supplied_as)
    }

    fn mean(&self, integral: f64) -> f64 {
        if self.span_s > 0.0 {
            integral / self.span_s
        } else {
            0.0
        }
    }
}

/// Constant source at the terminals: a voltage behind a resistance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Source {
    /// Open-circuit voltage of the source, V.
    pub volts: f64,
    /// Resistance in series with the winding, Ω.
    pub ohms: f64,
    /// Part of the motor current that the supply delivers: 1, 0 or −1.
    pub share: f64,
}

/// A motor: present current, and integrals since the latest reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    config: MotorConfig,
    speed_rad_s: f64,
    current_a: f64,
    slope_a_s: f64,
    open: bool,
    work: Work,
}

impl Motor {
    /// A motor at rest, without current.
    pub fn new(config: MotorConfig) -> Self {
        Self {
            config,
            speed_rad_s: 0.0,
            current_a: 0.0,
            slope_a_s: 0.0,
            open: false,
            work: Work::default(),
        }
    }

    /// Constants of the motor.
    pub fn config(&self) -> MotorConfig {
        self.config
    }

    /// Current from the first terminal to the second, A.
    pub(super) fn current_a(&self) -> f64 {
        self.current_a
    }

    /// Derivative of the current at the end of the latest interval, A/s.
    pub(super) fn slope_a_s(&self) -> f64 {
        self.slope_a_s
    }

    /// Back EMF at the present speed, V.
    pub(super) fn emf_v(&self) -> f64 {
        self.config.constant_nm_a * self.speed_rad_s
    }

    pub(super) fn set_speed(&mut self, speed_rad_s: f64) {
        self.speed_rad_s = speed_rad_s;
    }

    /// Sets a broken lead: no current. The arc of a real motor is not modelled.
    pub(super) fn set_open(&mut self, open: bool) {
        self.open = open;
        if open {
            (self.current_a, self.slope_a_s) = (0.0, 0.0);
        }
    }

    pub(super) fn is_open(&self) -> bool {
        self.open
    }

    /// Final value of the current with this source, A, and time constant of the approach, s.
    fn limit(&self, source: Source) -> (f64, f64) {
        let ohms = self.config.resistance_ohm + source.ohms;
        (
            (source.volts - self.emf_v()) / ohms,
            self.config.inductance_h / ohms,
        )
    }

    /// True if the current stays below a level with this source; cheaper than `time_to`.
    pub(super) fn stays_below(&self, level_a: f64, source: Source) -> bool {
        let ohms = self.config.resistance_ohm + source.ohms;
        (source.volts - self.emf_v()).abs() < level_a * ohms && self.current_a.abs() < level_a
    }

    /// Time until the current reaches a level with this source, s; infinite if never.
    pub(super) fn time_to(&self, level_a: f64, source: Source) -> f64 {
        let (limit, tau) = self.limit(source);
        let (from, to) = (self.current_a - limit, level_a - limit);
        // The current approaches its final value `limit` and never crosses it.
        if self.open || from * to <= 0.0 || to.abs() >= from.abs() {
            return f64::INFINITY;
        }
        tau * libm::log(from / to)
    }

    /// Advances by an interval with this source.
    pub(super) fn advance(&mut self, source: Source, span_s: f64) {
        self.work.span_s += span_s;
        if self.open {
            return;
        }
        let (limit, tau) = self.limit(source);
        let first = self.current_a - limit;
        let rise = rise(span_s / tau);
        let left = 1.0 - rise;
        let charge = limit * span_s + first * tau * rise;
        self.work.charge_as += charge;
        self.work.supplied_as += source.share * charge;
        self.work.square_a2s += limit * limit * span_s
            + 2.0 * limit * first * tau * rise
            + first * first * tau / 2.0 * rise * (1.0 + left);
        self.current_a = limit + first * left;
        self.slope_a_s = -first * left / tau;
    }

    /// Advances by an interval without current.
    pub(super) fn idle(&mut self, span_s: f64) {
        self.work.span_s += span_s;
        (self.current_a, self.slope_a_s) = (0.0, 0.0);
    }

    pub(super) fn take_work(&mut self) -> Work {
        std::mem::take(&mut self.work)
    }
}

/// 1 − e^(−x) without cancellation; by its series for small x, the usual case between two edges.
fn rise(x: f64) -> f64 {
    if x < 0.04 {
        // The next term is below 10⁻¹² of the first.
        x * (1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0)))))
    } else {
        -libm::expm1(-x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64, tolerance: f64) {
        assert!((a - b).abs() <= tolerance, "{a} {b}");
    }

    /// Reference integration with very small steps (Euler's method): current, charge, ∫ i² dt.
    fn integrate(config: MotorConfig, volts: f64, speed: f64, span: f64) -> (f64, f64, f64) {
        let n = 2_000_000;
        let dt = span / f64::from(n);
        let (mut i, mut charge, mut square) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let slope = (volts - config.constant_nm_a * speed - config.resistance_ohm * i)
                / config.inductance_h;
            let middle = i + 0.5 * dt * slope;
            charge += middle * dt;
            square += middle * middle * dt;
            i += dt * slope;
        }
        (i, charge, square)
    }

    #[test]
    fn current_charge_and_heat_match_small_steps() {
        let config = MotorConfig::default();
        let source = Source {
            volts: 12.0,
            ohms: 0.0,
            share: 1.0,
        };
        let mut motor = Motor::new(config);
        motor.set_speed(5.0);
        for span in [0.3e-3, 0.2e-3, 0.5e-3] {
            motor.advance(source, span);
        }
        let (current, charge, square) = integrate(config, 12.0, 5.0, 1e-3);
        let work = motor.take_work();
        close(motor.current_a(), current, 1e-5);
        close(work.charge_as, charge, 1e-8);
        close(work.square_a2s, square, 1e-8);
        close(work.span_s, 1e-3, 1e-15);
        assert_eq!(work.supplied_as, work.charge_as);
    }

    #[test]
    fn energy_is_conserved() {
        let config = MotorConfig::default();
        let mut motor = Motor::new(config);
        motor.set_speed(-7.0);
        let source = Source {
            volts: 9.0,
            ohms: 0.2,
            share: 1.0,
        };
        motor.advance(source, 2e-3);
        let work = motor.take_work();
        // Supplied energy = heat + mechanical work + energy in the inductance.
        let given = 9.0 * work.charge_as;
        let heat = (config.resistance_ohm + 0.2) * work.square_a2s;
        let mechanical = config.constant_nm_a * -7.0 * work.charge_as;
        let field = 0.5 * config.inductance_h * motor.current_a().powi(2);
        close(given, heat + mechanical + field, 1e-12);
    }

    #[test]
    fn current_reaches_a_level_at_the_predicted_time() {
        let mut motor = Motor::new(MotorConfig::default());
        let source = Source {
            volts: 12.0,
            ohms: 0.2,
            share: 1.0,
        };
        let span = motor.time_to(2.0, source);
        motor.advance(source, span);
        close(motor.current_a(), 2.0, 1e-12);
        // 12 V over 3.08 Ω is 3.9 A: the current never reaches 4 A, nor 1 A again.
        assert_eq!(motor.time_to(4.0, source), f64::INFINITY);
        assert_eq!(motor.time_to(1.0, source), f64::INFINITY);
    }
}
