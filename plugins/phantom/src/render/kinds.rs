//! The kinds of scenes, boards and instruments, by their names.

/// Kind of scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneKind {
    /// Smooth lobes, thin surface vessels, some fat, a membrane.
    Liver,
    /// Loops of bowel with branching vessels and fat between them.
    Bowel,
    /// A deep pocket between folds, 20 mm to more than 70 mm away.
    Cavity,
    /// A phantom box: printed rulers, crosses of known spacing, blocks of known height.
    Box,
    /// A flat calibration board; a moving camera sees it in another pose in each frame.
    Board,
}

impl SceneKind {
    /// All scenes, in the order of their declaration.
    pub const ALL: [Self; 5] = [Self::Liver, Self::Bowel, Self::Cavity, Self::Box, Self::Board];

    /// Name in a graph file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Liver => "liver",
            Self::Bowel => "bowel",
            Self::Cavity => "cavity",
            Self::Box => "box",
            Self::Board => "board",
        }
    }
}

/// Pattern printed on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardPrint {
    /// 10 x 7 squares of 3 mm: `chessboard:9x6:3mm`.
    Chessboard,
    /// OpenCV's asymmetric grid of 4 x 11 circles: `circles:4x11:3mm`.
    Circles,
    /// 10 x 7 squares of 3 mm with markers of 2.25 mm: `charuco:10x7:3mm:2.25mm:4x4_50`.
    Charuco,
}

impl BoardPrint {
    /// Name of the board for `calibrate_stereo`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Chessboard => "chessboard:9x6:3mm",
            Self::Circles => "circles:4x11:3mm",
            Self::Charuco => "charuco:10x7:3mm:2.25mm:4x4_50",
        }
    }
}

/// The instruments of the m2cai16-tool-locations data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolKind {
    /// Two blunt jaws.
    Grasper,
    /// Two slim jaws on a blue joint.
    Bipolar,
    /// A thin wire bent to an L shape.
    Hook,
    /// Two flat blades.
    Scissors,
    /// A thick shaft with two angled jaws.
    Clipper,
    /// A plain steel tube.
    Irrigator,
    /// A soft bag on a rod.
    SpecimenBag,
}

impl ToolKind {
    /// All kinds, in the order of their declaration.
    pub const ALL: [Self; 7] =
        [Self::Grasper, Self::Bipolar, Self::Hook, Self::Scissors, Self::Clipper, Self::Irrigator, Self::SpecimenBag];

    /// Name in a label table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Grasper => "grasper",
            Self::Bipolar => "bipolar",
            Self::Hook => "hook",
            Self::Scissors => "scissors",
            Self::Clipper => "clipper",
            Self::Irrigator => "irrigator",
            Self::SpecimenBag => "specimen_bag",
        }
    }
}
