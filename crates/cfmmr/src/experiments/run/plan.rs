//! Time limits of a run, and failures of boards during the run.

use core_algos::time::Micros;
use host_sim::base::error::Error;
use host_sim::run::robot::Span;
use host_sim::scenario::Scenario;
use host_sim::targets::Failure;

/// Time limits of a run, and failures of boards during the run.
#[derive(Clone, Debug, Default)]
pub struct Plan {
    /// Shortest and longest duration of the run.
    pub span: Span,
    /// True if the run keeps real time: no tick begins early.
    pub real_time: bool,
    /// Boards that are switched off.
    pub failures: Vec<Failure>,
    /// Time until a lost board is switched on again, ms.
    pub restart_after: Option<u32>,
}

impl Plan {
    /// Refuses failures of boards that are not fitted, and failures after the end of a run with the time limit
    /// `limit_s`, s.
    pub fn check(&self, scenario: &Scenario, limit_s: f64) -> Result<(), Error> {
        let seconds = |micros: Micros| micros as f64 * 1e-6;
        let end = self.span.most.map_or(f64::MAX, seconds).min(limit_s);
        for failure in &self.failures {
            let at = f64::from(failure.at) * 1e-3;
            let board = scenario.robot.topology().name(failure.role);
            let kill = format!("--kill {board}@{at}");
            if failure.role.is_beam() && !scenario.mission.rps {
                return Err(Error::input(format!(
                    "{kill}: must be front or rear: without the relative position sensor there is no beam board"
                )));
            }
            if at >= end {
                return Err(Error::input(format!(
                    "{kill}: {at} s: must be before the run ends, at {end} s"
                )));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::topology::Role;
    use host_sim::run::robot::Span;
    use host_sim::targets::FailureMode;

    #[test]
    fn failure_after_the_time_limit_is_refused_for_any_duration() {
        let failure = |at| Failure {
            role: Role::LEAD,
            at,
            mode: FailureMode::Off,
        };
        let plan = |at| Plan {
            span: Span {
                least: 30_000_000,
                most: None,
            },
            failures: vec![failure(at)],
            ..Plan::default()
        };
        let scenario = Scenario::default();
        assert!(plan(11_000).check(&scenario, 11.5).is_ok());
        assert_eq!(
            plan(25_000).check(&scenario, 11.5).unwrap_err().exit_code(),
            2
        );
    }
}
