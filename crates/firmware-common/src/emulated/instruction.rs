//! Loads and stores of a word, as far as a compiler uses them for registers of peripherals.

/// A load or store of one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// True for a load.
    pub load: bool,
    /// Register loaded or stored.
    pub value: u32,
    /// Base register and what is added to it, in the forms that change it.
    pub base: Option<(u32, i32)>,
    /// Bytes of the instruction.
    pub size: u32,
}

impl Access {
    /// Decodes LDR and STR (ARMv7-M reference manual, A7.7.43, 45, 161, 162); other instructions
    /// are none. `second` matters to the longer forms only.
    pub fn decode(first: u16, second: u16) -> Option<Self> {
        let (first, second) = (u32::from(first), u32::from(second));
        // With a register or a small immediate as offset; bit 11 tells load from store.
        if matches!(first & 0xfe00, 0x5000 | 0x5800) || matches!(first & 0xf000, 0x6000) {
            let load = first & 0x0800 != 0;
            return Some(Self {
                load,
                value: first & 0b111,
                base: None,
                size: 2,
            });
        }
        let load = first & 0x0010 != 0;
        let base = match first >> 4 {
            // 12-bit offset.
            0xf8c | 0xf8d => None,
            // Register as offset.
            0xf84 | 0xf85 if second & 0x0fc0 == 0 => None,
            // 8-bit offset: bit 11 is set, bit 9 adds it, bit 8 writes the sum back.
            0xf84 | 0xf85 if second & 0x0800 != 0 => {
                let offset = (second & 0xff) as i32;
                let offset = if second & 0x0200 != 0 {
                    offset
                } else {
                    -offset
                };
                (second & 0x0100 != 0).then_some((first & 0xf, offset))
            }
            _ => return None,
        };
        Some(Self {
            load,
            value: second >> 12,
            base,
            size: 4,
        })
    }
}

/// Program status behind an instruction: in an if-then block the block is moved on by one.
pub fn after_instruction(status: u32) -> u32 {
    // Its state lies in two parts: bits 7:2 at 15:10, bits 1:0 at 26:25.
    let block = (status >> 8) & 0xfc | (status >> 25) & 0b11;
    let next = if block & 0b111 == 0 {
        0
    } else {
        block & 0xe0 | (block << 1) & 0x1f
    };
    status & !(0xfc << 8 | 0b11 << 25) | (next & 0xfc) << 8 | (next & 0b11) << 25
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The codes are those that LLVM's assembler gave for the text behind them.
    #[test]
    fn words_are_decoded() {
        let (load, store) = (true, false);
        for (code, wanted) in [
            ((0x680b, 0), (load, 3, None, 2)),                 // ldr r3, [r1]
            ((0x6fcb, 0), (load, 3, None, 2)),                 // ldr r3, [r1, #124]
            ((0x6047, 0), (store, 7, None, 2)),                // str r7, [r0, #4]
            ((0x5962, 0), (load, 2, None, 2)),                 // ldr r2, [r4, r5]
            ((0x5162, 0), (store, 2, None, 2)),                // str r2, [r4, r5]
            ((0xf8d8, 0xac14), (load, 10, None, 4)),           // ldr.w r10, [r8, #0xc14]
            ((0xf8ce, 0xc008), (store, 12, None, 4)),          // str.w r12, [lr, #8]
            ((0xf852, 0x902b), (load, 9, None, 4)),            // ldr.w r9, [r2, r11, lsl #2]
            ((0xf842, 0x1003), (store, 1, None, 4)),           // str.w r1, [r2, r3]
            ((0xf851, 0x6f04), (load, 6, Some((1, 4)), 4)),    // ldr r6, [r1, #4]!
            ((0xf841, 0x6d08), (store, 6, Some((1, -8)), 4)),  // str r6, [r1, #-8]!
            ((0xf851, 0x6b0c), (load, 6, Some((1, 12)), 4)),   // ldr r6, [r1], #12
            ((0xf841, 0x6910), (store, 6, Some((1, -16)), 4)), // str r6, [r1], #-16
            ((0xf851, 0x6c04), (load, 6, None, 4)),            // ldr r6, [r1, #-4]
        ] {
            let (load, value, base, size) = wanted;
            let wanted = Access {
                load,
                value,
                base,
                size,
            };
            assert_eq!(Access::decode(code.0, code.1), Some(wanted), "{code:x?}");
        }
    }

    #[test]
    fn other_instructions_are_none() {
        for (first, second) in [
            (0x780b, 0),      // ldrb r3, [r1]
            (0x804b, 0),      // strh r3, [r1, #2]
            (0x568b, 0),      // ldrsb r3, [r1, r2]
            (0xf881, 0x3064), // strb.w r3, [r1, #100]
            (0xe9d1, 0x2300), // ldrd r2, r3, [r1]
            (0xe891, 0x000c), // ldm r1, {r2, r3}
            (0xed91, 0x0a00), // vldr s0, [r1]
        ] {
            assert_eq!(Access::decode(first, second), None, "{first:#x}");
        }
    }

    /// The state after `IT` with `first` condition and `mask`, and other bits that must stay.
    fn status(block: u32) -> u32 {
        0x8100_0003 | (block & 0xfc) << 8 | (block & 0b11) << 25
    }

    #[test]
    fn an_if_then_block_is_left_after_its_instructions() {
        let outside = status(0);
        assert_eq!(after_instruction(outside), outside);
        // The lowest set bit of the mask says how many instructions: 1000 one, 0001 four.
        for mask in 1..16u32 {
            for condition in [0b0000, 0b0001, 0b1010] {
                let instructions = 4 - mask.trailing_zeros();
                let mut now = status(condition << 4 | mask);
                for left in (0..instructions).rev() {
                    assert_ne!(now, outside, "{mask:04b}");
                    now = after_instruction(now);
                    if left > 0 {
                        // The upper bits of the condition hold for all, its lowest is the next of the mask.
                        let lowest = mask >> (3 - (instructions - 1 - left)) & 1;
                        let block = (now >> 8) & 0xfc | (now >> 25) & 0b11;
                        assert_eq!(block >> 4, condition & 0b1110 | lowest, "{mask:04b}");
                    }
                }
                assert_eq!(now, outside, "{mask:04b}");
            }
        }
    }
}
