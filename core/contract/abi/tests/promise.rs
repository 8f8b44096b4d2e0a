//! The ABI's promise: the contract does not change without its version number, and a minor version only appends.
//!
//! `contract.txt` keeps the declarations of the last version, without comments. PANOSCOPE_BLESS=1 writes it anew, but
//! only for a version number that is new.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use panoscope_abi::{ABI_MAJOR, ABI_MINOR};

/// A version of the contract.
#[derive(Clone, Debug, PartialEq)]
struct Contract {
    major: u32,
    minor: u32,
    /// Declarations in the order of the header, one a line, without comments.
    declarations: Vec<String>,
}

/// Result of comparing a contract with the stored one.
#[derive(Debug, PartialEq)]
enum Verdict {
    /// Same version, same declarations.
    Unchanged,
    /// A new version that keeps the promise; it has to be written down.
    NewVersion,
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn without_comments(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(start) = rest.find("/*") {
        out.push_str(&rest[..start]);
        let end = rest[start..].find("*/").expect("comments are closed");
        rest = &rest[start + end + 2..];
    }
    out + rest
}

/// The declarations of a header: a line per `#` line, struct, type and assertion.
fn declarations(header: &str) -> Vec<String> {
    let text = without_comments(header).replace("\\\n", " ");
    let (mut out, mut open, mut depth) = (Vec::new(), String::new(), 0_i32);
    for line in text.lines() {
        let words = line.split_whitespace().collect::<Vec<_>>().join(" ");
        if words.is_empty() {
            continue;
        }
        if open.is_empty() && words.starts_with('#') {
            out.push(words);
            continue;
        }
        for c in words.chars() {
            depth += i32::from(c == '{') - i32::from(c == '}');
        }
        if !open.is_empty() {
            open.push(' ');
        }
        open.push_str(&words);
        if depth == 0 && (words.ends_with(';') || words.ends_with('{')) || words == "}" && depth <= 0 {
            out.push(std::mem::take(&mut open));
        }
    }
    assert!(open.trim().is_empty(), "a declaration does not end: {open}");
    out
}

impl Contract {
    /// The contract in a header. `helpers`, a part of the header, is code for authors in C: plugins carry their own
    /// copy.
    fn of_header(header: &str, helpers: &str, (major, minor): (u32, u32)) -> Self {
        assert!(header.contains(helpers), "the header contains the helpers as they are");
        let is_version =
            |line: &String| ["MAJOR", "MINOR"].iter().any(|v| line.starts_with(&format!("#define PANOSCOPE_ABI_{v} ")));
        let mut declarations = declarations(&header.replace(helpers, "\n"));
        declarations.retain(|line| !is_version(line));
        Self { major, minor, declarations }
    }

    fn parse(text: &str) -> Option<Self> {
        let (first, rest) = text.split_once('\n')?;
        let (major, minor) = first.strip_prefix("abi ")?.split_once('.')?;
        let declarations = rest.lines().map(str::to_owned).collect();
        Some(Self { major: major.parse().ok()?, minor: minor.parse().ok()?, declarations })
    }

    fn text(&self) -> String {
        let mut out = format!("abi {}.{}\n", self.major, self.minor);
        for line in &self.declarations {
            writeln!(out, "{line}").expect("writing to a string");
        }
        out
    }

    /// Compares this contract with the stored one, `kept`.
    fn verdict(&self, kept: &Contract) -> Result<Verdict, String> {
        let version = (self.major, self.minor);
        let first_difference = || {
            let lost = kept.declarations.iter().find(|line| !self.declarations.contains(line));
            let new = self.declarations.iter().find(|line| !kept.declarations.contains(line));
            lost.map(|l| format!("- {l}\n")).unwrap_or_default() + &new.map(|l| format!("+ {l}")).unwrap_or_default()
        };
        match version.cmp(&(kept.major, kept.minor)) {
            std::cmp::Ordering::Less => {
                Err(format!("the version fell from {}.{} to {}.{}", kept.major, kept.minor, self.major, self.minor))
            }
            std::cmp::Ordering::Equal if self.declarations == kept.declarations => Ok(Verdict::Unchanged),
            std::cmp::Ordering::Equal => Err(format!(
                "the contract changed and its version did not: raise ABI_MINOR in core/contract/abi/src/lib.rs if you only appended, else \
                 ABI_MAJOR; then bless\n{}",
                first_difference()
            )),
            std::cmp::Ordering::Greater if self.major > kept.major => Ok(Verdict::NewVersion),
            std::cmp::Ordering::Greater => self.appends_to(kept).map(|()| Verdict::NewVersion),
        }
    }

    /// A minor version keeps every declaration; structs that carry their size may have new fields at their end, and a
    /// reserved field may get a name.
    fn appends_to(&self, kept: &Contract) -> Result<(), String> {
        for old in &kept.declarations {
            let survives = self.declarations.contains(old)
                || self.declarations.iter().any(|new| grew(old, new) || names_reserved(old, new));
            if !survives {
                return Err(format!("this declaration changed or is gone, which takes a new ABI_MAJOR: {old}"));
            }
        }
        Ok(())
    }
}

/// Whether `new` is `old` with more at its end, where the promise allows that.
fn grew(old: &str, new: &str) -> bool {
    // The size that a struct has, which grows with it: whether it may grow is decided by the struct's own line.
    if let Some((name, _)) = old.strip_prefix("PANOSCOPE_ASSERT(sizeof(").and_then(|rest| rest.split_once(')')) {
        return new.starts_with(&format!("PANOSCOPE_ASSERT(sizeof({name})"));
    }
    let Some((head, rest)) = old.split_once(" { ") else { return false };
    let Some((fields, _)) = rest.rsplit_once(" }") else { return false };
    fields.contains("uint32_t struct_size; ") && new.starts_with(&format!("{head} {{ {fields} "))
}

/// Whether `new` is `old` with names for reserved fields of the same types. Plugins of older versions write 0 there.
fn names_reserved(old: &str, new: &str) -> bool {
    let is_kept = |(old, new): (&str, &str)| {
        let named = old.strip_suffix(" reserved").zip(new.rsplit_once(' '));
        old == new || named.is_some_and(|(kind, (new_kind, _))| kind == new_kind)
    };
    old.split("; ").count() == new.split("; ").count() && old.split("; ").zip(new.split("; ")).all(is_kept)
}

#[test]
fn the_contract_changes_only_with_its_version() {
    let read = |path: &Path| std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let header = read(&root().join("panoscope.h"));
    let helpers = read(&root().join("src/helpers.h"));
    let now = Contract::of_header(&header, &helpers, (ABI_MAJOR, ABI_MINOR));
    assert!(now.declarations.len() > 100, "{} declarations", now.declarations.len());
    let path = root().join("tests/contract.txt");
    let kept = Contract::parse(&read(&path)).expect("contract.txt opens with `abi MAJOR.MINOR`");
    // Also when blessing: a contract that breaks the promise is never written down.
    let verdict = now.verdict(&kept).unwrap_or_else(|why| panic!("{why}"));
    if verdict == Verdict::NewVersion {
        assert!(
            std::env::var_os("PANOSCOPE_BLESS").is_some(),
            "ABI {}.{} is not written down yet: PANOSCOPE_BLESS=1 cargo test -p panoscope-abi does so",
            now.major,
            now.minor
        );
        std::fs::write(&path, now.text()).expect("contract.txt can be written");
    }
}

const OLD: &str = "#define PANOSCOPE_ABI_MINOR 2
/** A number. */
#define PANOSCOPE_A 1
typedef struct PanoscopeHost {
    /** Its size. */
    uint32_t struct_size;
    void (*log)(void *ctx,
                int level);
} PanoscopeHost;
typedef struct PanoscopeTick {
    uint64_t seq;
    uint32_t reserved;
} PanoscopeTick;
PANOSCOPE_ASSERT(sizeof(PanoscopeHost) == 16);
// helpers
";

fn contract(header: &str, version: (u32, u32)) -> Contract {
    Contract::of_header(header, "// helpers\n", version)
}

#[test]
fn comments_are_no_part_of_the_contract_and_texts_survive() {
    let old = contract(OLD, (1, 2));
    assert_eq!(
        old.declarations,
        [
            "#define PANOSCOPE_A 1",
            "typedef struct PanoscopeHost { uint32_t struct_size; void (*log)(void *ctx, int level); } PanoscopeHost;",
            "typedef struct PanoscopeTick { uint64_t seq; uint32_t reserved; } PanoscopeTick;",
            "PANOSCOPE_ASSERT(sizeof(PanoscopeHost) == 16);",
        ]
    );
    assert_eq!(Contract::parse(&old.text()), Some(old.clone()));
    let commented = contract(&OLD.replace("Its size.", "Size of this struct.").replace("MINOR 2", "MINOR 7"), (1, 2));
    assert_eq!(commented.verdict(&old), Ok(Verdict::Unchanged));
}

#[test]
fn a_change_needs_a_version_and_a_minor_one_only_appends() {
    let old = contract(OLD, (1, 2));
    let longer = OLD.replace("} PanoscopeHost", "    uint32_t more;\n} PanoscopeHost").replace("== 16", "== 24")
        + "#define PANOSCOPE_B 2\n";
    assert!(contract(&longer, (1, 2)).verdict(&old).is_err_and(|why| why.contains("its version did not")));
    assert!(contract(&longer, (1, 1)).verdict(&old).is_err_and(|why| why.contains("fell from 1.2 to 1.1")));
    assert_eq!(contract(&longer, (1, 3)).verdict(&old), Ok(Verdict::NewVersion));
    let named = OLD.replace("uint32_t reserved", "uint32_t source");
    assert_eq!(contract(&named, (1, 3)).verdict(&old), Ok(Verdict::NewVersion));
    for (from, to) in [
        ("PANOSCOPE_A 1", "PANOSCOPE_A 2"),
        ("int level", "long level"),
        ("    uint32_t struct_size;\n", "    uint32_t struct_size;\n    uint32_t between;\n"),
        // It does not carry its size, so the other side could not know.
        ("    uint64_t seq;\n", "    uint64_t seq;\n    uint64_t more;\n"),
        ("uint64_t seq", "uint64_t number"),
        ("uint32_t reserved", "int32_t source"),
        ("typedef struct PanoscopeTick {\n    uint64_t seq;\n    uint32_t reserved;\n} PanoscopeTick;\n", ""),
    ] {
        assert!(OLD.contains(from), "{from}");
        let broken = OLD.replace(from, to);
        let verdict = contract(&broken, (1, 3)).verdict(&old);
        assert!(verdict.is_err_and(|why| why.contains("takes a new ABI_MAJOR")), "{to}");
        assert_eq!(contract(&broken, (2, 0)).verdict(&old), Ok(Verdict::NewVersion), "{to}");
    }
}
