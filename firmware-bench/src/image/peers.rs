//! Other libraries on the problem of [`super::problem`], each by its own interface.

use super::counter::Counter;
use super::problem::{self, H, P0, Q, R, STEPS, X0, jacobian, measurement, motion};
use adskalman::{ObservationModel, StateAndCovariance, TransitionModelLinearNoControl};
use kfilter::measurement::LinearMeasurement;
use kfilter::system::StepReturn;
use kfilter::{Kalman, KalmanFilter, KalmanPredictInput, KalmanUpdate};
use minikalman::extended::builder::KalmanFilterBuilder;
use minikalman::prelude::*;
use nalgebra::{SMatrix, SVector};
use semihosting::println;

type M7 = SMatrix<f32, 7, 7>;
type V7 = SVector<f32, 7>;
type M4 = SMatrix<f32, 4, 4>;
type M47 = SMatrix<f32, 4, 7>;
type M74 = SMatrix<f32, 7, 4>;

/// Measures each.
pub fn measure(counter: &mut Counter) {
    textbook(counter);
    with_adskalman(counter);
    with_kfilter(counter);
    with_minikalman(counter);
}

fn rows<const N: usize>(a: &[[f32; 7]; N]) -> SMatrix<f32, N, 7> {
    SMatrix::from_fn(|i, j| a[i][j])
}

fn show(name: &str, x: &[f32]) {
    println!("state {} {} {} {}", name, x[0], x[1], x[2]);
}

/// The equations of a textbook with nalgebra's matrices: P − K S Kᵀ by a Cholesky factor of S.
fn textbook(counter: &mut Counter) {
    let (h, r) = (rows(&H), M4::from_diagonal(&R.into()));
    let q = M7::from_fn(|i, j| Q[i][j]);
    let (mut x, mut p) = (V7::from(X0), M7::from_diagonal(&P0.into()));
    counter.report("peer_nalgebra_textbook", STEPS, |k| {
        let (next, entries) = motion(&x.into());
        let a = rows(&jacobian(entries));
        x = next.into();
        p = a * p * a.transpose() + q;
        let innovation = SVector::from(measurement(k)) - h * x;
        let pht = p * h.transpose();
        if let Some(s) = (h * pht + r).cholesky() {
            let gain = s.solve(&pht.transpose()).transpose();
            x += gain * innovation;
            p = (M7::identity() - gain * h) * p;
        }
    });
    show("nalgebra_textbook", x.as_slice());
}

struct Linearised {
    next: V7,
    f: M7,
    ft: M7,
    q: M7,
}

impl TransitionModelLinearNoControl<f32, nalgebra::U7> for Linearised {
    fn F(&self) -> &M7 {
        &self.f
    }
    fn FT(&self) -> &M7 {
        &self.ft
    }
    fn Q(&self) -> &M7 {
        &self.q
    }
    fn predict(
        &self,
        previous: &StateAndCovariance<f32, nalgebra::U7>,
    ) -> StateAndCovariance<f32, nalgebra::U7> {
        let covariance = self.f * previous.covariance() * self.ft + self.q;
        StateAndCovariance::new(self.next, covariance)
    }
}

struct Sensors {
    h: M47,
    ht: M74,
    r: M4,
}

impl ObservationModel<f32, nalgebra::U7, nalgebra::U4> for Sensors {
    fn H(&self) -> &M47 {
        &self.h
    }
    fn HT(&self) -> &M74 {
        &self.ht
    }
    fn R(&self) -> &M4 {
        &self.r
    }
}

fn with_adskalman(counter: &mut Counter) {
    let h = rows(&H);
    let sensors = Sensors {
        h,
        ht: h.transpose(),
        r: M4::from_diagonal(&R.into()),
    };
    let q = M7::from_fn(|i, j| Q[i][j]);
    let mut estimate = StateAndCovariance::new(V7::from(X0), M7::from_diagonal(&P0.into()));
    counter.report("peer_adskalman", STEPS, |k| {
        let (next, entries) = motion(&(*estimate.state()).into());
        let f = rows(&jacobian(entries));
        let model = Linearised {
            next: next.into(),
            f,
            ft: f.transpose(),
            q,
        };
        let prior = model.predict(&estimate);
        // Of its three methods the cheapest.
        let method = adskalman::CovarianceUpdateMethod::OptimalKalman;
        if let Ok(posterior) = sensors.update(&prior, &measurement(k).into(), method) {
            estimate = posterior;
        }
    });
    show("adskalman", estimate.state().as_slice());
}

mod older {
    //! The version of nalgebra that kfilter takes.
    pub use nalgebra_0_34::{SMatrix, SVector};
}

fn kfilter_step(x: older::SVector<f32, 7>, _: older::SVector<f32, 0>) -> StepReturn<f32, 7> {
    let (next, entries) = motion(&x.into());
    let a = jacobian(entries);
    StepReturn {
        state: next.into(),
        jacobian: older::SMatrix::from_fn(|i, j| a[i][j]),
        covariance: older::SMatrix::from_fn(|i, j| Q[i][j]),
    }
}

fn with_kfilter(counter: &mut Counter) {
    let system = kfilter::system::NonLinearSystem::new(kfilter_step, X0.into());
    let mut filter = Kalman::new_custom(system, older::SMatrix::from_diagonal(&P0.into()));
    let mut sensors = LinearMeasurement::new(
        older::SMatrix::<f32, 4, 7>::from_fn(|i, j| H[i][j]),
        older::SMatrix::from_diagonal(&R.into()),
        older::SVector::zeros(),
    );
    counter.report("peer_kfilter", STEPS, |k| {
        let _ = filter.predict(older::SVector::zeros());
        sensors.z = measurement(k).into();
        let _ = filter.update(&sensors);
    });
    show("kfilter", filter.state().as_slice());
}

fn with_minikalman(counter: &mut Counter) {
    let builder = KalmanFilterBuilder::<7, f32>::default();
    let mut filter = builder.build();
    let mut sensors = builder.observations().build::<4>();
    filter.state_vector_mut().apply(|x| {
        for i in 0..7 {
            x.set_row(i, X0[i]);
        }
    });
    filter.estimate_covariance_mut().apply(|p| {
        p.clear();
        for i in 0..7 {
            p.set_at(i, i, P0[i]);
        }
    });
    filter.direct_process_noise_mut().apply(|q| {
        q.clear();
        for i in 0..7 {
            for j in 0..7 {
                q.set_at(i, j, Q[i][j]);
            }
        }
    });
    sensors.measurement_noise_covariance_mut().apply(|r| {
        r.clear();
        for i in 0..4 {
            r.set_at(i, i, R[i]);
        }
    });
    sensors.observation_jacobian_matrix_mut().apply(|h| {
        for i in 0..4 {
            for j in 0..7 {
                h.set_at(i, j, H[i][j]);
            }
        }
    });
    counter.report("peer_minikalman", STEPS, |k| {
        let x: [f32; 7] = core::array::from_fn(|i| filter.state_vector().get_row(i));
        let (next, entries) = motion(&x);
        let a = problem::jacobian(entries);
        filter.state_transition_jacobian_mut().apply(|m| {
            for i in 0..7 {
                for j in 0..7 {
                    m.set_at(i, j, a[i][j]);
                }
            }
        });
        filter.predict_nonlinear(|_, state| {
            for i in 0..7 {
                state[i] = next[i];
            }
        });
        let z = measurement(k);
        sensors.measurement_vector_mut().apply(|m| {
            for i in 0..4 {
                m.set_row(i, z[i]);
            }
        });
        filter.correct_nonlinear(&mut sensors, |state, seen| {
            for i in 0..4 {
                seen[i] = (3..6).map(|j| H[i][j] * state.get_row(j)).sum();
            }
        });
    });
    let x: [f32; 7] = core::array::from_fn(|i| filter.state_vector().get_row(i));
    show("minikalman", &x);
}
