//! The example plugins in C and C++ under tests/c: built against the generated header, inspected as ELF files, then
//! run.

use std::ffi::{CString, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use panoscope_node::Gray8;
use panoscope_node::abi;
use panoscope_node::harness::{Foreign, Harness, HarnessError, Setup};

unsafe extern "C" {
    fn dlopen(path: *const c_char, flags: c_int) -> *mut c_void;
    fn dlsym(library: *mut c_void, name: *const c_char) -> *mut c_void;
}
const RTLD_NOW: c_int = 2;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

/// Builds `tests/c/<source>`. Prints the reason and returns `None` where there is no compiler.
fn build(compiler: &str, source: &str, extra: &[&str]) -> Option<PathBuf> {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("lib{}.so", source.replace('.', "_")));
    let source = root().join("tests/c").join(source);
    if let Err(error) = Command::new(compiler).arg("--version").output() {
        panoscope_testing::skipped!("{compiler} cannot be run ({error})");
        return None;
    }
    let header = root().join("core/contract/abi/panoscope.h");
    panoscope_testing::made_once(&target, &[&source, &header], |target| {
        let output = Command::new(compiler)
            .args(["-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fPIC", "-fvisibility=hidden", "-shared"])
            .args(extra)
            .arg("-I")
            .arg(root().join("core/contract/abi"))
            .arg(&source)
            .arg("-o")
            .arg(target)
            .output()
            .expect("the compiler starts");
        assert!(output.status.success(), "{}: {}", source.display(), String::from_utf8_lossy(&output.stderr));
    });
    Some(target)
}

// Each library is built once: it must not be written while another test runs it.
static C_PLUGIN: LazyLock<Option<PathBuf>> = LazyLock::new(|| build("cc", "edge_c.c", &["-std=c11"]));
static CPP_PLUGIN: LazyLock<Option<PathBuf>> =
    LazyLock::new(|| build("c++", "edge_cpp.cpp", &["-std=c++17", "-fno-gnu-unique"]));

/// A 64-bit little-endian ELF file; reads only what these tests need.
struct Elf(Vec<u8>);

struct Section {
    name: String,
    kind: u32,
    link: usize,
    align: u64,
    bytes: Vec<u8>,
}

impl Elf {
    fn number<const N: usize>(&self, at: usize) -> u64 {
        number(&self.0[at..at + N])
    }

    fn sections(&self) -> Vec<Section> {
        let (table, count, names) =
            (self.number::<8>(40) as usize, self.number::<2>(60) as usize, self.number::<2>(62) as usize);
        let range = |index: usize| {
            let head = table + index * 64;
            let at = self.number::<8>(head + 24) as usize;
            (head, at..at + self.number::<8>(head + 32) as usize)
        };
        let texts = &self.0[range(names).1];
        (0..count)
            .map(|index| {
                let (head, bytes) = range(index);
                let kind = self.number::<4>(head + 4) as u32;
                // Sections without contents in the file may have any size.
                let bytes = if kind == 8 { Vec::new() } else { self.0[bytes].to_vec() };
                let link = self.number::<4>(head + 40) as usize;
                Section {
                    name: text(&texts[self.number::<4>(head) as usize..]),
                    kind,
                    link,
                    align: self.number::<8>(head + 48),
                    bytes,
                }
            })
            .collect()
    }

    /// Name and binding of the defined dynamic symbols.
    fn exported(&self) -> Vec<(String, u8)> {
        let sections = self.sections();
        let symbols = sections.iter().find(|s| s.kind == 11).expect("dynamic symbols");
        let names = &sections[symbols.link].bytes;
        let defined = symbols.bytes.chunks_exact(24).filter(|symbol| number(&symbol[6..8]) != 0);
        defined.map(|symbol| (text(&names[number(&symbol[..4]) as usize..]), symbol[4] >> 4)).collect()
    }
}

fn number(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |all, byte| all << 8 | u64::from(*byte))
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(&bytes[..bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len())]).into_owned()
}

fn file_is_right(path: &Path, name: &str) {
    let elf = Elf(std::fs::read(path).expect("the plugin was built"));
    let exported = elf.exported();
    assert!(exported.iter().any(|(symbol, _)| symbol == abi::ENTRY_SYMBOL), "{exported:?}");
    const UNIQUE: u8 = 10;
    assert!(exported.iter().all(|(_, binding)| *binding != UNIQUE), "a unique symbol pins the library: {exported:?}");
    // Templates of the C++ library may be exported, but no symbol of the plugin.
    let own: Vec<_> = exported.iter().filter(|(s, _)| !s.starts_with("_ZN") && !s.starts_with("_ZZN")).collect();
    assert_eq!(own.len(), 1, "{own:?}");
    let sections = elf.sections();
    let note = sections.iter().find(|s| s.name == abi::NOTE_SECTION).expect("the note");
    assert_eq!((note.kind, note.align, note.bytes.len()), (7, 4, size_of::<abi::Note>()));
    let word = |index: usize| number(&note.bytes[index * 4..index * 4 + 4]);
    assert_eq!((word(0), word(1), word(2)), (12, size_of::<abi::NoteBody>() as u64, u64::from(abi::NOTE_TYPE)));
    assert_eq!(note.bytes[12..24], abi::NOTE_OWNER);
    assert_eq!((word(6), word(7)), (u64::from(abi::ABI_MAJOR), u64::from(abi::ABI_MINOR)));
    let body = &note.bytes[32..];
    assert_eq!((text(body), text(&body[64..]), text(&body[96..])), (name.into(), "1.0.0".into(), name.into()));
}

fn load(path: &Path) -> *const abi::Plugin {
    let path = CString::new(path.to_str().expect("a UTF-8 path")).expect("no zero byte");
    // SAFETY: the library is built from this repository's sources, is never unmapped, and its entry function has this type.
    unsafe {
        let library = dlopen(path.as_ptr(), RTLD_NOW);
        assert!(!library.is_null());
        let symbol = dlsym(library, c"panoscope_plugin".as_ptr());
        assert!(!symbol.is_null());
        std::mem::transmute::<*mut c_void, abi::Entry>(symbol)()
    }
}

/// A step from 0 to 100 in the middle of a 6x4 image.
fn step() -> Vec<u8> {
    (0..24).map(|i| if i % 6 < 3 { 0 } else { 100 }).collect()
}

#[test]
fn the_plugin_in_c() -> Result<(), HarnessError> {
    let Some(path) = &*C_PLUGIN else { return Ok(()) };
    file_is_right(path, "edge_c");
    // SAFETY: `load` returns the descriptor of a library that stays mapped; the plugin obeys the ABI.
    let mut node = unsafe { Harness::<Foreign>::of_plugin(load(path), "edge_c", Setup::default())? };
    let out = node.input_image::<Gray8>("image", 6, 4, &step()).process()?;
    // 4 * 100 across, times the gain of 0.25.
    let row = [0, 0, 100, 100, 0, 0];
    assert_eq!(out.plane::<Gray8>("edges")?.data, [[0; 6], row, row, [0; 6]].concat());
    node.set_params("params = { threshold = 120, gain = 0.25 }")?;
    let out = node.input_image::<Gray8>("image", 6, 4, &step()).process()?;
    assert_eq!(out.plane::<Gray8>("edges")?.data, [0; 24]);
    node.set_params("params = { gain = 4 }")?;
    let padded: Vec<u8> = step().chunks(6).flat_map(|row| [row, &[77, 77]].concat()).collect();
    let out = node.input_image_with_stride::<Gray8>("image", 6, 4, 8, &padded).process()?;
    assert_eq!(out.plane::<Gray8>("edges")?.data[8..10], [255, 255]);
    let error = node.input_image::<Gray8>("image", 2, 2, &[0; 4]).process().err().map(|e| e.to_string());
    assert_eq!(error.as_deref(), Some("process returned STATUS_ERROR: the image is smaller than 3x3 pixels"));
    let wrong = node.set_params("params = { gian = 1 }").err().map(|e| e.to_string()).unwrap_or_default();
    assert!(wrong.contains("did you mean `gain`?"), "{wrong}");
    let exhausted = node.limit_buffers(1).input_image::<Gray8>("image", 3, 3, &[0; 9]).process().err();
    assert_eq!(exhausted.and_then(|e| e.status()), Some(abi::STATUS_EXHAUSTED));
    Ok(())
}

#[test]
fn the_plugin_in_cpp() -> Result<(), HarnessError> {
    let Some(path) = &*CPP_PLUGIN else { return Ok(()) };
    file_is_right(path, "edge_cpp");
    // SAFETY: `load` returns the descriptor of a library that stays mapped; the plugin obeys the ABI.
    let mut node = unsafe { Harness::<Foreign>::of_plugin(load(path), "edge_cpp", Setup::default())? };
    for kernel in ["sobel", "scharr", "prewitt"] {
        node.set_params(&format!("params.kernel = \"{kernel}\""))?;
        let out = node.input_image::<Gray8>("image", 6, 4, &step()).process()?;
        assert_eq!(out.plane::<Gray8>("edges")?.data[6..12], [0, 0, 100, 100, 0, 0], "{kernel}");
    }
    Ok(())
}

#[test]
fn what_cpp_throws_stays_in_the_plugin() -> Result<(), HarnessError> {
    let Some(path) = &*CPP_PLUGIN else { return Ok(()) };
    let setup = Setup::new("params.throws = \"exception\"");
    // SAFETY: `load` returns the descriptor of a library that stays mapped; the plugin obeys the ABI.
    let mut node = unsafe { Harness::<Foreign>::of_plugin(load(path), "edge_cpp", setup)? };
    let mut fails = |toml| {
        node.set_params(toml)?;
        let error = node.input_image::<Gray8>("image", 6, 4, &step()).process().err();
        Ok::<_, HarnessError>(error.map(|e| (e.status(), e.to_string())))
    };
    let panic = |words: &str| Some((Some(abi::STATUS_PANIC), format!("process returned STATUS_PANIC: {words}")));
    assert_eq!(fails("params.throws = \"exception\"")?, panic("thrown in tick 0"));
    assert_eq!(fails("params.throws = \"number\"")?, panic("something was thrown that is no std::exception"));
    assert_eq!(fails("")?, None, "the node goes on");
    Ok(())
}
