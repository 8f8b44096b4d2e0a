//! `rectify`: turns both views so that a point lies on one row in both (thesis, fig. 3.5).

use panoscope_imaging::Rect;
use panoscope_imaging::stereo::rotation::Matrix3;
use panoscope_imaging::stereo::{Rectification, RemapTable};
use panoscope_node::abi::Calibration;
use panoscope_node::{
    Bgr8, Choice, Context, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, Validation, Value, error,
};

use panoscope_calibration::packet as calibration;

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view, not rectified.
    left: Image<'f, Bgr8>,
    /// Right view of the same instant.
    right: Image<'f, Bgr8>,
    /// Calibration of the cameras; the newest one is used until another arrives.
    calibration: Option<Value<'f, Calibration>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// Rectified left view; black outside the camera's picture.
    left: Slot<'f, Bgr8>,
    /// Rectified right view.
    right: Slot<'f, Bgr8>,
    /// Calibration of the rectified views.
    calibration: Slot<'f, Calibration>,
}

/// Parameters.
#[derive(Params)]
pub struct RectifyNodeParams {
    /// Passes the views on unchanged: for views that another program has rectified.
    #[param(default = false)]
    bypass: bool,
    /// What becomes of views without a calibration.
    #[param(default = "refuse")]
    uncalibrated: Uncalibrated,
}

/// See [`RectifyNodeParams::uncalibrated`].
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Uncalibrated {
    /// The node fails.
    Refuse,
    /// The views are handed on as they are, without a calibration, until one arrives.
    Pass,
}

/// Maps of one calibration.
struct Maps {
    source: Calibration,
    target: Calibration,
    /// `None` when the views are rectified already.
    tables: Option<[RemapTable; 2]>,
}

/// See the module.
pub struct Rectify {
    maps: Option<Maps>,
    /// Views have been handed on without a calibration.
    is_passing: bool,
}

/// Whether the cameras are those of the rectified views, so that every pixel stays where it is.
fn is_level(source: &Calibration, target: &Calibration, rectification: &Rectification) -> bool {
    const EYE: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    (source.left, source.right) == (target.left, target.right)
        && (rectification.rotation_left, rectification.rotation_right) == (EYE, EYE)
}

impl Maps {
    fn new(source: &Calibration, cx: &Context<'_>) -> Result<Self> {
        if source.is_rectified != 0 {
            calibration::rectification(source)?;
            return Ok(Self { source: *source, target: *source, tables: None });
        }
        let rectification = calibration::rectification(source)?;
        let (left, right) = (calibration::camera(&source.left)?, calibration::camera(&source.right)?);
        let target = calibration::rectified(source, &rectification);
        if is_level(source, &target, &rectification) {
            return Ok(Self { source: *source, target, tables: None });
        }
        let all = Rect::whole(rectification.width, rectification.height);
        let tables = [
            RemapTable::left(&left, &rectification, all, cx.pool())?,
            RemapTable::right(&right, &rectification, all, cx.pool())?,
        ];
        Ok(Self { source: *source, target, tables: Some(tables) })
    }
}

impl Node for Rectify {
    const INFO: NodeInfo =
        NodeInfo::compute("rectify", "stereo", "Turns both views so that a point lies on one row in both.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = RectifyNodeParams;

    fn validate(params: &RectifyNodeParams, check: &mut Validation<'_>) {
        if params.bypass || check.is_connected("calibration") != Some(false) {
            return;
        }
        if params.uncalibrated == Uncalibrated::Refuse {
            check.node_error(
                "there is no calibration to rectify by: input `calibration` is not connected",
                "connect it, as in calibration = \"scope.calibration\", or set bypass = true when the views are rectified already",
            );
        } else {
            check.node_warning(
                "there is no calibration to rectify by: the views stay as they are, and nothing is known of their depth",
                "connect it, as in calibration = \"scope.calibration\"",
            );
        }
    }

    fn open(_: &Open<'_>, _: &RectifyNodeParams) -> Result<Self> {
        Ok(Self { maps: None, is_passing: false })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &RectifyNodeParams,
    ) -> Result<()> {
        if params.bypass {
            if let Some(given) = &input.calibration {
                out.calibration.set(Calibration { is_rectified: 1, ..**given })?;
            }
            out.left.forward(input.left.frame())?;
            return out.right.forward(input.right.frame());
        }
        if let Some(given) = &input.calibration
            && self.maps.as_ref().is_none_or(|maps| !calibration::same(&maps.source, given))
        {
            if self.maps.is_some() {
                cx.info("the calibration has changed: new maps");
            }
            self.maps = None;
            self.maps = Some(Maps::new(given, cx)?);
            if std::mem::replace(&mut self.is_passing, false) {
                cx.info("a calibration has arrived: the views are rectified from now on");
            }
        }
        let Some(maps) = &self.maps else {
            if params.uncalibrated == Uncalibrated::Pass {
                if !std::mem::replace(&mut self.is_passing, true) {
                    cx.warn("no calibration has arrived: the views stay as they are, and nothing is known of their depth. Connect `calibration`");
                }
                out.left.forward(input.left.frame())?;
                return out.right.forward(input.right.frame());
            }
            return Err(error!(
                "no calibration has arrived: connect `calibration`, or set `bypass` when the views are rectified already"
            ));
        };
        for (side, view, camera) in
            [("left", &input.left, &maps.source.left), ("right", &input.right, &maps.source.right)]
        {
            if (view.width(), view.height()) != (camera.width as usize, camera.height as usize) {
                return Err(error!(
                    "the {side} view is {}x{}, the calibration was made for {}x{}",
                    view.width(),
                    view.height(),
                    camera.width,
                    camera.height
                ));
            }
        }
        out.calibration.set(maps.target)?;
        let Some([left, right]) = &maps.tables else {
            out.left.forward(input.left.frame())?;
            return out.right.forward(input.right.frame());
        };
        let (width, height) = (maps.target.left.width as usize, maps.target.left.height as usize);
        if out.left.is_read() {
            left.remap(input.left.view(), out.left.alloc(width, height)?, cx.pool())?;
        }
        if out.right.is_read() {
            right.remap(input.right.view(), out.right.alloc(width, height)?, cx.pool())?;
        }
        Ok(())
    }
}
