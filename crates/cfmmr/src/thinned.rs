//! Series of values in bounded memory.

/// Evenly spaced values of a series, at most `max_len`, and the latest value. When a value too many is kept, every
/// second value is dropped.
#[derive(Clone, Debug)]
pub struct Thinned<T> {
    kept: Vec<T>,
    last: Option<T>,
    max_len: usize,
    stride: u64,
    count: u64,
}

impl<T: Clone> Thinned<T> {
    /// Empty series that keeps at most `max_len` evenly spaced values; `max_len` must be even.
    pub fn new(max_len: usize) -> Self {
        Self {
            kept: Vec::new(),
            last: None,
            max_len,
            stride: 1,
            count: 0,
        }
    }

    /// Appends a value to the series.
    pub fn push(&mut self, value: T) {
        self.last = None;
        match self.count.is_multiple_of(self.stride) {
            true => self.kept.push(value),
            false => self.last = Some(value),
        }
        if self.kept.len() > self.max_len {
            let mut number = 0;
            self.kept.retain(|_| {
                number += 1;
                number % 2 == 1
            });
            self.stride *= 2;
        }
        self.count += 1;
    }

    /// Kept values and the latest value, oldest first: at most `max_len` + 1 values.
    pub fn into_values(self) -> Vec<T> {
        self.kept.into_iter().chain(self.last).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_series_keeps_even_steps_and_its_last_value() {
        let mut series = Thinned::new(4);
        (0..7).for_each(|value| series.push(value));
        assert_eq!(series.clone().into_values(), [0, 2, 4, 6]);
        (7..32).for_each(|value| series.push(value));
        assert_eq!(series.clone().into_values(), [0, 8, 16, 24, 31]);
        series.push(32);
        assert_eq!(series.into_values(), [0, 16, 32]);
    }
}
