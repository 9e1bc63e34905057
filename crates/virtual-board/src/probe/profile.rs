//! Profile of a board: time by function, source line and interrupt.

use crate::board::Board;
use crate::core::ExceptionProfile;
use crate::image::Image;
use crate::time::Cycles;
use std::collections::BTreeMap;
use std::fmt;

/// Table entry for the cycles that belong to no function of the image.
const ELSEWHERE: &str = "(outside the flash, and first fetches)";

/// Times of an interrupt or another exception.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct InterruptTime {
    /// Name of the handler.
    pub name: String,
    /// Number of the handler's runs, and their durations.
    pub times: ExceptionProfile,
}

/// Cycles of a function.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FunctionTime {
    /// Name; without symbols, the address.
    pub name: String,
    /// Cycles in the function, without called functions.
    pub cycles: Cycles,
}

/// Times of a board.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Times {
    functions: Vec<FunctionTime>,
    /// Function, source line, cycles.
    lines: BTreeMap<(String, String), Cycles>,
    interrupts: Vec<InterruptTime>,
    frequency_hz: f64,
}

impl Times {
    /// Creates the tables from the cycles of each instruction (address, cycles) and the times of interrupts. Functions
    /// and interrupts are sorted by their cycles, largest first.
    pub fn new(
        image: &Image,
        instructions: impl IntoIterator<Item = (u32, Cycles)>,
        interrupts: impl IntoIterator<Item = InterruptTime>,
        frequency_hz: f64,
    ) -> Self {
        let mut functions: BTreeMap<String, Cycles> = BTreeMap::new();
        let mut lines = BTreeMap::new();
        for (pc, cycles) in instructions {
            let name = image
                .function(pc)
                .map_or_else(|| format!("{:#010x}", pc & !1), |s| s.name.clone());
            let line = image.line(pc).map_or_else(String::new, |p| p.to_string());
            *functions.entry(name.clone()).or_default() += cycles;
            *lines.entry((name, line)).or_default() += cycles;
        }
        let functions = functions.into_iter();
        let mut functions: Vec<_> = functions
            .map(|(name, cycles)| FunctionTime { name, cycles })
            .collect();
        // The sort is stable: functions with equal cycles stay in the order of their names.
        functions.sort_by_key(|f| std::cmp::Reverse(f.cycles));
        let mut interrupts: Vec<_> = interrupts
            .into_iter()
            .filter(|i| i.times.count > 0)
            .collect();
        interrupts.sort_by_key(|i| std::cmp::Reverse(i.times.total));
        Self {
            functions,
            lines,
            interrupts,
            frequency_hz,
        }
    }

    /// Times of a board with this image since its profiling began ([`crate::core::Core::set_profiling`]); `None`
    /// without profiling. The core ran at `frequency_hz`.
    pub fn of(image: &Image, board: &Board, frequency_hz: f64) -> Option<Self> {
        let profile = board.core().profile()?;
        let interrupts = image.handlers().into_iter().map(|(number, name)| {
            let times = profile.exception(number);
            InterruptTime { name, times }
        });
        let instructions = profile.instructions();
        let mut times = Self::new(image, instructions, interrupts, frequency_hz);
        let (name, cycles) = (ELSEWHERE.to_owned(), profile.elsewhere());
        times.lines.insert((name.clone(), String::new()), cycles);
        times.functions.push(FunctionTime { name, cycles });
        times.functions.sort_by_key(|f| std::cmp::Reverse(f.cycles));
        Some(times)
    }

    /// Frequency of the core clock, Hz.
    pub fn frequency_hz(&self) -> f64 {
        self.frequency_hz
    }

    /// Functions, sorted by cycles, largest first.
    pub fn functions(&self) -> &[FunctionTime] {
        &self.functions
    }

    /// Interrupts that occurred, sorted by total cycles, largest first.
    pub fn interrupts(&self) -> &[InterruptTime] {
        &self.interrupts
    }

    /// Cycles of all instructions.
    pub fn total(&self) -> Cycles {
        self.functions.iter().map(|f| f.cycles).sum()
    }

    /// Folded stacks for Speedscope and flame graph tools, one per line: `board;function;file:line cycles`. Callers are
    /// not known, so a stack consists of a function and its source line.
    pub fn folded(&self, board: &str) -> String {
        // `;` separates frames, the last space the number.
        let frame = |text: &str| text.replace(';', ":");
        let lines = self.lines.iter().map(|((function, line), cycles)| {
            let mut stack = format!("{};{}", frame(board), frame(function));
            if !line.is_empty() {
                stack += &format!(";{}", frame(line));
            }
            format!("{stack} {cycles}\n")
        });
        lines.collect()
    }
}

/// Two tables: the functions with the most cycles, and the interrupts.
impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const SHOWN: usize = 30;
        let total = self.total().max(1) as f64;
        let us = |cycles: Cycles| cycles as f64 / self.frequency_hz * 1e6;
        writeln!(f, "{:>7} {:>14}  function", "%", "cycles")?;
        for FunctionTime { name, cycles } in self.functions.iter().take(SHOWN) {
            let share = 100.0 * *cycles as f64 / total;
            writeln!(f, "{share:>7.2} {cycles:>14}  {name}")?;
        }
        if self.functions.len() > SHOWN {
            let rest: Cycles = self.functions[SHOWN..].iter().map(|f| f.cycles).sum();
            let share = 100.0 * rest as f64 / total;
            let others = self.functions.len() - SHOWN;
            writeln!(f, "{share:>7.2} {rest:>14}  {others} others")?;
        }
        writeln!(
            f,
            "\n{:>9} {:>9} {:>9} {:>9} {:>9}  interrupt (µs: mean, longest, with preemption, latency)",
            "times", "mean", "longest", "whole", "latency"
        )?;
        for i in &self.interrupts {
            let InterruptTime { name, times } = i;
            let (count, mean) = (times.count, us(times.total) / times.count as f64);
            let (own, whole) = (us(times.longest_own), us(times.longest));
            let latency = us(times.longest_latency);
            writeln!(
                f,
                "{count:>9} {mean:>9.2} {own:>9.2} {whole:>9.2} {latency:>9.2}  {name}"
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::tests::Builder;

    fn times() -> Times {
        let image = Builder::new(&[0; 64])
            .function("tick", 0x0800_0100, 8)
            .function("a;b", 0x0800_0108, 8)
            .lines(
                &[(0x0800_0100, "m.rs", 1), (0x0800_0104, "m.rs", 2)],
                0x0800_0108,
            )
            .image();
        let instructions = [
            (0x0800_0100, 10),
            (0x0800_0102, 5),
            (0x0800_0106, 20),
            (0x0800_010a, 100),
            (0x0800_0130, 1),
        ];
        let interrupt = |name: &str, count, total| InterruptTime {
            name: name.into(),
            times: ExceptionProfile {
                count,
                total,
                longest: 3360,
                longest_own: 1680,
                longest_latency: 168,
            },
        };
        let interrupts = [
            interrupt("never", 0, 0),
            interrupt("SysTick", 4, 672),
            interrupt("ADC", 2, 1680),
        ];
        Times::new(&image, instructions, interrupts, 168e6)
    }

    #[test]
    fn cycles_are_summed_by_function_and_sorted() {
        let times = times();
        let found: Vec<_> = times
            .functions()
            .iter()
            .map(|f| (&*f.name, f.cycles))
            .collect();
        assert_eq!(found, [("a;b", 100), ("tick", 35), ("0x08000130", 1)]);
        assert_eq!(times.total(), 136);
        let names: Vec<_> = times.interrupts().iter().map(|i| &*i.name).collect();
        assert_eq!(names, ["ADC", "SysTick"]);
    }

    #[test]
    fn folded_stacks_have_a_number_after_the_last_space() {
        let folded = times().folded("front");
        let expected = "front;0x08000130 1\nfront;a:b 100\nfront;tick;/source/m.rs:1 15\n\
                        front;tick;/source/m.rs:2 20\n";
        assert_eq!(folded, expected);
    }

    #[test]
    fn table_shows_interrupt_times_in_microseconds() {
        let text = times().to_string();
        let line = text.lines().find(|l| l.ends_with("ADC"));
        assert_eq!(
            line,
            Some("        2      5.00     10.00     20.00      1.00  ADC")
        );
        assert!(text.contains("  73.53            100  a;b"));
    }
}
