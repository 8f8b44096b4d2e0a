//! A Panoscope plugin with one node: `cargo test` tries it, `panoscope run {{name}}.toml` runs it.
//!
//! Doc comments of ports and parameters are the tooltips that users read.

use panoscope_node::*;

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Image to brighten.
    image: Image<'f, Bgr8>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// The brighter image.
    image: Slot<'f, Bgr8>,
}

/// Parameters under `params` of a graph file.
#[derive(Params)]
pub struct Params {
    /// Factor of every colour.
    #[param(default = 1.5, range = 0.0..=8.0, step = 0.1, unit = "ratio")]
    gain: f32,
}

/// Makes an image brighter.
pub struct Brighten;

impl Node for Brighten {
    const INFO: NodeInfo = NodeInfo::compute("{{node}}", "filter", "Makes a picture brighter.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Params;

    fn open(_: &Open<'_>, _: &Params) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Params) -> Result<()> {
        let image = input.image.view();
        let mut brighter = out.image.alloc(image.width, image.height)?;
        for y in 0..image.height {
            for (to, from) in brighter.row_mut(y).iter_mut().zip(image.row(y)) {
                *to = (f32::from(*from) * params.gain + 0.5) as u8;
            }
        }
        Ok(())
    }
}

export_plugin![Brighten];

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_node::harness::{Harness, HarnessError};

    #[test]
    fn colours_are_multiplied_and_stay_in_range() -> std::result::Result<(), HarnessError> {
        let mut node = Harness::<Brighten>::from_toml("params = { gain = 2.0 }")?;
        let out = node.input_image::<Bgr8>("image", 2, 1, &[0, 10, 20, 100, 200, 255]).process()?;
        assert_eq!(out.plane::<Bgr8>("image")?.data, [0, 20, 40, 200, 255, 255]);
        Ok(())
    }
}
