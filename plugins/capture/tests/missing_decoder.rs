//! A decoder that is not installed is named with its package. This is a separate test program, because it hides the decoders from the whole process.

use crate::common::{Folder, encode, scene};
use gstreamer as gst;
use gstreamer::prelude::*;

#[test]
fn the_package_of_a_missing_decoder_is_named() {
    let folder = Folder::new("missing_decoder");
    let size = (64, 48);
    let frames = (0..5).map(|index| (index, scene(index, size)));
    encode(&folder.0.join("v.mkv"), 25.0, size, "x264enc ! h264parse ! matroskamux", frames);
    let decodes = |factory: &gst::ElementFactory| {
        let caps = gst::Caps::new_empty_simple("video/x-h264");
        factory
            .static_pad_templates()
            .iter()
            .any(|pad| pad.direction() == gst::PadDirection::Sink && pad.caps().can_intersect(&caps))
    };
    let decoders = gst::ElementFactory::factories_with_type(gst::ElementFactoryType::DECODER, gst::Rank::NONE);
    let hidden: Vec<gst::ElementFactory> = decoders.into_iter().filter(decodes).collect();
    assert!(!hidden.is_empty());
    for factory in hidden {
        factory.set_rank(gst::Rank::NONE);
    }
    let message = folder.refused(r#"left = "v.mkv""#);
    for words in ["v.mkv", "H.264", "apt install gstreamer1.0-libav"] {
        assert!(message.contains(words), "{message}");
    }
}
