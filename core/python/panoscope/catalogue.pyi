# Written by `panoscope schema --python`: the node types of the plugins of one machine.

from typing import Any, Literal, Union

from typing_extensions import Unpack

from .building import Arg, File, Flag, Input, Inputs, Node, NodeOptions, Number, Numbers, Output, Text, Whole

class ArmPid(Node):
    joints: Output[Literal["joints"]]
    """Requested joint velocities (rad/s), with the present joint angles (rad). Empty without a tip."""
    table: Output[Literal["table"]]
    """One row per tick with a tip: errors in px, mm and percent, speed of the tip (mm/s), largest requested velocity (rad/s), distance from a singular pose, share of the limits used, score."""

class ArmSerial(Node):
    joints: Output[Literal["joints"]]
    """Joint angles (rad) and velocities (rad/s) as the encoders read them."""
    setpoint: Output[Literal["joints"]]
    """Newest set-points (rad, rad/s), after the interlock."""
    camera_pose: Output[Literal["pose"]]
    """Pose of the left camera in the frame `scene`, which is the camera's pose at joint angles of 0; mm. The true pose for `arm_sim`, by the encoders for a real arm."""
    links: Output[Literal["table"]]
    """Positions of the joints in the frame `scene`, mm: one row per joint, from the base to the camera."""
    table: Output[Literal["table"]]
    """One row per tick: whether the arm follows, number of the stop's cause (0 for none), stops so far, largest joint speed, distance of the tube from the trocar, its depth, age of the arm's last answer."""
    text: Output[Literal["text"]]
    """State of the arm as text."""

class ArmSim(Node):
    joints: Output[Literal["joints"]]
    """Joint angles (rad) and velocities (rad/s) as the encoders read them."""
    setpoint: Output[Literal["joints"]]
    """Newest set-points (rad, rad/s), after the interlock."""
    camera_pose: Output[Literal["pose"]]
    """Pose of the left camera in the frame `scene`, which is the camera's pose at joint angles of 0; mm. The true pose for `arm_sim`, by the encoders for a real arm."""
    links: Output[Literal["table"]]
    """Positions of the joints in the frame `scene`, mm: one row per joint, from the base to the camera."""
    table: Output[Literal["table"]]
    """One row per tick: whether the arm follows, number of the stop's cause (0 for none), stops so far, largest joint speed, speed and acceleration of the camera, distance of the tube from the trocar, its depth and its tilt."""
    text: Output[Literal["text"]]
    """State of the arm as text."""

class ArmUr(Node):
    joints: Output[Literal["joints"]]
    """Joint angles (rad) and velocities (rad/s) as the encoders read them."""
    setpoint: Output[Literal["joints"]]
    """Newest set-points (rad, rad/s), after the interlock."""
    camera_pose: Output[Literal["pose"]]
    """Pose of the left camera in the frame `scene`, which is the camera's pose at joint angles of 0; mm. The true pose for `arm_sim`, by the encoders for a real arm."""
    links: Output[Literal["table"]]
    """Positions of the joints in the frame `scene`, mm: one row per joint, from the base to the camera."""
    table: Output[Literal["table"]]
    """One row per tick: whether the arm follows, number of the stop's cause (0 for none), stops so far, largest joint speed, distance of the tube from the trocar, its depth, age of the arm's last answer."""
    text: Output[Literal["text"]]
    """State of the arm as text."""

class CalibrateStereo(Node):
    calibration: Output[Literal["calibration"]]
    """Calibration with rectification, in each tick in which it was solved."""
    table: Output[Literal["table"]]
    """One row per view: its number from 0, its state (0 used, otherwise the reason), number of points, errors in px, and the share of each picture that the board fills."""
    image: Output[Literal["image"]]
    """Both views side by side with the detected points."""
    coverage: Output[Literal["image"]]
    """Coverage of each view by points, in each tick in which the calibration was solved."""
    epipolar: Output[Literal["image"]]
    """The rectified pair with the largest board, with lines along the rows, in each tick in which the calibration was solved."""

class Capture(Node):
    left: Output[Literal["image"]]
    """Left view: view 0."""
    right: Output[Literal["image"]]
    """Right view: view 1."""
    view0: Output[Literal["image"]]
    """View 0."""
    view1: Output[Literal["image"]]
    """View 1."""
    view2: Output[Literal["image"]]
    """View 2."""
    view3: Output[Literal["image"]]
    """View 3."""
    calibration: Output[Literal["calibration"]]
    """Calibration of views 0 and 1, if a file is given."""

class Colorize(Node):
    image: Output[Literal["image"]]
    """The coloured map. Unknown pixels are dark gray; numbers below the range are black, those above it white (in `gray`: blue and red)."""

class Composite(Node):
    panorama: Output[Literal["image"]]
    """The panorama; black outside all views."""
    mask: Output[Literal["mask"]]
    """255 inside the views, 0 elsewhere."""
    canvas: Output[Literal["roi"]]
    """Rectangle of the first view in the panorama, px."""
    shown: Output[Literal["image"]]
    """View that each pixel shows: 0 none, 1 the first, 2 the second and so on."""
    gain: Output[Literal["scalar"]]
    """Area of the panorama beyond that of the first view, percent. In a cropped panorama only illuminated pixels count."""
    gain_text: Output[Literal["text"]]
    """The same as text: `+12 % over one view`. It changes rarely."""

class CompositeMesh(Node):
    panorama: Output[Literal["image"]]
    """The panorama; black outside both views."""
    mask: Output[Literal["mask"]]
    """255 inside the views, 0 elsewhere."""
    canvas: Output[Literal["roi"]]
    """Rectangle of the left view in the panorama, px."""
    shown: Output[Literal["image"]]
    """View that each pixel shows: 0 none, 1 the left, 2 the right one."""
    mesh: Output[Literal["table"]]
    """Vertices of the mesh: which pixel of the right view, and of the left one, each point of the panorama shows. Empty before the first mesh. With `views`, those of all further views one after the other, each after the number of the view; the first view is then not bent."""
    gain: Output[Literal["scalar"]]
    """Area of the panorama beyond that of the first view, percent. In a cropped panorama only illuminated pixels count."""
    gain_text: Output[Literal["text"]]
    """The same as text: `+12 % over one view`. It changes rarely."""

class CompositeOpencv(Node):
    panorama: Output[Literal["image"]]
    """The panorama; black outside all views."""
    mask: Output[Literal["mask"]]
    """255 inside the views, 0 elsewhere."""
    canvas: Output[Literal["roi"]]
    """Rectangle of the left view in the panorama, px."""
    shown: Output[Literal["image"]]
    """View that each pixel shows: 0 none, 1 left, 2 right."""

class CutViews(Node):
    left: Output[Literal["image"]]
    """Left part of the image, with noise."""
    right: Output[Literal["image"]]
    """Right part with another perspective, exposure and tint, with noise."""
    homography: Output[Literal["homography"]]
    """True homography: maps right-view pixels to left-view pixels."""
    left_in_image: Output[Literal["roi"]]
    """Rectangle of the left view in the image, px."""

class DataSet(Node):
    left: Output[Literal["image"]]
    """Left view, or the only one."""
    right: Output[Literal["image"]]
    """Right view."""
    calibration: Output[Literal["calibration"]]
    """Calibration of both views, with the rectification that the ground truth refers to."""
    disparity: Output[Literal["disparity"]]
    """True disparity of the left rectified view, px; NaN where unknown."""
    depth: Output[Literal["depth"]]
    """True depth of the left rectified view, mm; NaN where unknown."""
    detections: Output[Literal["detections"]]
    """True boxes in the left view as stored, not rectified."""
    instances: Output[Literal["instances"]]
    """True boxes and masks in the left view as stored, if the data set has masks."""
    tip: Output[Literal["tip"]]
    """Always empty, because none of these data sets has tips. It exists so that graphs for the phantom's ground truth run unchanged."""

class DisparityFbs(Node):
    disparity: Output[Literal["disparity"]]
    """The smoothed map, px; NaN where too few trusted pixels are near."""
    confidence: Output[Literal["confidence"]]
    """Confidence of each pixel, 0 to 1."""

class DisparityFbsOpencv(Node):
    disparity: Output[Literal["disparity"]]
    """The smoothed map, px."""

class DisparityWls(Node):
    disparity: Output[Literal["disparity"]]
    """The smoothed map, px; NaN where too few trusted pixels are near."""
    confidence: Output[Literal["confidence"]]
    """Confidence of each pixel, 0 to 1."""

class DisparityWlsOpencv(Node):
    disparity: Output[Literal["disparity"]]
    """The smoothed map, px."""
    confidence: Output[Literal["confidence"]]
    """Confidence, 0 to 1; empty for `disparity_fbs_opencv`."""

class EvaluateArm(Node):
    table: Output[Literal["table"]]
    """One row per tick; errors are NaN while the tip is not known. `in_view`: the tip is inside the left image. `seen`: nothing hides it there. `gap_ms`: time since the tracker saw the tip. `track_off_mm`: error of the tracker's position. Both are NaN while the tracker has no tip."""

class EvaluateCloud(Node):
    median_mm: Output[Literal["scalar"]]
    """Median distance of the points from the nearest point of the true surface; distances beyond `reach_mm` count as `reach_mm`."""
    mean_mm: Output[Literal["scalar"]]
    """Mean distance."""
    p95_mm: Output[Literal["scalar"]]
    """Distance that 95 % of the points stay below."""
    coverage_pct: Output[Literal["scalar"]]
    """Percent of the true surface with a point nearer than `reach_mm`."""
    table: Output[Literal["table"]]
    """One row: the numbers above, and the number of points that were compared."""

class EvaluateDepth(Node):
    median_mm: Output[Literal["scalar"]]
    """Median absolute error of the pixels that have a depth."""
    mean_mm: Output[Literal["scalar"]]
    """Mean absolute error of the pixels that have a depth."""
    p95_mm: Output[Literal["scalar"]]
    """Absolute error that 95 % of the pixels with a depth stay below."""
    coverage_pct: Output[Literal["scalar"]]
    """Percent of pixels that have a depth."""
    table: Output[Literal["table"]]
    """One row: the numbers above, and the number of pixels that count."""

class EvaluateDetections(Node):
    precision_pct: Output[Literal["scalar"]]
    """Percentage of the detections of at least `min_score` that match an object of their class with an overlap of 0.5."""
    recall_pct: Output[Literal["scalar"]]
    """Percentage of the objects that are matched by such a detection."""
    ap50_pct: Output[Literal["scalar"]]
    """COCO's average precision at an overlap of 0.5, over all scores, mean of the classes that have objects."""
    table: Output[Literal["table"]]
    """A row for each class in the order of `truth`'s labels, further classes after them: `class`, `objects`, `detections` of at least `min_score`, `hits`, and the three numbers above."""

class EvaluateDisparity(Node):
    bad1_pct: Output[Literal["scalar"]]
    """Percent of pixels with an error above 1 px; a pixel without disparity counts as bad."""
    bad2_pct: Output[Literal["scalar"]]
    """The same above 2 px."""
    bad3_pct: Output[Literal["scalar"]]
    """The same above 3 px."""
    mean_px: Output[Literal["scalar"]]
    """Mean absolute error of the pixels that have a disparity."""
    p95_px: Output[Literal["scalar"]]
    """Absolute error that 95 % of the pixels with a disparity stay below."""
    coverage_pct: Output[Literal["scalar"]]
    """Percent of pixels that have a disparity."""
    table: Output[Literal["table"]]
    """One row: the numbers above, `rms_px`, and the number of pixels that count."""

class EvaluateMosaic(Node):
    table: Output[Literal["table"]]
    """A row for every tick so far; NaN where the frame has no position. `state`: 0 fresh, 2 lost, 3 none. `drift_px`: root mean square distance, over the frame, between where the mosaic puts its points and where the camera of the first frame would see them; `drift_mm`: the same on the tissue; `drift_pct`: the same as a percentage of the camera's path so far. `floor_px`: residual of the best homography, 0 for a plane. `start_mm`: distance of the camera from its first position."""

class EvaluateProximity(Node):
    table: Output[Literal["table"]]
    """Counts since the start, for all tips together. The first row applies the thresholds exactly, the second one tolerates `margin_mm` around them. Columns for warnings of tissue, then of other tips."""

class EvaluateStitch(Node):
    table: Output[Literal["table"]]
    """A row for every tick so far; NaN where there is no ground truth. `state`: 0 fresh, 1 held, 2 lost, 3 none. Areas relative to that of the left view: `fov_pct` is covered by the panorama, `fov_truth_pct` by the footprint of all cameras, `fov_right_pct` by both."""

class EveryNth(Node):
    image: Output[Literal["image"]]
    """The same buffer as the input: nothing is copied."""

class FeaturesOpencv(Node):
    left_points: Output[Literal["table"]]
    """Keypoints of the left view, strongest first."""
    right_points: Output[Literal["table"]]
    """Keypoints of the right view."""
    matches: Output[Literal["table"]]
    """Matches: row numbers in both tables."""

class FeaturesSurf(Node):
    left_points: Output[Literal["table"]]
    """Keypoints of the left view, strongest first."""
    right_points: Output[Literal["table"]]
    """Keypoints of the right view."""
    matches: Output[Literal["table"]]
    """Matches: row numbers in both tables."""

class FindBoard(Node):
    table: Output[Literal["table"]]
    """One row per point that was found: its number on the board, its position on the board in mm, and in the picture in px."""

class Frames(Node):
    image: Output[Literal["image"]]
    """The test frame."""

class Gate(Node):
    image: Output[Literal["image"]]
    """The same buffer as the input: nothing is copied."""

class IgtlReceive(Node):
    image: Output[Literal["image"]]
    """IMAGE of one slice. 8 bits with one component are gray8, with three bgr8, with four rgba8; 16 bits are gray16; other numbers of one component f32. A partial image is merged into the previous one."""
    pose: Output[Literal["pose"]]
    """TRANSFORM that is a rotation and a translation, POSITION with an orientation, or the first tool of TDATA."""
    points: Output[Literal["table"]]
    """POINT, POSITION, the tools of TDATA, or the translation of TRANSFORM: a row per point with position and radius in mm."""
    names: Output[Literal["text"]]
    """Names of the rows of `points`, one per line: those of the points or tools, or the device name."""
    cloud: Output[Literal["cloud"]]
    """POLYDATA: its points, in one row, with their colours if it has any."""
    text: Output[Literal["text"]]
    """STRING, and the text of STATUS."""
    status: Output[Literal["scalar"]]
    """Code of STATUS; 1 is OK."""

class Level(Node):
    level: Output[Literal["scalar"]]
    """Mean of the window, times the gain."""
    levels: Output[Literal["table"]]
    """Mean, smallest and largest value of the window, and the mean of the spots, each times the gain; NaN without window and spots."""

class MaskRcnn(Node):
    instances: Output[Literal["instances"]]
    """Boxes and masks in px of the image, highest score first, with their labels."""
    unlikeness: Output[Literal["scalar"]]
    """How unlike the model's training images the last images are, smoothed, as a share of the model's limit. From 1 on the model is unreliable for such images. Empty if the model has no image statistics. Metric `unlike` is 1 while it is above."""
    text: Output[Literal["text"]]
    """Message for a screen while the images are too unlike the training images; otherwise empty text."""

class Measure(Node):
    table: Output[Literal["table"]]
    """One row per item: its points, its value and the 95 % error bound; NaN where unknown."""
    text: Output[Literal["text"]]
    """Why nothing is measured; empty while there is no reason."""

class Mosaic(Node):
    mosaic: Output[Literal["image"]]
    """The mosaic; black where nothing has been seen. The dark rim of a scope's frames is not shown."""
    homography: Output[Literal["homography"]]
    """Maps pixels of this frame to those of the first keyframe. State: fresh, or lost (with the last good map)."""
    view: Output[Literal["homography"]]
    """Maps pixels of the first keyframe to those of `mosaic`."""
    table: Output[Literal["table"]]
    """One row per tick. `state`: 0 fresh, 2 lost. `coverage_pct`: area of the keyframes in percent of one frame. `drift_px`, `drift_pct`: error of the last closed loop before it was distributed, in px and as a percentage of the loop's length; NaN before the first one. `spread_px`: distance of the keyframes' shared points after the last adjustment."""
    text: Output[Literal["text"]]
    """The main figures as text, one line each."""

class Onnx(Node):
    disparity: Output[Literal["disparity"]]
    """Disparity, px of the image, positive, NaN = unknown."""
    depth: Output[Literal["depth"]]
    """Depth, mm, NaN = unknown."""
    mask: Output[Literal["mask"]]
    """Mask: 255 inside."""
    confidence: Output[Literal["confidence"]]
    """Confidence, 0 to 1."""
    detections: Output[Literal["detections"]]
    """Boxes in px of the image, highest score first, with their labels."""
    flow_x: Output[Literal["image"]]
    """Motion to the right, px of the image."""
    flow_y: Output[Literal["image"]]
    """Motion downwards, px of the image."""
    image: Output[Literal["image"]]
    """Image that the network outputs: bgr8 if it has three channels, gray8 if it has one."""

class Overlay(Node):
    image: Output[Literal["image"]]
    """The image with everything drawn on it. The input's own buffer when there is nothing to draw."""

class Pass(Node):
    image: Output[Literal["image"]]
    """The same buffer as the input: nothing is copied."""

class PassBlocking(Node):
    image: Output[Literal["image"]]
    """The same buffer as the input: nothing is copied."""

class Phantom(Node):
    left: Output[Literal["image"]]
    """Left view (camera 0)."""
    right: Output[Literal["image"]]
    """Right view (camera 1)."""
    view0: Output[Literal["image"]]
    """Camera 0, upper left of the quad layout; the same buffer as `left`."""
    view1: Output[Literal["image"]]
    """Camera 1, upper right of the quad layout; the same buffer as `right`."""
    view2: Output[Literal["image"]]
    """Camera 2, lower left of the quad layout."""
    view3: Output[Literal["image"]]
    """Camera 3, lower right of the quad layout."""
    calibration: Output[Literal["calibration"]]
    """True calibration of cameras 0 and 1."""
    disparity: Output[Literal["disparity"]]
    """True disparity of the left view, px."""
    depth: Output[Literal["depth"]]
    """True depth of the left view, mm."""
    visible: Output[Literal["mask"]]
    """255 where the right camera sees the same point as the left one."""
    pose: Output[Literal["pose"]]
    """True pose of the left camera in the scene."""
    homography: Output[Literal["homography"]]
    """Plane homography that best fits the true correspondences."""
    wide: Output[Literal["image"]]
    """Image of one ideal camera with a larger sensor at the left camera's position."""
    footprint: Output[Literal["mask"]]
    """255 in each pixel of `wide` whose tissue is inside the image of at least one camera."""
    detections: Output[Literal["detections"]]
    """True boxes of the instruments visible in the left view."""
    instances: Output[Literal["instances"]]
    """True boxes and masks of the instruments visible in the left view."""
    tip: Output[Literal["tip"]]
    """True tip of the largest instrument with a visible tip; empty if there is none."""
    lead: Output[Literal["tip"]]
    """True tip of the first instrument, whether visible or not. Score 1: visible; 0: hidden or outside the left view. Empty behind the camera and without instruments."""
    second: Output[Literal["tip"]]
    """True tip of the second instrument, as `lead`."""
    clearance: Output[Literal["table"]]
    """One row per instrument: position of its tip (mm), whether it is visible, and its distances to the tissue and to the nearest other tip (mm)."""

class Proximity(Node):
    table: Output[Literal["table"]]
    """One row per tip: number and class; pixel and position (mm); distance to the tissue (mm) and pixel of the nearest point; whether that point is visible or hidden behind an instrument; state: -1 unknown, 0 clear, 1 near, 2 contact; distance to the nearest other tip (mm), its number, and the state: 0 clear, 1 near; age of the surface (ms). `overlay` draws it."""
    text: Output[Literal["text"]]
    """The warnings, one per line; empty when there is none."""

class ReadLabels(Node):
    detections: Output[Literal["detections"]]
    """The true boxes, with score 1, or 0 for objects that are marked as difficult."""

class ReadMaps(Node):
    disparity: Output[Literal["disparity"]]
    """Disparity of the image, if `holds` is `disparity`; NaN where the file has 0, a negative number or none."""
    depth: Output[Literal["depth"]]
    """Depth of the image, if `holds` is `depth`; NaN where the file has 0, a negative number or none."""

class Rectify(Node):
    left: Output[Literal["image"]]
    """Rectified left view; black outside the camera's picture."""
    right: Output[Literal["image"]]
    """Rectified right view."""
    calibration: Output[Literal["calibration"]]
    """Calibration of the rectified views. Empty while one of them is late, which spoils what is measured."""
    mask_left: Output[Literal["mask"]]
    """255 where the left view shows something: inside the scope's rim and inside what its camera covers. Empty while that is all of it."""
    mask_right: Output[Literal["mask"]]
    """The same of the right view."""

class RegisterGrid(Node):
    homography: Output[Literal["homography"]]
    """Maps right-view pixels to left-view pixels, with its state: fresh, held or lost."""
    roi_left: Output[Literal["roi"]]
    """Part of the left view that the right view also shows."""
    roi_right: Output[Literal["roi"]]
    """Part of the right view that the left view also shows."""

class RegisterOpencv(Node):
    homography: Output[Literal["homography"]]
    """Maps right-view pixels to left-view pixels; fresh or lost."""

class RegisterSurf(Node):
    homography: Output[Literal["homography"]]
    """Maps right-view pixels to left-view pixels, with its state: fresh, held or lost."""
    roi_left: Output[Literal["roi"]]
    """Part of the left view that the right view also shows."""
    roi_right: Output[Literal["roi"]]
    """Part of the right view that the left view also shows."""

class Reproject(Node):
    cloud: Output[Literal["cloud"]]
    """One point per pixel in the left rectified camera's frame; NaN where unknown. Points of small holes are filled in and marked so."""
    depth: Output[Literal["depth"]]
    """Depth along the left rectified camera's axis; NaN where unknown."""

class Ros2Bag(Node):
    left: Output[Literal["image"]]
    """Left view, or the only one."""
    right: Output[Literal["image"]]
    """Right view of the same instant."""
    calibration: Output[Literal["calibration"]]
    """Both cameras, with every image, once both camera_info topics had a message."""
    depth: Output[Literal["depth"]]
    """Depth of the left rectified view, mm; NaN where unknown."""
    disparity: Output[Literal["disparity"]]
    """Disparity of the left rectified view, px; NaN where unknown."""
    cloud: Output[Literal["cloud"]]
    """Points, mm, in the frame of the message."""
    detections: Output[Literal["detections"]]
    """Detected boxes."""
    pose: Output[Literal["pose"]]
    """A pose, mm."""
    joints: Output[Literal["joints"]]
    """Joints of an arm."""

class Ros2Subscribe(Node):
    left: Output[Literal["image"]]
    """Left view, or the only one."""
    right: Output[Literal["image"]]
    """Right view of the same instant."""
    calibration: Output[Literal["calibration"]]
    """Both cameras, with every image, once both camera_info topics had a message."""
    depth: Output[Literal["depth"]]
    """Depth of the left rectified view, mm; NaN where unknown."""
    disparity: Output[Literal["disparity"]]
    """Disparity of the left rectified view, px; NaN where unknown."""
    cloud: Output[Literal["cloud"]]
    """Points, mm, in the frame of the message."""
    detections: Output[Literal["detections"]]
    """Detected boxes."""
    pose: Output[Literal["pose"]]
    """A pose, mm."""
    joints: Output[Literal["joints"]]
    """Joints of an arm."""

class Screen(Node):
    image: Output[Literal["image"]]
    """The complete screen, always of the same size."""

class SideBySide(Node):
    image: Output[Literal["image"]]
    """All images in a grid."""

class Skill(Node):
    table: Output[Literal["table"]]
    """One row per tool and phase: number and class of the tool, number of the phase (-1: all phases), then all measures since the start. Times count from the tool's first frame."""
    pairs: Output[Literal["table"]]
    """One row per pair of tools: their numbers, time with both in view, time with both moving, share of the movement made together, correlation of their speeds."""
    text: Output[Literal["text"]]
    """The main measures as text, one line per tool."""

class Smooth(Node):
    image: Output[Literal["image"]]
    """Weighted mean of `image` and `past`."""

class StereoBm(Node):
    disparity: Output[Literal["disparity"]]
    """Disparity of the left rectified view, px, positive; NaN where unmatched."""
    disparity_right: Output[Literal["disparity"]]
    """Disparity of the right rectified view, px: `x_left = x_right + disparity`; NaN where unmatched."""
    drifted: Output[Literal["scalar"]]
    """1 while matched points lie farther off their rows than `drift_px`: the calibration does not fit the views. Else 0."""

class StereoNet(Node):
    disparity: Output[Literal["disparity"]]
    """Disparity of the left view, px; NaN where unlit, and where the expected error exceeds `max_error_px`."""
    confidence: Output[Literal["confidence"]]
    """Confidence of each pixel, 0 to 1: what `measure` turns into the standard deviation that the network states."""
    error: Output[Literal["image"]]
    """Mean size of the error that the network expects at each pixel, px."""
    occluded: Output[Literal["mask"]]
    """255 where the right view does not show the point, by the network."""

class StereoOpencv(Node):
    disparity: Output[Literal["disparity"]]
    """Pixels of the left rectified view; NaN where unmatched."""
    disparity_right: Output[Literal["disparity"]]
    """The same for the right view's pixels, positive."""

class StereoSgbm(Node):
    disparity: Output[Literal["disparity"]]
    """Disparity of the left rectified view, px, positive; NaN where unmatched."""
    disparity_right: Output[Literal["disparity"]]
    """Disparity of the right rectified view, px: `x_left = x_right + disparity`; NaN where unmatched."""
    drifted: Output[Literal["scalar"]]
    """1 while matched points lie farther off their rows than `drift_px`: the calibration does not fit the views. Else 0."""

class TipTrack(Node):
    tip: Output[Literal["tip"]]
    """The leading tip in the left camera's frame, mm. The score of a predicted tip falls with the time since it was last seen. A tip of unknown class gets the class that its tool had most often. Empty when lost."""
    table: Output[Literal["table"]]
    """One row per tick while the tip is known: position in the camera's frame and in the scene (mm), velocity (mm/s), standard deviation (mm), time since it was seen (ms), score, number of the tool."""

class ToolTip(Node):
    tip: Output[Literal["tip"]]
    """Tip of the leading tool; between open jaws the middle of both ends. Where masks and depth show that another tool hides one of two jaws, the tip is computed from the other jaw and the shaft's axis, for 10 s after both were seen. Empty when no tool is found, or when another tool hides its complete end."""
    hidden: Output[Literal["tip"]]
    """Apparent end of the leading tool while another tool hides its complete end: px, without a position in space. Otherwise empty. `tip_track` keeps following a tool that is reported here."""

class Trajectory(Node):
    image: Output[Literal["image"]]
    """The image with the trajectory drawn on it."""
    text: Output[Literal["text"]]
    """Size of the box as text. If this is connected, the text is not drawn on the image."""

class Transpose(Node):
    image: Output[Literal["image"]]
    """The image, mirrored at its diagonal."""
    disparity: Output[Literal["disparity"]]
    """The map, mirrored at its diagonal; its values do not change."""

class Turntable(Node):
    image: Output[Literal["image"]]
    """The surface seen from the side, with a ruler while lengths are known."""

class Yolo(Node):
    detections: Output[Literal["detections"]]
    """Boxes in px of the image, highest score first, with their labels. If the model has a calibration, scores are probabilities, and the last label is `unknown`: an instrument of uncertain kind."""
    unlikeness: Output[Literal["scalar"]]
    """How unlike the model's training images the last images are, smoothed, as a share of the model's limit. From 1 on the model is unreliable for such images. Empty if the model has no image statistics. Metric `unlike` is 1 while it is above."""
    text: Output[Literal["text"]]
    """Message for a screen while the images are too unlike the training images; otherwise empty text."""
    tip0: Output[Literal["tip"]]
    """First keypoint of the box with the highest score, in px, without a position in space. Empty if the model outputs no keypoints or finds nothing."""
    tip1: Output[Literal["tip"]]
    """Second keypoint of that box."""
    tip2: Output[Literal["tip"]]
    """Third keypoint of that box."""
    tip3: Output[Literal["tip"]]
    """Fourth keypoint of that box."""
    keypoints: Output[Literal["table"]]
    """All keypoints of all boxes, one per row: index of its box in `detections`, index of the keypoint, position in px, score. Empty if the model outputs no keypoints. The shipped detector has one keypoint, the tip; connect it to `keypoints` of `tool_tip`."""

class NodeTypes:
    def arm_pid(
        self,
        tip: Input[Literal["tip"]] | None = None,
        joints: Input[Literal["joints"]] | None = None,
        setpoint: Input[Literal["joints"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        *,
        arm: File = ...,
        distance_mm: Number = ...,
        picture_p: Number = ...,
        picture_i: Number = ...,
        picture_d: Number = ...,
        distance_p: Number = ...,
        distance_i: Number = ...,
        distance_d: Number = ...,
        filter_s: Number = ...,
        feed_forward: Number = ...,
        dead_zone_px: Number = ...,
        dead_zone_mm: Number = ...,
        latency_s: Number = ...,
        tip_acceleration: Number = ...,
        min_score: Number = ...,
        focal_px: Number = ...,
        baseline_mm: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> ArmPid:
        """Requests joint velocities about the trocar that bring the tip to the centre of the shared image and to its distance.

        tip: The tip to follow, in the left rectified camera's frame, mm. Empty: no velocities are requested.
        joints: Joint angles when the image was taken: the driver's `joints`, wired with `delay = 1`.
        setpoint: Newest set-points of the driver, wired with `delay = 1`. With them the controller accounts for set-points that the arm has not reached yet.
        calibration: Calibration of the rectified views; without it `focal_px` and `baseline_mm` are used.
        arm: URDF file of the arm; empty takes the arm that comes with the plugin. The driver must use the same. (default "")
        distance_mm: Distance of the tip from the left camera. (30 to 120 mm; default 66)
        picture_p: Proportional gain of the tip's position in the image, 1/s. (0 to 20; default 6)
        picture_i: Integral gain of the tip's position in the image, 1/s^2. (0 to 10; default 0.2)
        picture_d: Derivative gain on the tip's measured position in the image. A new goal causes no kick, because the goal is not differentiated. (0 to 1; default 0.2)
        distance_p: Proportional gain of the distance, 1/s. (0 to 20; default 6)
        distance_i: Integral gain of the distance, 1/s^2. (0 to 10; default 0.2)
        distance_d: Derivative gain on the measured distance. (0 to 1; default 0.2)
        filter_s: Time constant of the low-pass filter of the derivatives. (0 to 1 s; default 0.08)
        feed_forward: Share of the tip's own velocity that is fed forward. (0 to 1 ratio; default 1)
        dead_zone_px: Dead zone of the error in the image, for 640 columns. (0 to 50 px; default 2)
        dead_zone_mm: Dead zone of the error of the distance. (0 to 10 mm; default 0.2)
        latency_s: Time from a set-point to the movement. (0 to 0.5 s; default 0.045)
        tip_acceleration: Standard deviation of the tip's unknown acceleration, mm/s^2. Higher values follow faster and are less smooth. (1 to 5000; default 80)
        min_score: Lowest score of a tip that is followed. (0 to 1 ratio; default 0.3)
        focal_px: Focal length when no calibration is connected. (10 to 20000 px; default 750)
        baseline_mm: Distance of the cameras when no calibration is connected. (1 to 100 mm; default 15)"""

    def arm_serial(
        self,
        joints: Input[Literal["joints"]] | None = None,
        tip: Input[Literal["tip"]] | None = None,
        *,
        port: Text = ...,
        baud: Whole = ...,
        answer_ms: Number = ...,
        arm: File = ...,
        enabled: Flag = ...,
        emergency_stop: Flag = ...,
        reset: Whole = ...,
        max_age_ms: Number = ...,
        min_score: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> ArmSerial:
        """A six-axis arm on a serial line. A separate process guards it and stops it whatever the program does.

        joints: Requested joint velocities, from `arm_pid`.
        tip: Tip that the arm follows, straight from `tip_track`. The arm moves only while fresh tips arrive.
        port: Device of the serial line, such as /dev/ttyUSB0. (default "/dev/ttyUSB0")
        baud: Bits per second. (9600 to 4000000; default 921600)
        answer_ms: Time limit for an answer of the arm. After it the arm is stopped. (10 to 250 ms; default 30)
        arm: URDF file of the arm; empty takes the arm that comes with the plugin. (default "")
        enabled: Lets the arm move after `reset` has released it. Off: requested velocities are ignored. (default False)
        emergency_stop: Stops the arm. It stays stopped when this is switched off again, until `reset` changes. (default False)
        reset: A change of this number releases a latched stop. The driver of a real arm then also opens a lost connection again. (0 to 1000000000; default 0)
        max_age_ms: Maximum age of a tip's light, by the host's clock. The arm stops when no younger tip has arrived. A predicted tip is as old as the image in which it was last seen. (10 to 300 ms; default 150)
        min_score: Lowest score of a tip that is followed. The score of a predicted tip falls with time. (0.01 to 1 ratio; default 0.3)"""

    def arm_sim(
        self,
        joints: Input[Literal["joints"]] | None = None,
        tip: Input[Literal["tip"]] | None = None,
        *,
        arm: File = ...,
        emergency_stop: Flag = ...,
        reset: Whole = ...,
        max_age_ms: Number = ...,
        min_score: Number = ...,
        latency_ms: Number = ...,
        lag_ms: Number = ...,
        backlash_deg: Number = ...,
        encoder_noise_deg: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> ArmSim:
        """A simulated six-axis arm behind the interlock, with latency, motor lag, gear backlash and encoder noise.

        joints: Requested joint velocities, from `arm_pid`.
        tip: Tip that the arm follows, straight from `tip_track`. The arm moves only while fresh tips arrive.
        arm: URDF file of the arm; empty takes the arm that comes with the plugin. (default "")
        emergency_stop: Stops the arm. It stays stopped when this is switched off again, until `reset` changes. (default False)
        reset: A change of this number releases a latched stop. The driver of a real arm then also opens a lost connection again. (0 to 1000000000; default 0)
        max_age_ms: Maximum age of a tip's light, by the host's clock. The arm stops when no younger tip has arrived. A predicted tip is as old as the image in which it was last seen. (10 to 300 ms; default 150)
        min_score: Lowest score of a tip that is followed. The score of a predicted tip falls with time. (0.01 to 1 ratio; default 0.3)
        latency_ms: Time from a set-point until the motors receive it. (1 to 500 ms; default 50)
        lag_ms: Time constant of the motors. (1 to 500 ms; default 15)
        backlash_deg: Backlash of each gear, full width. (0 to 1 deg; default 0.0115)
        encoder_noise_deg: Standard deviation of each encoder's noise. (0 to 0.1 deg; default 0.0012)"""

    def arm_ur(
        self,
        joints: Input[Literal["joints"]] | None = None,
        tip: Input[Literal["tip"]] | None = None,
        *,
        host: Text = ...,
        port: Whole = ...,
        dashboard_port: Whole = ...,
        answer_ms: Number = ...,
        arm: File = ...,
        home_deg: Text = ...,
        enabled: Flag = ...,
        emergency_stop: Flag = ...,
        reset: Whole = ...,
        max_age_ms: Number = ...,
        min_score: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> ArmUr:
        """A Universal Robots arm over RTDE. A separate process guards it and stops it whatever the program does.

        joints: Requested joint velocities, from `arm_pid`.
        tip: Tip that the arm follows, straight from `tip_track`. The arm moves only while fresh tips arrive.
        host: Name or address of the robot's controller. (default "192.168.0.10")
        port: TCP port of the controller's RTDE interface. (1 to 65535; default 30004)
        dashboard_port: TCP port of the controller's dashboard server, from which the serial number is read. (1 to 65535; default 29999)
        answer_ms: Time limit for an answer of the arm. After it the arm is stopped. (10 to 250 ms; default 30)
        arm: URDF file of the robot as mounted, with scope and trocar. There is no default: the limits of another arm would not hold for this one. (default "")
        home_deg: The robot's six joint angles at which the angles of the URDF file are 0: in degrees as the pendant shows them, separated by commas. (default "0, 0, 0, 0, 0, 0")
        enabled: Lets the arm move after `reset` has released it. Off: requested velocities are ignored. (default False)
        emergency_stop: Stops the arm. It stays stopped when this is switched off again, until `reset` changes. (default False)
        reset: A change of this number releases a latched stop. The driver of a real arm then also opens a lost connection again. (0 to 1000000000; default 0)
        max_age_ms: Maximum age of a tip's light, by the host's clock. The arm stops when no younger tip has arrived. A predicted tip is as old as the image in which it was last seen. (10 to 300 ms; default 150)
        min_score: Lowest score of a tip that is followed. The score of a predicted tip falls with time. (0.01 to 1 ratio; default 0.3)"""

    def calibrate_stereo(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        *,
        board: Text = ...,
        model: Union[Literal["auto", "radial", "standard", "full", "rational", "equidistant"], Arg] = ...,
        method: Union[Literal["own", "sample"], Arg] = ...,
        solve_at: Whole = ...,
        min_views: Whole = ...,
        max_views: Whole = ...,
        min_move: Number = ...,
        reject: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> CalibrateStereo:
        """Gathers views of a chessboard, circle grid or ChArUco board and solves for both cameras.

        left: Left view, not rectified.
        right: Right view of the same instant, same size.
        board: Printed pattern: chessboard:9x6:25mm (inner corners), circles:4x11:20mm (asymmetric grid), circle_grid:7x6:10mm, or charuco:19x26:5mm:4mm:4x4_250 (squares, their side, the markers' side, dictionary). (default "chessboard:9x6:25mm")
        model: Model of the distortion. (default "auto")
        method: Procedure of the calibration. (default "own")
        solve_at: Number of ticks after which the calibration is solved once; 0 solves after each accepted view. (0 to 100000 frames; default 0)
        min_views: Smallest number of views to solve with. (3 to 100 frames; default 5)
        max_views: Largest number of views. (3 to 1000 frames; default 60)
        min_move: Smallest mean movement of the points since every earlier view, as a share of the picture's diagonal. (0 to 0.5 ratio; default 0)
        reject: Skips views whose error is an outlier. (default True)"""

    def capture(
        self,
        *,
        left: File = ...,
        right: File = ...,
        views: File = ...,
        split: Union[Literal["none", "side_by_side", "top_bottom"], Arg] = ...,
        crop: Numbers = ...,
        loop: Flag = ...,
        rate_hz: Number = ...,
        pace: Union[Literal["auto", "on", "off"], Arg] = ...,
        frames: Whole = ...,
        width: Whole = ...,
        height: Whole = ...,
        fps: Number = ...,
        lock_exposure: Flag = ...,
        lock_white_balance: Flag = ...,
        lock_after: Whole = ...,
        on_damage: Union[Literal["fail", "skip"], Arg] = ...,
        orientation: Union[Literal["upright", "as_stored"], Arg] = ...,
        bit_depth: Whole = ...,
        tolerance_ms: Number = ...,
        timeout_s: Number = ...,
        open_limit_s: Number = ...,
        calibration: File = ...,
        paused: Flag = ...,
        step: Whole = ...,
        speed: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Capture:
        """Views of cameras, video files, images or GStreamer pipelines, taken together.

        left: Left view: camera number or /dev/videoN, video file, image, folder of images, pattern (dir/*.png or img_%04d.png), stream address (rtsp://..., or rtspt://... for TCP; a password as ${PANOSCOPE_SECRET_NAME}, an environment variable), or GStreamer pipeline (any text with !). Images of folders and patterns are paired by the numbers in their names, videos by time, live views by arrival. (default "")
        right: Right view, as `left`. (default "")
        views: Up to four views instead of `left` and `right`, separated by semicolons. (default "")
        split: Splits one frame into both views; give `left` only. (default "none")
        crop: Crop in px: x, y, width, height, once for all views or once for each. A width or height of 0 extends to the edge. Frames are split first. (default [])
        loop: Repeats files from the start. Without it a single image is one tick in batch mode. (default False)
        rate_hz: Frames per second of media time, for all views. 0: the times in the videos, and 30 per second for images. (0 to 1000 Hz; default 0)
        pace: When to hold frames back to their rate. Cameras keep their own pace. (default "auto")
        frames: Number of ticks after which the source ends; 0 never ends it. (0 to 1000000000 frames; default 0)
        width: Width requested from cameras; 0 keeps their mode. (0 to 16384 px; default 0)
        height: Height requested from cameras; 0 keeps their mode. (0 to 16384 px; default 0)
        fps: Frame rate requested from cameras; 0 keeps their mode. (0 to 1000 Hz; default 0)
        lock_exposure: Locks exposure and gain of all cameras at the values of view 0 after `lock_after` frames. (default False)
        lock_white_balance: Locks the white balance of all cameras at the value of view 0 after `lock_after` frames. (default False)
        lock_after: Number of frames after which exposure and white balance are locked. (0 to 10000 frames; default 30)
        on_damage: What happens when a frame of a file is damaged. Damaged frames of live sources are counted and leave their tick empty. (default "fail")
        orientation: Whether frames are rotated as their metadata says (EXIF of images, the display matrix of videos). (default "upright")
        bit_depth: Bit depth of frames with more than eight bits: 12 makes 4095 white. 0 finds it from the values and logs it. (0 to 16; default 0)
        tolerance_ms: Maximum time between frames that belong together. 0: half a period of the fastest view. (0 to 10000 ms; default 0)
        timeout_s: A camera, stream or live pipeline without data for this long is lost; it is reopened until it is back. (0.1 to 60 s; default 1)
        open_limit_s: Time limit for opening a camera, stream or pipeline. (0.1 to 600 s; default 10)
        calibration: Calibration file of the first two views: OpenCV's FileStorage YAML, a Kalibr camera chain, or the file of KITTI, Middlebury, StereoMIS or EndoVis; the two files of ROS (left; right), of OpenCV's sample or of Hamlyn (intrinsics; extrinsics) are separated by a semicolon. (default "")
        paused: Holds files at their frame, which is repeated ten times a second, so that changes of other nodes show on it. Live mode only; cameras go on. Each repetition is a tick: `read_maps` and `read_labels`, which count ticks, no longer fit afterwards; `data_set` does. (default False)
        step: Shows one more frame whenever this number changes, while `paused`. (0 to 1000000000; default 0)
        speed: How fast files are played in live mode: 2 is twice their rate. Capture times pass as the frames are shown. (0.25 to 4 ratio; default 1)"""

    def colorize(
        self,
        disparity: Input[Literal["disparity"]] | None = None,
        depth: Input[Literal["depth"]] | None = None,
        confidence: Input[Literal["confidence"]] | None = None,
        drifted: Input[Literal["scalar"]] | None = None,
        *,
        low: Number = ...,
        high: Number = ...,
        colors: Union[Literal["rainbow", "viridian", "gray"], Arg] = ...,
        scale_bar: Flag = ...,
        scale_beside: Flag = ...,
        wanted_width: Whole = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Colorize:
        """Shows a disparity, depth or confidence map in colours.

        disparity: Disparity in px.
        depth: Depth in mm.
        confidence: Confidence, 0 to 1.
        drifted: Above 0 while the calibration does not fit the views, as a matcher reports it. The scale of depths then shows near and far instead of mm.
        low: Value of the first colour. When `high` is not greater, the range is that of the image, rounded; it is held as long as it fits. (-100000 to 100000; default 0)
        high: Value of the last colour. (-100000 to 100000; default 0)
        colors: Colour map. (default "rainbow")
        scale_bar: Draws the colour scale with its values. (default True)
        scale_beside: Puts the scale in a strip to the right of the map instead of on it: the image is wider, and its coordinates do not change. (default False)
        wanted_width: Width to which a small map with its scale next to it is enlarged, by the nearest integer factor, so that the text stays sharp on a large screen. 0 keeps its size. (0 to 4096 px; default 0)
        device: What paints the map. A GPU paints a map that was made there, is not enlarged and has no scale on it: the image stays there, and only a sample of the map is read. All else is painted by the processor, which does everything without a GPU, with a warning. (default "cpu")"""

    def composite(
        self,
        left: Input[Literal["image"]] | None = None,
        right: Input[Literal["image"]] | None = None,
        homography: Input[Literal["homography"]] | None = None,
        views: Inputs[Literal["image"]] | None = None,
        homographies: Inputs[Literal["homography"]] | None = None,
        mask_left: Input[Literal["mask"]] | None = None,
        mask_right: Input[Literal["mask"]] | None = None,
        masks: Inputs[Literal["mask"]] | None = None,
        *,
        seam: Union[Literal["graph_cut", "dynamic_programming", "none"], Arg] = ...,
        seam_scale: Whole = ...,
        seam_interval: Whole = ...,
        seam_cost: Union[Literal["color", "color_gradient", "transition"], Arg] = ...,
        seam_hold: Number = ...,
        blend: Union[Literal["multi_band", "feather", "none"], Arg] = ...,
        blend_px: Whole = ...,
        exposure: Union[Literal["gain", "channel_gain", "none"], Arg] = ...,
        canvas_width: Whole = ...,
        canvas_height: Whole = ...,
        canvas_margin: Whole = ...,
        canvas_grow: Whole = ...,
        crop: Union[Literal["none", "content", "filled"], Arg] = ...,
        crop_hold: Number = ...,
        border: Union[Literal["as_is", "fade", "crop"], Arg] = ...,
        border_px: Whole = ...,
        up_cue: Flag = ...,
        up_deg: Number = ...,
        mark_lost: Flag = ...,
        on_lost: Union[Literal["last", "skip"], Arg] = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Composite:
        """Warps overlapping views onto one plane, finds the seam between them and blends them there.

        left: Left view; the panorama is in its plane.
        right: Right view of the same instant.
        homography: Maps right-view pixels to left-view pixels.
        views: Two to eight views instead of `left` and `right`; the panorama is in the plane of the first.
        homographies: One homography for each further view of `views`, which maps its pixels to the first view's.
        mask_left: Nonzero where `left` is illuminated: only those pixels are shown, compared and blended. Unconnected: all pixels.
        mask_right: Nonzero where `right` is illuminated.
        masks: Nonzero where each of `views` is illuminated, in their order. Unconnected: all pixels.
        seam: Method that finds the seam between two views. (default "graph_cut")
        seam_scale: Factor by which the overlap is reduced before the seam is found; 1 finds it at full size. 0 selects the factor by the width of the views: 10 up to 1280 px, 15 for 1920, 30 for 3840. (0 to 64; default 0)
        seam_interval: Maximum number of frames before the seam is found again. (1 to 10000 frames; default 15)
        seam_cost: Cost of the seam between two pixels. (default "color_gradient")
        seam_hold: Minimum improvement in colour difference for a new seam to replace the previous one; 0 ignores the previous seam. (0 to 20 levels; default 0.5)
        blend: Blending of the views along the seam. (default "multi_band")
        blend_px: Width of the transition across the seam. (0 to 256 px; default 32)
        exposure: Exposure correction. (default "channel_gain")
        canvas_width: Width of the panorama; 0 takes it from the first good registration. (0 to 8192 px; default 0)
        canvas_height: Height of the panorama; 0 takes it from the first good registration. (0 to 8192 px; default 0)
        canvas_margin: Margin around the first good registration, so that the canvas need not move. (0 to 512 px; default 16)
        canvas_grow: Number of consecutive frames that must leave the canvas before it grows; 0 never grows it. (0 to 10000 frames; default 0)
        crop: Region of the plane that the panorama shows. A crop is held: its size changes rarely, in steps. Has no effect with a fixed width and height. (default "none")
        crop_hold: Time for which a larger region must have been covered before a cropped panorama grows, or a bounding box must have been wrong before it changes. (0 to 60 s; default 4)
        border: Treatment of the panorama's outer border. (default "as_is")
        border_px: Width of a fading border. (1 to 512 px; default 24)
        up_cue: Draws an arrow that points up in the left view. (default False)
        up_deg: Direction of up in the left view, clockwise from the top of the image. (-180 to 180 deg; default 0)
        mark_lost: Marks frames whose registration is lost. (default True)
        on_lost: Output while a frame's registration is lost or implausible. (default "last")
        device: What draws panoramas of two views. A GPU sometimes rounds positions differently, by 1/64 px; it is worthwhile for views of 1920x1080 and more, and with views that are on the GPU. The panorama stays there, unless marks or a border are drawn on it. The processor still finds and blends the seam, for which it reads samples and the columns around the seam. Without a GPU, and for more views, the processor draws. (default "cpu")"""

    def composite_mesh(
        self,
        left: Input[Literal["image"]] | None = None,
        right: Input[Literal["image"]] | None = None,
        homography: Input[Literal["homography"]] | None = None,
        disparity: Input[Literal["disparity"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        detections: Input[Literal["detections"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        views: Inputs[Literal["image"]] | None = None,
        homographies: Inputs[Literal["homography"]] | None = None,
        disparities: Inputs[Literal["disparity"]] | None = None,
        mask_left: Input[Literal["mask"]] | None = None,
        mask_right: Input[Literal["mask"]] | None = None,
        masks: Inputs[Literal["mask"]] | None = None,
        *,
        cell: Whole = ...,
        bend: Number = ...,
        fade: Number = ...,
        most_stretch: Number = ...,
        zone_px: Number = ...,
        outlier_px: Number = ...,
        steady: Number = ...,
        instruments: Flag = ...,
        min_score: Number = ...,
        camera_columns: Whole = ...,
        seam: Union[Literal["graph_cut", "dynamic_programming", "none"], Arg] = ...,
        seam_scale: Whole = ...,
        seam_interval: Whole = ...,
        seam_cost: Union[Literal["color", "color_gradient", "transition"], Arg] = ...,
        seam_hold: Number = ...,
        blend: Union[Literal["multi_band", "feather", "none"], Arg] = ...,
        blend_px: Whole = ...,
        exposure: Union[Literal["gain", "channel_gain", "none"], Arg] = ...,
        canvas_width: Whole = ...,
        canvas_height: Whole = ...,
        canvas_margin: Whole = ...,
        canvas_grow: Whole = ...,
        crop: Union[Literal["none", "content", "filled"], Arg] = ...,
        crop_hold: Number = ...,
        border: Union[Literal["as_is", "fade", "crop"], Arg] = ...,
        border_px: Whole = ...,
        up_cue: Flag = ...,
        up_deg: Number = ...,
        mark_lost: Flag = ...,
        on_lost: Union[Literal["last", "skip"], Arg] = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> CompositeMesh:
        """Joins views by meshes that follow their disparity, so that nothing breaks at the seam, and keep lengths beyond.

        left: Left view; the panorama is in its plane.
        right: Right view of the same instant.
        homography: Maps right-view pixels to left-view pixels; used where only the right camera sees.
        disparity: Disparity of the left rectified view, as large as the views or smaller by an integer factor; used where both cameras see. Without it the homography alone places the right view.
        calibration: Calibration of the views. Unconnected: they are assumed to be rectified.
        detections: Boxes of instruments in the left view, from a detector. Inside them, anything in front of the tissue is more readily treated as an instrument. Boxes of an earlier frame are accepted.
        mask: Nonzero on instruments in the left view, from a segmenting node.
        views: Two to eight views instead of `left` and `right`, row by row, of cameras one baseline apart with parallel axes.
        homographies: One homography for each further view of `views`, which maps its pixels to the first view's.
        disparities: Disparities of the first of `views` with cameras one baseline away, each at full size. In each pixel the first known value is used.
        mask_left: Nonzero where `left` is illuminated: only those pixels are shown, compared and blended. Unconnected: all pixels.
        mask_right: Nonzero where `right` is illuminated.
        masks: Nonzero where each of `views` is illuminated, in their order. Unconnected: all pixels.
        cell: Side of a mesh cell. (12 to 96 px; default 20)
        bend: Smoothness of the mesh: weight of its bending relative to the observations in a cell. (0.001 to 100 ratio; default 0.01)
        fade: Speed with which the mesh approaches the homography where nothing is observed: weight of its slopes. (0 to 10 ratio; default 0.005)
        most_stretch: Maximum change of a length, relative to the homography, where only the other camera sees. (0 to 100 %; default 4.5)
        zone_px: Width of the zone before the left view's border in which the mesh departs from the disparity to limit that change. A wide zone is smooth; a narrow one keeps more of the overlap exact. With 0 the mesh follows the disparity up to the border and stretches what is beyond. (0 to 400 px; default 60)
        outlier_px: Distance from the mesh at which an observation has a quarter of its weight. Observations on an instrument in front of the tissue are further away and do not count. (0.2 to 50 px; default 12)
        steady: Weight of the previous frame's mesh while nothing moves; 0 fits each frame independently. (0 to 1000 ratio; default 10)
        instruments: Shows each instrument in front of the tissue completely and unbent, from one of the views; for `left` and `right`. (default True)
        min_score: Minimum score of a box at `detections`. (0 to 1 ratio; default 0.3)
        camera_columns: Number of `views` per row of cameras, which are one baseline apart with parallel axes. (1 to 8; default 2)
        seam: Method that finds the seam between two views. (default "graph_cut")
        seam_scale: Factor by which the overlap is reduced before the seam is found; 1 finds it at full size. 0 selects the factor by the width of the views: 10 up to 1280 px, 15 for 1920, 30 for 3840. (0 to 64; default 0)
        seam_interval: Maximum number of frames before the seam is found again. (1 to 10000 frames; default 15)
        seam_cost: Cost of the seam between two pixels. (default "color_gradient")
        seam_hold: Minimum improvement in colour difference for a new seam to replace the previous one; 0 ignores the previous seam. (0 to 20 levels; default 0.5)
        blend: Blending of the views along the seam. (default "multi_band")
        blend_px: Width of the transition across the seam. (0 to 256 px; default 32)
        exposure: Exposure correction. (default "channel_gain")
        canvas_width: Width of the panorama; 0 takes it from the first good registration. (0 to 8192 px; default 0)
        canvas_height: Height of the panorama; 0 takes it from the first good registration. (0 to 8192 px; default 0)
        canvas_margin: Margin around the first good registration, so that the canvas need not move. (0 to 512 px; default 16)
        canvas_grow: Number of consecutive frames that must leave the canvas before it grows; 0 never grows it. (0 to 10000 frames; default 0)
        crop: Region of the plane that the panorama shows. A crop is held: its size changes rarely, in steps. Has no effect with a fixed width and height. (default "none")
        crop_hold: Time for which a larger region must have been covered before a cropped panorama grows, or a bounding box must have been wrong before it changes. (0 to 60 s; default 4)
        border: Treatment of the panorama's outer border. (default "as_is")
        border_px: Width of a fading border. (1 to 512 px; default 24)
        up_cue: Draws an arrow that points up in the left view. (default False)
        up_deg: Direction of up in the left view, clockwise from the top of the image. (-180 to 180 deg; default 0)
        mark_lost: Marks frames whose registration is lost. (default True)
        on_lost: Output while a frame's registration is lost or implausible. (default "last")
        device: What draws panoramas of two views. A GPU sometimes rounds positions differently, by 1/64 px; it is worthwhile for views of 1920x1080 and more, and with views that are on the GPU. The panorama stays there, unless marks or a border are drawn on it. The processor still finds and blends the seam, for which it reads samples and the columns around the seam. Without a GPU, and for more views, the processor draws. (default "cpu")"""

    def composite_opencv(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        homography: Input[Literal["homography"]],
        *,
        seam_megapixels: Number = ...,
        seam: Union[Literal["graph_cut", "dynamic_programming", "none"], Arg] = ...,
        seam_cost: Union[Literal["color", "color_grad"], Arg] = ...,
        gain: Flag = ...,
        blend_strength: Number = ...,
        canvas_margin: Whole = ...,
        threads: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> CompositeOpencv:
        """Joins two views with OpenCV's stitching classes: warp, gain, graph-cut seam, multi-band blend.

        left: Left view; the panorama is in its plane.
        right: Right view of the same instant.
        homography: Maps right-view pixels to left-view pixels.
        seam_megapixels: Size to which each view is reduced for gains and seam, in megapixels; 0 uses full resolution. OpenCV's stitcher uses 0.1. (0 to 10; default 0)
        seam: Method that finds the seam between the views. (default "graph_cut")
        seam_cost: Cost that the seam minimises. (default "color")
        gain: Equalises the exposure with one gain per view. (default True)
        blend_strength: Width of the blend, as a percentage of the panorama's side, as in OpenCV's sample. (0 to 100 %; default 5)
        canvas_margin: Margin around the first good registration, so that the canvas need not move. (0 to 512 px; default 16)
        threads: Number of OpenCV's threads. Applies to the whole process while this node is open. (1 to 64; default 1)"""

    def cut_views(
        self,
        image: Input[Literal["image"]],
        *,
        overlap: Number = ...,
        perspective_px: Number = ...,
        sway_px: Number = ...,
        sway_frames: Whole = ...,
        right_exposure: Number = ...,
        noise_levels: Number = ...,
        seed: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> CutViews:
        """Cuts an image into two overlapping views with different perspective, exposure and noise: real images with a true homography.

        image: Image to cut.
        overlap: Overlap of both views, as a share of their width. (0.1 to 0.9 ratio; default 0.5)
        perspective_px: Maximum displacement of the right view's corners by its perspective. (0 to 200 px; default 12)
        sway_px: Amplitude of the movement of each corner of the right view; 0 keeps it still. (0 to 50 px; default 2)
        sway_frames: Period of the movement. (2 to 10000 frames; default 60)
        right_exposure: Exposure of the right view relative to the left one. (0.25 to 1.9 ratio; default 0.9)
        noise_levels: Standard deviation of the noise added to each view, gray levels. (0 to 32; default 2)
        seed: Seed of shape, movement and noise. (0 to 1000000000; default 7)"""

    def data_set(
        self,
        *,
        folder: File = ...,
        sequence: Text = ...,
        loop: Flag = ...,
        rate_hz: Number = ...,
        pace: Union[Literal["auto", "on", "off"], Arg] = ...,
        on_damage: Union[Literal["fail", "skip"], Arg] = ...,
        paused: Flag = ...,
        step: Whole = ...,
        speed: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> DataSet:
        """Images of SCARED, Hamlyn, StereoMIS, EndoVis, KITTI, Middlebury, CholecSeg8k, VOC and YOLO folders, with their calibration and truth.

        folder: Folder of one data set or of several; `panoscope import FOLDER` lists what is found there. (default "")
        sequence: Name of a sequence, as `panoscope import` lists it. Empty: the first one. (default "")
        loop: Starts again at the end. (default False)
        rate_hz: Frames per second of media time. 0: the times in videos, and 30 per second for images. (0 to 1000 Hz; default 0)
        pace: When to hold frames back to their rate. (default "auto")
        on_damage: How a damaged image is handled. (default "fail")
        paused: Holds files at their frame, which is repeated ten times a second, so that changes of other nodes show on it. Live mode only; cameras go on. Each repetition is a tick: `read_maps` and `read_labels`, which count ticks, no longer fit afterwards; `data_set` does. (default False)
        step: Shows one more frame whenever this number changes, while `paused`. (0 to 1000000000; default 0)
        speed: How fast files are played in live mode: 2 is twice their rate. Capture times pass as the frames are shown. (0.25 to 4 ratio; default 1)"""

    def disparity_fbs(
        self,
        image: Input[Literal["image"]],
        disparity: Input[Literal["disparity"]],
        disparity_right: Input[Literal["disparity"]] | None = None,
        confidence: Input[Literal["confidence"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        *,
        sigma_xy_px: Whole = ...,
        sigma_luma: Whole = ...,
        lambda_: Number = ...,
        iterations: Whole = ...,
        tolerance: Number = ...,
        min_support: Number = ...,
        warm_start: Flag = ...,
        left_right_px: Number = ...,
        scatter_radius_px: Whole = ...,
        highlight_level: Whole = ...,
        dark_level: Whole = ...,
        beyond_mask_px: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> DisparityFbs:
        """Fast bilateral solver (Barron and Poole): the map close to trusted disparities and smooth wherever the picture is.

        image: Rectified left view, gray8 or bgr8. Its edges are kept in the map.
        disparity: Disparity of the left view, px.
        disparity_right: Disparity of the right view, px. Confidence is 0 where both views disagree.
        confidence: Confidence to use; without it the filter computes its own.
        mask: What of the left view is lit, not 0. The map is unknown elsewhere; without it all is lit.
        sigma_xy_px: Side of a grid cell. (2 to 128 px; default 8)
        sigma_luma: Height of a grid cell in gray levels. (2 to 128; default 16)
        lambda_: Weight of smoothness against closeness to the given map. (0 to 10000; default 0.5)
        iterations: Largest number of conjugate gradient steps. (1 to 200; default 25)
        tolerance: Residual at which the solver stops. (0 to 1 ratio; default 0.001)
        min_support: Support below which a pixel stays unknown. (0 to 1 ratio; default 0.1)
        warm_start: Starts from the solution of the previous frame. (default True)
        left_right_px: Largest difference to the right view's disparity that is trusted. (0 to 16 px; default 1.5)
        scatter_radius_px: Radius of the neighbourhood whose scatter lowers confidence: 5 after `stereo_bm`, 3 after `stereo_sgbm`, 0 for none. (0 to 15 px; default 5)
        highlight_level: Gray level from which a pixel is a highlight and not trusted; 256 trusts all. (1 to 256; default 250)
        dark_level: Gray level up to which a pixel lies outside the scope's picture and is not trusted; -1 trusts all. (-1 to 255; default 4)
        beyond_mask_px: Fills the map so far beyond the mask, where the picture is not black, at a width of 640 px. `rectify` ends its masks 5 px inside of the rim, and the surface goes on there. (0 to 16 px; default 0)"""

    def disparity_fbs_opencv(
        self,
        image: Input[Literal["image"]],
        disparity: Input[Literal["disparity"]],
        confidence: Input[Literal["confidence"]],
        *,
        sigma_spatial: Number = ...,
        sigma_luma: Number = ...,
        sigma_chroma: Number = ...,
        lambda_: Number = ...,
        threads: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> DisparityFbsOpencv:
        """OpenCV's fast bilateral solver.

        image: Rectified left view.
        disparity: Disparity of the left view.
        confidence: Confidence of the disparity.
        sigma_spatial: Side of a grid cell. (1 to 128 px; default 16)
        sigma_luma: Height of a grid cell in luminance. (1 to 128; default 8)
        sigma_chroma: Height of a grid cell in colour. (1 to 128; default 8)
        lambda_: Weight of smoothness against closeness to the given map. (0 to 100000; default 128)
        threads: Number of OpenCV's threads, for the whole process while this node is open. (1 to 64; default 1)"""

    def disparity_wls(
        self,
        image: Input[Literal["image"]],
        disparity: Input[Literal["disparity"]],
        disparity_right: Input[Literal["disparity"]] | None = None,
        confidence: Input[Literal["confidence"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        *,
        lambda_: Number = ...,
        sigma_color: Number = ...,
        iterations: Whole = ...,
        min_support: Number = ...,
        left_right_px: Number = ...,
        scatter_radius_px: Whole = ...,
        highlight_level: Whole = ...,
        dark_level: Whole = ...,
        beyond_mask_px: Whole = ...,
        scale: Whole = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> DisparityWls:
        """Weighted least squares: fills and smooths a disparity map along the picture's edges, trusted pixels first.

        image: Rectified left view, gray8 or bgr8. Its edges are kept in the map.
        disparity: Disparity of the left view, px.
        disparity_right: Disparity of the right view, px. Confidence is 0 where both views disagree.
        confidence: Confidence to use; without it the filter computes its own.
        mask: What of the left view is lit, not 0. The map is unknown elsewhere; without it all is lit.
        lambda_: Strength of the smoothing: strong smoothing flattens slopes. 1000 suits `stereo_bm`, 200 `stereo_sgbm`. (0 to 1000000; default 1000)
        sigma_color: Colour distance over which the coupling of two pixels falls to 1/e. (0.1 to 100; default 1.5)
        iterations: Number of iterations over rows and columns. (1 to 8; default 3)
        min_support: Support below which a pixel stays unknown; 0 fills all pixels that the filter reaches. (0 to 1 ratio; default 0.1)
        left_right_px: Largest difference to the right view's disparity that is trusted. (0 to 16 px; default 1.5)
        scatter_radius_px: Radius of the neighbourhood whose scatter lowers confidence: 5 after `stereo_bm`, 3 after `stereo_sgbm`, 0 for none. (0 to 15 px; default 5)
        highlight_level: Gray level from which a pixel is a highlight and not trusted; 256 trusts all. (1 to 256; default 250)
        dark_level: Gray level up to which a pixel lies outside the scope's picture and is not trusted; -1 trusts all. (-1 to 255; default 4)
        beyond_mask_px: Fills the map so far beyond the mask, where the picture is not black, at a width of 640 px. `rectify` ends its masks 5 px inside of the rim, and the surface goes on there. (0 to 16 px; default 0)
        scale: Factor by which maps and picture are shrunk before they are filtered, for maps that were matched so: as good at a fraction of the time. 0 finds it from the width: 1 below 640 px, 2 from 640, 3 from 1440, 4 from 2560. (0 to 8; default 1)
        device: What filters, with the same map to 0.01 px. A GPU pays for large maps that are matched there. Without one the processor does it, with a warning. (default "cpu")"""

    def disparity_wls_opencv(
        self,
        image: Input[Literal["image"]],
        disparity: Input[Literal["disparity"]],
        disparity_right: Input[Literal["disparity"]],
        *,
        method: Union[Literal["bm", "sgbm"], Arg] = ...,
        min_disparity_px: Whole = ...,
        search_px: Whole = ...,
        block_px: Whole = ...,
        lambda_: Number = ...,
        sigma_color: Number = ...,
        threads: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> DisparityWlsOpencv:
        """OpenCV's weighted-least-squares filter with its left-right confidence.

        image: Rectified left view.
        disparity: Disparity of the left view.
        disparity_right: Disparity of the right view.
        method: Algorithm of the matcher in front of this filter. (default "bm")
        min_disparity_px: Minimum disparity that the matcher in front searches. (-1024 to 1500 px; default 0)
        search_px: Number of disparities that the matcher in front searches. (16 to 512 px; default 64)
        block_px: Side of the window of the matcher in front. (3 to 31 px; default 15)
        lambda_: Strength of the smoothing. (0 to 1000000; default 8000)
        sigma_color: Sensitivity to edges of the image. (0.1 to 100; default 1.5)
        threads: Number of OpenCV's threads. Applies to the whole process while this node is open. The filter divides its rows among this number when it is created. (1 to 64; default 1)"""

    def drain(
        self,
        image: Input[Literal["image"]],
        *,
        digest: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Counts frames and releases them.

        image: The frame to forward.
        digest: Reads all pixels and reports a digest of all frames received, as the metric `digest`. (default False)"""

    def drain_blocking(
        self,
        image: Input[Literal["image"]],
        *,
        digest: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Counts frames and releases them, on its own thread.

        image: The frame to forward.
        digest: Reads all pixels and reports a digest of all frames received, as the metric `digest`. (default False)"""

    def evaluate_arm(
        self,
        calibration: Input[Literal["calibration"]],
        tip: Input[Literal["tip"]] | None = None,
        arm: Input[Literal["table"]] | None = None,
        track: Input[Literal["table"]] | None = None,
        *,
        distance_mm: Number = ...,
        track_id: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EvaluateArm:
        """Evaluates how well an arm follows an exactly known tip.

        calibration: Calibration of the rectified views.
        tip: The true tip (`lead` of the phantom), mm; score 0 while it is hidden or outside the image.
        arm: Table of the arm's driver.
        track: Table of the `tip_track` that controls the arm, for the time since the tip was seen and the tracker's error.
        distance_mm: Requested distance of the tip from the left camera. (30 to 120 mm; default 66)
        track_id: Number of the tool that is followed; tips of other tools are not evaluated. -1 evaluates all. (-1 to 1000000000; default -1)"""

    def evaluate_cloud(
        self,
        truth: Input[Literal["depth"]],
        calibration: Input[Literal["calibration"]],
        cloud: Input[Literal["cloud"]] | None = None,
        *,
        reach_mm: Number = ...,
        step: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EvaluateCloud:
        """Compares points with the true surface: distances in mm to its nearest points, coverage.

        truth: True depth of the left rectified view.
        calibration: Calibration of the rectified views.
        cloud: The points to evaluate, in the left rectified camera's frame. A tick without them covers nothing.
        reach_mm: Largest distance that is measured. (0.1 to 50 mm; default 2)
        step: Spacing of the points that are compared, in columns and rows. (1 to 64 px; default 8)"""

    def evaluate_depth(
        self,
        truth: Input[Literal["depth"]],
        depth: Input[Literal["depth"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        *,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EvaluateDepth:
        """Compares depth with the truth, pixel by pixel: median, mean and 95 % error in mm, coverage.

        truth: True depth of the same view; pixels where it is unknown do not count.
        depth: The map to evaluate. A tick without one counts as unknown everywhere.
        mask: Pixels that count are not 0; all count without it."""

    def evaluate_detections(
        self,
        truth: Input[Literal["detections"]],
        detections: Input[Literal["detections"]] | None = None,
        *,
        min_score: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EvaluateDetections:
        """Compares boxes with the true ones: precision, recall and average precision since the start.

        truth: True boxes, such as `detections` of the phantom or of `read_labels`. An object with a score of 0 is ignored.
        detections: Boxes to evaluate. A tick without them counts as no detection.
        min_score: Minimum score of a detection that counts for precision and recall. (0 to 1 ratio; default 0.5)"""

    def evaluate_disparity(
        self,
        truth: Input[Literal["disparity"]],
        disparity: Input[Literal["disparity"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        *,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EvaluateDisparity:
        """Compares disparities with the truth: bad pixels, mean and 95 % error, coverage.

        truth: True disparity of the same view; pixels where it is unknown do not count.
        disparity: The map to evaluate. A tick without one counts as unknown everywhere.
        mask: Pixels that count are not 0; all count without it."""

    def evaluate_mosaic(
        self,
        pose: Input[Literal["pose"]],
        depth: Input[Literal["depth"]],
        calibration: Input[Literal["calibration"]],
        homography: Input[Literal["homography"]] | None = None,
        *,
        step: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EvaluateMosaic:
        """Compares where a mosaic puts its frames with where the phantom's cameras truly were: drift in pixels, mm and percent of the path.

        pose: True pose of the camera in the scene.
        depth: True depth of the frame.
        calibration: True calibration; only the left camera is used.
        homography: The homography of the frame to evaluate.
        step: Spacing of the points that are compared. (4 to 200 px; default 40)"""

    def evaluate_proximity(
        self,
        truth: Input[Literal["table"]],
        table: Input[Literal["table"]] | None = None,
        *,
        warn_mm: Number = ...,
        tips_mm: Number = ...,
        release_mm: Number = ...,
        min_ms: Number = ...,
        margin_mm: Number = ...,
        delay_ms: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EvaluateProximity:
        """Counts false and missed warnings of `proximity`, compared with exactly known distances.

        truth: True distances (`clearance` of the phantom): `track_id`, `seen`, `tissue_mm`, `tip_mm`. Ticks in which a tip is not visible are not evaluated.
        table: Table of `proximity`. A tip without a row has no warning.
        warn_mm: Distance to the tissue below which a tip counts as near. (0.1 to 50 mm; default 5)
        tips_mm: Distance between tips below which they count as near. (0.1 to 100 mm; default 8)
        release_mm: Hysteresis: a warning ends at a distance larger by this than where it begins. (0 to 20 mm; default 1)
        min_ms: Time for which a distance must stay beyond a threshold before a warning begins or ends. (0 to 5000 ms; default 60)
        margin_mm: Tolerance around each threshold: approaches and warnings within it count neither as correct nor as wrong. (0 to 20 mm; default 1)
        delay_ms: Maximum delay of a warning. (0 to 5000 ms; default 200)"""

    def evaluate_stitch(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        homography: Input[Literal["homography"]] | None = None,
        mesh: Input[Literal["table"]] | None = None,
        panorama: Input[Literal["image"]] | None = None,
        canvas: Input[Literal["roi"]] | None = None,
        shown: Input[Literal["image"]] | None = None,
        disparity: Input[Literal["disparity"]] | None = None,
        visible: Input[Literal["mask"]] | None = None,
        truth: Input[Literal["homography"]] | None = None,
        wide: Input[Literal["image"]] | None = None,
        footprint: Input[Literal["mask"]] | None = None,
        left_in_wide: Input[Literal["roi"]] | None = None,
        *,
        wide_x: Whole = ...,
        wide_y: Whole = ...,
        seam_band: Whole = ...,
        step: Whole = ...,
        every: Whole = ...,
        correlate: Flag = ...,
        along_x: Number = ...,
        along_y: Number = ...,
        view: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EvaluateStitch:
        """Compares a registration and its panorama with the ground truth: alignment, similarity in the overlap and along the seam, jitter.

        left: Left view.
        right: Right view.
        homography: The registration to evaluate.
        mesh: Mesh that places the right view instead of the homography, as `composite_mesh` writes it.
        panorama: The panorama to evaluate.
        canvas: Rectangle of the left view in the panorama, px.
        shown: View that each pixel of the panorama shows.
        disparity: True disparity of the left view, px.
        visible: 255 where the right camera sees the same point.
        truth: True homography, or the best available.
        wide: Image of one wide camera at the left camera's position.
        footprint: 255 in each pixel of `wide` that at least one camera shows.
        left_in_wide: Rectangle of the left view in `wide`, px; overrides the parameters.
        wide_x: Column of the left view's origin in the wide ground truth; -1: as in the phantom, an eighth of the extra width. (-1 to 8192 px; default -1)
        wide_y: Row of the left view's origin in the wide ground truth; -1: as in the phantom, an eighth of the extra height. (-1 to 8192 px; default -1)
        seam_band: Half the width of the band along the seam that is compared. (1 to 256 px; default 16)
        step: Spacing of the true correspondences. (1 to 64 px; default 8)
        every: Number of ticks between comparisons of images, which take longer than stitching. (1 to 1000 frames; default 3)
        correlate: If no ground truth is connected, evaluates the alignment by correspondences found by correlation, on the same ticks. (default False)
        along_x: Horizontal displacement of the right view, in units of the true disparity. (-8 to 8 ratio; default 1)
        along_y: Vertical displacement of the right view: 1 for a camera one baseline below the left one. (-8 to 8 ratio; default 0)
        view: Number of the right view in `shown`. (2 to 8; default 2)"""

    def every_nth(
        self,
        image: Input[Literal["image"]],
        *,
        n: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> EveryNth:
        """Forwards every n-th frame.

        image: The frame to forward.
        n: One frame in this many passes; the output is empty for the others. (1 to 1000000; default 2)"""

    def features_opencv(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]] | None = None,
        *,
        detector: Union[Literal["sift", "akaze", "orb"], Arg] = ...,
        max_points: Whole = ...,
        threshold: Number = ...,
        ratio: Number = ...,
        mutual: Flag = ...,
        threads: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> FeaturesOpencv:
        """Finds and matches SIFT, AKAZE or ORB features of two views with OpenCV.

        left: Left view, or the only one.
        right: Right view, of any size. Without it no matches are made.
        detector: Kind of features. (default "sift")
        max_points: Maximum number of keypoints per view, strongest first; 0 uses OpenCV's default. (0 to 100000 points; default 0)
        threshold: Threshold of the detector; 0 uses OpenCV's default (0.04, 0.001, 20). (0 to 1000; default 0)
        ratio: Maximum ratio of the best to the second-best distance of a match. (0.3 to 1 ratio; default 0.8)
        mutual: Keeps a match only when each point is the other's best. (default True)
        threads: Number of OpenCV's threads. Applies to the whole process while this node is open. (1 to 64; default 1)"""

    def features_surf(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]] | None = None,
        *,
        hessian_threshold: Number = ...,
        max_points: Whole = ...,
        octaves: Whole = ...,
        layers: Whole = ...,
        upright: Flag = ...,
        fine_bias: Number = ...,
        upsample: Flag = ...,
        window: Number = ...,
        extended: Flag = ...,
        second_look: Flag = ...,
        scale: Whole = ...,
        ratio: Number = ...,
        mutual: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> FeaturesSurf:
        """Finds and matches SURF features of two views.

        left: Left view, or the only one.
        right: Right view, of any size. Without it no matches are made.
        hessian_threshold: Minimum determinant of the Hessian of a keypoint. (0 to 20000; default 100)
        max_points: Maximum number of keypoints per view, strongest first; 0 keeps all. (0 to 100000 points; default 0)
        octaves: Octaves of the scale space. (1 to 4; default 4)
        layers: Number of filters per octave. (3 to 8; default 4)
        upright: Ignores the orientation of keypoints, for cameras that are hardly rotated relative to each other. (default False)
        fine_bias: Exponent of the size by which responses are divided for ranking: larger values prefer fine detail, which is located more precisely. (0 to 4; default 1)
        upsample: Doubles the size of the image first: finer keypoints, about four times the time. Only with `scale` 1. (default False)
        window: Size of the descriptor's window relative to the usual one. (0.5 to 4 ratio; default 1)
        extended: Descriptors of 128 instead of 64 elements, from a narrow and a wide window: more correct matches, slower. (default False)
        second_look: Locates each keypoint more precisely with Gaussian derivatives; slow. (default True)
        scale: Factor by which the image is reduced before the search. (1 to 8; default 1)
        ratio: Maximum ratio of the best to the second-best distance of a match. (0.3 to 1 ratio; default 0.8)
        mutual: Keeps a match only when each point is the other's best. (default True)"""

    def find_board(
        self,
        image: Input[Literal["image"]],
        *,
        board: Text = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> FindBoard:
        """Finds the points of a chessboard, circle grid or ChArUco board, such as to measure known lengths with a calibration.

        image: Picture of the board.
        board: Printed pattern, named as for `calibrate_stereo`. (default "chessboard:9x6:25mm")"""

    def frames(
        self,
        *,
        width_px: Whole = ...,
        height_px: Whole = ...,
        format: Union[Literal["gray8", "bgr8", "rgba8", "gray16", "f32"], Arg] = ...,
        pattern: Union[Literal["ramp", "noise", "none"], Arg] = ...,
        rate_hz: Number = ...,
        count: Whole = ...,
        start_ms: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Frames:
        """Makes test frames.

        width_px: Width of the frames. (1 to 16384 px; default 640)
        height_px: Height of the frames. (1 to 16384 px; default 480)
        format: Pixel format of the frames. (default "bgr8")
        pattern: Content of the frames. (default "ramp")
        rate_hz: Frames per second of media time; a live graph runs at this rate. (0.001 to 1000000 Hz; default 30)
        count: Number of frames; 0 for no end. (0 to 1000000000; default 0)
        start_ms: Media time of the first frame. (-1000000 to 1000000 ms; default 0)"""

    def gate(
        self,
        image: Input[Literal["image"]],
        *,
        open: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Gate:
        """Forwards frames while it is open.

        image: The frame to forward.
        open: Whether frames pass; when closed, the output is empty. (default True)"""

    def igtl_receive(
        self,
        *,
        role: Union[Literal["server", "client"], Arg] = ...,
        address: Text = ...,
        port: Whole = ...,
        queue: Whole = ...,
        device: Text = ...,
        a: Text = ...,
        b: Text = ...,
        time_from: Union[Literal["sender", "arrival"], Arg] = ...,
        clocks_agree: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> IgtlReceive:
        """Receives images, poses, points, surfaces and texts from programs that speak OpenIGTLink.

        role: Which side connects. Nodes with the same role, address and port share one connection, which carries messages both ways. (default "server")
        address: Server: address of this machine to listen on. 127.0.0.1 serves only programs on this machine; 0.0.0.0 listens on all networks. There is no password: anybody who reaches the port can read and send messages. Client: name or address of the machine to connect to. (default "127.0.0.1")
        port: TCP port; the protocol's own is 18944. 0 lets a server take a free port, which the log and the metric `port` name. (0 to 65535; default 18944)
        queue: Maximum number of messages per device that wait for a slow program or for the graph; beyond it the oldest is dropped and counted. At most two images or surfaces wait. (1 to 65536; default 256)
        device: Device name of the messages to take; empty takes those of all devices. (default "")
        a: Frame `a` of the pose, to which it maps. Empty: from a device name such as `ToolToTracker`, the part after `To`. (default "")
        b: Frame `b` of the pose, from which it maps. Empty: from the device name, the part before `To`, or all of it. (default "")
        time_from: Where the capture time of a tick comes from. Capture times never decrease. (default "sender")
        clocks_agree: Whether the sender's clock and this machine's are synchronised (NTP or PTP) to better than the ages that matter. On: ages count from a message's timestamp. Off: ages count from its arrival here, and the transmission time is unknown. (default False)"""

    def igtl_send(
        self,
        image: Input[Literal["image"]] | None = None,
        pose: Input[Literal["pose"]] | None = None,
        tip: Input[Literal["tip"]] | None = None,
        cloud: Input[Literal["cloud"]] | None = None,
        detections: Input[Literal["detections"]] | None = None,
        text: Input[Literal["text"]] | None = None,
        *,
        role: Union[Literal["server", "client"], Arg] = ...,
        address: Text = ...,
        port: Whole = ...,
        queue: Whole = ...,
        version: Whole = ...,
        poses_as: Union[Literal["transform", "position", "tracking"], Arg] = ...,
        image_name: Text = ...,
        pose_name: Text = ...,
        tip_name: Text = ...,
        tracker_name: Text = ...,
        cloud_name: Text = ...,
        detections_name: Text = ...,
        text_name: Text = ...,
        pixel_mm: Number = ...,
        cloud_step: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Sends images, poses, tips, surfaces, detections and texts to programs that speak OpenIGTLink.

        image: Image, as IMAGE: gray8 and gray16 with one component, bgr8 as red, green, blue, rgba8 with four, f32 as floats.
        pose: Pose, in the message type that `poses_as` selects.
        tip: Tip of a tool in mm, in the message type that `poses_as` selects; not sent while its position is unknown.
        cloud: Surface, as the points of POLYDATA with their colours.
        detections: Detections, as POINT: the centre of each box in the image plane, with the class as name and half the diagonal as radius.
        text: Text, as STRING; truncated to 65,535 bytes.
        role: Which side connects. Nodes with the same role, address and port share one connection, which carries messages both ways. (default "server")
        address: Server: address of this machine to listen on. 127.0.0.1 serves only programs on this machine; 0.0.0.0 listens on all networks. There is no password: anybody who reaches the port can read and send messages. Client: name or address of the machine to connect to. (default "127.0.0.1")
        port: TCP port; the protocol's own is 18944. 0 lets a server take a free port, which the log and the metric `port` name. (0 to 65535; default 18944)
        queue: Maximum number of messages per device that wait for a slow program or for the graph; beyond it the oldest is dropped and counted. At most two images or surfaces wait. (1 to 65536; default 256)
        version: Header version of the messages. Every program understands 1. Versions 2 and 3 add a message number and, as metadata, the media time (`capture_ns`) and the frames of a pose (`a`, `b`). (1 to 3; default 1)
        poses_as: Message type of poses and tips. A program that asks for tracking data (`STT_TDATA`) gets it whatever this is. (default "transform")
        image_name: Device name of the image. (default "Panoscope")
        pose_name: Device name of the pose. Empty: from the names of its frames, `bToa` for a pose that maps coordinates of `b` to those of `a`. (default "")
        tip_name: Device name of the tip. (default "Tip")
        tracker_name: Device name of tracking data. (default "Tracker")
        cloud_name: Device name of the surface. (default "Surface")
        detections_name: Device name of the detections. (default "Detections")
        text_name: Device name of the text. (default "Text")
        pixel_mm: Side of an image pixel, for programs that place it in space: pixel (0, 0) is at the origin, x goes along columns, y along rows. (0.001 to 100 mm; default 1)
        cloud_step: Every n-th column and row of a surface is sent. (1 to 64; default 4)"""

    def level(
        self,
        image: Input[Literal["image"]],
        *,
        gain: Number = ...,
        window: Numbers = ...,
        spots: Numbers = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Level:
        """Measures the brightness of images.

        image: The image to measure.
        gain: Factor of all levels. (0 to 8 ratio; default 1)
        window: Region of the image that is measured: x, y, width, height; without it, the whole image. (px; default [])
        spots: Additional points to measure: u, v, u, v, ... (px; default [])"""

    def mask_rcnn(
        self,
        image: Input[Literal["image"]],
        mask: Input[Literal["mask"]] | None = None,
        *,
        model: File = ...,
        family: Union[Literal["auto", "torchvision", "detectron2", "yolo_seg"], Arg] = ...,
        min_score: Number = ...,
        unknown_below: Number = ...,
        max_overlap: Number = ...,
        mask_threshold: Number = ...,
        max_instances: Whole = ...,
        labels: File = ...,
        input_width: Whole = ...,
        input_height: Whole = ...,
        track: Flag = ...,
        vote_s: Number = ...,
        unlike_s: Number = ...,
        unlike: Union[Literal["keep", "drop"], Arg] = ...,
        threads: Whole = ...,
        provider: Union[Literal["cpu", "cuda", "tensorrt", "openvino", "rocm", "migraphx"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> MaskRcnn:
        """Finds surgical tools with their outlines by a segmenting network.

        image: Image to search, bgr8 or gray8.
        mask: Nonzero where the image is illuminated. Instances whose boxes are more than half outside are dropped. Unconnected: the whole image.
        model: ONNX file of the network. (default "models/instrument_masks.onnx")
        family: Family of the export. (default "auto")
        min_score: Minimum score of an instance. (0.001 to 1 ratio; default 0.5)
        unknown_below: Minimum share of an instance's class in the sum of the scores of all classes at its place. Below it the class is reported as `unknown`, an instrument of uncertain kind, with that sum as score. 0 always names the class with the highest score. On rendered instruments 0.4 makes a third of the outlines `unknown`, on real ones hardly any. (0 to 1 ratio; default 0)
        max_overlap: Overlap (intersection over union) above which the box with the lower score is dropped, within a class. (0.05 to 1 ratio; default 0.5)
        mask_threshold: Minimum probability of a pixel of the mask. (0.01 to 0.99 ratio; default 0.5)
        max_instances: Maximum number of instances in the output. (1 to 200; default 20)
        labels: File with the names of the classes, one per line. Empty: the names in the model file. (default "")
        input_width: Width of the network's input, for models that accept any size. (32 to 4096 px; default 640)
        input_height: Height of the network's input, for models that accept any size. (32 to 4096 px; default 480)
        track: Gives each tool a number (`track_id`) that it keeps over time. (default True)
        vote_s: Gives a tracked tool the class that it had most often: votes are weighted by score, and their weight halves after this time. 0: the class in each image. (0 to 60 s; default 0)
        unlike_s: Time constant of the smoothing of `unlikeness`. (0 to 60 s; default 2)
        unlike: What happens to the instruments while `unlikeness` is 1 or more. (default "keep")
        threads: Number of threads of the network; 0 uses as many as the host has. (0 to 64; default 0)
        provider: Execution provider: the processor, or an accelerator if ONNX Runtime's library supports it and finds a device. Otherwise the processor is used, with a warning. (default "cpu")"""

    def measure(
        self,
        cloud: Input[Literal["cloud"]] | None = None,
        depth: Input[Literal["depth"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        confidence: Input[Literal["confidence"]] | None = None,
        drifted: Input[Literal["scalar"]] | None = None,
        tips: Inputs[Literal["tip"]] | None = None,
        detections: Input[Literal["detections"]] | None = None,
        *,
        kind: Union[Literal["distance", "polyline", "depth", "angle"], Arg] = ...,
        points: Numbers = ...,
        radius_px: Whole = ...,
        disparity_noise_px: Number = ...,
        disparity_offset_px: Number = ...,
        baseline_error_mm: Number = ...,
        focal_error_percent: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Measure:
        """Measures distances, polylines, depths and angles between points of the picture in mm, with their errors.

        cloud: Points of the left rectified view.
        depth: Depth of the left rectified view; needs `calibration`.
        calibration: Calibration of the rectified views; without it errors are unknown.
        confidence: Confidence of the disparity that the surface comes from, as a filter gives it: errors grow where it is low. Without it all errors are stated wide.
        drifted: State of the calibration, as a matcher gives it: above 0 it does not fit the views. Nothing is known then.
        tips: Tips of tools: one point each, after those of the parameter. A tip that is missing in a tick is an unknown point.
        detections: Boxes in the left rectified view: the centre of each is a point, after those of the parameter and the tips.
        kind: Kind of measurement. (default "distance")
        points: Points of the left rectified view in px: u, v, u, v, ... (default [])
        radius_px: Radius of the neighbourhood to which a surface is fitted at each point. (1 to 32 px; default 4)
        disparity_noise_px: Standard deviation of a filtered disparity, added as a square to the scatter around the point: 0.35 where `scale` of the matcher halves the views. (0 to 4 px; default 0.05)
        disparity_offset_px: Standard deviation of the calibration's disparity offset; its reprojection error is used when larger. This and the two below count where the calibration does not state its own error. (0 to 4 px; default 0.05)
        baseline_error_mm: Standard deviation of the calibration's baseline. (0 to 4 mm; default 0.05)
        focal_error_percent: Standard deviation of the calibration's focal length. (0 to 10 %; default 0.1)"""

    def mosaic(
        self,
        image: Input[Literal["image"]],
        *,
        width: Whole = ...,
        height: Whole = ...,
        view: Union[Literal["fit", "follow"], Arg] = ...,
        zoom: Number = ...,
        loop_closure: Flag = ...,
        max_keyframes: Whole = ...,
        keyframe_overlap: Number = ...,
        model: Union[Literal["homography", "affine", "similarity"], Arg] = ...,
        scale: Whole = ...,
        hessian_threshold: Number = ...,
        max_points: Whole = ...,
        upright: Flag = ...,
        ratio: Number = ...,
        gate_px: Number = ...,
        ransac_px: Number = ...,
        min_inliers: Whole = ...,
        min_inlier_share: Number = ...,
        redraw_px: Number = ...,
        exposure: Flag = ...,
        live: Flag = ...,
        mark_lost: Flag = ...,
        restart: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Mosaic:
        """Adds each frame of one moving camera to a mosaic of everything it has seen; closed loops remove the drift.

        image: Frames of the camera; all of one size.
        width: Width of the output image. (64 to 8192 px; default 1280)
        height: Height of the output image. (64 to 8192 px; default 960)
        view: Region of the mosaic that is shown. (default "fit")
        zoom: Pixels of the output per pixel of the first frame: the maximum for `fit`, fixed for `follow`. (0.05 to 2 ratio; default 1)
        loop_closure: Also registers against earlier keyframes, and distributes the error of closed loops. Off: registers only against the newest keyframes. (default True)
        max_keyframes: Maximum number of keyframes. Beyond it a new one replaces the oldest, together with its part of the mosaic. A keyframe of 640x480 takes 1.4 MB. (2 to 500; default 60)
        keyframe_overlap: Overlap with keyframes below which a frame becomes a keyframe. (0.3 to 0.95 ratio; default 0.7)
        model: Model of the maps between keyframes. Fewer parameters drift less on curved tissue but fit a tilting camera worse. (default "homography")
        scale: Factor by which the image is reduced before features are found. (1 to 8; default 2)
        hessian_threshold: Minimum determinant of the Hessian of a keypoint. (1 to 20000; default 50)
        max_points: Maximum number of keypoints per frame. (50 to 10000 points; default 500)
        upright: Ignores the orientation of keypoints, for a scope that hardly rotates about its axis. (default False)
        ratio: Maximum ratio of the best to the second-best distance of a match. (0.3 to 1 ratio; default 0.8)
        gate_px: Radius around the predicted position in which matches are searched first; 0 searches everywhere. (0 to 1000 px; default 80)
        ransac_px: Maximum reprojection error of an inlier. (0.2 to 20 px; default 3)
        min_inliers: Minimum number of inliers of a registration; 1.6 times as many without a prediction and for closed loops. (6 to 1000 points; default 15)
        min_inlier_share: Minimum share of matches that are inliers; 1.6 times as large without a prediction and for closed loops. (0 to 1 ratio; default 0.25)
        redraw_px: Movement of keyframes in the image after which the mosaic is redrawn. (0 to 20 px; default 1)
        exposure: Equalises the exposure of keyframes. (default True)
        live: Draws the newest frame on top, with its border. (default True)
        mark_lost: Marks the output while the camera is lost. (default True)
        restart: Each change of this number starts a new mosaic. (0 to 1000000; default 0)"""

    def onnx(
        self,
        image: Input[Literal["image"]] | None = None,
        left: Input[Literal["image"]] | None = None,
        right: Input[Literal["image"]] | None = None,
        previous: Input[Literal["image"]] | None = None,
        *,
        model: File = ...,
        table: Text = ...,
        table_file: File = ...,
        mask_threshold: Number = ...,
        min_confidence: Number = ...,
        min_score: Number = ...,
        max_overlap: Number = ...,
        max_boxes: Whole = ...,
        labels: File = ...,
        threads: Whole = ...,
        provider: Union[Literal["cpu", "cuda", "tensorrt", "openvino", "rocm", "migraphx"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Onnx:
        """Runs any network; a table says what its inputs and outputs are.

        image: Image for a network with one view, bgr8 or gray8.
        left: Left rectified view.
        right: Right rectified view of the same instant.
        previous: View of the previous tick, for networks that estimate motion: the same output as `image`, with `delay = 1`.
        model: ONNX file of the network. (default "")
        table: Table of inputs and outputs as TOML text, as in `[inputs.left] port = "left"` and `[outputs.disparity] port = "disparity"` on lines of their own. Empty: the file `table_file`. `panoscope describe MODEL.onnx` prints a table; the README of the plugins lists the keys. (default "")
        table_file: File with the same keys. Empty: the model's name with the extension `toml`, in its folder; a lock of the graph includes it only if it is named here. (default "")
        mask_threshold: Value from which a pixel belongs to the mask, if the network outputs one number per pixel. (-1000 to 1000; default 0.5)
        min_confidence: Confidence below which pixels of disparity and depth are unknown. Takes effect if the network outputs a confidence. (0 to 1 ratio; default 0)
        min_score: Minimum score of a box. (0.001 to 1 ratio; default 0.3)
        max_overlap: Overlap (intersection over union) above which the box with the lower score is dropped, within a class. (0.05 to 1 ratio; default 0.5)
        max_boxes: Maximum number of boxes in the output. (1 to 1000; default 50)
        labels: File with the names of the classes, one per line. Empty: the names in the model file. (default "")
        threads: Number of threads of the network; 0 uses as many as the host has. (0 to 64; default 0)
        provider: Execution provider: the processor, or an accelerator if ONNX Runtime's library supports it and finds a device. Otherwise the processor is used, with a warning. (default "cpu")"""

    def overlay(
        self,
        image: Input[Literal["image"]],
        homography: Input[Literal["homography"]] | None = None,
        roi: Input[Literal["roi"]] | None = None,
        detections: Input[Literal["detections"]] | None = None,
        instances: Input[Literal["instances"]] | None = None,
        tip: Input[Literal["tip"]] | None = None,
        nearness: Input[Literal["table"]] | None = None,
        table: Input[Literal["table"]] | None = None,
        scalar: Input[Literal["scalar"]] | None = None,
        text: Inputs[Literal["text"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        disparity: Input[Literal["disparity"]] | None = None,
        depth: Input[Literal["depth"]] | None = None,
        *,
        show_registration: Flag = ...,
        show_outline: Flag = ...,
        show_roi: Flag = ...,
        show_boxes: Flag = ...,
        min_score: Number = ...,
        show_masks: Flag = ...,
        show_tip: Flag = ...,
        show_numbers: Flag = ...,
        columns: Text = ...,
        show_inset: Flag = ...,
        words: Union[Literal["picture", "below", "nowhere"], Arg] = ...,
        bar_lines: Whole = ...,
        max_aspect: Number = ...,
        wanted_width: Whole = ...,
        label: Text = ...,
        label_corner: Union[Literal["top_left", "top_right", "bottom_left", "bottom_right"], Arg] = ...,
        inset_corner: Union[Literal["top_left", "top_right", "bottom_left", "bottom_right"], Arg] = ...,
        inset_share: Number = ...,
        colors: Union[Literal["rainbow", "viridian", "gray"], Arg] = ...,
        text_scale: Number = ...,
        line_px: Number = ...,
        mask_alpha: Number = ...,
        offset_px: Numbers = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Overlay:
        """Draws registrations, boxes, masks, tips, numbers and maps on an image.

        image: The image to draw on.
        homography: Registration: draws the outline of the right view and writes the state.
        roi: A rectangle, px.
        detections: Boxes with labels.
        instances: Boxes with masks.
        tip: Tip of a tool.
        nearness: Table of `proximity`: draws a ring around each tip, a line to the nearest tissue, and the distance.
        table: A table, of which the first row is written.
        scalar: A number.
        text: Texts, each on separate lines.
        mask: A mask of the image's size.
        disparity: Disparity map, px, shown as an inset.
        depth: Depth map, mm, shown as an inset.
        show_registration: Draws the state of the registration. (default True)
        show_outline: Also draws the outline of the right view and the registration's numbers. Without it only a held or lost registration is named. (default True)
        show_roi: Draws the rectangle of `roi`. (default True)
        show_boxes: Draws boxes with their labels. (default True)
        min_score: Minimum score of boxes and masks that are drawn. (0 to 1; default 0)
        show_masks: Draws masks. (default True)
        show_tip: Draws the tip, and the distances of `proximity`. (default True)
        show_numbers: Writes table, scalar and text. (default True)
        columns: Columns of the table that are written, separated by commas; empty writes all. The unit follows the number, and the 95 % error bound if the next column holds it: `distance_mm` with `error_mm` is written as `distance 12.3 ± 1.2 mm`. (default "")
        show_inset: Shows the disparity or depth map as an inset. (default True)
        words: Where text is written: on the image, or below it where it covers nothing. (default "picture")
        bar_lines: Number of lines of the bar below the image. (1 to 8; default 2)
        max_aspect: Maximum width by height of an image with its bar: for a wider image the text grows, up to twice its size, then the number of lines, until the bar is high enough. It fills what a wide image leaves free on a screen. 0 leaves the bar as it is. (0 to 4 ratio; default 0)
        wanted_width: Width to which a small image with a bar is enlarged, by the nearest integer factor, so that the text stays sharp on a large screen. 0 keeps its size. (0 to 4096 px; default 0)
        label: Text that is always written in the corner; the title of a bar below the image. (default "")
        label_corner: Corner of all text. (default "top_left")
        inset_corner: Corner of the inset. (default "bottom_right")
        inset_share: Width of the inset, as a share of the image's width. (0.05 to 1 ratio; default 0.3)
        colors: Colour map of the inset. (default "rainbow")
        text_scale: Scale of text: capital letters are six times as many px high. (0.5 to 20; default 2)
        line_px: Width of lines. (0.5 to 20 px; default 2)
        mask_alpha: Opacity of masks. (0 to 1 ratio; default 0.4)
        offset_px: Offset added to all coordinates, x and y in px: the position of the left view's corner in the image. (px; default [])
        device: Where the image and the bar below it are joined. A GPU does it with an image that was made there and is not enlarged: the result stays there, and only parts with marks come to the processor, which draws them, and go back. An image with masks or an inset comes whole. Without a GPU the processor does everything, with a warning. (default "cpu")"""

    def pass_(
        self,
        image: Input[Literal["image"]],
        *,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Pass:
        """Forwards frames without a copy.

        image: The frame to forward."""

    def pass_blocking(
        self,
        image: Input[Literal["image"]],
        *,
        wait_ms: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> PassBlocking:
        """Forwards frames from its own thread, after an optional pause.

        image: The frame to forward.
        wait_ms: Time that the node sleeps per frame, as a slow device would. (0 to 10000 ms; default 0)"""

    def phantom(
        self,
        camera_pose: Input[Literal["pose"]] | None = None,
        *,
        scene: Union[Literal["liver", "bowel", "cavity", "box", "board"], Arg] = ...,
        board: Union[Literal["chessboard", "circles", "charuco"], Arg] = ...,
        seed: Whole = ...,
        layout: Union[Literal["stereo", "quad"], Arg] = ...,
        width: Whole = ...,
        height: Whole = ...,
        baseline_mm: Number = ...,
        distance_mm: Number = ...,
        rate_hz: Number = ...,
        relief: Number = ...,
        camera_path: Union[Literal["sway", "ring", "glide"], Arg] = ...,
        path_mm: Number = ...,
        speed_mm_s: Number = ...,
        breathing_mm: Number = ...,
        specular: Number = ...,
        texture: Number = ...,
        light: Number = ...,
        noise: Number = ...,
        smoke: Number = ...,
        blood_drops: Whole = ...,
        motion_blur: Whole = ...,
        shutter: Number = ...,
        right_exposure: Number = ...,
        zoom: Number = ...,
        lens: Union[Literal["pinhole", "equidistant"], Arg] = ...,
        distortion_k1: Number = ...,
        distortion_k2: Number = ...,
        black_camera: Union[Literal["none", "left", "right"], Arg] = ...,
        black_first: Whole = ...,
        black_count: Whole = ...,
        incident: Union[Literal["none", "smoke", "blur", "jump", "covered"], Arg] = ...,
        incident_first: Whole = ...,
        incident_count: Whole = ...,
        tools: Whole = ...,
        tool_kinds: Text = ...,
        tool_motion: Union[Literal["sway", "still", "step", "ramp", "circle", "strokes", "leave", "cross"], Arg] = ...,
        drop_share: Number = ...,
        drop_views: Union[Literal["all", "left", "right"], Arg] = ...,
        late_share: Number = ...,
        late_ms: Number = ...,
        wide_factor: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Phantom:
        """Renders a tissue-like scene for two or four parallel cameras at a scope's tip, with exact ground truth.

        camera_pose: Pose of the left camera in the scene. Unconnected: the scripted motion.
        scene: Scene to render. (default "bowel")
        board: Pattern of the board in the scene `board`. (default "chessboard")
        seed: Seed of all random numbers: the same seed gives the same images on every machine. (0 to 1000000000; default 7)
        layout: Arrangement of the cameras. (default "stereo")
        width: Image width of each camera. (64 to 3840 px; default 640)
        height: Image height of each camera. (48 to 2160 px; default 480)
        baseline_mm: Distance between neighbouring cameras. (1 to 40 mm; default 15)
        distance_mm: Mean distance from the resting left camera to the tissue. (15 to 150 mm; default 50)
        rate_hz: Frames per second of media time. (1 to 240 Hz; default 30)
        relief: Height of the tissue's relief; 0 is a plane. No effect on `box` and `board`. (0 to 1 ratio; default 1)
        camera_path: How the scripted camera moves. (default "sway")
        path_mm: Diameter of the path `ring`. (1 to 100 mm; default 40)
        speed_mm_s: Maximum speed of the scripted camera; 0 keeps it still. (0 to 200 mm/s; default 10)
        breathing_mm: Amplitude of breathing. (0 to 5 mm; default 1)
        specular: Strength of specular highlights. (0 to 4 ratio; default 1)
        texture: Strength of vessels, mottling, flecks and grain; 0 is smooth tissue of one colour. (0 to 1 ratio; default 1)
        light: Light that reaches the sensors. Less light gives a darker and, with the same noise, noisier image. (0.01 to 4 ratio; default 1)
        noise: Strength of sensor noise; 1 is a good small sensor. (0 to 8 ratio; default 1)
        smoke: Density of smoke. (0 to 1 ratio; default 0)
        blood_drops: Number of blood drops on each lens. (0 to 32; default 0)
        motion_blur: Number of sub-frames averaged for motion blur; 1 is none. (1 to 16 frames; default 1)
        shutter: Share of the frame time for which the shutter is open; used if `motion_blur` is above 1. (0 to 1 ratio; default 0.5)
        right_exposure: Exposure of the right camera relative to the left one. (0.25 to 4 ratio; default 0.93)
        zoom: Focal length relative to that of the thesis's scope, which is 750 px at 640 columns. Smaller values widen the view: 0.45 with `lens = "equidistant"` is a field of view of 109 degrees. (0.3 to 2 ratio; default 1)
        lens: Lens model of every camera. Ground truth and `calibration` describe the views after rectification to pinholes of the same focal length. (default "pinhole")
        distortion_k1: First radial distortion coefficient, k1, of every camera's lens. (-0.5 to 0.5; default 0)
        distortion_k2: Second radial distortion coefficient, k2, of every camera's lens. (-0.5 to 0.5; default 0)
        black_camera: Camera whose image is black from `black_first` on. (default "none")
        black_first: First black frame. (0 to 1000000000 frames; default 0)
        black_count: Number of black frames. (0 to 1000000000 frames; default 10)
        incident: Incident that begins at `incident_first`. (default "none")
        incident_first: First frame of the incident. (0 to 1000000000 frames; default 20)
        incident_count: Number of frames of the incident. (1 to 1000000000 frames; default 10)
        tools: Number of instruments in the scene. (0 to 7; default 0)
        tool_kinds: Kinds of the instruments in order, separated by commas: grasper, bipolar, hook, scissors, clipper, irrigator, specimen_bag. Empty: all kinds in a seeded order. (default "")
        tool_motion: Movement of the first instrument. All but `sway` start in front of the centre of the image region that both cameras share, at 0.78 of `distance_mm`. (default "sway")
        drop_share: Share of ticks that are dropped, chosen by the seed. (0 to 1 ratio; default 0)
        drop_views: Views that are missing in a dropped tick. (default "all")
        late_share: Share of ticks that are delivered late, chosen by the seed; in live mode only. (0 to 1 ratio; default 0)
        late_ms: Delay of late ticks. Their capture time does not change. (0 to 1000 ms; default 20)
        wide_factor: Width of the `wide` view relative to one image. (1 to 4 ratio; default 2)"""

    def preview(
        self,
        image: Input[Literal["image"]],
        *,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Holds the newest frame for a viewer; counts frames.

        image: The image to show."""

    def proximity(
        self,
        tip: Inputs[Literal["tip"]],
        calibration: Input[Literal["calibration"]],
        depth: Input[Literal["depth"]] | None = None,
        cloud: Input[Literal["cloud"]] | None = None,
        instances: Input[Literal["instances"]] | None = None,
        detections: Input[Literal["detections"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        image: Input[Literal["image"]] | None = None,
        *,
        warn_mm: Number = ...,
        contact_mm: Number = ...,
        tips_mm: Number = ...,
        release_mm: Number = ...,
        min_ms: Number = ...,
        rim_px: Whole = ...,
        max_age_ms: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Proximity:
        """Measures how near tips are to tissue and to each other, and warns.

        tip: Tips in the left rectified camera's frame, mm, one per tool: two detections of one tip would count as two touching tips. Warnings follow the tool's number if it has one, otherwise the input.
        calibration: Calibration of the rectified views.
        depth: Depth of the left rectified view, mm. Without it `cloud` is used.
        cloud: Points of the left rectified view, mm, one per pixel.
        instances: Masks of the instruments. Connect one of `instances`, `detections` and `mask`.
        detections: Boxes around instruments, which are segmented by depth, and by colour where `image` is connected.
        mask: One mask of all instruments.
        image: Image in which boxes were found, bgr8.
        warn_mm: Distance to the tissue below which a tip counts as near. (0.1 to 50 mm; default 5)
        contact_mm: Distance to the tissue below which a tip counts as touching it. (-20 to 50 mm; default 1)
        tips_mm: Distance between tips below which they count as near. (0.1 to 100 mm; default 8)
        release_mm: Hysteresis: a warning ends at a distance larger by this than where it begins. (0 to 20 mm; default 1)
        min_ms: Time for which a distance must stay beyond a threshold before a warning begins or ends. (0 to 5000 ms; default 60)
        rim_px: Width of the border around instruments that is not used as tissue, because matchers mix both depths there. (0 to 64 px; default 6)
        max_age_ms: Age after which a surface, or a tip, counts as unknown. (0 to 10000 ms; default 300)"""

    def read_labels(
        self,
        image: Input[Literal["image"]],
        *,
        path: File = ...,
        pictures: File = ...,
        loop: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> ReadLabels:
        """Reads true boxes from VOC or YOLO files, one image after the other.

        image: Image of the source, such as `left` of `capture`. The labels with its number are read; boxes are scaled to its size.
        path: Folder or pattern (labels/*.txt, Annotations/*.xml) of YOLO or VOC labels. (default "")
        pictures: Folder or pattern of the images, as in the source. With it, labels are matched to images by name, else by number, and an image without labels shows nothing. Without it, the n-th file by number belongs to the n-th image, and no number may be missing. (default "")
        loop: Repeats the files from the first one, as `loop` of `capture`. (default False)"""

    def read_maps(
        self,
        image: Input[Literal["image"]],
        *,
        path: File = ...,
        pictures: File = ...,
        holds: Union[Literal["disparity", "depth"], Arg] = ...,
        divisor: Number = ...,
        loop: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> ReadMaps:
        """Reads true disparity or depth from files (NPY, PFM, TIFF, EXR, PNG), one map for each image.

        image: Image of the source, such as `left` of `capture`. The map with its number is read, and must have its size.
        path: Folder, pattern (truth/*.pfm or truth/%04d.png) or file: NPY, PFM, TIFF, EXR or PNG; a single file belongs to every image. Of TIFF files with three floats the third one is taken; SCARED's x, y, z are of the raw left camera, so that z fits no rectified view: `data_set` moves them there. (default "")
        pictures: Folder or pattern of the images, as in the source. With it, maps are matched to images by name, else by number, and an image without a map has no ground truth. Without it, the n-th map by number belongs to the n-th image, and no number may be missing. (default "")
        holds: What the files hold. (default "disparity")
        divisor: Divisor that converts the numbers in the files to px or mm. 0: 256 for disparity in 16-bit PNG files, as KITTI writes it, and 1 for everything else. (0 to 1000000; default 0)
        loop: Repeats the files from the first one, as `loop` of `capture`. (default False)"""

    def rectify(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        calibration: Input[Literal["calibration"]] | None = None,
        *,
        bypass: Flag = ...,
        uncalibrated: Union[Literal["refuse", "pass"], Arg] = ...,
        scale: Whole = ...,
        find_rim: Flag = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Rectify:
        """Turns both views so that a point lies on one row in both.

        left: Left view, not rectified.
        right: Right view of the same instant.
        calibration: Calibration of the cameras; the newest one is used until another arrives.
        bypass: Passes the views on unchanged: for views that another program has rectified. (default False)
        uncalibrated: What becomes of views without a calibration. (default "refuse")
        scale: Factor by which views are shrunk, their calibration with them: each pixel is the mean of a block. All that follows works on fewer pixels. 0 finds the smallest factor whose views are at most 1280 px wide: 2 for 1920 px, 3 for 3840. (0 to 8; default 1)
        find_rim: Finds the dark rim of round and bordered scopes, from what stays dark over time and has the shape of a rim, and leaves it out of the masks. (default True)
        device: What shrinks and turns the views. A GPU makes the same bytes; it pays for views of 1920x1080 and more. Without one the processor does it, with a warning. (default "cpu")"""

    def register_grid(
        self,
        disparity: Input[Literal["disparity"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        left: Input[Literal["image"]] | None = None,
        right: Input[Literal["image"]] | None = None,
        *,
        rows: Whole = ...,
        columns: Whole = ...,
        point: Union[Literal["median", "peak"], Arg] = ...,
        scale: Whole = ...,
        least_valid: Number = ...,
        ransac_px: Number = ...,
        min_inliers: Whole = ...,
        stability_px: Number = ...,
        anchor_fit: Number = ...,
        max_rms_px: Number = ...,
        hold_frames: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> RegisterGrid:
        """Finds the homography between two overlapping views from a grid on their disparity, where tissue has no features.

        disparity: Disparity of the left rectified view, as large as the views or smaller by an integer factor.
        calibration: Calibration of the views. The homography is between these views, not between the rectified ones, unless the calibration states that they are rectified. Unconnected: they are assumed to be rectified.
        left: Left view. With `right` connected too, a tick without a disparity is registered by features.
        right: Right view of the same instant.
        rows: Number of rows of the grid on the overlap. (2 to 100; default 9)
        columns: Number of columns of the grid on the overlap. (2 to 200; default 24)
        point: Point that each cell contributes. (default "median")
        scale: Spacing of the pixels that are read in a cell. (1 to 16 px; default 3)
        least_valid: Minimum share of a cell's pixels that have a disparity. (0 to 1 ratio; default 0.3)
        ransac_px: Maximum reprojection error of an inlier. (0.2 to 40 px; default 4)
        min_inliers: Minimum number of inliers of a registration. (4 to 1000 points; default 12)
        stability_px: Keeps the previous homography while its median error on the new inliers is below this; 0 fits every frame independently. (0 to 10 px; default 0.8)
        anchor_fit: Weight of the previous frame's homography relative to all inliers. It stabilises the parts of the image that the overlap does not determine; 0 fits only the inliers. (0 to 4 ratio; default 1)
        max_rms_px: Maximum root mean square error of the inliers. A worse homography is not used: the previous one is held, then lost. 0 uses all. (0 to 100 px; default 18)
        hold_frames: Number of consecutive failed frames during which the previous homography counts as held; after that it is lost. (0 to 1000 frames; default 5)"""

    def register_opencv(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        *,
        detector: Union[Literal["sift", "akaze", "orb"], Arg] = ...,
        max_points: Whole = ...,
        threshold: Number = ...,
        work_megapixels: Number = ...,
        ratio: Number = ...,
        mutual: Flag = ...,
        ransac_px: Number = ...,
        min_inliers: Whole = ...,
        max_rms_px: Number = ...,
        threads: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> RegisterOpencv:
        """Finds the homography between two overlapping views with OpenCV: whole frames, brute-force matches, RANSAC.

        left: Left view; the homography maps to its pixels.
        right: Right view of the same instant.
        detector: Kind of features. (default "sift")
        max_points: Maximum number of keypoints per view, strongest first; 0 uses OpenCV's default. (0 to 100000 points; default 0)
        threshold: Threshold of the detector; 0 uses OpenCV's default (0.04, 0.001, 20). (0 to 1000; default 0)
        work_megapixels: Size to which larger views are reduced for the search, in megapixels; 0 searches at full resolution. OpenCV's stitcher uses 0.6. (0 to 10; default 0)
        ratio: Maximum ratio of the best to the second-best distance of a match. (0.3 to 1 ratio; default 0.75)
        mutual: Keeps a match only when each point is the other's best. Matches in both directions, which takes twice as long. (default True)
        ransac_px: Maximum reprojection error of an inlier. (0.2 to 20 px; default 3)
        min_inliers: Minimum number of inliers of a registration. (4 to 1000 points; default 8)
        max_rms_px: Maximum root mean square error of the inliers. A worse homography is not used: the state is lost. 0 uses all. (0 to 100 px; default 18)
        threads: Number of OpenCV's threads. Applies to the whole process while this node is open. (1 to 64; default 1)"""

    def register_surf(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        *,
        roi: Flag = ...,
        scale: Whole = ...,
        hessian_threshold: Number = ...,
        max_points: Whole = ...,
        spread: Flag = ...,
        second_look: Flag = ...,
        octaves: Whole = ...,
        upright: Flag = ...,
        ratio: Number = ...,
        ransac_px: Number = ...,
        min_inliers: Whole = ...,
        stability_px: Number = ...,
        anchor_fit: Number = ...,
        max_rms_px: Number = ...,
        hold_frames: Whole = ...,
        strips: Flag = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> RegisterSurf:
        """Finds the homography between two overlapping views by SURF and RANSAC, on the overlap seen last.

        left: Left view; the homography maps to its pixels.
        right: Right view of the same instant.
        roi: Searches only the overlap of the previous frame, reduced by `scale`. Off: searches whole frames at full size. (default True)
        scale: Factor by which the search regions are reduced when `roi` is on. (1 to 8; default 2)
        hessian_threshold: Minimum determinant of the Hessian of a keypoint. (1 to 20000; default 50)
        max_points: Maximum number of keypoints per view, strongest first. (16 to 10000 points; default 400)
        spread: Distributes the keypoints over the search region: each cell of a 6 x 4 grid takes its share before the strongest fill the rest. (default True)
        second_look: Locates each keypoint more precisely with Gaussian derivatives; doubles the time. (default False)
        octaves: Octaves of the scale space. (1 to 4; default 4)
        upright: Ignores the orientation of keypoints, for cameras that are hardly rotated relative to each other. (default True)
        ratio: Maximum ratio of the best to the second-best distance of a match. (0.3 to 1 ratio; default 0.8)
        ransac_px: Maximum reprojection error of an inlier. (0.2 to 20 px; default 5)
        min_inliers: Minimum number of inliers of a registration. (4 to 1000 points; default 8)
        stability_px: Keeps the previous homography while its median error on the new inliers is below this; 0 fits every frame independently. (0 to 10 px; default 0.8)
        anchor_fit: Weight of the previous frame's homography relative to all inliers. It stabilises the parts of the image that the overlap does not determine; 0 fits only the inliers. (0 to 4 ratio; default 1)
        max_rms_px: Maximum root mean square error of the inliers. A worse homography is not used: the previous one is held, then lost. 0 uses all. (0 to 100 px; default 18)
        hold_frames: Number of consecutive failed frames during which the previous homography counts as held; after that it is lost. (0 to 1000 frames; default 5)
        strips: Also finds narrow overlaps: when whole views do not match, searches facing sides at full size. Only with `roi`. (default False)"""

    def reproject(
        self,
        image: Input[Literal["image"]],
        disparity: Input[Literal["disparity"]],
        calibration: Input[Literal["calibration"]],
        confidence: Input[Literal["confidence"]] | None = None,
        *,
        near_mm: Number = ...,
        far_mm: Number = ...,
        min_confidence: Number = ...,
        surface_step_px: Number = ...,
        min_neighbours: Whole = ...,
        max_hole: Number = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Reproject:
        """Turns disparities into depth and coloured points in mm.

        image: Rectified left view, gray8 or bgr8, for the colours of the points.
        disparity: Disparity of the left view.
        calibration: Calibration of the rectified views.
        confidence: Confidence of the disparity; pixels below `min_confidence` are dropped.
        near_mm: Smallest depth that is kept. (0.1 to 10000 mm; default 5)
        far_mm: Largest depth that is kept. (1 to 100000 mm; default 500)
        min_confidence: Confidence below which a pixel is dropped, where a confidence map is connected. (0 to 1 ratio; default 0.05)
        surface_step_px: Largest step of disparity between neighbours of one surface. (0.01 to 64 px; default 1)
        min_neighbours: Smallest number of the eight neighbours on the same surface: removes flying pixels; 0 keeps all. (0 to 8; default 5)
        max_hole: Largest hole of a surface that is filled in the cloud, as a share of all pixels; 0 fills none. `depth` has what was measured only. (0 to 0.05 ratio; default 0.0015)
        device: What computes depth and points, with the same values to the last bits. A GPU pays when its maps and its cloud stay there; the processor, which looks for small holes of the cloud, reads which depths are unknown, and those around holes. Without a GPU it does it all, with a warning. (default "cpu")"""

    def ros2_bag(
        self,
        *,
        path: File = ...,
        left: Text = ...,
        right: Text = ...,
        depth: Text = ...,
        disparity: Text = ...,
        cloud: Text = ...,
        detections: Text = ...,
        pose: Text = ...,
        joints: Text = ...,
        tolerance_ms: Number = ...,
        bit_depth: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Ros2Bag:
        """Plays a bag of ROS 2: images in pairs with their cameras, depth, disparity, points, boxes, poses, joints.

        path: Folder of a bag with MCAP files, or one MCAP file. (default "")
        left: Topic of the left view. Empty: the first image topic with `left` in its name, or the only one there is. (default "")
        right: Topic of the right view. Empty: the first image topic with `right` in its name. (default "")
        depth: Topic of depth. Empty: the first image topic with `depth` in its name. (default "")
        disparity: Topic of disparity. Empty: the first one. (default "")
        cloud: Topic of points. Empty: the first one. (default "")
        detections: Topic of boxes. Empty: the first one. (default "")
        pose: Topic of poses. Empty: the first one. (default "")
        joints: Topic of joints. Empty: the first one. (default "")
        tolerance_ms: Maximum difference of the stamps of two views of a pair. (0 to 1000 ms; default 5)
        bit_depth: Bit depth of images with more than eight bits: 12 makes 4095 white. 0 finds it from the values and logs it. (0 to 16; default 0)"""

    def ros2_publish(
        self,
        left: Input[Literal["image"]] | None = None,
        right: Input[Literal["image"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        depth: Input[Literal["depth"]] | None = None,
        disparity: Input[Literal["disparity"]] | None = None,
        cloud: Input[Literal["cloud"]] | None = None,
        detections: Input[Literal["detections"]] | None = None,
        pose: Input[Literal["pose"]] | None = None,
        joints: Input[Literal["joints"]] | None = None,
        *,
        namespace: Text = ...,
        domain: Whole = ...,
        networks: Union[Literal["loopback", "all"], Arg] = ...,
        reliable: Flag = ...,
        queue: Whole = ...,
        pictures: Union[Literal["raw", "jpeg", "both"], Arg] = ...,
        stamps: Union[Literal["clock", "capture"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Publishes images, cameras, depth, disparity, points, boxes, poses and joints as topics of ROS 2.

        left: Left view, as `left/image_raw`.
        right: Right view, as `right/image_raw`.
        calibration: Both cameras, as `left/camera_info` and `right/camera_info`; the disparity's focal length and baseline.
        depth: Depth, as `depth/image`, in m.
        disparity: Disparity, as `disparity`.
        cloud: Points, as `points`, in m.
        detections: Boxes, as `detections`.
        pose: A pose, as `pose`, in m.
        joints: Joints of an arm, as `joint_states`.
        namespace: Prefix of the name of every topic. (default "/panoscope")
        domain: DDS domain, the ROS_DOMAIN_ID of other programs. (0 to 232; default 0)
        networks: Which machines can be reached. (default "loopback")
        reliable: Sends lost messages again; readers may still ask for best effort. (default True)
        queue: Number of messages per topic that are kept for slow readers. (1 to 100; default 5)
        pictures: How 8-bit images are sent. (default "raw")
        stamps: Origin of the stamps. (default "clock")"""

    def ros2_subscribe(
        self,
        *,
        left: Text = ...,
        right: Text = ...,
        depth: Text = ...,
        disparity: Text = ...,
        cloud: Text = ...,
        detections: Text = ...,
        pose: Text = ...,
        joints: Text = ...,
        tolerance_ms: Number = ...,
        bit_depth: Whole = ...,
        domain: Whole = ...,
        networks: Union[Literal["loopback", "all"], Arg] = ...,
        reliable: Flag = ...,
        queue: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Ros2Subscribe:
        """Receives images, cameras, depth, disparity, points, boxes, poses and joints from topics of ROS 2.

        left: Topic of the left view, such as /camera/left/image_raw, or of the only one. A topic that ends with /compressed has JPEG or PNG. Its camera is read from camera_info in the same namespace. (default "")
        right: Topic of the right view. (default "")
        depth: Topic of depth: 32FC1 in m, 16UC1 in mm. (default "")
        disparity: Topic of a DisparityImage. (default "")
        cloud: Topic of a PointCloud2. (default "")
        detections: Topic of a Detection2DArray. (default "")
        pose: Topic of a PoseStamped. (default "")
        joints: Topic of a JointState. (default "")
        tolerance_ms: Maximum difference of the stamps of two views of a pair. (0 to 1000 ms; default 5)
        bit_depth: Bit depth of images with more than eight bits: 12 makes 4095 white. 0 finds it from the values and logs it. (0 to 16; default 0)
        domain: DDS domain, the ROS_DOMAIN_ID of other programs. (0 to 232; default 0)
        networks: Which machines can be reached. (default "loopback")
        reliable: Requests lost messages again; publishers of best effort do not match then. (default False)
        queue: Maximum number of waiting messages per topic. (1 to 100; default 5)"""

    def screen(
        self,
        main: Input[Literal["image"]],
        side: Inputs[Literal["image"]] | None = None,
        *,
        width: Whole = ...,
        height: Whole = ...,
        side_share: Number = ...,
        gap_px: Whole = ...,
        titles: Text = ...,
        text_scale: Number = ...,
        max_age_ms: Whole = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Screen:
        """Puts one large image and smaller ones next to it on a screen.

        main: The large image: bgr8, gray8 or rgba8.
        side: Smaller images, next to the large one and below it.
        width: Width of the screen. (64 to 7680 px; default 1280)
        height: Height of the screen. (64 to 4320 px; default 720)
        side_share: Width of a column with all smaller images, as a share of the screen's width. 0 finds the arrangement that fills the screen: a column next to the large image, a row below it, or both. (0 to 0.5 ratio; default 0)
        gap_px: Margin around images on a screen 720 px high; it grows with the screen. (0 to 64 px; default 4)
        titles: Titles separated by semicolons, the large image's first. Each is in a strip below its image; an image without a title has no strip. (default "")
        text_scale: Scale of the titles on a screen 720 px high, with which it grows: capital letters are six times as many px high. (0.5 to 20; default 2)
        max_age_ms: Age of its light from which an image is dimmed and framed, with its age in the middle. 0 shows every image as it is. (0 to 60000 ms; default 1000)
        device: What brings images to the size of their places. A GPU does it with bgr8 images that were made there and are larger than their places: only the small images are read. All other images are placed by the processor, which does everything without a GPU, with a warning. (default "cpu")"""

    def side_by_side(
        self,
        views: Inputs[Literal["image"]],
        *,
        columns: Whole = ...,
        cell_width: Whole = ...,
        cell_height: Whole = ...,
        gap_px: Whole = ...,
        titles: Text = ...,
        text_scale: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> SideBySide:
        """Puts several images with titles into one.

        views: Images, row after row: bgr8, gray8 or rgba8.
        columns: Images per row; 0 makes the grid about as wide as it is high. (0 to 64; default 0)
        cell_width: Width of a cell; 0 takes the first image's. (0 to 8192 px; default 0)
        cell_height: Height of a cell; 0 takes the first image's. (0 to 8192 px; default 0)
        gap_px: Gap between images. (0 to 256 px; default 4)
        titles: Titles in the order of the images, separated by semicolons. Each is in a strip below its image; without titles there are no strips. (default "")
        text_scale: Scale of the titles: capital letters are six times as many px high. (0.5 to 20; default 2)"""

    def skill(
        self,
        tip: Inputs[Literal["tip"]],
        camera_pose: Input[Literal["pose"]] | None = None,
        phase: Input[Literal["text"]] | None = None,
        proximity: Input[Literal["table"]] | None = None,
        *,
        tools: Union[Literal["input", "track", "class"], Arg] = ...,
        min_score: Number = ...,
        max_gap_ms: Number = ...,
        window_ms: Number = ...,
        rest_mm_s: Number = ...,
        rest_ms: Number = ...,
        knot_ms: Number = ...,
        touch_mm: Number = ...,
        touch_ms: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Skill:
        """Measures surgical skill from the tracks of tips: path, economy, smoothness, idleness, working room, both hands.

        tip: Tips in the left rectified camera's frame, mm. Connect one `tip_track` per hand.
        camera_pose: Pose of the left camera in the scene. Without it the camera's own movement counts as the tips' movement.
        phase: Name of the current phase of the operation.
        proximity: Table of `proximity`. With it, touches of the tissue are counted.
        tools: Which tips belong to one tool. (default "input")
        min_score: Minimum score of a tip that is used. The score of a predicted tip falls with time. (0 to 1 ratio; default 0.3)
        max_gap_ms: Maximum gap between two tips that is bridged. After a longer gap the tool was out of view. (10 to 5000 ms; default 250)
        window_ms: Half the width of the window over which speed is computed. (10 to 1000 ms; default 80)
        rest_mm_s: Speed below which a tool counts as resting. (0.1 to 50 mm/s; default 3)
        rest_ms: Minimum duration of a rest that counts as idle time. (10 to 10000 ms; default 300)
        knot_ms: Distance between the knots of the spline from which jerk is computed. (20 to 1000 ms; default 100)
        touch_mm: Distance to the tissue below which a tip counts as touching it. (-5 to 20 mm; default 1.5)
        touch_ms: Minimum duration of a touch. (0 to 10000 ms; default 200)"""

    def smooth(
        self,
        image: Input[Literal["image"]],
        past: Input[Literal["image"]] | None = None,
        *,
        past_weight: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Smooth:
        """Averages images over time.

        image: The newest image.
        past: Output of this node at the previous tick: wire its own output here with `delay = 1`.
        past_weight: Weight of the past, in 1/256. (0 to 255; default 192)"""

    def stereo_bm(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        roi: Input[Literal["roi"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        mask_left: Input[Literal["mask"]] | None = None,
        mask_right: Input[Literal["mask"]] | None = None,
        *,
        auto_offset: Flag = ...,
        auto_range: Flag = ...,
        min_disparity_px: Whole = ...,
        search_px: Whole = ...,
        drift_px: Number = ...,
        speckle_area_px: Whole = ...,
        rectified_only: Flag = ...,
        block_px: Whole = ...,
        prefilter_cap: Whole = ...,
        texture: Whole = ...,
        uniqueness: Whole = ...,
        left_right_px: Whole = ...,
        scale: Whole = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> StereoBm:
        """Block matching: disparity maps of both views of a rectified pair, with the search's offset found by itself.

        left: Rectified left view.
        right: Rectified right view of the same instant, same size.
        roi: Part of the left view that is matched; the whole view when unconnected.
        calibration: Calibration of the rectified views; read only with `rectified_only`.
        mask_left: What of the left view is lit, not 0. Disparities whose blocks reach beyond stay unknown; without it all is lit.
        mask_right: What of the right view is lit.
        auto_offset: Finds the offset of the search from the region that both views show. (default True)
        auto_range: Searches each part of the picture over its own range when one search does not hold what the views show. Needs `auto_offset`. (default True)
        min_disparity_px: Smallest disparity that is searched when the offset is not found from the pictures. (-1024 to 2048 px; default 0)
        search_px: Number of disparities that are searched. (32 to 512 px; default 128)
        drift_px: Warns that the calibration does not fit when the median distance of matched points from their rows exceeds this; 0 never warns. (0 to 20 px; default 1)
        speckle_area_px: Removes patches of the left map with at most this many pixels as wrong matches; 0 keeps all. (0 to 10000 px; default 0)
        rectified_only: Makes no map in a tick without `calibration`: views that nobody has rectified cannot be matched along rows. (default False)
        block_px: Side of the square window in which views are compared. (3 to 31 px; default 15)
        prefilter_cap: Limit of the horizontal edge response that is compared; 0 compares gray values. (0 to 31; default 31)
        texture: Smallest edge response of a window that is matched; 0 matches all. (0 to 20000; default 10)
        uniqueness: Drops a pixel when another disparity costs at most this much more than the best one; 0 keeps all. (0 to 100 %; default 15)
        left_right_px: Largest difference between the disparities of both views; -1 does not check. (-1 to 64 px; default 1)
        scale: Factor by which views are shrunk before they are matched: a coarser map, much faster. 0 finds it from the width: 1 below 640 px, 2 from 640, 3 from 1440, 4 from 2560. (0 to 8; default 1)
        device: What matches the views, with the same disparities. A GPU pays for large views. Without one the processor matches, with a warning. (default "cpu")"""

    def stereo_net(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        matched: Input[Literal["disparity"]] | None = None,
        mask_left: Input[Literal["mask"]] | None = None,
        *,
        model: File = ...,
        max_error_px: Number = ...,
        scale: Whole = ...,
        threads: Whole = ...,
        provider: Union[Literal["cpu", "cuda", "tensorrt", "openvino", "rocm", "migraphx"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> StereoNet:
        """A network that matches two rectified views, with a matcher's map as a hint, and states its error.

        left: Rectified left view, bgr8 or gray8.
        right: Rectified right view of the same instant, same size.
        matched: Disparity of the left view by a matcher or a filter, px. Without it the network matches alone, which is less exact.
        mask_left: What of the left view is lit, not 0. The map is unknown elsewhere; without it all is lit.
        model: ONNX file of the network. (default "models/stereo_net.onnx")
        max_error_px: Pixels whose expected error is larger are unknown; 0 keeps all. (0 to 100 px; default 0)
        scale: Factor by which views and map are shrunk before the network. 0 finds it from the width (1 below 1440 px, 2 from 1440, 3 from 2160, 4 from 2880) and from the range of `matched`, of which the network reaches 216 px. (0 to 8; default 0)
        threads: Number of threads of the network; 0 uses as many as the host has. (0 to 64; default 0)
        provider: Execution provider: the processor, or an accelerator if ONNX Runtime's library supports it and finds a device. Otherwise the processor is used, with a warning. (default "cpu")"""

    def stereo_opencv(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        *,
        method: Union[Literal["bm", "sgbm"], Arg] = ...,
        auto_offset: Flag = ...,
        min_disparity_px: Whole = ...,
        search_px: Whole = ...,
        block_px: Whole = ...,
        own_checks: Flag = ...,
        threads: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> StereoOpencv:
        """OpenCV's block or semi-global matching, left and right.

        left: Rectified left view.
        right: Right view of the same instant, same size.
        method: Matching algorithm. (default "bm")
        auto_offset: Finds the offset of the search from the region that both views share. (default True)
        min_disparity_px: Minimum disparity searched when the offset is not found from the images. (-1024 to 1500 px; default 0)
        search_px: Width of the disparity search. (16 to 512 px; default 64)
        block_px: Side of the window: at least 5 for block matching. (3 to 31 px; default 15)
        own_checks: Checks of texture and uniqueness by block matching. OpenCV's sample `disparity_filtering` disables them in front of `disparity_wls_opencv`, which evaluates the matches itself. (default True)
        threads: Number of OpenCV's threads. Applies to the whole process while this node is open. (1 to 64; default 1)"""

    def stereo_sgbm(
        self,
        left: Input[Literal["image"]],
        right: Input[Literal["image"]],
        roi: Input[Literal["roi"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        mask_left: Input[Literal["mask"]] | None = None,
        mask_right: Input[Literal["mask"]] | None = None,
        *,
        auto_offset: Flag = ...,
        auto_range: Flag = ...,
        min_disparity_px: Whole = ...,
        search_px: Whole = ...,
        drift_px: Number = ...,
        speckle_area_px: Whole = ...,
        rectified_only: Flag = ...,
        block_px: Whole = ...,
        prefilter_cap: Whole = ...,
        small_penalty: Whole = ...,
        large_penalty: Whole = ...,
        diagonals: Flag = ...,
        uniqueness: Whole = ...,
        left_right_px: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> StereoSgbm:
        """Semi-global matching: disparity maps of both views of a rectified pair, with the search's offset found by itself.

        left: Rectified left view.
        right: Rectified right view of the same instant, same size.
        roi: Part of the left view that is matched; the whole view when unconnected.
        calibration: Calibration of the rectified views; read only with `rectified_only`.
        mask_left: What of the left view is lit, not 0. Disparities whose blocks reach beyond stay unknown; without it all is lit.
        mask_right: What of the right view is lit.
        auto_offset: Finds the offset of the search from the region that both views show. (default True)
        auto_range: Searches each part of the picture over its own range when one search does not hold what the views show. Needs `auto_offset`. (default True)
        min_disparity_px: Smallest disparity that is searched when the offset is not found from the pictures. (-1024 to 2048 px; default 0)
        search_px: Number of disparities that are searched. (32 to 512 px; default 128)
        drift_px: Warns that the calibration does not fit when the median distance of matched points from their rows exceeds this; 0 never warns. (0 to 20 px; default 1)
        speckle_area_px: Removes patches of the left map with at most this many pixels as wrong matches; 0 keeps all. (0 to 10000 px; default 0)
        rectified_only: Makes no map in a tick without `calibration`: views that nobody has rectified cannot be matched along rows. (default False)
        block_px: Side of the square window in which views are compared. (3 to 7 px; default 5)
        prefilter_cap: Limit of the horizontal edge response that is compared; 0 compares gray values. (0 to 31; default 31)
        small_penalty: Penalty of a change of disparity by 1 px; must be below `large_penalty`. (1 to 100; default 10)
        large_penalty: Penalty of a larger change of disparity. (2 to 120; default 100)
        diagonals: Aggregates along diagonal paths too: smoother, slower. (default True)
        uniqueness: Drops a pixel when another disparity costs at most this much more than the best one; 0 keeps all. (0 to 100 %; default 5)
        left_right_px: Largest difference between the disparities of both views; -1 does not check. (-1 to 64 px; default 1)"""

    def stream(
        self,
        image: Input[Literal["image"]],
        *,
        serve: Flag = ...,
        address: Text = ...,
        port: Whole = ...,
        path: Text = ...,
        codec: Union[Literal["h264", "hevc", "mjpg"], Arg] = ...,
        bitrate: Whole = ...,
        key_interval: Whole = ...,
        quality: Whole = ...,
        push: Text = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Serves its input as live video over RTSP, or sends it to a server.

        image: Frames to send: bgr8, gray8 or rgba8.
        serve: Serves RTSP at rtsp://ADDRESS:PORT/PATH. Several `stream` nodes share a port with different paths. (default True)
        address: Address of this machine to listen on. 127.0.0.1 serves only programs on this machine. 0.0.0.0 listens on all networks. There is no password: anybody who reaches the port sees the video. (default "127.0.0.1")
        port: TCP port to listen on. 0 takes a free port, which the log names. (0 to 65535; default 8554)
        path: Path of the stream on its server. (default "/live")
        codec: Compression of the stream. (default "h264")
        bitrate: Bit rate of `h264` and `hevc` at 30 frames per second. (50 to 100000 kbit/s; default 4000)
        key_interval: Distance of keyframes of `h264` and `hevc`. A client that joins gets one at once; after a lost packet the image is complete again with the next one. (1 to 1000 frames; default 30)
        quality: Quality of `mjpg`. (1 to 100 %; default 80)
        push: Additional address to send the stream to: rtsp://HOST:PORT/PATH, a server that accepts recordings, or udp://HOST:PORT, as RTP packets. Empty: none. (default "")"""

    def tip_track(
        self,
        tip: Inputs[Literal["tip"]],
        hidden: Inputs[Literal["tip"]] | None = None,
        camera_pose: Input[Literal["pose"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        *,
        acceleration: Number = ...,
        gate: Number = ...,
        lateral_px: Number = ...,
        disparity_px: Number = ...,
        min_score: Number = ...,
        max_gap_ms: Number = ...,
        switch_ms: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> TipTrack:
        """Tracks the leading tool's tip in space: filters it, distinguishes it from other tips, predicts it over short gaps.

        tip: Tips of one or more detectors, mm, in the left rectified camera's frame at the time of their images. Wire a detector that is slower than the camera with `align = "latest"`: each of its tips is used once, with the age of its image.
        hidden: Tips that another tool hides: the output `hidden` of `tool_tip`. A leading tool whose tip is hidden keeps the lead for up to 5 s.
        camera_pose: Pose of the left camera in the scene. Without it the camera's own movement counts as the tip's movement.
        calibration: Calibration of the rectified views, for the uncertainty of depth and for the pixels of predicted tips.
        acceleration: Standard deviation of a tool's unknown acceleration, mm/s^2. Higher values follow faster and are less smooth. (1 to 5000; default 200)
        gate: Squared Mahalanobis distance above which a detection does not belong to this tip; 16.3 accepts 99.9 % of the true ones. (1 to 200; default 16.3)
        lateral_px: Standard deviation of a tip's position in the image. (0.05 to 20 px; default 1)
        disparity_px: Standard deviation of a tip's disparity. (0.05 to 20 px; default 0.5)
        min_score: Minimum score of a tip that is used. (0 to 1 ratio; default 0.3)
        max_gap_ms: Maximum duration of a prediction without a detection; after it the tip is lost. (0 to 2000 ms; default 300)
        switch_ms: Time for which only other tools must be seen before one of them leads. (0 to 10000 ms; default 600)"""

    def tool_tip(
        self,
        detections: Input[Literal["detections"]] | None = None,
        instances: Input[Literal["instances"]] | None = None,
        keypoints: Input[Literal["table"]] | None = None,
        image: Input[Literal["image"]] | None = None,
        right: Input[Literal["image"]] | None = None,
        depth: Input[Literal["depth"]] | None = None,
        disparity: Input[Literal["disparity"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        *,
        class_: Text = ...,
        min_score: Number = ...,
        keep_score: Number = ...,
        keypoint_score: Number = ...,
        keypoint_distance: Number = ...,
        radius_px: Whole = ...,
        max_age_ms: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> ToolTip:
        """Finds the leading tool's tip, in px and in mm.

        detections: Boxes of tools in the left rectified view. Boxes of a detector that is slower than the camera (wired with `align = "latest"`) are moved along with the tip, and the tool is segmented in the image of this tick: a tip is as new as `image`, not as its box.
        instances: Tools with masks; used instead of boxes.
        keypoints: Keypoints of the boxes, from the output `keypoints` of the same `yolo`, with the same `align`. The first keypoint of a box is its tip where the tool's end in the image is missing or far from it (`keypoint_score`). Unused with masks.
        image: Image in which tools were found, bgr8. With it, or with depth, the tool is segmented inside its box and its end is the tip. Without both, the tip is the end of the box, wrong by up to half the box's width. The image also shows on which side the shaft of a box or mask goes on or leaves the view: the tip is on the other one.
        right: Right rectified view of the same tick, bgr8. With it the depth of a segmented tool end is found by comparing both views. Tool ends are often thinner than a matcher's window, which returns the depth of the tissue there.
        depth: Depth of the left rectified view, mm, for the position in space.
        disparity: Disparity of the left rectified view, px, used if no depth is connected. Connect the matcher's map: filters fill unmatched pixels and so mix a thin tool end with the tissue behind it.
        calibration: Calibration of the rectified views, for the position in space.
        class_: Name of the class to follow; empty takes any. (default "")
        min_score: Minimum score of a tool. Without a given class, the scores of overlapping boxes of several classes are added. (0 to 1 ratio; default 0.3)
        keep_score: Minimum score of a box that overlaps the previous box of the leading tool: a weak box at the position of a certain tool is that tool (after Zhang et al. 2022, ByteTrack). (0 to 1 ratio; default 0.1)
        keypoint_score: Minimum score of a keypoint that replaces the end of the segmented tool. 1: keypoints are not used. (0 to 1 ratio; default 0.35)
        keypoint_distance: Minimum distance of such a keypoint from the end of the segmented tool, as a share of the diagonal of the box: nearer, the end is used. 0 always uses the keypoint, which is more accurate in real images without depth and less accurate in rendered ones. (0 to 1 ratio; default 0.35)
        radius_px: Radius around the tip within which depth is read. (1 to 64 px; default 6)
        max_age_ms: Maximum age of a box that is used, and time for which the last box is used while the detector finds none. (0 to 1000 ms; default 300)"""

    def trajectory(
        self,
        image: Input[Literal["image"]],
        tip: Input[Literal["tip"]] | None = None,
        camera_pose: Input[Literal["pose"]] | None = None,
        calibration: Input[Literal["calibration"]] | None = None,
        detections: Input[Literal["detections"]] | None = None,
        *,
        length: Whole = ...,
        goal_mm: Number = ...,
        show_box: Flag = ...,
        box_share: Number = ...,
        line_px: Number = ...,
        text_scale: Number = ...,
        device: Union[Literal["cpu", "gpu"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Trajectory:
        """Draws the trajectory of a tool's tip on the image and in a box.

        image: The left rectified view.
        tip: The tip in the left rectified camera's frame, mm.
        camera_pose: Pose of the left camera in the scene. Without it the trajectory is drawn relative to the camera.
        calibration: Calibration of the rectified views, to project positions to pixels.
        detections: Instruments that the box does not cover.
        length: Length of the trajectory. (2 to 3000 frames; default 240)
        goal_mm: Marks the position at which an arm keeps the tip: the middle of what both cameras see, at this distance from the left camera. Without `camera_pose` there is no arm and no mark; 0 draws none. (0 to 200 mm; default 66)
        show_box: Also draws the trajectory in a box, in perspective. (default True)
        box_share: Width of the box, as a share of the image's width. (0.1 to 1 ratio; default 0.3)
        line_px: Width of lines in images up to 640 px wide; in wider ones it grows with the image. (0.5 to 20 px; default 2)
        text_scale: Scale of text: capital letters are six times as many px high. (0.5 to 20; default 1.5)
        device: Where it is drawn. A GPU draws on images that were made there: only the parts with lines come to the processor, and go back. Without a GPU the processor does it, with a warning. (default "cpu")"""

    def transpose(
        self,
        image: Input[Literal["image"]] | None = None,
        disparity: Input[Literal["disparity"]] | None = None,
        *,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Transpose:
        """Swaps rows and columns of an image or a disparity map, so that views above one another can be matched.

        image: Image to transpose.
        disparity: Disparity map to transpose, px, NaN where unmatched."""

    def turntable(
        self,
        cloud: Input[Literal["cloud"]],
        calibration: Input[Literal["calibration"]] | None = None,
        drifted: Input[Literal["scalar"]] | None = None,
        *,
        width: Whole = ...,
        height: Whole = ...,
        yaw_deg: Number = ...,
        pitch_deg: Number = ...,
        swing_deg: Number = ...,
        period: Whole = ...,
        zoom: Number = ...,
        step: Whole = ...,
        max_gradient: Number = ...,
        shading: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Turntable:
        """Shows a point cloud as a surface that turns, with a ruler in mm.

        cloud: Points of `reproject`, mm. Those that were filled in are drawn darker.
        calibration: Calibration of the rectified views, for the baseline. Without it 5 mm is assumed, the baseline of a narrow scope.
        drifted: Above 0 while the calibration does not fit the views, as a matcher reports it. No length is shown then.
        width: Width of the image. (16 to 4096 px; default 640)
        height: Height of the image. (16 to 4096 px; default 480)
        yaw_deg: Mean angle of the turn about the vertical axis; 0 is the camera's own direction. (-180 to 180 deg; default 0)
        pitch_deg: Angle about the horizontal axis; positive angles look from above. (-89 to 89 deg; default 20)
        swing_deg: Angle by which it turns to each side; 180 is a full turn. (0 to 180 deg; default 40)
        period: Number of images for one turn to and fro. (2 to 100000 frames; default 240)
        zoom: Magnification; 1 fills the image when seen from the front. (0.1 to 20 ratio; default 0.9)
        step: Spacing of the points that form the surface. 0 takes as many as the image can show: one for every third of its columns. (0 to 16 px; default 2)
        max_gradient: Maximum change of disparity per px of distance between neighbours of one surface; others are not connected. (0.1 to 100 ratio; default 1.5)
        shading: Strength of the shading of surfaces that face away. (0 to 1 ratio; default 0.6)"""

    def webrtc(
        self,
        image: Input[Literal["image"]],
        *,
        address: Text = ...,
        port: Whole = ...,
        path: Text = ...,
        bitrate: Whole = ...,
        key_interval: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Serves its input as live video to web browsers (WebRTC).

        image: Frames to send: bgr8, gray8 or rgba8.
        address: Address of this machine to listen on. 127.0.0.1 serves only programs on this machine. 0.0.0.0 listens on all networks. There is no password: anybody who reaches the port sees the video. (default "127.0.0.1")
        port: TCP port of the page, http://ADDRESS:PORT/PATH. 0 takes a free port, which the log names. The video itself uses a free UDP port for each viewer. Several `webrtc` nodes share a port with different paths. (0 to 65535; default 8889)
        path: Path of the page, which is also the WHEP endpoint for players. (default "/live")
        bitrate: Bit rate at 30 frames per second. (50 to 100000 kbit/s; default 4000)
        key_interval: Distance of keyframes. A viewer that joins or has lost a packet gets one at once. (1 to 1000 frames; default 300)"""

    def write_cloud(
        self,
        cloud: Input[Literal["cloud"]],
        calibration: Input[Literal["calibration"]] | None = None,
        *,
        path: File = ...,
        every: Whole = ...,
        mesh: Flag = ...,
        max_gradient: Number = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Writes point clouds as binary PLY files with colour.

        cloud: Points in mm with colours. Unknown points are skipped; points that were filled in have the property `filled` 1.
        calibration: Calibration of the rectified views, for the baseline. Without it 5 mm is assumed, the baseline of a narrow scope.
        path: File to write, with the extension .ply. `{seq}` becomes the tick's number; without it each cloud replaces the previous one. (default "out/cloud.ply")
        every: Every n-th cloud is written. (1 to 100000 frames; default 1)
        mesh: Also writes the surface between neighbouring points as triangles. (default False)
        max_gradient: Maximum change of disparity per px of distance between neighbours of one surface; others are not connected. (0.1 to 100 ratio; default 1.5)"""

    def write_images(
        self,
        image: Input[Literal["image"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        *,
        path: File = ...,
        every: Whole = ...,
        limit: Whole = ...,
        at_end: Flag = ...,
        jpeg_quality: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Writes images as PNG or JPEG files.

        image: Image to write: bgr8, gray8, rgba8 or gray16.
        mask: Mask to write, black and white.
        path: File to write, with the extension .png or .jpg. `{seq}` becomes the tick's number, six digits (`{seq:4}` four); without it every image replaces the previous one. (default "out/image.png")
        every: Every n-th image is written. (1 to 100000 frames; default 1)
        limit: Stops writing after this many files; 0 never. (0 to 1000000000 frames; default 0)
        at_end: Writes only the last bgr8 image, when the graph ends; `every` is then the number of ticks between the images considered. (default False)
        jpeg_quality: Quality of JPEG files. (1 to 100 %; default 92)"""

    def write_raw(
        self,
        image: Input[Literal["image"]] | None = None,
        disparity: Input[Literal["disparity"]] | None = None,
        depth: Input[Literal["depth"]] | None = None,
        confidence: Input[Literal["confidence"]] | None = None,
        mask: Input[Literal["mask"]] | None = None,
        *,
        path: File = ...,
        every: Whole = ...,
        limit: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Writes planes with their full precision: PFM, NPY, TIFF, PGM, raw.

        image: Any image.
        disparity: Disparity map in px, NaN where unmatched.
        depth: Depth map in mm, NaN where unknown.
        confidence: Confidence, 0 to 1.
        mask: Mask, 0 or 255.
        path: File to write. Its extension selects the format: .pfm (floats), .npy, .tif, .pgm or .ppm, .raw (bare rows). `{seq}` becomes the tick's number, `{port}` the input's name; with several inputs the name is added if `{port}` is missing. (default "out/plane.pfm")
        every: Every n-th tick is written. (1 to 100000 frames; default 1)
        limit: Number of ticks after which writing stops; 0 never stops. (0 to 1000000000 frames; default 0)"""

    def write_table(
        self,
        table: Input[Literal["table"]] | None = None,
        scalar: Input[Literal["scalar"]] | None = None,
        homography: Input[Literal["homography"]] | None = None,
        roi: Input[Literal["roi"]] | None = None,
        tip: Input[Literal["tip"]] | None = None,
        pose: Input[Literal["pose"]] | None = None,
        joints: Input[Literal["joints"]] | None = None,
        text: Input[Literal["text"]] | None = None,
        detections: Input[Literal["detections"]] | None = None,
        instances: Input[Literal["instances"]] | None = None,
        *,
        path: File = ...,
        image_name: Text = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Writes numbers as JSON lines or CSV, detections and instances as COCO JSON.

        table: Named columns of numbers.
        scalar: A number.
        homography: Registration of the views.
        roi: A rectangle, px.
        tip: Tip of a tool.
        pose: Pose of one coordinate frame in another.
        joints: Angles and speeds of the arm.
        text: A text.
        detections: Boxes.
        instances: Boxes with masks.
        path: File to write. .jsonl: one JSON object per tick. .csv: one line per tick or table row. .json: one COCO file of all detections or instances, written at the end; until then each tick is a line of a file with the extension .json.journal next to it, which remains if the run is cut off. A node that is reopened in the same run continues in .part2.jsonl and so on. (default "out/table.jsonl")
        image_name: Name of each tick's image in a COCO file; `{seq}` becomes the tick's number. Empty: number and .png. (default "")"""

    def write_video(
        self,
        image: Input[Literal["image"]],
        *,
        path: File = ...,
        codec: Union[Literal["mjpg", "h264", "hevc", "mpeg4", "vp8", "ffv1"], Arg] = ...,
        fps: Number = ...,
        time: Union[Literal["capture", "passed"], Arg] = ...,
        replace: Flag = ...,
        quality: Whole = ...,
        crf: Whole = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Node:
        """Writes frames as a video file.

        image: Frames to write: bgr8, gray8 or rgba8.
        path: File to write: .mkv, .webm, .mp4, .mov or .avi. .mkv and .webm survive a crash and play to the last frame; the others do not. A node that is reopened in the same run continues in .part2.mkv and so on. (default "out/video.mkv")
        codec: Compression of the video. .mkv holds every codec. (default "mjpg")
        fps: Constant frame rate, whatever the times of the frames. 0 gives each frame its own time, to the ms; in .avi the first two frames set the rate, and later ones are repeated if they are further apart. (0 to 1000 Hz; default 0)
        time: Timestamps of the frames. (default "capture")
        replace: Replaces the file of an earlier run; otherwise the video is written to the next .part file that does not exist. (default True)
        quality: Quality of `mjpg`, `mpeg4` and `vp8`. `mpeg4` and `vp8` use a new value from the next file on. (1 to 100 %; default 90)
        crf: Constant quality of `h264` and `hevc`, as the encoder's constant rate factor: 18 looks like the original, 23 is usual, 28 gives small files. (1 to 50 CRF; default 20)"""

    def yolo(
        self,
        image: Input[Literal["image"]],
        mask: Input[Literal["mask"]] | None = None,
        *,
        model: File = ...,
        layout: Union[Literal["auto", "yolox", "yolox_decoded", "yolov5", "yolov8", "end_to_end", "detr"], Arg] = ...,
        min_score: Number = ...,
        calibrated: Flag = ...,
        unknown_below: Number = ...,
        class_limits: Flag = ...,
        max_overlap: Number = ...,
        class_agnostic: Flag = ...,
        max_boxes: Whole = ...,
        labels: File = ...,
        input_width: Whole = ...,
        input_height: Whole = ...,
        track: Flag = ...,
        vote_s: Number = ...,
        unlike_s: Number = ...,
        unlike: Union[Literal["keep", "drop"], Arg] = ...,
        threads: Whole = ...,
        provider: Union[Literal["cpu", "cuda", "tensorrt", "openvino", "rocm", "migraphx"], Arg] = ...,
        id: str | None = None,
        **options: Unpack[NodeOptions],
    ) -> Yolo:
        """Finds surgical tools with a detector network.

        image: Image to search, bgr8 or gray8.
        mask: Nonzero where the image is illuminated. Boxes that are more than half outside are dropped. Unconnected: the whole image.
        model: ONNX file of the network. (default "models/instruments.onnx")
        layout: Family of the export. (default "auto")
        min_score: Minimum score of a box. (0.001 to 1 ratio; default 0.3)
        calibrated: Converts scores to the probability that a box and its class are correct, if the model has a calibration. Off: scores as the network outputs them, and no `unknown`. (default True)
        unknown_below: Minimum probability of a box's class, given that the box is on an instrument. Below it the class is reported as `unknown`, with the probability of any instrument as score. 0 always names the most probable class. Takes effect if the model's calibration includes objectness. (0 to 1 ratio; default 0.5)
        class_limits: Applies the minimum probability of each class that the model contains, at which the share of correct boxes was as large as requested at its export, if it is above `min_score`. (default False)
        max_overlap: Overlap (intersection over union) above which the box with the lower score is dropped. (0.05 to 1 ratio; default 0.5)
        class_agnostic: Boxes of different classes also suppress each other. (default False)
        max_boxes: Maximum number of boxes in the output. (1 to 1000; default 50)
        labels: File with the names of the classes, one per line. Empty: the names in the model file. (default "")
        input_width: Width of the network's input, for models that accept any size. (32 to 4096 px; default 640)
        input_height: Height of the network's input, for models that accept any size. (32 to 4096 px; default 640)
        track: Gives each tool a number (`track_id`) that it keeps over time. (default True)
        vote_s: Gives a tracked tool the class that it had most often: votes are weighted by score, and their weight halves after this time. 0: the class in each image. Best with boxes of one class per tool (`class_agnostic`). (0 to 60 s; default 0)
        unlike_s: Time constant of the smoothing of `unlikeness`. (0 to 60 s; default 2)
        unlike: What happens to the boxes while `unlikeness` is 1 or more. (default "keep")
        threads: Number of threads of the network; 0 uses as many as the host has. (0 to 64; default 0)
        provider: Execution provider: the processor, or an accelerator if ONNX Runtime's library supports it and finds a device. Otherwise the processor is used, with a warning. (default "cpu")"""
