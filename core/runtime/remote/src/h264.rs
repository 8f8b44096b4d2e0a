//! Colour images as H.264: a stream for each input and output of an instance.
//!
//! Frames of a lane are sent and unpacked in their order, and a connection that is lost takes its streams with it: the
//! next one begins with a key frame. An image of another size, or one that does not compress, restarts its stream.

use std::collections::HashMap;

use gstreamer::Fraction;
use panoscope_engine::isolation::Pixels;
use panoscope_host::isolate::relay::messages::Picture;
use panoscope_media::{Decoder, Encoder, EncoderSettings, Framing, MediaError, RateControl, VideoCodec};

/// The constant rate factor of x264: 18 is visually close to the original.
const CODEC: VideoCodec = VideoCodec::H264 { rate: RateControl::Crf(18) };
/// Images between keyframes. Long, because a connection loses no data.
const KEY_INTERVAL: u32 = 250;
/// Minimum side of an image for a stream, px.
const MIN_SIDE: u32 = 32;
/// Maximum number of streams of a connection.
const MAX_STREAMS: usize = 1024;

/// Lane and stream.
type Key = (u32, u32);

/// This machine cannot code pixels as H.264.
#[derive(Debug, thiserror::Error)]
#[error("pixels = \"h264\" cannot be used: {0}")]
pub struct Unusable(#[from] MediaError);

/// An image from the other machine that cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// It has more or fewer pixels than the frame.
    #[error("an image of the other machine does not match its frame")]
    Size,
    /// A new stream beyond [`MAX_STREAMS`].
    #[error("the other machine has too many streams")]
    TooManyStreams,
    /// Its stream never began.
    #[error("an image of the other machine has no stream")]
    NoStream,
    /// An error of the decoder.
    #[error("an image of the other machine cannot be decoded: {0}")]
    Media(#[from] MediaError),
}

/// Checks whether this machine can encode pixels in this way.
///
/// # Errors
/// Something is missing; the error names its package.
pub fn check(pixels: Pixels) -> Result<(), Unusable> {
    if pixels != Pixels::H264 {
        return Ok(());
    }
    Ok(CODEC.check().and_then(|()| Decoder::check())?)
}

/// Streams to the other machine.
#[derive(Default)]
pub struct Encoders(HashMap<Key, (Encoder, (u32, u32))>);

impl Encoders {
    /// Encodes the next image of a stream; `size`: columns, rows, bytes from row to row. `None` for an image that
    /// should be sent without loss.
    pub fn encode(&mut self, key: Key, size: (u32, u32, u32), bytes: &[u8]) -> Option<(Picture, Vec<u8>)> {
        let (width, height, stride_bytes) = size;
        let picture = Picture { stream: key.1, width, height, stride_bytes, begins: false };
        if width.min(height) < MIN_SIDE || !picture.fits(bytes.len() as u64) {
            return None;
        }
        let coded = self.encoded(key, &picture, bytes).ok().flatten();
        if coded.is_none() {
            // Its decoder does not see this picture.
            self.0.remove(&key);
        }
        coded
    }

    fn encoded(&mut self, key: Key, picture: &Picture, bytes: &[u8]) -> Result<Option<(Picture, Vec<u8>)>, MediaError> {
        let Picture { width, height, stride_bytes, .. } = *picture;
        let begins = self.0.get(&key).is_none_or(|(_, size)| *size != (width, height));
        let size_px = (width as usize, height as usize);
        if begins {
            if self.0.len() >= MAX_STREAMS && !self.0.contains_key(&key) {
                return Ok(None);
            }
            let settings = EncoderSettings {
                codec: CODEC,
                framing: Framing::StartCodes,
                size_px,
                rate_hz: Fraction::new(30, 1),
                key_interval: KEY_INTERVAL,
            };
            self.0.insert(key, (Encoder::new(settings)?, (width, height)));
        }
        let Some((encoder, _)) = self.0.get_mut(&key) else { return Ok(None) };
        let row = size_px.0 * 3;
        let packed: Vec<u8>;
        let rows = match stride_bytes as usize == row {
            true => bytes.get(..row * size_px.1),
            false => {
                packed = bytes.chunks(stride_bytes as usize).take(size_px.1).flat_map(|r| &r[..row]).copied().collect();
                Some(&packed[..])
            }
        };
        let Some(rows) = rows else { return Ok(None) };
        let packets = encoder.encode(rows, size_px, 0)?;
        // One picture in, one packet out; otherwise it waits for a later one, which the other machine cannot.
        let [packet] = &packets[..] else { return Ok(None) };
        let Ok(map) = packet.buffer.map_readable() else { return Ok(None) };
        let is_shorter = map.len() < bytes.len();
        Ok(is_shorter.then(|| (Picture { begins, ..*picture }, map.to_vec())))
    }
}

/// Streams from the other machine.
#[derive(Default)]
pub struct Decoders(HashMap<Key, Decoder>);

impl Decoders {
    /// Decodes the next image of a stream into a frame.
    ///
    /// # Errors
    /// It is not an image of this stream.
    pub fn decode(&mut self, lane: u32, picture: &Picture, coded: Vec<u8>, to: &mut [u8]) -> Result<(), DecodeError> {
        let key = (lane, picture.stream);
        if !picture.fits(to.len() as u64) {
            return Err(DecodeError::Size);
        }
        if picture.begins {
            if self.0.len() >= MAX_STREAMS && !self.0.contains_key(&key) {
                return Err(DecodeError::TooManyStreams);
            }
            self.0.insert(key, Decoder::new()?);
        }
        let decoder = self.0.get_mut(&key).ok_or(DecodeError::NoStream)?;
        let size_px = (picture.width as usize, picture.height as usize);
        Ok(decoder.decode(coded, size_px, picture.stride_bytes as usize, to)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_begin_with_each_size_and_come_back() {
        let (mut encoders, mut decoders) = (Encoders::default(), Decoders::default());
        let mut begun = 0;
        for (number, width) in [64, 64, 64, 80, 80, 64].into_iter().enumerate() {
            let (stride, height) = (width * 3 + 4, 48);
            let bytes: Vec<u8> = (0..stride * height).map(|at| (at / stride * 4 + number as u32) as u8).collect();
            let (picture, coded) = encoders.encode((7, 1), (width, height, stride), &bytes).expect("it is coded");
            assert!(coded.len() < bytes.len() / 4, "{} bytes", coded.len());
            begun += u32::from(picture.begins);
            let mut arrived = vec![0; bytes.len()];
            decoders.decode(7, &picture, coded, &mut arrived).expect("it is decoded");
            let rows = |bytes: &[u8]| {
                bytes.chunks(stride as usize).flat_map(|row| row[..width as usize * 3].to_vec()).collect::<Vec<_>>()
            };
            let worst = rows(&bytes).iter().zip(rows(&arrived)).map(|(a, b)| a.abs_diff(b)).max();
            assert!(worst < Some(24), "{worst:?}");
        }
        assert_eq!(begun, 3);
        assert!(encoders.encode((7, 1), (16, 16, 48), &[0; 768]).is_none(), "too small");
        let lost = Picture { stream: 2, width: 64, height: 48, stride_bytes: 192, begins: false };
        assert!(decoders.decode(7, &lost, vec![0; 9], &mut [0; 9216]).is_err(), "a stream that never began");
    }
}
