//! In-process board with the sample and message faults of a plan; its nodes are checked at every tick.

use super::checks::{AxleChecks, BeamChecks, LeadChecks, Violation};
use super::plan::{BusFault, Plan, SampleFaults};
use core_algos::bus::{CanFrame, Message};
use core_algos::link::protocol::Placement;
use core_algos::node::board::{Board, Samples};
use core_algos::node::lead::{LeadNode, Task};
use core_algos::node::robot::RobotConfig;
use core_algos::node::{Outbox, axle};
use core_algos::time::{Micros, TICK};
use core_algos::topology::{AxleId, Role, Topology, Wheels};
use host_sim::base::error::Error;
use host_sim::targets::{
    Fault, HostCommand, InProcess, Outgoing, Output, Room, Target, TargetReport,
};
use std::sync::{Arc, Mutex};

/// Results of the checks of all boards.
#[derive(Debug, Default)]
pub struct Findings {
    pub violation: Option<(u32, Violation)>,
    /// True for each axle whose motors were switched on at this tick.
    pub armed: [bool; 2],
    /// True if the lead node began to drive.
    pub began: bool,
    /// Number of ticks with torque, summed over the axles.
    pub driven: u32,
    /// Number of orders that the lead node refused.
    pub refused: u32,
}

/// Checks of the nodes of a board.
enum BoardChecks {
    Front(AxleChecks, LeadChecks),
    Rear(AxleChecks),
    Beam(BeamChecks),
}

/// Board whose nodes are checked.
pub struct CheckedBoard {
    role: Role,
    plan: Arc<Plan>,
    findings: Arc<Mutex<Findings>>,
    nodes: Option<(Board, BoardChecks)>,
    sample_faults: SampleFaults,
    /// Messages in transit, with the tick of arrival.
    late: Vec<(u32, Message)>,
    begun: Option<(u32, Samples)>,
    torque_nm: Wheels<f32>,
}

impl CheckedBoard {
    pub fn new(role: Role, plan: &Arc<Plan>, seed: u64, findings: &Arc<Mutex<Findings>>) -> Self {
        Self {
            role,
            plan: Arc::clone(plan),
            findings: Arc::clone(findings),
            nodes: None,
            sample_faults: SampleFaults::new(role, seed),
            late: Vec::new(),
            begun: None,
            torque_nm: Wheels::both(0.0),
        }
    }

    fn bus_faults(&self, tick: u32) -> impl Iterator<Item = BusFault> + use<> {
        let (plan, role) = (Arc::clone(&self.plan), self.role);
        (0..plan.bus.len()).filter_map(move |i| {
            let (of, fault, span) = plan.bus[i];
            (of == role && span.holds(tick)).then_some(fault)
        })
    }

    fn lead(&mut self) -> Option<&mut LeadNode> {
        self.nodes.as_mut().and_then(|(board, _)| board.lead())
    }

    fn deliver(&mut self, tick: u32) {
        let due = |(at, _): &(u32, Message)| *at <= tick;
        let arrived: Vec<_> = self.late.extract_if(.., |one| due(one)).collect();
        let Some((board, checks)) = &mut self.nodes else {
            return;
        };
        for (_, message) in arrived {
            board.receive(Micros::from(tick) * TICK, &message);
            match checks {
                BoardChecks::Front(axle, lead) => {
                    axle.receive(tick, &message);
                    lead.receive(tick, &message);
                }
                BoardChecks::Rear(axle) => axle.receive(tick, &message),
                BoardChecks::Beam(beam) => beam.receive(&message),
            }
        }
    }

    /// Steps the nodes and checks them.
    fn step(
        &mut self,
        tick: u32,
        samples: &Samples,
        outbox: &mut Outbox,
    ) -> Result<Output, Violation> {
        let Some((board, checks)) = &mut self.nodes else {
            return Ok(Output::default());
        };
        let output = board.step(Micros::from(tick) * TICK, samples, outbox);
        let none = axle::Samples::default();
        let readings = match samples {
            Samples::Axle(samples) => samples,
            Samples::Beam(_) => &none,
        };
        let torque_nm = output.torque_nm;
        for message in outbox.iter() {
            match checks {
                BoardChecks::Front(axle, _) | BoardChecks::Rear(axle) => {
                    axle.sends(tick, message)?
                }
                BoardChecks::Beam(beam) => beam.sends(tick, message)?,
            }
        }
        match (&*board, checks) {
            (
                Board::Axle {
                    axle,
                    lead: Some(lead),
                },
                BoardChecks::Front(checks, of_lead),
            ) => {
                let armed = checks.step(tick, readings, axle.supervision(), torque_nm)?;
                let mut findings = self.findings.lock().unwrap();
                findings.armed[0] = armed;
                if let Some(output) = &output.lead {
                    findings.began = of_lead.step(tick, lead.supervision(), output)?;
                }
            }
            (Board::Axle { axle, .. }, BoardChecks::Rear(checks)) => {
                let armed = checks.step(tick, readings, axle.supervision(), torque_nm)?;
                self.findings.lock().unwrap().armed[1] = armed;
            }
            (Board::Beam(beam), BoardChecks::Beam(checks)) => {
                checks.step(tick, beam.supervision())?
            }
            _ => unreachable!("a board has its own watch"),
        }
        Ok(Output {
            torque_nm,
            lead: output.lead,
        })
    }
}

impl Target for CheckedBoard {
    fn start(
        &mut self,
        config: &RobotConfig,
        _: u32,
        place: Option<&Placement>,
    ) -> Result<(), Fault> {
        let board = Board::new(config, self.role).map_err(Error::from)?;
        let axle = |of| AxleChecks::new(of, config.axle.controller.max_torque_nm);
        let checks = match self.role {
            Role::LEAD => BoardChecks::Front(axle(AxleId(0)), LeadChecks::new()),
            Role::Axle(_) => BoardChecks::Rear(axle(AxleId(1))),
            Role::Beam(_) => BoardChecks::Beam(BeamChecks::new()),
        };
        self.nodes = Some((board, checks));
        if let (Some(lead), Some(place)) = (self.lead(), place) {
            lead.initialize(place);
        }
        Ok(())
    }

    /// Executes a command. Drops `SetPose` while the motors have torque, because the link would refuse it.
    fn command(&mut self, command: &HostCommand) -> Result<(), Fault> {
        let driven = self.torque_nm != Wheels::both(0.0);
        if driven && matches!(command, HostCommand::SetPose(_)) {
            return Ok(());
        }
        let Some((board, BoardChecks::Front(_, checks))) = &mut self.nodes else {
            return Ok(());
        };
        let Some(lead) = board.lead() else {
            return Ok(());
        };
        let mut orders = command.orders().into_iter();
        let done = orders.try_for_each(|order| order.execute(lead));
        match (command, done) {
            (HostCommand::Task(task), Ok(())) => checks.clears = *task == Task::Clear,
            // A new posture restarts the lead node, so its checks begin anew.
            (HostCommand::SetPose(_), Ok(())) => *checks = LeadChecks::new(),
            (HostCommand::Lost, Ok(())) | (_, Ok(())) => {}
            (_, Err(_)) => self.findings.lock().unwrap().refused += 1,
        }
        Ok(())
    }

    fn room(&mut self) -> Room {
        let path = self.lead().map(LeadNode::path_task);
        Room {
            path: path.as_ref().map_or(0, |path| path.path_room()),
            trajectory: path.map_or(0, |path| path.trajectory_room()),
        }
    }

    fn receive(&mut self, now: Micros, _frame: &CanFrame, message: &Message) {
        let tick = (now / TICK) as u32;
        let mut at = tick;
        for fault in self.bus_faults(tick) {
            match fault {
                BusFault::ReceiveNothing => return,
                BusFault::Loss(share) if self.sample_faults.lost(share) => return,
                BusFault::Late(ms) => at += ms,
                BusFault::Loss(_) | BusFault::SendNothing => {}
            }
        }
        self.late.push((at, *message));
    }

    fn begin(&mut self, tick: u32, samples: &Samples) -> Result<(), Fault> {
        self.begun = Some((tick, *samples));
        Ok(())
    }

    fn finish(&mut self, post: &mut dyn FnMut(Outgoing)) -> Result<Output, Fault> {
        let Some((tick, samples)) = self.begun.take() else {
            return Ok(Output::default());
        };
        self.deliver(tick);
        let samples = self.sample_faults.samples(&self.plan, tick, &samples);
        let mut outbox = Outbox::new();
        let output = self.step(tick, &samples, &mut outbox);
        let mute = self
            .bus_faults(tick)
            .any(|fault| matches!(fault, BusFault::SendNothing));
        if !mute {
            for message in outbox.iter() {
                post(Outgoing::Message(message));
            }
        }
        let mut findings = self.findings.lock().unwrap();
        let output = output.unwrap_or_else(|violation| {
            let what = format!("{} board: {violation}", Topology::PAIR.name(self.role));
            findings.violation.get_or_insert((tick, what));
            Output::default()
        });
        self.torque_nm = output.torque_nm;
        findings.driven += u32::from(output.torque_nm != Wheels::both(0.0));
        Ok(output)
    }

    fn switch_off(&mut self) -> Result<(), Error> {
        self.nodes = None;
        self.late.clear();
        Ok(())
    }

    fn switch_on(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn report(&self) -> TargetReport {
        InProcess::new(Topology::PAIR, self.role).report()
    }
}
