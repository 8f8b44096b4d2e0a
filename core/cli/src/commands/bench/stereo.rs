//! `panoscope bench stereo`: the thesis's chain step by step, beside OpenCV's four steps (thesis, table 3.2).
//!
//! Both chains are graphs of real nodes on the same pictures of the phantom, run turn about. Times are the nodes' own, as
//! the engine counts them; pictures come slowly enough that only one is under way.

use std::path::Path;
use std::time::Duration;

use anyhow::{Result, bail};
use panoscope_graph::GraphText;
use panoscope_runtime::{Engine, Options, Outcome, Report};

use super::record::Figure;
use crate::terminal::tell;
use crate::{allocations, graph_file};

/// Disparity at which the search begins: the bowel scene at 50 mm holds 206 to 262 px.
const OFFSET_PX: u32 = 204;
const SEARCH_PX: u32 = 64;
const INPUT: &str = "phantom bowel 640x480, 64 residual disparities";

/// Picture source: few pictures a second, so that rendering and matching do not meet.
const HEAD: &str = r#"
mode = "live"
[nodes.scope]
type = "phantom"
params = { scene = "bowel", rate_hz = 5.0 }
[nodes.rectify]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
[nodes.sink]
type = "write_raw"
"#;

fn ours() -> String {
    format!(
        r#"{HEAD}inputs = {{ disparity = "fbs.disparity" }}
params = {{ path = "SINK", limit = 1 }}
[nodes.bm]
type = "stereo_bm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ auto_offset = false, min_disparity_px = {OFFSET_PX}, search_px = {SEARCH_PX} }}
[nodes.wls]
type = "disparity_wls"
inputs = {{ image = "rectify.left", disparity = "bm.disparity", disparity_right = "bm.disparity_right" }}
[nodes.fbs]
type = "disparity_fbs"
inputs = {{ image = "rectify.left", disparity = "wls.disparity", confidence = "wls.confidence" }}
"#
    )
}
