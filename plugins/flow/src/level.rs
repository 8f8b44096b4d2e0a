//! `level`: the brightness of images, as numbers.

use panoscope_node::abi::Scalar;
use panoscope_node::{Context, Gray8, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, View};

/// Input ports of `level`.
#[derive(Ports)]
pub struct In<'f> {
    /// The image to measure.
    image: Image<'f, Gray8>,
}

/// Output ports of `level`.
#[derive(Ports)]
pub struct Out<'f> {
    /// Mean of the window, times the gain.
    level: Slot<'f, Scalar>,
    /// Mean, smallest and largest value of the window, and the mean of the spots, each times the gain; NaN without window and spots.
    levels: Slot<'f, TableData>,
}

/// The window and the spots to measure.
#[derive(Params)]
pub struct LevelParams {
    /// Factor of all levels.
    #[param(default = 1.0, range = 0.0..=8.0, step = 0.1, unit = "ratio")]
    gain: f64,
    /// Region of the image that is measured: x, y, width, height; without it, the whole image.
    #[param(default = [], range = 0..=4, unit = "px", rectangles)]
    window: Vec<f64>,
    /// Additional points to measure: u, v, u, v, ...
    #[param(default = [], range = 0..=32, unit = "px", points)]
    spots: Vec<f64>,
}

/// Measures the brightness of images.
pub struct Level;

/// Rows and columns of the window, clipped to the image.
fn window(image: &View<'_, u8>, window: &[f64]) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    let [x, y, width, height] = *window else { return (0..image.height, 0..image.width) };
    // Casts keep to the range of their type; NaN becomes 0.
    let part = |from: f64, len: f64, most: usize| {
        let end = ((from + len).round().max(0.0) as usize).min(most);
        (from.round().max(0.0) as usize).min(end)..end
    };
    (part(y, height, image.height), part(x, width, image.width))
}

impl Node for Level {
    const INFO: NodeInfo = NodeInfo::compute("level", "flow", "Measures the brightness of images.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = LevelParams;

    fn open(_: &Open<'_>, _: &LevelParams) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &LevelParams) -> Result<()> {
        let image = input.image.view();
        let (rows, columns) = window(&image, &params.window);
        let (mut sum, mut count, mut least, mut most) = (0u64, 0u64, u8::MAX, 0);
        for y in rows {
            for &value in &image.row(y)[columns.clone()] {
                (sum, count) = (sum + u64::from(value), count + 1);
                (least, most) = (least.min(value), most.max(value));
            }
        }
        let (mut spots, mut seen) = (0.0, 0u32);
        for [u, v] in params.spots.as_chunks::<2>().0 {
            let inside = *u >= 0.0 && *v >= 0.0 && *u < image.width as f64 && *v < image.height as f64;
            if inside {
                spots += f64::from(image.row(*v as usize)[*u as usize]);
                seen += 1;
            }
        }
        let gained = |value: f64, known: bool| if known { value * params.gain } else { f64::NAN };
        let mean = gained(sum as f64 / count.max(1) as f64, count > 0);
        cx.metric("level", mean);
        out.level.set_scalar("level", mean, "")?;
        let ends = [least, most].map(|v| gained(f64::from(v), count > 0));
        let spots = gained(spots / f64::from(seen.max(1)), seen > 0);
        out.levels.set_table(&["mean", "min", "max", "spots"], &[mean, ends[0], ends[1], spots])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_node::harness::{Harness, HarnessError};

    fn levels(params: &str) -> std::result::Result<Vec<f64>, HarnessError> {
        let mut node = Harness::<Level>::from_toml(&format!("params = {{ {params} }}"))?;
        let values: Vec<u8> = (0..16).collect();
        let outputs = node.input_image::<Gray8>("image", 4, 4, &values).process()?;
        let row = outputs.table("levels")?.rows().next().unwrap_or_default().to_vec();
        Ok(row)
    }

    #[test]
    fn windows_and_spots_are_looked_at() -> std::result::Result<(), HarnessError> {
        assert_eq!(levels("gain = 2.0")?[..3], [15.0, 0.0, 30.0]);
        assert_eq!(levels("window = [1, 2, 2, 1]")?[..3], [9.5, 9.0, 10.0]);
        assert_eq!(levels("spots = [3, 0, 0, 1]")?[3], 3.5);
        assert!(levels("window = [9, 9, 2, 2]")?[0].is_nan(), "beside the picture");
        Ok(())
    }
}
