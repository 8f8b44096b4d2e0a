//! `skill`: measures how skilfully instruments are moved, during the operation (thesis, abstract). The measures are defined in
//! `panoscope_arm_core::tracking::skill`.

use std::collections::VecDeque;
use std::fmt::Write;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use panoscope_arm_core::tracking::skill::measures::FIGURES;
use panoscope_arm_core::tracking::skill::{Measures, Sample, Session, Settings};
use panoscope_node::abi::{Pose, Tip};
use panoscope_node::{
    Choice, Context, List, Node, NodeInfo, Open, Params, Ports, Result, Slot, Table, TableData, Text, TextPacket,
    Value, error,
};

/// Input ports of `skill`.
#[derive(Ports)]
pub struct In<'f> {
    /// Tips in the left rectified camera's frame, mm. Connect one `tip_track` per hand.
    tip: List<'f, Value<'f, Tip>>,
    /// Pose of the left camera in the scene. Without it the camera's own movement counts as the tips' movement.
    camera_pose: Option<Value<'f, Pose>>,
    /// Name of the current phase of the operation.
    phase: Option<Text<'f>>,
    /// Table of `proximity`. With it, touches of the tissue are counted.
    proximity: Option<Table<'f>>,
}

/// Output ports of `skill`.
#[derive(Ports)]
pub struct Out<'f> {
    /// One row per tool and phase: number and class of the tool, number of the phase (-1: all phases), then all measures since the start. Times count
    /// from the tool's first frame.
    table: Slot<'f, TableData>,
    /// One row per pair of tools: their numbers, time with both in view, time with both moving, share of the movement made together, correlation of
    /// their speeds.
    pairs: Slot<'f, TableData>,
    /// The main measures as text, one line per tool.
    text: Slot<'f, TextPacket>,
}

/// Which tips belong to one tool.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Tools {
    /// Tips at one input: each hand has its own.
    Input,
    /// Tips with one number.
    Track,
    /// Tips of one class.
    Class,
}

/// Parameters of `skill`.
#[derive(Params)]
pub struct SkillParams {
    /// Which tips belong to one tool.
    #[param(default = "input", reopen)]
    tools: Tools,
    /// Minimum score of a tip that is used. The score of a predicted tip falls with time.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f64,
    /// Maximum gap between two tips that is bridged. After a longer gap the tool was out of view.
    #[param(default = 250.0, range = 10.0..=5000.0, step = 10.0, unit = "ms", reopen)]
    max_gap_ms: f64,
    /// Half the width of the window over which speed is computed.
    #[param(default = 80.0, range = 10.0..=1000.0, step = 10.0, unit = "ms", reopen)]
    window_ms: f64,
    /// Speed below which a tool counts as resting.
    #[param(default = 3.0, range = 0.1..=50.0, step = 0.1, unit = "mm/s", reopen)]
    rest_mm_s: f64,
    /// Minimum duration of a rest that counts as idle time.
    #[param(default = 300.0, range = 10.0..=10000.0, step = 10.0, unit = "ms", reopen)]
    rest_ms: f64,
    /// Distance between the knots of the spline from which jerk is computed.
    #[param(default = 100.0, range = 20.0..=1000.0, step = 10.0, unit = "ms", reopen)]
    knot_ms: f64,
    /// Distance to the tissue below which a tip counts as touching it.
    #[param(default = 1.5, range = -5.0..=20.0, step = 0.1, unit = "mm", reopen)]
    touch_mm: f64,
    /// Minimum duration of a touch.
    #[param(default = 200.0, range = 0.0..=10000.0, step = 10.0, unit = "ms", reopen)]
    touch_ms: f64,
}

/// Columns of the table before the measures.
const KEYS: [&str; 3] = ["tool", "class_index", "phase"];
/// All columns of the table.
pub const COLUMNS: [&str; KEYS.len() + FIGURES.len()] = {
    let mut names = [""; KEYS.len() + FIGURES.len()];
    let mut at = 0;
    while at < names.len() {
        names[at] = if at < KEYS.len() { KEYS[at] } else { FIGURES[at - KEYS.len()].name };
        at += 1;
    }
    names
};
/// Columns of the pairs.
pub const PAIRS: [&str; 6] = ["a", "b", "seen_s", "both_s", "overlap", "correlation"];

/// Maximum number of poses of the camera that are stored for late tips.
const MAX_POSES: usize = 64;

/// The `skill` node.
pub struct Skill {
    session: Session,
    poses: VecDeque<(i64, Isometry3<f64>)>,
    /// Class of each tool; capture time of the newest tip of each input, ns.
    classes: Vec<u32>,
    looked_ns: Vec<i64>,
    refused: bool,
    rows: Vec<f64>,
    words: String,
}

fn settings(params: &SkillParams) -> Settings {
    Settings {
        max_gap_s: params.max_gap_ms * 1e-3,
        window_s: params.window_ms * 1e-3,
        rest_mm_s: params.rest_mm_s,
        rest_s: params.rest_ms * 1e-3,
        knot_s: params.knot_ms * 1e-3,
        touch_mm: params.touch_mm,
        touch_s: params.touch_ms * 1e-3,
    }
}

fn pose_of(pose: &Pose) -> Option<Isometry3<f64>> {
    let [w, x, y, z] = pose.a_from_b_wxyz;
    let [tx, ty, tz] = pose.a_from_b_mm;
    let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)?;
    let all = [w, x, y, z, tx, ty, tz];
    all.iter().all(|v| v.is_finite()).then(|| Isometry3::from_parts(Translation3::new(tx, ty, tz), turn))
}

/// Distance to the tissue of the tip with this number, from the table of `proximity`, mm; NaN if it is unknown.
fn tissue_mm(table: &Table<'_>, track_id: i64) -> Result<f64> {
    let column = |name: &str| {
        let place = table.names().position(|n| n == name);
        place.ok_or_else(|| {
            error!("the table at `proximity` has no column `{name}`: connect the table of a `proximity` node")
        })
    };
    let (id, tissue) = (column("track_id")?, column("tissue_mm")?);
    Ok(table.rows().find(|row| row[id] == track_id as f64).map_or(f64::NAN, |row| row[tissue]))
}

impl Skill {
    fn set_text(&mut self) {
        self.words.clear();
        for (tool, class) in self.session.tools().zip(&self.classes) {
            let m = tool.total;
            let _ = write!(
                self.words,
                "tool {} (class {class}): {:.0} s in view, {:.0} mm, {:.0} % idle, economy {:.2}",
                tool.key,
                m.seen_s(),
                m.path_mm(),
                100.0 * m.idle_share(),
                m.economy()
            );
            let _ = writeln!(self.words, ", log dimensionless jerk {:.1}", m.ldlj.mean());
        }
    }
}

impl Skill {
    /// Adds a tip to the session of its tool.
    fn observe(
        &mut self,
        cx: &Context<'_>,
        input: &In<'_>,
        index: usize,
        tip: &Value<'_, Tip>,
        params: &SkillParams,
    ) -> Result<()> {
        let key = match params.tools {
            Tools::Input => index as u64,
            Tools::Track => tip.track_id as u64,
            Tools::Class => u64::from(tip.class_index),
        };
        let Some(tool) = self.session.tool(key, String::new) else {
            if !std::mem::replace(&mut self.refused, true) {
                cx.warn("more than 16 tools: the last ones are not measured; set `tools = \"class\"` to have fewer");
            }
            return Ok(());
        };
        self.classes.resize(self.classes.len().max(tool + 1), 0);
        self.classes[tool] = tip.class_index;
        let seen_ns = tip.tick().capture_ns;
        let then = self.poses.iter().min_by_key(|(pose_ns, _)| pose_ns.abs_diff(seen_ns));
        let room = then.map_or_else(Isometry3::identity, |(_, room)| *room) * Point3::from(tip.xyz_mm);
        let tissue_mm = match &input.proximity {
            Some(table) => tissue_mm(table, tip.track_id)?,
            None => f64::NAN,
        };
        let sample = Sample {
            at_s: seen_ns as f64 * 1e-9,
            place_mm: [room.x, room.y, room.z],
            depth_mm: tip.xyz_mm[2],
            tissue_mm,
        };
        self.session.observe(tool, sample);
        Ok(())
    }

    /// Fills the rows with the measures of each tool, in all and in each phase.
    fn set_tool_rows(&mut self) {
        self.rows.clear();
        for (tool, class) in self.session.tools().zip(&self.classes) {
            let rows = &mut self.rows;
            let mut add = |phase: f64, measures: &Measures| {
                rows.extend([tool.key as f64, f64::from(*class), phase]);
                rows.extend(FIGURES.iter().map(|figure| (figure.of)(measures)));
            };
            add(-1.0, tool.total);
            for (phase, measures) in tool.phases.iter().enumerate().filter(|(_, measures)| !measures.is_empty()) {
                add(phase as f64, measures);
            }
        }
    }

    /// Fills the rows with the measures of each pair of tools.
    fn set_pair_rows(&mut self) {
        self.rows.clear();
        let keys = |number: usize| self.session.tools().nth(number).map_or(f64::NAN, |tool| tool.key as f64);
        for (a, b, both, _) in self.session.pairs() {
            let figures = [both.seen_s(), both.both_s(), both.overlap(), both.correlation()];
            self.rows.extend([keys(a), keys(b)]);
            self.rows.extend(figures);
        }
    }
}

impl Node for Skill {
    const INFO: NodeInfo = NodeInfo::compute(
        "skill",
        "tools",
        "Measures surgical skill from the tracks of tips: path, economy, smoothness, idleness, working room, both hands.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = SkillParams;

    fn open(_: &Open<'_>, params: &SkillParams) -> Result<Self> {
        Ok(Self {
            session: Session::new(settings(params)),
            poses: VecDeque::with_capacity(MAX_POSES),
            classes: Vec::new(),
            looked_ns: Vec::new(),
            refused: false,
            rows: Vec::new(),
            words: String::new(),
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &SkillParams) -> Result<()> {
        let now_ns = cx.tick().capture_ns;
        let room_from_camera = match &input.camera_pose {
            Some(pose) => pose_of(pose).ok_or_else(|| {
                error!("the camera pose is not valid: its numbers are not finite, or its quaternion is 0")
            })?,
            None => Isometry3::identity(),
        };
        if self.poses.len() == MAX_POSES {
            self.poses.pop_front();
        }
        self.poses.push_back((now_ns, room_from_camera));
        if let Some(phase) = &input.phase {
            let name = phase.lines().next().unwrap_or("").trim();
            self.session.set_phase(name);
        }
        self.looked_ns.resize(input.tip.len(), i64::MIN);
        for (index, tip) in input.tip.iter().enumerate().filter_map(|(index, tip)| Some((index, tip?))) {
            let seen_ns = tip.tick().capture_ns;
            let is_new = std::mem::replace(&mut self.looked_ns[index], seen_ns) < seen_ns;
            if !is_new || tip.xyz_valid != 1 || tip.score < params.min_score {
                continue;
            }
            self.observe(cx, &input, index, &tip, params)?;
        }
        self.session.advance(now_ns as f64 * 1e-9);
        if out.table.is_read() {
            self.set_tool_rows();
            if !self.rows.is_empty() {
                out.table.set_table(&COLUMNS, &self.rows)?;
            }
        }
        if out.pairs.is_read() {
            self.set_pair_rows();
            if !self.rows.is_empty() {
                out.pairs.set_table(&PAIRS, &self.rows)?;
            }
        }
        if out.text.is_read() && !self.classes.is_empty() {
            self.set_text();
            out.text.set_text(self.words.trim_end())?;
        }
        Ok(())
    }
}
