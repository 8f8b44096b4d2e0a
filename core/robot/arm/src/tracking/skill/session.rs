//! All tools and phases of an operation.

use std::collections::VecDeque;

use super::measures::Measures;
use super::movement::{Meter, Movement};
pub use super::tool::Cell;
use super::tool::{Sink, Tool};
use super::{Sample, Settings, Together};

/// Largest number of tools.
pub const MAX_TOOLS: usize = 16;
/// Largest number of phases; later ones count as the last.
pub const MAX_PHASES: usize = 64;
/// Movements that are kept for [`Session::take_movements`].
const MAX_MOVEMENTS: usize = 256;

/// Results for one tool.
#[derive(Clone, Copy)]
pub struct ToolReport<'a> {
    /// Key given to [`Session::tool`].
    pub key: u64,
    /// Name given to [`Session::tool`].
    pub name: &'a str,
    /// Measures over all phases.
    pub total: &'a Measures,
    /// Measures per phase, in the order of [`Session::phases`]; those in which it was never seen are empty.
    pub phases: &'a [Measures],
}

#[derive(Default)]
struct Pair {
    total: Together,
    phases: Vec<Together>,
}

/// Measures an operation while it runs. Memory is bounded: about a megabyte per tool, however long it lasts.
#[derive(Default)]
pub struct Session {
    settings: Settings,
    tools: Vec<Tool>,
    /// Pairs of tools: 0 and 1, 0 and 2, 1 and 2, 0 and 3 and so on.
    pairs: Vec<Pair>,
    phases: Vec<String>,
    phase: usize,
    next_phase: usize,
    meter: Meter,
    movements: Vec<VecDeque<Movement>>,
    cells: Option<Vec<Vec<Cell>>>,
    now_s: f64,
}

impl Session {
    /// A session without tools or phases.
    pub fn new(settings: Settings) -> Self {
        Self { settings, now_s: f64::NEG_INFINITY, ..Self::default() }
    }

    /// Keeps decided cells until they are taken by [`Session::take_cells`].
    pub fn keep_cells(mut self) -> Self {
        self.cells = Some(Vec::new());
        self
    }

    /// Names of the phases so far; without any [`Session::set_phase`] there is one without name.
    pub fn phases(&self) -> &[String] {
        &self.phases
    }

    /// The current phase.
    pub fn phase(&self) -> usize {
        self.phase
    }

    /// Starts a phase with the next [`Session::advance`]. A name that was used before continues that phase.
    pub fn set_phase(&mut self, name: &str) {
        if let [only] = &mut self.phases[..]
            && only.is_empty()
            && self.tools.iter().all(|tool| tool.total.is_empty())
        {
            // Nothing happened before the first name.
            name.clone_into(only);
        }
        self.next_phase = match self.phases.iter().position(|known| known == name) {
            Some(known) => known,
            None if self.phases.len() < MAX_PHASES => {
                self.phases.push(name.to_owned());
                self.phases.len() - 1
            }
            None => MAX_PHASES - 1,
        };
        let count = self.phases.len();
        self.tools.iter_mut().for_each(|tool| tool.phases.resize(count, Measures::default()));
        self.pairs.iter_mut().for_each(|pair| pair.phases.resize(count, Together::default()));
    }

    /// Assigns undecided data to the phase that ends.
    fn change_phase(&mut self) {
        for index in 0..self.tools.len() {
            let (tool, mut sink) = self.part(index);
            tool.cut(&mut sink);
        }
        self.look_at_pairs();
        self.phase = self.next_phase;
    }

    /// Number of the tool with a key, created with a name if it is new; `None` if there are [`MAX_TOOLS`] others.
    pub fn tool(&mut self, key: u64, name: impl FnOnce() -> String) -> Option<usize> {
        if let Some(known) = self.tools.iter().position(|tool| tool.key == key) {
            return Some(known);
        }
        if self.tools.len() == MAX_TOOLS {
            return None;
        }
        if self.phases.is_empty() {
            self.phases.push(String::new());
        }
        let mut tool = Tool::new(key, name(), self.phases.len());
        // Pairs need nothing of it before now.
        tool.decided = self.tools.iter().map(|t| t.decided).min().unwrap_or(0);
        self.tools.push(tool);
        self.movements.push(VecDeque::with_capacity(MAX_MOVEMENTS));
        if let Some(cells) = &mut self.cells {
            cells.push(Vec::new());
        }
        let phases = vec![Together::default(); self.phases.len()];
        self.pairs.extend((1..self.tools.len()).map(|_| Pair { total: Together::default(), phases: phases.clone() }));
        Some(self.tools.len() - 1)
    }

    fn part(&mut self, index: usize) -> (&mut Tool, Sink<'_>) {
        let sink = Sink {
            settings: &self.settings,
            meter: &mut self.meter,
            phase: self.phase,
            cells: self.cells.as_mut().map(|cells| &mut cells[index]),
            movements: &mut self.movements[index],
        };
        (&mut self.tools[index], sink)
    }

    /// Adds a sample of a tool. Samples of one tool must be in the order of time; others, and unknown tool numbers, are
    /// ignored.
    pub fn observe(&mut self, tool: usize, sample: Sample) {
        if tool < self.tools.len() {
            let (tool, mut sink) = self.part(tool);
            tool.observe(sample, &mut sink);
        }
    }

    /// Advances the time to `now_s`; tools that were not seen for too long go out of view. Call it once per image,
    /// after its samples.
    pub fn advance(&mut self, now_s: f64) {
        if now_s.is_nan() || now_s < self.now_s {
            return;
        }
        self.now_s = now_s;
        for index in 0..self.tools.len() {
            let (tool, mut sink) = self.part(index);
            tool.advance(now_s, &mut sink);
        }
        if self.next_phase != self.phase {
            self.change_phase();
        }
        self.look_at_pairs();
    }

    /// Decides all remaining data: the operation has ended at the last time of [`Session::advance`].
    pub fn finish(&mut self) {
        for index in 0..self.tools.len() {
            let (tool, mut sink) = self.part(index);
            tool.cut(&mut sink);
        }
        self.look_at_pairs();
    }

    /// Compares cells that are decided for all tools.
    fn look_at_pairs(&mut self) {
        let Some(frontier) = self.tools.iter().map(|tool| tool.decided).min() else { return };
        let mut number = 0;
        for b in 1..self.tools.len() {
            for a in 0..b {
                let pair = &mut self.pairs[number];
                number += 1;
                let (mut left, mut right) = (self.tools[a].waiting.iter(), self.tools[b].waiting.iter());
                let (mut x, mut y) = (left.next(), right.next());
                while let (Some(p), Some(q)) = (x, y) {
                    if p.0.max(q.0) >= frontier {
                        break;
                    }
                    match p.0.cmp(&q.0) {
                        std::cmp::Ordering::Less => x = left.next(),
                        std::cmp::Ordering::Greater => y = right.next(),
                        std::cmp::Ordering::Equal => {
                            let (moving, speed) = ([p.1, q.1], [f64::from(p.2), f64::from(q.2)]);
                            pair.total.add(moving, speed);
                            if let Some(phase) = pair.phases.get_mut(self.phase) {
                                phase.add(moving, speed);
                            }
                            (x, y) = (left.next(), right.next());
                        }
                    }
                }
            }
        }
        for tool in &mut self.tools {
            while tool.waiting.front().is_some_and(|cell| cell.0 < frontier) {
                tool.waiting.pop_front();
            }
        }
    }

    /// All tools so far.
    pub fn tools(&self) -> impl Iterator<Item = ToolReport<'_>> {
        self.tools.iter().map(|tool| ToolReport {
            key: tool.key,
            name: &tool.name,
            total: &tool.total,
            phases: &tool.phases,
        })
    }

    /// All pairs of tools: their numbers, and their measures in total and per phase.
    pub fn pairs(&self) -> impl Iterator<Item = (usize, usize, &Together, &[Together])> {
        let numbers = (1..self.tools.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
        numbers.zip(&self.pairs).map(|((a, b), pair)| (a, b, &pair.total, pair.phases.as_slice()))
    }

    /// Takes the movements of a tool that ended since the last call; only the newest 256 are kept.
    pub fn take_movements(&mut self, tool: usize) -> impl Iterator<Item = Movement> + '_ {
        self.movements.get_mut(tool).into_iter().flat_map(|kept| kept.drain(..))
    }

    /// Takes the cells of a tool that were decided since the last call, if [`Session::keep_cells`] was called.
    pub fn take_cells(&mut self, tool: usize) -> impl Iterator<Item = Cell> + '_ {
        self.cells.as_mut().and_then(|cells| cells.get_mut(tool)).into_iter().flat_map(|kept| kept.drain(..))
    }
}
