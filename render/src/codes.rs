//! The finished picture of one eye: 8-bit codes on the GPU, on their way to memory.

use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::readback::Readback;

/// A picture of codes, one pixel per 32-bit element, red in the lowest byte.
#[derive(Debug)]
pub struct Codes {
    out: Readback,
    size_px: [u32; 2],
}

impl Codes {
    /// Room for a picture of `size_px`.
    #[must_use]
    pub fn new(gpu: &Gpu, label: &str, size_px: [u32; 2]) -> Self {
        let bytes = 4 * u64::from(size_px[0]) * u64::from(size_px[1]);
        Self {
            out: Readback::new(gpu, label, bytes),
            size_px,
        }
    }

    /// The buffer that passes write.
    #[must_use]
    pub fn buffer(&self) -> &wgpu::Buffer {
        self.out.buffer()
    }

    /// Columns and rows.
    #[must_use]
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// Records the copy to memory, after the last pass that writes.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder) {
        self.out.record(encoder);
    }

    /// The picture as 8-bit RGBA, once submitted.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<u8>, RenderError> {
        let mut rgba = vec![0; 4 * (self.size_px[0] * self.size_px[1]) as usize];
        self.out.read(gpu, &mut rgba)?;
        Ok(rgba)
    }

    /// Copies the picture, once submitted, into `rgba`, a picture of `n` such pictures side by side, as number `index`.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read_beside(&self, gpu: &Gpu, rgba: &mut [u8], (index, n): (usize, usize)) -> Result<(), RenderError> {
        let row_bytes = 4 * self.size_px[0] as usize;
        self.out.read_with(gpu, |bytes| {
            for (to, from) in rgba.chunks_exact_mut(n * row_bytes).zip(bytes.chunks_exact(row_bytes)) {
                to[index * row_bytes..(index + 1) * row_bytes].copy_from_slice(from);
            }
        })
    }
}
