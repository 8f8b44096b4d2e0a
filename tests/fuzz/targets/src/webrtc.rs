//! Offers of web browsers that want to watch a stream.

use panoscope_media::offer::Offer;

/// An offer. An accepted one reads as the same offer when it is passed on, and contains only lines of plain text.
pub fn offer(bytes: &[u8]) {
    let Ok(offer) = Offer::parse(bytes) else { return };
    let text = offer.to_text();
    assert!(text.lines().all(|line| line.as_bytes().get(1) == Some(&b'=')), "{text}");
    assert!(text.bytes().all(|byte| byte == b'\r' || byte == b'\n' || (b' '..=b'~').contains(&byte)), "{text}");
    assert_eq!(text.matches("m=").count(), 1, "{text}");
    assert!(text.len() < 2048, "{} bytes", text.len());
    let again = Offer::parse(text.as_bytes()).expect("an offer");
    assert_eq!((again.to_text(), again.format.clone()), (text, offer.format.clone()));
    let media = bytes.split(|byte| *byte == b'\n').filter(|line| line.starts_with(b"m=")).count();
    let answer = offer.complete("v=0\r\nm=video 9 UDP/TLS/RTP/SAVPF 96\r\n").expect("an answer to one medium");
    assert_eq!(answer.matches("\r\nm=").count(), media, "{answer}");
}

pub fn offer_seeds() -> Vec<Vec<u8>> {
    let digest = ["0A"; 32].join(":");
    let whole = format!(
        "v=0\r\no=- 1 2 IN IP4 127.0.0.1\r\ns=-\r\nt=0 0\r\na=group:BUNDLE 0 1\r\na=setup:actpass\r\n\
         m=audio 9 UDP/TLS/RTP/SAVPF 111\r\na=mid:0\r\n\
         m=video 9 UDP/TLS/RTP/SAVPF 96 102\r\nc=IN IP4 0.0.0.0\r\na=ice-ufrag:abcd\r\na=ice-pwd:0123456789012345678901\r\n\
         a=fingerprint:sha-256 {digest}\r\na=mid:1\r\na=recvonly\r\na=rtcp-mux\r\na=rtpmap:96 VP8/90000\r\n\
         a=rtpmap:102 H264/90000\r\na=rtcp-fb:102 nack pli\r\n\
         a=fmtp:102 level-asymmetry-allowed=1;packetization-mode=1;profile-level-id=42e01f\r\n\
         m=application 9 UDP/DTLS/SCTP webrtc-datachannel\r\na=mid:2\r\n"
    );
    let half = whole.as_bytes()[..whole.len() / 2].to_vec();
    vec![
        whole.replace("recvonly", "sendonly").into_bytes(),
        whole.replace("sha-256", "sha-512").into_bytes(),
        whole.replace("H264", "H265").into_bytes(),
        whole.into_bytes(),
        half,
        b"v=0\r\n".to_vec(),
    ]
}
