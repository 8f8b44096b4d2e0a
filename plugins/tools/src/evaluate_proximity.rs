//! `evaluate_proximity`: false and missed warnings, compared with exactly known distances.

use panoscope_arm_core::tracking::proximity::{Judge, Rule, Verdict};
use panoscope_node::{Context, Node, NodeInfo, Open, Params, Ports, Result, Slot, Table, TableData, error};

use crate::proximity;

/// Input ports of `evaluate_proximity`.
#[derive(Ports)]
pub struct In<'f> {
    /// Table of `proximity`. A tip without a row has no warning.
    table: Option<Table<'f>>,
    /// True distances (`clearance` of the phantom): `track_id`, `seen`, `tissue_mm`, `tip_mm`. Ticks in which a tip is not visible are not evaluated.
    truth: Table<'f>,
}

/// Output ports of `evaluate_proximity`.
#[derive(Ports)]
pub struct Out<'f> {
    /// Counts since the start, for all tips together. The first row applies the thresholds exactly, the second one tolerates `margin_mm` around them.
    /// Columns for warnings of tissue, then of other tips.
    table: Slot<'f, TableData>,
}

/// Parameters. The first four must match those of `proximity`.
#[derive(Params)]
pub struct JudgeParams {
    /// Distance to the tissue below which a tip counts as near.
    #[param(default = 5.0, range = 0.1..=50.0, step = 0.1, unit = "mm", reopen)]
    warn_mm: f64,
    /// Distance between tips below which they count as near.
    #[param(default = 8.0, range = 0.1..=100.0, step = 0.1, unit = "mm", reopen)]
    tips_mm: f64,
    /// Hysteresis: a warning ends at a distance larger by this than where it begins.
    #[param(default = 1.0, range = 0.0..=20.0, step = 0.1, unit = "mm", reopen)]
    release_mm: f64,
    /// Time for which a distance must stay beyond a threshold before a warning begins or ends.
    #[param(default = 60.0, range = 0.0..=5000.0, step = 10.0, unit = "ms", reopen)]
    min_ms: f64,
    /// Tolerance around each threshold: approaches and warnings within it count neither as correct nor as wrong.
    #[param(default = 1.0, range = 0.0..=20.0, step = 0.1, unit = "mm", reopen)]
    margin_mm: f64,
    /// Maximum delay of a warning.
    #[param(default = 200.0, range = 0.0..=5000.0, step = 10.0, unit = "ms", reopen)]
    delay_ms: f64,
}

/// Columns of the table.
pub const COLUMNS: [&str; 19] = [
    "margin_mm",
    "tissue_ticks",
    "tissue_approaches",
    "tissue_missed",
    "tissue_warnings",
    "tissue_false",
    "tissue_delay_ms",
    "tissue_delay_max_ms",
    "tissue_rms_mm",
    "tissue_known",
    "tips_ticks",
    "tips_approaches",
    "tips_missed",
    "tips_warnings",
    "tips_false",
    "tips_delay_ms",
    "tips_delay_max_ms",
    "tips_rms_mm",
    "tips_known",
];

/// Maximum number of tips that are evaluated.
const MAX_TIPS: usize = 16;

/// Counts of one tip: warnings of tissue and of other tips, with exact thresholds and with the margin.
struct Tip {
    track_id: f64,
    judges: [[Judge; 2]; 2],
}

/// The `evaluate_proximity` node.
#[derive(Default)]
pub struct EvaluateProximity {
    tips: Vec<Tip>,
}

/// Indices of columns in a table.
fn columns<const N: usize>(table: &Table<'_>, what: &str, names: [&str; N]) -> Result<[usize; N]> {
    let mut places = [0; N];
    for (place, name) in places.iter_mut().zip(names) {
        *place = table.names().position(|n| n == name).ok_or_else(|| {
            error!("the table at `{what}` has no column `{name}`: connect a table with {}", names.join(", "))
        })?;
    }
    Ok(places)
}

impl Node for EvaluateProximity {
    const INFO: NodeInfo = NodeInfo::compute(
        "evaluate_proximity",
        "tools",
        "Counts false and missed warnings of `proximity`, compared with exactly known distances.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = JudgeParams;

    fn open(_: &Open<'_>, _: &JudgeParams) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &JudgeParams) -> Result<()> {
        let now_s = cx.tick().capture_ns as f64 * 1e-9;
        let [id, seen, tissue, tip] = columns(&input.truth, "truth", ["track_id", "seen", "tissue_mm", "tip_mm"])?;
        let names = [proximity::COLUMNS[0], "tissue_mm", "tissue_state", "tip_mm", "tip_state"];
        let found = match &input.table {
            Some(table) => Some((table, columns(table, "table", names)?)),
            None => None,
        };
        let rule = |on_mm: f64| Rule { on_mm, off_mm: on_mm + params.release_mm, min_s: params.min_ms * 1e-3 };
        for truth in input.truth.rows().filter(|row| row[seen] > 0.5) {
            let index = match self.tips.iter().position(|known| known.track_id == truth[id]) {
                Some(index) => index,
                None if self.tips.len() == MAX_TIPS => continue,
                None => {
                    let judge = |on_mm: f64, margin_mm: f64| Judge::new(rule(on_mm), margin_mm, params.delay_ms * 1e-3);
                    let both = |on_mm: f64| [judge(on_mm, 0.0), judge(on_mm, params.margin_mm)];
                    self.tips.push(Tip { track_id: truth[id], judges: [both(params.warn_mm), both(params.tips_mm)] });
                    self.tips.len() - 1
                }
            };
            let row = found.as_ref().and_then(|(table, at)| {
                let row = table.rows().find(|row| row[at[0]] == truth[id])?;
                Some([row[at[1]], row[at[2]], row[at[3]], row[at[4]]])
            });
            let [tissue_mm, tissue_state, tip_mm, tip_state] = row.unwrap_or([f64::NAN, 0.0, f64::NAN, 0.0]);
            let [of_tissue, of_tips] = &mut self.tips[index].judges;
            of_tissue.iter_mut().for_each(|judge| judge.step(now_s, truth[tissue], tissue_mm, tissue_state > 0.5));
            if truth[tip].is_finite() {
                of_tips.iter_mut().for_each(|judge| judge.step(now_s, truth[tip], tip_mm, tip_state > 0.5));
            }
        }
        let mut rows = [0.0; 2 * COLUMNS.len()];
        for (margin, row) in rows.chunks_exact_mut(COLUMNS.len()).enumerate() {
            row[0] = [0.0, params.margin_mm][margin];
            for (kind, part) in row[1..].chunks_exact_mut(9).enumerate() {
                let mut sum = Verdict::default();
                self.tips.iter().for_each(|tip| sum.add(&tip.judges[kind][margin].verdict()));
                part.copy_from_slice(&[
                    sum.ticks as f64,
                    sum.approaches as f64,
                    sum.missed as f64,
                    sum.warnings as f64,
                    sum.false_warnings as f64,
                    sum.delay_s() * 1e3,
                    sum.delay_max_s * 1e3,
                    sum.rms_mm(),
                    sum.distances as f64,
                ]);
                if margin == 1 && kind == 0 {
                    cx.metric("missed", sum.missed as f64);
                    cx.metric("false_warnings", sum.false_warnings as f64);
                }
            }
        }
        out.table.set_table(&COLUMNS, &rows)
    }
}
