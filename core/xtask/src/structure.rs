//! Tests of the structure: a crate imports only crates of lower layers, and sibling modules do not import each other in
//! a circle.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::process;
use crate::workspace::Workspace;

/// Crates of the host, which plugins never import.
const HOST: [&str; 7] = ["engine", "host", "remote", "monitor", "record", "eval", "cli"];

/// A package of the workspace.
struct Package {
    name: String,
    /// Folder relative to the workspace's root.
    folder: PathBuf,
    floor: Option<u64>,
    /// Names of all packages that it depends on.
    imports: Vec<String>,
}

fn packages(workspace: &Workspace) -> Vec<Package> {
    let metadata = ["metadata", "--format-version", "1", "--no-deps", "--offline"];
    let text = process::capture(workspace.cargo().args(metadata)).expect("cargo reads the manifests");
    let json: Value = serde_json::from_str(&text).expect("JSON");
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let package = |package: &Value| {
        let manifest = PathBuf::from(package["manifest_path"].as_str().expect("a path"));
        let folder = manifest.parent().and_then(|folder| folder.strip_prefix(&workspace.root).ok());
        let imports = list(&package["dependencies"]).into_iter().filter(|import| import["kind"] != "dev");
        Package {
            name: package["name"].as_str().expect("a name").to_owned(),
            folder: folder.expect("a folder of the workspace").to_owned(),
            floor: package["metadata"]["floor"].as_u64(),
            imports: imports.map(|import| import["name"].as_str().expect("a name").to_owned()).collect(),
        }
    };
    list(&json["packages"]).iter().map(package).collect()
}

#[test]
fn crates_import_only_lower_floors() {
    let workspace = Workspace::locate().expect("a workspace");
    let packages = packages(&workspace);
    let floors: BTreeMap<&str, Option<u64>> = packages.iter().map(|p| (p.name.as_str(), p.floor)).collect();
    let mut wrong = Vec::new();
    for package in &packages {
        let Some(floor) = package.floor else {
            wrong.push(format!("{}: write `floor` into [package.metadata] of its Cargo.toml", package.name));
            continue;
        };
        for import in &package.imports {
            if let Some(Some(other)) = floors.get(import.as_str()).filter(|other| other.is_some_and(|o| o >= floor)) {
                wrong.push(format!("{} on floor {floor} imports {import} on floor {other}", package.name));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn plugins_import_neither_the_host_nor_each_other() {
    let workspace = Workspace::locate().expect("a workspace");
    let packages = packages(&workspace);
    let plugins: BTreeSet<&str> =
        packages.iter().filter(|p| p.folder.starts_with("plugins")).map(|p| p.name.as_str()).collect();
    assert!(plugins.len() > 5);
    let host: BTreeSet<String> = HOST.iter().map(|name| format!("panoscope-{name}")).collect();
    for package in packages.iter().filter(|package| plugins.contains(package.name.as_str())) {
        let wrong: Vec<&String> = package
            .imports
            .iter()
            .filter(|import| host.contains(*import) || plugins.contains(import.as_str()))
            .collect();
        assert!(wrong.is_empty(), "{} imports {wrong:?}", package.name);
    }
}

/// Path of a module in its crate; empty for the crate's root.
type Module = Vec<String>;

/// The modules of a crate by their paths, with their files.
fn modules(src: &Path) -> BTreeMap<Module, PathBuf> {
    let (mut modules, mut folders) = (BTreeMap::new(), vec![src.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let below = path.with_extension("");
                let below = below.strip_prefix(src).expect("a file of the crate");
                let mut module: Module = below.iter().map(|part| part.to_string_lossy().into_owned()).collect();
                if module.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
                    module.pop();
                }
                modules.insert(module, path);
            }
        }
    }
    modules
}

/// A source text without its test module, line comments and string literals.
fn code_of(text: &str) -> String {
    let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or(text);
    let mut code = String::new();
    for line in text.lines() {
        let mut is_text = false;
        let mut rest = line.chars().peekable();
        while let Some(c) = rest.next() {
            match c {
                '\\' if is_text => drop(rest.next()),
                '"' => is_text = !is_text,
                '/' if !is_text && rest.peek() == Some(&'/') => break,
                _ if !is_text => code.push(c),
                _ => {}
            }
        }
        code.push('\n');
    }
    code
}

/// The paths of a `use` tree, such as `a::b` and `a::c` of `a::{b, c}`.
fn paths_of(tree: &str, prefix: &[String], paths: &mut Vec<Vec<String>>) {
    let (mut depth, mut begin) = (0, 0);
    let ends = tree.char_indices().filter(|(_, c)| {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        depth == 0 && *c == ','
    });
    let mut branches = Vec::new();
    for end in ends.map(|(at, _)| at).chain([tree.len()]) {
        branches.push(tree[begin..end].trim());
        begin = (end + 1).min(tree.len());
    }
    let parts = |text: &str| {
        let text = text.split(" as ").next().unwrap_or(text);
        text.split("::").map(str::trim).filter(|part| !part.is_empty()).map(str::to_owned).collect::<Vec<_>>()
    };
    for branch in branches.into_iter().filter(|branch| !branch.is_empty()) {
        match branch.split_once('{') {
            Some((head, inner)) => {
                let prefix = [prefix, &parts(head)].concat();
                paths_of(inner.strip_suffix('}').unwrap_or(inner), &prefix, paths);
            }
            None => paths.push([prefix, &parts(branch)].concat()),
        }
    }
}

/// All paths that a source names: those of `use`, and those with `::` in between.
fn named(code: &str) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    let mut body = String::new();
    for statement in code.split_inclusive(';') {
        let begin = statement.rfind("use ").filter(|at| {
            let is_alone = |c: char| !c.is_alphanumeric() && c != '_';
            statement[..*at].chars().next_back().is_none_or(is_alone) && !statement[*at..].contains(['(', '='])
        });
        match begin {
            Some(at) => {
                body.push_str(&statement[..at]);
                paths_of(statement[at + 4..].trim_end_matches(';').trim(), &[], &mut paths);
            }
            None => body.push_str(statement),
        }
    }
    let is_path = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    for word in body.split(|c| !is_path(c)).filter(|word| word.contains("::") && !word.starts_with(':')) {
        paths.push(word.split("::").map(str::to_owned).collect());
    }
    paths
}

/// The modules that each module of a crate names.
fn imports(modules: &BTreeMap<Module, PathBuf>) -> BTreeMap<&Module, BTreeSet<Module>> {
    let mut all = BTreeMap::new();
    for (module, file) in modules {
        if file.ends_with("tests.rs") || module.iter().any(|part| part == "tests") {
            continue;
        }
        let text = std::fs::read_to_string(file).expect("a source file");
        let mut to = BTreeSet::new();
        for path in named(&code_of(&text)) {
            let is_child = modules.contains_key(&[module.as_slice(), &path[..1]].concat());
            let (mut at, mut rest) = match path[0].as_str() {
                "crate" => (Module::new(), &path[1..]),
                "self" => (module.clone(), &path[1..]),
                "super" => (module.clone(), &path[..]),
                _ if is_child => (module.clone(), &path[..]),
                _ => continue,
            };
            while rest.first().is_some_and(|part| part == "super") {
                at.pop();
                rest = &rest[1..];
            }
            for part in rest {
                at.push(part.clone());
                if !modules.keys().any(|known| known.starts_with(&at)) {
                    at.pop();
                    break;
                }
            }
            to.insert(at);
        }
        all.insert(module, to);
    }
    all
}

/// Cycles: groups of names that reach each other.
fn circles(edges: &BTreeMap<String, BTreeSet<String>>) -> Vec<BTreeSet<String>> {
    let reach = |from: &String| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from]);
        while let Some(name) = open.pop() {
            for next in edges.get(name).into_iter().flatten() {
                if seen.insert(next.clone()) {
                    open.push(next);
                }
            }
        }
        seen
    };
    let reached: BTreeMap<&String, BTreeSet<String>> = edges.keys().map(|name| (name, reach(name))).collect();
    let mut groups: Vec<BTreeSet<String>> = Vec::new();
    for (name, others) in &reached {
        if others.contains(*name) && !groups.iter().any(|group| group.contains(*name)) {
            let is_mutual = |other: &&String| reached.get(other).is_some_and(|back| back.contains(*name));
            groups.push(others.iter().filter(is_mutual).cloned().collect());
        }
    }
    groups
}

/// Cycles among the children of each module of a crate: the parent, and the children of each cycle.
fn circles_of(src: &Path) -> Vec<(String, BTreeSet<String>)> {
    let modules = modules(src);
    let imports = imports(&modules);
    let parents: BTreeSet<&[String]> =
        modules.keys().flat_map(|module| (0..module.len()).map(|depth| &module[..depth])).collect();
    let mut all = Vec::new();
    for parent in parents {
        let depth = parent.len();
        let mut edges: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (from, to) in imports.iter().filter(|(from, _)| from.len() > depth && from.starts_with(parent)) {
            let to = to.iter().filter(|to| to.len() > depth && to.starts_with(parent) && to[depth] != from[depth]);
            edges.entry(from[depth].clone()).or_default().extend(to.map(|to| to[depth].clone()));
        }
        all.extend(circles(&edges).into_iter().map(|circle| (parent.join("::"), circle)));
    }
    all
}

#[test]
fn sibling_modules_do_not_import_each_other_in_a_circle() {
    let workspace = Workspace::locate().expect("a workspace");
    let mut found = Vec::new();
    for package in packages(&workspace) {
        let circles = circles_of(&workspace.root.join(&package.folder).join("src"));
        found.extend(circles.iter().map(|(parent, circle)| {
            let crate_and_module = format!("{} {parent}", package.folder.display());
            format!("{}: {circle:?}", crate_and_module.trim())
        }));
    }
    assert!(
        found.is_empty(),
        "modules import each other in a circle; move what they share into a file of its own: {found:#?}"
    );
}

#[test]
fn a_circle_is_found_through_use_trees_and_paths() {
    let folder = std::env::temp_dir().join(format!("panoscope-structure-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("c")).expect("a folder");
    let files = [
        ("lib.rs", "mod a;\nmod b;\nmod c;\n"),
        ("a.rs", "use crate::{b::{B, Other as _}, c};\n// use crate::d;\n"),
        ("b.rs", "fn f() { super::c::inner::g(\"crate::b\"); }\n"),
        ("c/mod.rs", "mod inner;\n"),
        ("c/inner.rs", "pub fn g(_: &str) { let _ = crate::a::A; }\n#[cfg(test)]\nmod tests { use crate::b; }\n"),
    ];
    for (name, text) in files {
        std::fs::write(folder.join(name), text).expect("a file");
    }
    let circle: BTreeSet<String> = ["a", "b", "c"].map(str::to_owned).into();
    assert_eq!(circles_of(&folder), [(String::new(), circle)]);
    std::fs::write(folder.join("c/inner.rs"), "pub fn g(_: &str) {}\n").expect("a file");
    assert_eq!(circles_of(&folder), []);
    let _ = std::fs::remove_dir_all(&folder);
}
