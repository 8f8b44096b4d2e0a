//! A picture of the window for `--screenshot`, after a script of actions.

use std::sync::Arc;
use std::time::Duration;

use eframe::egui::{self, Context};

use super::App;
use crate::actions;
use crate::observe::Output;

impl App {
    pub(super) fn picture_of_window(&mut self, ctx: &Context) {
        let Some((file, after)) = self.options.screenshot.clone() else { return };
        let elapsed = self.start.elapsed().as_secs_f64();
        if elapsed > after * 0.4 && !self.options.script.is_empty() {
            let script = std::mem::take(&mut self.options.script);
            script.iter().for_each(|step| self.play(step));
        }
        let taken = ctx.input(|i| {
            i.events.iter().find_map(|e| match e {
                egui::Event::Screenshot { image, .. } => Some(Arc::clone(image)),
                _ => None,
            })
        });
        if let Some(image) = taken {
            let rgb: Vec<u8> = image.pixels.iter().flat_map(|p| [p.r(), p.g(), p.b()]).collect();
            let [width, height] = image.size.map(|n| n as u32);
            let saved = image::RgbImage::from_raw(width, height, rgb).map(|picture| picture.save(&file));
            match saved {
                Some(Ok(())) => println!("{}", file.display()),
                Some(Err(error)) => eprintln!("error: {} was not written: {error}", file.display()),
                None => eprintln!("error: the window gave no picture"),
            }
            let (ms, frames) = self.cost();
            println!("ui {ms:.2} ms per frame, {frames} frames in {elapsed:.1} s");
            self.options.screenshot = None;
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        } else if elapsed > after {
            ctx.send_viewport_cmd(egui::ViewportCommand::Screenshot(egui::UserData::default()));
            ctx.request_repaint_after(Duration::from_millis(200));
        } else {
            ctx.request_repaint_after(Duration::from_millis(100));
        }
    }

    /// One step of a script: `select:NODE`, `view:NODE.PORT`, `heat`, ...
    fn play(&mut self, step: &str) {
        let (word, rest) = step.split_once(':').unwrap_or((step, ""));
        match word {
            "select" => self.canvas.select_only(rest),
            "view" | "compare" if rest.contains('.') => {
                if let Some((node, port)) = rest.split_once('.') {
                    let output = Output::new(node, port);
                    match word {
                        "view" => self.look_at(output),
                        _ => {
                            let source = self.source(output);
                            self.viewer.compare(Some(source));
                        }
                    }
                }
            }
            _ => {
                let named = actions::ALL.iter().find(|(a, ..)| format!("{a:?}").eq_ignore_ascii_case(word));
                match named {
                    Some((action, ..)) => self.act(*action),
                    None => self.tell(format!("there is no action `{word}`"), true),
                }
            }
        }
    }
}
