//! Trace of the boards' outputs in a run, and the first difference of two traces, bit by bit.

use crate::bus::virtual_bus::name_of;
use core_algos::bus::CanFrame;
use core_algos::node::lead;
use core_algos::time::{EPOCH, TICK};
use core_algos::topology::{Role, Topology};
use serde_json::Value;
use std::fmt;

/// Ticks in an epoch.
const EPOCH_TICKS: usize = (EPOCH / TICK) as usize;

/// Torques of every tick, frames on the bus, and the lead node's output at the end of every epoch.
#[derive(Clone, Debug)]
pub struct Trace {
    topology: Topology,
    /// Torques of each axle at each tick, N m.
    torques: Vec<[f32; 2]>,
    frames: Vec<(u32, CanFrame)>,
    leads: Vec<lead::Output>,
}

/// First difference of two traces.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Tick, ms; for an output of the lead node the last tick of its epoch.
    pub tick: usize,
    /// Name of the differing signal.
    pub signal: String,
    /// Value in the first trace.
    pub first: String,
    /// Value in the second trace.
    pub second: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            tick,
            signal,
            first,
            second,
        } = self;
        write!(f, "tick {tick}: {signal} is {first}, in process {second}")
    }
}

impl Trace {
    /// A trace without ticks.
    pub fn new(topology: Topology) -> Self {
        Self {
            topology,
            torques: Vec::new(),
            frames: Vec::new(),
            leads: Vec::new(),
        }
    }

    /// Adds a frame sent at a tick.
    pub fn frame(&mut self, tick: u32, frame: CanFrame) {
        self.frames.push((tick, frame));
    }

    /// Adds the torques of the next tick, by axle and wheel.
    pub fn torque(&mut self, torque: impl IntoIterator<Item = [f32; 2]>) {
        self.torques.extend(torque);
    }

    /// Adds the lead node's latest output at the end of the next epoch.
    pub fn lead(&mut self, output: &lead::Output) {
        self.leads.push(*output);
    }

    /// Frames on the bus, in the order of sending.
    pub fn frames(&self) -> impl Iterator<Item = &CanFrame> {
        self.frames.iter().map(|(_, frame)| frame)
    }

    /// Number of recorded ticks.
    pub fn ticks(&self) -> usize {
        self.torques.len() / self.topology.axle_count()
    }

    /// First difference of the traces; `None` if every bit is identical.
    pub fn difference(&self, other: &Self) -> Option<Difference> {
        let differences = [
            self.in_frames(other),
            self.in_torques(other),
            self.in_leads(other),
            self.in_length(other),
        ];
        let found = differences.into_iter().flatten();
        found.min_by_key(|difference| difference.tick)
    }

    fn in_torques(&self, other: &Self) -> Option<Difference> {
        let axles = (0..).flat_map(|tick| self.topology.axles().map(move |axle| (tick, axle)));
        for ((tick, axle), (a, b)) in axles.zip(self.torques.iter().zip(&other.torques)) {
            for (k, side) in ["left", "right"].into_iter().enumerate() {
                if a[k].to_bits() != b[k].to_bits() {
                    let axle = self.topology.name(Role::Axle(axle));
                    return Some(Difference {
                        tick,
                        signal: format!("{axle} axle, {side} wheel torque"),
                        first: format!("{:e} N m", a[k]),
                        second: format!("{:e} N m", b[k]),
                    });
                }
            }
        }
        None
    }

    fn in_frames(&self, other: &Self) -> Option<Difference> {
        let count = self.frames.len().max(other.frames.len());
        let place = (0..count).find(|&i| self.frames.get(i) != other.frames.get(i))?;
        let (a, b) = (self.frames.get(place), other.frames.get(place));
        let tick = [a, b].into_iter().flatten().map(|(tick, _)| *tick).min()?;
        let show = |entry: Option<&(u32, CanFrame)>| match entry {
            Some((at, frame)) if *at == tick => show_frame(self.topology, frame),
            _ => "absent".to_owned(),
        };
        Some(Difference {
            tick: tick as usize,
            signal: "frame on the bus".to_owned(),
            first: show(a),
            second: show(b),
        })
    }

    fn in_leads(&self, other: &Self) -> Option<Difference> {
        let mut pairs = self.leads.iter().zip(&other.leads).enumerate();
        let (epoch, (path, first, second)) =
            pairs.find_map(|(epoch, (a, b))| Some((epoch, lead_difference(a, b)?)))?;
        Some(Difference {
            tick: (epoch + 1) * EPOCH_TICKS - 1,
            signal: format!("lead node{path}"),
            first,
            second,
        })
    }

    fn in_length(&self, other: &Self) -> Option<Difference> {
        let (a, b) = (self.ticks(), other.ticks());
        (a != b).then(|| Difference {
            tick: a.min(b),
            signal: "length of the run".to_owned(),
            first: format!("{a} ticks"),
            second: format!("{b} ticks"),
        })
    }
}

/// Name and data of a frame as text.
pub fn show_frame(topology: Topology, frame: &CanFrame) -> String {
    let name = name_of(topology, frame.id).unwrap_or("unknown");
    let data = frame.data.get(..usize::from(frame.length));
    format!("{name} {:02x?}", data.unwrap_or(&frame.data))
}

/// First differing signal of two outputs of the lead node, with both values; `None` if the outputs are identical.
pub fn lead_difference(a: &lead::Output, b: &lead::Output) -> Option<(String, String, String)> {
    if bits(a) == bits(b) {
        return None;
    }
    let json = |output| serde_json::to_value(output).unwrap_or_default();
    let found = divergence(&json(a), &json(b));
    Some(found.unwrap_or_else(|| (String::new(), format!("{a:?}"), format!("{b:?}"))))
}

/// Bytes of an output; NaNs with different bits give different bytes.
fn bits(output: &lead::Output) -> Vec<u8> {
    let mut buffer = [0; 1024];
    match postcard::to_slice(output, &mut buffer) {
        Ok(used) => used.to_vec(),
        Err(_) => format!("{output:?}").into_bytes(),
    }
}

/// First leaf in which two value trees differ: path and both values. `None` if the trees are equal.
fn divergence(a: &Value, b: &Value) -> Option<(String, String, String)> {
    let below = |key: String, a: &Value, b: &Value| {
        divergence(a, b).map(|(path, a, b)| (format!("{key}{path}"), a, b))
    };
    match (a, b) {
        (Value::Object(a), Value::Object(b)) if a.len() == b.len() => a
            .iter()
            .find_map(|(key, value)| below(format!(".{key}"), value, b.get(key)?)),
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => a
            .iter()
            .zip(b)
            .enumerate()
            .find_map(|(i, (a, b))| below(format!("[{i}]"), a, b)),
        _ => (a != b).then(|| (String::new(), a.to_string(), b.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace() -> Trace {
        let mut trace = Trace::new(Topology::PAIR);
        for tick in 0..20 {
            trace.frame(
                tick,
                CanFrame {
                    id: 0x100,
                    length: 8,
                    data: [tick as u8; 8],
                },
            );
            trace.torque([[tick as f32; 2]; 2]);
        }
        trace.lead(&lead::Output::default());
        trace.lead(&lead::Output::default());
        trace
    }

    #[test]
    fn equal_traces_have_no_difference() {
        assert_eq!(trace().difference(&trace()), None);
        assert_eq!(trace().ticks(), 20);
    }

    #[test]
    fn one_different_bit_is_found_with_tick_and_signal() {
        let mut other = trace();
        other.torques[2 * 7 + 1][0] = f32::from_bits(7.0f32.to_bits() + 1);
        let found = trace().difference(&other).unwrap();
        assert_eq!(
            (found.tick, found.signal.as_str()),
            (7, "rear axle, left wheel torque")
        );
        assert_ne!(found.first, found.second);

        let mut other = trace();
        other.frames[5].1.data[3] ^= 1;
        other.torques[2 * 9][0] += 1.0;
        let found = trace().difference(&other).unwrap();
        assert_eq!((found.tick, found.signal.as_str()), (5, "frame on the bus"));
        assert!(found.second.contains("AxlePostureFront"));

        let mut other = trace();
        other.leads[1].fused.robot.covariance[2][0] = 1e-12;
        let found = trace().difference(&other).unwrap();
        assert_eq!(found.tick, 19);
        assert_eq!(found.signal, "lead node.fused.robot.covariance[2][0]");

        let mut other = trace();
        other.frames.remove(4);
        let found = trace().difference(&other).unwrap();
        assert_eq!((found.tick, found.second.as_str()), (4, "absent"));

        let mut other = trace();
        other.torque([[0.0; 2]; 2]);
        assert_eq!(trace().difference(&other).unwrap().tick, 20);
        // Zeros of different sign are different.
        let mut other = trace();
        other.torques[0][0] = -0.0;
        assert!(trace().difference(&other).is_some());
    }
}
