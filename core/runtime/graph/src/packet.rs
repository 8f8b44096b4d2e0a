//! Types of packets, and which output may be connected to which input.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Type of a packet.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PacketType {
    /// `image`, `disparity`, ... or the name of a plugin's own type. An input called `any` accepts every packet.
    pub name: String,
    /// Pixel formats that an input accepts or an output may send (`gray8`, `bgr8`, `rgba8`, `gray16`, `f32`);
    /// empty means any. Used for images only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub formats: Vec<String>,
    /// Hash of the memory layout, compared when an edge is connected. 0 means "not stated" and is not compared.
    #[serde(default)]
    pub layout_hash: u64,
}

/// An output that cannot be connected to an input.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PacketMismatch {
    /// Another packet type.
    #[error("this input accepts {taken}, but the output sends {sent}")]
    Type {
        /// Packet type of the output.
        sent: String,
        /// Packet type of the input.
        taken: String,
    },
    /// The same packet type in other pixel formats.
    #[error("this input accepts {packet} as {taken}, but the output sends {sent}")]
    Format {
        /// The packet type of both.
        packet: String,
        /// Formats of the output.
        sent: String,
        /// Formats of the input.
        taken: String,
    },
    /// One name, two memory layouts.
    #[error("both are {packet}, but their memory layouts differ: rebuild one of the plugins")]
    Layout {
        /// The packet type of both.
        packet: String,
    },
}

/// Fit of an output for an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fit {
    Yes,
    /// The output may send bgr8, the input takes gray8.
    Convert,
    Type,
    Format,
    Layout,
}

impl PacketType {
    /// An input of this packet name accepts every packet (previews, recorders).
    pub const ANY: &'static str = "any";

    /// Whether an output of this type may be connected to an input of type `input`.
    ///
    /// # Errors
    /// The reason why not.
    pub fn fits(&self, input: &PacketType) -> Result<(), PacketMismatch> {
        let packet = || self.name.clone();
        match self.fit(input) {
            Fit::Yes | Fit::Convert => Ok(()),
            Fit::Type => Err(PacketMismatch::Type { sent: packet(), taken: input.name.clone() }),
            Fit::Format => {
                let (sent, taken) = (self.formats.join(", "), input.formats.join(" or "));
                Err(PacketMismatch::Format { packet: packet(), sent, taken })
            }
            Fit::Layout => Err(PacketMismatch::Layout { packet: packet() }),
        }
    }

    /// Fit of an output of this type for an input of type `input`.
    pub(crate) fn fit(&self, input: &PacketType) -> Fit {
        if input.name == Self::ANY || self.name == Self::ANY {
            return Fit::Yes;
        }
        if self.name != input.name {
            return Fit::Type;
        }
        if self.layout_hash != 0 && input.layout_hash != 0 && self.layout_hash != input.layout_hash {
            return Fit::Layout;
        }
        let (sent, taken) = (&self.formats, &input.formats);
        let sends = |format: &str| sent.iter().any(|f| f == format);
        let takes = |format: &str| taken.iter().any(|f| f == format);
        if taken.is_empty() {
            return Fit::Yes;
        }
        if takes("gray8") && !takes("bgr8") && (sent.is_empty() || sends("bgr8")) {
            return Fit::Convert;
        }
        if sent.is_empty() || sent.iter().any(|f| takes(f)) { Fit::Yes } else { Fit::Format }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mismatch_names_both_sides() {
        let image = |formats: &[&str]| PacketType {
            name: "image".to_owned(),
            formats: formats.iter().map(|f| (*f).to_owned()).collect(),
            layout_hash: 0,
        };
        let depth = PacketType { name: "depth".to_owned(), ..PacketType::default() };
        let words = |output: &PacketType, input: &PacketType| output.fits(input).map_err(|e| e.to_string());
        assert_eq!(words(&image(&["bgr8"]), &image(&["gray8"])), Ok(()));
        assert_eq!(words(&depth, &image(&[])), Err("this input accepts image, but the output sends depth".to_owned()));
        assert_eq!(
            words(&image(&["f32"]), &image(&["bgr8", "gray8"])),
            Err("this input accepts image as bgr8 or gray8, but the output sends f32".to_owned())
        );
    }
}
