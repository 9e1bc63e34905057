//! Tests of the figures.

use super::*;
use crate::plot::checks::{check_figure, png_size};
use host_sim::run::end::EndKind;

const BODY: Body = Body {
    half_track_m: 0.162,
    wheel_radius_m: 0.073,
    wheel_width_m: 0.03,
};

fn panel(title: &str, spread: f64) -> PathsPanel {
    let path = |k: usize| -> Vec<[f64; 2]> {
        let miss = spread * (k as f64).sin();
        (0..=100)
            .map(|i| f64::from(i) / 100.0)
            .map(|s| [1.342 * (s - 1.0), 1.342 * (s * s - 1.0) + miss * s])
            .collect()
    };
    PathsPanel {
        title: title.into(),
        others: (1..20).map(path).collect(),
        path: path(0),
        wheels: vec![path(0); 4],
        snapshots: vec![Snapshot {
            axles: vec![[-1.162, -1.342, 0.1], [-1.522, -1.342, -0.1]],
            frames: vec![vec![[-1.522, -1.342], [-1.162, -1.342]]],
            time_s: 0.0,
        }],
        goal: Some([0.0; 3]),
        tolerance: [0.03, 0.05236],
        ends: (0..20)
            .map(|k| [0.0, spread * f64::from(k).sin(), 0.02])
            .map(|end| (Verdict::of(EndKind::Reached, end[1].abs() < 0.03), end))
            .collect(),
        measured: None,
    }
}

fn trace(offset: f64) -> Vec<(f64, FinalError)> {
    let error = |t: f64| FinalError {
        e_m: (-t).exp() + offset,
        heading_rad: 0.0,
        theta_rad: (3.0 + t).sin().atan2((3.0 + t).cos()),
        alpha_rad: 2.0 * (-t).exp() - offset,
    };
    let times = (0..500).map(|k| f64::from(k) * 0.02);
    times.map(|t| (t, error(t))).collect()
}

fn column(title: &str) -> ErrorsColumn {
    ErrorsColumn {
        title: title.into(),
        estimate: trace(0.015),
        truth: trace(0.095),
        measured: None,
    }
}

fn starts(count: u32) -> Vec<StartMark> {
    (0..count)
        .map(f64::from)
        .map(|k| StartMark {
            posture: [2.0 * (1.3 * k).sin(), 2.0 * (1.7 * k).cos(), k],
            value: 5.0 + (0.3 * k).sin(),
            end: Verdict::ALL[if k < 3.0 { k as usize } else { 0 }],
        })
        .collect()
}

#[test]
fn every_figure_is_complete_and_fits_the_page() {
    let run = FollowRun {
        reference: vec![[0.0, 0.0], [2.0, 0.0]],
        driven: vec![vec![[0.0, 0.1], [1.0, 0.01], [2.0, 0.0]]],
        snapshots: panel("", 0.0).snapshots,
        distance_label: "distance to the left",
        truth: FollowErrors {
            t_s: vec![0.0, 5.0, 10.0],
            distance_m: vec![0.1, 0.01, 0.0],
            heading_rad: vec![0.0, -0.1, 0.0],
        },
        estimate: FollowErrors::default(),
    };
    let (with, without) = (panel("with RPS", 0.01), panel("without RPS", 0.2));
    for figure in [
        paths("Robot paths", &BODY, &[with.clone(), without]),
        paths("Robot paths", &BODY, &[with]),
        errors(
            "Posture errors",
            &[column("with RPS"), column("without RPS")],
        ),
        errors("Posture errors", &[column("with RPS")]),
        follow("Path following", &BODY, &run),
        maps(
            "Starts",
            "time (s)",
            &[("a".to_owned(), starts(200))],
            ([0.0; 3], [0.1, 0.1]),
        ),
    ] {
        check_figure(&figure);
        let [width, height] = png_size(&figure.png());
        assert!(width == 1600 && (600..3000).contains(&height), "{height}");
    }
}

#[test]
fn empty_results_still_give_figures() {
    let empty = PathsPanel {
        others: Vec::new(),
        path: Vec::new(),
        wheels: Vec::new(),
        snapshots: Vec::new(),
        ends: Vec::new(),
        ..panel("none", 0.0)
    };
    let no_errors = ErrorsColumn {
        title: "none".into(),
        estimate: Vec::new(),
        truth: Vec::new(),
        measured: None,
    };
    for figure in [
        paths("", &BODY, &[empty]),
        errors("", &[no_errors]),
        maps("", "", &[], ([0.0; 3], [0.1, 0.1])),
    ] {
        check_figure(&figure);
    }
}

#[test]
fn final_errors_are_given_in_the_caption() {
    let svg = errors("", &[column("with RPS")]).svg();
    // At the end e^−t is below the last digit shown: the offsets 9.5 cm and 1.5 cm remain.
    assert!(svg.contains("final: 9.5 cm; estimate: 1.5 cm"));
    assert!(svg.contains("final: −5.4°; estimate: –"));
}

#[test]
fn angles_are_not_drawn_within_5_cm_of_the_goal() {
    // e^-t + 0.015 falls below 0.05 at t = -ln 0.035 = 3.352.
    for axis in &ERROR_AXES[1..] {
        let near = ErrorsColumn {
            truth: trace(0.015),
            ..column("")
        };
        let [time, _] = error_panel(axis, 1, &near).extent().unwrap();
        assert_eq!(time, [0.0, 3.34], "{}", axis.label);
    }
    let [time, _] = error_panel(&ERROR_AXES[0], 0, &column(""))
        .extent()
        .unwrap();
    assert_eq!(time, [0.0, 9.98]);
}

#[test]
fn map_of_starts_distinguishes_verdicts() {
    let map = |starts: Vec<StartMark>| {
        maps(
            "",
            "time (s)",
            &[("a".to_owned(), starts)],
            ([0.0; 3], [0.03, 0.05236]),
        )
    };
    let svg = map(starts(200)).svg();
    for text in [
        "198 of 200 within 3 cm and 3°",
        "outside 3 cm or 3°",
        "task not done",
    ] {
        assert!(svg.contains(text), "{text}");
    }
    let svg = map(starts(1)).svg();
    assert!(!svg.contains("outside") && !svg.contains("not carried"));
}

#[test]
fn line_of_an_angle_is_interrupted_where_it_wraps() {
    let points = [[0.0, 170.0], [1.0, -175.0], [2.0, -160.0]];
    let line = with_gaps(points.into_iter(), 180.0);
    assert_eq!(line.len(), 4);
    assert!(line[1][0].is_nan() && line[2] == points[1]);
}

#[test]
fn final_postures_are_shown_in_goal_coordinates() {
    let data = PathsPanel {
        goal: Some([1.0, 1.0, std::f64::consts::FRAC_PI_2]),
        tolerance: [0.005, 0.1],
        // The run ended 1 cm ahead of the goal and 2 cm to its right.
        ends: vec![(Verdict::Within, [1.02, 1.01, 1.0])],
        ..panel("", 0.0)
    };
    let [x, y] = end_map(&data).extent().unwrap();
    assert!(
        (x[1] - 1.0).abs() < 1e-9 && (y[0] + 2.0).abs() < 1e-9,
        "{x:?} {y:?}"
    );
}

/// Table 1: e = 9.5 ± 2.1 cm, θ = −13.3 ± 14.2°, α = −21.6 ± 14.9°; by eq. 1 the heading is θ − α.
#[test]
fn measured_end_lies_where_its_polar_errors_put_it() {
    let [theta, alpha] = [[-13.3, 14.2], [-21.6, 14.9]].map(|pair| pair.map(f64::to_radians));
    let measured = MeasuredEnd {
        e_m: [0.095, 0.021],
        theta_rad: theta,
        alpha_rad: alpha,
    };
    let [x, y, heading] = measured.mean_posture();
    let error = FinalError::of([0.01 * x, 0.01 * y, heading], [0.0; 3]);
    assert!((error.e_m - 0.095).abs() < 1e-12);
    assert!((error.theta_rad - theta[0]).abs() < 1e-12);
    assert!((error.alpha_rad - alpha[0]).abs() < 1e-12);
    // On the outline the larger of the two errors, in standard deviations, is 1.
    for [x, y] in measured.outline() {
        let error = FinalError::of([0.01 * x, 0.01 * y, 0.0], [0.0; 3]);
        let e = (error.e_m - 0.095).abs() / 0.021;
        let angle = (error.theta_rad - theta[0]).abs() / theta[1];
        assert!((e.max(angle) - 1.0).abs() < 1e-9, "{x} {y}");
    }
    let mut shown = panel("the paper's robot", 0.01);
    shown.measured = Some(measured);
    let svg = paths("", &BODY, &[shown]).svg();
    assert!(svg.contains("paper, Table 1"));
    let mut column = column("encoders");
    column.measured = Some([0.015, 0.035, 0.18]);
    assert!(errors("", &[column]).svg().contains("paper, final value"));
}
