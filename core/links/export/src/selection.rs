//! Which ports and ticks of a recording are exported.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use panoscope_abi as abi;
use panoscope_record::{Packet, PortTypes, Recording};

use crate::error::ExportError;
use crate::value::{Kind, Value};

/// The selected part of a recording.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Names of ports, `node.output`, or of nodes, which select all their outputs. Empty for all ports.
    pub ports: Vec<String>,
    /// Numbers of the ticks.
    pub ticks: RangeInclusive<u64>,
}

impl Default for Selection {
    fn default() -> Self {
        Self { ports: Vec::new(), ticks: 0..=u64::MAX }
    }
}

/// A port with the packets that are exported.
#[derive(Debug)]
pub struct Port<'r> {
    /// `node.output`.
    pub name: &'r str,
    /// Name of the packet type; empty if no plugin here declares it.
    pub packet: String,
    /// Kind of its packets, or why it is unknown.
    pub kind: Result<Kind, String>,
    /// The packets, in order of their ticks.
    pub packets: Vec<&'r Packet>,
}

impl Port<'_> {
    /// The report of a port that is in the target.
    pub(crate) fn written(&self, form: Form, at: impl Into<String>) -> PortReport {
        self.report(Ok((form, at.into())))
    }

    /// The report of a port that is not in the target.
    pub(crate) fn left_out(&self, why: impl Into<String>) -> PortReport {
        self.report(Err(why.into()))
    }

    fn report(&self, outcome: Result<(Form, String), String>) -> PortReport {
        PortReport { port: self.name.to_owned(), packet: self.packet.clone(), packets: self.packets.len(), outcome }
    }
}

/// Format of a port in a target, such as `PNG` or `foxglove.PointCloud`.
pub type Form = &'static str;

/// Result of the export of one port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortReport {
    /// `node.output`.
    pub port: String,
    /// Name of the packet type; empty if unknown.
    pub packet: String,
    /// Number of packets.
    pub packets: usize,
    /// Form and location in the target, or why the port was left out.
    pub outcome: Result<(Form, String), String>,
}

/// Ports and ticks of a recording, ready to be written.
pub struct Export<'r> {
    recording: &'r Recording,
    /// The ports, by name.
    pub ports: Vec<Port<'r>>,
}

impl<'r> Export<'r> {
    /// Selects ports and ticks.
    ///
    /// # Errors
    /// A port or a tick is not in the recording.
    pub fn new(types: &'r PortTypes, selection: &Selection) -> Result<Self, ExportError> {
        let recording = types.recording();
        let file = || recording.path().to_owned();
        let names = || recording.ports.keys().map(String::as_str);
        if recording.ports.values().all(Vec::is_empty) {
            return Err(ExportError::Empty { file: file() });
        }
        for wanted in &selection.ports {
            if !names().any(|name| is_of(name, wanted)) {
                let known = names().collect::<Vec<_>>().join(", ");
                return Err(ExportError::NoPort { file: file(), port: wanted.clone(), known });
            }
        }
        let is_wanted =
            |name: &str| selection.ports.is_empty() || selection.ports.iter().any(|wanted| is_of(name, wanted));
        let mut ports = Vec::new();
        for (name, all) in recording.ports.iter().filter(|(name, _)| is_wanted(name)) {
            let packets: Vec<&Packet> =
                all.iter().filter(|packet| selection.ticks.contains(&packet.head.tick.seq)).collect();
            let Some(first) = packets.first() else { continue };
            let packet = types.packet(name);
            let kind = Kind::of(first.head.format, packet.as_deref().ok()).ok_or_else(|| match &packet {
                Ok(packet) => format!("packets of type `{packet}` are known to their plugin only"),
                Err(error) => error.to_string(),
            });
            let packet = packet.unwrap_or_default().to_owned();
            ports.push(Port { name, packet, kind, packets });
        }
        if ports.is_empty() {
            let ticks = || recording.ports.values().flatten().map(|packet| packet.head.tick.seq);
            let (first, last) = (ticks().min().unwrap_or(0), ticks().max().unwrap_or(0));
            return Err(ExportError::NoTicks { file: file(), first, last });
        }
        Ok(Self { recording, ports })
    }

    /// Passes the value of a packet to `take`.
    ///
    /// # Errors
    /// The packet is damaged, or `take` fails.
    pub(crate) fn value<T>(
        &self,
        port: &Port<'_>,
        kind: Kind,
        packet: &Packet,
        take: impl FnOnce(Value<'_>) -> Result<T, ExportError>,
    ) -> Result<T, ExportError> {
        let bytes = self.recording.bytes(port.name, packet)?;
        // A port of images may change its format from packet to packet; the head of each one says which it has.
        let kind = if packet.head.format == abi::FORMAT_BYTES {
            kind
        } else {
            Kind::of(packet.head.format, None).unwrap_or(kind)
        };
        let value = Value::read(kind, &packet.head, &bytes);
        let (port, tick) = (|| port.name.to_owned(), packet.head.tick.seq);
        take(value.map_err(|cause| ExportError::Value { port: port(), tick, cause })?)
    }

    /// Whether `path` is the recording itself.
    pub(crate) fn is_recording(&self, path: &Path) -> bool {
        let real = |path: &Path| path.canonicalize().ok();
        real(path).is_some_and(|path| real(self.recording.path()) == Some(path))
    }
}

/// Whether a port has that name, or belongs to the node or part of that name.
fn is_of(port: &str, wanted: &str) -> bool {
    port.strip_prefix(wanted).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '/']))
}

/// Path of an incomplete file, next to the final one.
pub(crate) fn part_of(path: &Path) -> PathBuf {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    part.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_or_part_stands_for_its_ports() {
        for (wanted, is) in [
            ("stereo/match.depth", true),
            ("stereo/match", true),
            ("stereo", true),
            ("stereo/mat", false),
            ("ster", false),
        ] {
            assert_eq!(is_of("stereo/match.depth", wanted), is, "{wanted}");
        }
    }
}
