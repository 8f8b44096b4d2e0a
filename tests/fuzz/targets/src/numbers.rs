//! Planes and clouds of numbers in files: PFM, NPY, TIFF, PNG, XYZ, PLY.

use panoscope_data::truth::points;
use panoscope_eval::eval::disparity::truth_files::{self, Loaded};
use panoscope_imaging::stereo::FloatImage;
use panoscope_imaging::stereo::formats::{read_npy, read_pfm, write_npy, write_pfm};

use crate::scratch;

fn bits(image: &FloatImage) -> Vec<u32> {
    image.data.iter().map(|value| value.to_bits()).collect()
}

fn same(a: &FloatImage, b: &FloatImage) {
    assert_eq!((a.width, a.height), (b.width, b.height));
    assert_eq!(bits(a), bits(b));
}

/// PFM and NPY, both from the same bytes.
pub fn float_image(bytes: &[u8]) {
    for read in [read_pfm, read_npy] {
        let Ok(image) = read(bytes) else { continue };
        assert_eq!(image.data.len(), image.width * image.height);
        assert!(image.data.len() <= bytes.len(), "{} values from {} bytes", image.data.len(), bytes.len());
        same(&read_pfm(&write_pfm(&image)).expect("a PFM that was written"), &image);
        same(&read_npy(&write_npy(&image)).expect("an NPY that was written"), &image);
    }
}

pub fn float_image_seeds() -> Vec<Vec<u8>> {
    let image = FloatImage { width: 3, height: 2, data: vec![1.0, f32::NAN, -0.0, 4.0, 5.5, 1e-40] };
    let npy = |header: &str, body: usize| {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.resize(bytes.len() + body, 7);
        bytes
    };
    vec![
        write_pfm(&image),
        write_npy(&image),
        b"Pf\n2 1\n1.0\n\x3f\x80\0\0\x40\0\0\0".to_vec(),
        npy("{'descr': '>f8', 'fortran_order': True, 'shape': (2, 3), }\n", 48),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (65536, 65536), }\n", 8),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (0, 9), }\n", 0),
        b"Pf\n65536 65536\n-1\n".to_vec(),
        b"PF\n1 1\n-1\n".to_vec(),
        b"Pf\n65537 1\n-1\n".to_vec(),
        b"Pf\na b c\n".to_vec(),
        b"Pf\n2 2\n-1\nabc".to_vec(),
        b"no picture".to_vec(),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1, 2), }\n", 16),
        npy("{'descr': '>f4', 'fortran_order': False, 'shape': (1, 2), }\n", 8),
        npy("{'descr': '<i4', 'fortran_order': False, 'shape': (1, 2), }\n", 8),
        npy("{'fortran_order': False, 'shape': (1, 2), }\n", 8),
        npy("{'descr': '<f4', 'shape': (1, 2, 3), }\n", 24),
        npy("{'descr': '<f4', 'shape': (x, 2), }\n", 8),
        [
            b"\x93NUMPY\x02\x00\x35\x00\x00\x00",
            &b"{'descr': '<f4', 'fortran_order': False, 'shape': (1,1)}\n"[..53],
            &[0; 8],
        ]
        .concat(),
        b"\x93NUMPY\x09\x00\x00\x00\x00\x00".to_vec(),
        b"\x93NUMPY\x01\x00\xff\xff\x00\x00".to_vec(),
    ]
}

const ENDINGS: [&str; 8] = ["pfm", "npy", "tif", "png", "xyz", "ply", "txt", "exr"];

/// A file of ground truth; the first byte selects its extension.
pub fn truth_file(bytes: &[u8]) {
    let Some((kind, bytes)) = bytes.split_first() else { return };
    let ending = ENDINGS[usize::from(*kind) % ENDINGS.len()];
    let path = scratch::file(&format!("truth.{ending}"), bytes);
    // Both kinds of TIFF read the same bytes.
    if ending == "tif"
        && let Ok(points) = points::decode(bytes)
    {
        assert_eq!(points.xyz_mm.len(), points.width * points.height);
        let is_known = |point: &[f32; 3]| point.iter().all(|v| v.is_finite()) && point[2] > 0.0;
        assert!(points.xyz_mm.iter().all(|point| is_known(point) || point.iter().all(|v| v.is_nan())));
    }
    match truth_files::read(&path, 16.0) {
        Ok(Loaded::Plane(image)) => {
            assert_eq!(image.data.len(), image.width * image.height);
            assert!(image.data.iter().all(|value| value.is_nan() || (*value > 0.0 && value.is_finite())));
            // PNG, EXR and TIFF can pack their pixels; the others hold a value in four bytes or more.
            assert!(!matches!(ending, "pfm" | "npy") || image.data.len() <= bytes.len(), "{}", image.data.len());
        }
        Ok(Loaded::Points(points)) => assert!(points.len() <= bytes.len(), "{} points", points.len()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// A TIFF of one strip of floats.
fn tiff(width: u32, height: u32, strips: &[(u32, u32)], data: &[u8]) -> Vec<u8> {
    let mut out = b"II\x2a\0\x08\0\0\0".to_vec();
    let count = strips.len() as u32;
    let directory = 8 + 2 + 8 * 12 + 4;
    let (offsets, lengths) = (directory, directory + 4 * count);
    let list = |tag: u32, at: u32, one: u32| if count == 1 { (tag, 4, 1, one) } else { (tag, 4, count, at) };
    let one = strips.first().copied().unwrap_or_default();
    let entries: [(u32, u32, u32, u32); 8] = [
        (256, 4, 1, width),
        (257, 4, 1, height),
        (258, 3, 1, 32),
        (259, 3, 1, 1),
        list(273, offsets, one.0),
        (277, 3, 1, 1),
        list(279, lengths, one.1),
        (339, 3, 1, 3),
    ];
    out.extend(8u16.to_le_bytes());
    for (tag, kind, count, value) in entries {
        out.extend((tag as u16).to_le_bytes());
        out.extend((kind as u16).to_le_bytes());
        out.extend(count.to_le_bytes());
        out.extend(value.to_le_bytes());
    }
    out.extend(0u32.to_le_bytes());
    strips.iter().for_each(|(start, _)| out.extend(start.to_le_bytes()));
    strips.iter().for_each(|(_, len)| out.extend(len.to_le_bytes()));
    out.extend(data);
    out
}

pub fn truth_file_seeds() -> Vec<Vec<u8>> {
    let mut all: Vec<Vec<u8>> = Vec::new();
    let mut add = |ending: &str, bytes: &[u8]| {
        let kind = ENDINGS.iter().position(|known| *known == ending).expect("a known ending");
        all.push([&[kind as u8], bytes].concat());
    };
    let image = FloatImage { width: 2, height: 1, data: vec![1.0, 2.0] };
    add("pfm", &write_pfm(&image));
    add("npy", &write_npy(&image));
    let floats = [1.5f32, 2.5].map(f32::to_le_bytes).concat();
    add("tif", &tiff(2, 1, &[(118, 8)], &floats));
    add("tif", &tiff(65536, 65536, &[(118, 8)], &floats));
    // Every strip is the whole file.
    add("tif", &tiff(65536, 65536, &[(0, 500); 60], &floats));
    let big = |bytes: Vec<u8>| {
        // The same file with the other byte order: all its numbers are those of `tiff`.
        let mut out = bytes;
        out[..4].copy_from_slice(b"MM\0\x2a");
        out[4..8].reverse();
        out[8..10].reverse();
        for entry in 0..8 {
            let at = 10 + 12 * entry;
            out[at..at + 2].reverse();
            let is_short = out[at + 2] == 3;
            out[at + 2..at + 4].reverse();
            out[at + 4..at + 8].reverse();
            if is_short { out[at + 8..at + 10].reverse() } else { out[at + 8..at + 12].reverse() }
        }
        out
    };
    let floats_big = [1.5f32, 2.5].map(f32::to_be_bytes).concat();
    add("tif", &big(tiff(2, 1, &[(118, 8)], &floats_big)));
    add("tif", &tiff(2, 1, &[(126, 4), (130, 4)], &[&[0; 8][..], &floats].concat()));
    add("tif", &tiff(0, 1, &[(118, 8)], &floats));
    add("tif", &tiff(2, 2, &[(118, 8)], &[&floats[..], &[0; 64]].concat()));
    add("tif", &tiff(2, 1, &[(118, 800)], &floats));
    let mut other = tiff(2, 1, &[(118, 8)], &floats);
    // Another number of bits, and another type of a tag.
    other[10 + 2 * 12 + 8] = 16;
    add("tif", &other);
    let mut other = tiff(2, 1, &[(118, 8)], &floats);
    other[10 + 2] = 5;
    add("tif", &other);
    add("tif", b"no TIFF");
    add("xyz", b"");
    add("xyz", b"1 2\n");
    add("xyz", b"# points\n1 2 3\n4;5;6 7\n");
    add("txt", b"1,2\n");
    let header =
        "ply\nformat FORMAT 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty double z\nend_header\n";
    add("ply", [&header.replace("FORMAT", "ascii"), "1 2 3\n"].concat().as_bytes());
    add("ply", &[header.replace("FORMAT", "binary_little_endian").as_bytes(), &[0; 16]].concat());
    add("ply", header.replace("FORMAT", "ascii").replace("vertex 1", "vertex 99999999999").as_bytes());
    add("ply", header.replace("FORMAT", "binary_big_endian").as_bytes());
    add("ply", header.replace("FORMAT", "ascii").replace("vertex 1", "vertex one").as_bytes());
    add("ply", header.replace("FORMAT", "ascii").replace("float x", "float w").as_bytes());
    add("ply", b"ply\n");
    let other = "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty uchar a\nproperty short b\nproperty double x\n\
        property float y\nproperty int z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n";
    add("ply", &[other.as_bytes(), &[1; 2 * 19]].concat());
    add("ply", &[other.as_bytes(), &[1; 19]].concat());
    let mut png = Vec::new();
    let picture = image::GrayImage::from_fn(3, 2, |x, y| image::Luma([(x + y) as u8]));
    picture.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).expect("a PNG");
    add("png", &png);
    add("png", b"no PNG");
    let mut png = Vec::new();
    let picture = image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::from_fn(3, 2, |x, y| image::Luma([(x * y) as u16]));
    picture.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).expect("a PNG");
    add("png", &png);
    all
}
