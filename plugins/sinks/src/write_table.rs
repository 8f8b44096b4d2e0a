//! `write_table`: numbers as JSON lines or CSV; detections and instances also as COCO JSON.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use panoscope_node::abi::{Homography, Joints, Pose, Roi, Scalar, Tip};
use panoscope_node::{
    Context, Detections, Finish, Instances, NoPorts, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Table,
    Text, Validation, Value,
};

use crate::formats::coco::{Coco, run_lengths};
use crate::target::{Growing, Pattern, SinkError, check_name, check_path, claim, write_whole};
use panoscope_data::formats::fields::{self, CsvFields, Fields, JsonFields};
use panoscope_data::formats::json;

/// Number of cells of the tick itself in each line of a CSV file.
const TICK_CELLS: usize = 3;
const ENDINGS: &str = "jsonl, ndjson, csv, json";
/// Inputs that COCO's format cannot hold.
const NOT_IN_COCO: [&str; 8] = ["table", "scalar", "homography", "roi", "tip", "pose", "joints", "text"];

/// Input ports of `write_table`.
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

/// Parameters of `write_table`.
#[derive(Params)]
pub struct Settings {
    /// File to write. .jsonl: one JSON object per tick. .csv: one line per tick or table row. .json: one COCO file of all detections or instances,
    /// written at the end; until then each tick is a line of a file with the extension .json.journal next to it, which remains if the run is cut off.
    /// A node that is reopened in the same run continues in .part2.jsonl and so on.
    #[param(default = "out/table.jsonl", reopen, writes)]
    pub path: PathBuf,
    /// Name of each tick's image in a COCO file; `{seq}` becomes the tick's number. Empty: number and .png.
    #[param(default = "", reopen)]
    pub image_name: String,
}

enum Form {
    /// Complete lines are passed to the system one by one, so that a crash leaves a file of complete lines.
    Lines(Growing),
    Csv(Csv),
    /// Written at the end from the journal, which remains if the run is cut off.
    Coco {
        coco: Coco,
        image_name: Pattern,
        journal: Growing,
        /// The file to write, known after the first tick.
        begun: Option<PathBuf>,
    },
}

/// State of a CSV file.
struct Csv {
    file: Growing,
    columns: Vec<String>,
    loss_reported: bool,
    /// Cells of one line; the memory is reused.
    cells: CsvFields,
}

impl Csv {
    fn new(file: Growing) -> Self {
        Self { file, columns: Vec::new(), loss_reported: false, cells: CsvFields::default() }
    }

    /// Appends the lines of a tick to `out`: one per table row or box, else one. Returns their number.
    fn push_tick(&mut self, cx: &Context<'_>, input: &In<'_>, out: &mut String) -> u64 {
        let mut cells = std::mem::take(&mut self.cells);
        csv_head(&mut cells, cx, input);
        let head = cells.len();
        let mut lines = 0;
        let boxes = input.instances.map(|instances| instances.detections()).or(input.detections);
        match (&input.table, boxes) {
            (Some(table), _) => {
                for row in table.rows() {
                    cells.truncate(head);
                    for (name, value) in table.names().zip(row) {
                        cells.number(name, *value);
                    }
                    lines += self.push_line(cx, &cells, out);
                }
            }
            (None, Some(boxes)) => {
                for item in boxes.items() {
                    cells.truncate(head);
                    fields::detection(item, boxes.label(item.class_index), &mut cells);
                    lines += self.push_line(cx, &cells, out);
                }
            }
            (None, None) => lines += self.push_line(cx, &cells, out),
        }
        self.cells = cells;
        lines
    }

    /// Appends a line to `out`, after the header if it is the first one. Returns 1, or 0 if there was nothing to write.
    fn push_line(&mut self, cx: &Context<'_>, cells: &CsvFields, out: &mut String) -> u64 {
        // An empty tick has nothing to name columns after.
        if cells.len() <= TICK_CELLS && self.columns.is_empty() {
            return 0;
        }
        if self.columns.is_empty() {
            self.columns.extend(cells.iter().map(|(name, _)| name.to_owned()));
            fields::csv_line(out, &self.columns);
        }
        for (index, name) in self.columns.iter().enumerate() {
            out.push_str(if index == 0 { "" } else { "," });
            out.push_str(cells.iter().find(|(n, _)| n == name).map_or("", |(_, cell)| cell));
        }
        out.push('\n');
        let mut names = cells.iter().map(|(name, _)| name);
        if !self.loss_reported
            && let Some(name) = names.find(|name| self.columns.iter().all(|column| column != name))
        {
            self.loss_reported = true;
            cx.warn(&format!(
                "column `{name}` first appeared after the header and is left out: write .jsonl to keep it"
            ));
        }
        1
    }
}

/// Writes numbers, texts, boxes and tables of each tick.
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
            let message =
                format!("a .json file can hold only detections or instances in COCO's format, not input `{other}`");
            check.error("path", message, "write it to .jsonl or .csv");
        } else if ending == "csv" && ["table", "detections"].iter().all(is_connected) {
            let message = "a CSV file can have only one kind of line, but `table` and `detections` are both connected";
            check.error("path", message, "use a separate `write_table` for each, or write .jsonl");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let path = params.path.clone();
        let ending = check_name(&path, "table.jsonl", ENDINGS)?;
        claim(open, &path)?;
        let file = Growing::new(&path);
        let image_name = if params.image_name.is_empty() { "{seq}.png" } else { &params.image_name };
        let form = match ending.as_str() {
            "csv" => Form::Csv(Csv::new(file)),
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
            Form::Csv(csv) => {
                if input.detections.is_some() && input.table.is_some() {
                    return Err(NodeError::new(
                        "a CSV file can have only one kind of line: use a separate `write_table` for each of `table` and `detections`, or write .jsonl",
                    ));
                }
                let columns_before = csv.columns.len();
                let lines = csv.push_tick(cx, &input, &mut self.line);
                if let Err(error) = csv.file.append(cx, self.line.as_bytes()) {
                    csv.columns.truncate(columns_before);
                    return Err(error);
                }
                self.lines += lines;
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
                        "a .json file can hold only detections or instances in COCO's format: write other inputs to .jsonl or .csv",
                    ));
                }
                if begun.is_none() {
                    let mut file = cx.begin_file(&self.path, true)?;
                    while journal_of(&file).exists() {
                        let next = cx.begin_file(&self.path, true)?;
                        cx.warn(&format!(
                            "{} belongs to a run that was cut off: this run continues in {}",
                            journal_of(&file).display(),
                            next.display()
                        ));
                        file = next;
                    }
                    journal.create(journal_of(&file))?;
                    // That of an earlier run must not pass for this one's, should this run be cut off.
                    let _ = std::fs::remove_file(&file);
                    *begun = Some(file);
                }
                let seq = cx.tick().seq;
                let name = image_name.file(seq, "image", false);
                // Instances repeat the boxes of their detections.
                if let Some(instances) = &input.instances {
                    coco.push_instances(&mut self.line, seq, &name.to_string_lossy(), instances);
                } else if let Some(detections) = &input.detections {
                    coco.push_detections(&mut self.line, seq, &name.to_string_lossy(), detections);
                }
                if let Err(error) = journal.append(cx, self.line.as_bytes()) {
                    if !journal.is_begun() {
                        *begun = None;
                    }
                    return Err(error);
                }
                self.lines = coco.ticks();
            }
        }
        cx.metric("lines", self.lines as f64);
        Ok(())
    }

    fn finish(&mut self, cx: &Finish<'_>) -> Result<()> {
        match &mut self.form {
            Form::Lines(file) | Form::Csv(Csv { file, .. }) => file.finish(cx),
            Form::Coco { begun, .. } => {
                if begun.is_none() {
                    let file = cx.begin_file(&self.path, true)?;
                    *begun = (file == self.path && !journal_of(&file).exists()).then_some(file);
                }
                Ok(self.complete_coco()?)
            }
        }
    }
}

/// Path of the journal of a COCO file.
fn journal_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".journal");
    name.into()
}

impl WriteTable {
    /// Writes the COCO file, if the node writes one, and removes its journal.
    fn complete_coco(&mut self) -> Result<(), SinkError> {
        let Form::Coco { coco, begun, journal, .. } = &mut self.form else { return Ok(()) };
        let Some(path) = begun.take() else { return Ok(()) };
        let lines = journal_of(&path);
        let io = |error| SinkError::io(&path, error);
        write_whole(&path, true, |file| {
            if !journal.is_begun() {
                return coco.write(Cursor::new(""), file).map_err(io);
            }
            let lines = File::open(&lines).map_err(|error| SinkError::io(&lines, error))?;
            coco.write(BufReader::new(lines), file).map_err(io)
        })?;
        let _ = std::fs::remove_file(lines);
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

/// Passes one value per packet type to `take`: its key, and its parts.
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

/// Writes the cells that all lines of a tick begin with.
fn csv_head(head: &mut CsvFields, cx: &Context<'_>, input: &In<'_>) {
    let tick = cx.tick();
    head.clear();
    head.number("seq", tick.seq as f64);
    head.number("source", f64::from(tick.source));
    head.number("capture_ms", tick.capture_ns as f64 / 1e6);
    each_value(input, |name, parts| {
        head.set_prefix(&[name, "."]);
        parts(head);
    });
    head.set_prefix(&[]);
    if let Some(text) = &input.text {
        head.text("text", text);
    }
}
