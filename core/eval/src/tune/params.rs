//! Parameters of the controller and arm of a graph file.

use std::path::Path;

use panoscope_arm_core::Chain;
use panoscope_arm_core::control::Goals;
use panoscope_arm_core::dynamics::Quality;
use panoscope_arm_core::pid::Gains;
use panoscope_arm_core::rehearsal::shipped_goals;
use panoscope_arm_core::tuning::course::{Channel, Course};
use panoscope_arm_core::tuning::relay::Tuned;
use panoscope_graph::{Catalog, GraphOptions, Node, ParamValue};
use panoscope_host::loader::graph_file;

use crate::error::{Context, EvalError, Result, bail};

/// A controller and its arm.
pub struct Plant {
    /// Parameters of the controller.
    pub goals: Goals,
    /// Model of the arm.
    pub course: Course,
    /// Name of the controller in its graph.
    pub node: Option<String>,
}

/// The shipped arm with the defaults of its nodes.
pub fn shipped() -> Result<Plant> {
    Ok(Plant { goals: shipped_goals(), course: Course::shipped(Chain::shipped()?), node: None })
}

/// Gains of a channel.
pub fn gains_of(goals: &Goals, channel: Channel) -> Tuned {
    let gains: &Gains = match channel {
        Channel::Picture => &goals.picture,
        Channel::Distance => &goals.distance,
    };
    Tuned { proportional: gains.proportional, integral: gains.integral, derivative: gains.derivative }
}

/// The parameters of a node by name.
struct Named<'a> {
    node: &'a Node,
    catalog: &'a Catalog,
}

impl Named<'_> {
    fn value(&self, name: &str) -> Option<&ParamValue> {
        let index = self.node.node_type(self.catalog).params.iter().position(|param| param.name == name)?;
        self.node.params.get(index)
    }

    fn number(&self, name: &str) -> Result<f64> {
        match self.value(name) {
            Some(ParamValue::Float(value)) => Ok(*value),
            Some(ParamValue::Int(value)) => Ok(*value as f64),
            _ => bail!(
                "`{}` has no number `{name}`: its plugin has another version; install Panoscope again",
                self.node.id
            ),
        }
    }

    /// Loads the arm's file; default: the shipped one.
    fn arm(&self) -> Result<Chain> {
        match self.value("arm") {
            Some(ParamValue::Path(path)) if !path.as_os_str().is_empty() => {
                let text = std::fs::read_to_string(path)
                    .with_context(|| format!("`{}`: cannot read the arm {}", self.node.id, path.display()))?;
                Ok(Chain::from_urdf(&text).with_context(|| format!("the arm {}", path.display()))?)
            }
            _ => Ok(Chain::shipped()?),
        }
    }
}

/// Reads controller and arm from a graph file. `node` names the controller if there are several.
pub fn of_graph(path: &Path, node: Option<&str>, options: &GraphOptions) -> Result<Plant> {
    let ready = match graph_file::open(path, options) {
        Ok(ready) => ready,
        Err(diagnostics) => return Err(EvalError::Check { diagnostics }),
    };
    let of_type = |kind: &str| ready.graph.nodes.iter().filter(|n| n.type_name == kind).collect::<Vec<&Node>>();
    let controllers = of_type("arm_pid");
    let names = || controllers.iter().map(|n| format!("`{}`", n.id)).collect::<Vec<String>>().join(", ");
    let refused = |reason: String| Err(EvalError::Options { reason: format!("{}: {reason}", path.display()) });
    let controller = match (node, &controllers[..]) {
        (Some(id), _) => match controllers.iter().find(|n| n.id == id) {
            Some(found) => *found,
            None if controllers.is_empty() => {
                return refused(format!("`{id}` is not an `arm_pid`, and the graph has none"));
            }
            None => return refused(format!("`{id}` is not an `arm_pid`; the graph has {}", names())),
        },
        (None, [one]) => one,
        (None, []) => return refused("the graph has no node of type `arm_pid` to tune".to_owned()),
        (None, _) => return refused(format!("the graph has several `arm_pid`, {}: choose one with --node", names())),
    };
    let arms = of_type("arm_sim");
    let pid = Named { node: controller, catalog: &ready.catalog };
    let mut goals = shipped_goals();
    let number = |name: &str| pid.number(name);
    let focal_px = number("focal_px")?;
    for (gains, of) in [(&mut goals.picture, "picture"), (&mut goals.distance, "distance")] {
        gains.proportional = number(&format!("{of}_p"))?;
        gains.integral = number(&format!("{of}_i"))?;
        gains.derivative = number(&format!("{of}_d"))?;
        gains.filter_s = number("filter_s")?;
    }
    goals.picture.dead_zone = number("dead_zone_px")?;
    goals.distance.dead_zone = number("dead_zone_mm")?;
    goals.distance_mm = number("distance_mm")?;
    goals.feed_forward = number("feed_forward")?;
    goals.latency_s = number("latency_s")?;
    goals.acceleration_mm_s2 = number("tip_acceleration")?;
    let mut course = Course::shipped(pid.arm()?);
    // The dead zone and the limit of the picture's errors are stated at 640 columns, 750 px.
    let scale = focal_px / course.cameras.focal_px.0;
    goals.picture.dead_zone *= scale;
    goals.picture.most *= scale;
    course.cameras.focal_px = (focal_px, focal_px);
    course.cameras.baseline_mm = number("baseline_mm")?;
    if let [arm] = arms[..] {
        let arm = Named { node: arm, catalog: &ready.catalog };
        course.quality = Quality {
            latency_ms: arm.number("latency_ms")?,
            lag_ms: arm.number("lag_ms")?,
            backlash_rad: arm.number("backlash_deg")?.to_radians(),
            encoder_noise_rad: arm.number("encoder_noise_deg")?.to_radians(),
        };
    }
    Ok(Plant { goals, course, node: Some(controller.id.clone()) })
}
