//! Offers of viewers (SDP), and the answers to them.
//!
//! GStreamer's `webrtcbin` never sees the bytes of a viewer. An offer is read here, and [`Offer::to_text`] writes a new
//! one from the few checked values that a connection needs. Addresses of the viewer are left out: the viewer connects
//! to this machine, and this machine sends nothing to an address before it received a packet with the right password
//! from it.

use std::fmt::Write;

/// Maximum length of an offer, bytes. A browser's offer of sound and video has 7 to 10 KB.
pub const MAX_OFFER_BYTES: usize = 64 << 10;
/// Maximum number of media of an offer.
const MAX_MEDIA: usize = 16;

/// An offer that is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OfferError {
    /// It is longer than [`MAX_OFFER_BYTES`].
    #[error("the offer has {bytes} bytes; at most {MAX_OFFER_BYTES} are read")]
    Long {
        /// Its length.
        bytes: usize,
    },
    /// It is not an SDP.
    #[error("line {line} of the offer is not an SDP: send the text of an SDP offer as the body")]
    Syntax {
        /// Number of the line, from 1.
        line: usize,
    },
    /// It has too many media.
    #[error("the offer has more than {MAX_MEDIA} media: offer one video")]
    ManyMedia,
    /// It accepts no video.
    #[error("the offer has no video that receives: add a transceiver of `video` with the direction `recvonly`")]
    NoVideo,
    /// The viewer cannot decode the sent format.
    #[error("the viewer does not offer H.264 with packetization-mode 1, which this stream needs")]
    NoCodec,
    /// A value that a connection needs is missing or malformed.
    #[error("the offer has no usable `a={name}` for its video")]
    Missing {
        /// Name of the attribute.
        name: &'static str,
    },
}

/// One `m=` line and what follows it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Media<'t> {
    kind: &'t str,
    protocol: &'t str,
    formats: Vec<&'t str>,
    attributes: Vec<(&'t str, &'t str)>,
}

impl<'t> Media<'t> {
    fn parse(value: &'t str) -> Option<Self> {
        let mut words = value.split(' ');
        let (kind, port, protocol) = (words.next()?, words.next()?, words.next()?);
        let formats: Vec<&str> = words.collect();
        let is_good = is_token(kind)
            && port.parse::<u16>().is_ok()
            && protocol.split('/').all(is_token)
            && !formats.is_empty()
            && formats.iter().all(|format| is_token(format));
        is_good.then(|| Self { kind, protocol, formats, attributes: Vec::new() })
    }

    fn values<'s>(&'s self, name: &'s str) -> impl Iterator<Item = &'t str> + 's {
        self.attributes.iter().filter(move |(of, _)| *of == name).map(|(_, value)| *value)
    }

    fn has(&self, name: &str) -> bool {
        self.values(name).next().is_some()
    }

    fn mid(&self) -> Option<&'t str> {
        self.values("mid").next().filter(|mid| is_token(mid))
    }

    fn is_wanted_video(&self) -> bool {
        let is_wanted = !self.has("sendonly") && !self.has("inactive");
        self.kind == "video" && self.protocol == "UDP/TLS/RTP/SAVPF" && is_wanted
    }
}

/// A word of an SDP without separators; short, so that answers stay short.
fn is_token(word: &str) -> bool {
    let is_good = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.+".contains(&byte);
    (1..=64).contains(&word.len()) && word.bytes().all(is_good)
}

/// A name or password of ICE.
fn is_ice(word: &str, shortest: usize) -> bool {
    let is_good = |byte: u8| byte.is_ascii_alphanumeric() || b"+/-_=".contains(&byte);
    (shortest..=256).contains(&word.len()) && word.bytes().all(is_good)
}

fn is_fingerprint(value: &str) -> bool {
    let Some((hash, digest)) = value.split_once(' ') else { return false };
    let bytes = match hash.to_ascii_lowercase().as_str() {
        "sha-256" => 32,
        "sha-384" => 48,
        "sha-512" => 64,
        _ => return false,
    };
    let is_byte = |pair: &str| pair.len() == 2 && pair.bytes().all(|digit| digit.is_ascii_hexdigit());
    digest.split(':').count() == bytes && digest.split(':').all(is_byte)
}

/// H.264 as a viewer offers it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Format {
    /// RTP payload type.
    pub payload_type: u8,
    /// `profile-level-id`, six hexadecimal digits in lower case.
    pub profile_level_id: String,
}

impl Format {
    /// Order of preference; the constrained baseline profile, which is sent, comes first.
    fn rank(&self) -> usize {
        ["42e0", "42c0", "42"].iter().position(|start| self.profile_level_id.starts_with(start)).unwrap_or(usize::MAX)
    }

    fn best_of(video: &Media<'_>) -> Option<Self> {
        let maps = video.values("rtpmap").filter_map(|map| map.split_once(' '));
        let h264 = maps.filter(|(_, codec)| codec.eq_ignore_ascii_case("H264/90000"));
        let formats = h264.filter_map(|(format, _)| {
            let payload_type = format.parse::<u8>().ok().filter(|payload_type| *payload_type < 128)?;
            if !video.formats.contains(&format) {
                return None;
            }
            let settings = video.values("fmtp").find_map(|line| line.strip_prefix(format)?.strip_prefix(' '))?;
            let setting = |name: &str| {
                let pairs = settings.split(';').filter_map(|pair| pair.trim().split_once('='));
                pairs.into_iter().find(|(of, _)| of.eq_ignore_ascii_case(name)).map(|(_, value)| value)
            };
            let profile = setting("profile-level-id")?;
            let is_profile = profile.len() == 6 && profile.bytes().all(|digit| digit.is_ascii_hexdigit());
            (setting("packetization-mode") == Some("1") && is_profile)
                .then(|| Self { payload_type, profile_level_id: profile.to_ascii_lowercase() })
        });
        formats.min_by_key(Self::rank)
    }
}

/// The checked values of an offer that a connection needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Offer {
    /// Format that is sent.
    pub format: Format,
    mid: String,
    ufrag: String,
    password: String,
    fingerprint: String,
    setup: &'static str,
    feedback: Vec<&'static str>,
    /// The media in the answer, `None` for the video.
    refused: Vec<Option<String>>,
}

/// The part of an answer for a medium that is not sent.
fn refusal(media: &Media<'_>) -> String {
    let mut text =
        format!("m={} 0 {} {}\r\nc=IN IP4 0.0.0.0\r\na=inactive\r\n", media.kind, media.protocol, media.formats[0]);
    if let Some(mid) = media.mid() {
        text += &format!("a=mid:{mid}\r\n");
    }
    text
}

impl Offer {
    /// Reads an offer.
    ///
    /// # Errors
    /// It is not an SDP, or accepts no H.264 video.
    pub fn parse(bytes: &[u8]) -> Result<Self, OfferError> {
        if bytes.len() > MAX_OFFER_BYTES {
            return Err(OfferError::Long { bytes: bytes.len() });
        }
        let text = std::str::from_utf8(bytes).map_err(|_| OfferError::Syntax { line: 1 })?;
        let mut session = Media::default();
        let mut all: Vec<Media<'_>> = Vec::new();
        for (number, line) in text.lines().enumerate() {
            let syntax = OfferError::Syntax { line: number + 1 };
            let (kind, value) = match line.split_once('=') {
                Some((kind, value)) if kind.len() == 1 && (number > 0 || line == "v=0") => (kind, value),
                _ => return Err(syntax),
            };
            match kind {
                "m" if all.len() == MAX_MEDIA => return Err(OfferError::ManyMedia),
                "m" => all.push(Media::parse(value).ok_or(syntax)?),
                "a" => {
                    let attribute = value.split_once(':').unwrap_or((value, ""));
                    all.last_mut().unwrap_or(&mut session).attributes.push(attribute);
                }
                _ => {}
            }
        }
        if text.is_empty() {
            return Err(OfferError::Syntax { line: 1 });
        }
        let chosen = all.iter().position(Media::is_wanted_video).ok_or(OfferError::NoVideo)?;
        let video = &all[chosen];
        let format = Format::best_of(video).ok_or(OfferError::NoCodec)?;
        let need = |name: &'static str, is_good: &dyn Fn(&str) -> bool| {
            let value = video.values(name).chain(session.values(name)).next();
            value.filter(|value| is_good(value)).map(str::to_owned).ok_or(OfferError::Missing { name })
        };
        need("rtcp-mux", &|_| true)?;
        let setup = need("setup", &|_| true)?;
        let setups = ["actpass", "active", "passive"];
        let setup = setups.into_iter().find(|known| *known == setup).ok_or(OfferError::Missing { name: "setup" })?;
        let of_format = format.payload_type.to_string();
        let has_feedback = |wanted: &str| {
            let offered = video.values("rtcp-fb").filter_map(|line| line.split_once(' '));
            offered.into_iter().any(|(of, what)| (of == "*" || of == of_format) && what == wanted)
        };
        Ok(Self {
            mid: need("mid", &is_token)?,
            ufrag: need("ice-ufrag", &|word| is_ice(word, 4))?,
            password: need("ice-pwd", &|word| is_ice(word, 22))?,
            fingerprint: need("fingerprint", &is_fingerprint)?,
            setup,
            feedback: ["nack pli", "ccm fir"].into_iter().filter(|wanted| has_feedback(wanted)).collect(),
            refused: all.iter().enumerate().map(|(i, media)| (i != chosen).then(|| refusal(media))).collect(),
            format,
        })
    }

    /// An offer with the video only.
    pub fn to_text(&self) -> String {
        let Format { payload_type, profile_level_id } = &self.format;
        let Self { mid, ufrag, password, fingerprint, setup, .. } = self;
        let mut text = format!(
            "v=0\r\no=- 1 1 IN IP4 127.0.0.1\r\ns=-\r\nt=0 0\r\na=group:BUNDLE {mid}\r\n\
             m=video 9 UDP/TLS/RTP/SAVPF {payload_type}\r\nc=IN IP4 0.0.0.0\r\n\
             a=ice-ufrag:{ufrag}\r\na=ice-pwd:{password}\r\na=fingerprint:{fingerprint}\r\na=setup:{setup}\r\n\
             a=mid:{mid}\r\na=recvonly\r\na=rtcp-mux\r\na=rtpmap:{payload_type} H264/90000\r\n\
             a=fmtp:{payload_type} level-asymmetry-allowed=1;packetization-mode=1;profile-level-id={profile_level_id}\r\n"
        );
        for what in &self.feedback {
            // Writing to a text cannot fail.
            let _ = write!(text, "a=rtcp-fb:{payload_type} {what}\r\n");
        }
        text
    }

    /// The answer to the whole offer: `answer` is the one to [`Self::to_text`], and other media are refused. `None`
    /// unless `answer` has exactly one medium.
    pub fn complete(&self, answer: &str) -> Option<String> {
        let start = answer.find("\r\nm=")? + 2;
        let (session, video) = answer.split_at(start);
        if video.contains("\r\nm=") {
            return None;
        }
        let media = self.refused.iter().map(|refused| refused.as_deref().unwrap_or(video));
        Some(std::iter::once(session).chain(media).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FINGERPRINT: &str =
        "sha-256 00:11:22:33:44:55:66:77:88:99:AA:BB:CC:DD:EE:FF:00:11:22:33:44:55:66:77:88:99:AA:BB:CC:DD:EE:FF";

    /// The parts of a browser's offer that are read, after sound that it offers too.
    fn text() -> String {
        format!(
            "v=0\r\no=- 1 2 IN IP4 127.0.0.1\r\ns=-\r\nt=0 0\r\na=group:BUNDLE 0 1\r\n\
             m=audio 9 UDP/TLS/RTP/SAVPF 111 63\r\na=mid:0\r\na=recvonly\r\n\
             m=video 9 UDP/TLS/RTP/SAVPF 96 97 103 107 109\r\nc=IN IP4 0.0.0.0\r\na=rtcp:9 IN IP4 0.0.0.0\r\n\
             a=candidate:1 1 udp 2113937151 203.0.113.9 40000 typ host\r\n\
             a=ice-ufrag:AbCd\r\na=ice-pwd:0123456789012345678901+/\r\na=fingerprint:{FINGERPRINT}\r\na=setup:actpass\r\n\
             a=mid:1\r\na=recvonly\r\na=rtcp-mux\r\na=rtpmap:96 VP8/90000\r\na=rtpmap:97 rtx/90000\r\na=fmtp:97 apt=96\r\n\
             a=rtpmap:103 H264/90000\r\na=fmtp:103 level-asymmetry-allowed=1;packetization-mode=1;profile-level-id=64001f\r\n\
             a=rtpmap:107 H264/90000\r\na=fmtp:107 packetization-mode=0;profile-level-id=42e01f\r\n\
             a=rtpmap:109 H264/90000\r\na=rtcp-fb:109 nack\r\na=rtcp-fb:109 nack pli\r\na=rtcp-fb:96 ccm fir\r\n\
             a=fmtp:109 level-asymmetry-allowed=1;packetization-mode=1;profile-level-id=42E01F\r\n"
        )
    }

    #[test]
    fn the_baseline_profile_is_chosen_and_addresses_are_left_out() {
        let offer = Offer::parse(text().as_bytes()).unwrap();
        assert_eq!(offer.format, Format { payload_type: 109, profile_level_id: "42e01f".to_owned() });
        let written = offer.to_text();
        for line in ["a=ice-ufrag:AbCd", "a=mid:1", "a=rtcp-fb:109 nack pli", &format!("a=fingerprint:{FINGERPRINT}")] {
            assert!(written.lines().any(|have| have == line), "{line}: {written}");
        }
        assert!(!written.contains("candidate") && !written.contains("203.0.113.9"), "{written}");
        assert!(!written.contains("fir") && !written.contains("audio"), "{written}");
        // What is written is an offer with the same values.
        let again = Offer::parse(written.as_bytes()).unwrap();
        assert_eq!(again.to_text(), written);
    }

    #[test]
    fn the_answer_has_the_media_of_the_offer() {
        let offer = Offer::parse(text().as_bytes()).unwrap();
        let answer = "v=0\r\ns=-\r\nm=video 9 UDP/TLS/RTP/SAVPF 109\r\na=sendonly\r\n";
        let expected = "v=0\r\ns=-\r\nm=audio 0 UDP/TLS/RTP/SAVPF 111\r\nc=IN IP4 0.0.0.0\r\na=inactive\r\na=mid:0\r\n\
                        m=video 9 UDP/TLS/RTP/SAVPF 109\r\na=sendonly\r\n";
        assert_eq!(offer.complete(answer).as_deref(), Some(expected));
        assert_eq!(offer.complete("v=0\r\n"), None);
    }

    #[test]
    fn offers_that_cannot_be_answered_are_refused_with_the_reason() {
        let change = |from: &str, to: &str| {
            let text = text();
            assert!(text.contains(from), "{from}");
            Offer::parse(text.replace(from, to).as_bytes()).unwrap_err().to_string()
        };
        for (from, to, words) in [
            ("v=0", "v=1", "line 1"),
            ("t=0 0", "hello", "line 4"),
            ("m=video 9", "m=video nine", "line 9"),
            ("m=video", "m=text", "no video"),
            ("a=mid:1\r\na=recvonly", "a=mid:1\r\na=sendonly", "`recvonly`"),
            ("H264", "H265", "H.264"),
            ("packetization-mode=1", "packetization-mode=0", "packetization-mode 1"),
            ("a=ice-ufrag:AbCd", "a=ice-ufrag:A b", "ice-ufrag"),
            ("a=ice-pwd:01", "a=ice-pwd:0\u{1}", "ice-pwd"),
            ("sha-256 00:", "sha-256 0:", "fingerprint"),
            ("sha-256", "md5", "fingerprint"),
            ("a=setup:actpass", "a=setup:holdconn", "setup"),
            ("a=mid:1", "a=mid:1 2", "mid"),
            ("a=rtcp-mux\r\n", "", "rtcp-mux"),
        ] {
            let message = change(from, to);
            assert!(message.contains(words), "{from} -> {to}: {message}");
        }
        for bytes in [&b""[..], b"\xff\xfe", b"\0\0\0\0"] {
            assert_eq!(Offer::parse(bytes), Err(OfferError::Syntax { line: 1 }));
        }
        let many = format!("v=0\r\n{}", "m=video 9 UDP/TLS/RTP/SAVPF 96\r\n".repeat(17));
        assert_eq!(Offer::parse(many.as_bytes()), Err(OfferError::ManyMedia));
        assert!(matches!(Offer::parse(&[b'a'; MAX_OFFER_BYTES + 1]), Err(OfferError::Long { .. })));
    }
}
