//! Files of floats, and scores against truth.

use crate::stereo_common::*;
use panoscope_imaging::stereo::formats::{read_npy, read_pfm, write_npy, write_pfm};
use panoscope_imaging::stereo::{FloatImage, MapScorer, score_disparity, score_surface};

fn image() -> FloatImage {
    FloatImage { width: 5, height: 3, data: (0..15).map(|i| i as f32 * 1.25 - 4.0).collect() }
}

/// The image as PFM with another header.
fn with_header(header: &[u8]) -> Vec<u8> {
    let pfm = write_pfm(&image());
    [header, &pfm[pfm.len() - 4 * 15..]].concat()
}

#[test]
fn files_come_back_as_they_were() {
    let image = image();
    assert_eq!(read_pfm(&write_pfm(&image)).unwrap(), image);
    assert_eq!(read_npy(&write_npy(&image)).unwrap(), image);
    let empty = FloatImage::default();
    assert_eq!(read_npy(&write_npy(&empty)).unwrap(), empty);
    assert_eq!(write_npy(&image).len() % 64, 60);
}

#[test]
fn other_byte_orders_and_layouts_are_read() {
    let mut pfm = b"Pf 2 2 1.0\n".to_vec();
    for value in [3.0f32, 4.0, 1.0, 2.0] {
        pfm.extend(value.to_be_bytes());
    }
    assert_eq!(read_pfm(&pfm).unwrap().data, [1.0, 2.0, 3.0, 4.0]);
    // Lines of Windows; and a header of one line whose first value begins with a byte that is a line feed, too.
    let crlf = with_header(b"Pf\r\n5 3\r\n-1.0\r\n");
    assert_eq!(read_pfm(&crlf).unwrap(), image());
    assert!((0..crlf.len()).all(|length| read_pfm(&crlf[..length]).is_err()));
    let value = [0x0A, 0, 0x80, 0x3F];
    assert_eq!(read_pfm(&[&b"Pf 1 1 -1.0\r"[..], &value].concat()).unwrap().data, [f32::from_le_bytes(value)]);
    let mut npy = b"\x93NUMPY\x01\x00".to_vec();
    let header = "{'descr': '>f8', 'fortran_order': True, 'shape': (2, 3)}\n";
    npy.extend((header.len() as u16).to_le_bytes());
    npy.extend(header.bytes());
    for value in [1.0f64, 4.0, 2.0, 5.0, 3.0, 6.0] {
        npy.extend(value.to_be_bytes());
    }
    let image = read_npy(&npy).unwrap();
    assert_eq!((image.width, image.height, image.data), (3, 2, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
}

#[test]
fn damaged_files_are_refused_at_every_length() {
    let (pfm, npy) = (write_pfm(&image()), write_npy(&image()));
    for length in 0..pfm.len() {
        assert!(read_pfm(&pfm[..length]).is_err(), "PFM cut at {length}");
    }
    for length in 0..npy.len() {
        assert!(read_npy(&npy[..length]).is_err(), "NPY cut at {length}");
    }
    assert!(read_pfm(b"PF\n2 2\n-1\n").unwrap_err().to_string().contains("three channels"));
    assert!(read_pfm(b"Pf 99999999999 2 -1\n").is_err());
    assert!(read_npy(b"\x93NUMPY\x01\x00\x30\x00{'descr': '<i4', 'shape': (1, 1), } ........").is_err());
}

#[test]
fn scores_count_missing_pixels_as_bad() {
    let truth = [10.0, 10.0, 10.0, 10.0, f32::INFINITY, 10.0];
    let found = [10.5, 11.5, 13.0, f32::NAN, 1.0, 20.0];
    let score = score_disparity(plane(&found, 3, 2), plane(&truth, 3, 2), None).unwrap();
    assert_eq!(score.pixels, 5);
    assert!((score.density - 0.8).abs() < 1e-12);
    assert_eq!(score.bad, [0.8, 0.6, 0.4, 0.4]);
    assert_eq!(score.bad_of_known, [0.75, 0.5, 0.25, 0.25]);
    assert!((score.mean_error_px - 15.0 / 4.0).abs() < 1e-6);
    assert_eq!(score.p95_error_px, 10.0);
    let mask = [1, 1, 0, 0, 1, 0];
    let score = score_disparity(plane(&found, 3, 2), plane(&truth, 3, 2), Some(gray(&mask, 3, 2))).unwrap();
    assert_eq!((score.pixels, score.bad), (2, [0.5, 0.0, 0.0, 0.0]));
    assert!(score_disparity(plane(&found, 2, 3), plane(&truth, 3, 2), None).is_err());
}

#[test]
fn depth_is_scored_where_both_are_known() {
    let truth = [50.0, 50.0, 50.0, 50.0, f32::NAN, 50.0];
    let found = [50.5, 49.0, 52.0, f32::NAN, 1.0, 60.0];
    let mut scorer = MapScorer::default();
    let score = scorer.depth(plane(&found, 3, 2), plane(&truth, 3, 2), None).unwrap();
    assert_eq!((score.pixels, score.density), (5, 0.8));
    // Errors are 0.5, 1, 2 and 10: of four values rank 2 is the median, rank 3 the 95th percentile.
    assert_eq!((score.median_error_mm, score.mean_error_mm, score.p95_error_mm), (2.0, 3.375, 10.0));
    let score = scorer.depth(plane(&[f32::NAN; 6], 3, 2), plane(&truth, 3, 2), None).unwrap();
    assert!(score.density == 0.0 && score.mean_error_mm.is_nan() && score.p95_error_mm.is_nan());
    assert!(scorer.depth(plane(&found, 2, 3), plane(&truth, 3, 2), None).is_err());
}

#[test]
fn surface_distance_is_the_nearest_points() {
    let surface: Vec<[f32; 3]> = (0..400).map(|i| [(i % 20) as f32, (i / 20) as f32, 50.0]).collect();
    let measured: Vec<[f32; 3]> = (0..100).map(|i| [(i % 10) as f32 + 3.0, (i / 10) as f32 + 2.0, 50.5]).collect();
    let score = score_surface(&measured, &surface, 2.0).unwrap();
    assert_eq!((score.points, score.within_reach), (100, 1.0));
    assert!((score.median_mm - 0.5).abs() < 1e-6 && (score.p95_mm - 0.5).abs() < 1e-6);
    let far = [[100.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0]];
    let score = score_surface(&far, &surface, 2.0).unwrap();
    assert_eq!((score.points, score.median_mm, score.within_reach), (1, 2.0, 0.0));
    assert!(score_surface(&measured, &[], 2.0).is_err() && score_surface(&measured, &surface, f32::NAN).is_err());
}
