//! Frames that describe themselves: source, tick, and the nodes that made them. All other pixels are derived from that, so that a reader detects
//! every byte of another tick, of an old frame or of unwritten memory.

use crate::world::point;
use panoscope_base::random::SplitMix64;

/// A node that a frame passed through, with the values that the node had.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Step {
    /// [`name_hash`] of the node.
    pub node: u32,
    /// Number of the node's values.
    pub values: u32,
}

/// Description of a frame.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Content {
    /// Number of the tick.
    pub seq: u64,
    /// The nodes, from the source on.
    pub steps: Vec<Step>,
}

/// Maximum number of steps of a frame.
pub const MAX_STEPS: usize = 20;
/// Minimum size of a frame that holds all steps, bytes.
pub const MIN_BYTES: usize = HEAD_BYTES + MAX_STEPS * 8 + 8;
const HEAD_BYTES: usize = 4 + 4 + 8 + 4;
const MAGIC: [u8; 4] = *b"PSIM";
/// Number of bytes that are written or read between two points at which another thread may run.
const PIECE_BYTES: usize = 128;
/// Maximum size of a frame, bytes.
const MAX_BYTES: usize = 1 << 16;

/// Identifier of a node in a frame.
pub fn name_hash(name: &str) -> u32 {
    panoscope_abi::fnv1a(panoscope_abi::FNV_START, name.as_bytes()) as u32
}

impl Content {
    fn head(&self, len: usize) -> Vec<u8> {
        let mut head = MAGIC.to_vec();
        head.extend((len as u32).to_le_bytes());
        head.extend(self.seq.to_le_bytes());
        head.extend((self.steps.len() as u32).to_le_bytes());
        for step in &self.steps {
            head.extend(step.node.to_le_bytes());
            head.extend(step.values.to_le_bytes());
        }
        let hash = panoscope_abi::fnv1a(panoscope_abi::FNV_START, &head);
        head.extend(hash.to_le_bytes());
        head
    }

    /// All bytes of a frame of `len` bytes.
    fn bytes(&self, len: usize) -> Vec<u8> {
        let mut bytes = self.head(len);
        let mut rest = SplitMix64(panoscope_abi::fnv1a(panoscope_abi::FNV_START, &bytes));
        while bytes.len() < len {
            bytes.extend(rest.bits().to_le_bytes());
        }
        bytes.truncate(len);
        bytes
    }

    /// Writes the frame piece by piece.
    pub fn write(&self, out: &mut [u8]) {
        let bytes = self.bytes(out.len());
        for (to, from) in out.chunks_mut(PIECE_BYTES).zip(bytes.chunks(PIECE_BYTES)) {
            to.copy_from_slice(from);
            point();
        }
    }

    /// The bytes `from..to` of a frame of `len` bytes, for threads that write a part each.
    pub fn part(&self, len: usize, from: usize, to: usize) -> Vec<u8> {
        self.bytes(len)[from..to].to_vec()
    }

    /// Reads a frame piece by piece.
    ///
    /// # Errors
    /// The first wrong byte.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        let mut copy = Vec::with_capacity(bytes.len());
        for piece in bytes[..bytes.len().min(MAX_BYTES)].chunks(PIECE_BYTES) {
            copy.extend_from_slice(piece);
            point();
        }
        let number = |at: usize| copy.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        if copy.get(..4) != Some(&MAGIC) {
            let poisoned = copy.iter().take(4).all(|byte| *byte == crate::engine::POISON);
            let what = if poisoned { "memory that nobody wrote" } else { "no picture" };
            return Err(format!("{what}: it begins with {:02x?}", &copy[..copy.len().min(8)]));
        }
        let (Some(len), Some(count)) = (number(4), number(16)) else { return Err("it is too short".to_owned()) };
        if len as usize != copy.len() || count as usize > MAX_STEPS {
            return Err(format!("a picture of {len} bytes with {count} steps in {} bytes", copy.len()));
        }
        let seq = u64::from(number(8).unwrap_or(0)) | u64::from(number(12).unwrap_or(0)) << 32;
        let step = |at: usize| Some(Step { node: number(at)?, values: number(at + 4)? });
        let steps = (0..count as usize).map_while(|n| step(HEAD_BYTES + n * 8)).collect();
        let content = Self { seq, steps };
        let expected = content.bytes(copy.len());
        match expected.iter().zip(&copy).position(|(a, b)| a != b) {
            None => Ok(content),
            Some(at) => {
                let wrong = expected.iter().zip(&copy).filter(|(a, b)| a != b).count();
                Err(format!("tick {seq}: {wrong} of {len} bytes are wrong, the first at {at}: {:02x}", copy[at]))
            }
        }
    }

    /// The frame after another node.
    #[must_use]
    pub fn then(&self, node: u32, values: u32) -> Self {
        let mut next = self.clone();
        next.steps.push(Step { node, values });
        next
    }
}
