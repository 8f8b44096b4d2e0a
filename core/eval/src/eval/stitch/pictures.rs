//! Panoramas of several methods, one above the other.

use std::path::Path;

use panoscope_engine::memory::FrameRef;
use panoscope_imaging::draw;

use crate::canvas::Canvas;
use crate::error::Result;
use crate::inputs::create;
use crate::packets;
use crate::registration::JudgedRun;

/// Height of the line above each panorama, px.
const TITLE_PX: usize = 22;

/// The last panorama of each composite of a run, with titles.
pub(super) fn panels(run: &JudgedRun, title: &str) -> Vec<(String, Canvas)> {
    let bytes = |frame: &FrameRef| {
        let (width, height) = (frame.frame().width as usize, frame.frame().height as usize);
        Some(Canvas { width, height, bgr: packets::bytes(frame, 3)? })
    };
    run.panoramas.iter().flatten().filter_map(bytes).map(|panorama| (title.to_owned(), panorama)).collect()
}

/// Writes the images one above the other as `NAME.png` into a folder, which is created if needed.
///
/// # Errors
/// The folder or the file cannot be written.
pub(super) fn write(folder: &Path, name: &str, panels: &[(String, Canvas)]) -> Result<()> {
    create(Some(folder))?;
    let width = panels.iter().map(|(_, picture)| picture.width).max().unwrap_or(1);
    let height = panels.iter().map(|(_, picture)| picture.height + TITLE_PX).sum::<usize>().max(1);
    let mut sheet = Canvas::new(width, height, [0; 3]);
    let mut top = 0;
    for (title, picture) in panels {
        draw::text(&mut sheet.view(), 6.0, top as f32 + 3.0, title, 2.0, [230; 3]);
        sheet.paste((0, top + TITLE_PX), picture);
        top += TITLE_PX + picture.height;
    }
    sheet.save(&folder.join(format!("{name}.png")))
}
