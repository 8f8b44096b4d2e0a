//! Which camera is lost. A source of several cameras may withhold the images of all of them while one is lost: only its fault names that one.

use std::time::Duration;

use panoscope_editor_model::observe::Output;
use panoscope_engine::fault::Fault;

use super::time;

/// How much earlier than the silence that it explains a fault may be, ms: images wait on their way to the window.
const BEFORE_MS: u64 = 500;
/// How much later it may be, ms: a source waits for a while before it calls a camera lost.
const AFTER_MS: u64 = 2500;

/// Time between the last images of two cameras that do not fall silent together: longer than between two frames of the window.
const APART: Duration = Duration::from_millis(250);

/// A camera and its silence.
pub struct SilentCamera<'a> {
    /// Its output.
    pub output: &'a Output,
    /// Its title.
    pub title: String,
    /// What the parameters of its source name as this camera, such as an address; empty where that is not known.
    pub source: &'a str,
    /// Time since its last image; `None` when there never was one.
    pub since: Option<Duration>,
    /// Whether that is so long that something is wrong.
    pub has_stopped: bool,
}

/// Cameras of a notice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LostCameras {
    /// Their titles: one, or all of those of which one or more are lost.
    pub titles: Vec<String>,
    /// Time since the last image; `None` when there never was one.
    pub since: Option<Duration>,
}

/// The cameras of a node that are silent: those that have stopped, and those whose last images are hardly newer, so that they will count as stopped
/// within a moment.
fn silent_of<'s, 'a>(cameras: &'s [SilentCamera<'a>], node: &str) -> Vec<&'s SilentCamera<'a>> {
    let of_node = || cameras.iter().filter(|camera| camera.output.node == node);
    let longest = of_node().filter(|camera| camera.has_stopped).filter_map(|camera| camera.since).max();
    let is_hardly_newer = |camera: &&SilentCamera<'_>| {
        camera.since.zip(longest).is_some_and(|(since, longest)| since > APART && since + APART >= longest)
    };
    of_node().filter(|camera| camera.has_stopped || is_hardly_newer(camera)).collect()
}

/// The cameras that are lost. `all` are the cameras of the graph, `fault_of` is the newest fault of a node.
///
/// Where all cameras of a source are silent and its fault names some of them, only those are lost. Without such a fault they are listed together:
/// a name that may be wrong is worse than none. That goes for a fault, too, that names another camera than one before: `named_before` are those that
/// earlier faults of this silence have named.
pub fn cameras<'f>(
    all: &[SilentCamera<'_>],
    named_before: &mut Vec<Output>,
    fault_of: impl Fn(&str) -> Option<&'f Fault>,
) -> Vec<LostCameras> {
    named_before.retain(|output| all.iter().any(|camera| camera.has_stopped && camera.output == output));
    let mut lost = Vec::new();
    let mut nodes: Vec<&str> =
        all.iter().filter(|camera| camera.has_stopped).map(|camera| camera.output.node.as_str()).collect();
    nodes.dedup();
    for node in nodes {
        let of_node = silent_of(all, node);
        let count = all.iter().filter(|camera| camera.output.node == node).count();
        let since = || of_node.iter().map(|camera| camera.since.unwrap_or_default());
        let apart = since().max().unwrap_or_default().saturating_sub(since().min().unwrap_or_default());
        // One that went on while another was silent is silent by itself.
        if of_node.len() == 1 || of_node.len() < count || apart > APART {
            lost.extend(of_node.iter().map(|c| LostCameras { titles: vec![c.title.clone()], since: c.since }));
            continue;
        }
        let since = of_node.iter().filter_map(|camera| camera.since).max();
        let before: Vec<_> = of_node.iter().copied().filter(|camera| named_before.contains(camera.output)).collect();
        let of_fault = fault_of(node).map(|fault| (came(fault, since), named(&of_node, &fault.words)));
        let named = match of_fault {
            Some((Came::AtBegin, named)) => named,
            // Of an attempt to open the camera again, or of the loss of another one: the first may be back by then.
            Some((Came::Later, named)) if !named.is_empty() && !before.is_empty() => named,
            _ => before.clone(),
        };
        let is_sure = before.iter().all(|camera| named.iter().any(|named| named.output == camera.output));
        named_before.extend(named.iter().map(|camera| camera.output.clone()));
        named_before.sort_unstable();
        named_before.dedup();
        match Some(named).filter(|named| !named.is_empty() && is_sure) {
            Some(named) => {
                lost.extend(named.iter().map(|c| LostCameras { titles: vec![c.title.clone()], since: c.since }));
            }
            None => lost.push(LostCameras { titles: of_node.iter().map(|c| c.title.clone()).collect(), since }),
        }
    }
    lost
}

/// When a fault came, relative to the start of a silence.
enum Came {
    Before,
    AtBegin,
    Later,
}

/// When a fault came, relative to the start of a silence; without an image ever, the start.
fn came(fault: &Fault, since: Option<Duration>) -> Came {
    let Some(since) = since else { return Came::AtBegin };
    let begin_ms = time::unix_ms().saturating_sub(since.as_millis() as u64);
    match fault.unix_ms {
        at_ms if at_ms < begin_ms.saturating_sub(BEFORE_MS) => Came::Before,
        at_ms if at_ms <= begin_ms + AFTER_MS => Came::AtBegin,
        _ => Came::Later,
    }
}

/// The cameras whose source a fault names.
fn named<'s, 'a>(cameras: &[&'s SilentCamera<'a>], message: &str) -> Vec<&'s SilentCamera<'a>> {
    let found: Vec<_> = cameras.iter().copied().filter(|camera| names(message, camera.source)).collect();
    // `udp://scope:500` is a part of `udp://scope:5001`.
    let is_part = |one: &SilentCamera<'_>| {
        found.iter().any(|other| other.source.len() > one.source.len() && other.source.contains(one.source))
    };
    found.iter().copied().filter(|camera| !is_part(camera)).collect()
}

/// Whether an error message names a source. A number stands for a camera of this machine.
fn names(message: &str, source: &str) -> bool {
    let device = match source.parse::<u32>() {
        Ok(number) => format!("/dev/video{number}"),
        Err(_) => source.to_owned(),
    };
    let ends_there = |rest: &str| !rest.starts_with(|c: char| c.is_ascii_digit());
    !source.is_empty() && message.match_indices(&device).any(|(at, _)| ends_there(&message[at + device.len()..]))
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use panoscope_engine::fault::{Action, Cause};

    use super::*;

    fn fault(message: &str, ago: Duration) -> Fault {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).expect("after 1970");
        Fault {
            unix_ms: (now - ago).as_millis() as u64,
            run_ms: 0.0,
            node: "scope".to_owned(),
            cause: Cause::Error,
            words: message.to_owned(),
            done: Action::Note,
            seq: None,
            late_ms: None,
            count: 1,
        }
    }

    /// The titles of what is lost where the cameras of `scope` have been silent for some ms; they have stopped from 1 s on.
    fn lost(
        sources: [&str; 2],
        since_ms: [u64; 2],
        named: &mut Vec<Output>,
        fault: Option<&Fault>,
    ) -> Vec<Vec<String>> {
        let outputs = ["left", "right"].map(|port| Output::new("scope", port));
        let camera = |n: usize| SilentCamera {
            output: &outputs[n],
            title: format!("{} camera", outputs[n].port),
            source: sources[n],
            since: Some(Duration::from_millis(since_ms[n])),
            has_stopped: since_ms[n] > 1000,
        };
        cameras(&[camera(0), camera(1)], named, |_| fault).into_iter().map(|lost| lost.titles).collect()
    }

    /// Of both cameras, silent for three seconds.
    fn both_silent(sources: [&str; 2], fault: Option<&Fault>) -> Vec<Vec<String>> {
        lost(sources, [3000; 2], &mut Vec::new(), fault)
    }

    #[test]
    fn the_camera_of_the_fault_is_named_and_no_other() {
        let udp = ["udpsrc port=500 ! decodebin", "udpsrc port=5001 ! decodebin"];
        for (number, source) in udp.iter().enumerate() {
            let words = format!("pipeline `{source}` is gone after 90 frames: no data for 2 s");
            let expected = [["left camera"], ["right camera"]][number];
            assert_eq!(both_silent(udp, Some(&fault(&words, Duration::from_secs(1)))), [expected]);
        }
        let words = "camera /dev/video12 is gone after 3 frames: the stream has ended. Outputs stay empty";
        assert_eq!(both_silent(["1", "12"], Some(&fault(words, Duration::from_secs(1)))), [["right camera"]]);
        assert_eq!(
            both_silent(["/dev/video1", "/dev/video12"], Some(&fault(words, Duration::from_secs(1)))),
            [["right camera"]]
        );
        let nested = ["rtsp://scope/a", "rtsp://scope/ab"];
        let words = "rtsp://scope/ab is gone after 3 frames: the stream has ended";
        assert_eq!(both_silent(nested, Some(&fault(words, Duration::from_secs(1)))), [["right camera"]]);
    }

    #[test]
    fn a_second_camera_that_is_lost_does_not_hide_the_first() {
        let mut named = Vec::new();
        let mut titles = |since_ms: u64, number: u32| {
            let gone = fault(&format!("camera /dev/video{number} is gone after 3 frames"), Duration::ZERO);
            lost(["0", "1"], [since_ms; 2], &mut named, Some(&gone))
        };
        assert_eq!(titles(2000, 0), [["left camera"]]);
        assert_eq!(titles(4000, 0), [["left camera"]], "it is tried again");
        assert_eq!(titles(5000, 1), [["left camera", "right camera"]], "the first one may be back");
        assert_eq!(titles(6000, 0), [["left camera", "right camera"]]);
        assert!(titles(0, 1).is_empty());
        assert_eq!(titles(2000, 1), [["right camera"]], "another silence");
        assert!(titles(0, 1).is_empty());
        assert_eq!(titles(4000, 1), [["left camera", "right camera"]], "what came later does not explain it");
    }

    #[test]
    fn cameras_that_fall_silent_together_are_never_named_one_by_one() {
        let both = [["left camera", "right camera"]];
        // The last image of one came a moment later.
        for since_ms in [[1010, 990], [990, 1010], [1200, 990], [1400, 1390]] {
            assert_eq!(lost(["0", "1"], since_ms, &mut Vec::new(), None), both, "{since_ms:?}");
        }
        assert!(lost(["0", "1"], [990, 970], &mut Vec::new(), None).is_empty());
        // The other one goes on, or did so for long.
        let later = fault("camera /dev/video1 is gone after 3 frames", Duration::from_millis(680));
        for since_ms in [[1010, 400], [1150, 680], [1600, 1010]] {
            assert_eq!(lost(["0", "1"], since_ms, &mut Vec::new(), Some(&later))[0], ["left camera"], "{since_ms:?}");
        }
        let gone = fault("camera /dev/video1 is gone after 3 frames", Duration::ZERO);
        assert_eq!(lost(["0", "1"], [1010, 990], &mut Vec::new(), Some(&gone)), [["right camera"]]);
    }

    #[test]
    fn without_a_fault_that_names_one_they_are_listed_together() {
        let both = [["left camera", "right camera"]];
        assert_eq!(both_silent(["0", "1"], None), both);
        let other = "no pictures of all views belong together";
        assert_eq!(both_silent(["0", "1"], Some(&fault(other, Duration::ZERO))), both);
        // An earlier loss says nothing about this one.
        let old = "camera /dev/video0 is gone after 3 frames: the stream has ended";
        assert_eq!(both_silent(["0", "1"], Some(&fault(old, Duration::from_secs(60)))), both);
        assert_eq!(both_silent(["", ""], Some(&fault(old, Duration::ZERO))), both);
    }
}
