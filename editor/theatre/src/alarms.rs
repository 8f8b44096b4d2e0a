//! Every kind of notice: its urgency, its text, its usual cause and what to do. The README has the same table, which a test compares.
//!
//! Ideas of IEC 60601-1-8 that are followed: three priorities that differ by colour, sign and size, the most urgent first, each with its cause in
//! plain words, shown until the cause is gone. No sound is made, and no compliance is claimed.

/// Urgency of a notice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// For information: gray.
    Note,
    /// Needs attention soon: yellow, with a sign.
    Warning,
    /// Needs attention now: orange, with a sign.
    Alarm,
}

/// A kind of notice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alarm {
    /// Its urgency.
    pub urgency: Urgency,
    /// Its text; what changes is in capitals.
    pub text: &'static str,
    /// The usual cause.
    pub cause: &'static str,
    /// What to do.
    pub action: &'static str,
}

macro_rules! alarms {
    ($($name:ident = $urgency:ident, $text:literal, $cause:literal, $action:literal;)*) => {
        $(
            #[doc = $text]
            pub const $name: Alarm =
                Alarm { urgency: Urgency::$urgency, text: $text, cause: $cause, action: $action };
        )*
        /// All kinds, the most urgent first.
        pub const ALL: &[Alarm] = &[$($name),*];
    };
}

alarms! {
    EMERGENCY = Alarm, "Emergency stop: the arm is stopped",
        "the stop was pressed", "make the arm safe, then hold the stop for two seconds to release it";
    NO_IMAGE = Alarm, "No image: REASON",
        "the camera did not open", "check cable and power, close other programs that use it, press Enter";
    RESTARTING = Alarm, "The image processing CRASHED",
        "a plugin ended the process", "go on with the camera's image; it starts again by itself, or with Enter";
    CAMERA_ONLY = Alarm, "Camera image only: REASON",
        "the graph cannot run", "go on with the camera's image; correct the reason, press Enter";
    STOPPED = Alarm, "The system stopped: REASON",
        "a stage stopped the run", "press Enter to start again";
    MACHINE_LOST = Alarm, "MACHINE is not reached: REASON",
        "its network, or its program", "the images are old: look at that machine's own display; it is tried again by itself";
    CAMERA_LOST = Alarm, "CAMERA lost: no image for N s",
        "cable, power or driver", "check cable and power; it is retried by itself";
    VIEW_STOPPED = Alarm, "VIEW has stopped",
        "a stage before it is in fault", "use the camera's image in its place";
    STAGE = Alarm, "Stage `NAME` HAS A FAULT",
        "an error in a plugin", "check the view that depends on it; the stage restarts by itself";
    DISK_FULL = Alarm, "The disk is full: nothing can be recorded",
        "less than 64 MiB are free", "free space; the view is not affected";
    SWAPPED = Alarm, "The left and right cameras are swapped",
        "cables are exchanged", "exchange the cables; do not measure";
    ENDED = Warning, "The source has ended",
        "a recording is over", "press Enter to start again";
    NOT_CHANGED = Warning, "REASON",
        "a change was not possible", "the graph before it keeps running";
    OLD_IMAGE = Warning, "Image is N s old",
        "a stage or the camera is too slow", "wait before you move; switch to the camera's view";
    DISK_LOW = Warning, "The disk is nearly full: N free",
        "less than 2 GiB are free while a clip is recorded", "end the clip, or free space";
    AUDIT = Warning, "The audit log is not written: REASON",
        "its folder is full or read-only", "free space, or tell who looks after the machine";
    PEDAL = Warning, "The pedal's settings are not used: REASON",
        "a mistake in `pedal.toml`", "use F13 to F17 and F20, or the keyboard; correct the file, then open the theatre again";
    DRIFTED = Warning, "The calibration does not fit any more: distances may be wrong, calibrate again",
        "the cameras moved against each other", "do not rely on distances; calibrate again";
    ATTACHED = Note, "Attached to MACHINE: no emergency stop from here",
        "the graph runs on another machine", "stop an arm at that machine only";
    UNLOCKED = Note, "Runs although it differs from its lock: DIFFERENCE",
        "files changed since the graph was locked", "use it for trials only, or lock it again after testing";
    PUBLIC = Note, "Other machines can reach this one: NODES",
        "the graph serves pictures or takes messages beyond this machine", "be sure that only the intended machines share the network";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_urgent_come_first_and_each_says_what_to_do() {
        assert!(ALL.is_sorted_by_key(|alarm| std::cmp::Reverse(alarm.urgency)));
        for alarm in ALL {
            assert!(!alarm.cause.is_empty() && !alarm.action.is_empty(), "{alarm:?}");
        }
    }

    #[test]
    fn the_readme_has_the_same_table() {
        let readme =
            std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../README.md")).expect("it is there");
        let row = |alarm: &Alarm| {
            let urgency = format!("{:?}", alarm.urgency).to_lowercase();
            format!("| {urgency} | {} | {} | {} |", alarm.text, alarm.cause, alarm.action)
        };
        let missing: Vec<String> = ALL.iter().map(row).filter(|row| !readme.contains(row)).collect();
        assert!(missing.is_empty(), "the README lacks:\n{}", missing.join("\n"));
        let rows = readme.lines().filter(|line| line.starts_with("| alarm |") || line.starts_with("| warning |"));
        let notes = readme.lines().filter(|line| line.starts_with("| note |"));
        assert_eq!(rows.count() + notes.count(), ALL.len());
    }
}
