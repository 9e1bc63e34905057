//! What was asked of a part that its model does not do, or that its data sheet forbids.

use crate::time::Time;

/// Different texts that are kept; what comes beyond is counted under the last.
const LIMIT: usize = 64;

/// One thing, and how often.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnmodelledUse {
    /// What it is, in words.
    pub text: String,
    /// The first time.
    pub at: Time,
    /// How often.
    pub count: u64,
}

/// Uses in the order of their first times.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UnmodelledUses {
    list: Vec<UnmodelledUse>,
}

impl UnmodelledUses {
    /// All of them.
    pub fn list(&self) -> &[UnmodelledUse] {
        &self.list
    }

    #[cold]
    pub(super) fn note(&mut self, at: Time, text: String) {
        let known = self.list.iter().position(|r| r.text == text);
        let full = self.list.len() == LIMIT;
        match known.or(full.then_some(LIMIT - 1)) {
            Some(index) => self.list[index].count += 1,
            None => self.list.push(UnmodelledUse { text, at, count: 1 }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_texts_are_counted_and_the_number_of_texts_is_bounded() {
        let mut unmodelled = UnmodelledUses::default();
        for k in 0..200u64 {
            unmodelled.note(Time(k), format!("{}", k / 2));
        }
        assert_eq!(unmodelled.list().len(), LIMIT);
        assert_eq!(unmodelled.list()[3].count, 2);
        assert_eq!(unmodelled.list()[3].at, Time(6));
        let sum: u64 = unmodelled.list().iter().map(|r| r.count).sum();
        assert_eq!(sum, 200);
    }
}
