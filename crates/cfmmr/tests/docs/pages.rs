//! Checked parts of a page: headings, links, code.

use pulldown_cmark::{CodeBlockKind, Event, LinkType, Options, Parser, Tag, TagEnd};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

/// A block of code.
pub struct Block {
    /// Words after the fence: language, and the name of the file to write.
    pub info: Vec<String>,
    pub text: String,
    pub line: usize,
}

impl Block {
    pub fn language(&self) -> &str {
        self.info.first().map_or("", String::as_str)
    }
}

/// Inline code in the text of a page.
pub struct Code {
    pub text: String,
    pub line: usize,
    /// Number of the table cell that contains the code.
    pub cell: Option<usize>,
    /// Text between the preceding code in the same paragraph or cell and this code.
    pub between: Option<String>,
}

pub struct Page {
    /// Path from the root of the repository.
    pub path: PathBuf,
    pub blocks: Vec<Block>,
    pub codes: Vec<Code>,
    /// Link destinations with line numbers.
    pub links: Vec<(String, usize)>,
    pub anchors: Vec<String>,
}

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// README, CONTRIBUTING, SECURITY and every page in `docs/`, by name.
pub fn all() -> Vec<Page> {
    let entries = fs::read_dir(root().join("docs")).unwrap();
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| Path::new("docs").join(entry.unwrap().file_name()))
        .filter(|path| path.extension().is_some_and(|kind| kind == "md"))
        .collect();
    paths.extend(["README.md", "CONTRIBUTING.md", "SECURITY.md"].map(PathBuf::from));
    paths.sort();
    paths.into_iter().map(read).collect()
}

fn read(path: PathBuf) -> Page {
    let text = fs::read_to_string(root().join(&path)).unwrap();
    parse(path, &text)
}

pub fn parse(path: PathBuf, text: &str) -> Page {
    let mut page = Page {
        path,
        blocks: Vec::new(),
        codes: Vec::new(),
        links: Vec::new(),
        anchors: Vec::new(),
    };
    let (mut heading, mut block): (Option<String>, Option<Block>) = (None, None);
    let (mut cells, mut cell) = (0, None);
    let mut between: Option<String> = None;
    let mut repeats: HashMap<String, usize> = HashMap::new();
    let events = Parser::new_ext(text, Options::ENABLE_TABLES).into_offset_iter();
    for (event, range) in events {
        let line = 1 + text[..range.start].matches('\n').count();
        match event {
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::End(TagEnd::Heading(_)) => {
                let anchor = anchor(&heading.take().unwrap());
                let repeat_count = repeats.entry(anchor.clone()).or_insert(0);
                page.anchors.push(match *repeat_count {
                    0 => anchor,
                    n => format!("{anchor}-{n}"),
                });
                *repeat_count += 1;
            }
            Event::Start(Tag::CodeBlock(kind)) => {
                let info = match &kind {
                    CodeBlockKind::Fenced(info) => info.split_whitespace().map(Into::into),
                    CodeBlockKind::Indented => panic!("{:?}:{line}: not fenced", page.path),
                };
                block = Some(Block {
                    info: info.collect(),
                    text: String::new(),
                    line,
                });
            }
            Event::End(TagEnd::CodeBlock) => page.blocks.extend(block.take()),
            Event::Start(Tag::TableCell) => {
                cells += 1;
                cell = Some(cells);
                between = None;
            }
            Event::End(TagEnd::TableCell) => cell = None,
            Event::Start(Tag::Paragraph | Tag::Item) => between = None,
            Event::Start(Tag::Link {
                link_type,
                dest_url,
                ..
            }) if link_type != LinkType::Email => page.links.push((dest_url.into(), line)),
            Event::Start(Tag::Image { dest_url, .. }) => page.links.push((dest_url.into(), line)),
            Event::Code(code) => {
                if let Some(heading) = &mut heading {
                    *heading += &code;
                }
                page.codes.push(Code {
                    text: code.into(),
                    line,
                    cell,
                    between: between.replace(String::new()),
                });
            }
            Event::Text(words) => {
                let block = block.as_mut().map(|block| &mut block.text);
                let open = [heading.as_mut(), block, between.as_mut()];
                for text in open.into_iter().flatten() {
                    *text += &words;
                }
            }
            Event::SoftBreak | Event::HardBreak => {
                if let Some(between) = &mut between {
                    between.push(' ');
                }
            }
            _ => {}
        }
    }
    page
}

fn anchor(heading: &str) -> String {
    heading
        .trim()
        .to_lowercase()
        .chars()
        .filter_map(|c| match c {
            ' ' => Some('-'),
            '-' | '_' => Some(c),
            _ => c.is_alphanumeric().then_some(c),
        })
        .collect()
}

#[test]
fn anchors_match_those_of_common_renderers() {
    let page = parse(
        "page.md".into(),
        "# What only *silicon* can show\n## A `cfmmr` (1.5 m), twice\n## A `cfmmr` (1.5 m), twice\n",
    );
    let expected = [
        "what-only-silicon-can-show",
        "a-cfmmr-15-m-twice",
        "a-cfmmr-15-m-twice-1",
    ];
    assert_eq!(page.anchors, expected);
}
