//! OpenCV's `FileStorage` YAML: one file with everything, or the pair `intrinsics.yml` and `extrinsics.yml` of
//! OpenCV's sample `stereo_calib`.

use std::fmt::Write as _;

use panoscope_abi::{Calibration, Camera};
use panoscope_imaging::stereo::CalibrationError;

use crate::calibration::EYE3;
use crate::calibration::document::Node;
use crate::calibration::error::Mistake;
use crate::calibration::{EQUIDISTANT, equidistant, equidistant_of, no_camera_matrix, packet_of};

/// Names in use for the same matrices; the first is what is written.
const LEFT_MATRIX: [&str; 6] =
    ["M1", "K1", "cameraMatrix1", "camera_matrix_1", "camera_matrix_left", "left_camera_matrix"];
const RIGHT_MATRIX: [&str; 6] =
    ["M2", "K2", "cameraMatrix2", "camera_matrix_2", "camera_matrix_right", "right_camera_matrix"];
const LEFT_DISTORTION: [&str; 4] = ["D1", "distCoeffs1", "dist_coeffs_1", "distortion_coefficients_left"];
const RIGHT_DISTORTION: [&str; 4] = ["D2", "distCoeffs2", "dist_coeffs_2", "distortion_coefficients_right"];

/// What a calibration states of its own error, see [`CalibrationError`]; other programs pass over these names.
const STATED: [&str; 4] = ["offset_error_px", "scale_error_percent", "point_error_px", "neutral_depth_mm"];

/// Whether one of the documents describes an OpenCV stereo pair.
pub(crate) fn is(documents: &[Node]) -> bool {
    documents.iter().any(|d| d.any(&LEFT_MATRIX).or(d.any(&RIGHT_MATRIX)).or(d.any(&["R1", "P1", "Q"])).is_some())
}

/// Numbers and position of the first document that has one of the names, with the index of that document.
struct Located<'a> {
    name: &'a str,
    index: usize,
    node: &'a Node,
}

fn find<'a>(documents: &'a [Node], names: &[&'a str]) -> Option<Located<'a>> {
    documents.iter().enumerate().find_map(|(index, document)| {
        let (name, node) = document.any(names)?;
        Some(Located { name, index, node })
    })
}

type Result<T> = std::result::Result<T, (usize, Mistake)>;

fn exactly<const N: usize>(documents: &[Node], names: &[&str]) -> Result<Option<[f64; N]>> {
    let Some(found) = find(documents, names) else { return Ok(None) };
    found.node.exactly(found.name).map(Some).map_err(|mistake| (found.index, mistake))
}

fn needed<const N: usize>(documents: &[Node], names: &[&str], what: &str) -> Result<[f64; N]> {
    exactly(documents, names)?.ok_or_else(|| {
        let last = documents.len().saturating_sub(1);
        (
            last,
            Mistake::whole(format!(
                "{what} (`{}`) is missing: the file is cut off, or its other half was not given",
                names[0]
            )),
        )
    })
}

/// Whether the documents state an equidistant lens. OpenCV has no word of its own in these files; this is that of ROS.
fn is_equidistant(documents: &[Node]) -> Result<bool> {
    let Some(found) = find(documents, &["distortion_model"]) else { return Ok(false) };
    match found.node.text().unwrap_or_default() {
        model if EQUIDISTANT.contains(&model) => Ok(true),
        "plumb_bob" | "radtan" | "rational_polynomial" | "none" | "" => Ok(false),
        other => {
            let what = format!(
                "the distortion model `{other}` is not supported: plumb_bob, rational_polynomial and equidistant are"
            );
            Err((found.index, found.node.mistake(what)))
        }
    }
}

fn distortion(documents: &[Node], names: &[&str]) -> Result<[f64; 14]> {
    let mut out = [0.0; 14];
    let Some(found) = find(documents, names) else { return Ok(out) };
    let fail = |mistake| (found.index, mistake);
    let all = found.node.numbers(found.name).map_err(fail)?;
    if is_equidistant(documents)? {
        let what = || format!("`{}` holds {} coefficients: an equidistant lens has 4", found.name, all.len());
        return Ok(equidistant(all[..].try_into().map_err(|_| fail(found.node.mistake(what())))?));
    }
    if ![0, 4, 5, 8, 12, 14].contains(&all.len()) {
        let what = format!("`{}` holds {} coefficients: 4, 5, 8, 12 or 14 are known", found.name, all.len());
        return Err(fail(found.node.mistake(what)));
    }
    out[..all.len()].copy_from_slice(&all);
    Ok(out)
}

/// A camera matrix by rows.
fn camera_matrix(documents: &[Node], names: &[&str], what: &str) -> Result<[f64; 9]> {
    let matrix: [f64; 9] = needed(documents, names, what)?;
    if let (Some(words), Some(found)) = (no_camera_matrix(&matrix), find(documents, names)) {
        return Err((found.index, found.node.mistake(format!("`{}` {words}", found.name))));
    }
    Ok(matrix)
}

/// Width and height; zero when no document states them, as in the output of OpenCV's sample.
fn size(documents: &[Node]) -> Result<(u32, u32)> {
    let pixels = |names: &[&str]| -> Result<Option<u32>> {
        let Some(found) = find(documents, names) else { return Ok(None) };
        found.node.pixels(found.name).map(Some).map_err(|mistake| (found.index, mistake))
    };
    if let (Some(width), Some(height)) = (
        pixels(&["image_width", "width", "imageWidth", "Camera.width"])?,
        pixels(&["image_height", "height", "imageHeight", "Camera.height"])?,
    ) {
        return Ok((width, height));
    }
    let Some(found) = find(documents, &["image_size", "imageSize", "size"]) else { return Ok((0, 0)) };
    let [width, height] = found.node.exactly(found.name).map_err(|mistake| (found.index, mistake))?;
    let whole = |v: f64| v.fract() == 0.0 && (2.0..=65536.0).contains(&v);
    if !whole(width) || !whole(height) {
        return Err((found.index, found.node.mistake(format!("`{}` is no size in px", found.name))));
    }
    Ok((width as u32, height as u32))
}

/// What the calibration states of its own error; 0 where the file says nothing of it.
fn stated_error(documents: &[Node]) -> Result<u32> {
    let mut numbers = [0.0; 4];
    let found = STATED.map(|name| find(documents, std::slice::from_ref(&name)).map(|found| (found.index, found.node)));
    let Some((index, node)) = found.iter().flatten().next() else { return Ok(0) };
    for ((number, name), found) in numbers.iter_mut().zip(STATED).zip(&found) {
        let Some((index, node)) = found else {
            let what = format!("`{name}` is missing: of {} all are stated or none", STATED.join(", "));
            return Err((*index, node.mistake(what)));
        };
        *number = node.number(name).map_err(|mistake| (*index, mistake))?;
        // NaN fails.
        if !(*number > 0.0 && number.is_finite()) {
            return Err((
                *index,
                node.mistake(format!("`{name}` is {number}: a standard deviation or a depth is above 0")),
            ));
        }
    }
    let [offset_px, scale_percent, point_px, neutral_mm] = numbers;
    Ok(CalibrationError { offset_px, scale_percent, point_px, neutral_mm }.bits())
}

fn camera(size: (u32, u32), k: &[f64; 9], distortion: [f64; 14]) -> Camera {
    Camera { width: size.0, height: size.1, fx: k[0], fy: k[4], cx: k[2], cy: k[5], distortion }
}

/// The packet of one or more documents together; a mistake comes with the index of its document.
pub(crate) fn packet(documents: &[Node]) -> Result<Calibration> {
    let size = size(documents)?;
    let left = camera_matrix(documents, &LEFT_MATRIX, "the left camera matrix")?;
    let right = camera_matrix(documents, &RIGHT_MATRIX, "the right camera matrix")?;
    let rotation = needed(documents, &["R", "rotation"], "the rotation between the cameras")?;
    let translation: [f64; 3] = needed(documents, &["T", "translation"], "the translation between the cameras")?;
    let (left, right) = (
        camera(size, &left, distortion(documents, &LEFT_DISTORTION)?),
        camera(size, &right, distortion(documents, &RIGHT_DISTORTION)?),
    );
    let rectification: [Option<[f64; 9]>; 2] = [exactly(documents, &["R1"])?, exactly(documents, &["R2"])?];
    let projection: [Option<[f64; 12]>; 2] = [exactly(documents, &["P1"])?, exactly(documents, &["P2"])?];
    let rms_px = match find(documents, &["rms_px", "rms", "avg_reprojection_error"]) {
        Some(found) => found.node.number(found.name).map_err(|mistake| (found.index, mistake))?,
        None => f64::NAN,
    };
    let whole = (rectification, projection);
    let ([r1, r2], [p1, p2]) = match whole {
        ([Some(r1), Some(r2)], [Some(p1), Some(p2)]) => ([r1, r2], [p1, p2]),
        // Callers compute it from the cameras.
        ([None, None], [None, None]) => ([EYE3; 2], [[0.0; 12]; 2]),
        _ => {
            let last = documents.len().saturating_sub(1);
            let what = "of `R1`, `R2`, `P1`, `P2` some are there and some are missing: the file is cut off";
            return Err((last, Mistake::whole(what)));
        }
    };
    Ok(Calibration {
        rectified_from_left: r1,
        rectified_from_right: r2,
        left_projection: p1,
        right_projection: p2,
        rms_px,
        stated_error: stated_error(documents)?,
        ..packet_of([left, right], rotation, translation)
    })
}

/// A number as OpenCV's writer puts it: 17 digits, which are exact.
fn number(value: f64) -> String {
    if value.is_nan() {
        return ".Nan".into();
    }
    if value.is_infinite() {
        return if value > 0.0 { ".Inf" } else { "-.Inf" }.into();
    }
    if value.fract() == 0.0 && value.abs() < 1e15 {
        return format!("{value}.");
    }
    let text = format!("{value:.16e}");
    let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let (sign, exponent) = exponent.strip_prefix('-').map_or(('+', exponent), |rest| ('-', rest));
    format!("{digits}e{sign}{exponent:0>2}")
}

fn matrix(out: &mut String, name: &str, rows: usize, values: &[f64]) {
    let cells: Vec<String> = values.iter().map(|value| number(*value)).collect();
    let columns = values.len() / rows.max(1);
    let lines: Vec<String> = cells.chunks(columns.clamp(1, 3)).map(|line| line.join(", ")).collect();
    let _ = write!(
        out,
        "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {} ]\n",
        lines.join(",\n       ")
    );
}

/// Coefficients up to the last that is not zero, in one of OpenCV's lengths.
fn coefficients(all: &[f64; 14]) -> &[f64] {
    let used = all.iter().rposition(|value| *value != 0.0).map_or(0, |last| last + 1);
    let length = [5, 8, 12, 14].into_iter().find(|length| used <= *length).unwrap_or(14);
    &all[..length]
}

/// The packet as `FileStorage` YAML. `Q`, which OpenCV's `reprojectImageTo3D` takes, is added where the packet holds
/// a rectification; numbers read back bit by bit.
pub fn text_of(packet: &Calibration) -> String {
    let mut out = "%YAML:1.0\n---\n".to_owned();
    // A file that states no size is read as 0, and is written without one again.
    if packet.left.width > 0 && packet.left.height > 0 {
        let _ = writeln!(out, "image_width: {}\nimage_height: {}", packet.left.width, packet.left.height);
    }
    for (camera, k, d) in [(&packet.left, "M1", "D1"), (&packet.right, "M2", "D2")] {
        matrix(&mut out, k, 3, &[camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]);
        match equidistant_of(camera) {
            Some(k) => matrix(&mut out, d, 1, &k),
            None => matrix(&mut out, d, 1, coefficients(&camera.distortion)),
        }
    }
    if equidistant_of(&packet.left).is_some() {
        let _ = writeln!(out, "distortion_model: {}", EQUIDISTANT[0]);
    }
    matrix(&mut out, "R", 3, &packet.right_from_left_rotation);
    matrix(&mut out, "T", 3, &packet.right_from_left_mm);
    let (left, right) = (&packet.left_projection, &packet.right_projection);
    if *left != [0.0; 12] {
        matrix(&mut out, "R1", 3, &packet.rectified_from_left);
        matrix(&mut out, "R2", 3, &packet.rectified_from_right);
        matrix(&mut out, "P1", 3, left);
        matrix(&mut out, "P2", 3, right);
        let per_mm = -right[0] / right[3];
        let offset = (left[2] - right[2]) * -per_mm;
        let q = [
            [1.0, 0.0, 0.0, -left[2]],
            [0.0, 1.0, 0.0, -left[6]],
            [0.0, 0.0, 0.0, left[0]],
            [0.0, 0.0, per_mm, offset],
        ];
        if per_mm.is_finite() {
            matrix(&mut out, "Q", 4, q.as_flattened());
        }
    }
    let _ = writeln!(out, "baseline_mm: {}", number(packet.baseline_mm));
    if packet.rms_px.is_finite() {
        let _ = writeln!(out, "rms_px: {}", number(packet.rms_px));
    }
    if let Some(stated) = CalibrationError::of_bits(packet.stated_error) {
        let numbers = [stated.offset_px, stated.scale_percent, stated.point_px, stated.neutral_mm];
        for (name, value) in STATED.into_iter().zip(numbers) {
            let _ = writeln!(out, "{name}: {}", number(value));
        }
    }
    out
}
