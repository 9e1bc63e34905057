//! Parsers of command-line numbers; errors state the allowed range.

use std::f64::consts::TAU;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Parser of a whole number in `range`.
pub fn whole<T>(
    range: RangeInclusive<T>,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static
where
    T: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text| match text.parse() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => {
            let (least, most) = (range.start(), range.end().to_string());
            Err(match most == u64::MAX.to_string() {
                true => format!("must be a whole number of at least {least}"),
                false => format!("must be a whole number from {least} to {most}"),
            })
        }
    }
}

/// Reads a finite number; the range is checked later, where the scenario is known.
pub fn number(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err("must be a plain number, in the unit shown between < and >".to_owned()),
    }
}

/// Reads an angle in radians, or in degrees with the suffix `deg` or `°`; gives rad.
pub fn angle(text: &str) -> Result<f64, String> {
    let degrees = text.strip_suffix("deg").or_else(|| text.strip_suffix('°'));
    let (text, unit, scale) = match degrees {
        Some(text) => (text.trim_end(), "°", 1.0_f64.to_radians()),
        None => (text, "rad", 1.0),
    };
    let most = TAU / scale;
    match text.parse::<f64>() {
        Ok(value) if value.abs() <= most * (1.0 + f64::EPSILON) => Ok(match degrees {
            Some(_) => value.to_radians(),
            None => value,
        }),
        _ => Err(format!(
            "must be a number from -{most:.5} to {most:.5} {unit} (degrees end in deg: 90deg)"
        )),
    }
}

/// Reads a posture from three words: x and y, m, and the heading as in [`angle`]. `most` limits |x| and |y|, m.
pub fn posture([x, y, phi]: [&str; 3], most: f64) -> Result<[f64; 3], String> {
    let coordinate = |name: &str, text: &str| match text.parse::<f64>() {
        Ok(value) if value.abs() <= most => Ok(value),
        _ => Err(format!(
            "{name} = {text}: must be a number from -{most} to {most} m"
        )),
    };
    Ok([
        coordinate("X", x)?,
        coordinate("Y", y)?,
        angle(phi).map_err(|error| format!("PHI = {phi}: {error}"))?,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_number_is_refused_with_allowed_range() {
        let trials = whole::<u32>(1..=1000);
        assert_eq!((trials("1"), trials("1000")), (Ok(1), Ok(1000)));
        for bad in ["0", "1001", "-1", "many", "1.5", "5_000_000_000", ""] {
            let text = trials(bad).unwrap_err();
            assert_eq!(text, "must be a whole number from 1 to 1000", "{bad}");
        }
        let seed = whole::<u64>(0..=u64::MAX)("x").unwrap_err();
        assert_eq!(seed, "must be a whole number of at least 0");
        assert_eq!(number("-0.25"), Ok(-0.25));
        for bad in ["20cm", "nan", "inf", "1,5", ""] {
            assert!(number(bad).unwrap_err().contains("plain number"), "{bad}");
        }
    }

    #[test]
    fn angle_is_in_radians_or_degrees() {
        assert_eq!(angle("-0.5"), Ok(-0.5));
        for degrees in ["90deg", "90 deg", "90°", "+9e1°"] {
            let found = angle(degrees).unwrap();
            assert!((found - TAU / 4.0).abs() < 1e-15, "{degrees}");
        }
        assert!(angle("360deg").is_ok() && angle("-360deg").is_ok());
        for bad in [
            "7",
            "361deg",
            "90degrees",
            "deg",
            "nan",
            "inf°",
            "",
            "90 rad",
        ] {
            assert!(angle(bad).unwrap_err().contains("90deg"), "{bad}");
        }
    }
}
