//! Plots of scores: curves of precision and recall, class confusions, the worst misses.

use std::path::Path;

use panoscope_imaging::View;
use panoscope_imaging::draw::{self, Color};

use super::reliability::{self, Outcome, expected_error};
use super::truth::Truth;
use crate::canvas::Canvas;
use crate::error::{FileAction, OnFile, Result};
use panoscope_imaging::detect::Mask;
use panoscope_imaging::detect::{Find, Object, Scores, Shape, pairs};

/// Minimum score of a find that is shown and counted among the mistakes.
pub const SHOWN_SCORE: f64 = 0.3;

const INK: Color = [40, 40, 40];
const GRID: Color = [215, 215, 215];
const CLASS_COLORS: [Color; 10] = [
    [180, 119, 31],
    [14, 127, 255],
    [44, 160, 44],
    [40, 39, 214],
    [189, 103, 148],
    [75, 86, 140],
    [194, 119, 227],
    [127, 127, 127],
    [34, 189, 188],
    [207, 190, 23],
];

/// Precision over recall of each class, at an overlap of 0.5.
pub fn curves(path: &Path, title: &str, classes: &[String], scores: &Scores) -> Result<()> {
    let (left, top, side) = (70.0, 60.0, 440.0);
    let mut canvas = Canvas::new(800, 570, [255, 255, 255]);
    canvas.text(left, 18.0, title, INK);
    for tick in 0..=5 {
        let share = tick as f32 / 5.0;
        let (x, y) = (left + side * share, top + side * (1.0 - share));
        draw::line(&mut canvas.view(), (x, top), (x, top + side), 1.0, GRID);
        draw::line(&mut canvas.view(), (left, y), (left + side, y), 1.0, GRID);
        canvas.text(left - 38.0, y - 5.0, &format!("{share:.1}"), INK);
        canvas.text(x - 12.0, top + side + 8.0, &format!("{share:.1}"), INK);
    }
    canvas.text(left + side / 2.0 - 30.0, top + side + 30.0, "recall", INK);
    canvas.text(4.0, top - 22.0, "precision", INK);
    let mut line = 0.0;
    for (index, (name, class)) in classes.iter().zip(&scores.classes).enumerate() {
        if class.truths == 0 {
            continue;
        }
        let color = CLASS_COLORS[index % CLASS_COLORS.len()];
        let points: Vec<(f32, f32)> =
            class.curve.iter().map(|&(r, p)| (left + side * r as f32, top + side * (1.0 - p as f32))).collect();
        draw::polyline(&mut canvas.view(), &points, 2.0, color);
        let y = top + 22.0 * line;
        draw::line(&mut canvas.view(), (left + side + 20.0, y + 6.0), (left + side + 44.0, y + 6.0), 3.0, color);
        canvas.text(left + side + 52.0, y, &format!("{name} {:.3}", class.ap[0]), INK);
        line += 1.0;
    }
    canvas.text(left + side + 20.0, top + 22.0 * line + 8.0, &format!("mean AP50 {:.3}", scores.ap_at(0)), INK);
    canvas.save(path)
}

/// Scores of one class with their outcomes; with a correction also the corrected ones.
pub struct Reliability {
    /// Name of the class.
    pub name: String,
    /// Uncorrected outcomes.
    pub before: Vec<Outcome>,
    /// Corrected outcomes; empty without a correction.
    pub after: Vec<Outcome>,
}

/// Reliability diagrams: share of correct finds over the mean score of each bin, red uncorrected, blue corrected; on
/// the diagonal scores are probabilities. Bars show the number of finds of a bin.
pub fn reliability(path: &Path, title: &str, classes: &[Reliability]) -> Result<()> {
    const PANEL: (f32, f32, f32) = (290.0, 300.0, 210.0);
    const BEFORE: Color = [60, 60, 220];
    const AFTER: Color = [200, 110, 20];
    let columns = classes.len().clamp(1, 4);
    let rows = classes.len().div_ceil(columns).max(1);
    let size = (columns as f32 * PANEL.0 + 20.0, rows as f32 * PANEL.1 + 60.0);
    let mut canvas = Canvas::new(size.0 as usize, size.1 as usize, [255, 255, 255]);
    canvas.text(16.0, 12.0, title, INK);
    canvas.text(16.0, 34.0, "right over score; red: as the model gives it, blue: corrected", INK);
    for (index, class) in classes.iter().enumerate() {
        let (left, top) = ((index % columns) as f32 * PANEL.0 + 52.0, (index / columns) as f32 * PANEL.1 + 92.0);
        let side = PANEL.2;
        let percent = |outcomes: &[Outcome]| format!("{:.1} %", 100.0 * expected_error(outcomes.iter().copied()));
        let error = match (class.before.is_empty(), class.after.is_empty()) {
            (true, _) => "nothing found".to_owned(),
            (false, true) => percent(&class.before),
            (false, false) => format!("{}, then {}", percent(&class.before), percent(&class.after)),
        };
        canvas.text(left, top - 26.0, &format!("{}: {error}", class.name), INK);
        for tick in [0.0, 0.5, 1.0] {
            let (x, y) = (left + side * tick, top + side * (1.0 - tick));
            draw::line(&mut canvas.view(), (left, y), (left + side, y), 1.0, GRID);
            draw::line(&mut canvas.view(), (x, top), (x, top + side), 1.0, GRID);
            canvas.text(left - 32.0, y - 5.0, &format!("{tick:.1}"), INK);
            canvas.text(x - 10.0, top + side + 6.0, &format!("{tick:.1}"), INK);
        }
        draw::line(&mut canvas.view(), (left, top + side), (left + side, top), 1.0, INK);
        let most = reliability::bins(class.before.iter().copied()).iter().map(|bin| bin.count).max().unwrap_or(0);
        for (outcomes, color) in [(&class.before, BEFORE), (&class.after, AFTER)] {
            let bins = reliability::bins(outcomes.iter().copied());
            let seen = || bins.iter().enumerate().filter(|(_, bin)| bin.count > 0);
            let at = |score: f64, right: f64| (left + side * score as f32, top + side * (1.0 - right as f32));
            let points: Vec<(f32, f32)> = seen().map(|(_, bin)| at(bin.score, bin.right)).collect();
            draw::polyline(&mut canvas.view(), &points, 2.0, color);
            points.iter().for_each(|p| draw::fill_circle(&mut canvas.view(), p.0, p.1, 3.0, color, 1.0));
            if color == BEFORE {
                let width = side / reliability::BINS as f32;
                for (k, bin) in seen() {
                    let high = (40.0 * bin.count as f32 / most as f32).max(1.0);
                    let (x, y) = (left + k as f32 * width + 2.0, top + side - high);
                    let (w, h) = (width as i32 - 4, high as i32);
                    draw::fill_rectangle(&mut canvas.view(), x as i32, y as i32, w, h, [150, 150, 150], 0.45);
                }
            }
        }
    }
    canvas.save(path)
}

/// Confusion of true classes (rows, the last for background) with detected classes (columns, the last for background).
pub fn confusion(truth: &Truth, finds: &[Vec<Find>], shape: Shape) -> Vec<Vec<usize>> {
    let n = truth.classes.len();
    let mut table = vec![vec![0; n + 1]; n + 1];
    for (picture, found) in truth.pictures.iter().zip(finds) {
        for (t, f) in pairs(&picture.objects, found, SHOWN_SCORE, shape) {
            if t.is_some_and(|t| picture.objects[t].ignored) {
                continue;
            }
            table[t.map_or(n, |t| picture.objects[t].class)][f.map_or(n, |f| found[f].class)] += 1;
        }
    }
    table
}

/// The table of [`confusion`] as an image; shares are of each row.
pub fn confusion_picture(path: &Path, title: &str, classes: &[String], table: &[Vec<usize>]) -> Result<()> {
    let n = classes.len();
    let cell = if n <= 12 { 64.0 } else { (900.0 / (n + 1) as f32).max(14.0) };
    let (left, top) = (170.0, 130.0);
    let size = cell * (n + 1) as f32;
    let mut canvas = Canvas::new((left + size + 30.0) as usize, (top + size + 30.0) as usize, [255, 255, 255]);
    canvas.text(16.0, 14.0, title, INK);
    canvas.text(16.0, 38.0, "rows: truth, columns: found", INK);
    let name = |i: usize| classes.get(i).map_or("nothing", String::as_str);
    for row in 0..=n {
        let total: usize = table[row].iter().sum();
        let y = top + cell * row as f32;
        canvas.text(12.0, y + cell / 2.0 - 6.0, name(row), INK);
        // Every second name is set higher, so that long ones do not meet.
        let short: String = name(row).chars().take(9).collect();
        canvas.text(left + cell * row as f32 + 2.0, top - if row % 2 == 0 { 24.0 } else { 46.0 }, &short, INK);
        for column in 0..=n {
            let count = table[row][column];
            let share = if total == 0 { 0.0 } else { count as f32 / total as f32 };
            let good = row == column;
            let fade = |full: f32| (255.0 - (255.0 - full) * share.sqrt()) as u8;
            let color =
                if good { [fade(80.0), fade(160.0), fade(60.0)] } else { [fade(70.0), fade(90.0), fade(225.0)] };
            let x = left + cell * column as f32;
            draw::fill_rectangle(&mut canvas.view(), x as i32, y as i32, cell as i32 - 2, cell as i32 - 2, color, 1.0);
            if count > 0 && cell > 30.0 {
                canvas.text(x + 6.0, y + cell / 2.0 - 6.0, &count.to_string(), INK);
            }
        }
    }
    canvas.save(path)
}

/// A mistake in an image.
struct Mistake {
    picture: usize,
    words: String,
    weight: f64,
}

/// Missed objects, largest first, alternating with false finds, most confident first; each image once.
fn mistakes(truth: &Truth, finds: &[Vec<Find>], shape: Shape) -> Vec<Mistake> {
    let (mut missed, mut false_finds) = (Vec::new(), Vec::new());
    let name = |class: usize| truth.classes.get(class).map_or("?", String::as_str);
    for (index, (picture, found)) in truth.pictures.iter().zip(finds).enumerate() {
        let area = (picture.width * picture.height).max(1) as f64;
        for (t, f) in pairs(&picture.objects, found, SHOWN_SCORE, shape) {
            let object = t.map(|t| &picture.objects[t]).filter(|o| !o.ignored);
            let find = f.map(|f| &found[f]);
            match (object, find) {
                (Some(o), Some(f)) if o.class != f.class => false_finds.push(Mistake {
                    picture: index,
                    words: format!("{} taken for {} {:.2}", name(o.class), name(f.class), f.score),
                    weight: f.score,
                }),
                (Some(o), None) => missed.push(Mistake {
                    picture: index,
                    words: format!("missed {}", name(o.class)),
                    weight: o.bbox[2] * o.bbox[3] / area,
                }),
                (None, Some(f)) if t.is_none() => false_finds.push(Mistake {
                    picture: index,
                    words: format!("false {} {:.2}", name(f.class), f.score),
                    weight: f.score,
                }),
                _ => {}
            }
        }
    }
    for list in [&mut missed, &mut false_finds] {
        list.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    }
    let (mut missed, mut false_finds) = (missed.into_iter(), false_finds.into_iter());
    let (mut out, mut seen) = (Vec::new(), std::collections::BTreeSet::new());
    loop {
        let next: Vec<Mistake> = [missed.next(), false_finds.next()].into_iter().flatten().collect();
        if next.is_empty() {
            return out;
        }
        out.extend(next.into_iter().filter(|m| seen.insert(m.picture)));
    }
}

/// An image file, shrunk to fit, with its scale.
fn thumbnail(path: &Path, width: usize, height: usize) -> Result<(Canvas, f32)> {
    let image = image::open(path).on_file(FileAction::Read, path)?;
    let small = image.resize(width as u32, height as u32, image::imageops::FilterType::Triangle).to_rgb8();
    let scale = small.width() as f32 / image.width() as f32;
    let bgr = small.pixels().flat_map(|p| [p[2], p[1], p[0]]).collect();
    Ok((Canvas { width: small.width() as usize, height: small.height() as usize, bgr }, scale))
}

/// Draws a mask over a shrunk image.
fn lay(canvas: &mut Canvas, mask: &Mask, scale: f32, color: Color) {
    let (w, h) = (canvas.width, canvas.height);
    let at = |i: usize| ((i as f32 + 0.5) / scale) as usize;
    let bytes: Vec<u8> =
        (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| 255 * u8::from(mask.at(at(x), at(y)))).collect();
    draw::blend_mask(&mut canvas.view(), &View::new(&bytes, w, h, 1), color, 0.35);
}

/// Draws ground truth in green and finds in red with their scores.
fn mark(canvas: &mut Canvas, scale: f32, objects: &[Object], finds: &[Find], classes: &[String], shape: Shape) {
    const TRUE: Color = [60, 220, 60];
    const FOUND: Color = [60, 60, 255];
    let name = |class: usize| classes.get(class).map_or("?", String::as_str);
    let shown = || finds.iter().filter(|f| f.score >= SHOWN_SCORE);
    if shape == Shape::Mask {
        objects.iter().filter_map(|o| o.mask.as_ref()).for_each(|m| lay(canvas, m, scale, TRUE));
        shown().filter_map(|f| f.mask.as_ref()).for_each(|m| lay(canvas, m, scale, FOUND));
    }
    let frame = |canvas: &mut Canvas, b: [f64; 4], color: Color| {
        let [x, y, w, h] = b.map(|v| v as f32 * scale);
        draw::rectangle(&mut canvas.view(), x, y, w, h, 1.5, color);
    };
    for o in objects {
        frame(canvas, o.bbox, TRUE);
        draw::text(
            &mut canvas.view(),
            o.bbox[0] as f32 * scale + 2.0,
            o.bbox[1] as f32 * scale + 2.0,
            name(o.class),
            1.3,
            TRUE,
        );
    }
    for f in shown() {
        frame(canvas, f.bbox, FOUND);
        let (x, y) = (f.bbox[0] as f32 * scale, (f.bbox[1] + f.bbox[3]) as f32 * scale);
        draw::text(&mut canvas.view(), x + 2.0, y - 12.0, &format!("{} {:.2}", name(f.class), f.score), 1.3, FOUND);
    }
}

/// A contact sheet of the worst misses, at most 24; with `all`, the first images regardless of misses.
pub fn sheet(path: &Path, truth: &Truth, finds: &[Vec<Find>], shape: Shape, all: bool) -> Result<()> {
    const CELL: (usize, usize) = (320, 250);
    const COLUMNS: usize = 4;
    let list: Vec<(usize, String)> = if all {
        (0..truth.pictures.len()).map(|i| (i, truth.pictures[i].stem())).collect()
    } else {
        mistakes(truth, finds, shape).into_iter().map(|m| (m.picture, m.words)).collect()
    };
    let list = &list[..list.len().min(24)];
    let rows = list.len().div_ceil(COLUMNS).max(1);
    let mut sheet = Canvas::new(CELL.0 * COLUMNS, CELL.1 * rows, [24, 24, 24]);
    if list.is_empty() {
        sheet.text(20.0, 20.0, "no mistakes", [255, 255, 255]);
    }
    for (place, (index, words)) in list.iter().enumerate() {
        let (x0, y0) = (place % COLUMNS * CELL.0, place / COLUMNS * CELL.1);
        let picture = &truth.pictures[*index];
        let (mut small, scale) = thumbnail(&picture.path, CELL.0 - 4, CELL.1 - 26)?;
        mark(&mut small, scale, &picture.objects, &finds[*index], &truth.classes, shape);
        sheet.paste((x0 + 2, y0 + 22), &small);
        let caption: String = format!("{}: {words}", picture.stem()).chars().take(42).collect();
        draw::text(&mut sheet.view(), x0 as f32 + 4.0, y0 as f32 + 5.0, &caption, 1.2, [255, 255, 255]);
    }
    sheet.save(path)
}

#[cfg(test)]
mod tests {
    use super::super::truth::Picture;
    use super::*;

    fn truth(objects: Vec<Object>) -> Truth {
        let picture = Picture { path: "a.png".into(), width: 100, height: 100, objects };
        Truth { classes: vec!["grasper".into(), "hook".into()], pictures: vec![picture] }
    }

    #[test]
    fn who_is_taken_for_whom_is_counted() {
        let object = |class, x| Object { class, bbox: [x, 0.0, 10.0, 10.0], mask: None, ignored: false };
        let find = |class, x, score| Find { class, bbox: [x, 0.0, 10.0, 10.0], mask: None, score };
        let truth = truth(vec![object(0, 0.0), object(1, 20.0), object(1, 40.0)]);
        let finds = vec![vec![find(0, 0.0, 0.9), find(0, 20.0, 0.8), find(1, 70.0, 0.7), find(1, 40.0, 0.1)]];
        let table = confusion(&truth, &finds, Shape::Box);
        assert_eq!(table, [[1, 0, 0], [1, 0, 1], [0, 1, 0]]);
        let all = mistakes(&truth, &finds, Shape::Box);
        assert_eq!(all.len(), 1, "each picture once");
        assert_eq!(all[0].words, "missed hook");
    }
}
