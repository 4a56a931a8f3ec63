//! Results that come back from the GPU to memory.

use bytemuck::Pod;

use super::Gpu;
use crate::error::RenderError;

/// A buffer of the GPU with its twin that memory can read; made once, used every frame.
#[derive(Debug)]
pub struct Readback {
    buffer: wgpu::Buffer,
    mapped: wgpu::Buffer,
    bytes: u64,
}

impl Readback {
    /// Room for `bytes` bytes.
    #[must_use]
    pub fn new(gpu: &Gpu, label: &str, bytes: u64) -> Self {
        Self::with_usage(gpu, label, bytes, wgpu::BufferUsages::STORAGE)
    }

    /// Room for `bytes` bytes of resolved queries.
    #[must_use]
    pub fn for_queries(gpu: &Gpu, label: &str, bytes: u64) -> Self {
        Self::with_usage(gpu, label, bytes, wgpu::BufferUsages::QUERY_RESOLVE)
    }

    fn with_usage(gpu: &Gpu, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> Self {
        let buffer = |usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: bytes,
                usage,
                mapped_at_creation: false,
            })
        };
        Self {
            buffer: buffer(usage | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST),
            mapped: buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST),
            bytes,
        }
    }

    /// The buffer that passes write.
    #[must_use]
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Records the copy to memory, after the pass that writes.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.copy_buffer_to_buffer(&self.buffer, 0, &self.mapped, 0, self.bytes);
    }

    /// Waits for the submitted work and copies the result into `out`, which must hold exactly the buffer's bytes.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read<T: Pod>(&self, gpu: &Gpu, out: &mut [T]) -> Result<(), RenderError> {
        const DURING: &str = "reading a result back";
        let failed = |message: String| RenderError::Gpu {
            during: DURING,
            message,
        };
        let (sender, receiver) = std::sync::mpsc::channel();
        self.mapped.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver waits below; when it is gone, nobody wants the result.
            let _ = sender.send(result);
        });
        gpu.wait(DURING)?;
        receiver
            .recv()
            .map_err(|e| failed(e.to_string()))?
            .map_err(|e| failed(e.to_string()))?;
        let view = self.mapped.get_mapped_range(..).map_err(|e| failed(e.to_string()))?;
        let bytes: &[u8] = &view;
        let out = bytemuck::cast_slice_mut(out);
        if out.len() != bytes.len() {
            return Err(failed(format!("{} bytes wanted, {} there", out.len(), bytes.len())));
        }
        out.copy_from_slice(bytes);
        drop(view);
        self.mapped.unmap();
        Ok(())
    }
}
