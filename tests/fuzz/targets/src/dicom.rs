//! DICOM: entries of worklists and heads of files, videos in MP4, JPEG heads, tables of measurements.

use std::io::Cursor;

use panoscope_export::dicom::lengths::Encoding;
use panoscope_export::dicom::object::{Lengths, parse_jpeg, parse_mp4};
use panoscope_export::dicom::part10::Head;
use panoscope_export::dicom::{Entry, uid};

pub fn entry(bytes: &[u8]) {
    for encoding in [Encoding::Implicit, Encoding::Explicit] {
        match Entry::decode(bytes, encoding) {
            Ok(entry) => {
                assert!(uid::is_valid(&entry.study) && !entry.patient_id.is_empty(), "{entry:?}");
                assert!(!entry.patient_name.chars().any(char::is_control), "{entry:?}");
                assert!(entry.has_key(&entry.study));
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
    if let Ok(head) = Head::parse(bytes) {
        assert!(head.length <= bytes.len() && uid::is_valid(&head.instance), "{head:?}");
    }
}

/// An element in explicit VR with a short length.
fn explicit(tag: [u16; 2], vr: &[u8; 2], value: &[u8]) -> Vec<u8> {
    [&tag[0].to_le_bytes()[..], &tag[1].to_le_bytes(), vr, &(value.len() as u16).to_le_bytes(), value].concat()
}

/// The same without value representation.
fn implicit(tag: [u16; 2], value: &[u8]) -> Vec<u8> {
    [&tag[0].to_le_bytes()[..], &tag[1].to_le_bytes(), &(value.len() as u32).to_le_bytes(), value].concat()
}

pub fn entry_seeds() -> Vec<Vec<u8>> {
    let plain: [([u16; 2], &[u8; 2], &[u8]); 6] = [
        ([8, 5], b"CS", b"ISO_IR 100"),
        ([8, 0x50], b"SH", b"A1001 "),
        ([0x10, 0x10], b"PN", b"M\xFCller^Anna "),
        ([0x10, 0x20], b"LO", b"P-7 "),
        ([0x10, 0x30], b"DA", b"19700102"),
        ([0x20, 0x0D], b"UI", b"1.2.3\0"),
    ];
    let item = implicit([0xFFFE, 0xE000], &explicit([8, 0x60], b"CS", b"ES"));
    let steps = [&[0x40, 0, 0, 1][..], b"SQ\0\0", &(item.len() as u32).to_le_bytes(), &item].concat();
    let whole: Vec<u8> =
        plain.iter().flat_map(|(tag, vr, value)| explicit(*tag, vr, value)).chain(steps.clone()).collect();
    let step = implicit([0xFFFE, 0xE000], &implicit([8, 0x60], b"ES"));
    let without: Vec<u8> =
        plain.iter().flat_map(|(tag, _, value)| implicit(*tag, value)).chain(implicit([0x40, 0x100], &step)).collect();
    let head = [
        explicit([2, 2], b"UI", b"1.2.840.10008.5.1.4.1.1.7\0"),
        explicit([2, 3], b"UI", b"2.25.77\0"),
        explicit([2, 0x10], b"UI", b"1.2.840.10008.1.2.1\0"),
    ]
    .concat();
    let file = [&[0; 128][..], b"DICM", &explicit([2, 0], b"UL", &(head.len() as u32).to_le_bytes()), &head, &whole];
    let open = [&[0x40, 0, 0, 1][..], b"SQ\0\0", &[0xFF; 4]].concat().repeat(20);
    vec![whole.clone(), without, file.concat(), whole[..whole.len() - 3].to_vec(), steps, open, Vec::new()]
}

pub fn film(bytes: &[u8]) {
    match parse_mp4(&mut Cursor::new(bytes)) {
        Ok(film) => {
            assert!(film.frames > 0 && film.size.0 > 0 && film.size.1 > 0, "{film:?}");
            assert!(film.seconds > 0.0 && film.seconds.is_finite(), "{film:?}");
        }
        Err(problem) => assert!(!problem.to_string().is_empty()),
    }
    if let Some(jpeg) = parse_jpeg(bytes) {
        assert!(bytes.len() > 10, "{jpeg:?}");
    }
}

fn boxed(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    [&(content.len() as u32 + 8).to_be_bytes()[..], kind, content].concat()
}

/// An MP4 file of 12 frames without their data.
fn mp4(profile: u8) -> Vec<u8> {
    let words = |words: &[u32]| words.iter().flat_map(|word| word.to_be_bytes()).collect::<Vec<u8>>();
    let coding = boxed(b"avcC", &[1, profile, 0, 30, 0xFF, 0xE1, 0, 1, 0x67, 1, 0, 1, 0x68, 0xFD, 0xF8, 0xF8, 0]);
    let mut picture = vec![0; 78];
    picture[24..28].copy_from_slice(&[0, 160, 0, 120]);
    picture.extend(coding);
    let entry = boxed(b"avc1", &picture);
    let table = [boxed(b"stsd", &[words(&[0, 1]), entry].concat()), boxed(b"stts", &words(&[0, 2, 11, 1000, 1, 1001]))];
    let media = [
        boxed(b"mdhd", &words(&[0, 0, 0, 30_000, 12_001, 0])),
        boxed(b"hdlr", &[&words(&[0, 0])[..], b"vide", &[0; 13]].concat()),
        boxed(b"minf", &boxed(b"stbl", &table.concat())),
    ];
    let track = boxed(b"trak", &boxed(b"mdia", &media.concat()));
    let large = [&1u32.to_be_bytes()[..], b"mdat", &24u64.to_be_bytes(), &[7; 8]].concat();
    [boxed(b"ftyp", b"isom\0\0\0\0"), large, boxed(b"moov", &track)].concat()
}

pub fn film_seeds() -> Vec<Vec<u8>> {
    let whole = mp4(100);
    let mut jpeg = Vec::new();
    let picture = image::RgbImage::new(8, 8);
    picture.write_to(&mut Cursor::new(&mut jpeg), image::ImageFormat::Jpeg).expect("a JPEG");
    let mut endless = whole.clone();
    endless[3] = 0;
    vec![whole.clone(), mp4(66), whole[..whole.len() - 20].to_vec(), endless, jpeg, Vec::new()]
}

pub fn lengths(bytes: &[u8]) {
    match Lengths::read(bytes) {
        Ok(lengths) => {
            for row in &lengths.rows {
                assert!(row.value.is_finite() && row.error.is_none_or(f64::is_finite), "{row:?}");
                assert!(row.points.len() <= 4 && row.points.iter().flatten().all(|px| px.is_finite()), "{row:?}");
            }
            assert!(lengths.picture.is_none_or(|name| name.components().count() == 1));
        }
        Err(problem) => assert!(!problem.to_string().is_empty()),
    }
}

pub fn lengths_seeds() -> Vec<Vec<u8>> {
    let row =
        br#"{"picture":"a.png","table":[{"u0_px":1,"v0_px":2,"u1_px":3,"v1_px":4,"distance_mm":9.5,"error_mm":0.5}]}"#;
    vec![
        row.to_vec(),
        [&row[..], b"\n", &row[..50]].concat(),
        b"{\"table\":[{\"u_px\":1,\"v_px\":2,\"depth_mm\":50,\"error_mm\":null}]}\n".to_vec(),
        b"{\"table\":[{\"segment_mm\":1,\"segment_error_mm\":1e400,\"length_mm\":3,\"error_mm\":1}]}\n".to_vec(),
        b"{\"table\":[{\"angle_deg\":90,\"error_deg\":1}]}\n{\"picture\":\"../x\",\"table\":[]}\n".to_vec(),
        b"\n\n{}\n[".to_vec(),
    ]
}
