//! Results that come back from the GPU to memory.

use bytemuck::Pod;
use glam::Vec4;

use super::Gpu;
use crate::error::RenderError;

const DURING: &str = "reading a result back";

fn failed(message: String) -> RenderError {
    RenderError::Gpu {
        during: DURING,
        message,
    }
}

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
            gpu.count_made();
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
        let out = bytemuck::cast_slice_mut(out);
        if out.len() as u64 != self.bytes {
            return Err(failed(format!("{} bytes wanted, {} there", out.len(), self.bytes)));
        }
        self.read_with(gpu, |bytes| out.copy_from_slice(bytes))
    }

    /// Waits for the submitted work and shows the result's bytes to `take`.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read_with(&self, gpu: &Gpu, take: impl FnOnce(&[u8])) -> Result<(), RenderError> {
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
        take(&view);
        drop(view);
        self.mapped.unmap();
        Ok(())
    }
}

impl Gpu {
    /// Reads back the first layer and mip of a texture of four half floats per texel, rows from the top. For tests and
    /// files: it makes its buffers anew.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read_half(&self, texture: &wgpu::Texture) -> Result<Vec<Vec4>, RenderError> {
        let texels: Vec<[half::f16; 4]> = self.read_texels(texture)?;
        Ok(texels
            .iter()
            .map(|t| Vec4::from_array(t.map(half::f16::to_f32)))
            .collect())
    }

    /// The same for four single floats per texel.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read_float(&self, texture: &wgpu::Texture) -> Result<Vec<Vec4>, RenderError> {
        self.read_texels(texture)
    }

    fn read_texels<T: Pod>(&self, texture: &wgpu::Texture) -> Result<Vec<T>, RenderError> {
        const ALIGNMENT: usize = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize;
        let (width, height) = (texture.width() as usize, texture.height() as usize);
        let row_bytes = width * size_of::<T>();
        let padded = row_bytes.next_multiple_of(ALIGNMENT);
        let readback = Readback::new(self, "texels", (padded * height) as u64);
        let mut encoder = self
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("texels") });
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: readback.buffer(),
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(padded as u32),
                    rows_per_image: None,
                },
            },
            wgpu::Extent3d {
                width: width as u32,
                height: height as u32,
                depth_or_array_layers: 1,
            },
        );
        readback.record(&mut encoder);
        self.queue.submit([encoder.finish()]);
        let mut bytes = vec![0u8; padded * height];
        readback.read(self, &mut bytes)?;
        let rows = bytes.chunks_exact(padded).map(|row| &row[..row_bytes]);
        Ok(rows
            .flat_map(|row| row.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned))
            .collect())
    }
}
