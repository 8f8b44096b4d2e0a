//! A picture of the window for `--screenshot`, or its costs for `--measure`, after a script of actions.

use std::sync::Arc;
use std::time::Duration;

use eframe::egui::{self, Context};

use super::App;
use crate::actions;
use crate::observe::Output;

impl App {
    /// Does what `--do` asks for, once the graph has had time to start.
    pub(super) fn play_script(&mut self, ctx: &Context) {
        let after = self.options.screenshot.as_ref().or(self.options.measure.as_ref()).map_or(0.0, |(_, after)| *after);
        if self.start.elapsed().as_secs_f64() > (after * 0.4).min(4.0) && !self.options.script.is_empty() {
            let script = std::mem::take(&mut self.options.script);
            script.iter().for_each(|step| self.play(step));
        }
        if self.panning {
            let side = if (self.cost.2 / 60).is_multiple_of(2) { 4.0 } else { -4.0 };
            self.canvas.pan_by(egui::vec2(side, side / 2.0));
            ctx.request_repaint();
        }
    }

    /// Writes what the window cost, and how the graph did meanwhile.
    pub(super) fn measure(&mut self, ctx: &Context) {
        let Some((file, after)) = self.options.measure.clone() else { return };
        let seconds = self.start.elapsed().as_secs_f64();
        if seconds < after {
            return ctx.request_repaint_after(Duration::from_secs_f64((after - seconds).max(0.01)));
        }
        let (ui_ms, frames) = self.cost();
        let measured = (seconds - Self::WARM_UP.as_secs_f64()).max(1e-3);
        let report = self.session.handle().engine().map(|engine| engine.report());
        let json = serde_json::json!({
            "ui_ms": ui_ms,
            "ui_fps": frames as f64 / measured,
            "ui_cpu_pct": ui_ms * frames as f64 / measured / 10.0,
            "report": report,
        });
        if let Err(error) = std::fs::write(&file, format!("{json:#}\n")) {
            eprintln!("error: {} was not written: {error}", file.display());
        }
        self.options.measure = None;
        ctx.send_viewport_cmd(egui::ViewportCommand::Close);
    }

    pub(super) fn picture_of_window(&mut self, ctx: &Context) {
        let Some((file, after)) = self.options.screenshot.clone() else { return };
        let elapsed = self.start.elapsed().as_secs_f64();
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
            "pan" => self.panning = true,
            "zoom" => self.canvas.zoom_by(rest.parse().unwrap_or(0)),
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
