//! The STM32F405 around the core: memories, clocks, peripherals.
