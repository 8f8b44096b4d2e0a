//! Times of the stages of stitching.

use panoscope_engine::Report;

/// Medians of the nodes of one run, ms.
#[derive(Clone, Copy, Debug)]
pub struct Stages {
    pub matching: f64,
    pub register: f64,
    pub composite: f64,
    /// Seams found per frame; NaN if the composite does not count them.
    pub seams: f64,
}

impl Stages {
    pub const WORST: Self =
        Self { matching: f64::INFINITY, register: f64::INFINITY, composite: f64::INFINITY, seams: f64::NAN };

    pub fn of(report: &Report) -> Self {
        let p50 = |id: &str| report.nodes.get(id).map_or(0.0, |node| node.p50_ms);
        let seams = report.nodes.get("wide").and_then(|node| {
            let found = node.metrics.get("seams_found")?;
            Some(found / node.count.max(1) as f64)
        });
        Self {
            matching: p50("match"),
            register: p50("register"),
            composite: p50("wide"),
            seams: seams.unwrap_or(f64::NAN),
        }
    }

    /// The faster of two runs of the same graph, stage by stage.
    pub fn better(self, other: Self) -> Self {
        Self {
            matching: self.matching.min(other.matching),
            register: self.register.min(other.register),
            composite: self.composite.min(other.composite),
            seams: other.seams,
        }
    }
}

/// Times per frame of one method, ms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Times {
    pub matching: f64,
    pub register: f64,
    /// The composite without finding a seam.
    pub rest: f64,
    /// The seam in a frame that finds one.
    pub seam_found: f64,
    /// Mean of the seam over all frames.
    pub seam: f64,
}

impl Times {
    /// `default`: the unchanged graph; `every`: composite time with a seam in each frame; `kept`: with one in the first
    /// only.
    pub fn of(default: Stages, every: f64, kept: f64) -> Self {
        // Where seams are rare the median frame of the default finds none either.
        let is_rare = default.seams < 0.5;
        let rest = if is_rare { default.composite.min(kept) } else { kept };
        let seam_found = (every - rest).max(0.0);
        let seam = if is_rare { default.seams * seam_found } else { seam_found };
        Self { matching: default.matching, register: default.register, rest, seam_found, seam }
    }

    pub fn registration(&self) -> f64 {
        self.matching + self.register
    }

    pub fn composite(&self) -> f64 {
        self.rest + self.seam
    }

    /// Mean time of a frame.
    pub fn whole(&self) -> f64 {
        self.registration() + self.composite()
    }

    /// Time of a frame that finds a seam.
    pub fn every_frame(&self) -> f64 {
        self.registration() + self.rest + self.seam_found
    }
}
