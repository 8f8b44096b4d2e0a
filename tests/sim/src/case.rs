//! A case: everything that is derived from a seed.

use std::time::Duration;

use crate::engine::fault::Cause;
use crate::world::disk::Habits;
use crate::world::{Dice, Settings};

use crate::graphs::{Kind, Maker, Model, Node, Trouble};
use crate::harm::Harm;

/// A kind of misbehaviour, the nodes that can show it, and the causes under which it may be reported; no cause if it need not be reported.
pub struct HarmRule {
    /// The misbehaviour.
    pub harm: Harm,
    /// Types of nodes that can show it.
    pub kinds: &'static [Kind],
    /// One of these causes must be reported.
    pub causes: &'static [Cause],
    /// Minimum and maximum number of consecutive ticks.
    pub ticks: (u64, u64),
    /// Number of bad calls after which it is reported.
    pub calls: usize,
    /// Whether its consequences in batch mode depend on the ticks alone.
    pub in_batch: bool,
}

const MAKERS: &[Kind] = &[Kind::Mark, Kind::MarkBlocking, Kind::MarkDevice, Kind::Pair];
const FILTERS: &[Kind] =
    &[Kind::Mark, Kind::MarkBlocking, Kind::MarkDevice, Kind::Pair, Kind::Pass, Kind::Keep, Kind::Draw];
const ALL: &[Kind] = &[
    Kind::Mark,
    Kind::MarkBlocking,
    Kind::MarkDevice,
    Kind::Pair,
    Kind::Pass,
    Kind::Keep,
    Kind::Draw,
    Kind::Write,
    Kind::Camera,
];
const HANDLERS: &[Kind] = &[Kind::Mark, Kind::MarkBlocking, Kind::MarkDevice, Kind::Pair, Kind::Pass, Kind::Keep];
const CAMERA: &[Kind] = &[Kind::Camera];

const fn rule(
    harm: Harm,
    kinds: &'static [Kind],
    causes: &'static [Cause],
    ticks: (u64, u64),
    in_batch: bool,
) -> HarmRule {
    let calls = match harm {
        Harm::Nothing => 30,
        Harm::Leak => 129,
        _ => 1,
    };
    HarmRule { harm, kinds, causes, ticks, calls, in_batch }
}

/// All kinds of misbehaviour.
pub static HARMS: &[HarmRule] = &[
    rule(Harm::Error, ALL, &[Cause::Error], (1, 3), true),
    rule(Harm::Panic, ALL, &[Cause::Panic], (1, 3), true),
    rule(Harm::Hang, ALL, &[Cause::Hang], (1, 1), false),
    rule(Harm::HangInLoop, FILTERS, &[Cause::Hang], (1, 1), false),
    rule(Harm::HangInNestedLoop, FILTERS, &[Cause::Hang], (1, 1), false),
    rule(Harm::Nan, FILTERS, &[Cause::NotANumber], (1, 15), true),
    rule(Harm::WrongSize, MAKERS, &[], (1, 3), false),
    rule(Harm::WrongFormat, FILTERS, &[Cause::Format], (1, 3), true),
    rule(Harm::WrongLength, &[Kind::MarkLying], &[Cause::BadOutput], (1, 15), true),
    rule(Harm::Nothing, FILTERS, &[Cause::Silent], (40, 60), true),
    rule(Harm::TooMuch, FILTERS, &[Cause::TooMuch], (1, 15), true),
    rule(Harm::Slow, FILTERS, &[Cause::Slow, Cause::Hang], (1, 3), false),
    rule(Harm::Leak, HANDLERS, &[Cause::Leak], (150, 170), true),
    rule(Harm::ReleaseTwice, HANDLERS, &[Cause::Release], (1, 3), true),
    rule(Harm::Repeat, CAMERA, &[Cause::CaptureTime], (1, 3), true),
    rule(Harm::Reorder, CAMERA, &[Cause::CaptureTime], (1, 3), true),
    rule(Harm::Extreme, CAMERA, &[Cause::CaptureTime], (1, 3), true),
    rule(Harm::Rewind, CAMERA, &[], (1, 1), true),
    rule(Harm::RefuseOpen, ALL, &[Cause::Open], (1, 1), false),
    rule(Harm::HangInOpen, ALL, &[Cause::Hang], (1, 1), false),
    rule(Harm::HangInClose, ALL, &[Cause::Hang], (1, 1), false),
    rule(Harm::HangInSave, MAKERS, &[], (0, 0), false),
    rule(Harm::HangInLoad, MAKERS, &[], (0, 0), false),
];

/// The rule for a kind of misbehaviour.
pub fn rule_of(harm: Harm) -> Option<&'static HarmRule> {
    HARMS.iter().find(|rule| rule.harm == harm)
}

/// Everything that is derived from one seed.
#[derive(Clone, Debug)]
pub struct Case {
    /// The seed.
    pub seed: u64,
    /// Settings of the simulated world.
    pub world: Settings,
    /// The initial graph.
    pub model: Model,
    /// Number of threads of the pool.
    pub threads: usize,
    /// The engine's option of this name.
    pub ticks_at_once: Option<u32>,
    /// Number of ticks of each source in batch mode.
    pub frames: u64,
    /// Number of changes while it runs.
    pub edits: usize,
    /// Whether an observer is connected.
    pub observed: bool,
    /// Behaviour of the disk.
    pub disk: Habits,
    /// If set, frames may for a time take only this much more memory than at its start.
    pub pinch_bytes: Option<i64>,
    /// Whether a node of the initial graph fails to open.
    pub start_fails: bool,
    /// Seed of the decisions while it runs.
    pub driver_seed: u64,
}

impl Case {
    /// Derives the case from a seed.
    pub fn new(seed: u64) -> Self {
        let mut dice = Dice::new(panoscope_base::random::mix(seed));
        let (mut world_dice, mut graph_dice) = (dice.split(), dice.split());
        let mut world = Settings { seed: world_dice.bits(), ..Settings::default() };
        world.switch_every = *world_dice.pick(&[2, 6, 15, 40, 150]);
        world.priorities = world_dice.one_in(3);
        world.stall_one_in = *world_dice.pick(&[0, 0, 2_000, 400, 50]);
        world.longest_stall_ns = *world_dice.pick(&[200_000, 5_000_000, 25_000_000]);
        if world.stall_one_in == 50 {
            // So many long ones would make calls look hung.
            world.longest_stall_ns = 3_000_000;
        }
        world.stall_first_one_in = *world_dice.pick(&[0, 0, 4]);
        world.longest_delay_ns = *world_dice.pick(&[0, 60_000, 2_000_000]);
        let batch = graph_dice.one_in(4);
        let mut maker = Maker::new(graph_dice.split());
        maker.costs = !graph_dice.one_in(4);
        let mut model = maker.graph(batch);
        if !graph_dice.one_in(4) {
            add_trouble(&mut model, &mut graph_dice, seed);
        }
        let healthy = model.nodes.iter().all(|node| node.trouble.is_none());
        if world_dice.one_in(10) {
            world.most_threads = Some(world_dice.within(6, 26) as usize);
        }
        let start_fails = dice.one_in(16);
        if start_fails {
            let able: Vec<usize> = (0..model.nodes.len()).filter(|&at| model.nodes[at].kind != Kind::Look).collect();
            let node = &mut model.nodes[*dice.pick(&able)];
            if dice.one_in(2) {
                node.refuses = true;
            } else {
                node.open_ms = 60_000.0;
            }
        }
        let mut disk = Habits::default();
        if dice.one_in(6) {
            disk.operation = Duration::from_micros(dice.within(100, 30_000));
        }
        if healthy && dice.one_in(4) {
            disk.capacity_bytes = Some(dice.within(80, 1_500) as usize);
        } else if healthy && dice.one_in(8) {
            disk.fails_from = Some(dice.within(3, 200));
        }
        Self {
            seed,
            world,
            threads: dice.within(1, 4) as usize,
            ticks_at_once: if dice.one_in(4) { Some(dice.within(1, 4) as u32) } else { None },
            frames: dice.within(60, 220),
            edits: if dice.one_in(3) { 0 } else { dice.within(1, 6) as usize },
            observed: dice.one_in(2),
            disk,
            pinch_bytes: (!batch && healthy && dice.one_in(8)).then(|| dice.within(0, 20_000) as i64),
            driver_seed: dice.bits(),
            start_fails,
            model,
        }
    }

    /// The node that misbehaves.
    pub fn culprit(&self) -> Option<&Node> {
        self.model.nodes.iter().find(|node| node.trouble.is_some())
    }

    /// Whether the fault of that node stops the run.
    pub fn stops(&self) -> bool {
        self.culprit().and_then(|node| node.trouble.as_ref()).is_some_and(|trouble| trouble.on_fault == "stop")
    }

    /// Whether starting a thread may fail.
    pub fn is_short_of_threads(&self) -> bool {
        self.world.most_threads.is_some()
    }

    /// Whether writing may fail.
    pub fn disk_fails(&self) -> bool {
        self.disk.capacity_bytes.is_some() || self.disk.fails_from.is_some()
    }

    /// The case as text.
    pub fn describe(&self) -> String {
        let Self { seed, world, threads, ticks_at_once, frames, edits, observed, disk, pinch_bytes, .. } = self;
        format!(
            "seed {seed}: {threads} threads, ticks_at_once {ticks_at_once:?}, {frames} frames in batch, {edits} edits, observed {observed}, \
             pinch {pinch_bytes:?}\n{disk:?}\n{world:?}\n{}",
            self.model.text()
        )
    }
}

/// Makes one node misbehave. The seed selects the kind, so that all occur.
fn add_trouble(model: &mut Model, dice: &mut Dice, seed: u64) {
    let rule = &HARMS[seed as usize % HARMS.len()];
    if model.batch && !rule.in_batch {
        return;
    }
    if rule.harm == Harm::WrongLength {
        let honest = |node: &&mut Node| matches!(node.kind, Kind::Mark | Kind::MarkBlocking | Kind::Draw | Kind::Pass);
        if let Some(node) = model.nodes.iter_mut().find(honest) {
            node.kind = Kind::MarkLying;
        }
    }
    if rule.harm == Harm::ReleaseTwice {
        // A node may release what another instance of its plugin retains.
        model.nodes.iter_mut().filter(|node| node.kind == Kind::Keep).for_each(|node| node.kind = Kind::Pass);
    }
    let able: Vec<usize> = (0..model.nodes.len()).filter(|&at| rule.kinds.contains(&model.nodes[at].kind)).collect();
    if able.is_empty() {
        return;
    }
    let node = &mut model.nodes[*dice.pick(&able)];
    let hangs = matches!(rule.harm, Harm::Hang | Harm::HangInLoop | Harm::HangInNestedLoop | Harm::Slow);
    let ends = matches!(rule.harm, Harm::Error | Harm::Panic | Harm::Hang);
    let on_fault = match dice.below(8) {
        0 if ends => "stop",
        1 | 2 if !matches!(rule.harm, Harm::RefuseOpen | Harm::HangInOpen) => "bypass",
        _ => "restart",
    };
    let hang_ms = match rule.harm {
        Harm::Slow => 14.0,
        // A loop that hangs is waited for in short steps.
        Harm::HangInLoop | Harm::HangInNestedLoop => *dice.pick(&[4_000.0, 8_000.0]),
        _ => *dice.pick(&[7_000.0, 60_000.0, 3_000_000.0]),
    };
    let budget_ms = (rule.harm == Harm::Slow || (hangs && dice.one_in(2))).then_some(8.0);
    if budget_ms.is_some() {
        node.cost_ms = 0.0;
    }
    let (first, ticks) = (dice.within(3, 25), dice.within(rule.ticks.0, rule.ticks.1));
    node.trouble = Some(Trouble { harm: rule.harm, first, ticks, hang_ms, on_fault, budget_ms });
}
