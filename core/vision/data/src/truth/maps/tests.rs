use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, SmallVec, WritableImage,
};
use tiff::encoder::{TiffEncoder, colortype};

use super::*;

const VALUES: [f32; 6] = [1.5, 2.0, 0.0, 4.25, f32::NAN, 6.0];

fn same(found: &[f32], expected: &[f32]) -> bool {
    found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
}

fn tiff_of<C: colortype::ColorType>(values: &[C::Inner]) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    TiffEncoder::new(&mut bytes).expect("a TIFF").write_image::<C>(3, 2, values).expect("written");
    bytes.into_inner()
}

fn png_of(picture: DynamicImage) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).expect("written");
    bytes.into_inner()
}

fn exr_of(channels: &[(&str, &[f32])]) -> Vec<u8> {
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> =
        channels.iter().map(|(name, values)| AnyChannel::new(*name, FlatSamples::F32(values.to_vec()))).collect();
    let layer = Layer::new((3, 2), LayerAttributes::default(), Encoding::UNCOMPRESSED, AnyChannels::sort(list));
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).expect("written");
    bytes.into_inner()
}

#[test]
fn every_format_gives_the_same_numbers() {
    let image = FloatImage { width: 3, height: 2, data: VALUES.to_vec() };
    for (ending, bytes) in [
        ("pfm", formats::write_pfm(&image)),
        ("npy", formats::write_npy(&image)),
        ("tif", tiff_of::<colortype::Gray32Float>(&VALUES)),
        ("exr", exr_of(&[("Z", &VALUES)])),
        ("exr", exr_of(&[("A", &[1.0; 6]), ("B", &VALUES), ("G", &VALUES), ("R", &VALUES)])),
        ("exr", exr_of(&[("left.V", &VALUES), ("left.R", &[0.0; 6])])),
    ] {
        let map = decode(ending, &bytes).unwrap_or_else(|error| panic!("{ending}: {error}"));
        assert_eq!((map.image.width, map.image.height, map.stored), (3, 2, Stored::Floats), "{ending}");
        assert!(same(&map.image.data, &VALUES), "{ending}: {:?}", map.image.data);
        let known = map.divided(0.5).data;
        assert!(same(&known, &[3.0, 4.0, f32::NAN, 8.5, f32::NAN, 12.0]), "{ending}: 0 is unknown, {known:?}");
        for at in 0..bytes.len() - 4 {
            assert!(decode(ending, &bytes[..at]).is_err() || ending == "tif", "{ending} cut at {at}");
        }
    }
}

#[test]
fn kitti_divides_16_bits_by_256_and_0_is_unknown() {
    let values = vec![256u16, 640, 0, 25600, 1, 65535];
    let gray = image::ImageBuffer::from_raw(3, 2, values).expect("6 values");
    let map = decode("png", &png_of(DynamicImage::ImageLuma16(gray))).expect("a map");
    assert_eq!((map.stored, map.disparity_divisor()), (Stored::Png16, 256.0));
    let disparity = map.divided(KITTI_DIVISOR).data;
    assert!(same(&disparity, &[1.0, 2.5, f32::NAN, 100.0, 1.0 / 256.0, 65535.0 / 256.0]), "{disparity:?}");
    // Middlebury's older pictures have 8 bits and hold px.
    let gray = image::ImageBuffer::from_raw(3, 2, vec![7u8, 0, 255, 1, 2, 3]).expect("6 values");
    let map = decode("png", &png_of(DynamicImage::ImageLuma8(gray))).expect("a map");
    assert_eq!((map.stored, map.disparity_divisor(), map.image.data[2]), (Stored::EightBits, 1.0, 255.0));
    let colours = image::ImageBuffer::from_raw(1, 2, vec![7u8, 7, 7, 1, 2, 3]).expect("6 values");
    let error = decode("png", &png_of(DynamicImage::ImageRgb8(colours))).expect_err("colours").to_string();
    assert!(error.contains("one number per pixel"), "{error}");
}

#[test]
fn of_scared_points_the_third_number_is_depth() {
    let points: Vec<f32> = (0..6).flat_map(|n| [-1.0, 100.0, 50.0 + n as f32]).collect();
    let map = decode("tiff", &tiff_of::<colortype::RGB32Float>(&points)).expect("a map");
    assert_eq!(map.image.data, [50.0, 51.0, 52.0, 53.0, 54.0, 55.0]);
    let colours = tiff_of::<colortype::RGB8>(&[1; 18]);
    assert!(decode("tif", &colours).expect_err("colours").to_string().contains("colour image"));
}

#[test]
fn whole_numbers_of_a_tiff_are_kept() {
    let map = decode("tif", &tiff_of::<colortype::Gray16>(&[1, 2, 3, 4, 5, 65535])).expect("a map");
    assert_eq!((map.stored, map.disparity_divisor(), map.image.data[5]), (Stored::Whole, 1.0, 65535.0));
    let map = decode("tif", &tiff_of::<colortype::Gray32>(&[1, 2, 3, 4, 5, 1 << 20])).expect("a map");
    assert_eq!(map.image.data[5], 1_048_576.0);
}

#[test]
fn what_is_no_map_is_named_with_its_file() {
    let error = exr_of(&[("U", &[0.0; 6]), ("W", &VALUES)]);
    let error = decode("exr", &error).expect_err("two channels").to_string();
    assert!(error.contains("channels are U, W"), "{error}");
    let error = read(Path::new("no/map.bmp")).expect_err("a picture").to_string();
    assert!(error.contains("no/map.bmp") && error.contains(".pfm"), "{error}");
    let error = read(Path::new("no/map.pfm")).expect_err("it is not there").to_string();
    assert!(error.contains("no/map.pfm"), "{error}");
}

#[test]
fn a_small_tiff_cannot_ask_for_much_memory() {
    let mut bytes = tiff_of::<colortype::Gray32Float>(&VALUES);
    let is_width = |entry: &[u8]| entry[..2] == 256u16.to_le_bytes() && entry[4..8] == 1u32.to_le_bytes();
    let at = bytes.windows(8).position(is_width).expect("the tag of the width");
    for entry in [at, at + 12] {
        bytes[entry + 2..entry + 4].copy_from_slice(&4u16.to_le_bytes());
        bytes[entry + 8..entry + 12].copy_from_slice(&65536u32.to_le_bytes());
    }
    let error = decode("tif", &bytes).expect_err("16 GB").to_string();
    assert!(error.contains("65536x65536"), "{error}");
}
