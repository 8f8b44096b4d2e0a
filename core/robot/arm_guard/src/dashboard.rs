//! The dashboard server of a Universal Robots controller: lines of text over TCP. It can start, stop and unlock the
//! robot; this module only sends a query.

use std::io::{BufRead, BufReader, Read, Write};
use std::time::Duration;

use panoscope_arm_core::line::Serial;

use crate::port::PortError;
use crate::tcp;

/// Time limit of each answer to the set-up.
pub(crate) const ANSWER_WITHIN: Duration = Duration::from_millis(800);
/// Advice for a controller whose software is too old.
pub(crate) const UPDATE: &str =
    "update its software to PolyScope 5.6 or later (e-Series), 3.12 or later (CB3); PolyScope X is not supported";

/// Asks the dashboard server for the serial number of the arm, which RTDE does not give.
///
/// # Errors
/// Nothing answers, or the answer is not that of a dashboard server of a supported version.
pub(crate) fn serial_number(host: &str, port: u16) -> Result<Serial, PortError> {
    let place = format!("{host}:{port}");
    let failed = |cause| PortError::NotReached { place: place.clone(), cause };
    let mut stream = tcp::connect(host, port)?;
    stream.set_read_timeout(Some(ANSWER_WITHIN)).map_err(failed)?;
    stream.set_write_timeout(Some(ANSWER_WITHIN)).map_err(failed)?;
    // Bounded: whatever answers here may send without end.
    let mut lines = BufReader::new(stream.try_clone().map_err(failed)?.take(1024));
    let mut line = String::new();
    lines.read_line(&mut line).map_err(failed)?;
    let unsuitable = |what: String, advice| PortError::Unsuitable { place: place.clone(), what, advice };
    if !line.starts_with("Connected") {
        return Err(unsuitable("this is not a dashboard server".to_owned(), "check the address and `dashboard_port`"));
    }
    stream.write_all(b"get serial number\n").map_err(failed)?;
    line.clear();
    lines.read_line(&mut line).map_err(failed)?;
    let answer = line.trim();
    // Of whatever answers here, a message quotes a little.
    let quoted: String = answer.chars().take(60).flat_map(char::escape_debug).collect();
    Serial::new(&format!("UR-{answer}")).filter(|_| answer.starts_with(|c: char| c.is_ascii_digit())).ok_or_else(|| {
        unsuitable(format!("the dashboard server returned `{quoted}` instead of a serial number"), UPDATE)
    })
}
