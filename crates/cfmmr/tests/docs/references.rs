//! Links, files and names in the pages.

use super::pages::{self, Code, Page, root};
use std::collections::HashMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

/// A path without `.` and `..`.
fn normal(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => {
                out.pop();
            }
            other => out.push(other),
        }
    }
    out
}

fn assert_none(wrong: Vec<String>) {
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn targets_of_links_exist() {
    let pages = pages::all();
    let anchors: HashMap<&Path, &[String]> = pages
        .iter()
        .map(|page| (page.path.as_path(), page.anchors.as_slice()))
        .collect();
    let mut wrong = Vec::new();
    for page in &pages {
        for (link, line) in &page.links {
            let place = format!("{}:{line}: {link}", page.path.display());
            if ["https://", "http://", "mailto:"]
                .iter()
                .any(|start| link.starts_with(start))
            {
                continue;
            }
            let (file, anchor) = match link.split_once('#') {
                Some((file, anchor)) => (file, Some(anchor)),
                None => (link.as_str(), None),
            };
            let target = match file {
                "" => page.path.clone(),
                file => normal(&page.path.parent().unwrap().join(file)),
            };
            if !root().join(&target).exists() {
                wrong.push(format!("{place}: no such file"));
            } else if let Some(anchor) = anchor {
                let known = anchors.get(target.as_path());
                if !known.is_some_and(|known| known.iter().any(|known| known == anchor)) {
                    wrong.push(format!("{place}: no such heading"));
                }
            }
        }
    }
    assert_none(wrong);
}

#[test]
fn every_page_and_picture_is_in_the_index() {
    let pages = pages::all();
    let index = Path::new("docs/README.md");
    let index = pages.iter().find(|page| page.path == index).unwrap();
    let mut named: Vec<PathBuf> = index
        .links
        .iter()
        .map(|(link, _)| normal(&Path::new("docs").join(link.split('#').next().unwrap())))
        .collect();
    named.push(index.path.clone());
    let pictures = fs::read_dir(root().join("docs/images")).unwrap();
    let pictures = pictures.map(|entry| Path::new("docs/images").join(entry.unwrap().file_name()));
    let wrong = pages
        .iter()
        .map(|page| page.path.clone())
        .filter(|path| path.starts_with("docs"))
        .chain(pictures)
        .filter(|path| !named.contains(path))
        .map(|path| format!("{}: not in docs/README.md", path.display()));
    assert_none(wrong.collect());
}

/// File of the repository that a piece of code names, if the code looks like a path.
fn file_of(code: &str) -> Option<&str> {
    let first = code.split('/').next()?;
    let not_committed = ["", "target", "out", ".git", ".", ".."];
    if code.contains(char::is_whitespace)
        || not_committed.contains(&first)
        || !root().join(first).exists()
    {
        return None;
    }
    let is_path = code.contains('/') || Path::new(code).extension().is_some();
    is_path.then_some(code)
}

#[test]
fn files_named_in_the_text_exist() {
    let mut wrong = Vec::new();
    for page in pages::all() {
        for code in &page.codes {
            let Some(file) = file_of(&code.text) else {
                continue;
            };
            // Of a pattern with `*`, only the folder must exist.
            let path = match file.split_once('*') {
                Some((before, _)) => before.rsplit_once('/').map_or("", |(folder, _)| folder),
                None => file,
            };
            if !root().join(path).exists() {
                let place = format!("{}:{}", page.path.display(), code.line);
                wrong.push(format!("{place}: {}: no such file", code.text));
            }
        }
    }
    assert_none(wrong);
}

fn is_source(code: &Code) -> bool {
    code.text.ends_with(".rs") && file_of(&code.text).is_some()
}

fn is_item(code: &Code) -> bool {
    let mut letters = code.text.chars();
    letters.next().is_some_and(|c| c.is_alphabetic())
        && letters.all(|c| c.is_alphanumeric() || c == '_' || c == ':')
}

/// Pairs of a source file and an item that the page says is in the file. In a table cell these are the items after the
/// file, in the text the items of "`item`, `item` in `file`".
fn items_of(page: &Page) -> Vec<(&Code, &Code)> {
    let mut found = Vec::new();
    for (k, file) in page.codes.iter().enumerate().filter(|(_, c)| is_source(c)) {
        if file.cell.is_some() {
            let items = page.codes[k + 1..].iter();
            let items = items.take_while(|item| item.cell == file.cell && !is_source(item));
            found.extend(items.filter(|item| is_item(item)).map(|item| (file, item)));
        }
        let joined = |code: &Code, by: &[&str]| {
            let between = code.between.as_deref().map(str::trim);
            between.is_some_and(|between| by.contains(&between))
        };
        let (mut behind, mut by) = (file, &["in", "of"][..]);
        for item in page.codes[..k].iter().rev() {
            if !(joined(behind, by) && is_item(item)) {
                break;
            }
            found.push((file, item));
            (behind, by) = (item, &[",", "and"]);
        }
    }
    found
}

/// True if the text contains the word.
fn has_word(text: &str, word: &str) -> bool {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word)
        .any(|(at, _)| !text[..at].ends_with(part) && !text[at + word.len()..].starts_with(part))
}

#[test]
fn items_named_with_a_file_are_in_it() {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for page in pages::all() {
        for (file, item) in items_of(&page) {
            let text = fs::read_to_string(root().join(&file.text)).unwrap_or_default();
            count += 1;
            // Both words of `Type::function` must be in the file.
            if !item.text.split("::").all(|word| has_word(&text, word)) {
                let place = format!("{}:{}", page.path.display(), item.line);
                wrong.push(format!("{place}: {} is not in {}", item.text, file.text));
            }
        }
    }
    assert_none(wrong);
    // The table in docs/theory.md alone names that many items, so fewer mean that the search failed.
    assert!(count > 80, "only {count} found");
}

#[test]
fn wrong_references_are_found() {
    let page = pages::parse(
        "docs/page.md".into(),
        "| a |\n|---|\n| `ci.sh`, `core-algos/src/lib.rs`: `math`, `no_such_module` |\n\n\
         `math` and `gone` in `core-algos/src/lib.rs`, `not this` of `core-algos/src/lib.rs`\n",
    );
    let found = items_of(&page);
    let names: Vec<&str> = found.iter().map(|(_, item)| item.text.as_str()).collect();
    assert_eq!(names, ["math", "no_such_module", "gone", "math"]);
    assert!(has_word("pub mod math;", "math") && !has_word("mathematics", "math"));
    assert_eq!(
        file_of("docs/no_such_page.md"),
        Some("docs/no_such_page.md")
    );
    assert_eq!(file_of("target/release/cfmmr"), None);
    assert_eq!(file_of("/lead.nis"), None);
}
