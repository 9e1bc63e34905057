use super::directory::{Block, Directory};
use super::parts::{merge, next_step, ranges};
use super::pictures::{correlations, distributions, map, sensitivity};
use super::report::{CampaignReport, rank_correlation, wilson};
use super::rows::{self, CampaignRow};
use super::study::{Study, StudyRun, number};
use host_sim::run::end::{EndKind, RunEnd};
use host_sim::run::regulate::Outcome;
use plant::{Creep, Tyre};
use view::plot::checks::check_figure;

const TEXT: &str = r#"
name = "test"
seed = 3
trials = 4
block = 3

[[vary]]
key = "plant.tyre.creep.velocity_m_s"
values = [0.003, 0.01]

[[vary]]
key = "mission.rps"
values = [true, false]

[[vary]]
key = "sensors.geometry.wheel_radius_sigma"
uniform = [0.0, 0.002]

[scenario.plant]
tyre.creep = {}

[scenario.mission]
start = [-0.5, 0.1, 0.0]
"#;

pub(super) fn study() -> Study {
    Study::parse(TEXT, "test").unwrap()
}

#[test]
fn every_combination_has_the_same_trials() {
    let study = study();
    assert_eq!((study.runs(), study.blocks()), (16, 6));
    let runs: Vec<_> = (0..16).map(|i| study.run(i).unwrap()).collect();
    let drawn = |run: &StudyRun| run.scenario.world.sensors.geometry.wheel_radius_sigma;
    for (i, run) in runs.iter().enumerate() {
        assert_eq!((run.cell, run.trial), (i as u64 / 4, i as u32 % 4));
        let [creep, rps] = [[0.003, 0.01][i / 8], [1.0, 0.0][i / 4 % 2]];
        let tyre = Tyre::Creep(Creep {
            velocity_m_s: creep,
        });
        assert_eq!(run.scenario.world.plant.tyre, tyre);
        assert_eq!(f64::from(u8::from(run.scenario.mission.rps)), rps);
        assert_eq!(run.scenario.mission.start[0], -0.5);
        // Drawn values depend on the trial only.
        assert!((0.0..0.002).contains(&drawn(run)));
        assert_eq!(drawn(run), drawn(&runs[i % 4]));
    }
    let drawn: Vec<f64> = runs[..4].iter().map(drawn).collect();
    assert!(drawn.windows(2).all(|pair| pair[0] != pair[1]), "{drawn:?}");
}

#[test]
fn error_of_a_study_names_file_and_key() {
    let changes = r#"
        trials = 4 => trials = 0 => trials
        block = 3 => block = 0 => block
        trials = 4 => trials = 9000000 => runs
        uniform = [0.0, 0.002] => uniform = [0.002, 0.0] => uniform
        uniform = [0.0, 0.002] => log_uniform = [0.0, 0.002] => log_uniform
        uniform = [0.0, 0.002] => normal = [0.0, 0.0] => normal
        uniform = [0.0, 0.002] => uniform = [0.0, 0.2] => draws reach sensors.geometry.wheel_radius_sigma = 0.2
        uniform = [0.0, 0.002] => normal = [0.001, 0.0005] => draws reach sensors.geometry.wheel_radius_sigma = -0.0015
        uniform = [0.0, 0.002] => => exactly one
        [0.0, 0.002] => [0.0, 0.5] => vary: draws reach sensors.geometry.wheel_radius_sigma = 0.5: must be
        values = [true, false] => values = [] => values
        values = [true, false] => values = [true, 3] => mission.rps
        mission.rps => mission.rsp => rsp
        mission.rps => plant.tyre.creep.velocity_m_s => twice
        mission.rps => plant.tyre => vary plant.tyre: contains or is part of vary plant.tyre.creep.velocity_m_s
        [-0.5, 0.1, 0.0] => [-0.5, 0.1] => start
        seed = 3 => sede = 3 => sede"#;
    for change in changes.trim().lines() {
        let [from, to, named] = change.split("=>").map(str::trim).collect::<Vec<_>>()[..] else {
            panic!("{change}");
        };
        let text = TEXT.replace(from, to);
        assert_ne!(text, TEXT);
        let error = Study::parse(&text, "file.toml").unwrap_err();
        assert!(error.to_string().contains(named), "{to}: {error}");
        assert!(
            error.to_string().contains("file.toml") && error.exit_code() == 2,
            "{error}"
        );
    }
}

pub(super) fn finished(study: &Study, block: u64) -> Vec<CampaignRow> {
    let row = |index| {
        let outcome = Outcome {
            midpoint: [0.001 * index as f64, 0.0, 0.0],
            end: RunEnd {
                kind: EndKind::Reached,
                ..RunEnd::default()
            },
            ..Outcome::default()
        };
        CampaignRow::of(index, study.run(index).unwrap(), &outcome)
    };
    study.block_runs(block).map(row).collect()
}

#[test]
fn blocks_are_stored_and_spoiled_files_detected() {
    let folder = tempfile::tempdir().unwrap();
    let directory = Directory::open_for(study(), folder.path()).unwrap();
    assert_eq!(directory.block(2).unwrap(), Block::Missing);
    directory.write(2, finished(&study(), 2)).unwrap();
    let Block::Complete(rows) = directory.block(2).unwrap() else {
        panic!("{:?}", directory.block(2));
    };
    let cells_and_trials: Vec<_> = rows.iter().map(|row| (row.cell, row.trial)).collect();
    assert_eq!(cells_and_trials, [(1, 2), (1, 3), (2, 0)]);
    let of = |row: &CampaignRow| (row.run, row.e_m, row.values[1].as_bool() == Some(true));
    let found: Vec<_> = rows.iter().map(of).collect();
    let wanted = [(6, 0.006, false), (7, 0.007, false), (8, 0.008, true)];
    assert_eq!(found, wanted);
    // JSON cannot represent NaN.
    let mut bad = finished(&study(), 1);
    bad[0].path_m = f64::NAN;
    let error = directory.write(1, bad).unwrap_err().to_string();
    assert!(error.contains("block-000001.jsonl"), "{error}");
    assert_eq!(directory.block(1).unwrap(), Block::Missing);
    // A file with the content of another block, and a truncated file, count as damaged.
    let path = folder.path().join("block-000002.jsonl");
    std::fs::copy(&path, folder.path().join("block-000003.jsonl")).unwrap();
    assert!(matches!(directory.block(3).unwrap(), Block::Damaged(_)));
    let content = std::fs::read(&path).unwrap();
    std::fs::write(&path, &content[..content.len() / 2]).unwrap();
    assert!(matches!(directory.block(2).unwrap(), Block::Damaged(_)));
    // The folder of a different study is refused.
    let other = Study::parse(&TEXT.replace("seed = 3", "seed = 4"), "other").unwrap();
    let error = Directory::open_for(other, folder.path()).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("a different study"));
    assert_eq!(Directory::open(folder.path()).unwrap().study(), &study());
    assert!(Directory::open(&folder.path().join("none")).is_err());
}

/// All runs of a study.
fn all_runs(study: &Study) -> Vec<CampaignRow> {
    (0..study.blocks())
        .flat_map(|block| finished(study, block))
        .collect()
}

#[test]
fn report_of_some_runs_counts_them() {
    let study = study();
    let all = all_runs(&study);
    let report = CampaignReport::of(&study, &all);
    assert_eq!((report.runs, report.cells.len()), (16, 4));
    let csv = String::from_utf8(rows::csv(&study, &all).into_bytes()).unwrap();
    let seventh = csv.lines().nth(7).unwrap();
    assert!(seventh.starts_with("6,1,2,0.003,false,0.00"), "{seventh}");
    assert_eq!((csv.lines().count(), seventh.split(',').count()), (17, 25));
    // The second combination has runs 4 to 7, which end 4 to 7 mm from the goal.
    let second = &report.cells[1];
    assert!((second.e_m.mean - 0.0055).abs() < 1e-12);
    assert_eq!(second.within_3cm_3deg, 1.0);
    assert_eq!(
        second.values[1],
        ("mission.rps".to_owned(), "false".to_owned())
    );
    assert_eq!(report.influences.len(), 4);
    // If runs 0 and 1 are missing, the first combination has 2 of 4 trials.
    let part = CampaignReport::of(&study, &all[2..]);
    let trials: Vec<_> = part.cells.iter().map(|cell| cell.trials).collect();
    assert_eq!(trials, [2, 4, 4, 4]);
}

#[test]
fn pictures_are_complete_for_any_varied_keys() {
    let lists = |count: usize| {
        let blocks: Vec<&str> = TEXT.split("[[vary]]").collect();
        let kept: Vec<&str> = [&blocks[..1], &blocks[3 - count..]].concat();
        kept.join("[[vary]]")
    };
    let mut lines = Vec::new();
    for count in 0..=2 {
        for (from, to) in [
            ("block = 3", "block = 3"),
            ("block = 3", "block = 3\nstarts = \"random\""),
            ("trials = 4", "trials = 1"),
        ] {
            let study = Study::parse(&lists(count).replace(from, to), "test").unwrap();
            let runs = all_runs(&study);
            let shares = distributions(&study, &runs);
            let influences = sensitivity(&study, &runs).unwrap();
            for figure in [&shares, &map(&study, &runs), &influences] {
                check_figure(figure);
            }
            let of = CampaignReport::of(&study, &runs).influences;
            let correlations = correlations(&study, &runs, &of);
            assert_eq!(correlations.is_some(), study.trials > 1);
            correlations.iter().for_each(check_figure);
            // The axis of errors from 0 to 15 mm has a label.
            assert!(influences.svg().contains(">0.01<"));
            lines.push(shares.svg().matches("stroke-width=\"1.8\"").count());
        }
    }
    // One line per combination.
    assert!(lines[0] < lines[3] && lines[3] < lines[6], "{lines:?}");
}

#[test]
fn pictures_are_split_by_every_key_without_numbers() {
    let more = r#"[[vary]]
key = "sensors.gyro.fitted"
values = [true, false]

[[vary]]
key = "mission.rps""#;
    for starts in ["scenario", "random"] {
        let text = TEXT.replacen("[[vary]]\nkey = \"mission.rps\"", more, 1);
        let text = text.replace("block = 3", &format!("block = 3\nstarts = \"{starts}\""));
        let study = Study::parse(&text, "test").unwrap();
        let runs = all_runs(&study);
        for figure in [
            distributions(&study, &runs),
            map(&study, &runs),
            sensitivity(&study, &runs).unwrap(),
            correlations(&study, &runs, &CampaignReport::of(&study, &runs).influences).unwrap(),
        ] {
            check_figure(&figure);
            let svg = figure.svg();
            for gyro in [true, false] {
                for rps in [true, false] {
                    let label = format!("gyro.fitted = {gyro}, mission.rps = {rps}<");
                    assert!(svg.contains(&label), "{label}");
                }
            }
        }
    }
}

#[test]
fn intervals_and_correlations_match_textbook_values() {
    // Wilson's interval of 8 of 10, as tabulated.
    let interval = wilson(8, 10).map(|share| (1e4 * share).round());
    assert_eq!(interval, [4902.0, 9433.0]);
    // Spearman's example with d² summing to 194 over 10 pairs: 1 − 6·194/990.
    let iq = [
        106.0, 100.0, 86.0, 101.0, 99.0, 103.0, 97.0, 113.0, 112.0, 110.0,
    ];
    let hours = [7.0, 27.0, 2.0, 50.0, 28.0, 29.0, 20.0, 12.0, 6.0, 17.0];
    let correlation = |a: &[f64], b: &[f64]| rank_correlation(a, b).unwrap();
    assert!((correlation(&iq, &hours) + 29.0 / 165.0).abs() < 1e-12);
    // Equal values share a rank.
    assert!((correlation(&[1.0, 1.0, 2.0, 3.0], &[1.0, 1.0, 2.0, 3.0]) - 1.0).abs() < 1e-12);
    assert_eq!(rank_correlation(&[1.0, 2.0], &[3.0, 3.0]), None);
}

/// Report of 5 trials. With the sensor e rises with the drawn value, and |heading| has the ranks 1 2 4 3 5 (Σd² = 2,
/// ρ = 1 − 12/120). Without the sensor e has the ranks 2 5 3 1 4 (Σd² = 20, ρ = 0), and |heading| is constant.
fn one_armed(text: &str) -> CampaignReport {
    let study = Study::parse(&text.replace("trials = 4", "trials = 5"), "test").unwrap();
    let mut rows = all_runs(&study);
    let drawn = study.vary.iter().position(|vary| vary.uniform.is_some());
    for arm in rows.chunk_by_mut(|a, b| a.cell == b.cell) {
        arm.sort_by_key(|row| (1e9 * number(&row.values[drawn.unwrap()]).unwrap()) as u64);
        let sensor = arm[0].values.contains(&true.into());
        let (e, heading) = match sensor {
            true => ([0.1, 0.2, 0.3, 0.4, 0.5], [-1.0, 2.0, -4.0, 3.0, 5.0]),
            false => ([2.0, 5.0, 3.0, 1.0, 4.0], [-1.0, 1.0, -1.0, 1.0, 1.0]),
        };
        for (n, row) in arm.iter_mut().enumerate() {
            (row.e_m, row.heading_rad) = (e[n], heading[n]);
        }
        arm.sort_by_key(|row| row.trial);
    }
    CampaignReport::of(&study, &rows)
}

#[test]
fn drawn_quantity_with_effect_in_one_arm_correlates_there_only() {
    let mut blocks: Vec<&str> = TEXT.split("\n\n").collect();
    let report = one_armed(TEXT);
    // In the other study the drawn quantity is first, and the lists and their values are in reverse order.
    blocks[1..4].reverse();
    let text = blocks
        .join("\n\n")
        .replace("[true, false]", "[false, true]");
    let other = one_armed(&text.replace("[0.003, 0.01]", "[0.01, 0.003]"));
    for creep in ["0.003", "0.01"] {
        for (rps, e, heading, note) in [
            ("true", 1.0, Some(0.9), None),
            (
                "false",
                0.0,
                None,
                Some("the error is the same in all runs"),
            ),
        ] {
            for report in [&report, &other] {
                assert_eq!(report.influences.len(), 4);
                let mut found = report.influences.iter();
                let has = |(_, value): &(String, String)| value == creep || value == rps;
                let of = found.find(|of| of.values.iter().all(has)).unwrap();
                let rounded = |value: f64| (1e12 * value).round() / 1e12;
                assert_eq!(of.rank_correlation_e.map(rounded), Some(e), "{of:?}");
                assert_eq!(of.rank_correlation_heading.map(rounded), heading);
                assert_eq!((of.trials, of.significance), (5, Some(1.96 / 2.0)));
                assert_eq!(of.note.as_deref(), note);
                assert_eq!(report.cells[of.cell as usize].values, of.values);
            }
        }
    }
}

#[test]
fn drawn_key_without_effect_in_an_arm_has_no_correlation_there() {
    let key = "sensors.bridge.noise_strain";
    let report = one_armed(&TEXT.replace("sensors.geometry.wheel_radius_sigma", key));
    assert!(report.influences[0].rank_correlation_e > Some(0.999));
    let without = serde_json::to_value(&report.influences[1]).unwrap();
    for field in [
        "rank_correlation_e",
        "rank_correlation_heading",
        "significance",
    ] {
        assert!(without[field].is_null(), "{without}");
    }
    let note = format!("{key}: no effect with mission.rps = false");
    assert_eq!(without["note"], note.as_str());
    assert_eq!(report.text().matches(&note).count(), 1, "{}", report.text());
    let one = CampaignReport::of(&study(), &all_runs(&study())[..1]);
    let note = one.influences[0].note.as_deref();
    assert_eq!(note, Some("the error is the same in all runs"));
}

#[test]
fn tables_of_the_report_fit_80_columns_with_whole_figures() {
    let text = one_armed(TEXT).text();
    assert!(
        text.lines().all(|line| line.chars().count() <= 80),
        "{text}"
    );
    // e (cm) of 0.1 to 0.5 m and of 1 to 5 m as mean ± standard deviation, and the rank correlation.
    for figure in ["30.00 ± 15.81", "300.00 ± 158.11", "+0.90"] {
        assert_eq!(text.matches(figure).count(), 2, "{text}");
    }
}

#[test]
fn table_of_the_report_has_a_line_per_end() {
    let study = study();
    let mut rows = all_runs(&study);
    // In the second combination, 3 of 4 trials end as `long`.
    let long = "uncertain, wheels inconsistent";
    rows[5..8]
        .iter_mut()
        .for_each(|row| row.label = long.to_owned());
    let text = CampaignReport::of(&study, &rows).text();
    let (first, second) = (format!("3 {long}"), "1 reached");
    let lines: Vec<&str> = text.lines().collect();
    let line = lines
        .iter()
        .position(|line| line.ends_with(&first))
        .expect(&text);
    assert!(lines[line].starts_with("0.003, false "), "{text}");
    assert_eq!(lines[line + 1].trim(), second, "{text}");
    assert_eq!(lines[line].find(&first), lines[line + 1].find(second));
}

#[test]
fn numbers_in_report_of_80_columns_are_not_wrapped() {
    for keys in 0..=3 {
        let more = [
            "plant.friction",
            "mission.tolerance_m",
            "mission.tolerance_rad",
        ];
        let more = more[..keys]
            .iter()
            .map(|key| format!("[[vary]]\nkey = \"{key}\"\nvalues = [0.25]\n\n"));
        let text = TEXT.replace(
            "[scenario.plant]",
            &(more.collect::<String>() + "[scenario.plant]"),
        );
        let study = Study::parse(&text, "test").unwrap();
        let mut rows = all_runs(&study);
        rows.iter_mut().for_each(|row| row.e_m = 12.345);
        let text = CampaignReport::of(&study, &rows).text();
        for figure in ["1234.50 ± 0.00", "1234.50  ", "100 % (51 to 100)"] {
            assert!(text.matches(figure).count() >= 4, "{figure}: {text}");
        }
        // If a line break divided a number, a word would begin or end with the decimal point.
        let words = text.split_whitespace();
        let ends = words.filter(|word| word.starts_with('.') || word.ends_with('.'));
        let number = |word: &&str| word.contains(|c: char| c.is_ascii_digit());
        assert_eq!(ends.filter(number).collect::<Vec<_>>(), [""; 0], "{text}");
    }
}

#[test]
fn finished_part_names_the_missing_blocks_or_the_merge() {
    let folder = tempfile::tempdir().unwrap();
    let directory = Directory::open_for(study(), folder.path()).unwrap();
    let merge = format!("cfmmr campaign merge {}", folder.path().display());
    for block in [0, 3] {
        directory.write(block, finished(&study(), block)).unwrap();
    }
    let text = next_step(&directory, folder.path());
    assert!(text.contains("missing: 4 of 6 blocks (1-2, 4-5)"), "{text}");
    assert!(
        text.ends_with(&format!("after these parts: {merge}\n")),
        "{text}"
    );
    for block in [1, 2, 4, 5] {
        directory.write(block, finished(&study(), block)).unwrap();
    }
    let text = next_step(&directory, folder.path());
    assert_eq!(text, format!("all blocks are complete; next: {merge}\n"));
}

#[test]
fn merge_without_all_blocks_fails_and_names_them() {
    let folder = tempfile::tempdir().unwrap();
    let directory = Directory::open_for(study(), folder.path()).unwrap();
    for block in [0, 2, 4] {
        directory.write(block, finished(&study(), block)).unwrap();
    }
    let out = folder.path().join("merged");
    let error = merge(&directory, folder.path(), &out, false).err().unwrap();
    assert_eq!(error.exit_code(), 1);
    let text = error.to_string();
    assert!(
        text.contains("9 of 16 runs are complete; missing blocks: 1, 3, 5"),
        "{text}"
    );
    assert!(!out.exists());
}

#[test]
fn ranges_of_numbers_are_short() {
    for (numbers, text) in [
        (vec![], ""),
        (vec![4], "4"),
        (vec![0, 1], "0-1"),
        (vec![0, 1, 2, 7, 9, 10], "0-2, 7, 9-10"),
        ((0..18).step_by(2).collect(), "0, 2, 4, 6, 8, 10, 12, 14, …"),
        ((0..16).step_by(2).collect(), "0, 2, 4, 6, 8, 10, 12, 14"),
    ] {
        assert_eq!(ranges(&numbers), text);
    }
}

#[test]
fn varied_key_of_another_tyre_is_refused() {
    let text = TEXT.replace(
        "key = \"mission.rps\"\nvalues = [true, false]",
        "key = \"plant.tyre.brush.rest_velocity_m_s\"\nvalues = [1e-4]",
    );
    let error = Study::parse(&text, "test").unwrap_err();
    let words = "plant.tyre has brush and creep: must have one of them";
    assert!(error.to_string().contains(words), "{error}");
}
