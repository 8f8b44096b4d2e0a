//! Servers that answer with anything but what they should: each is an error that says so, and no object is lost.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::thread;

use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use dicom_transfer_syntax_registry::entries::IMPLICIT_VR_LITTLE_ENDIAN;
use dicom_ul::association::server::{ServerAssociation, ServerAssociationOptions};
use dicom_ul::pdu::{PDataValue, PDataValueType, Pdu};
use panoscope_export::dicom::export::{Input, Kind, wrap};
use panoscope_export::dicom::net::{Peer, echo, worklist};
use panoscope_export::dicom::object::Region;
use panoscope_export::dicom::{Entry, Query, outbox};
use panoscope_testing::Folder;

const WORKLIST: &str = "1.2.840.10008.5.1.4.31";

/// A server that gets one connection.
fn serve(answer: impl FnOnce(TcpStream) + Send + 'static) -> Peer {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address").to_string();
    thread::spawn(move || answer(listener.accept().expect("a connection").0));
    Peer { address, called: "ANY-SCP".parse().expect("a title"), calling: "PANOSCOPE".parse().expect("a title") }
}

/// A server that accepts everything it is asked for, and then does as `answer` says.
fn accepting(answer: impl FnOnce(ServerAssociation<TcpStream>) + Send + 'static) -> Peer {
    serve(|stream| {
        let options = ServerAssociationOptions::new().accept_any().promiscuous(true);
        if let Ok(association) = options.establish(stream) {
            answer(association);
        }
    })
}

fn number(tag: Tag, value: u16) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, VR::US, PrimitiveValue::from(value))
}

/// The command set of a response.
fn response(field: u16, id: u16, status: u16, has_data: bool) -> Vec<u8> {
    let set = InMemDicomObject::command_from_element_iter([
        number(tags::COMMAND_FIELD, field),
        number(tags::MESSAGE_ID_BEING_RESPONDED_TO, id),
        number(tags::COMMAND_DATA_SET_TYPE, if has_data { 1 } else { 0x0101 }),
        number(tags::STATUS, status),
    ]);
    let mut bytes = Vec::new();
    set.write_dataset_with_ts(&mut bytes, &IMPLICIT_VR_LITTLE_ENDIAN.erased()).expect("encoded");
    bytes
}

fn send(association: &mut ServerAssociation<TcpStream>, value_type: PDataValueType, data: Vec<u8>) -> bool {
    let value = PDataValue { presentation_context_id: 1, value_type, is_last: true, data };
    association.send(&Pdu::PData { data: vec![value] }).is_ok()
}

fn reply(association: &mut ServerAssociation<TcpStream>, value_type: PDataValueType, data: Vec<u8>) {
    send(association, value_type, data);
}

/// Reads PDUs until the last of a message has come.
fn await_request(association: &mut ServerAssociation<TcpStream>, with_data: bool) {
    let last = if with_data { PDataValueType::Data } else { PDataValueType::Command };
    while let Ok(Pdu::PData { data }) = association.receive() {
        if data.iter().any(|value| value.is_last && value.value_type == last) {
            return;
        }
    }
}

#[test]
fn no_association_is_an_error_that_says_why() {
    let cases: [(&str, Vec<u8>); 6] = [
        ("connection closed", Vec::new()),
        ("no association", vec![0xFF; 4096]),
        // A PDU that is said to have 4 GiB.
        ("too large", vec![2, 0, 0xFF, 0xFF, 0xFF, 0xF0, 0, 1]),
        // Rejected for good: the calling title is not known.
        ("calling AE title not recognized", vec![3, 0, 0, 0, 0, 4, 0, 1, 1, 3]),
        ("aborted", vec![7, 0, 0, 0, 0, 4, 0, 0, 2, 0]),
        ("no association", b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec()),
    ];
    for (words, bytes) in cases {
        let peer = serve(move |mut stream| {
            let _ = stream.read(&mut [0; 4096]);
            let _ = stream.write_all(&bytes);
        });
        let error = echo(&peer).expect_err(words).to_string();
        assert!(error.contains(words) && error.contains(&peer.address), "{words}: {error}");
    }
}

#[test]
fn answers_that_make_no_sense_are_errors() {
    type Answer = Box<dyn FnOnce(&mut ServerAssociation<TcpStream>) + Send>;
    let command = |bytes: Vec<u8>| -> Answer {
        Box::new(move |association| {
            send(association, PDataValueType::Command, bytes);
        })
    };
    let mut huge = response(0x8030, 1, 0, false);
    let length = huge.len();
    // The length of the last value: 4 GiB.
    huge[length - 6..length - 2].copy_from_slice(&[0xFF, 0xFF, 0xFF, 0xF0]);
    let cases: [(&str, Answer); 7] = [
        ("status 0x0122", command(response(0x8030, 1, 0x0122, false))),
        ("response to another request", command(response(0x8030, 7, 0, false))),
        ("response to another request", command(response(0x8001, 1, 0, false))),
        ("announced", command(huge)),
        ("cannot be read", command(vec![0xFF; 64])),
        ("wrong order", Box::new(|association| reply(association, PDataValueType::Data, vec![0; 8]))),
        ("more than 16384 bytes", command(vec![0; 20_000])),
    ];
    for (words, answer) in cases {
        let peer = accepting(|mut association| {
            await_request(&mut association, false);
            answer(&mut association);
            let _ = association.receive();
        });
        let error = echo(&peer).expect_err(words).to_string();
        assert!(error.contains(words), "{words}: {error}");
    }
}

/// An entry as implicit VR little endian, or explicit where the context has it.
fn entry_bytes(patient_id: &str) -> Vec<u8> {
    let text = |tag, vr, value: &str| DataElement::new(tag, vr, PrimitiveValue::from(value));
    let set = InMemDicomObject::from_element_iter([
        text(tags::PATIENT_ID, VR::LO, patient_id),
        text(tags::PATIENT_NAME, VR::PN, "A^B"),
        text(tags::STUDY_INSTANCE_UID, VR::UI, "1.2.3"),
    ]);
    let mut bytes = Vec::new();
    let explicit = dicom_transfer_syntax_registry::entries::EXPLICIT_VR_LITTLE_ENDIAN.erased();
    set.write_dataset_with_ts(&mut bytes, &explicit).expect("encoded");
    bytes
}

#[test]
fn a_worklist_is_limited_and_its_entries_are_checked() {
    let answer = |entries: Vec<Vec<u8>>, repeat: usize| {
        accepting(move |mut association| {
            await_request(&mut association, true);
            for entry in entries.iter().cycle().take(entries.len() * repeat) {
                if !send(&mut association, PDataValueType::Command, response(0x8020, 1, 0xFF00, true))
                    || !send(&mut association, PDataValueType::Data, entry.clone())
                {
                    return;
                }
            }
            send(&mut association, PDataValueType::Command, response(0x8020, 1, 0, false));
            let _ = association.receive();
        })
    };
    let ask = |peer: &Peer| worklist(peer, &Query::default());
    let (entries, problems) = ask(&answer(vec![entry_bytes("P-1"), entry_bytes("")], 1)).expect("a worklist");
    assert_eq!((entries.len(), problems.len()), (1, 1), "an entry without a patient is left out");
    assert_eq!((entries[0].patient_id.as_str(), entries[0].study.as_str()), ("P-1", "1.2.3"));
    let error = ask(&answer(vec![entry_bytes("P-1")], 1100)).expect_err("too many").to_string();
    assert!(error.contains("more than 1000 worklist entries"), "{error}");
    // A value of 4 GiB in an entry of a few bytes.
    let mut huge = entry_bytes("P-1");
    huge.extend(b"\x08\x00\x05\x01OB\0\0\xF0\xFF\xFF\xFF");
    let error = ask(&answer(vec![huge], 1)).expect_err("a false length").to_string();
    assert!(error.contains("announced"), "{error}");
    // The abstract syntax of the request is that of worklists.
    let peer = accepting(|association| {
        assert!(
            association.presentation_contexts().iter().all(|context| context.abstract_syntax.starts_with(WORKLIST))
        );
    });
    assert!(ask(&peer).is_err());
}

/// An outbox with one object.
fn filled(name: &str) -> Folder {
    let folder = Folder::new(name, &[]);
    let picture = folder.at("still_1.png");
    image::GrayImage::from_pixel(8, 8, image::Luma([7])).save(&picture).expect("a picture");
    let entry = Entry { patient_id: "P-1".into(), study: "1.2.3".into(), ..Entry::default() };
    let input = Input { file: picture, kind: Kind::Still };
    wrap(&entry, Region::Unknown, &[input], folder.path(), |file| Ok(file.to_owned())).expect("an object");
    folder
}

#[test]
fn an_object_leaves_the_outbox_only_when_it_is_stored() {
    type Answer = fn(&mut ServerAssociation<TcpStream>);
    let cases: [(&str, usize, Answer); 5] = [
        ("", 1, |association| reply(association, PDataValueType::Command, response(0x8001, 2, 0, false))),
        ("no room", 0, |association| reply(association, PDataValueType::Command, response(0x8001, 2, 0xA700, false))),
        ("aborted", 0, |association| {
            drop(association.send(&Pdu::AbortRQ { source: dicom_ul::pdu::AbortRQSource::ServiceUser }))
        }),
        ("closed", 0, |_| {}),
        ("has no status", 0, |association| {
            let mut bytes = response(0x8001, 2, 0, false);
            // The status is the last element, of ten bytes.
            bytes.truncate(bytes.len() - 10);
            send(association, PDataValueType::Command, bytes);
        }),
    ];
    for (words, stored, answer) in cases {
        let folder = filled("dicom-hostile-store");
        let peer = accepting(move |mut association| {
            await_request(&mut association, false);
            send(&mut association, PDataValueType::Command, response(0x8030, 1, 0, false));
            await_request(&mut association, true);
            answer(&mut association);
            if stored == 1 {
                let _ = association.receive();
            }
        });
        let sent = outbox::send(folder.path(), &peer, false).expect("the server was asked");
        let left = outbox::objects(folder.path()).expect("a folder").len();
        assert_eq!((sent.stored, left), (stored, 1 - stored), "{words}");
        assert_eq!(sent.kept.len(), left, "{words}");
        assert!(sent.kept.iter().all(|(_, error)| error.to_string().contains(words)), "{words}: {:?}", sent.kept);
    }
}
