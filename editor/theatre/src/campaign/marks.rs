//! Blocks of bits in an image that name what it shows. They survive scaling and dimming.

use panoscope_editor_model::pixels::Pixels;

/// Blocks per row and column.
const BLOCKS: (usize, usize) = (8, 4);
/// Size of an image, px.
pub const SIZE_PX: (usize, usize) = (64, 48);
const WHITE: u8 = 230;
const BLACK: u8 = 20;
const TIME_BITS: usize = 19;
const VIEW_BITS: usize = 3;
const CHECK_BITS: usize = 8;
/// Unit of the time, ms.
const UNIT_MS: u64 = 4;
/// Brightness of a white block between a dimmed and a present image.
const MIN_BRIGHT: f32 = 150.0;

/// What an image shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Mark {
    /// Number of the camera or the view.
    pub view: u8,
    /// Time of its oldest light, ms of the simulation.
    pub light_ms: u64,
}

impl Mark {
    /// A mark of a time, rounded to what an image can show.
    pub fn new(view: u8, light_ms: u64) -> Self {
        Self { view, light_ms: light_ms / UNIT_MS * UNIT_MS }
    }

    fn bits(self) -> u32 {
        let value = ((self.light_ms / UNIT_MS) as u32) << VIEW_BITS | u32::from(self.view);
        value << CHECK_BITS | check(value)
    }

    /// An image with this mark between a white block and a black one.
    pub fn pixels(self) -> Pixels {
        let bits = self.bits() << 1 | 1;
        let (width, height) = SIZE_PX;
        let value = |x: usize, y: usize| if bits >> (y * BLOCKS.0 + x) & 1 == 1 { WHITE } else { BLACK };
        // One row of pixels per row of blocks; a rule per pixel takes a tenth of the campaign.
        let rows: Vec<Vec<u8>> = (0..BLOCKS.1)
            .map(|y| {
                (0..width).flat_map(|x| [[value(x * BLOCKS.0 / width, y); 3].as_slice(), &[255]].concat()).collect()
            })
            .collect();
        let rgba = (0..height).flat_map(|y| rows[y * BLOCKS.1 / height].iter().copied()).collect();
        Pixels { width, height, rgba }
    }

    /// The middles of the blocks, as fractions of the width and height.
    pub fn blocks() -> impl Iterator<Item = (f32, f32)> {
        let middle = |n: usize, of: usize| (n as f32 + 0.5) / of as f32;
        (0..BLOCKS.0 * BLOCKS.1).map(move |n| (middle(n % BLOCKS.0, BLOCKS.0), middle(n / BLOCKS.0, BLOCKS.1)))
    }

    /// Reads the mark of an image in memory.
    pub fn of(pixels: &Pixels) -> Option<Self> {
        let at = |(x, y): (f32, f32)| {
            (y * pixels.height as f32) as usize * pixels.width + (x * pixels.width as f32) as usize
        };
        let brightness: Vec<f32> = Self::blocks().map(|block| f32::from(pixels.rgba[at(block) * 4])).collect();
        Self::read(&brightness).map(|(mark, _)| mark)
    }

    /// Reads a mark from the brightness of [`Self::blocks`]. Returns whether it is undimmed, too; `None` where there is none.
    pub fn read(brightness: &[f32]) -> Option<(Self, bool)> {
        let (white, black) = (*brightness.first()?, *brightness.last()?);
        if white < black + 20.0 {
            return None;
        }
        let middle = f32::midpoint(white, black);
        let bits =
            (1..BLOCKS.0 * BLOCKS.1).filter(|n| brightness[*n] > middle).fold(0_u32, |bits, n| bits | 1 << (n - 1));
        let (value, known) = (bits >> CHECK_BITS, bits & ((1 << CHECK_BITS) - 1));
        let mark =
            Self { view: (value & ((1 << VIEW_BITS) - 1)) as u8, light_ms: u64::from(value >> VIEW_BITS) * UNIT_MS };
        (known == check(value)).then_some((mark, white > MIN_BRIGHT))
    }
}

/// A check sum of [`CHECK_BITS`] bits.
fn check(value: u32) -> u32 {
    (panoscope_base::random::mix(u64::from(value)) & ((1 << CHECK_BITS) - 1)) as u32
}

const _: () = assert!(TIME_BITS + VIEW_BITS + CHECK_BITS + 2 == BLOCKS.0 * BLOCKS.1);

#[test]
fn a_mark_survives_dimming_and_noise_is_none() {
    for (view, light_ms) in [(0, 0), (3, 4), (7, 1_999_996)] {
        let mark = Mark::new(view, light_ms);
        let pixels = mark.pixels();
        assert_eq!(Mark::of(&pixels), Some(mark));
        let read = |share: f32| {
            let blocks = Mark::blocks().map(|(x, y)| {
                let at = (y * SIZE_PX.1 as f32) as usize * SIZE_PX.0 + (x * SIZE_PX.0 as f32) as usize;
                f32::from(pixels.rgba[at * 4]) * share
            });
            Mark::read(&blocks.collect::<Vec<_>>())
        };
        assert_eq!((read(1.0), read(90.0 / 255.0)), (Some((mark, true)), Some((mark, false))));
    }
    assert_eq!(Mark::read(&[30.0; BLOCKS.0 * BLOCKS.1]), None);
}
