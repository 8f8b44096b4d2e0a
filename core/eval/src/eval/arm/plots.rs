//! Plots of a run over time.

use std::path::Path;

use crate::canvas::Canvas;
use crate::error::Result;
use panoscope_arm_core::rehearsal::Row;
use panoscope_imaging::draw;

const WIDTH: usize = 1200;
const BAND: usize = 190;
const LEFT: f32 = 70.0;
const TOP: f32 = 30.0;
const BOTTOM: f32 = 24.0;

/// One band: a title, its curves in BGR, and a limit line.
struct Band<'a> {
    title: &'a str,
    curves: Vec<([u8; 3], Vec<f64>)>,
    limit: Option<f64>,
}

/// Draws error, position in the image, distance, trocar and camera speed of a run; gray where the arm does not follow.
pub fn draw(path: &Path, title: &str, rows: &[Row]) -> Result<()> {
    let of = |pick: &dyn Fn(&Row) -> f64| rows.iter().map(pick).collect::<Vec<f64>>();
    let (blue, red, green) = ([200, 90, 20], [40, 40, 210], [60, 140, 30]);
    let bands = [
        Band {
            title: "distance of the tip from where it should be, mm",
            curves: vec![(blue, of(&|r| r.error_mm))],
            limit: Some(3.0),
        },
        Band {
            title: "error in the picture, px at 640 columns: across (blue), down (red)",
            curves: vec![(blue, of(&|r| r.error_px[0])), (red, of(&|r| r.error_px[1]))],
            limit: None,
        },
        Band { title: "error of the distance, mm", curves: vec![(green, of(&|r| r.distance_error_mm))], limit: None },
        Band { title: "miss of the trocar, mm", curves: vec![(red, of(&|r| r.pivot_mm))], limit: Some(1.0) },
        Band { title: "speed of the camera, mm/s", curves: vec![(green, of(&|r| r.camera_mm_s))], limit: None },
    ];
    let mut canvas = Canvas::new(WIDTH, BAND * bands.len(), [255; 3]);
    let mut out = canvas.view();
    let end_s = rows.last().map_or(1.0, |row| row.at_s).max(1e-3);
    let x_of = |at_s: f64| LEFT + (WIDTH as f32 - LEFT - 12.0) * (at_s / end_s) as f32;
    for (index, band) in bands.iter().enumerate() {
        let top = (index * BAND) as f32;
        let (low_y, high_y) = (top + BAND as f32 - BOTTOM, top + TOP);
        let values = || band.curves.iter().flat_map(|(_, curve)| curve).copied().filter(|v| v.is_finite());
        let high = values().chain(band.limit).fold(1e-3, f64::max) * 1.05;
        let low = values().fold(0.0, f64::min) * 1.05;
        let y_of = |value: f64| low_y + (high_y - low_y) * ((value - low) / (high - low)) as f32;
        for row in rows.windows(2).filter(|two| !two[0].following) {
            let (a, b) = (x_of(row[0].at_s), x_of(row[1].at_s));
            draw::fill_rectangle(
                &mut out,
                a as i32,
                high_y as i32,
                (b - a).ceil() as i32,
                (low_y - high_y) as i32,
                [225; 3],
                1.0,
            );
        }
        for part in 0..=4 {
            let value = low + (high - low) * f64::from(part) / 4.0;
            draw::line(&mut out, (LEFT, y_of(value)), (WIDTH as f32 - 12.0, y_of(value)), 1.0, [230; 3]);
            draw::text(&mut out, 6.0, y_of(value) - 6.0, &format!("{value:.1}"), 1.5, [60; 3]);
        }
        for part in 0..=6 {
            let at_s = end_s * f64::from(part) / 6.0;
            draw::text(&mut out, x_of(at_s) - 10.0, low_y + 5.0, &format!("{at_s:.0} s"), 1.5, [60; 3]);
        }
        if let Some(limit) = band.limit {
            draw::line(&mut out, (LEFT, y_of(limit)), (WIDTH as f32 - 12.0, y_of(limit)), 1.0, [80, 80, 255]);
        }
        for (color, curve) in &band.curves {
            for (two, values) in rows.windows(2).zip(curve.windows(2)) {
                if values.iter().all(|v| v.is_finite()) {
                    let (a, b) = ((x_of(two[0].at_s), y_of(values[0])), (x_of(two[1].at_s), y_of(values[1])));
                    draw::line(&mut out, a, b, 1.5, *color);
                }
            }
        }
        let words = if index == 0 { format!("{title}: {}", band.title) } else { band.title.to_owned() };
        draw::text(&mut out, LEFT, top + 8.0, &words, 2.0, [0; 3]);
    }
    canvas.save(path)
}
