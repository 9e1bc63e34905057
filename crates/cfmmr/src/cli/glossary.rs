//! `cfmmr glossary`: prints `docs/glossary.md`, or one of its entries.

use clap::Args;
use host_sim::base::error::Error;
use host_sim::base::spelling;
use output::terminal;

const PAGE: &str = include_str!("../../../../docs/glossary.md");
/// Start of an entry's heading line in `docs/glossary.md`.
const HEADING: &str = "\n## ";

/// Arguments of `glossary`.
#[derive(Clone, Debug, Args)]
pub struct GlossaryArgs {
    /// Word [default: all]
    pub word: Vec<String>,
}

/// Runs `cfmmr glossary`.
pub fn run(args: &GlossaryArgs) -> Result<(), Error> {
    match args.word.is_empty() {
        true => terminal::print_page(PAGE),
        false => terminal::print_page(&entry(&args.word.join(" "))?),
    }
}

/// Words of the glossary with their entries.
fn entries() -> impl Iterator<Item = (&'static str, &'static str)> {
    let parts = PAGE.split(HEADING).skip(1);
    parts.map(|part| (part.lines().next().unwrap_or_default(), part))
}

/// Entry of a word, heading included.
fn entry(word: &str) -> Result<String, Error> {
    let wanted = word.to_lowercase();
    let found = entries().find(|(known, _)| known.to_lowercase() == wanted);
    match found {
        Some((_, text)) => Ok(format!("## {}\n", text.trim_end())),
        None => {
            let hint = spelling::hint(&wanted, entries().map(|(known, _)| known));
            Err(Error::input(format!(
                "{word}: not in the glossary{hint}; `cfmmr glossary` prints all words"
            )))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_word_prints_its_own_entry() {
        for (word, text) in entries() {
            let printed = entry(&word.to_uppercase()).unwrap();
            assert!(printed.starts_with(&format!("## {word}\n")), "{printed}");
            assert!(text.lines().count() > 1, "{word} has no meaning");
        }
        for word in ["claim", "careful", "NEES", "epoch"] {
            assert!(entry(word).is_ok(), "{word}");
        }
        let error = entry("clam").unwrap_err().to_string();
        assert!(error.contains("claim"), "{error}");
    }
}
