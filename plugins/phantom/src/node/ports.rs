//! Ports of `phantom`.

use panoscope_node::{
    Bgr8, Depth, Disparity, LabeledDetections, LabeledInstances, Mask, Ports, Slot, TableData, Value, abi,
};

/// Inputs of the phantom.
#[derive(Ports)]
pub struct In<'f> {
    /// Pose of the left camera in the scene. Unconnected: the scripted motion.
    pub camera_pose: Option<Value<'f, abi::Pose>>,
}

/// Outputs of the phantom.
#[derive(Ports)]
pub struct Out<'f> {
    /// Left view (camera 0).
    pub left: Slot<'f, Bgr8>,
    /// Right view (camera 1).
    pub right: Slot<'f, Bgr8>,
    /// Camera 0, upper left of the quad layout; the same buffer as `left`.
    pub view0: Slot<'f, Bgr8>,
    /// Camera 1, upper right of the quad layout; the same buffer as `right`.
    pub view1: Slot<'f, Bgr8>,
    /// Camera 2, lower left of the quad layout.
    pub view2: Slot<'f, Bgr8>,
    /// Camera 3, lower right of the quad layout.
    pub view3: Slot<'f, Bgr8>,
    /// True calibration of cameras 0 and 1.
    pub calibration: Slot<'f, abi::Calibration>,
    /// True disparity of the left view, px.
    pub disparity: Slot<'f, Disparity>,
    /// True depth of the left view, mm.
    pub depth: Slot<'f, Depth>,
    /// 255 where the right camera sees the same point as the left one.
    pub visible: Slot<'f, Mask>,
    /// True pose of the left camera in the scene.
    pub pose: Slot<'f, abi::Pose>,
    /// Plane homography that best fits the true correspondences.
    pub homography: Slot<'f, abi::Homography>,
    /// Image of one ideal camera with a larger sensor at the left camera's position.
    pub wide: Slot<'f, Bgr8>,
    /// 255 in each pixel of `wide` whose tissue is inside the image of at least one camera.
    pub footprint: Slot<'f, Mask>,
    /// True boxes of the instruments visible in the left view.
    pub detections: Slot<'f, LabeledDetections>,
    /// True boxes and masks of the instruments visible in the left view.
    pub instances: Slot<'f, LabeledInstances>,
    /// True tip of the largest instrument with a visible tip; empty if there is none.
    pub tip: Slot<'f, abi::Tip>,
    /// True tip of the first instrument, whether visible or not. Score 1: visible; 0: hidden or outside the left view. Empty behind the camera and
    /// without instruments.
    pub lead: Slot<'f, abi::Tip>,
    /// True tip of the second instrument, as `lead`.
    pub second: Slot<'f, abi::Tip>,
    /// One row per instrument: position of its tip (mm), whether it is visible, and its distances to the tissue and to the nearest other tip (mm).
    pub clearance: Slot<'f, TableData>,
}
