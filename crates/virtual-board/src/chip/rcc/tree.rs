//! Frequencies from the settings of PLL and prescalers, and their limits.

use crate::chip::effect::Clocks;

/// The PLL as configured by PLLCFGR and the frequency of its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pll {
    m: u64,
    n: u64,
    q: u64,
    /// Input of the phase detector, Hz.
    pub input_hz: u64,
    /// Voltage-controlled oscillator, Hz.
    pub oscillator_hz: u64,
    /// Output for the core, Hz.
    pub core_hz: u64,
    /// Output for USB, random number generator and SDIO, Hz.
    pub usb_hz: u64,
}

impl Pll {
    pub fn of(pllcfgr: u32, source_hz: u64) -> Self {
        let field = |shift: u32, bits: u32| u64::from(pllcfgr >> shift & bits);
        let (m, n, q) = (field(0, 63), field(6, 511), field(24, 15));
        // The multiplication comes first to keep the fraction of a source that M does not divide.
        let oscillator_hz = source_hz * n / m.max(1);
        Self {
            m,
            n,
            q,
            input_hz: source_hz / m.max(1),
            oscillator_hz,
            core_hz: oscillator_hz / (2 * field(16, 3) + 2),
            usb_hz: oscillator_hz / q.max(1),
        }
    }

    /// Violated limits (RM0090, 7.3.2; data sheet, table of the main PLL).
    pub fn violations(&self) -> Vec<String> {
        let Self { m, n, q, .. } = self;
        let Self {
            input_hz,
            oscillator_hz,
            core_hz,
            usb_hz,
            ..
        } = self;
        [
            (
                !(2..=63).contains(m),
                format!("PLLM = {m}: must be 2 to 63"),
            ),
            (
                !(50..=432).contains(n),
                format!("PLLN = {n}: must be 50 to 432"),
            ),
            (*q < 2, format!("PLLQ = {q}: must be 2 to 15")),
            (
                !(950_000..=2_100_000).contains(input_hz),
                format!("PLL input {input_hz} Hz: must be 1 to 2 MHz"),
            ),
            (
                !(100_000_000..=432_000_000).contains(oscillator_hz),
                format!("PLL oscillator {oscillator_hz} Hz: must be 100 to 432 MHz"),
            ),
            (
                *core_hz > 168_000_000,
                format!("PLL output {core_hz} Hz: must be at most 168 MHz"),
            ),
            (
                *usb_hz > 75_000_000,
                format!("PLL output for USB {usb_hz} Hz: must be at most 75 MHz"),
            ),
        ]
        .into_iter()
        .filter_map(|(wrong, text)| wrong.then_some(text))
        .collect()
    }
}

/// Clocks of core and buses from the prescalers in CFGR.
pub(super) fn clocks(cfgr: u32, system_hz: u64) -> Clocks {
    let ahb = match cfgr >> 4 & 15 {
        k @ 8..=11 => 2 << (k - 8),
        // There is no divider of 32.
        k @ 12..=15 => 64 << (k - 12),
        _ => 1,
    };
    let apb = |bits: u32| if bits < 4 { 1 } else { 2u64 << (bits - 4) };
    let (apb1, apb2) = (apb(cfgr >> 10 & 7), apb(cfgr >> 13 & 7));
    let timer = |apb: u64| if apb == 1 { 1 } else { apb / 2 };
    Clocks {
        hclk_hz: system_hz / ahb,
        apb1,
        apb2,
        timer1: timer(apb1),
        timer2: timer(apb2),
    }
}

/// Clocks above their limit (data sheet, general operating conditions).
pub(super) fn too_fast(clocks: &Clocks, system_hz: u64) -> Vec<String> {
    [
        ("SYSCLK", system_hz, 168_000_000),
        ("PCLK1", clocks.hclk_hz / clocks.apb1, 42_000_000),
        ("PCLK2", clocks.hclk_hz / clocks.apb2, 84_000_000),
    ]
    .into_iter()
    .filter(|(_, hz, max_hz)| hz > max_hz)
    .map(|(name, hz, max_hz)| format!("{name} {hz} Hz: must be at most {max_hz} Hz"))
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pll_frequencies_follow_from_pllcfgr() {
        // The oscillator runs at 8 MHz / 8 · 336; divided by 2 for the core and by 7 for USB.
        let pll = Pll::of(8 | 336 << 6 | 7 << 24, 8_000_000);
        assert_eq!(
            [pll.input_hz, pll.oscillator_hz, pll.core_hz, pll.usb_hz],
            [1_000_000, 336_000_000, 168_000_000, 48_000_000]
        );
        assert!(pll.violations().is_empty());
        // 25 MHz / 15 is no whole number of Hz; its fraction is kept in 25 MHz / 15 · 180 / 4.
        let pll = Pll::of(15 | 180 << 6 | 1 << 16 | 7 << 24, 25_000_000);
        assert_eq!(pll.core_hz, 75_000_000);
    }

    #[test]
    fn each_violated_limit_of_the_pll_is_reported() {
        for (pllcfgr, word) in [
            (1 | 168 << 6 | 7 << 24, "PLLM"),
            (8 | 49 << 6 | 7 << 24, "PLLN"),
            (8 | 336 << 6 | 1 << 24, "PLLQ"),
            (2 | 84 << 6 | 7 << 24, "input"),
            (8 | 433 << 6 | 1 << 16 | 7 << 24, "oscillator"),
            (8 | 338 << 6 | 7 << 24, "output"),
            (8 | 336 << 6 | 4 << 24, "USB"),
        ] {
            let found = Pll::of(pllcfgr, 8_000_000).violations();
            assert!(
                found.iter().any(|text| text.contains(word)),
                "{word}: {found:?}"
            );
        }
    }

    #[test]
    fn prescalers_divide_by_the_factors_of_the_manual() {
        for (hpre, divider) in [(0, 1), (7, 1), (8, 2), (11, 16), (12, 64), (15, 512)] {
            assert_eq!(clocks(hpre << 4, 102_400).hclk_hz, 102_400 / divider);
        }
        let clocks = clocks(5 << 10 | 4 << 13, 168_000_000);
        assert_eq!([clocks.apb1, clocks.apb2], [4, 2]);
        assert_eq!([clocks.timer1, clocks.timer2], [2, 1]);
        assert!(too_fast(&clocks, 168_000_000).is_empty());
        let clocks = super::clocks(5 << 10 | 4 << 13, 180_000_000);
        assert_eq!(too_fast(&clocks, 180_000_000).len(), 3);
    }
}
