//! `transpose`: swaps rows and columns, so that views above one another can be matched like views side by side.

use panoscope_node::{Bgr8, Context, Disparity, Image, Node, NodeInfo, Open, Ports, Result, Slot, View, ViewMut};

/// Side of the square tiles in which pixels are moved, px: source and destination of a tile fit into the cache.
const TILE: usize = 32;

/// Input ports of `transpose`.
#[derive(Ports)]
pub struct In<'f> {
    /// Image to transpose.
    image: Option<Image<'f, Bgr8>>,
    /// Disparity map to transpose, px, NaN where unmatched.
    disparity: Option<Image<'f, Disparity>>,
}

/// Output ports of `transpose`.
#[derive(Ports)]
pub struct Out<'f> {
    /// The image, mirrored at its diagonal.
    image: Slot<'f, Bgr8>,
    /// The map, mirrored at its diagonal; its values do not change.
    disparity: Slot<'f, Disparity>,
}

/// Swaps rows and columns.
pub struct Transpose;

fn transpose<T: Copy>(from: View<'_, T>, to: &mut ViewMut<'_, T>) {
    let channels = from.channels;
    for top in (0..from.height).step_by(TILE) {
        for left in (0..from.width).step_by(TILE) {
            for x in left..(left + TILE).min(from.width) {
                let out = to.row_mut(x);
                for y in top..(top + TILE).min(from.height) {
                    out[y * channels..][..channels].copy_from_slice(&from.row(y)[x * channels..][..channels]);
                }
            }
        }
    }
}

impl Node for Transpose {
    const INFO: NodeInfo = NodeInfo::compute(
        "transpose",
        "flow",
        "Swaps rows and columns of an image or a disparity map, so that views above one another can be matched.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ();

    fn open(_: &Open<'_>, (): &()) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, (): &()) -> Result<()> {
        if let Some(image) = input.image {
            let image = image.view();
            transpose(image, &mut out.image.alloc(image.height, image.width)?);
        }
        if let Some(map) = input.disparity {
            let map = map.view();
            transpose(map, &mut out.disparity.alloc(map.height, map.width)?);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_node::harness::{Harness, Setup};

    #[test]
    fn rows_become_columns_and_twice_is_nothing() {
        let (width, height) = (70, 41);
        let picture: Vec<u8> = (0..width * height * 3).map(|i| (i * 7 % 251) as u8).collect();
        let map: Vec<f32> = (0..width * height).map(|i| if i % 9 == 0 { f32::NAN } else { i as f32 }).collect();
        let mut node = Harness::<Transpose>::open(Setup::new("")).unwrap();
        node.input_image::<Bgr8>("image", width, height, &picture);
        node.input_image::<Disparity>("disparity", width, height, &map);
        let (turned, turned_map) = {
            let out = node.process().unwrap();
            let (image, disparity) =
                (out.plane::<Bgr8>("image").unwrap(), out.plane::<Disparity>("disparity").unwrap());
            assert_eq!((image.width, image.height), (height, width));
            for (x, y) in [(0, 0), (69, 40), (33, 12)] {
                assert_eq!(image.row(x)[y * 3..y * 3 + 3], picture[(y * width + x) * 3..][..3]);
                assert_eq!(disparity.row(x)[y].to_bits(), map[y * width + x].to_bits());
            }
            let rows = |at: usize| image.row(at)[..height * 3].to_vec();
            let values = |at: usize| disparity.row(at)[..height].to_vec();
            ((0..width).flat_map(rows).collect::<Vec<u8>>(), (0..width).flat_map(values).collect::<Vec<f32>>())
        };
        node.input_image::<Bgr8>("image", height, width, &turned);
        node.input_image::<Disparity>("disparity", height, width, &turned_map);
        let out = node.process().unwrap();
        let (image, disparity) = (out.plane::<Bgr8>("image").unwrap(), out.plane::<Disparity>("disparity").unwrap());
        for y in 0..height {
            assert_eq!(image.row(y)[..width * 3], picture[y * width * 3..(y + 1) * width * 3]);
            let bits = |row: &[f32]| row.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&disparity.row(y)[..width]), bits(&map[y * width..(y + 1) * width]));
        }
    }
}
