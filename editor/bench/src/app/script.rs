//! Performs the steps of a `--do` script.

use eframe::egui::{self, Context};

use super::App;
use crate::actions;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::ops;

impl App {
    /// Performs the steps that are due.
    pub(super) fn play_script(&mut self, ctx: &Context) {
        while let Some(step) = self.shot.step() {
            self.play(&step);
        }
        if self.panning {
            let side = if (self.costs.frames / 60).is_multiple_of(2) { 4.0 } else { -4.0 };
            self.canvas.pan_by(egui::vec2(side, side / 2.0));
            ctx.request_repaint();
        }
    }

    /// Performs one step of a script: `select:NODE`, `view:NODE.PORT`, `set:NODE.PARAM=VALUE`, `pick:NODE.PARAM`, `browse:NODE.PARAM`,
    /// `sweep:NODE.PARAM MEASURE`, `wire:NODE.OUTPUT NODE.INPUT`, `orbit:YAW,PITCH,ZOOM`, `heat`, ...
    fn play(&mut self, step: &str) {
        let (word, rest) = step.split_once(':').unwrap_or((step, ""));
        match (word, rest.split_once('.')) {
            ("pick", Some((node, param))) => return self.begin_picking(node, param),
            ("browse", Some((node, param))) => return self.browse(node, param),
            ("set", Some((node, rest))) => return self.set_from_script(node, rest),
            ("sweep", Some(_)) => return self.sweep_from_script(rest),
            ("wire", Some(_)) => return self.wire_from_script(rest),
            _ => {}
        }
        match word {
            "pan" => self.panning = true,
            "zoom" => self.canvas.zoom_by(rest.parse().unwrap_or(0)),
            "orbit" => match rest.split(',').map(|n| n.trim().parse()).collect::<Result<Vec<f32>, _>>().as_deref() {
                Ok([yaw, pitch, zoom]) => self.viewer.view3d().look_from(*yaw, *pitch, *zoom),
                _ => self.notify("orbit needs yaw and pitch in rad and the zoom: orbit:1.2,0.3,0.5", true),
            },
            "select" => self.canvas.select_only(rest),
            "view" | "compare" if rest.contains('.') => {
                if let Some((node, port)) = rest.split_once('.') {
                    let output = Output::new(node, port);
                    match word {
                        "view" => self.view_large(output),
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
                    Some((action, ..)) => self.perform(*action),
                    None => self.notify(format!("there is no action `{word}`"), true),
                }
            }
        }
    }

    fn wire_from_script(&mut self, rest: &str) {
        let ends = rest.split_once(' ').and_then(|(from, to)| Some((from.split_once('.')?, to.split_once('.')?)));
        let Some(((from, output), to)) = ends else {
            return self.notify("wire needs an output and an input: wire:NODE.OUTPUT NODE.INPUT", true);
        };
        let result = ops::wire(&mut self.document, &Output::new(from, output), to, None, None);
        self.try_edit(result);
    }
}
