//! Draws a [`View`]: equal views give equal characters.
//!
//! The picture of two axles needs 60 columns and 20 lines; each further axle needs three lines more. A smaller terminal
//! shows a note instead.

use super::map;
use super::view::View;
use core_algos::safety::{Condition, Conditions, OperatingState};
use host_sim::base::statistics::NIS_EXPECTED;
use host_sim::run::final_error::FinalError;
use host_sim::run::keyboard::Hand;
use host_sim::run::recovery::Status;
use host_sim::targets::BoardTraffic;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span, Text};
use ratatui::widgets::{Block, Borders, Paragraph};

/// Smallest terminal for a robot of two axles: columns, lines.
const MIN_SIZE: (u16, u16) = (60, 20);
/// Width of the left column in the smallest terminal.
const LEFT_WIDTH: u16 = 34;
/// Smallest terminal with a map, for a robot of two axles.
const MIN_SIZE_WITH_MAP: (u16, u16) = (80, 24);
/// Lines of a section of a robot of two axles.
const SECTION: u16 = 6;
/// Lines that a further axle adds to nodes and to links: its board and that of its frame.
const BOARDS_PER_AXLE: u16 = 2;
/// Lines that a further axle adds to the motion: the speeds of its wheels.
const WHEELS_PER_AXLE: u16 = 1;
/// Age of the latest heartbeat above which a node is shown as silent, s.
const SILENT_S: f64 = 0.5;

const ALERT: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
const CAUTION: Style = Style::new().fg(Color::Yellow);
const GOOD: Style = Style::new().fg(Color::Green);
const DIM: Style = Style::new().add_modifier(Modifier::DIM);

/// Number of axles beyond two.
fn further(view: &View) -> u16 {
    u16::try_from(view.axles.len())
        .unwrap_or(u16::MAX)
        .saturating_sub(2)
}

/// Draws the view over the whole terminal.
pub fn draw(frame: &mut Frame, view: &View) {
    let area = frame.area();
    let added = (BOARDS_PER_AXLE + WHEELS_PER_AXLE) * further(view);
    let needed = MIN_SIZE.1 + added;
    if area.width < MIN_SIZE.0 || area.height < needed {
        let text = format!(
            "The dashboard needs {} x {needed} characters; this terminal has {} x {}. q: end the run",
            MIN_SIZE.0, area.width, area.height
        );
        let lines = wrapped(&text, area.width.into())
            .into_iter()
            .map(Line::from);
        frame.render_widget(Paragraph::new(Text::from_iter(lines)), area);
        return;
    }
    let faults = fault_lines(view, area.width.into(), usize::MAX).len() + 1;
    let faults = u16::try_from(faults).unwrap_or(u16::MAX).max(4);
    // Faults have precedence over the map.
    match area.width >= MIN_SIZE_WITH_MAP.0
        && area.height >= faults.saturating_add(MIN_SIZE_WITH_MAP.1 - 4 + added)
    {
        true => draw_with_map(frame, view, faults),
        false => draw_without_map(frame, view),
    }
}

fn draw_without_map(frame: &mut Frame, view: &View) {
    let [head, upper, middle, faults, foot] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(SECTION + BOARDS_PER_AXLE * further(view)),
        Constraint::Length(SECTION + WHEELS_PER_AXLE * further(view)),
        Constraint::Fill(1),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    let columns = [
        Constraint::Length(LEFT_WIDTH.max(frame.area().width / 2)),
        Constraint::Length(1),
        Constraint::Fill(1),
    ];
    let [nodes, _, links] = Layout::horizontal(columns).areas(upper);
    let [estimate, _, motion] = Layout::horizontal(columns).areas(middle);
    draw_rest(
        frame,
        view,
        [head, nodes, links, estimate, motion, faults, foot],
    );
}

fn draw_with_map(frame: &mut Frame, view: &View, lines: u16) {
    let [head, body, faults, foot] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(lines),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    let [left, _, right] = Layout::horizontal([
        Constraint::Length(LEFT_WIDTH + 6),
        Constraint::Length(1),
        Constraint::Fill(1),
    ])
    .areas(body);
    let boards = Constraint::Length(SECTION + BOARDS_PER_AXLE * further(view));
    let heights = [boards, Constraint::Length(SECTION), Constraint::Fill(1)];
    let [nodes, estimate, motion] = Layout::vertical(heights).areas(left);
    let heights = [
        boards,
        Constraint::Fill(1),
        Constraint::Length(1 + further(view)),
    ];
    let [links, map, gauges] = Layout::vertical(heights).areas(right);
    map::draw(frame, map, view);
    let strains: Vec<Line> = strains(view, gauges.width).map(Line::raw).collect();
    frame.render_widget(Paragraph::new(strains), gauges);
    draw_rest(
        frame,
        view,
        [head, nodes, links, estimate, motion, faults, foot],
    );
}

/// Draws everything except the map into the given areas.
fn draw_rest(
    frame: &mut Frame,
    view: &View,
    [head, nodes, links, estimate, motion, faults, foot]: [Rect; 7],
) {
    frame.render_widget(header(view, head.width), head);
    section(frame, nodes, "Nodes", node_lines(view));
    section(frame, links, "Links", link_lines(view));
    let nis = view.record.lead.fused.beam.nis;
    let title = match nis > 0.0 {
        true => format!("Estimate, NIS {nis:.2} (expected {NIS_EXPECTED})"),
        false => "Estimate".to_owned(),
    };
    section(frame, estimate, &title, estimate_lines(view));
    section(frame, motion, "Motion", motion_lines(view));
    let room = faults.height.saturating_sub(1).into();
    let lines = fault_lines(view, faults.width.into(), room);
    section(frame, faults, "Faults", lines);
    frame.render_widget(footer(view), foot);
}

fn section(frame: &mut Frame, area: Rect, title: &str, lines: Vec<Line<'static>>) {
    let block = Block::new()
        .borders(Borders::TOP)
        .title(format!(" {title} "));
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

/// Title and progress of the run.
fn header(view: &View, width: u16) -> Line<'static> {
    let end = format!(" {:?}  {:.2} s ", view.record.lead.mode, view.time_s);
    let room = usize::from(width).saturating_sub(end.chars().count());
    let title: String = format!(" {}", view.title).chars().take(room).collect();
    Line::styled(
        format!("{title:<room$}{end}"),
        Style::new().add_modifier(Modifier::REVERSED),
    )
}

fn footer(view: &View) -> Line<'static> {
    let late = match view.late_ticks {
        0 => Span::raw(""),
        late => {
            let most = 1e3 * view.most_late_s;
            Span::styled(
                format!("   {late} late ticks, at most {most:.0} ms"),
                CAUTION,
            )
        }
    };
    if let Some(end) = &view.end {
        return Line::styled(
            format!(" {end}; q: quit"),
            Style::new().add_modifier(Modifier::BOLD),
        );
    }
    let mut text = " q: end the run".to_owned();
    match view.pace {
        Some((true, _)) => text += "  PAUSED: p, step: .",
        Some((false, rate)) if rate != 1.0 => text += &format!("  p: pause  +/-: speed {rate}"),
        Some(_) => text += "  p: pause  +/-: speed",
        None => {}
    }
    if let Some(hand) = view.hand {
        let Hand {
            speed_m_s,
            curvature,
            ..
        } = hand;
        return Line::raw(format!(
            " {speed_m_s:.2} m/s {curvature:+.2} 1/m  arrows, WASD: drive  space: stop  c: clear  q: end"
        ));
    }
    Line::from(vec![Span::raw(text), late])
}

fn node_lines(view: &View) -> Vec<Line<'static>> {
    let heading = format!("{:<10}{:<9}{:>7}  {}", "", "state", "age ms", "code");
    let mut lines = vec![Line::styled(heading, DIM)];
    for node in &view.nodes {
        let name = Span::raw(format!("{:<10}", node.name));
        let Some(status) = node.latest else {
            lines.push(Line::from(vec![name, Span::styled("no heartbeat", DIM)]));
            continue;
        };
        let age = view.time_s - status.time_s;
        let (state, style) = match age > SILENT_S {
            true => ("silent", ALERT),
            false => (status.state.name(), style_of(status.state)),
        };
        let code = status
            .reason
            .map(|reason| format!("{:#04x}", reason.code()));
        lines.push(Line::from(vec![
            name,
            Span::styled(format!("{state:<9}"), style),
            Span::raw(format!("{:>7.0}  ", (1e3 * age).max(0.0))),
            Span::styled(code.unwrap_or_default(), style),
        ]));
    }
    lines
}

fn style_of(state: OperatingState) -> Style {
    match state {
        OperatingState::Active => GOOD,
        OperatingState::SafeStop | OperatingState::Fault => ALERT,
        OperatingState::Boot | OperatingState::Idle | OperatingState::Armed => CAUTION,
    }
}

fn link_lines(view: &View) -> Vec<Line<'static>> {
    let heading = format!("{:<6}{:>8}{:>5}{:>6}", "board", "frames", "lost", "CRC");
    let mut lines = vec![Line::styled(heading, DIM)];
    let bad = |count: u64| if count == 0 { Style::new() } else { CAUTION };
    for BoardTraffic { name, on, traffic } in &view.boards {
        let name = Span::raw(format!("{name:<6}"));
        lines.push(match (on, traffic) {
            (false, _) => Line::from(vec![name, Span::styled("      off", DIM)]),
            (true, None) => Line::from(vec![name, Span::styled("  without a port", DIM)]),
            (true, Some(traffic)) => Line::from(vec![
                name,
                Span::raw(format!("{:>8}", traffic.frames)),
                Span::styled(format!("{:>5}", traffic.lost), bad(traffic.lost)),
                Span::styled(format!("{:>6}", traffic.damaged), bad(traffic.damaged)),
            ]),
        });
    }
    lines.push(Line::from(vec![
        Span::raw(format!("{:<6}{:>8}", "bus", view.bus.sent)),
        Span::styled(format!("{:>5}", view.bus.lost), bad(view.bus.lost)),
    ]));
    lines
}

fn estimate_lines(view: &View) -> Vec<Line<'static>> {
    let estimate = &view.record.lead.fused.robot;
    let posture = estimate.posture;
    let estimated = [posture.x, posture.y, posture.phi].map(f64::from);
    let off = [estimated[0] - view.truth[0], estimated[1] - view.truth[1]];
    let turned = FinalError::of(estimated, view.truth).heading_rad;
    let sigma: [f64; 3] = std::array::from_fn(|i| f64::from(estimate.covariance[i][i]).sqrt());
    let heading = format!("{:<11}{:>7}{:>7}{:>8}", "", "x", "y", "φ °");
    let metres = |name: &str, [x, y, phi]: [f64; 3]| {
        let phi = phi.to_degrees();
        Line::raw(format!("{name:<11}{x:>7.3}{y:>7.3}{phi:>8.2}"))
    };
    let millimetres = |name: &str, x: f64, y: f64, phi: f64| {
        let (x, y, phi) = (1e3 * x, 1e3 * y, phi.to_degrees());
        Line::raw(format!("{name:<11}{x:>7.1}{y:>7.1}{phi:>8.2}"))
    };
    let mut lines = vec![Line::styled(heading, DIM), metres("estimate m", estimated)];
    if !turned.is_nan() {
        lines.push(metres("truth m", view.truth));
        lines.push(millimetres("error mm", off[0], off[1], turned));
    }
    lines.push(millimetres("sigma mm", sigma[0], sigma[1], sigma[2]));
    lines
}

fn motion_lines(view: &View) -> Vec<Line<'static>> {
    let left = FinalError::of(view.record.midpoint, view.goal);
    let motion = &view.record.lead.motion;
    // The longest name of two axles is `front`, of more axles `axle-2`; the lines have equal lengths.
    let (name_width, left_width) = match further(view) {
        0 => (5, 7),
        _ => (6, 6),
    };
    let wheels = |name: &str, [left, right]: [f64; 2]| {
        Line::raw(format!(
            "{name:<name_width$}{left:>left_width$.2}{right:>7.2} rad/s"
        ))
    };
    let mut lines = vec![
        Line::raw(format!("speed {:>7.3} m/s", motion.v)),
        Line::raw(format!("steer {:>7.3} rad", motion.psi.0)),
    ];
    if !left.e_m.is_nan() {
        let turn = left.heading_rad.to_degrees();
        lines.insert(
            0,
            Line::raw(format!("to go {:>7.3} m {turn:>6.1}°", left.e_m)),
        );
    }
    let axles = view.axles.iter().zip(&view.record.axles);
    let known = axles.filter(|(_, axle)| !axle.wheel_speed[0].is_nan());
    lines.extend(known.map(|(name, axle)| wheels(name, axle.wheel_speed)));
    lines
}

/// Strains of each frame's gauges, as many as the width allows; a frame without readings gives an empty line.
fn strains(view: &View, width: u16) -> impl Iterator<Item = String> {
    let most = (usize::from(width).saturating_sub(9)) / 6;
    let frames = view.frames.iter().zip(&view.record.frames);
    frames.map(move |(name, frame)| {
        let strains = frame.strain.iter();
        let known = strains.filter(|strain| strain.is_finite() && **strain != 0.0);
        let shown: String = known
            .take(most)
            .map(|strain| format!("{:>6.0}", 1e6 * strain))
            .collect();
        let name = match view.frames.len() {
            1 => "strain",
            _ => *name,
        };
        match shown.is_empty() {
            true => shown,
            false => format!("{name} µε{shown}"),
        }
    })
}

/// Faults of the run with remedies, oldest first, then degradations and notices; limited to `height` lines.
fn fault_lines(view: &View, width: usize, height: usize) -> Vec<Line<'static>> {
    let idle = view.idle_stop.iter().map(|text| (text.clone(), CAUTION));
    let faults = view.faults.iter().map(|f| fault(view, f));
    let mut texts: Vec<(String, Style)> = faults.chain(idle).collect();
    texts.extend(notices(view));
    if texts.is_empty() {
        return vec![Line::styled("none", GOOD)];
    }
    let mut lines = Vec::new();
    let count = texts.len();
    for (i, (text, style)) in texts.into_iter().enumerate() {
        let parts = wrapped(&text, width);
        // One line is reserved for "and N more", unless this is the last text.
        let kept = usize::from(i + 1 < count);
        if lines.len() + parts.len() + kept > height {
            lines.push(Line::raw(format!("and {} more", count - i)));
            break;
        }
        lines.extend(parts.into_iter().map(|part| Line::styled(part, style)));
    }
    lines
}

fn fault(view: &View, status: &Status) -> (String, Style) {
    let Some(entry) = status.reason.map(Condition::entry) else {
        return (status.to_string(), ALERT);
    };
    let latest = view.nodes.iter().filter_map(|node| node.latest);
    let lasts = latest
        .filter(|latest| latest.node == status.node)
        .any(|latest| latest.reason == status.reason);
    let (note, style) = match lasts {
        true => ("", ALERT),
        false => (", cleared", DIM),
    };
    let text = format!(
        "{:#04x} {} ({}, {:.3} s{note}): {}",
        entry.code, entry.name, status.name, status.time_s, entry.remedy
    );
    (text, style)
}

fn notices(view: &View) -> Vec<(String, Style)> {
    let all = view.nodes.iter().map(|node| node.noticed);
    let mut conditions: Vec<_> = all
        .fold(Conditions::NONE, Conditions::union)
        .iter()
        // Stops and cuts are left out here, because `fault_lines` lists them as faults.
        .filter(|condition| !condition.class().is_hard())
        .collect();
    conditions.sort_by_key(|condition| std::cmp::Reverse(condition.class()));
    let text = |condition: Condition| {
        let nodes = view.nodes.iter();
        let nodes: Vec<_> = nodes
            .filter(|node| node.noticed.contains(condition))
            .map(|node| node.name)
            .collect();
        let entry = condition.entry();
        let (code, name, nodes) = (entry.code, entry.name, nodes.join(", "));
        (
            format!("{code:#04x} {name} ({nodes}): {}", entry.remedy),
            CAUTION,
        )
    };
    conditions.into_iter().map(text).collect()
}

/// Breaks a text between words into lines of at most `width` characters; a longer word has a line of its own.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::super::view::NodeView;
    use super::*;
    use core_algos::bus::LeadMode;
    use core_algos::math::Posture;
    use core_algos::topology::{AxleId, MAX_AXLES, Node, Role, Topology};
    use host_sim::run::recovery::Monitor;
    use host_sim::run::robot::{AxleRecord, FrameRecord};
    use host_sim::targets::Traffic;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    /// Lines of the picture.
    fn picture(view: &View, (width, height): (u16, u16)) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, view)).unwrap();
        let buffer = terminal.backend().buffer().clone();
        let line = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect();
        (0..height).map(line).collect()
    }

    /// Words of the lines, separated by single spaces.
    fn words(lines: &[String]) -> String {
        let text = lines.join(" ");
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    fn status(node: Node, state: OperatingState, reason: Option<Condition>) -> Status {
        let (time_s, notices) = (12.3, Conditions::NONE);
        Status {
            time_s,
            node,
            name: Topology::PAIR.node_name(node),
            state,
            reason,
            notices,
        }
    }

    fn view() -> View {
        let mut view = View {
            title: "posture: RPS, joint filter, seed 1".to_owned(),
            time_s: 12.34,
            late_ticks: 7,
            most_late_s: 0.012,
            truth: [-1.0, 0.5, 0.1],
            goal: [0.0, 0.5, 0.0],
            axles: vec!["front", "rear"],
            frames: vec!["beam"],
            boards: Role::PAIR
                .map(|role| BoardTraffic {
                    name: Topology::PAIR.name(role),
                    on: role != Role::beam(0),
                    traffic: (role == Role::LEAD).then_some(Traffic {
                        frames: 123_456,
                        lost: 12,
                        damaged: 345,
                    }),
                })
                .to_vec(),
            ..View::default()
        };
        view.record.midpoint = view.truth;
        view.record.axles = [[1.25, -2.5], [3.75, 4.5]]
            .map(|wheel_speed| AxleRecord {
                wheel_speed,
                ..AxleRecord::default()
            })
            .to_vec();
        view.bus.sent = 98_765;
        view.bus.lost = 43;
        let node = |node| NodeView {
            name: Topology::PAIR.node_name(node),
            latest: match node {
                Node::Lead => Some(status(node, OperatingState::Active, None)),
                Node::Axle(AxleId(0)) => Some(status(node, OperatingState::Armed, None)),
                Node::Axle(_) => Some(status(node, OperatingState::Idle, None)),
                _ => None,
            },
            noticed: Conditions::NONE,
        };
        view.nodes = Topology::PAIR.nodes().map(node).collect();
        // Every node reports a lost neighbour until the other nodes have started.
        view.nodes[1].noticed.set(Condition::NeighbourLost, true);
        view.record.lead.mode = LeadMode::Hold;
        view.record.lead.motion.v = 0.2;
        view.record.lead.motion.psi.0 = -0.3;
        view.record.lead.fused.beam.nis = 2.25;
        let robot = &mut view.record.lead.fused.robot;
        robot.posture = Posture::new(-1.002, 0.503, 0.1);
        robot.covariance[0][0] = 4e-6;
        robot.covariance[1][1] = 9e-6;
        view
    }

    fn stopped() -> View {
        let mut view = view();
        let fault = |node, reason| status(node, OperatingState::Fault, Some(reason));
        view.faults = vec![
            fault(Node::axle(1), Condition::SupplyLow),
            fault(Node::Lead, Condition::NeighbourFault),
        ];
        view.nodes[2].latest = Some(view.faults[0]);
        view.nodes[3].noticed.set(Condition::ConversionsLost, true);
        view.nodes[0].noticed.set(Condition::BeamLost, true);
        view
    }

    const SIZES: [(u16, u16); 3] = [(80, 24), (60, 20), (132, 50)];

    #[test]
    fn every_value_is_shown_in_full_at_any_size() {
        for size in SIZES {
            let lines = picture(&view(), size);
            let text = words(&lines);
            for part in [
                "posture: RPS, joint filter, seed 1",
                "Hold 12.34 s",
                "Lead Active 40",
                "FrontAxle Armed 40",
                "RearAxle Idle 40",
                "Beam no heartbeat",
                "front 123456 12 345",
                "rear without a port",
                "beam off",
                "bus 98765 43",
                "NIS 2.25",
                "estimate m -1.002 0.503 5.73",
                "truth m -1.000 0.500 5.73",
                "error mm -2.0 3.0 0.00",
                "sigma mm 2.0 3.0 0.00",
                "to go 1.000 m 5.7°",
                "speed 0.200 m/s",
                "steer -0.300 rad",
                "front 1.25 -2.50 rad/s",
                "rear 3.75 4.50 rad/s",
                "none",
                "q: end the run",
                "7 late ticks, at most 12 ms",
            ] {
                let there = lines
                    .iter()
                    .any(|line| words(std::slice::from_ref(line)).contains(part));
                assert!(
                    there,
                    "{size:?}: no {part:?} in\n{}\n{text}",
                    lines.join("\n")
                );
            }
        }
    }

    /// A view of the largest robot, before its first heartbeat.
    fn chain() -> View {
        let robot = Topology::new(MAX_AXLES).unwrap();
        let mut view = View {
            boards: robot
                .boards()
                .map(|role| BoardTraffic {
                    name: robot.name(role),
                    on: true,
                    traffic: None,
                })
                .collect(),
            ..View::before(&Monitor::new(robot))
        };
        view.record.axles = (0..5)
            .map(|k| AxleRecord {
                posture: [-0.4 * f64::from(k), 0.0, 0.0],
                wheel_speed: [f64::from(k) + 0.25, f64::from(k) + 0.75],
                ..AxleRecord::default()
            })
            .collect();
        view.record.frames = (0..4)
            .map(|k| FrameRecord {
                strain: [1e-6 * (k as f32 + 10.0); 8],
                ..FrameRecord::default()
            })
            .collect();
        view
    }

    #[test]
    fn every_board_axle_and_frame_of_five_axles_is_shown() {
        for (width, height) in [(60, 29), (80, 33), (132, 50)] {
            let lines = picture(&chain(), (width, height));
            let all = lines.join("\n");
            for part in [
                "Lead no heartbeat",
                "FrontAxle no heartbeat",
                "Axle4 no heartbeat",
                "Beam4 no heartbeat",
                "axle-3 without a port",
                "beam-4 without a port",
                "bus 0 0",
                "front 0.25 0.75 rad/s",
                "axle-4 3.25 3.75 rad/s",
                "rear 4.25 4.75 rad/s",
                "none",
                "q: end the run",
            ] {
                let there = lines
                    .iter()
                    .any(|line| words(std::slice::from_ref(line)).contains(part));
                assert!(there, "{width}: no {part:?} in\n{all}");
            }
            for (frame, strain) in [("beam-1", "10"), ("beam-4", "13")] {
                let there = words(&lines).contains(&format!("{frame} µε {strain}"));
                assert_eq!(there, width >= 80, "{all}");
            }
        }
        let text = words(&picture(&chain(), (60, 28)));
        assert!(
            text.contains("60 x 29") && text.contains("60 x 28"),
            "{text}"
        );
    }

    #[test]
    fn idle_driver_is_shown_as_reason_of_the_stop() {
        let mut view = view();
        view.nodes[1].noticed = Conditions::NONE;
        view.idle_stop = Some("no key for 5 s, so the robot stopped".to_owned());
        let text = words(&picture(&view, (80, 24)));
        assert!(text.contains("no key for 5 s, so the robot stopped") && !text.contains("none"));
    }

    #[test]
    fn faults_have_code_name_node_and_remedy() {
        for size in SIZES {
            let lines = picture(&stopped(), size);
            let text = words(&lines);
            let low = "0x8a supply low (RearAxle, 12.300 s): charge the battery; check the cable";
            assert!(text.contains(low), "{size:?}: {}", lines.join("\n"));
            assert!(text.contains("RearAxle Fault 40 0x8a"), "{text}");
            assert!(!text.contains("none"));
            // The lead node reported this condition and later left the fault state, hence "cleared".
            let expected =
                "0x83 neighbour stopped (Lead, 12.300 s, cleared): read the code of that node";
            assert!(text.contains(expected), "{size:?}: {}", lines.join("\n"));
        }
        let text = words(&picture(&stopped(), (80, 24)));
        let degraded = text
            .find("0x40 relative position sensor lost (Lead)")
            .unwrap();
        let notice = text.find("0x0c conversions lost (Beam)").unwrap();
        assert!(degraded < notice);
    }

    #[test]
    fn faults_without_room_are_counted_and_never_cut() {
        let mut view = stopped();
        for node in &mut view.nodes {
            node.noticed = Conditions::NONE;
        }
        for condition in Condition::ALL.into_iter().take(12) {
            view.nodes[1].noticed.set(condition, true);
        }
        let lines = picture(&view, (60, 20));
        let last = &lines[18];
        assert!(last.contains("more"), "{}", lines.join("\n"));
        let left: usize = last.split_whitespace().nth(1).unwrap().parse().unwrap();
        let shown = lines.iter().filter(|line| line.starts_with("0x")).count();
        assert_eq!(left + shown, 2 + 12);
        for line in lines.iter().filter(|line| line.starts_with("0x")) {
            assert!(line.contains('('), "{line}");
        }
    }

    #[test]
    fn node_without_heartbeats_is_shown_as_silent() {
        let mut view = view();
        view.time_s += 1.0;
        let text = words(&picture(&view, (80, 24)));
        assert!(text.contains("Lead silent 1040"), "{text}");
        assert!(!text.contains("Active"), "{text}");
    }

    #[test]
    fn small_terminal_shows_the_needed_size_and_any_size_is_drawn() {
        let text = words(&picture(&view(), (40, 10)));
        assert!(text.contains("60 x 20") && text.contains("40 x 10") && text.contains("q: end"));
        let mut broken = view();
        broken.truth = [f64::NAN; 3];
        broken.time_s = f64::INFINITY;
        for size in [(1, 1), (0, 0), (59, 100), (200, 19), (60, 20), (300, 100)] {
            picture(&broken, size);
        }
    }
}
