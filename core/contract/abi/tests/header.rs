//! `panoscope.h` is made from this crate's sources and must be current. `PANOSCOPE_BLESS=1` renews it.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_abi as abi;

const SOURCES: [&str; 7] = ["lib.rs", "frame.rs", "packets.rs", "note.rs", "device.rs", "call.rs", "descriptor.rs"];

const HEAD: &str = "/*
 * The binary contract between the Panoscope host and its plugins.
 *
 * Made from core/contract/abi by its test `header` (PANOSCOPE_BLESS=1 renews it): do not edit. Only plain data crosses; texts are
 * UTF-8 with a length; fields are only ever appended, and structs that may grow open with their own size.
 * A plugin exports `const PanoscopePlugin *panoscope_plugin(void)` and carries a PANOSCOPE_NOTE.
 * Build: cc -shared -fPIC -fvisibility=hidden, for C++ also -fno-gnu-unique.
 */";

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Names after `pub const`, `pub struct`, `pub type` at the start of a line: what C may see.
fn names(keyword: &str, text: &str, into: &mut BTreeSet<String>) {
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix(keyword) {
            into.insert(rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect());
        }
    }
}

fn generate() -> String {
    let mut builder = cbindgen::Builder::new();
    let (mut types, mut consts) = (BTreeSet::new(), BTreeSet::new());
    for source in SOURCES {
        let path = root().join("src").join(source);
        let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        names("pub struct ", &text, &mut types);
        names("pub type ", &text, &mut types);
        names("pub const ", &text, &mut consts);
        builder = builder.with_src(path);
    }
    consts.remove("fn");
    let mut config = cbindgen::Config {
        language: cbindgen::Language::C,
        cpp_compat: true,
        header: Some(HEAD.to_owned()),
        include_guard: Some("PANOSCOPE_H".to_owned()),
        style: cbindgen::Style::Both,
        usize_is_size_t: true,
        no_includes: true,
        sys_includes: ["stddef.h", "stdint.h", "string.h"].map(str::to_owned).to_vec(),
        documentation_style: cbindgen::DocumentationStyle::Doxy,
        line_length: 120,
        tab_width: 4,
        ..cbindgen::Config::default()
    };
    config.layout.aligned_n = Some("PANOSCOPE_ALIGNED".to_owned());
    config.after_includes = Some("\n#define PANOSCOPE_ALIGNED(BYTES) __attribute__((aligned(BYTES)))".to_owned());
    // Structs that no function mentions are part of the contract too.
    config.export.include = types.iter().cloned().collect();
    for name in &types {
        config.export.rename.insert(name.clone(), format!("Panoscope{name}"));
    }
    for name in &consts {
        config.export.rename.insert(name.clone(), format!("PANOSCOPE_{name}"));
    }
    config.export.exclude = ["FNV_START", "NOTE_OWNER", "EMPTY"].map(str::to_owned).to_vec();
    let mut bytes = Vec::new();
    builder.with_config(config).generate().expect("the sources have a C form").write(&mut bytes);
    let generated = String::from_utf8(bytes).expect("headers are UTF-8");
    let mut generated = links_to_c(&generated, &types);
    for family in [
        "CALL_", "DEVICE_", "FORMAT_", "HOME_", "INPUT_", "KIND_", "LOG_", "NODE_", "PARAM_", "PORT_", "PROBLEM_",
        "STATE_", "STATUS_",
    ] {
        generated = generated.replace(&format!("`{family}"), &format!("`PANOSCOPE_{family}"));
    }
    let generated: String = generated
        .lines()
        .map(|line| match line.strip_prefix("#define ").and_then(|rest| rest.split_once(" -")) {
            Some((name, number)) => format!("#define {name} (-{number})\n"),
            None => format!("{line}\n"),
        })
        .collect();
    let end = generated.rfind("#endif").expect("an include guard");
    let helpers = std::fs::read_to_string(root().join("src/helpers.h")).expect("helpers.h is there");
    format!("{}{}\n{helpers}\n{}", &generated[..end], sizes(), &generated[end..])
}

/// Rust's links in comments, such as "[`crate::Call`]", as the names that C knows.
fn links_to_c(text: &str, types: &BTreeSet<String>) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(start) = rest.find("[`") {
        let Some(len) = rest[start..].find("`]") else { break };
        let name = rest[start + 2..start + len].trim_start_matches("crate::");
        out.push_str(&rest[..start]);
        match name.split_once("::") {
            Some((owner, field)) => write!(out, "Panoscope{owner}.{field}"),
            None if types.contains(name) => write!(out, "Panoscope{name}"),
            None => write!(out, "PANOSCOPE_{name}"),
        }
        .expect("writing to a string");
        rest = &rest[start + len + 2..];
    }
    out + rest
}

/// Assertions that the C compiler lays the structs out as Rust does.
fn sizes() -> String {
    let mut out = format!(
        "/** The one symbol that a plugin exports. */\n#define PANOSCOPE_ENTRY_SYMBOL \"{}\"\n\n\
         /** ELF section that holds the note. */\n#define PANOSCOPE_NOTE_SECTION \"{}\"\n\n\
         /** Name of the output that tells where the links of an arm join. */\n#define PANOSCOPE_LINKS \"{}\"\n\
         /** Columns of its table: a row per joint from the base to the camera, in the frame of the node's pose. */\n\
         #define PANOSCOPE_LINK_COLUMNS \"{}\"\n\n",
        abi::ENTRY_SYMBOL,
        abi::NOTE_SECTION,
        abi::LINKS,
        abi::LINK_COLUMNS.join("\\n")
    );
    out.push_str(
        "/* The layout that the host was built with, on 64-bit systems. */\n#ifdef __cplusplus\n#define PANOSCOPE_ASSERT(CONDITION) \
         static_assert(CONDITION, #CONDITION)\n#else\n#define PANOSCOPE_ASSERT(CONDITION) \
         _Static_assert(CONDITION, #CONDITION)\n#endif\n",
    );
    macro_rules! size {
        ($($ty:ident),*) => {$(
            let size = size_of::<abi::$ty>();
            writeln!(out, "PANOSCOPE_ASSERT(sizeof(Panoscope{}) == {size});", stringify!($ty)).expect("writing to a string");
        )*};
    }
    size!(
        Str,
        Tick,
        BufferId,
        Frame,
        PortRange,
        ParamValue,
        OpenCall,
        ValidateCall,
        Call,
        Host,
        Port,
        Param,
        NodeType,
        Plugin,
        NoteBody,
        Note,
        Homography,
        Roi,
        Camera,
        Calibration,
        CloudPoint,
        Detection,
        DetectionsHeader,
        Tip,
        Pose,
        Joints,
        Scalar,
        TableHeader
    );
    out
}

#[test]
fn the_header_is_current() {
    let (path, made) = (root().join("panoscope.h"), generate());
    if std::env::var_os("PANOSCOPE_BLESS").is_some() {
        std::fs::write(&path, &made).expect("panoscope.h can be written");
        return;
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        found == made,
        "core/contract/abi/panoscope.h is not current: PANOSCOPE_BLESS=1 cargo test -p panoscope-abi renews it"
    );
}

/// Every constant and struct of the contract has its C form.
#[test]
fn the_header_is_complete() {
    let header = generate();
    let (mut types, mut consts) = (BTreeSet::new(), BTreeSet::new());
    for source in SOURCES {
        let text = std::fs::read_to_string(root().join("src").join(source)).expect("a source");
        names("pub struct ", &text, &mut types);
        names("pub const ", &text, &mut consts);
    }
    for name in ["fn", "FNV_START", "NOTE_OWNER"] {
        consts.remove(name);
    }
    assert!(types.len() >= 27 && consts.len() >= 45, "{} types, {} constants", types.len(), consts.len());
    for name in types {
        assert!(header.contains(&format!("}} Panoscope{name};")), "struct {name} is missing");
    }
    for name in consts {
        assert!(header.contains(&format!("#define PANOSCOPE_{name} ")), "constant {name} is missing");
    }
}

fn compiles(compiler: &str, language: &str, standard: &str) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let source = folder.join(format!("only_header_{language}.{}", if language == "c" { "c" } else { "cpp" }));
    std::fs::write(
        &source,
        "#include \"panoscope.h\"\n#include \"panoscope.h\"\nPANOSCOPE_NOTE(\"a\", \"1\", \"b,c\");\n",
    )
    .expect("a folder for tests");
    let output = Command::new(compiler)
        .args(["-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only", standard, "-I"])
        .arg(root())
        .arg(&source)
        .output();
    match output {
        Ok(output) => assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr)),
        Err(error) => panoscope_testing::skipped!("{compiler} cannot be run ({error})"),
    }
}

#[test]
fn the_header_is_plain_c_and_cpp() {
    compiles("cc", "c", "-std=c11");
    compiles("c++", "cpp", "-std=c++17");
    compiles("clang", "c", "-std=c11");
    compiles("clang++", "cpp", "-std=c++17");
}
