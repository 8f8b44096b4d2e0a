//! The records of MCAP that hold texts. Their lengths are compared with the record before anything is allocated: a
//! four-byte length in a small damaged file can claim four gigabytes.

/// A channel record, as far as recordings use it.
pub(crate) struct Channel {
    pub id: u16,
    pub schema_id: u16,
    pub topic: String,
    pub message_encoding: String,
    pub has_metadata: bool,
}

struct Fields<'b>(&'b [u8]);

impl<'b> Fields<'b> {
    fn take(&mut self, len: usize) -> Option<&'b [u8]> {
        let (head, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(head)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take(2)?.try_into().ok().map(u16::from_le_bytes)
    }

    fn len(&mut self) -> Option<usize> {
        let bytes: [u8; 4] = self.take(4)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(bytes)).ok()
    }

    fn text(&mut self) -> Option<String> {
        let len = self.len()?;
        String::from_utf8(self.take(len)?.to_vec()).ok()
    }
}

/// Reads the body of a channel record; `None` when it is damaged.
pub(crate) fn channel(body: &[u8]) -> Option<Channel> {
    let mut fields = Fields(body);
    let (id, schema_id) = (fields.u16()?, fields.u16()?);
    let (topic, message_encoding) = (fields.text()?, fields.text()?);
    let metadata_len = fields.len()?;
    fields.take(metadata_len)?;
    Some(Channel { id, schema_id, topic, message_encoding, has_metadata: metadata_len > 0 })
}

/// Reads the body of a header record: profile and library; `None` when it is damaged.
pub(crate) fn header(body: &[u8]) -> Option<(String, String)> {
    let mut fields = Fields(body);
    Some((fields.text()?, fields.text()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
    }

    #[test]
    fn texts_are_read_and_false_lengths_are_refused() {
        let body = [&[7, 0, 1, 0][..], &text("a.b"), &text("json"), &[0; 4]].concat();
        let read = channel(&body).expect("a channel");
        assert_eq!((read.id, read.schema_id, read.topic.as_str()), (7, 1, "a.b"));
        assert_eq!((read.message_encoding.as_str(), read.has_metadata), ("json", false));
        for end in 0..body.len() {
            assert!(channel(&body[..end]).is_none(), "{end}");
        }
        // No more than the record has is allocated, whatever the length says.
        let mut long = body;
        long[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(channel(&long).is_none());
        let head = [text("panoscope"), text("library 1")].concat();
        assert_eq!(header(&head), Some(("panoscope".to_owned(), "library 1".to_owned())));
        assert!(header(&head[..head.len() - 1]).is_none() && header(&text("\u{e9}")[..5]).is_none());
    }
}
