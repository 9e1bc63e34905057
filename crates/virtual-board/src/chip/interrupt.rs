//! Interrupt lines of the STM32F405 that the model uses.

/// Number of an interrupt line (reference manual, vector table).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the manual's names")]
#[repr(u32)]
pub enum Interrupt {
    Wwdg = 0,
    Pvd = 1,
    Flash = 4,
    Rcc = 5,
    Dma1Stream0 = 11,
    Dma1Stream1 = 12,
    Dma1Stream2 = 13,
    Dma1Stream3 = 14,
    Dma1Stream4 = 15,
    Dma1Stream5 = 16,
    Dma1Stream6 = 17,
    Adc = 18,
    Can1Tx = 19,
    Can1Rx0 = 20,
    Can1Rx1 = 21,
    Can1Sce = 22,
    Tim1Break = 24,
    Tim1Update = 25,
    Tim1Trigger = 26,
    Tim1Compare = 27,
    Tim2 = 28,
    Tim3 = 29,
    Tim4 = 30,
    Spi1 = 35,
    Usart3 = 39,
    Dma1Stream7 = 47,
    Tim5 = 50,
    Dma2Stream0 = 56,
    Dma2Stream1 = 57,
    Dma2Stream2 = 58,
    Dma2Stream3 = 59,
    Dma2Stream4 = 60,
    Dma2Stream5 = 68,
    Dma2Stream6 = 69,
    Dma2Stream7 = 70,
}

impl Interrupt {
    /// Interrupt lines of the streams of DMA1 and DMA2.
    #[rustfmt::skip]
    pub(crate) const OF_STREAMS: [[Self; 8]; 2] = {
        use Interrupt::*;
        [
            [Dma1Stream0, Dma1Stream1, Dma1Stream2, Dma1Stream3, Dma1Stream4, Dma1Stream5, Dma1Stream6, Dma1Stream7],
            [Dma2Stream0, Dma2Stream1, Dma2Stream2, Dma2Stream3, Dma2Stream4, Dma2Stream5, Dma2Stream6, Dma2Stream7],
        ]
    };
}
