//! Which outputs are shown, and their images as JPEG.

use panoscope_base::{View, format};
use panoscope_data::formats::{Pixels, still};
use panoscope_engine::memory::FrameRef;
use panoscope_graph::{Catalog, Graph, PresetView};

use crate::paint::{Range, painted};

/// Maximum number of outputs that are shown of a graph without `[preset]`.
const MAX_COUNT: usize = 6;
/// JPEG quality, percent.
const QUALITY: u8 = 80;

/// An output that is shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shown {
    /// The node.
    pub node: String,
    /// Its output.
    pub output: String,
    /// Type of its packets.
    pub packet: String,
    /// Label next to it.
    pub label: String,
}

impl Shown {
    /// `node.output`, as in a graph file.
    pub fn name(&self) -> String {
        format!("{}.{}", self.node, self.output)
    }
}

/// The views of the graph's preset that can be drawn; without a preset, the inputs of its sinks.
pub fn of_graph(graph: &Graph, catalog: &Catalog) -> Vec<Shown> {
    let type_of = |node: usize| graph.nodes[node].node_type(catalog);
    let has_picture = |node: usize, port: usize| {
        let packet = type_of(node).outputs.get(port).map(|port| port.packet.name.as_str());
        packet.is_some_and(|packet| PresetView::PACKETS.contains(&packet))
    };
    let shown = |node: usize, port: usize, label: &str| Shown {
        node: graph.nodes[node].id.clone(),
        output: type_of(node).outputs[port].name.clone(),
        packet: type_of(node).outputs[port].packet.name.clone(),
        label: label.to_owned(),
    };
    let views = graph.preset.views.iter().filter(|view| has_picture(view.node, view.port));
    let mut all: Vec<Shown> = views.map(|view| shown(view.node, view.port, &view.label)).collect();
    if all.is_empty() {
        let to_sinks = graph.edges.iter().filter(|edge| type_of(edge.to_node).outputs.is_empty());
        for edge in to_sinks.filter(|edge| has_picture(edge.from_node, edge.from_port)) {
            let label = &graph.nodes[edge.from_node].id;
            let one = shown(edge.from_node, edge.from_port, label);
            if all.len() < MAX_COUNT && !all.iter().any(|known| known.name() == one.name()) {
                all.push(one);
            }
        }
    }
    all
}

/// An output without an image.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The output made no packet yet.
    #[error("there is no image yet")]
    None,
    /// Its description needs more bytes than the packet has.
    #[error("an image of {width} x {height} {format} does not match its bytes")]
    Bytes {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Name of the format.
        format: &'static str,
    },
    /// Packets of its format cannot be drawn.
    #[error("{format} cannot be shown as an image")]
    Format {
        /// Name of the format.
        format: &'static str,
    },
    /// It could not be encoded.
    #[error("{reason}")]
    Encode {
        /// The encoder's reason.
        reason: String,
    },
}

/// A packet of a type as JPEG. `range` of the colours of a map is kept from image to image.
pub fn jpeg(frame: &FrameRef, packet: &str, range: &mut Range) -> Result<Vec<u8>, PictureError> {
    let head = frame.frame();
    let name = format::name(head.format);
    let wrong = || PictureError::Bytes { width: head.width, height: head.height, format: name };
    let (width, height, stride) = (head.width as usize, head.height as usize, head.stride_bytes as usize);
    let need = format::image_bytes(width, height, stride, format::pixel_bytes(head.format)).ok_or_else(wrong)?;
    let bytes = frame.bytes().get(..need).ok_or_else(wrong)?;
    let view = |channels| View::with_stride(bytes, width, height, channels, stride);
    let paint = painted(head, bytes, packet, range);
    let pixels = match name {
        _ if paint.is_some() => Pixels::Bgr8(View::new(paint.as_deref().unwrap_or_default(), width, height, 3)),
        "gray8" => Pixels::Gray8(view(1)),
        "bgr8" => Pixels::Bgr8(view(3)),
        "rgba8" => Pixels::Rgba8(view(4)),
        _ => return Err(PictureError::Format { format: name }),
    };
    let mut out = Vec::new();
    still::encode(&mut out, "jpg", &pixels, QUALITY, &mut Vec::new())
        .map_err(|error| PictureError::Encode { reason: error.to_string() })?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_abi::Frame;
    use panoscope_engine::memory::memory;

    fn frame(format: &str, width: u32, height: u32, bytes: &[u8]) -> FrameRef {
        let (buffer, data) = memory().allocate(bytes.len()).unwrap();
        let format = format::image_named(format).unwrap().id;
        let stride_bytes = width * format::pixel_bytes(format) as u32;
        // SAFETY: a new buffer of this length, whose one reference goes to the frame.
        unsafe {
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), data, bytes.len());
            let empty = FrameRef::empty(Default::default()).into_raw();
            FrameRef::adopt(Frame { buffer, data, len: bytes.len(), format, width, height, stride_bytes, ..empty })
        }
    }

    #[test]
    fn a_picture_becomes_a_jpeg_of_its_size() {
        let bytes = [0, 0, 255].repeat(64 * 48);
        let encoded = jpeg(&frame("bgr8", 64, 48, &bytes), "image", &mut None).unwrap();
        let decoded = image::load_from_memory(&encoded).unwrap().to_rgb8();
        assert_eq!(decoded.dimensions(), (64, 48));
        let [red, green, blue] = decoded.get_pixel(32, 24).0;
        assert!(red > 245 && green < 10 && blue < 10, "{red} {green} {blue}");
    }

    #[test]
    fn a_map_becomes_a_picture_in_colours() {
        let bytes: Vec<u8> = (0..64 * 48).flat_map(|at| ((at % 64) as f32).to_le_bytes()).collect();
        let encoded = jpeg(&frame("f32", 64, 48, &bytes), "depth", &mut None).unwrap();
        let decoded = image::load_from_memory(&encoded).unwrap().to_rgb8();
        assert_eq!(decoded.dimensions(), (64, 48));
        let ([near, ..], [far, ..]) = (decoded.get_pixel(2, 24).0, decoded.get_pixel(61, 24).0);
        assert!(far > near + 100, "dark violet to yellow: {near} {far}");
    }

    #[test]
    fn frames_without_a_picture_are_errors() {
        for name in ["bgr8", "f32"] {
            assert!(
                jpeg(&frame(name, 64, 48, &[0; 100]), "image", &mut None)
                    .unwrap_err()
                    .to_string()
                    .contains("does not match")
            );
        }
    }
}
