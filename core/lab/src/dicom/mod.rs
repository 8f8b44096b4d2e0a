//! `panoscope dicom`: stills, clips and measurements into a hospital's archive.

mod clip;
mod pick;

use std::path::PathBuf;

use anyhow::Result;
use panoscope_export::dicom::export::{self, Kind};
use panoscope_export::dicom::net::{self, AeTitle, Peer};
use panoscope_export::dicom::object::Region;
use panoscope_export::dicom::{Entry, Query, outbox};

use panoscope_cli::End;
use panoscope_cli::terminal::{log, out};

/// Commands of `dicom`.
#[derive(clap::Subcommand)]
pub enum Dicom {
    /// Checks that a server answers (C-ECHO).
    Echo(Server),
    /// Lists the entries of a worklist.
    Worklist {
        #[command(flatten)]
        server: Server,
        #[command(flatten)]
        query: QueryArguments,
    },
    /// Makes DICOM objects of stills, clips and measurements, for the patient of one worklist entry, in a folder.
    Wrap(Wrap),
    /// Stores the objects of a folder at a PACS (C-STORE). Confirmed objects are removed from the folder; others stay
    /// for the next call.
    Send(Send),
}

/// Address and titles of a server.
#[derive(clap::Args)]
pub struct Server {
    /// Address of the PACS or worklist server.
    #[arg(long, value_name = "HOST:PORT")]
    pacs: String,
    #[command(flatten)]
    titles: Titles,
}

/// Application entity titles.
#[derive(clap::Args)]
pub struct Titles {
    /// Application entity title of the server.
    #[arg(long, value_name = "AE", default_value = "ANY-SCP")]
    called: AeTitle,
    /// Own application entity title, by which the server knows this machine.
    #[arg(long, value_name = "AE", default_value = "PANOSCOPE")]
    calling: AeTitle,
}

impl Titles {
    fn peer(&self, address: &str) -> Peer {
        Peer { address: address.to_owned(), called: self.called.clone(), calling: self.calling.clone() }
    }
}

impl Server {
    fn peer(&self) -> Peer {
        self.titles.peer(&self.pacs)
    }
}

/// Filter of worklist entries.
#[derive(clap::Args)]
pub struct QueryArguments {
    /// Only steps of this modality, such as ES for endoscopy.
    #[arg(long, value_name = "CODE", default_value = "")]
    modality: String,
    /// Only steps of this day: `today`, `all`, YYYYMMDD or YYYYMMDD-YYYYMMDD.
    #[arg(long, value_name = "DAY", default_value = "today")]
    date: String,
    /// Only steps of the station with this application entity title.
    #[arg(long, value_name = "AE", default_value = "")]
    station: String,
}

/// A malformed option of a query.
#[derive(Debug, thiserror::Error)]
enum QueryError {
    #[error("--date `{days}`: write today, all, YYYYMMDD or YYYYMMDD-YYYYMMDD")]
    Date { days: String },
    #[error("{option} `{text}`: use at most 16 ASCII letters, digits and punctuation marks")]
    Code { option: &'static str, text: String },
}

impl QueryArguments {
    /// The query.
    fn query(&self) -> Result<Query, QueryError> {
        let date = match self.date.as_str() {
            "today" => panoscope_export::dicom::today(),
            "all" => String::new(),
            days => {
                let is_day = |day: &str| day.len() == 8 && day.bytes().all(|b| b.is_ascii_digit());
                if !days.split('-').all(is_day) || days.split('-').count() > 2 {
                    return Err(QueryError::Date { days: days.to_owned() });
                }
                days.to_owned()
            }
        };
        let is_code =
            |text: &str| text.len() <= 16 && text.chars().all(|c| c.is_ascii_graphic() && !"\\*?".contains(c));
        for (option, text) in [("--modality", &self.modality), ("--station", &self.station)] {
            if !is_code(text) {
                return Err(QueryError::Code { option, text: text.clone() });
            }
        }
        Ok(Query { modality: self.modality.clone(), date, station: self.station.clone() })
    }
}

/// Part of the body.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Part {
    Unknown,
    Abdomen,
    Pelvis,
    Chest,
    Joint,
    Head,
    Neck,
}

impl From<Part> for Region {
    fn from(part: Part) -> Self {
        match part {
            Part::Unknown => Self::Unknown,
            Part::Abdomen => Self::Abdomen,
            Part::Pelvis => Self::Pelvis,
            Part::Chest => Self::Chest,
            Part::Joint => Self::Joint,
            Part::Head => Self::Head,
            Part::Neck => Self::Neck,
        }
    }
}

/// Arguments of `dicom wrap`.
#[derive(clap::Args)]
pub struct Wrap {
    /// Stills, clips and tables of `measure`, or folders with them, such as the theatre's.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Folder for the objects; created if missing, accessible only to its owner.
    #[arg(long, short, value_name = "FOLDER")]
    output: PathBuf,
    /// Worklist server.
    #[arg(long, value_name = "HOST:PORT", required_unless_present = "entry_file")]
    pacs: Option<String>,
    #[command(flatten)]
    titles: Titles,
    #[command(flatten)]
    query: QueryArguments,
    /// Accession number, step ID or study instance UID of the entry; default: you are asked.
    #[arg(long, value_name = "KEY", requires = "pacs")]
    entry: Option<String>,
    /// Body region in view of the endoscope.
    #[arg(long, value_name = "PART", default_value = "unknown")]
    region: Part,
    /// The entry as a DICOM file, if there is no worklist server.
    #[arg(long, value_name = "FILE", conflicts_with = "pacs")]
    entry_file: Option<PathBuf>,
}

/// Arguments of `dicom send`.
#[derive(clap::Args)]
pub struct Send {
    /// Folder with objects, as `wrap` makes it.
    folder: PathBuf,
    #[command(flatten)]
    server: Server,
    /// Leaves stored objects in the folder.
    #[arg(long)]
    keep: bool,
}

/// Runs a command of `dicom`.
pub fn run(command: &Dicom) -> Result<End> {
    match command {
        Dicom::Echo(server) => {
            net::echo(&server.peer())?;
            out!("{} answers as {}", server.pacs, server.titles.called);
            Ok(End::Done)
        }
        Dicom::Worklist { server, query } => match query.query() {
            Ok(query) => {
                let entries = entries(&server.peer(), &query)?;
                out!("{}", pick::table(&entries));
                Ok(End::Done)
            }
            Err(problem) => wrong(&problem.to_string()),
        },
        Dicom::Wrap(arguments) => wrap(arguments),
        Dicom::Send(arguments) => send(arguments),
    }
}

fn wrong(problem: &str) -> Result<End> {
    log!("error: {problem}");
    Ok(End::Wrong)
}

/// The entries of a worklist; those that cannot be used are reported.
fn entries(peer: &Peer, query: &Query) -> Result<Vec<Entry>> {
    let (entries, problems) = net::worklist(peer, query)?;
    for problem in problems {
        log!("warning: {problem}; it is left out");
    }
    Ok(entries)
}

fn wrap(arguments: &Wrap) -> Result<End> {
    let inputs = match export::inputs(&arguments.files) {
        Ok(inputs) => inputs,
        Err(error) => return wrong(&error.to_string()),
    };
    let entry = match (&arguments.entry_file, &arguments.pacs) {
        (Some(file), _) => Entry::open(file)?,
        (None, Some(address)) => {
            let query = match arguments.query.query() {
                Ok(query) => query,
                Err(problem) => return wrong(&problem.to_string()),
            };
            let entries = entries(&arguments.titles.peer(address), &query)?;
            match &arguments.entry {
                Some(key) => Entry::choose(&entries, key)?.clone(),
                None => match pick::ask(&entries)? {
                    Some(entry) => entry.clone(),
                    None => return wrong("no entry was chosen; nothing was exported"),
                },
            }
        }
        (None, None) => return wrong("name a worklist server with --pacs, or an entry with --entry-file"),
    };
    outbox::create(&arguments.output)?;
    let count = |kind| inputs.iter().filter(|input| input.kind == kind).count();
    let mut clips = clip::Clips::new(&arguments.output);
    let made = export::wrap(&entry, arguments.region.into(), &inputs, &arguments.output, |file| clips.mp4_of(file))?;
    out!(
        "{} objects in {}: {} stills, {} clips, measurements of {} tables",
        made.len(),
        arguments.output.display(),
        count(Kind::Still),
        count(Kind::Clip),
        count(Kind::Lengths)
    );
    Ok(End::Done)
}

fn send(arguments: &Send) -> Result<End> {
    let sent = outbox::send(&arguments.folder, &arguments.server.peer(), arguments.keep)?;
    for (file, error) in &sent.kept {
        log!("error: {}: {error}", file.display());
    }
    out!("{} objects stored at {}", sent.stored, arguments.server.pacs);
    if sent.kept.is_empty() {
        return Ok(End::Done);
    }
    log!("{} objects stay in {}; call `panoscope dicom send` again", sent.kept.len(), arguments.folder.display());
    Ok(End::Failed)
}
