//! Borrowed images: a slice, a size, a channel count and a stride.

/// Read-only image of `channels` interleaved elements per pixel.
#[derive(Clone, Copy, Debug)]
pub struct View<'a, T> {
    /// Elements, row after row.
    pub data: &'a [T],
    /// Columns, in pixels.
    pub width: usize,
    /// Rows, in pixels.
    pub height: usize,
    /// Elements from one row's start to the next one's.
    pub stride: usize,
    /// Elements per pixel: 1 (gray), 3 (BGR) or 4 (RGBA).
    pub channels: usize,
}

/// Writable image of `channels` interleaved elements per pixel.
#[derive(Debug)]
pub struct ViewMut<'a, T> {
    /// Elements, row after row.
    pub data: &'a mut [T],
    /// Columns, in pixels.
    pub width: usize,
    /// Rows, in pixels.
    pub height: usize,
    /// Elements from one row's start to the next one's.
    pub stride: usize,
    /// Elements per pixel: 1 (gray), 3 (BGR) or 4 (RGBA).
    pub channels: usize,
}

#[inline]
fn check(len: usize, width: usize, height: usize, stride: usize, channels: usize) {
    let row = width * channels;
    assert!(stride >= row, "stride {stride} is shorter than a row of {row} elements");
    let need = if width == 0 || height == 0 { 0 } else { (height - 1) * stride + row };
    assert!(len >= need, "{width}x{height}x{channels} with stride {stride} needs {need} elements, got {len}");
}

impl<'a, T> View<'a, T> {
    /// A view without padding between rows.
    ///
    /// # Panics
    /// When `data` is too short.
    pub fn new(data: &'a [T], width: usize, height: usize, channels: usize) -> Self {
        Self::with_stride(data, width, height, channels, width * channels)
    }

    /// A view whose rows start `stride` elements apart.
    ///
    /// # Panics
    /// When `data` is too short or `stride` shorter than a row.
    pub fn with_stride(data: &'a [T], width: usize, height: usize, channels: usize, stride: usize) -> Self {
        check(data.len(), width, height, stride, channels);
        Self { data, width, height, stride, channels }
    }

    /// Row `y` without its padding.
    pub fn row(&self, y: usize) -> &'a [T] {
        let start = y * self.stride;
        &self.data[start..start + self.width * self.channels]
    }

    /// The rectangle `x, y, width, height` as a separate view.
    ///
    /// # Panics
    /// When the rectangle leaves the image.
    pub fn crop(&self, x: usize, y: usize, width: usize, height: usize) -> View<'a, T> {
        assert!(x + width <= self.width && y + height <= self.height, "crop leaves the image");
        let start = if width == 0 || height == 0 { 0 } else { y * self.stride + x * self.channels };
        View::with_stride(&self.data[start..], width, height, self.channels, self.stride)
    }
}

impl<'a, T> ViewMut<'a, T> {
    /// A view without padding between rows.
    ///
    /// # Panics
    /// When `data` is too short.
    pub fn new(data: &'a mut [T], width: usize, height: usize, channels: usize) -> Self {
        let stride = width * channels;
        check(data.len(), width, height, stride, channels);
        Self { data, width, height, stride, channels }
    }

    /// A view whose rows start `stride` elements apart.
    ///
    /// # Panics
    /// When `data` is too short or `stride` shorter than a row.
    pub fn with_stride(data: &'a mut [T], width: usize, height: usize, channels: usize, stride: usize) -> Self {
        check(data.len(), width, height, stride, channels);
        Self { data, width, height, stride, channels }
    }

    /// Row `y` without its padding.
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        let start = y * self.stride;
        &mut self.data[start..start + self.width * self.channels]
    }

    /// The same image, read-only.
    pub fn as_view(&self) -> View<'_, T> {
        View { data: self.data, width: self.width, height: self.height, stride: self.stride, channels: self.channels }
    }
}
