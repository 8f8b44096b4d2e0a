//! Whether a view of the board was used for a calibration.

/// Whether a pair of views was used and if not, why. The column `state` of the table of `calibrate_stereo` holds its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewState {
    /// The pair is used.
    Used,
    /// The left view shows no board.
    NoBoardLeft,
    /// The right view shows no board.
    NoBoardRight,
    /// Neither view shows a board.
    NoBoard,
    /// The views share too few points of the board.
    FewPoints,
    /// Another view already shows the board in this position.
    Alike,
    /// Its reprojection error is too large.
    LargeError,
    /// Its size differs from that of the views before.
    OtherSize,
    /// Enough views have been collected.
    NotNeeded,
    /// A part of a chessboard is seen, and it is not known which.
    PartlySeen,
}

impl ViewState {
    const ALL: [Self; 10] = [
        Self::Used,
        Self::NoBoardLeft,
        Self::NoBoardRight,
        Self::NoBoard,
        Self::FewPoints,
        Self::Alike,
        Self::LargeError,
        Self::OtherSize,
        Self::NotNeeded,
        Self::PartlySeen,
    ];

    /// Its number in tables.
    pub fn code(self) -> f64 {
        Self::ALL.iter().position(|state| *state == self).unwrap_or(0) as f64
    }

    /// The state that a number in a table stands for.
    pub fn of_code(code: f64) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.code() == code)
    }

    /// The reason as a report words it.
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
            Self::PartlySeen => "a part of the board is seen, and other views do not say which",
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
