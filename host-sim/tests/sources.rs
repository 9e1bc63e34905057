//! Sizes of the sources: lines of each file, lines of each function.

use proc_macro2::Span;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};

/// Largest number of lines of a file, test modules excluded.
const FILE: usize = 600;
/// Largest number of lines of a function.
const FUNCTION: usize = 80;

/// Numeric kernels: one formula that reads best as a whole.
const KERNELS: &[&str] = &[
    "core-algos/src/fusion/joint.rs: predict",
    "crates/plant/src/frame/newton.rs: factor",
    "crates/plant/src/frame/newton.rs: newton",
    "crates/plant/src/integrator.rs: advance",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// Every Rust file below `folder`, build results excluded.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy();
        if path.is_dir() && name != "target" && name != "out" && !name.starts_with('.') {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

/// Path from the root and text of every Rust file.
fn sources() -> BTreeMap<String, String> {
    let mut files = Vec::new();
    collect(root(), &mut files);
    let read = |path: PathBuf| {
        let name = path.strip_prefix(root()).unwrap().to_str().unwrap();
        (name.to_owned(), fs::read_to_string(&path).unwrap())
    };
    files.into_iter().map(read).collect()
}

/// True for sources whose files and functions are limited: no tests.
fn is_limited(path: &str) -> bool {
    let tests = path.ends_with("/tests.rs") || path.split('/').any(|part| part == "tests");
    !tests
}

/// Lines of test modules and of the functions outside of them.
#[derive(Default)]
struct Lines {
    tests: usize,
    functions: Vec<(String, usize)>,
}

impl Lines {
    fn of(text: &str) -> Self {
        let mut lines = Self::default();
        lines.visit_file(&syn::parse_file(text).unwrap());
        lines
    }

    fn function(&mut self, signature: &syn::Signature, body: &syn::Block) {
        let lines = height(signature.span().join(body.span()).unwrap());
        self.functions.push((signature.ident.to_string(), lines));
    }
}

fn height(span: Span) -> usize {
    span.end().line - span.start().line + 1
}

impl<'ast> Visit<'ast> for Lines {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        let is_test = |attribute: &syn::Attribute| {
            attribute.path().is_ident("cfg")
                && attribute
                    .parse_args::<syn::Path>()
                    .is_ok_and(|path| path.is_ident("test"))
        };
        if module.attrs.iter().any(is_test) {
            self.tests += height(module.span());
        } else {
            visit::visit_item_mod(self, module);
        }
    }

    fn visit_item_fn(&mut self, function: &'ast syn::ItemFn) {
        self.function(&function.sig, &function.block);
        visit::visit_item_fn(self, function);
    }

    fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
        self.function(&function.sig, &function.block);
        visit::visit_impl_item_fn(self, function);
    }

    fn visit_trait_item_fn(&mut self, function: &'ast syn::TraitItemFn) {
        if let Some(body) = &function.default {
            self.function(&function.sig, body);
        }
        visit::visit_trait_item_fn(self, function);
    }
}

#[test]
fn files_without_tests_have_at_most_600_lines() {
    let mut longer = Vec::new();
    for (path, text) in sources().into_iter().filter(|(path, _)| is_limited(path)) {
        let lines = text.lines().count() - Lines::of(&text).tests;
        if lines > FILE {
            longer.push(format!("{path}: {lines} lines"));
        }
    }
    assert!(longer.is_empty(), "above {FILE} lines: {longer:#?}");
}

#[test]
fn functions_have_at_most_80_lines() {
    let mut longer = Vec::new();
    for (path, text) in sources().into_iter().filter(|(path, _)| is_limited(path)) {
        let functions = Lines::of(&text).functions.into_iter();
        let functions = functions.filter(|(_, lines)| *lines > FUNCTION);
        longer.extend(functions.map(|(name, _)| format!("{path}: {name}")));
    }
    longer.sort();
    assert_eq!(longer, KERNELS, "functions above {FUNCTION} lines");
}
