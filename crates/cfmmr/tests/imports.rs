//! Import order of the crates' top modules, and absence of import cycles between files.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use syn::visit::{self, Visit};

/// Crates with their top modules, from the bottom up: a module imports modules before it only.
const ORDERS: &[(&str, &str)] = &[
    (
        "core-algos",
        "config math time topology acquisition control safety bus drive beam fusion node params link",
    ),
    (
        "crates/plant",
        "per_axle config elastica geometry lanes legendre reference sincos state wheel drivetrain frame loads \
         integrator drive",
    ),
    (
        "crates/virtual-board",
        "image noise time finding wire core chip board device workers network probe",
    ),
    (
        "crates/firmware-common",
        "accelerator crystal clock critical executors dma_halves crash_record stack fault watchdog task_watchdog supply store board_id \
         led time_driver timing record can identity link tick_loop board",
    ),
    ("host-sim", "base paths bus world scenario targets run"),
    ("crates/output", "terminal files progress table"),
    (
        "crates/remote",
        "interrupt serial_line board_log images link log_reader unanswered serial virtual_link board parameters relay board_link \
         serial_robot virtual_robot",
    ),
    (
        "crates/recording",
        "schema entry topics dbc csv tables log no_log writer tap",
    ),
    ("crates/view", "style plot figures animation page"),
    (
        "crates/cfmmr",
        "thinned no_dashboard dashboard experiments cli",
    ),
];

/// Names from the root of the crate to a module.
type Module = Vec<String>;

/// Paths from the root of the crate that a file names outside test modules.
struct Imports {
    module: Module,
    found: BTreeSet<Module>,
}

impl Imports {
    fn of(text: &str, module: &Module) -> BTreeSet<Module> {
        let module = module.clone();
        let found = BTreeSet::new();
        let mut imports = Self { module, found };
        imports.visit_file(&syn::parse_file(text).unwrap());
        imports.found
    }

    fn add(&mut self, path: &[String]) {
        let supers = path.iter().take_while(|part| *part == "super").count();
        let root = match path[0].as_str() {
            "crate" => Vec::new(),
            "self" => self.module.clone(),
            "super" => self.module[..self.module.len() - supers].to_vec(),
            _ => return,
        };
        let rest = &path[supers.max(1)..];
        self.found.insert([root.as_slice(), rest].concat());
    }

    fn tree(&mut self, tree: &syn::UseTree, prefix: &[String]) {
        let longer = |name: &syn::Ident| [prefix, &[name.to_string()]].concat();
        match tree {
            syn::UseTree::Path(path) => self.tree(&path.tree, &longer(&path.ident)),
            syn::UseTree::Name(name) => self.add(&longer(&name.ident)),
            syn::UseTree::Rename(name) => self.add(&longer(&name.ident)),
            syn::UseTree::Glob(_) => self.add(prefix),
            syn::UseTree::Group(group) => {
                group.items.iter().for_each(|item| self.tree(item, prefix));
            }
        }
    }
}

fn is_test(attribute: &syn::Attribute) -> bool {
    let test = |path: syn::Path| path.is_ident("test");
    attribute.path().is_ident("cfg") && attribute.parse_args().is_ok_and(test)
}

impl<'ast> Visit<'ast> for Imports {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        if !module.attrs.iter().any(is_test) {
            self.module.push(module.ident.to_string());
            visit::visit_item_mod(self, module);
            self.module.pop();
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        if !item.attrs.iter().any(is_test) {
            self.tree(&item.tree, &[]);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Module = path.segments.iter().map(|s| s.ident.to_string()).collect();
        if names.len() > 1 {
            self.add(&names);
        }
        visit::visit_path(self, path);
    }
}

/// Every module file below `folder`, with the modules that it imports.
fn graph(folder: &Path) -> BTreeMap<Module, BTreeSet<Module>> {
    let mut texts = BTreeMap::new();
    let mut folders = vec![(folder.to_owned(), Module::new())];
    while let Some((folder, above)) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            let module = [above.as_slice(), std::slice::from_ref(&name)].concat();
            if path.is_dir() {
                if name != "tests" {
                    folders.push((path, module));
                }
            } else if name == "mod" {
                texts.insert(above.clone(), fs::read_to_string(path).unwrap());
            } else if path.extension().is_some_and(|e| e == "rs")
                && !["lib", "main", "tests", "properties"].contains(&name.as_str())
            {
                texts.insert(module, fs::read_to_string(path).unwrap());
            }
        }
    }
    let file_of = |path: &Module| {
        let prefixes = (1..=path.len()).rev().map(|n| path[..n].to_vec());
        prefixes
            .into_iter()
            .find(|prefix| texts.contains_key(prefix))
    };
    let of = |(module, text): (&Module, &String)| {
        let found = Imports::of(text, module);
        let files = found.iter().filter_map(file_of);
        (
            module.clone(),
            files.filter(|file| file != module).collect(),
        )
    };
    texts.iter().map(of).collect()
}

fn sources(name: &str) -> BTreeMap<Module, BTreeSet<Module>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    graph(&root.join(name).join("src"))
}

#[test]
fn modules_import_only_modules_before_them() {
    let mut report = String::new();
    for (name, order) in ORDERS {
        let place = |module: &Module| {
            let place = order
                .split_whitespace()
                .position(|other| other == module[0]);
            place.unwrap_or_else(|| panic!("{name}: {} is not in the order", module[0]))
        };
        for (module, imports) in &sources(name) {
            for other in imports.iter().filter(|other| place(other) > place(module)) {
                report += &format!("{name}: {} -> {}\n", module.join("::"), other.join("::"));
            }
        }
    }
    assert!(report.is_empty(), "imports against the order:\n{report}");
}

/// Imports from a module's parent are not counted, because a parent re-exports items of its children.
#[test]
fn files_have_no_import_cycle() {
    for (name, _) in ORDERS {
        let mut left = sources(name);
        for (module, imports) in &mut left {
            imports.retain(|other| !module.starts_with(other));
        }
        loop {
            let leaves: Vec<Module> = left
                .iter()
                .filter(|(_, imports)| imports.iter().all(|other| !left.contains_key(other)))
                .map(|(module, _)| module.clone())
                .collect();
            if leaves.is_empty() {
                break;
            }
            leaves.iter().for_each(|leaf| drop(left.remove(leaf)));
        }
        let left: Vec<String> = left.keys().map(|module| module.join("::")).collect();
        assert!(left.is_empty(), "{name}: in or above a circle: {left:?}");
    }
}

/// Experiments do not depend on the parser of the command line.
#[test]
fn experiments_do_not_use_clap() {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src/experiments")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let text = fs::read_to_string(&path).unwrap();
            assert!(!text.contains("clap"), "{}", path.display());
        }
    }
}
