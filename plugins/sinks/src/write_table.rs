//! `write_table`: numbers as JSON lines or CSV; detections and instances as COCO JSON too.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use panoscope_node::abi::{Homography, Joints, Pose, Roi, Scalar, Tip};
use panoscope_node::{
    Context, Detections, Finish, Instances, NoPorts, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Table,
    Text, Validation, Value,
};

use crate::formats::coco::{Coco, run_lengths};
use crate::target::{Growing, Pattern, SinkError, Wholes, check_name, check_path, claim};
use panoscope_formats::fields::{self, CsvFields, Fields, JsonFields, csv_cell};
use panoscope_formats::json;

const ENDINGS: &str = "jsonl, ndjson, csv, json";
/// Inputs that COCO's form has no room for.
const NOT_IN_COCO: [&str; 8] = ["table", "scalar", "homography", "roi", "tip", "pose", "joints", "text"];

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Named columns of numbers.
    pub table: Option<Table<'f>>,
    /// A number.
    pub scalar: Option<Value<'f, Scalar>>,
    /// Registration of the views.
    pub homography: Option<Value<'f, Homography>>,
    /// A rectangle, px.
    pub roi: Option<Value<'f, Roi>>,
    /// Tip of a tool.
    pub tip: Option<Value<'f, Tip>>,
    /// Pose of one coordinate frame in another.
    pub pose: Option<Value<'f, Pose>>,
    /// Angles and speeds of the arm.
    pub joints: Option<Value<'f, Joints>>,
    /// A text.
    pub text: Option<Text<'f>>,
    /// Boxes.
    pub detections: Option<Detections<'f>>,
    /// Boxes with masks.
    pub instances: Option<Instances<'f>>,
}

/// Parameters.
#[derive(Params)]
pub struct Settings {
    /// File to write: .jsonl holds one JSON object per tick, .csv one line per tick or table row, .json is one COCO file of all
    /// detections or instances, written at the end; until then they are JSON lines in a file beside it, ending in .json.journal. A node that is
    /// opened again in the same run continues in .part2.jsonl and so on.
    #[param(default = "out/table.jsonl", reopen, writes)]
    pub path: PathBuf,
    /// Name of each tick's picture in a COCO file; `{seq}` becomes the tick's number. Empty: number and .png.
    #[param(default = "", reopen)]
    pub image_name: String,
}

enum Form {
    /// Whole lines are handed to the system one by one, so that a crash leaves a file of whole lines.
    Lines(Growing),
    Csv {
        file: Growing,
        columns: Vec<String>,
        loss_reported: bool,
    },
    /// Written at the end; the journal holds what has come so far, in case that the end does not.
    Coco {
        coco: Coco,
        image_name: Pattern,
        journal: Growing,
        /// The file to write, known once the first tick has come.
        begun: Option<PathBuf>,
    },
}

/// Writes numbers.
pub struct WriteTable {
    path: PathBuf,
    form: Form,
    line: String,
    lines: u64,
}

impl Node for WriteTable {
    const INFO: NodeInfo = NodeInfo::blocking(
        "write_table",
        "sink",
        "Writes numbers as JSON lines or CSV, detections and instances as COCO JSON.",
    )
    .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        let Some(ending) = check_path(check, &params.path, "table.jsonl", ENDINGS) else { return };
        let is_connected = |name: &&str| check.is_connected(name) == Some(true);
        if ending == "json"
            && let Some(other) = NOT_IN_COCO.iter().find(|name| is_connected(name))
        {
            let message = format!("a .json file holds detections or instances in COCO's form, not input `{other}`");
            check.error("path", message, "write it to .jsonl or .csv");
        } else if ending == "csv" && ["table", "detections"].iter().all(is_connected) {
            let message = "a CSV file has one kind of line: `table` and `detections` are both connected";
            check.error("path", message, "give each a `write_table`, or write .jsonl");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let path = params.path.clone();
        let ending = check_name(&path, "table.jsonl", ENDINGS)?;
        claim(open, &path)?;
        let file = Growing::new(&path);
        let image_name = if params.image_name.is_empty() { "{seq}.png" } else { &params.image_name };
        let form = match ending.as_str() {
            "csv" => Form::Csv { file, columns: Vec::new(), loss_reported: false },
            "json" => {
                let image_name = Pattern::new(image_name.as_ref());
                Form::Coco { coco: Coco::default(), image_name, journal: file, begun: None }
            }
            _ => Form::Lines(file),
        };
        Ok(Self { path, form, line: String::new(), lines: 0 })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, _: &Settings) -> Result<()> {
        self.line.clear();
        match &mut self.form {
            Form::Lines(file) => {
                json_line(&mut self.line, cx, &input);
                file.append(cx, self.line.as_bytes())?;
                self.lines += 1;
            }
            Form::Csv { file, columns, loss_reported } => {
                if input.detections.is_some() && input.table.is_some() {
                    return Err(NodeError::new(
                        "a CSV file has one kind of line: give `table` and `detections` a `write_table` each, or write .jsonl",
                    ));
                }
                let (columns_before, lines_before) = (columns.len(), self.lines);
                for cells in csv_lines(cx, &input) {
                    // An empty tick has nothing to name columns after.
                    if cells.len() <= 3 && columns.is_empty() {
                        continue;
                    }
                    if columns.is_empty() {
                        columns.extend(cells.iter().map(|(name, _)| name.clone()));
                        let names: Vec<String> = columns.iter().map(|name| csv_cell(name)).collect();
                        let _ = writeln!(self.line, "{}", names.join(","));
                    }
                    for (index, name) in columns.iter().enumerate() {
                        let cell = cells.iter().find(|(n, _)| n == name).map_or("", |(_, cell)| cell);
                        let _ = write!(self.line, "{}{cell}", if index == 0 { "" } else { "," });
                    }
                    self.line.push('\n');
                    self.lines += 1;
                    if !*loss_reported && let Some((name, _)) = cells.iter().find(|(name, _)| !columns.contains(name)) {
                        *loss_reported = true;
                        cx.warn(&format!(
                            "column `{name}` came after the file's first line and is left out: .jsonl would keep it"
                        ));
                    }
                }
                if let Err(error) = file.append(cx, self.line.as_bytes()) {
                    columns.truncate(columns_before);
                    self.lines = lines_before;
                    return Err(error);
                }
            }
            Form::Coco { coco, image_name, journal, begun } => {
                let others = [
                    input.table.is_some(),
                    input.scalar.is_some(),
                    input.homography.is_some(),
                    input.roi.is_some(),
                    input.tip.is_some(),
                    input.pose.is_some(),
                    input.joints.is_some(),
                    input.text.is_some(),
                ];
                if others.contains(&true) {
                    return Err(NodeError::new(
                        "a .json file holds detections or instances in COCO's form: write other inputs to .jsonl or .csv",
                    ));
                }
                if begun.is_none() {
                    let file = cx.begin_file(&self.path, true)?;
                    journal.create(journal_of(&file))?;
                    // That of an earlier run must not pass for this one's, should this run be cut off.
                    let _ = std::fs::remove_file(&file);
                    *begun = Some(file);
                }
                json_line(&mut self.line, cx, &input);
                if let Err(error) = journal.append(cx, self.line.as_bytes()) {
                    if !journal.is_begun() {
                        *begun = None;
                    }
                    return Err(error);
                }
                let seq = cx.tick().seq;
                let name = image_name.file(seq, "image", false);
                // Instances repeat the boxes of their detections.
                if let Some(instances) = &input.instances {
                    coco.push_instances(seq, &name.to_string_lossy(), instances);
                } else if let Some(detections) = &input.detections {
                    coco.push_detections(seq, &name.to_string_lossy(), detections);
                }
                self.lines = coco.ticks();
            }
        }
        cx.metric("lines", self.lines as f64);
        Ok(())
    }

    fn finish(&mut self, cx: &Finish<'_>) -> Result<()> {
        match &mut self.form {
            Form::Lines(file) | Form::Csv { file, .. } => file.finish(cx),
            Form::Coco { begun, .. } => {
                if begun.is_none() {
                    let file = cx.begin_file(&self.path, true)?;
                    *begun = (file == self.path).then_some(file);
                }
                Ok(self.complete_coco()?)
            }
        }
    }
}

/// Where the ticks of a COCO file are until it is complete.
fn journal_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".journal");
    name.into()
}

impl WriteTable {
    /// Writes the COCO file, if its node is one of those, and removes its journal.
    fn complete_coco(&mut self) -> Result<(), SinkError> {
        let Form::Coco { coco, begun, .. } = &mut self.form else { return Ok(()) };
        let Some(path) = begun.take() else { return Ok(()) };
        let mut whole = Wholes::default();
        whole
            .write(&path, |file| file.write_all(coco.text().as_bytes()).map_err(|error| SinkError::io(&path, error)))?;
        whole.finish()?;
        let _ = std::fs::remove_file(journal_of(&path));
        Ok(())
    }
}

impl Drop for WriteTable {
    fn drop(&mut self) {
        if let Err(error) = self.complete_coco() {
            // `finish` was not called, and no running call can report the error.
            eprintln!("panoscope: write_table: {error}");
        }
    }
}

/// One value per packet type: its key, and its parts.
fn each_value(input: &In<'_>, mut take: impl FnMut(&str, &dyn Fn(&mut dyn Fields))) {
    if let Some(v) = &input.scalar {
        take("scalar", &|out| fields::scalar(v, out));
    }
    if let Some(v) = &input.homography {
        take("homography", &|out| fields::homography(v, out));
    }
    if let Some(v) = &input.roi {
        take("roi", &|out| fields::roi(v, out));
    }
    if let Some(v) = &input.tip {
        take("tip", &|out| fields::tip(v, out));
    }
    if let Some(v) = &input.pose {
        take("pose", &|out| fields::pose(v, out));
    }
    if let Some(v) = &input.joints {
        take("joints", &|out| fields::joints(v, out));
    }
}

fn json_line(out: &mut String, cx: &Context<'_>, input: &In<'_>) {
    let tick = cx.tick();
    let _ = write!(out, "{{\"seq\":{},\"source\":{},\"capture_ms\":", tick.seq, tick.source);
    json::number(out, tick.capture_ns as f64 / 1e6);
    each_value(input, |name, parts| {
        json::key(out, name);
        out.push('{');
        parts(&mut JsonFields(out));
        out.push('}');
    });
    if let Some(text) = &input.text {
        json::key(out, "text");
        json::string(out, text);
    }
    if let Some(table) = &input.table {
        json::key(out, "table");
        out.push('[');
        for (index, row) in table.rows().enumerate() {
            out.push_str(if index == 0 { "{" } else { ",{" });
            for (name, value) in table.names().zip(row) {
                JsonFields(out).number(name, *value);
            }
            out.push('}');
        }
        out.push(']');
    }
    if let Some(detections) = &input.detections {
        json_boxes(out, "detections", detections, None);
    }
    if let Some(instances) = &input.instances {
        json_boxes(out, "instances", &instances.detections(), Some(instances));
    }
    out.push_str("}\n");
}

fn json_boxes(out: &mut String, name: &str, detections: &Detections<'_>, masks: Option<&Instances<'_>>) {
    let (width, height) = detections.image_size();
    json::key(out, name);
    out.push('[');
    for (index, item) in detections.items().iter().enumerate() {
        out.push_str(if index == 0 { "{" } else { ",{" });
        fields::detection(item, detections.label(item.class_index), &mut JsonFields(out));
        if let Some(instances) = masks {
            let counts = run_lengths(instances.mask(index), width, height);
            let _ = write!(out, ",\"segmentation\":{{\"size\":[{height},{width}],\"counts\":{counts:?}}}");
        }
        out.push('}');
    }
    out.push(']');
}

/// The lines of a tick: one per table row or box, else one.
fn csv_lines(cx: &Context<'_>, input: &In<'_>) -> Vec<Vec<(String, String)>> {
    let tick = cx.tick();
    let mut head = CsvFields::default();
    head.number("seq", tick.seq as f64);
    head.number("source", f64::from(tick.source));
    head.number("capture_ms", tick.capture_ns as f64 / 1e6);
    each_value(input, |name, parts| {
        head.prefix = format!("{name}.");
        parts(&mut head);
    });
    head.prefix.clear();
    if let Some(text) = &input.text {
        head.text("text", text);
    }
    let boxes = input.instances.map(|instances| instances.detections()).or(input.detections);
    match (&input.table, boxes) {
        (Some(table), _) => table
            .rows()
            .map(|row| {
                let mut line = head.clone();
                for (name, value) in table.names().zip(row) {
                    line.number(name, *value);
                }
                line.cells
            })
            .collect(),
        (None, Some(boxes)) => boxes
            .items()
            .iter()
            .map(|item| {
                let mut line = head.clone();
                fields::detection(item, boxes.label(item.class_index), &mut line);
                line.cells
            })
            .collect(),
        (None, None) => vec![head.cells],
    }
}
