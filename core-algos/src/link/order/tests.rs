use super::*;
use crate::control::regulator::Tolerance;
use crate::math::Posture;
use crate::node::board::{Board, Ready};
use crate::node::robot::{ConfiguredPlacement, RobotConfig};
use crate::topology::Role;

fn front() -> Board {
    let config = RobotConfig::default();
    Ready::new(&config, Role::LEAD).unwrap().begin()
}

fn point(s: f32, kappa: f32) -> PathPoint {
    let posture = Posture::new(s, 0.0, 0.0);
    PathPoint { posture, kappa, s }
}

/// Path points with these curvatures, and a trajectory through the same points at 1 m/s.
fn points(
    kappas: &[f32],
) -> (
    [Option<PathPoint>; POINTS],
    [Option<TrajectoryPoint>; POINTS],
) {
    let path = core::array::from_fn(|i| {
        let kappa = kappas.get(i)?;
        Some(point(0.1 * i as f32, *kappa))
    });
    let timed = |point: PathPoint| TrajectoryPoint {
        time_s: point.s,
        v: 1.0,
        point,
    };
    (path, path.map(|point| point.map(timed)))
}

#[test]
fn place_task_and_loss_reach_the_lead_node() {
    let placement = RobotConfig::default()
        .placement(Posture::new(2.0, 1.0, 0.5), &ConfiguredPlacement::default());
    let goal = Posture::new(1.0, 0.0, 0.0);
    let mut nodes = front();
    let lead = nodes.lead().unwrap();
    let mut expected = lead.clone();
    for order in [
        Order::SetPose(placement),
        Order::Task(Task::regulate(goal)),
        Order::Lost,
        Order::Task(Task::follow()),
        Order::Task(Task::Idle),
    ] {
        let before = expected.clone();
        match order {
            Order::SetPose(placement) => expected.initialize(&placement),
            Order::Task(task) => expected.command(task),
            _ => expected.on_host_lost(),
        }
        assert_ne!(before, expected, "{order:?}");
        assert_eq!(order.execute(lead), Ok(()));
        assert_eq!(*lead, expected, "{order:?}");
    }
}

#[test]
fn task_that_is_not_finite_or_too_tight_is_refused_and_changes_nothing() {
    let mut nodes = front();
    let lead = nodes.lead().unwrap();
    let most = 1.001 * lead.cascade().max_curvature();
    let (not_finite, tight) = (Err(PathError::NotFinite), Err(PathError::TooTight));
    let regulate = |x, position_m| Task::Regulate {
        goal: Posture::new(x, 0.0, 0.0),
        within: Tolerance {
            position_m,
            heading_rad: 0.1,
        },
    };
    let drive = |speed_m_s, curvature| Task::Drive {
        speed_m_s,
        curvature,
    };
    let within = |position_m, heading_rad| Tolerance {
        position_m,
        heading_rad,
    };
    let follow = |within| Task::Follow { within };
    let track = |within| Task::Track { within };
    for (task, expected) in [
        (follow(within(f32::NAN, 0.1)), not_finite),
        (follow(within(0.1, 0.0)), not_finite),
        (track(within(-0.1, 0.1)), not_finite),
        (track(within(0.1, f32::NAN)), not_finite),
        (regulate(1.0, 0.1), Ok(())),
        (regulate(f32::NAN, 0.1), not_finite),
        (regulate(f32::INFINITY, 0.1), not_finite),
        (regulate(1.0, 0.0), not_finite),
        (regulate(1.0, f32::NAN), not_finite),
        (regulate(f32::NAN, f32::NAN), not_finite),
        (drive(0.1, most), Ok(())),
        (drive(-0.1, -most), Ok(())),
        (drive(0.1, most.next_up()), tight),
        (drive(0.1, -most.next_up()), tight),
        (drive(f32::NAN, most.next_up()), tight),
        (drive(0.1, f32::INFINITY), tight),
        (drive(f32::NAN, 0.0), not_finite),
        (drive(f32::NEG_INFINITY, 0.0), not_finite),
        (drive(0.1, f32::NAN), not_finite),
        (Task::Stop, Ok(())),
    ] {
        let before = lead.clone();
        assert_eq!(Order::Task(task).execute(lead), expected, "{task:?}");
        assert_eq!(before == *lead, expected.is_err(), "{task:?}");
    }
}

#[test]
fn points_are_appended_up_to_the_first_that_is_refused() {
    let mut nodes = front();
    let lead = nodes.lead().unwrap();
    let most = 1.001 * lead.cascade().max_curvature();
    let over = most.next_up();
    for (kappas, taken, error) in [
        (
            &[most, -most, most, -most, 0.0, 0.0, 0.0, most][..],
            8,
            None,
        ),
        (&[0.0, 0.0], 2, None),
        (&[], 0, None),
        (&[over, 0.0, 0.0], 0, Some(PathError::TooTight)),
        (&[0.0, -over, 0.0], 1, Some(PathError::TooTight)),
        (
            &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, over],
            7,
            Some(PathError::TooTight),
        ),
        (&[0.0, f32::NAN, 0.0], 1, Some(PathError::NotFinite)),
    ] {
        let (path, trajectory) = points(kappas);
        let points = path
            .into_iter()
            .flatten()
            .zip(trajectory.into_iter().flatten());
        for end in [false, true] {
            let ends = end && error.is_none();
            // Expected state: the points are pushed into the node directly.
            let [mut by_path, mut by_trajectory] = [lead.clone(), lead.clone()];
            for (point, timed) in points.clone().take(taken) {
                by_path.path_task().push_path_point(point).unwrap();
                by_trajectory
                    .path_task()
                    .push_trajectory_point(timed)
                    .unwrap();
            }
            if ends {
                by_path.path_task().finish_path();
                by_trajectory.path_task().finish_trajectory();
            }
            let orders = [
                (Order::Path { points: path, end }, by_path),
                (
                    Order::Trajectory {
                        points: trajectory,
                        end,
                    },
                    by_trajectory,
                ),
            ];
            for (order, expected) in orders {
                let mut lead = lead.clone();
                assert_eq!(order.execute(&mut lead).err(), error, "{order:?}");
                assert!(lead == expected, "{order:?}");
            }
        }
    }
}

#[test]
fn place_order_with_nan_is_refused() {
    let mut nodes = front();
    let lead = nodes.lead().unwrap();
    let mut placement =
        RobotConfig::default().placement(Posture::ORIGIN, &ConfiguredPlacement::default());
    placement.center.posture.x = f32::NAN;
    let refused = Order::SetPose(placement).execute(lead);
    assert_eq!(refused, Err(PathError::NotFinite));
    assert!(lead.fusion().is_none());
}
