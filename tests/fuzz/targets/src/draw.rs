//! Values drawn from bytes, for inputs that are structures in memory.

/// Draws values from the front of the bytes; zero when they are used up.
pub struct Draw<'b>(pub &'b [u8]);

impl<'b> Draw<'b> {
    fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        let (head, rest) = self.0.split_at(N.min(self.0.len()));
        out[..head.len()].copy_from_slice(head);
        self.0 = rest;
        out
    }

    pub fn u8(&mut self) -> u8 {
        self.array::<1>()[0]
    }

    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.array())
    }

    pub fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.array())
    }

    pub fn f64(&mut self) -> f64 {
        f64::from_bits(self.u64())
    }

    /// Up to `most` bytes; the first byte gives the number.
    pub fn bytes(&mut self, most: usize) -> &'b [u8] {
        let len = usize::from(self.u8()).min(most).min(self.0.len());
        let (head, rest) = self.0.split_at(len);
        self.0 = rest;
        head
    }
}
