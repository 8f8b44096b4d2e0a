//! A warning when views stay unregistered.

use super::RegistrationState;
use crate::Report;

/// Lost frames in a row before the warning: about a second.
const LOST_FRAMES: u32 = 30;

/// Warns once when many frames in a row have no registration, and reports once when they have one again.
#[derive(Clone, Copy, Debug, Default)]
pub struct RegistrationMonitor {
    has_warned: bool,
    lost_frames: u32,
}

impl RegistrationMonitor {
    /// Takes the state of one frame. `help` closes the warning: what the user can do.
    pub fn observe(&mut self, report: &dyn Report, state: RegistrationState, help: &str) {
        match state {
            RegistrationState::Lost => self.lost_frames = self.lost_frames.saturating_add(1),
            RegistrationState::Held => {}
            RegistrationState::Fresh => {
                if self.has_warned {
                    report.info(&format!("the views are registered again after {} frames", self.lost_frames));
                }
                *self = Self::default();
            }
        }
        report.metric("lost_in_a_row", f64::from(self.lost_frames));
        if self.lost_frames >= LOST_FRAMES && !self.has_warned {
            self.has_warned = true;
            report.warn(&format!(
                "the views have not been registered for {LOST_FRAMES} frames: the panorama shows the last good geometry, or one view. They may \
                 share too little (the scope is too near), or show too few details: {help}"
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    #[derive(Default)]
    struct Heard(RefCell<Vec<String>>);

    impl Report for Heard {
        fn warn(&self, message: &str) {
            self.0.borrow_mut().push(format!("warning: {message}"));
        }
        fn info(&self, message: &str) {
            self.0.borrow_mut().push(message.to_owned());
        }
        fn metric(&self, _: &str, _: f64) {}
    }

    #[test]
    fn one_warning_and_one_end_of_it() {
        let (heard, mut watch) = (Heard::default(), RegistrationMonitor::default());
        let mut look = |state, times: u32| (0..times).for_each(|_| watch.observe(&heard, state, "move back"));
        look(RegistrationState::Lost, LOST_FRAMES - 1);
        look(RegistrationState::Fresh, 1);
        look(RegistrationState::Lost, LOST_FRAMES - 1);
        assert!(heard.0.borrow().is_empty(), "a second is not over");
        look(RegistrationState::Lost, 40);
        look(RegistrationState::Held, 1);
        look(RegistrationState::Fresh, 2);
        let heard = heard.0.borrow();
        assert_eq!(heard.len(), 2, "{heard:?}");
        assert!(heard[0].starts_with("warning: ") && heard[0].ends_with("move back"), "{heard:?}");
        assert!(heard[1].contains(&format!("after {} frames", LOST_FRAMES + 39)), "{heard:?}");
    }
}
