//! Stereo pairs on disk: pictures, true disparities, cameras, surfaces.

use std::fs;
use std::path::Path;

use crate::error::{Context, EvalError, FileAction, OnFile, Result, bail};
use crate::packets;
use panoscope_engine::memory::FrameRef;
use panoscope_imaging::stereo::{CameraModel, FloatImage, StereoCameras, formats};

/// A picture as the kernels want it.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Blue, green, red bytes.
    pub bgr: Vec<u8>,
    /// Gray bytes.
    pub gray: Vec<u8>,
}

impl Picture {
    /// From BGR bytes, with the host's weights for gray.
    pub fn new(width: usize, height: usize, bgr: Vec<u8>) -> Self {
        let weigh =
            |p: &[u8]| (u32::from(p[0]) * 7471 + u32::from(p[1]) * 38470 + u32::from(p[2]) * 19595 + 32768) >> 16;
        let gray = bgr.chunks_exact(3).map(|p| weigh(p) as u8).collect();
        Self { width, height, bgr, gray }
    }

    /// A view in a packet of an image.
    pub fn of(frame: &FrameRef) -> Result<Self> {
        let (width, height) = (frame.frame().width as usize, frame.frame().height as usize);
        Ok(Self::new(width, height, packets::bytes(frame, 3).context("a picture is cut off")?))
    }

    /// Reads a file.
    pub fn read(path: &Path) -> Result<Self> {
        let image = image::open(path).on_file(FileAction::Read, path)?.to_rgb8();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let bgr = image.pixels().flat_map(|p| [p[2], p[1], p[0]]).collect();
        Ok(Self::new(width, height, bgr))
    }
}

/// An 8-bit map such as a mask or a coarse disparity.
pub fn gray(path: &Path) -> Result<Vec<u8>> {
    Ok(image::open(path).on_file(FileAction::Read, path)?.to_luma8().into_raw())
}

/// True disparity of the Motorcycle pair: the only member of a compressed NumPy archive.
pub fn npz(path: &Path) -> Result<FloatImage> {
    let bytes = fs::read(path).on_file(FileAction::Read, path)?;
    let word = |at: usize, len: usize| -> Option<usize> {
        let part = bytes.get(at..at + len)?;
        Some(part.iter().rev().fold(0, |sum, byte| sum << 8 | usize::from(*byte)))
    };
    // The directory at the end knows the sizes even where the member's own header leaves them out.
    let Some(end) = bytes.windows(4).rposition(|w| w == b"PK\x05\x06") else {
        bail!("{} is not an archive", path.display())
    };
    let member = || -> Option<(usize, usize, usize)> {
        let entry = word(end + 16, 4)?;
        let local = word(entry + 42, 4)?;
        let start = local + 30 + word(local + 26, 2)? + word(local + 28, 2)?;
        Some((word(entry + 10, 2)?, start, word(entry + 20, 4)?))
    };
    let Some((method, start, len)) = member() else { bail!("{} is cut off", path.display()) };
    let Some(packed) = bytes.get(start..start.saturating_add(len)) else { bail!("{} is cut off", path.display()) };
    let plain = match method {
        0 => packed.to_vec(),
        8 => miniz_oxide::inflate::decompress_to_vec(packed)
            .map_err(|error| EvalError::Input { reason: format!("{}: {error}", path.display()) })?,
        other => bail!("{}: packing method {other} is unknown", path.display()),
    };
    Ok(formats::read_npy(&plain)?)
}

/// All numbers of a text file.
fn numbers(path: &Path) -> Result<Vec<f64>> {
    let text = fs::read_to_string(path).on_file(FileAction::Read, path)?;
    text.split_whitespace().map(|word| word.parse().with_context(|| format!("{}: `{word}`", path.display()))).collect()
}

/// Four rows of four numbers.
pub fn matrix4(path: &Path) -> Result<[f64; 16]> {
    let numbers = numbers(path)?;
    numbers.try_into().map_err(|_| EvalError::Input { reason: format!("{}: 16 numbers were expected", path.display()) })
}

fn camera(folder: &Path, side: &str, ending: &str, size: (usize, usize)) -> Result<CameraModel> {
    let k = numbers(&folder.join(format!("calib.{side}.{ending}.txt")))?;
    let distortion = numbers(&folder.join(format!("calib.{side}.distortion.txt")))?;
    let [fx, _, cx, _, fy, cy, ..] = k[..] else { bail!("{}: 9 numbers were expected", folder.display()) };
    Ok(CameraModel::new(size, (fx, fy), (cx, cy), &distortion[..5.min(distortion.len())])?)
}

/// Left and right camera of a folder of the scikit-surgery kind.
pub fn intrinsics(folder: &Path, size: (usize, usize)) -> Result<(CameraModel, CameraModel)> {
    let plural = folder.join("calib.left.intrinsics.txt").exists();
    let ending = if plural { "intrinsics" } else { "intrinsic" };
    Ok((camera(folder, "left", ending, size)?, camera(folder, "right", ending, size)?))
}

/// The pose between the cameras as it is written: three rows of a rotation, one of a translation in mm.
pub fn rotation_and_translation(folder: &Path) -> Result<([[f64; 3]; 3], [f64; 3])> {
    let m = numbers(&folder.join("calib.l2r.txt"))?;
    if m.len() != 12 {
        bail!("{}: calib.l2r.txt holds {} numbers, 12 were expected", folder.display(), m.len());
    }
    Ok((std::array::from_fn(|i| std::array::from_fn(|j| m[3 * i + j])), [m[9], m[10], m[11]]))
}

/// Both cameras of a folder with a 4x4 pose between them.
pub fn cameras(folder: &Path, size: (usize, usize)) -> Result<StereoCameras> {
    let m = matrix4(&folder.join("calib.l2r.4x4"))?;
    let (left, right) = intrinsics(folder, size)?;
    let rotation = std::array::from_fn(|i| std::array::from_fn(|j| m[4 * i + j]));
    Ok(StereoCameras { left, right, rotation, translation_mm: [m[3], m[7], m[11]] })
}

/// Points on the triangles of a binary little-endian PLY, about `step_mm` apart.
pub fn surface(path: &Path, step_mm: f32) -> Result<Vec<[f32; 3]>> {
    let bytes = fs::read(path).on_file(FileAction::Read, path)?;
    let cut_off =
        || EvalError::Input { reason: format!("{} is no binary PLY of triangles, or cut off", path.display()) };
    const END: &[u8] = b"end_header\n";
    let end = bytes.windows(END.len()).position(|w| w == END).ok_or_else(cut_off)? + END.len();
    let header = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let count = |what: &str| -> Option<usize> {
        header.lines().find_map(|line| line.strip_prefix("element ")?.strip_prefix(what)?.trim().parse().ok())
    };
    let (vertices, faces) = (count("vertex ").ok_or_else(cut_off)?, count("face ").ok_or_else(cut_off)?);
    let bytes_of = |properties: &str| -> usize {
        let kinds = properties.lines().filter_map(|line| line.strip_prefix("property ")?.split(' ').next());
        kinds.filter(|kind| *kind != "list").map(|kind| if kind.ends_with("char") { 1 } else { 4 }).sum()
    };
    let (of_vertex, of_face) = header.split_once("element face").unwrap_or_default();
    let (stride, after_face) = (bytes_of(of_vertex), bytes_of(of_face));
    let float = |at: usize| -> Option<f32> { Some(f32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?)) };
    let vertex = |index: usize| -> Option<[f32; 3]> {
        let at = end + index * stride;
        Some([float(at)?, float(at + 4)?, float(at + 8)?])
    };
    let mut at = end + vertices * stride;
    let mut points = Vec::new();
    for _ in 0..faces {
        if bytes.get(at) != Some(&3) {
            return Err(cut_off());
        }
        let corner = |k: usize| -> Option<[f32; 3]> {
            let part = bytes.get(at + 1 + 4 * k..at + 5 + 4 * k)?;
            vertex(u32::from_le_bytes(part.try_into().ok()?) as usize)
        };
        let [Some(a), Some(b), Some(c)] = [corner(0), corner(1), corner(2)] else { return Err(cut_off()) };
        at += 13 + after_face;
        let side = |p: [f32; 3], q: [f32; 3]| (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f32>().sqrt();
        let parts = (side(a, b).max(side(b, c)).max(side(c, a)) / step_mm).ceil().clamp(1.0, 64.0) as usize;
        for i in 0..=parts {
            for j in 0..=parts - i {
                let (s, t) = (i as f32 / parts as f32, j as f32 / parts as f32);
                points.push(std::array::from_fn(|k| a[k] + s * (b[k] - a[k]) + t * (c[k] - a[k])));
            }
        }
    }
    Ok(points)
}
