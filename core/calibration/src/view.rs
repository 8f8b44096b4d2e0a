//! What became of one view of a calibration.

/// What became of a pair of views; its number stands in the column `state` of `calibrate_stereo`'s table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewState {
    /// It takes part.
    Used,
    /// The left view shows no board.
    NoBoardLeft,
    /// The right view shows no board.
    NoBoardRight,
    /// Neither view shows a board.
    NoBoard,
    /// The views share too few points of the board.
    FewPoints,
    /// The board stands where another view has it already.
    Alike,
    /// Its points lie too far from where the solution puts them.
    LargeError,
    /// Its size differs from that of the views before.
    OtherSize,
    /// Enough views are there.
    NotNeeded,
}

impl ViewState {
    const ALL: [Self; 9] = [
        Self::Used,
        Self::NoBoardLeft,
        Self::NoBoardRight,
        Self::NoBoard,
        Self::FewPoints,
        Self::Alike,
        Self::LargeError,
        Self::OtherSize,
        Self::NotNeeded,
    ];

    /// The number in tables.
    pub fn code(self) -> f64 {
        Self::ALL.iter().position(|state| *state == self).unwrap_or(0) as f64
    }

    /// The state of a number in a table.
    pub fn of_code(code: f64) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.code() == code)
    }

    /// As a reason in a report.
    pub fn words(self) -> &'static str {
        match self {
            Self::Used => "used",
            Self::NoBoardLeft => "no board was found in the left view",
            Self::NoBoardRight => "no board was found in the right view",
            Self::NoBoard => "no board was found in either view",
            Self::FewPoints => "the views share too few points of the board",
            Self::Alike => "the board stands as in a view before",
            Self::LargeError => "its reprojection error stands out: blurred, mislabelled or not of one instant",
            Self::OtherSize => "its size differs from that of the views before",
            Self::NotNeeded => "enough views were there",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::ViewState;

    #[test]
    fn codes_lead_back() {
        for state in ViewState::ALL {
            assert_eq!(ViewState::of_code(state.code()), Some(state));
            assert!(!state.words().is_empty());
        }
        assert_eq!(ViewState::of_code(99.0), None);
    }
}
