//! Panoramas of several methods, one above the other.

use std::path::Path;

use image::{Rgb, RgbImage};
use panoscope_engine::memory::FrameRef;
use panoscope_imaging::ViewMut;
use panoscope_imaging::draw;

use crate::error::{FileAction, OnFile, Result};
use crate::registration::JudgedRun;

/// Height of the line above each panorama, px.
const TITLE_PX: usize = 22;

/// An image with its pixels.
pub(super) struct Picture {
    pub width: usize,
    pub height: usize,
    /// Row after row, without padding.
    pub bgr: Vec<u8>,
}

fn of_frame(frame: &FrameRef) -> Option<Picture> {
    let (described, bytes) = (frame.frame(), frame.bytes());
    let (width, height, stride) =
        (described.width as usize, described.height as usize, described.stride_bytes as usize);
    let mut bgr = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        bgr.extend_from_slice(bytes.get(y * stride..y * stride + width * 3)?);
    }
    Some(Picture { width, height, bgr })
}

/// The last panorama of each composite of a run, with titles.
pub(super) fn panels(run: &JudgedRun, title: &str) -> Vec<(String, Picture)> {
    let pictures = run.panoramas.iter().flatten().filter_map(of_frame);
    pictures.map(|picture| (title.to_owned(), picture)).collect()
}

/// Writes the images one above the other as `NAME.png` into a folder, which is created if needed.
///
/// # Errors
/// The folder or the file cannot be written.
pub(super) fn write(folder: &Path, name: &str, panels: &[(String, Picture)]) -> Result<()> {
    std::fs::create_dir_all(folder).on_file(FileAction::Create, folder)?;
    let width = panels.iter().map(|(_, picture)| picture.width).max().unwrap_or(1);
    let height = panels.iter().map(|(_, picture)| picture.height + TITLE_PX).sum::<usize>().max(1);
    let mut bgr = vec![0; width * height * 3];
    let mut top = 0;
    for (title, picture) in panels {
        let row = top as f32 + 3.0;
        draw::text(&mut ViewMut::new(&mut bgr, width, height, 3), 6.0, row, title, 2.0, [230; 3]);
        top += TITLE_PX;
        for y in 0..picture.height {
            let from = &picture.bgr[y * picture.width * 3..(y + 1) * picture.width * 3];
            bgr[(top + y) * width * 3..][..picture.width * 3].copy_from_slice(from);
        }
        top += picture.height;
    }
    let at = |x: u32, y: u32| (y as usize * width + x as usize) * 3;
    let picture = RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let at = at(x, y);
        Rgb([bgr[at + 2], bgr[at + 1], bgr[at]])
    });
    let path = folder.join(format!("{name}.png"));
    picture.save(&path).on_file(FileAction::Write, &path)
}
