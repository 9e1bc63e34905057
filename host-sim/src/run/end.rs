//! End of a run or of a step: one type for every command, table, file and page.
//!
//! [`RunEnd::of`] derives the end from the robot and from the cause that ended the run loop. All texts of ends are
//! here.

use crate::run::recovery::SENSORS;
use crate::run::robot::Robot;
use core_algos::node::lead;
use core_algos::safety::{Condition, Conditions, OperatingState};
use core_algos::topology::Node;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

/// Kind of an end.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum EndKind {
    /// At rest at the goal or the end of the path; distance and 95 % error are within the tolerance.
    Reached,
    /// At rest at the goal or the end of the path, but the 95 % error exceeds the tolerance, or a sensor is
    /// inconsistent.
    Uncertain,
    /// A step without a goal was carried out.
    Done,
    /// The robot stopped with a fault.
    Stopped,
    /// The robot is at rest away from its goal after the last attempt.
    #[serde(rename = "gave up")]
    GaveUp,
    /// The robot made no progress on its task.
    #[serde(rename = "no progress")]
    NoProgress,
    /// The time limit of the run passed.
    #[default]
    #[serde(rename = "time limit")]
    TimeLimit,
    /// The robot does not answer.
    #[serde(rename = "no answer")]
    NoAnswer,
    /// The user ended the run.
    Interrupted,
}

impl EndKind {
    /// All kinds, in the order of declaration.
    pub const ALL: [Self; 9] = [
        Self::Reached,
        Self::Uncertain,
        Self::Done,
        Self::Stopped,
        Self::GaveUp,
        Self::NoProgress,
        Self::TimeLimit,
        Self::NoAnswer,
        Self::Interrupted,
    ];

    /// Name of the kind in tables and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reached => "reached",
            Self::Uncertain => "uncertain",
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::GaveUp => "gave up",
            Self::NoProgress => "no progress",
            Self::TimeLimit => "time limit",
            Self::NoAnswer => "no answer",
            Self::Interrupted => "interrupted",
        }
    }

    /// Meaning of the kind in one line, for a legend.
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::Reached => "at rest at the goal, with its 95 % error within the tolerance",
            Self::Uncertain => "at rest at the goal, but its 95 % error exceeds the tolerance",
            Self::Done => "step done",
            Self::Stopped => "stopped by a fault",
            Self::GaveUp => "at rest away from the goal after its last attempt",
            Self::NoProgress => "commanded to move, did not move",
            Self::TimeLimit => "time limit of the run reached",
            Self::NoAnswer => "the robot does not answer",
            Self::Interrupted => "ended by the user",
        }
    }

    /// True if the task was carried out.
    pub const fn is_success(self) -> bool {
        matches!(self, Self::Reached | Self::Uncertain | Self::Done)
    }
}

/// Event that ended the run loop.
#[derive(Clone, Debug, PartialEq)]
pub enum Cause {
    /// The lead node reported a task with a goal as done.
    AtGoal,
    /// A task without a goal was carried out.
    Done,
    /// The lead node failed, the robot cannot go on, or the time limit has passed.
    Unfinished,
    /// The user ended the run; holds the command-line option that limited the run, if any.
    Interrupted(Option<&'static str>),
    /// The robot does not answer, with the reason.
    NoAnswer(String),
}

/// How and why a run or a step ended, with the final estimate.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunEnd {
    /// Kind of the end.
    pub kind: EndKind,
    /// Condition that ended the run, or that qualifies a reached goal.
    pub condition: Option<Condition>,
    /// Details of the cause of the end, if any.
    pub reason: Option<String>,
    /// Notices and degradations of all nodes since the beginning of the task.
    pub notices: Conditions,
    /// Estimated posture of O: m, m, rad; `None` if the robot has no estimate.
    pub estimate: Option<[f64; 3]>,
    /// 95 % error of the estimate: half axis of the position (m), half the interval of the heading (rad).
    pub error_95: Option<[f64; 2]>,
    /// True posture of O: m, m, rad; `None` if unknown.
    pub truth: Option<[f64; 3]>,
    /// Time from the task to its end, s.
    pub duration_s: f64,
}

/// Outcome that contains a [`RunEnd`].
pub trait Ended {
    /// End of the run or step.
    fn end(&self) -> RunEnd;
}

impl RunEnd {
    /// End of a robot's task, caused by `cause`, `duration_s` seconds after the start of the task.
    pub fn of(robot: &impl Robot, cause: Cause, duration_s: f64) -> Self {
        let record = robot.record();
        let (lead, monitor) = (&record.lead, robot.monitor());
        let notices = monitor.notices();
        let (kind, condition, reason) = match cause {
            Cause::Done => (EndKind::Done, silence(notices), None),
            Cause::AtGoal => match uncertain(robot) {
                Some(condition) => (EndKind::Uncertain, Some(condition), None),
                None => (EndKind::Reached, silence(notices), None),
            },
            Cause::NoAnswer(reason) => (EndKind::NoAnswer, None, Some(reason)),
            Cause::Interrupted(option) => {
                let reason = option.map(|option| format!("by {option}"));
                (EndKind::Interrupted, None, reason)
            }
            Cause::Unfinished => unfinished(robot, lead),
        };
        let known = lead.fused.robot.covariance[0][0] > 0.0;
        let at = lead.fused.robot.posture;
        Self {
            kind,
            condition,
            reason,
            notices,
            estimate: known.then(|| [at.x, at.y, at.phi].map(f64::from)),
            error_95: known.then(|| lead.fused.robot.half_axes_95().map(f64::from)),
            truth: (!record.midpoint[0].is_nan()).then_some(record.midpoint),
            duration_s,
        }
    }

    /// End of a robot that never answered.
    pub fn no_answer(reason: String) -> Self {
        Self {
            kind: EndKind::NoAnswer,
            reason: Some(reason),
            ..Self::default()
        }
    }

    /// Names and values of the end's JSON fields, as text without quotes.
    pub fn fields(&self) -> Vec<(String, String)> {
        let fields = serde_json::to_value(self).unwrap_or_default();
        let fields = fields.as_object().into_iter().flatten();
        let text = |value: &Value| match value {
            Value::String(text) => text.clone(),
            Value::Null => String::new(),
            value => value.to_string(),
        };
        fields
            .map(|(name, value)| (name.clone(), text(value)))
            .collect()
    }

    /// True if the task was carried out.
    pub fn is_success(&self) -> bool {
        self.kind.is_success()
    }

    /// Sensors that the robot found inconsistent, and lost gauges. Lost inertial sensors are left out: a robot without
    /// inertial sensors always reports them lost.
    pub fn suspects(&self) -> impl Iterator<Item = Condition> {
        let notices = self.notices;
        let named = move |it: &Condition| *it != Condition::InertialLost && notices.contains(*it);
        SENSORS.into_iter().filter(named)
    }

    /// Code of the condition as in docs/codes.md; `None` without a condition.
    pub fn code(&self) -> Option<String> {
        let code = self.condition.map(Condition::code);
        code.map(|code| format!("{code:#04x}"))
    }

    /// Names of the notices, without their codes.
    pub fn notice_names(&self) -> Vec<&'static str> {
        let names = self.notices.iter().map(|notice| notice.entry().name);
        names.collect()
    }

    /// Kind, cause of a stop, and the sensors at fault: equal for runs that ended alike.
    pub fn label(&self) -> String {
        format!("{}{}", self.kind.name(), self.causes())
    }

    /// Condition of a stop and sensors at fault as text; a comma precedes each name.
    fn causes(&self) -> String {
        let stop = self.condition.filter(|_| self.kind == EndKind::Stopped);
        let causes = stop.into_iter().chain(self.suspects());
        causes.map(|it| format!(", {}", it.entry().name)).collect()
    }

    /// The 95 % error as text; `None` if the error is unknown.
    pub fn error_text(&self) -> Option<String> {
        let [position, heading] = self.error_95?;
        Some(format!(
            "±{:.1} cm, ±{:.1}°",
            100.0 * position,
            heading.to_degrees()
        ))
    }

    /// Text of the end in one line: kind, code, causes, time, 95 % error.
    pub fn text(&self) -> String {
        let code = self
            .code()
            .map_or(String::new(), |code| format!(" ({code})"));
        let error = self.error_text().filter(|_| self.kind != EndKind::Done);
        let error = error.map_or(String::new(), |error| format!(", 95 % error {error}"));
        let user = self.reason.as_ref();
        let user = user.filter(|_| self.kind == EndKind::Interrupted);
        let user = user.map_or(String::new(), |option| format!(" {option}"));
        let (name, causes) = (self.kind.name(), self.causes());
        let time = self.duration_s;
        format!("{name}{user}{code}{causes} after {time:.1} s{error}")
    }

    /// Text of the notices in one line; `None` without notices.
    pub fn notices_text(&self) -> Option<String> {
        let names = self.notice_names();
        (!names.is_empty()).then(|| format!("notices: {}", names.join(", ")))
    }

    /// Names and values in the summary of a report page: end, reason and notices.
    pub fn summary(&self) -> Vec<(String, String)> {
        let mut rows = vec![("End".to_owned(), self.text())];
        if let Some(reason) = &self.reason {
            rows.push(("Reason".to_owned(), reason.clone()));
        }
        if !self.notices.is_empty() {
            rows.push(("Notices".to_owned(), self.notice_names().join(", ")));
        }
        rows
    }

    /// Warning about an uncertain end, with the remedy; `None` if the end is not uncertain.
    pub fn warning(&self) -> Option<String> {
        let suspect = self.suspects().next();
        let remedy = suspect.or(self.condition)?.entry().remedy;
        (self.kind == EndKind::Uncertain).then(|| format!("{}; {remedy}", self.text()))
    }

    /// Error message of the run; `None` if the task was carried out or the user ended the run.
    pub fn failure(&self) -> Option<String> {
        if self.is_success() || self.kind == EndKind::Interrupted {
            return None;
        }
        let remedy = self.condition.map(|condition| condition.entry().remedy);
        let cause = self.reason.as_deref().or(remedy);
        let cause = cause.map_or(String::new(), |cause| format!(": {cause}"));
        Some(format!("{}{cause}", self.text()))
    }
}

/// Condition that makes a reached goal uncertain, by the latest heartbeats: the lead node's notice, or a sensor that a
/// node found inconsistent. `None` if there is neither.
fn uncertain(robot: &impl Robot) -> Option<Condition> {
    let notices = |node| robot.monitor().latest(node).map(|latest| latest.notices);
    let lead = notices(Node::Lead).unwrap_or_default();
    if lead.contains(Condition::ReachedUncertain) {
        return Some(Condition::ReachedUncertain);
    }
    let all = robot.monitor().topology.nodes().filter_map(notices);
    let all = all.fold(Conditions::NONE, Conditions::union);
    let lost = [Condition::GaugeLost, Condition::InertialLost];
    let mut sensors = SENSORS.into_iter().filter(|it| !lost.contains(it));
    sensors.find(|&it| all.contains(it))
}

/// Notice that the commanding host timed out; `None` if the robot did not report the notice.
fn silence(notices: Conditions) -> Option<Condition> {
    let silent = Condition::CommanderSilent;
    notices.contains(silent).then_some(silent)
}

/// Kind, condition and reason of a task that was not carried out.
fn unfinished(
    robot: &impl Robot,
    lead: &lead::Output,
) -> (EndKind, Option<Condition>, Option<String>) {
    let fault = robot.monitor().first_fault().and_then(|first| first.reason);
    let stopped = matches!(
        lead.supervision.state,
        OperatingState::SafeStop | OperatingState::Fault
    );
    let fault = fault.or(lead.supervision.reason.filter(|_| stopped));
    let why = robot.failure().or_else(|| robot.monitor().why_stopped());
    match (why, lead.failed) {
        (Some(why), _) => (EndKind::Stopped, fault, Some(why)),
        (None, _) if fault.is_some() => (EndKind::Stopped, fault, None),
        (None, Some(Condition::NotANumber)) => {
            let why = "the controller's velocity or curvature is not finite";
            (EndKind::Stopped, lead.failed, Some(why.to_owned()))
        }
        (None, Some(Condition::NoProgress)) => (EndKind::NoProgress, lead.failed, None),
        (None, Some(_)) => (EndKind::GaveUp, lead.failed, None),
        (None, None) => (EndKind::TimeLimit, None, None),
    }
}

impl Serialize for RunEnd {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Fields<'a> {
            kind: EndKind,
            code: Option<String>,
            condition: Option<&'static str>,
            reason: Option<&'a str>,
            notices: Vec<&'static str>,
            estimate: Option<[f64; 3]>,
            error_95: Option<[f64; 2]>,
            truth: Option<[f64; 3]>,
            duration_s: f64,
        }
        let fields = Fields {
            kind: self.kind,
            code: self.code(),
            condition: self.condition.map(|condition| condition.entry().name),
            reason: self.reason.as_deref(),
            notices: self.notice_names(),
            estimate: self.estimate,
            error_95: self.error_95,
            truth: self.truth,
            duration_s: self.duration_s,
        };
        fields.serialize(to)
    }
}

/// Colour class of a final posture in pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Task carried out, within the tolerance of the goal.
    Within,
    /// Task carried out, outside the tolerance.
    Outside,
    /// Task not carried out.
    Failed,
}

impl Verdict {
    /// All verdicts.
    pub const ALL: [Self; 3] = [Self::Within, Self::Outside, Self::Failed];

    /// Verdict on a run that ended as `kind`; `within` is true if the final posture is within the tolerance.
    pub const fn of(kind: EndKind, within: bool) -> Self {
        match (kind.is_success(), within) {
            (true, true) => Self::Within,
            (true, false) => Self::Outside,
            (false, _) => Self::Failed,
        }
    }

    /// Text of the legend, with the tolerance of position (m) and heading (rad).
    pub fn label(self, [position, heading]: [f64; 2]) -> String {
        // Rounded, so that 0.0873 rad reads 5°.
        let degrees = (10.0 * heading.to_degrees()).round() / 10.0;
        let cm = (1e3 * position).round() / 10.0;
        match self {
            Self::Within => format!("within {cm} cm and {degrees}°"),
            Self::Outside => format!("outside {cm} cm or {degrees}°"),
            Self::Failed => "task not done".to_owned(),
        }
    }
}

/// Number of runs with each label of [`RunEnd::label`], most frequent label first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ends(Vec<(String, u32)>);

impl Ends {
    /// Counts the labels of several runs' ends.
    pub fn of<'a>(ends: impl IntoIterator<Item = &'a RunEnd>) -> Self {
        Self::of_labels(ends.into_iter().map(RunEnd::label))
    }

    /// Counts equal labels.
    pub fn of_labels(labels: impl IntoIterator<Item = String>) -> Self {
        let mut counts: Vec<(String, u32)> = Vec::new();
        for label in labels {
            match counts.iter_mut().find(|(known, _)| *known == label) {
                Some((_, count)) => *count += 1,
                None => counts.push((label, 1)),
            }
        }
        counts.sort_by(|(a, m), (b, n)| n.cmp(m).then_with(|| a.cmp(b)));
        Self(counts)
    }

    /// Lines of number and label, for example `3 reached`.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let counts = self.0.iter();
        counts.map(|(label, count)| format!("{count} {label}"))
    }

    /// Number and label of all ends in one line.
    pub fn text(&self) -> String {
        self.lines().collect::<Vec<_>>().join("; ")
    }
}

impl Serialize for Ends {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_map(self.0.iter().map(|(label, count)| (label, count)))
    }
}
