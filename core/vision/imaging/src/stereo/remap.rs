//! Resampling a view through a map computed once, bilinear in fixed point.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::lit::LitPart;
use crate::stereo::StereoError;
use crate::stereo::camera::CameraModel;
use crate::stereo::error::{check_channels, check_size};
use crate::stereo::rectify::{Rectification, RectifiedCamera};
use crate::stereo::rotation::{Matrix3, apply, transposed};
use crate::{Parallel, Rect, SharedMut, Simd, View, ViewMut};

/// Fractions of a pixel are kept in 1/32 px.
const FRACTION_BITS: u32 = 5;
const ONE: i32 = 1 << FRACTION_BITS;
const OUTSIDE: u16 = u16::MAX;

/// For each pixel of a rectified view, where it comes from in the camera's image.
#[derive(Clone, Debug)]
pub struct RemapTable {
    source_size: (usize, usize),
    size: (usize, usize),
    roi: Rect,
    /// Upper left source pixel, `y << 16 | x`, row after row of the ROI.
    corner: Vec<u32>,
    /// Fractions in 1/32 px, `y << 8 | x`, or `OUTSIDE`.
    fraction: Vec<u16>,
    /// Pixels were left out because the camera's distortion turns back before them.
    is_folded: bool,
    avx2: bool,
}

impl RemapTable {
    /// Map of the left view of `rectification`, for the pixels of `roi`.
    ///
    /// # Errors
    /// As [`RemapTable::new`].
    pub fn left(
        camera: &CameraModel,
        rectification: &Rectification,
        roi: Rect,
        pool: &dyn Parallel,
    ) -> Result<Self, StereoError> {
        let size = (rectification.width, rectification.height);
        Self::new(camera, &rectification.rotation_left, rectification.left, size, roi, pool)
    }

    /// Map of the right view of `rectification`, for the pixels of `roi`.
    ///
    /// # Errors
    /// As [`RemapTable::new`].
    pub fn right(
        camera: &CameraModel,
        rectification: &Rectification,
        roi: Rect,
        pool: &dyn Parallel,
    ) -> Result<Self, StereoError> {
        let size = (rectification.width, rectification.height);
        Self::new(camera, &rectification.rotation_right, rectification.right, size, roi, pool)
    }

    /// Map from a turned pinhole camera of `size` back into `camera`, for the pixels of `roi`. What lies beyond the radius at which the camera's
    /// distortion turns back is outside: its pixels are those of other rays, mirrored.
    ///
    /// # Errors
    /// [`StereoError::Calibration`] when the camera is unusable or larger than 65,535 px.
    pub fn new(
        camera: &CameraModel,
        rotation: &Matrix3,
        target: RectifiedCamera,
        size: (usize, usize),
        roi: Rect,
        pool: &dyn Parallel,
    ) -> Result<Self, StereoError> {
        camera.validate()?;
        if camera.width > 65_535 || camera.height > 65_535 {
            return Err(StereoError::Calibration { reason: "images are limited to 65535 px a side".into() });
        }
        let roi = roi.clamped(size.0, size.1);
        let mut corner = vec![0; roi.width * roi.height];
        let mut fraction = vec![OUTSIDE; roi.width * roi.height];
        let back = transposed(rotation);
        let farthest = camera.lens.fold_radius().map_or(f64::INFINITY, |radius| radius * radius);
        let is_folded = AtomicBool::new(false);
        let (corners, fractions) = (SharedMut::new(&mut corner), SharedMut::new(&mut fraction));
        pool.run(roi.height, &|row| {
            // SAFETY: one row, one chunk.
            let (corner, fraction) =
                unsafe { (corners.part(row * roi.width, roi.width), fractions.part(row * roi.width, roi.width)) };
            for column in 0..roi.width {
                let x = ((roi.x + column) as f64 - target.cx) / target.focal_px;
                let y = ((roi.y + row) as f64 - target.cy) / target.focal_px;
                let [x, y, z] = apply(&back, [x, y, 1.0]);
                if z <= 0.0 {
                    continue;
                }
                let (u, v) = camera.project(x / z, y / z);
                if let (Some((sx, fx)), Some((sy, fy))) = (split(u, camera.width), split(v, camera.height)) {
                    if (x * x + y * y) / (z * z) > farthest {
                        is_folded.store(true, Ordering::Relaxed);
                        continue;
                    }
                    corner[column] = (sy << 16) | sx;
                    fraction[column] = (fy << 8) | fx;
                }
            }
        });
        let source_size = (camera.width, camera.height);
        let is_folded = is_folded.into_inner();
        Ok(Self { source_size, size, roi, corner, fraction, is_folded, avx2: Simd::detect().avx2() })
    }

    /// Takes the portable path even where AVX2 exists (tests compare the two).
    pub fn force_portable(&mut self) {
        self.avx2 = false;
    }

    /// Columns and rows of the camera's image.
    pub fn source_size(&self) -> (usize, usize) {
        self.source_size
    }

    /// Columns and rows of the rectified view.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// For each pixel of the rectangle, row after row: the row of its upper left source pixel times 65,536, and that pixel's column.
    pub fn corners(&self) -> &[u32] {
        &self.corner
    }

    /// For each pixel of the rectangle: fractions in 1/32 px, down times 256 and right; 65,535 where the camera does not see.
    pub fn fractions(&self) -> &[u16] {
        &self.fraction
    }

    /// Whether pixels are outside because the camera's distortion turns back before them.
    pub fn is_folded(&self) -> bool {
        self.is_folded
    }

    /// The pixels that the camera sees: in each row the longest run of them.
    pub fn valid(&self) -> LitPart {
        let (width, height) = self.size;
        let mut mask = vec![0; width * height];
        for (row, fractions) in self.fraction.chunks_exact(self.roi.width.max(1)).enumerate() {
            let start = (self.roi.y + row) * width + self.roi.x;
            for (out, fraction) in mask[start..].iter_mut().zip(fractions) {
                *out = u8::from(*fraction != OUTSIDE);
            }
        }
        let mut part = LitPart::default();
        part.read_mask(View::new(&mask, width, height, 1));
        part
    }

    /// The rectangle this map fills.
    pub fn roi(&self) -> Rect {
        self.roi
    }

    /// Resamples `source` (gray or BGR) into `target`; pixels that the camera does not cover, and
    /// those outside the ROI, become 0.
    ///
    /// # Errors
    /// When sizes or channel counts do not agree.
    pub fn remap(&self, source: View<'_, u8>, target: ViewMut<'_, u8>, pool: &dyn Parallel) -> Result<(), StereoError> {
        check_size("camera image", self.source_size, (source.width, source.height))?;
        check_size("rectified view", self.size, (target.width, target.height))?;
        check_channels("camera image", &[1, 3], "1 (gray) or 3 (BGR)", source.channels)?;
        check_channels("rectified view", &[source.channels], "as many as the camera image", target.channels)?;
        let (stride, channels) = (target.stride, target.channels);
        let (width, height) = self.size;
        let roi = self.roi;
        let out = SharedMut::new(target.data);
        const CHUNK_ROWS: usize = 16;
        pool.run(height.div_ceil(CHUNK_ROWS), &|chunk| {
            for y in chunk * CHUNK_ROWS..((chunk + 1) * CHUNK_ROWS).min(height) {
                // SAFETY: one row, one chunk.
                let row = unsafe { out.part(y * stride, width * channels) };
                if y < roi.y || y >= roi.y + roi.height || roi.width == 0 {
                    row.fill(0);
                    continue;
                }
                row[..roi.x * channels].fill(0);
                row[(roi.x + roi.width) * channels..].fill(0);
                let from = (y - roi.y) * roi.width;
                let corner = &self.corner[from..from + roi.width];
                let fraction = &self.fraction[from..from + roi.width];
                let out = &mut row[roi.x * channels..(roi.x + roi.width) * channels];
                self.row(source, corner, fraction, out);
            }
        });
        Ok(())
    }

    /// One BGR pixel of what [`RemapTable::remap`] makes of an image whose pixels `source` gives, by column and row.
    pub fn pixel(&self, x: usize, y: usize, source: impl Fn(usize, usize) -> [u8; 3]) -> [u8; 3] {
        let mut out = [0; 3];
        let (column, row) = (x.wrapping_sub(self.roi.x), y.wrapping_sub(self.roi.y));
        if column >= self.roi.width || row >= self.roi.height {
            return out;
        }
        let at = row * self.roi.width + column;
        if self.fraction[at] != OUTSIDE {
            let (x, y) = ((self.corner[at] & 0xffff) as usize, (self.corner[at] >> 16) as usize);
            let four = [source(x, y), source(x + 1, y), source(x, y + 1), source(x + 1, y + 1)];
            pixel(View::new(four.as_flattened(), 2, 2, 3), 0, self.fraction[at], &mut out);
        }
        out
    }

    fn row(&self, source: View<'_, u8>, corner: &[u32], fraction: &[u16], out: &mut [u8]) {
        let mut done = 0;
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: AVX2 was found; corners were made for this source size.
            done = unsafe {
                if source.channels == 1 {
                    avx2::gray_row(source, corner, fraction, out)
                } else {
                    avx2::bgr_row(source, corner, fraction, out)
                }
            };
        }
        let channels = source.channels;
        for i in done..corner.len() {
            pixel(source, corner[i], fraction[i], &mut out[i * channels..(i + 1) * channels]);
        }
    }
}

/// Whole pixel and fraction; the last pixel is reached as fraction 1 of the one before, so that the
/// four neighbours always exist.
fn split(position: f64, size: usize) -> Option<(u32, u16)> {
    let fixed = (position * f64::from(ONE)).round();
    let last = (size as f64 - 1.0) * f64::from(ONE);
    if !(fixed >= 0.0 && fixed <= last) {
        return None;
    }
    let fixed = fixed as u32;
    let whole = (fixed >> FRACTION_BITS).min(size as u32 - 2);
    Some((whole, (fixed - (whole << FRACTION_BITS)) as u16))
}

#[inline(always)]
fn pixel(source: View<'_, u8>, corner: u32, fraction: u16, out: &mut [u8]) {
    if fraction == OUTSIDE {
        out.fill(0);
        return;
    }
    let channels = source.channels;
    let start = (corner >> 16) as usize * source.stride + (corner & 0xffff) as usize * channels;
    let (fx, fy) = (i32::from(fraction & 0xff), i32::from(fraction >> 8));
    for (c, out) in out.iter_mut().enumerate() {
        let at = |index: usize| i32::from(source.data[index + c]);
        let upper = at(start) * (ONE - fx) + at(start + channels) * fx;
        let lower = at(start + source.stride) * (ONE - fx) + at(start + source.stride + channels) * fx;
        *out = ((upper * (ONE - fy) + lower * fy + ONE * ONE / 2) >> (2 * FRACTION_BITS)) as u8;
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{ONE, OUTSIDE, pixel};
    use crate::View;
    use std::arch::x86_64::*;

    /// Eight gray pixels at a time; returns how many were done.
    ///
    /// # Safety
    /// Needs AVX2; `corner` holds pixels that have a right and a lower neighbour in `source`.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn gray_row(source: View<'_, u8>, corner: &[u32], fraction: &[u16], out: &mut [u8]) -> usize {
        let stride = source.stride;
        if source.data.len() >= i32::MAX as usize || source.data.len() < stride + 4 {
            return 0;
        }
        let last_start = _mm256_set1_epi32((source.data.len() - stride - 4) as i32);
        let stride_all = _mm256_set1_epi32(stride as i32);
        let groups = corner.len() / 8;
        for group in 0..groups {
            let at = group * 8;
            // SAFETY: `at + 8 <= corner.len()`, and `fraction` is as long (the caller slices both alike).
            let (corners, fractions) = unsafe {
                (
                    _mm256_loadu_si256(corner.as_ptr().add(at).cast()),
                    _mm256_cvtepu16_epi32(_mm_loadu_si128(fraction.as_ptr().add(at).cast())),
                )
            };
            let y = _mm256_srli_epi32::<16>(corners);
            let x = _mm256_and_si256(corners, _mm256_set1_epi32(0xffff));
            let start = _mm256_add_epi32(_mm256_mullo_epi32(y, stride_all), x);
            if _mm256_movemask_epi8(_mm256_cmpgt_epi32(start, last_start)) != 0 {
                // A four-byte read would pass the end of the image.
                for i in at..at + 8 {
                    pixel(source, corner[i], fraction[i], &mut out[i..i + 1]);
                }
                continue;
            }
            // SAFETY: `start + stride + 4 <= data.len()` was just checked for all eight.
            let (upper, lower) = unsafe {
                (
                    _mm256_i32gather_epi32::<1>(source.data.as_ptr().cast(), start),
                    _mm256_i32gather_epi32::<1>(source.data.as_ptr().add(stride).cast(), start),
                )
            };
            let fx = _mm256_and_si256(fractions, _mm256_set1_epi32(0xff));
            let fy = _mm256_srli_epi32::<8>(fractions);
            let one = _mm256_set1_epi32(ONE);
            // Bytes (1 - fx, fx, 0, 0) of each pixel against (left, right, ..).
            let across = _mm256_or_si256(_mm256_sub_epi32(one, fx), _mm256_slli_epi32::<8>(fx));
            let upper = _mm256_maddubs_epi16(upper, across);
            let lower = _mm256_maddubs_epi16(lower, across);
            let pair =
                _mm256_or_si256(_mm256_and_si256(upper, _mm256_set1_epi32(0xffff)), _mm256_slli_epi32::<16>(lower));
            let down = _mm256_or_si256(_mm256_sub_epi32(one, fy), _mm256_slli_epi32::<16>(fy));
            let sum = _mm256_add_epi32(_mm256_madd_epi16(pair, down), _mm256_set1_epi32(ONE * ONE / 2));
            let value = _mm256_srli_epi32::<10>(sum);
            let outside = _mm256_cmpeq_epi32(fractions, _mm256_set1_epi32(i32::from(OUTSIDE)));
            let value = _mm256_andnot_si256(outside, value);
            let words = _mm256_packus_epi32(value, value);
            let bytes = _mm256_packus_epi16(words, words);
            let low = _mm256_castsi256_si128(bytes);
            let high = _mm256_extracti128_si256::<1>(bytes);
            let joined = _mm_unpacklo_epi32(low, high);
            // SAFETY: `out` has a byte for each corner.
            unsafe { _mm_storel_epi64(out.as_mut_ptr().add(at).cast(), joined) };
        }
        groups * 8
    }

    /// BGR pixels one at a time, their twelve products at once; returns how many were done.
    ///
    /// # Safety
    /// As [`gray_row`].
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn bgr_row(source: View<'_, u8>, corner: &[u32], fraction: &[u16], out: &mut [u8]) -> usize {
        let stride = source.stride;
        // Bytes b b' g g' r r' of the upper and of the lower pair.
        let order = _mm_setr_epi8(0, 3, 1, 4, 2, 5, -1, -1, 8, 11, 9, 12, 10, 13, -1, -1);
        let half = _mm_set1_epi32(ONE * ONE / 2);
        for i in 0..corner.len() {
            let target = &mut out[3 * i..3 * i + 3];
            let start = (corner[i] >> 16) as usize * stride + (corner[i] & 0xffff) as usize * 3;
            if fraction[i] == OUTSIDE || start + stride + 8 > source.data.len() {
                pixel(source, corner[i], fraction[i], target);
                continue;
            }
            let (fx, fy) = (i32::from(fraction[i] & 0xff), i32::from(fraction[i] >> 8));
            // SAFETY: eight bytes from `start` and from `start + stride` were checked to be inside.
            let pair = unsafe {
                let upper = _mm_loadl_epi64(source.data.as_ptr().add(start).cast());
                let lower = _mm_loadl_epi64(source.data.as_ptr().add(start + stride).cast());
                _mm_unpacklo_epi64(upper, lower)
            };
            let across = _mm_set1_epi16(((fx << 8) | (ONE - fx)) as i16);
            let sums = _mm_maddubs_epi16(_mm_shuffle_epi8(pair, order), across);
            let both = _mm_unpacklo_epi16(sums, _mm_unpackhi_epi64(sums, sums));
            let down = _mm_set1_epi32((fy << 16) | (ONE - fy));
            let value = _mm_srli_epi32::<10>(_mm_add_epi32(_mm_madd_epi16(both, down), half));
            let words = _mm_packus_epi32(value, value);
            let bytes = _mm_cvtsi128_si32(_mm_packus_epi16(words, words)) as u32;
            target.copy_from_slice(&bytes.to_le_bytes()[..3]);
        }
        corner.len()
    }
}
