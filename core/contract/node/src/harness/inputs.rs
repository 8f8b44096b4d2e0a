//! Frames that a test gives to the node's inputs.

use crate::View;
use crate::abi::{self, Detection, Frame, Tick};
use crate::output::Slot;
use crate::packet::{LabeledDetections, LabeledInstances, Packet, Plane, PointCloud, TableData, TextPacket};
use crate::port::{PortField, RawCall};

use super::error::HarnessError;
use super::host::{CallState, bare_call};
use super::outputs::copy_rows;
use super::{Harness, available, memory};

/// Content of an input port for the next call.
pub(super) enum Pending {
    /// Nothing was given.
    Unconnected,
    /// Frames; [`Frame::EMPTY`] for an empty one.
    Frames(Vec<Frame>),
}

impl Pending {
    pub(super) fn buffers(&self) -> usize {
        match self {
            Pending::Unconnected => 0,
            Pending::Frames(frames) => frames.iter().filter(|f| !f.is_empty()).count(),
        }
    }
}

/// Makes one frame through an output slot, so that only `Slot` lays out packets of variable length.
fn make_frame<T>(
    pool: u32,
    host: &abi::Host,
    fill: impl FnOnce(&mut Slot<'_, T>) -> crate::Result<()>,
) -> crate::Result<Frame>
where
    for<'f> Slot<'f, T>: PortField<'f>,
{
    let mut outputs = [Frame::EMPTY];
    let mut state = CallState::new(pool, &mut outputs, vec![0], 0);
    let mut call = bare_call(host, &mut state, Tick::default());
    // SAFETY: the call and all that it points to are locals that live until the end of this function.
    let mut slot = Slot::<T>::bind(unsafe { RawCall::new(&mut call) }, 0, "input")?;
    let result = fill(&mut slot);
    let [frame] = outputs;
    match result {
        Ok(()) => Ok(frame),
        Err(error) => {
            if !frame.is_empty() {
                memory::release(frame.buffer);
            }
            Err(error)
        }
    }
}

impl<N> Harness<N> {
    /// Gives an input an image (or mask, disparity map, ...) of `width` x `height` pixels. On a list input every call
    /// adds an entry. The next [`Harness::process`] reports a mistake.
    pub fn input_image<P: Plane>(&mut self, name: &str, width: usize, height: usize, data: &[P::Element]) -> &mut Self {
        self.input_image_with_stride::<P>(name, width, height, width * P::CHANNELS, data)
    }

    /// As [`Harness::input_image`] with rows that start `stride` elements apart, in `data` and in the frame.
    pub fn input_image_with_stride<P: Plane>(
        &mut self,
        name: &str,
        width: usize,
        height: usize,
        stride: usize,
        data: &[P::Element],
    ) -> &mut Self {
        let row = width * P::CHANNELS;
        let need = if height == 0 { 0 } else { (height - 1) * stride + row };
        if width == 0 || height == 0 || stride < row || data.len() < need {
            let problem = format!(
                "input `{name}`: {width}x{height} pixels with {stride} elements a row need {need} elements, {} were given",
                data.len()
            );
            return self.refuse(problem);
        }
        let size = size_of::<P::Element>();
        let described = Frame {
            format: P::FORMAT,
            width: width as u32,
            height: height as u32,
            stride_bytes: (stride * size) as u32,
            ..Frame::EMPTY
        };
        let bytes = crate::packet::bytes_of(&data[..need]);
        let frame = memory::store(self.pool, bytes, described);
        self.accept(name, P::PACKET, 0, P::FORMAT, frame)
    }

    /// Gives an input an image as [`Harness::input_image`] does, which counts as made on the GPU.
    pub fn input_image_from_device<P: Plane>(
        &mut self,
        name: &str,
        width: usize,
        height: usize,
        data: &[P::Element],
    ) -> &mut Self {
        self.input_image::<P>(name, width, height, data);
        if let Some(Pending::Frames(frames)) = self.node_type.input(name).map(|index| &mut self.pending[index])
            && let Some(frame) = frames.last_mut()
        {
            frame.buffer.home = abi::HOME_DEVICE;
        }
        self
    }

    /// Gives an input plain data: a homography, a calibration, a plugin's own packet.
    pub fn input_value<T: Packet>(&mut self, name: &str, value: T) -> &mut Self {
        self.fill::<T>(name, T::NAME, T::LAYOUT_HASH, |slot| slot.set(value))
    }

    /// Gives an input a text.
    pub fn input_text(&mut self, name: &str, text: &str) -> &mut Self {
        self.fill::<TextPacket>(name, "text", 0, |slot| slot.set_text(text))
    }

    /// Gives an input a table: `columns` are names with their units, `values` are in row order.
    pub fn input_table(&mut self, name: &str, columns: &[&str], values: &[f64]) -> &mut Self {
        self.fill::<TableData>(name, "table", 0, |slot| slot.set_table(columns, values))
    }

    /// Gives an input boxes. `labels` are names separated by line feeds, `image_size` is width, height in px.
    pub fn input_detections(
        &mut self,
        name: &str,
        items: &[Detection],
        labels: &str,
        image_size: (usize, usize),
    ) -> &mut Self {
        self.fill::<LabeledDetections>(name, "detections", 0, |slot| slot.set_detections(items, labels, image_size))
    }

    /// Gives an input boxes with bit masks, see [`crate::detections::mask_len`].
    pub fn input_instances(
        &mut self,
        name: &str,
        items: &[Detection],
        labels: &str,
        image_size: (usize, usize),
        masks: &[u8],
    ) -> &mut Self {
        self.fill::<LabeledInstances>(name, "instances", 0, |slot| slot.set_instances(items, labels, image_size, masks))
    }

    /// Gives an input a point cloud: `width * height` points, row after row.
    pub fn input_cloud(&mut self, name: &str, width: usize, height: usize, points: &[abi::CloudPoint]) -> &mut Self {
        if points.len() != width * height {
            return self.refuse(format!("input `{name}`: expected {width}x{height} points, got {}", points.len()));
        }
        self.fill::<PointCloud>(name, "cloud", 0, |slot| {
            copy_rows(View::new(points, width, height, 1), slot.alloc_cloud(width, height)?);
            Ok(())
        })
    }

    /// Marks an input as connected but empty for the next tick. On a list input every call adds an empty entry.
    pub fn input_empty(&mut self, name: &str) -> &mut Self {
        self.put(name, Frame::EMPTY)
    }

    /// Stores the first mistake, for the next call.
    fn refuse(&mut self, problem: String) -> &mut Self {
        self.problem.get_or_insert_with(|| HarnessError::port(problem));
        self
    }

    /// Gives an input a frame that is made as a node's output would be.
    fn fill<T>(
        &mut self,
        name: &str,
        packet: &str,
        layout_hash: u64,
        fill: impl FnOnce(&mut Slot<'_, T>) -> crate::Result<()>,
    ) -> &mut Self
    where
        for<'f> Slot<'f, T>: PortField<'f>,
    {
        match make_frame::<T>(self.pool, &self.host, fill) {
            Ok(frame) => self.accept(name, packet, layout_hash, frame.format, Some(frame)),
            Err(error) => self.refuse(format!("input `{name}`: {error}")),
        }
    }

    /// Checks a frame against the port's declaration and stores it for the next call.
    fn accept(&mut self, name: &str, packet: &str, layout_hash: u64, format: u32, frame: Option<Frame>) -> &mut Self {
        let Some(frame) = frame else {
            return self.refuse(format!("input `{name}`: no more buffers are allowed"));
        };
        let problem = self.node_type.input(name).and_then(|index| {
            let port = &self.node_type.inputs[index].packet;
            if port.name == panoscope_graph::PacketType::ANY {
                return None;
            }
            if port.name != packet {
                return Some(format!("input `{name}` takes `{}`, it was given `{packet}`", port.name));
            }
            if port.layout_hash != 0 && layout_hash != 0 && port.layout_hash != layout_hash {
                return Some(format!("input `{name}` takes `{packet}` of another layout"));
            }
            let word = panoscope_base::format::name(format);
            (!port.formats.is_empty() && !port.formats.iter().any(|f| f == word))
                .then(|| format!("input `{name}` takes {}, it was given {word}", port.formats.join(", ")))
        });
        match problem {
            Some(problem) => {
                memory::release(frame.buffer);
                self.refuse(problem)
            }
            None => self.put(name, frame),
        }
    }

    fn put(&mut self, name: &str, frame: Frame) -> &mut Self {
        let Some(index) = self.node_type.input(name) else {
            if !frame.is_empty() {
                memory::release(frame.buffer);
            }
            let names = self.node_type.inputs.iter().map(|p| p.name.as_str());
            let problem = format!("there is no input `{name}`{}", available(name, names));
            return self.refuse(problem);
        };
        let is_list = self.node_type.inputs[index].list;
        match &mut self.pending[index] {
            Pending::Frames(frames) if is_list => frames.push(frame),
            Pending::Frames(_) => {
                if !frame.is_empty() {
                    memory::release(frame.buffer);
                }
                return self.refuse(format!("input `{name}` was given twice, but it is not a list"));
            }
            waiting => *waiting = Pending::Frames(vec![frame]),
        }
        self
    }

    /// Releases the frames given for the next call.
    pub(super) fn drop_inputs(&mut self) {
        for waiting in &mut self.pending {
            if let Pending::Frames(frames) = std::mem::replace(waiting, Pending::Unconnected) {
                frames.iter().filter(|f| !f.is_empty()).for_each(|f| memory::release(f.buffer));
            }
        }
    }
}
