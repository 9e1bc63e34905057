//! Numbers drawn from the fuzzer's bytes, often edge values.

/// Reader of the fuzzer's bytes from the front; gives zeros after the end.
pub struct Bytes<'a>(pub &'a [u8]);

impl<'a> Bytes<'a> {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn byte(&mut self) -> u8 {
        match self.0.split_first() {
            Some((&first, rest)) => {
                self.0 = rest;
                first
            }
            None => 0,
        }
    }

    pub fn array<const N: usize>(&mut self) -> [u8; N] {
        std::array::from_fn(|_| self.byte())
    }

    /// Reads the next bytes, at most `length`; fewer at the end.
    pub fn take(&mut self, length: usize) -> &'a [u8] {
        let (head, rest) = self.0.split_at(length.min(self.0.len()));
        self.0 = rest;
        head
    }

    /// Reads a finite number, because JSON cannot represent NaN and infinity.
    pub fn number(&mut self) -> f64 {
        const EDGES: [f64; 12] = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            1e-45,
            1e-30,
            1e38,
            3.5e38,
            -1e39,
            1e308,
            5e-324,
            std::f64::consts::PI,
        ];
        let number = match self.byte() {
            kind @ 0..=95 => f64::from(self.byte() as i8) * 10f64.powi(i32::from(kind) / 12 - 5),
            96..=127 => f64::from(i16::from_le_bytes(self.array())) * 1e-4,
            128..=159 => f64::from(f32::from_bits(u32::from_le_bytes(self.array()))),
            160..=191 => f64::from_bits(u64::from_le_bytes(self.array())),
            kind => EDGES[usize::from(kind) % EDGES.len()],
        };
        if number.is_finite() { number } else { f64::MAX }
    }
}

/// Replaces each `#` of `template` by a number.
pub fn fill(template: &str, bytes: &mut Bytes) -> String {
    let mut text = String::new();
    for (i, part) in template.split('#').enumerate() {
        if i > 0 {
            text += &format!("{:e}", bytes.number());
        }
        text += part;
    }
    text
}
