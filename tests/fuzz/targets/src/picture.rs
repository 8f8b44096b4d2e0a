//! Images that the node `capture` decodes itself: PNG, EXR, TIFF, JPEG, BMP, PNM; masks of classes.

use panoscope_capture::source::decode_picture;
use panoscope_data::bit_depth::white_for;
use panoscope_data::truth::masks::{Code, MaskPicture};
use panoscope_media::input::jpeg;

/// Maximum size of masks that are divided into their parts, which takes time in proportion, px.
const MAX_PARTED: usize = 1 << 20;

pub fn run(bytes: &[u8]) {
    if let Ok(whole) = jpeg::whole(bytes) {
        assert!(whole.len() <= bytes.len() + 1024, "at most the standard tables are added");
        let _ = jpeg::check(bytes);
    }
    if let Ok(mask) = MaskPicture::decode(bytes) {
        assert_eq!(mask.colours.len(), mask.width * mask.height);
        if mask.colours.len() < MAX_PARTED {
            let parts = mask.parts(&Code::Set, 0);
            let set = mask.colours.iter().filter(|colour| **colour != [0; 3]).count();
            assert_eq!(parts.iter().map(|part| part.pixels.len()).sum::<usize>(), set, "every pixel is in one part");
        }
    }
    match decode_picture(bytes) {
        Some(Ok(picture)) => {
            assert!(picture.width > 0 && picture.height > 0);
            // Rows of three values; each value takes a byte or more.
            assert!(picture.bytes() >= 3 * picture.width * picture.height);
            // As the node uses it: the depth that holds the brightest value, then rows of eight bits.
            let peak = picture.peak();
            let Some(white) = peak.map_or(Some(255.0), |peak| white_for(peak, picture.is_float())) else {
                assert!(peak.is_some_and(|peak| peak > 65_535.0), "{peak:?}");
                return;
            };
            let mut row = vec![0; 3 * picture.width];
            for y in [0, picture.height - 1] {
                picture.write_row(0, y, white, &mut row);
            }
            picture.write_row(picture.width - 1, 0, white, &mut row[..3]);
        }
        Some(Err(error)) => assert!(!error.to_string().is_empty()),
        // A format that GStreamer decodes.
        None => {}
    }
}

pub fn seeds() -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    let color = image::RgbImage::from_fn(5, 4, |x, y| image::Rgb([x as u8, y as u8, 200]));
    let mut write = |picture: image::DynamicImage, format: image::ImageFormat| {
        let mut bytes = Vec::new();
        picture.write_to(&mut std::io::Cursor::new(&mut bytes), format).expect("a format that is built in");
        all.push(bytes);
    };
    write(color.clone().into(), image::ImageFormat::Png);
    write(color.clone().into(), image::ImageFormat::Jpeg);
    write(color.into(), image::ImageFormat::Tiff);
    let float = image::Rgb32FImage::from_fn(3, 2, |x, y| image::Rgb([x as f32, y as f32, 0.5]));
    write(float.into(), image::ImageFormat::OpenExr);
    let deep = image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::from_fn(3, 2, |x, y| image::Luma([(x * y) as u16]));
    write(deep.into(), image::ImageFormat::Png);
    let mut write = |picture: image::DynamicImage, format: image::ImageFormat| {
        let mut bytes = Vec::new();
        picture.write_to(&mut std::io::Cursor::new(&mut bytes), format).expect("a format that is built in");
        all.push(bytes);
    };
    let small =
        image::DynamicImage::from(image::RgbaImage::from_fn(3, 2, |x, y| image::Rgba([x as u8, y as u8, 9, 255])));
    write(small.clone(), image::ImageFormat::Tiff);
    write(small.to_luma8().into(), image::ImageFormat::Tiff);
    write(small.to_luma8().into(), image::ImageFormat::Jpeg);
    write(small.to_luma16().into(), image::ImageFormat::Tiff);
    write(small.to_rgb16().into(), image::ImageFormat::Tiff);
    write(small.to_rgb32f().into(), image::ImageFormat::Tiff);
    write(
        image::RgbImage::from_fn(40, 33, |x, y| image::Rgb([(x * y) as u8, (x ^ y) as u8, x as u8])).into(),
        image::ImageFormat::Jpeg,
    );
    let jpegs: Vec<Vec<u8>> = all.iter().filter(|bytes| bytes.starts_with(&[0xff, 0xd8])).cloned().collect();
    for jpeg in jpegs {
        // As Motion JPEG has them, without tables; with fill bytes before each marker; with more behind the end; cut off.
        all.push(changed_segments(&jpeg, |marker, segment| if marker == 0xc4 { Vec::new() } else { segment.to_vec() }));
        all.push(changed_segments(&jpeg, |_, segment| [&[0xff, 0xff], segment].concat()));
        all.push(changed_segments(&jpeg, |marker, segment| if marker == 0xda { Vec::new() } else { segment.to_vec() }));
        all.push([&jpeg[..], b"more"].concat());
        all.push(jpeg[..jpeg.len() - 2].to_vec());
        all.push([&jpeg[..jpeg.len() - 2], &[0xff, 0xff, 0xd9]].concat());
        all.push([&jpeg[..jpeg.len() - 12], &[0xff, 0xd9]].concat());
        let mut scan = jpeg.clone();
        for (at, byte) in scan.iter_mut().enumerate().rev().skip(3).take(40) {
            *byte ^= (at * 37) as u8 & 0x7f;
        }
        all.push(scan);
    }
    all.push(b"P5\n2 2\n255\nabcd".to_vec());
    all.push(b"P6\n2 1\n65535\nabcdefghijkl".to_vec());
    all.push(b"P2\n2 1\n9\n1 2\n".to_vec());
    all.push(b"P5\n999999999 999999999\n255\n".to_vec());
    let mut bmp = b"BM".to_vec();
    bmp.extend(62u32.to_le_bytes());
    bmp.extend([0; 4]);
    bmp.extend(54u32.to_le_bytes());
    for number in [40u32, 2, 1, 1 | 24 << 16, 0, 8, 0, 0, 0, 0] {
        bmp.extend(number.to_le_bytes());
    }
    bmp.extend([1, 2, 3, 4, 5, 6, 0, 0]);
    all.push(bmp);
    all
}

/// A JPEG with each of its segments changed; the data after the scan header stay.
fn changed_segments(jpeg: &[u8], change: impl Fn(u8, &[u8]) -> Vec<u8>) -> Vec<u8> {
    let (mut out, mut at) = (jpeg[..2].to_vec(), 2);
    while let Some(&[0xff, marker, high, low]) = jpeg.get(at..at + 4) {
        let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        out.extend(change(marker, &jpeg[at..end]));
        at = end;
        if marker == 0xda {
            break;
        }
    }
    out.extend(&jpeg[at..]);
    out
}
