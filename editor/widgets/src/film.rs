//! A short film of the window (`--screenshot FILE.gif`): a picture twice per second, written as GIF at the end.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Duration;

use eframe::egui::{ColorImage, Context, Event, UserData, ViewportCommand};
use gif::{Encoder, EncodingError, Frame, Repeat};

/// Time between two pictures, hundredths of a second.
const INTERVAL: u16 = 50;
/// Maximum width of the film, px; larger windows are shown at half, a third, ... of their size.
const WIDTH: usize = 960;
/// Maximum number of pictures.
const MAX_FRAMES: usize = 400;
/// How coarsely colours are chosen, 1 to 30.
const SPEED: i32 = 10;

/// Pixels of one picture, three bytes each.
#[derive(Clone, Debug, PartialEq)]
struct Picture {
    width: u16,
    height: u16,
    rgb: Vec<u8>,
}

/// A film that is being taken.
#[derive(Clone, Debug)]
pub(crate) struct Film {
    file: PathBuf,
    /// When the next picture is due, and when the film ends, s.
    next: f64,
    end: f64,
    /// Each with its time, hundredths of a second.
    pictures: Vec<(Picture, u16)>,
}

impl Film {
    /// A film between two moments, s after the start.
    pub fn new(file: PathBuf, (begin, end): (f64, f64)) -> Self {
        Self { file, next: begin, end, pictures: Vec::new() }
    }

    /// Takes the pictures that are due; returns whether the film has ended and is written.
    pub fn take(&mut self, ctx: &Context, elapsed: f64) -> bool {
        let taken = ctx.input(|input| {
            input.events.iter().find_map(|event| match event {
                Event::Screenshot { image, .. } => Some(shrunk(image)),
                _ => None,
            })
        });
        if let Some(picture) = taken {
            self.add(picture);
        }
        if elapsed >= self.end || self.pictures.len() >= MAX_FRAMES {
            match write(&self.file, &self.pictures) {
                Ok(()) => println!("{}", self.file.display()),
                Err(error) => eprintln!("error: {} was not written: {error}", self.file.display()),
            }
            ctx.send_viewport_cmd(ViewportCommand::Close);
            return true;
        }
        if elapsed >= self.next {
            self.next = elapsed + f64::from(INTERVAL) / 100.0;
            ctx.send_viewport_cmd(ViewportCommand::Screenshot(UserData::default()));
        }
        ctx.request_repaint_after(Duration::from_millis(30));
        false
    }

    /// Adds a picture; one like the last makes that one last longer. A film has one size.
    fn add(&mut self, picture: Picture) {
        match self.pictures.last_mut() {
            Some((last, time)) if *last == picture => *time += INTERVAL,
            Some((last, _)) if (last.width, last.height) != (picture.width, picture.height) => {}
            _ => self.pictures.push((picture, INTERVAL)),
        }
    }
}

/// A picture at a whole fraction of its size, at most [`WIDTH`] wide; each pixel is the mean of those that it stands for.
fn shrunk(image: &ColorImage) -> Picture {
    let step = image.width().div_ceil(WIDTH).max(1);
    let (width, height) = (image.width() / step, image.height() / step);
    let mut rgb = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let mut sums = [0usize; 3];
            for (dx, dy) in (0..step).flat_map(|dy| (0..step).map(move |dx| (dx, dy))) {
                let color = image[(x * step + dx, y * step + dy)];
                sums.iter_mut().zip([color.r(), color.g(), color.b()]).for_each(|(sum, c)| *sum += usize::from(c));
            }
            rgb.extend(sums.map(|sum| (sum / (step * step)) as u8));
        }
    }
    let size = |length: usize| u16::try_from(length).unwrap_or(u16::MAX);
    Picture { width: size(width), height: size(height), rgb }
}

fn write(file: &Path, pictures: &[(Picture, u16)]) -> Result<(), EncodingError> {
    let (width, height) = pictures.first().map_or((1, 1), |(first, _)| (first.width, first.height));
    let mut encoder = Encoder::new(BufWriter::new(File::create(file)?), width, height, &[])?;
    encoder.set_repeat(Repeat::Infinite)?;
    for (picture, time) in pictures {
        let mut frame = Frame::from_rgb_speed(picture.width, picture.height, &picture.rgb, SPEED);
        frame.delay = *time;
        encoder.write_frame(&frame)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::Color32;

    #[test]
    fn pictures_are_means_and_equal_ones_last_longer() {
        let image =
            ColorImage::new([1922, 6], (0..1922 * 6).map(|i| Color32::from_gray((i % 1922 % 3) as u8 * 30)).collect());
        let picture = shrunk(&image);
        assert_eq!((picture.width, picture.height), (640, 2));
        assert!(picture.rgb.iter().all(|value| *value == 30));
        let mut film = Film::new(PathBuf::new(), (0.0, 1.0));
        let other = Picture { rgb: vec![200; picture.rgb.len()], ..picture.clone() };
        [picture.clone(), picture.clone(), other, Picture { width: 1, height: 1, rgb: vec![0; 3] }]
            .into_iter()
            .for_each(|picture| film.add(picture));
        assert_eq!(film.pictures.iter().map(|(_, time)| *time).collect::<Vec<_>>(), [2 * INTERVAL, INTERVAL]);
        let file = std::env::temp_dir().join(format!("panoscope_film_{}.gif", std::process::id()));
        write(&file, &film.pictures).expect("written");
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(File::open(&file).expect("a file")).expect("a film");
        let first = decoder.read_next_frame().expect("whole").expect("a picture");
        assert_eq!((first.width, first.height, first.delay, first.buffer[0]), (640, 2, 2 * INTERVAL, 30));
        assert_eq!(decoder.read_next_frame().expect("whole").expect("another").buffer[0], 200);
        assert!(decoder.read_next_frame().expect("whole").is_none());
        std::fs::remove_file(&file).expect("removed");
    }
}
