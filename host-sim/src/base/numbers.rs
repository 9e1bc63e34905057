//! Numbers on the command line, refused with what is allowed.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Reads a whole number in a range.
pub fn whole<T>(
    range: RangeInclusive<T>,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static
where
    T: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text| match text.parse() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!(
            "must be a whole number from {} to {}",
            range.start(),
            range.end()
        )),
    }
}

/// Reads a number; its range is checked where the scenario is known.
pub fn number(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err("must be a plain number, in the unit shown between < and >".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_refused_says_what_is_allowed() {
        let trials = whole::<u32>(1..=1000);
        assert_eq!((trials("1"), trials("1000")), (Ok(1), Ok(1000)));
        for bad in ["0", "1001", "-1", "many", "1.5", "5_000_000_000", ""] {
            let text = trials(bad).unwrap_err();
            assert_eq!(text, "must be a whole number from 1 to 1000", "{bad}");
        }
        assert_eq!(number("-0.25"), Ok(-0.25));
        for bad in ["20cm", "nan", "inf", "1,5", ""] {
            assert!(number(bad).unwrap_err().contains("plain number"), "{bad}");
        }
    }
}
