//! The nodes of simulated graphs. Each checks every byte of its inputs.

use crate::world::{disk, point};
use panoscope_node::export::NodeTypeOf;
use panoscope_node::{
    AnyFormat, Context, Finish, Gray8, Image, NoPorts, Node, NodeInfo, Open, Parallel, Params, Ports, Result, Retained,
    Slot, abi, error,
};

use crate::content::{Content, name_hash};
use crate::harm::Harm;
use crate::observe::{Seen, disk, next_instance, observe};
use crate::plan::{Begin, Plan, wait_ms};

/// One frame of the call's tick.
#[derive(Ports)]
pub struct In<'f> {
    /// The frame to process.
    image: Image<'f, Gray8>,
}

/// Two frames of the call's tick.
#[derive(Ports)]
pub struct TwoIn<'f> {
    /// The frame to forward.
    left: Image<'f, Gray8>,
    /// The second frame.
    right: Image<'f, Gray8>,
}

/// One frame.
#[derive(Ports)]
pub struct Out<'f> {
    /// The frame.
    image: Slot<'f, AnyFormat>,
}

/// State that all simulated nodes have.
struct Base {
    id: String,
    hash: u32,
    instance: u64,
    count: u64,
    close_ms: f64,
    save_ms: f64,
    load_ms: f64,
}

impl Base {
    fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
        let id = open.node_id().to_owned();
        if plan.open_ms > 0.0 {
            wait_ms(plan.open_ms);
        }
        if plan.refuses {
            return Err(error!("told not to open"));
        }
        let ms = |harm: Harm| if plan.harm == harm { plan.hang_ms } else { 0.0 };
        let base = Self {
            hash: name_hash(&id),
            instance: next_instance(),
            count: 0,
            close_ms: ms(Harm::HangInClose),
            save_ms: ms(Harm::HangInSave),
            load_ms: ms(Harm::HangInLoad),
            id,
        };
        let after_fault =
            crate::observe::count(|seen| matches!(seen, Seen::Harmed { node, seq: Some(_), .. } if *node == base.id))
                > 0;
        let tries =
            crate::observe::count(|seen| matches!(seen, Seen::Harmed { node, seq: None, .. } if *node == base.id));
        if after_fault && tries < 2 && matches!(plan.harm, Harm::HangInOpen | Harm::RefuseOpen) {
            observe(Seen::Harmed { node: base.id.clone(), seq: None, harm: plan.harm });
            match plan.harm {
                Harm::HangInOpen => wait_ms(plan.hang_ms),
                _ => return Err(error!("told not to open again")),
            }
        }
        Ok(base)
    }

    fn wrong(&self, words: String) {
        observe(Seen::Wrong { node: self.id.clone(), words });
    }

    /// Checks an input. `exact`: it must belong to the call's tick.
    fn look(&self, cx: &Context<'_>, image: &Image<'_, Gray8>, exact: bool) -> Option<Content> {
        let frame = image.frame();
        // SAFETY: the host lends `len` bytes for the call.
        let bytes = unsafe { std::slice::from_raw_parts(frame.data, frame.len) };
        let content = match Content::read(bytes) {
            Ok(content) => content,
            Err(words) => {
                self.wrong(format!("tick {}: {words}", cx.tick().seq));
                return None;
            }
        };
        let (tick, call) = (frame.tick, cx.tick());
        if content.seq != tick.seq {
            self.wrong(format!("a picture of tick {} came as tick {}", content.seq, tick.seq));
        }
        if exact && (tick.seq, tick.source, tick.capture_ns) != (call.seq, call.source, call.capture_ns) {
            self.wrong(format!("an input of tick {} in a call for tick {}", tick.seq, call.seq));
        }
        if (frame.width as usize) * (frame.height as usize) != frame.len {
            self.wrong(format!("{}x{} pixels in {} bytes", frame.width, frame.height, frame.len));
        }
        Some(content)
    }

    fn called(&mut self, seq: u64, inputs: Vec<Content>) {
        self.count += 1;
        let (node, instance, count) = (self.id.clone(), self.instance, self.count);
        observe(Seen::Called { node, instance, seq, inputs, count });
    }

    /// Checks the only input.
    fn begin(&mut self, cx: &Context<'_>, image: &Image<'_, Gray8>) -> Option<Content> {
        let content = self.look(cx, image, true)?;
        self.called(cx.tick().seq, vec![content.clone()]);
        Some(content)
    }

    fn save(&self) -> Option<Vec<u8>> {
        if self.save_ms > 0.0 {
            observe(Seen::Harmed { node: self.id.clone(), seq: None, harm: Harm::HangInSave });
            wait_ms(self.save_ms);
        }
        Some(self.count.to_le_bytes().to_vec())
    }

    fn load(&mut self, state: &[u8]) -> Result<()> {
        if self.load_ms > 0.0 {
            observe(Seen::Harmed { node: self.id.clone(), seq: None, harm: Harm::HangInLoad });
            wait_ms(self.load_ms);
        }
        self.count = u64::from_le_bytes(state.try_into().map_err(|_| error!("a state of {} bytes", state.len()))?);
        Ok(())
    }
}

impl Drop for Base {
    fn drop(&mut self) {
        if self.close_ms > 0.0 {
            observe(Seen::Harmed { node: self.id.clone(), seq: None, harm: Harm::HangInClose });
            wait_ms(self.close_ms);
        }
    }
}

/// Writes a frame, on several threads if the plan says so.
fn paint(cx: &Context<'_>, plan: &Plan, content: &Content, out: &mut [u8]) {
    let len = out.len();
    if plan.loops == 0 {
        return content.write(out);
    }
    let parts: Vec<std::sync::Mutex<&mut [u8]>> = out.chunks_mut(64).map(std::sync::Mutex::new).collect();
    let pool = cx.pool();
    let part = |n: usize| {
        let bytes = content.part(len, n * 64, (n * 64 + 64).min(len));
        point();
        if let Ok(mut part) = parts[n].try_lock() {
            part.copy_from_slice(&bytes);
        } else {
            observe(Seen::Wrong { node: "pool".to_owned(), words: format!("chunk {n} ran twice at once") });
        }
        point();
    };
    if plan.loops == 1 {
        pool.run(parts.len(), &part);
    } else {
        pool.run(parts.len().div_ceil(4), &|outer| {
            pool.run(4, &|inner| {
                if outer * 4 + inner < parts.len() {
                    part(outer * 4 + inner);
                }
            });
        });
    }
}

/// Forwards the same buffer.
pub struct Pass(Base);
/// Makes a new frame.
pub struct Mark(Base);
/// As [`Mark`], on a separate thread.
pub struct MarkBlocking(Base);
/// As [`Mark`], with an exclusive device.
pub struct MarkDevice(Base);
/// Changes the frame in place, or a copy if others read it.
pub struct Draw(Base);
/// Forwards the frame and retains the last three, which must not change.
pub struct Keep(Base, Vec<(Retained<Gray8>, Content)>);
/// Joins two frames of a tick.
pub struct Pair(Base);

/// Processes a tick of [`Mark`] and its variants.
fn mark<'f>(base: &mut Base, cx: &Context<'f>, input: &In<'f>, out: &mut Out<'f>, plan: &Plan) -> Result<()> {
    let Some(content) = base.begin(cx, &input.image) else { return Ok(()) };
    make(base, cx, &content, &input.image, out, plan)
}

fn make<'f>(
    base: &Base,
    cx: &Context<'f>,
    content: &Content,
    image: &Image<'f, Gray8>,
    out: &mut Out<'f>,
    plan: &Plan,
) -> Result<()> {
    let harm = plan.begin_harm(&base.id, cx.tick().seq);
    plan.suffer(cx, harm)?;
    if plan.cost_ms > 0.0 {
        wait_ms(plan.cost_ms);
    }
    plan.mishandle(harm, image);
    let (width, height) = (image.width(), image.height());
    if plan.spoil(harm, &mut out.image, width, height)? {
        return Ok(());
    }
    let content = content.then(base.hash, plan.values());
    let more = if harm == Harm::WrongSize { (1, 3) } else { (0, 0) };
    let plane = out.image.alloc_as::<Gray8>(width + more.0, height + more.1)?;
    let pixels = &mut *plane.data;
    if pixels.iter().take(256).any(|byte| *byte != crate::engine::POISON) {
        base.wrong("a new buffer is in use".to_owned());
    }
    paint(cx, plan, &content, pixels);
    Ok(())
}

macro_rules! node {
    ($node:ident, $info:expr, $in:ident, $process:expr) => {
        impl Node for $node {
            const INFO: NodeInfo = $info;
            type In<'f> = $in<'f>;
            type Out<'f> = Out<'f>;
            type Params = Plan;

            fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
                Ok(Self(Base::open(open, plan)?))
            }

            fn process<'f>(&mut self, cx: &Context<'f>, input: $in<'f>, mut out: Out<'f>, plan: &Plan) -> Result<()> {
                let process: fn(&mut Base, &Context<'f>, &$in<'f>, &mut Out<'f>, &Plan) -> Result<()> = $process;
                process(&mut self.0, cx, &input, &mut out, plan)
            }

            fn save_state(&self) -> Option<Vec<u8>> {
                self.0.save()
            }

            fn load_state(&mut self, state: &[u8]) -> Result<()> {
                self.0.load(state)
            }
        }
    };
}

node!(Mark, NodeInfo::compute("mark", "flow", "Makes a new picture."), In, mark);
node!(MarkBlocking, NodeInfo::blocking("mark_blocking", "flow", "Makes a new picture on its own thread."), In, mark);
node!(
    MarkDevice,
    NodeInfo::compute("mark_device", "flow", "Makes a new picture with a device that only one can open.").exclusive(),
    In,
    mark
);
node!(Pass, NodeInfo::compute("pass", "flow", "Hands the same buffer on."), In, |base, cx, input, out, plan| {
    if base.begin(cx, &input.image).is_none() {
        return Ok(());
    }
    let harm = plan.begin_harm(&base.id, cx.tick().seq);
    plan.suffer(cx, harm)?;
    plan.mishandle(harm, &input.image);
    if plan.spoil(harm, &mut out.image, input.image.width(), input.image.height())? {
        return Ok(());
    }
    out.image.forward(input.image.frame())
});
node!(Draw, NodeInfo::compute("draw", "flow", "Changes the picture in place."), In, |base, cx, input, out, plan| {
    let Some(content) = base.begin(cx, &input.image) else { return Ok(()) };
    let harm = plan.begin_harm(&base.id, cx.tick().seq);
    plan.suffer(cx, harm)?;
    if plan.spoil(harm, &mut out.image, input.image.width(), input.image.height())? {
        return Ok(());
    }
    let plane = out.image.alloc_copy_as::<Gray8>(&input.image)?;
    let pixels = &mut *plane.data;
    if Content::read(pixels).as_ref() != Ok(&content) {
        base.wrong("the copy of a picture differs from it".to_owned());
    }
    content.then(base.hash, plan.values()).write(pixels);
    Ok(())
});
node!(Pair, NodeInfo::compute("pair", "flow", "Joins two pictures of a tick."), TwoIn, |base, cx, input, out, plan| {
    let left = base.look(cx, &input.left, true);
    let right = base.look(cx, &input.right, true);
    let (Some(left), Some(right)) = (left, right) else { return Ok(()) };
    base.called(cx.tick().seq, vec![left.clone(), right]);
    if (input.left.width(), input.left.height()) != (input.right.width(), input.right.height()) {
        return Err(error!("two sizes"));
    }
    make(base, cx, &left, &input.left, out, plan)
});

impl Node for Keep {
    const INFO: NodeInfo = NodeInfo::compute("keep", "flow", "Hands the picture on and retains the last three.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Plan;

    fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
        Ok(Self(Base::open(open, plan)?, Vec::new()))
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, plan: &Plan) -> Result<()> {
        let Some(content) = self.0.begin(cx, &input.image) else { return Ok(()) };
        let harm = plan.begin_harm(&self.0.id, cx.tick().seq);
        plan.suffer(cx, harm)?;
        plan.mishandle(harm, &input.image);
        if plan.spoil(harm, &mut out.image, input.image.width(), input.image.height())? {
            return Ok(());
        }
        for (kept, then) in &self.1 {
            let view = kept.view();
            let bytes: Vec<u8> = (0..view.height).flat_map(|y| view.row(y).iter().copied()).collect();
            if Content::read(&bytes).as_ref() != Ok(then) {
                self.0.wrong(format!("a retained picture of tick {} changed", then.seq));
            }
        }
        self.1.push((input.image.retain(), content));
        if self.1.len() > 3 {
            self.1.remove(0);
        }
        out.image.forward(input.image.frame())
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        self.0.save()
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        self.0.load(state)
    }
}

/// A source.
pub struct Camera {
    base: Base,
    back_ns: i64,
}

/// Maximum accepted capture time, ns.
const END_NS: i64 = 1 << 62;

impl Node for Camera {
    const INFO: NodeInfo = NodeInfo::compute("camera", "source", "Makes pictures.").source();
    type In<'f> = NoPorts;
    type Out<'f> = Out<'f>;
    type Params = Plan;

    fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
        Ok(Self { base: Base::open(open, plan)?, back_ns: 0 })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, plan: &Plan) -> Result<()> {
        let (base, seq) = (&mut self.base, cx.tick().seq);
        let harm = plan.begin_harm(&base.id, seq);
        plan.suffer(cx, harm)?;
        let period_ns = (plan.period_ms * 1e6) as i64;
        if harm == Harm::Rewind && seq == plan.first {
            self.back_ns += 10_000_000_000;
        }
        let begin_ns = match plan.begin {
            Begin::Zero => 0,
            Begin::Lowest => -END_NS,
            Begin::Highest => END_NS - 1_000_000_000_000,
        };
        let late_ns = match harm {
            Harm::Repeat => period_ns,
            Harm::Reorder => 2 * period_ns + period_ns / 2,
            _ => 0,
        };
        cx.set_capture_ns(match harm {
            Harm::Extreme if seq.is_multiple_of(2) => i64::MIN,
            Harm::Extreme => i64::MAX,
            _ => begin_ns + seq as i64 * period_ns - late_ns - self.back_ns,
        });
        let (width, height) = (plan.width_px as usize, plan.height_px as usize);
        if plan.spoil(harm, &mut out.image, width, height)? {
            return Ok(());
        }
        let content = Content { seq, steps: Vec::new() }.then(base.hash, plan.values());
        let plane = out.image.alloc_as::<Gray8>(width, height)?;
        paint(cx, plan, &content, plane.data);
        base.count += 1;
        observe(Seen::Made { node: base.id.clone(), seq });
        Ok(())
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        self.base.save()
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        self.base.load(state)
    }
}

/// Reads the newest frame or each one, and writes nothing.
pub struct Look(Base);

/// Parameters of a node that only reads.
#[derive(Params)]
pub struct Looks {
    /// Whether its input must belong to the call's tick.
    #[param(default = true)]
    exact: bool,
    /// Duration of a call.
    #[param(default = 0.0, range = 0.0..=100000.0, unit = "ms")]
    cost_ms: f64,
}

impl Node for Look {
    const INFO: NodeInfo = NodeInfo::compute("look", "sink", "Looks at pictures.");
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Looks;

    fn open(open: &Open<'_>, _: &Looks) -> Result<Self> {
        let id = open.node_id().to_owned();
        let (hash, instance) = (name_hash(&id), next_instance());
        Ok(Self(Base { id, hash, instance, count: 0, close_ms: 0.0, save_ms: 0.0, load_ms: 0.0 }))
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, looks: &Looks) -> Result<()> {
        if let Some(content) = self.0.look(cx, &input.image, looks.exact) {
            self.0.called(cx.tick().seq, vec![content]);
        }
        if looks.cost_ms > 0.0 {
            wait_ms(looks.cost_ms);
        }
        Ok(())
    }
}

/// Writes the number of each tick to the simulated disk.
pub struct Write {
    base: Base,
    file: disk::File,
    name: String,
}

impl Node for Write {
    const INFO: NodeInfo = NodeInfo::blocking("write", "sink", "Writes the numbers of ticks.").side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Plan;

    fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
        let base = Base::open(open, plan)?;
        let name = format!("{}-{}", base.id, base.instance);
        let file = disk().create(&name)?;
        Ok(Self { base, file, name })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, plan: &Plan) -> Result<()> {
        let seq = cx.tick().seq;
        if self.base.begin(cx, &input.image).is_none() {
            return Ok(());
        }
        let harm = plan.begin_harm(&self.base.id, seq);
        plan.suffer(cx, harm)?;
        let before = self.file.len();
        if let Err(error) = self.file.append(&seq.to_le_bytes()) {
            // A number is whole or not there.
            self.file.cut(before);
            return Err(error.into());
        }
        observe(Seen::Wrote { node: self.base.id.clone(), file: self.name.clone(), seq });
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        observe(Seen::Finished { node: self.base.id.clone(), file: self.name.clone() });
        Ok(())
    }
}

/// [`Mark`], then reports a wrong length of its output.
unsafe extern "C" fn lie(instance: *mut std::ffi::c_void, call: *mut abi::Call) -> abi::Status {
    const HONEST: abi::NodeType = NodeTypeOf::<Mark>::NODE_TYPE;
    let Some(process) = HONEST.process else { return abi::STATUS_INVALID };
    // SAFETY: the host's own call, passed on.
    let status = unsafe { process(instance, call) };
    // SAFETY: the host keeps the call and its outputs valid until this function returns; no `process` runs now.
    unsafe {
        let (seq, outputs) = ((*call).tick.seq, (*call).outputs);
        let params = std::slice::from_raw_parts((*call).params, (*call).params_len);
        let plan = Plan::read(params);
        let lies = |plan: &Plan| plan.harm == Harm::WrongLength && seq >= plan.first && seq - plan.first < plan.ticks;
        if plan.is_ok_and(|plan| lies(&plan)) && (*call).outputs_len > 0 && !(*outputs).is_empty() {
            (*outputs).len += 4096;
            (*outputs).height *= 2;
        }
    }
    status
}

/// Descriptors of all simulated nodes. They live until the process ends.
pub fn node_types() -> Vec<&'static abi::NodeType> {
    let liar = abi::NodeType { name: abi::Str::new("mark_lying"), process: Some(lie), ..NodeTypeOf::<Mark>::NODE_TYPE };
    vec![
        &NodeTypeOf::<Camera>::NODE_TYPE,
        &NodeTypeOf::<Pass>::NODE_TYPE,
        &NodeTypeOf::<Mark>::NODE_TYPE,
        &NodeTypeOf::<MarkBlocking>::NODE_TYPE,
        &NodeTypeOf::<MarkDevice>::NODE_TYPE,
        &NodeTypeOf::<Draw>::NODE_TYPE,
        &NodeTypeOf::<Keep>::NODE_TYPE,
        &NodeTypeOf::<Pair>::NODE_TYPE,
        &NodeTypeOf::<Look>::NODE_TYPE,
        &NodeTypeOf::<Write>::NODE_TYPE,
        Box::leak(Box::new(liar)),
    ]
}
