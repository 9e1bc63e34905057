//! What is counted, and the trigger from timer to converter.

use rigless::emulator::{
    Access, AccessKind, Driver, Hit, HitKind, Host, Settled, Stop, StopReason, Watch,
};
use rigless::image::Image;
use rigless::machine::Board;
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use std::collections::BTreeMap;

/// Where the vector table begins, and how many exceptions it has.
const VECTORS: u64 = 0x0800_0000;
const EXCEPTIONS: usize = 16 + 82;
const SYSTICK: usize = 15;

/// How often TIM2 is looked at while it stands still.
pub const STEP: VirtualNanos = VirtualNanos(10_000);
/// TIM2's clock in the images, Hz.
const TIM2_HZ: u64 = 84_000_000;
const TIM2_CR1: u64 = 0x4000_0000;
const TIM2_SR: u64 = 0x4000_0010;
const TIM2_CNT: u64 = 0x4000_0024;
const TIM2_ARR: u64 = 0x4000_002c;
const ADC1_CR2: u64 = 0x4001_2008;
/// EXTEN: rising edge; EXTSEL: TRGO of TIM2.
const BY_TIM2: u64 = 1 << 28 | 6 << 24;
const TRIGGER: u64 = 0x3f << 24;
const SWSTART: u64 = 1 << 30;

/// Counts, from the first tick on.
pub struct Counts {
    /// Exception by the address of its handler.
    handlers: BTreeMap<u64, usize>,
    taken: BTreeMap<usize, u64>,
    scans: u64,
    /// For how long, nanoseconds.
    length: u64,
    /// When it ends, once the first tick came.
    end: Option<u64>,
    /// TIM2 counted when it was looked at last.
    counted: bool,
}

impl Counts {
    /// Counts of these handlers' exceptions.
    pub fn new(handlers: BTreeMap<u64, usize>, length: u64) -> Self {
        Self {
            handlers,
            taken: BTreeMap::new(),
            scans: 0,
            length,
            end: None,
            counted: false,
        }
    }

    /// Watches the handlers.
    pub fn watch<D: Board + ?Sized>(&self, session: &mut Session<D>) {
        for &address in self.handlers.keys() {
            session.watch(Watch::Instruction(address));
        }
    }

    /// The counts as an object.
    pub fn json(&self, resets: usize) -> String {
        let taken = self
            .taken
            .iter()
            .map(|(number, count)| format!("\"{number}\": {count}"));
        let taken: Vec<String> = taken.collect();
        format!(
            "{{\"resets\": {resets}, \"scans\": {}, \"exceptions\": {{{}}}}}",
            self.scans,
            taken.join(", ")
        )
    }

    /// An update of TIM2 starts a scan; gives when to look again.
    fn trigger<D: Board + ?Sized>(
        &mut self,
        session: &mut Session<D>,
        stop: Stop,
        host: &mut dyn Host,
    ) -> u64 {
        let mut access = |kind, address, value| {
            let access = Access::new(kind, address, Width::W32, value);
            session
                .access(access.at(stop.instruction_count, stop.at), host)
                .0
        };
        let mut read = |address| access(AccessKind::Read, address, 0);
        let counts = read(TIM2_CR1) & 1 != 0;
        let updated = read(TIM2_SR) & 1 != 0;
        let left = read(TIM2_ARR).saturating_sub(read(TIM2_CNT)) + 1;
        let control = read(ADC1_CR2);
        if updated {
            access(AccessKind::Write, TIM2_SR, !1 & 0xffff);
        }
        // The update by software before it counts is none that starts a scan.
        if updated && self.counted && control & TRIGGER == BY_TIM2 {
            access(AccessKind::Write, ADC1_CR2, control | SWSTART);
            self.scans += u64::from(self.end.is_some());
        }
        self.counted = counts;
        match counts {
            true => (left * 1_000_000_000).div_ceil(TIM2_HZ),
            false => STEP.0,
        }
    }
}

impl<D: Board + ?Sized> Driver<D> for Counts {
    fn on_settled(&mut self, _session: &mut Session<D>, _host: &mut dyn Host, settled: Settled) {
        let Settled::Hit(hit) = settled else {
            return;
        };
        let Hit {
            kind, address, at, ..
        } = hit;
        if kind != HitKind::Instruction {
            return;
        }
        let Some(&exception) = self.handlers.get(&address) else {
            return;
        };
        if exception == SYSTICK && self.end.is_none() {
            self.end = Some(at.0 + self.length);
        } else if self.end.is_some() {
            *self.taken.entry(exception).or_default() += 1;
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<D>,
        stop: Stop,
        host: &mut dyn Host,
    ) -> Option<VirtualNanos> {
        if self.end.is_some_and(|end| stop.at.0 >= end) || stop.reason == StopReason::Reset {
            return None;
        }
        let next = stop.at.0 + self.trigger(session, stop, host);
        Some(VirtualNanos(next.min(self.end.unwrap_or(u64::MAX))))
    }
}

/// Handlers that belong to one exception alone, by address.
pub fn handlers(image: &Image) -> Result<BTreeMap<u64, usize>, &'static str> {
    let (start, bytes) = image
        .segments()
        .find(|(address, bytes)| (*address..*address + bytes.len() as u64).contains(&VECTORS))
        .ok_or("the image has no vector table at 0x08000000")?;
    let table = &bytes[(VECTORS - start) as usize..];
    let words = table.chunks_exact(4).take(EXCEPTIONS);
    let vectors: Vec<u64> = words
        .map(|w| u64::from(u32::from_le_bytes([w[0], w[1], w[2], w[3]]) & !1))
        .collect();
    let mut handlers = BTreeMap::new();
    for (exception, &address) in vectors.iter().enumerate().skip(2) {
        let shared = vectors.iter().filter(|&&other| other == address).count() > 1;
        if address != 0 && !shared {
            handlers.insert(address, exception);
        }
    }
    Ok(handlers)
}
