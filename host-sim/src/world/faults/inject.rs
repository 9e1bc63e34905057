//! Fault injection between the plant and the boards.

use crate::world::faults::{Fault, Rail, Wheel};
use core_algos::beam::MAX_GAUGES;
use core_algos::node::axle;
use core_algos::node::board::Samples;
use core_algos::safety::Conditions;
use core_algos::topology::{Role, Wheels};

/// Lag of a board's slow clock, ticks.
pub type ClockLag = u32;

/// Readings of all boards at a tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Readings {
    /// Samples of the axle boards, front first.
    pub axles: Vec<axle::Samples>,
    /// Counts of each frame's bridges, front first.
    pub frames: Vec<[i32; MAX_GAUGES]>,
}

impl Readings {
    /// Readings of each board, in the order of [`core_algos::topology::Topology::boards`].
    pub fn samples(&self) -> impl Iterator<Item = Samples> {
        let axles = self.axles.iter().copied().map(Samples::Axle);
        let frames = self.frames.iter();
        axles.chain(frames.map(|&counts| Samples::Beam(counts.into())))
    }
}

/// Applies a fault to readings and boards from one tick onwards.
#[derive(Clone, Debug)]
pub struct Injector {
    fault: Fault,
    /// Frame of a fault of gauges or of a frame.
    frame: usize,
    /// First tick of the fault.
    at: u32,
    full_scale: i32,
    /// Readings at the last tick before the fault.
    held: Readings,
}

impl Injector {
    /// Injector of `fault` from tick `at` on. `full_scale` is the largest count of the beam's converter; `held` are the
    /// readings at the last tick before the fault.
    pub fn new(fault: Fault, at: u32, full_scale: i32, held: Readings) -> Self {
        let (frame, fault) = match fault {
            Fault::OfFrame { frame, fault } => (frame, *fault),
            fault => (0, fault),
        };
        Self {
            fault,
            frame,
            at,
            full_scale,
            held,
        }
    }

    /// Injected fault and its first tick.
    pub fn fault(&self) -> (&Fault, u32) {
        (&self.fault, self.at)
    }

    /// Applies the fault to the boards' readings at a tick.
    pub fn readings(&mut self, tick: u32, readings: &mut Readings) {
        let Some(since) = tick.checked_sub(self.at) else {
            self.held.axles.clone_from(&readings.axles);
            self.held.frames.clone_from(&readings.frames);
            return;
        };
        let Readings { axles, frames } = readings;
        let counts = &mut frames[self.frame];
        match self.fault {
            Fault::GaugeRail { count, rail } => {
                let rail = match rail {
                    Rail::Zero => 0,
                    Rail::FullScale => self.full_scale,
                };
                let gauges = counts.iter_mut().take(count);
                gauges.for_each(|gauge| *gauge = rail);
            }
            Fault::GaugeStuck(i) => counts[i] = self.held.frames[self.frame][i],
            Fault::GaugesShifted(by) => {
                let gauges = counts.iter_mut().zip(by);
                gauges.for_each(|(gauge, by)| *gauge += by);
            }
            Fault::GaugeDrift {
                gauge,
                counts_per_s,
            } => {
                let drift = counts_per_s * f64::from(since) * 1e-3;
                let gauge = &mut counts[gauge];
                *gauge = (*gauge + drift.round() as i32).clamp(0, self.full_scale);
            }
            Fault::EncoderStuck(Wheel { axle, side }) => {
                axles[axle].encoder[side] = self.held.axles[axle].encoder[side];
            }
            Fault::EncoderJumps {
                wheel: Wheel { axle, side },
                counts: by,
            } => {
                let jumps = (since / 50 + 1) as i32;
                let count = &mut axles[axle].encoder[side];
                *count = count.map(|count| count.wrapping_add(by.wrapping_mul(jumps)));
            }
            Fault::EncodersSwapped(axle) => {
                let Wheels { left, right } = &mut axles[axle].encoder;
                std::mem::swap(left, right);
            }
            Fault::EncoderMissing(Wheel { axle, side }) => axles[axle].encoder[side] = None,
            Fault::GyroNotANumber(axle) => axles[axle].gyro_rad_s = Some(f32::NAN),
            Fault::GyroBias { axle, bias_rad_s } => {
                let gyro = &mut axles[axle].gyro_rad_s;
                *gyro = gyro.map(|rate| rate + bias_rad_s);
            }
            Fault::AccelerometerMissing(axle) => axles[axle].acceleration_m_s2 = None,
            Fault::Reported {
                axle,
                condition,
                ms,
            } if ms == 0 || since < ms => {
                let conditions = &mut axles[axle].conditions;
                *conditions = conditions.union(Conditions::only(condition));
            }
            _ => {}
        }
    }

    /// Applies the fault to the wheel torques at a tick. `wanted` holds the commanded torques, N m, and becomes the
    /// torques of the motors.
    pub fn torque(&self, tick: u32, wanted: &mut [[f64; 2]]) {
        if tick < self.at {
            return;
        }
        match self.fault {
            Fault::MotorWeak {
                wheel: Wheel { axle, side },
                share,
            } => wanted[axle][side as usize] *= share,
            // A board with its motor bridges off has both commands at exactly zero.
            Fault::MotorStuckOn {
                wheel: Wheel { axle, side },
                torque_n_m,
            } if wanted[axle] != [0.0; 2] => {
                wanted[axle][side as usize] = torque_n_m;
            }
            _ => {}
        }
    }

    /// Wheel that leaves the ground at this tick; `None` if no wheel does.
    pub fn lifts(&self, tick: u32) -> Option<Wheel> {
        match self.fault {
            Fault::WheelLifted(wheel) if tick == self.at => Some(wheel),
            _ => None,
        }
    }

    /// Frame that snaps at this tick; `None` if none does.
    pub fn snaps(&self, tick: u32) -> Option<usize> {
        (self.fault == Fault::FrameSnapped && tick == self.at).then_some(self.frame)
    }

    /// True if the board `role` does not run at this tick.
    pub fn frozen(&self, role: Role, tick: u32) -> bool {
        match self.fault {
            Fault::Freeze { board, ms } if board == role => {
                tick.checked_sub(self.at).is_some_and(|since| since < ms)
            }
            Fault::SlowClock { board, period } if board == role => {
                let since = tick.checked_sub(self.at);
                since.is_some_and(|since| since % period == period - 1)
            }
            _ => false,
        }
    }

    /// Delay of a board's clock behind the true time at a tick, ticks.
    pub fn clock_lag(&self, role: Role, tick: u32) -> ClockLag {
        match self.fault {
            Fault::SlowClock { board, period } if board == role => {
                tick.saturating_sub(self.at).div_euclid(period)
            }
            _ => 0,
        }
    }
}
