//! What holds tensors on the device, and how bytes come to lie there.

use crate::engine::gpu::device::Device;
use crate::engine::gpu::faults::{Call, Fault};
use crate::engine::gpu::quirks::uneven;
use crate::engine::kernels::Storage;
use crate::engine::lock::lock;
use crate::engine::precision::Precision;

/// Bytes of weights that may wait to be uploaded, and that are passed on at a time.
const UPLOAD_BYTES: usize = 8 << 20;

/// The format of a texture of four channels.
pub(super) fn texture_format(precision: Precision) -> wgpu::TextureFormat {
    match precision {
        Precision::F32 | Precision::Bf16 | Precision::Int8 => wgpu::TextureFormat::Rgba32Float,
        Precision::F16 => wgpu::TextureFormat::Rgba16Float,
    }
}

/// What holds a tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Resource {
    Buffer(wgpu::Buffer),
    Texture(wgpu::Texture, wgpu::TextureView),
}

/// Bytes of `width` texels of a texture of four channels.
fn row_bytes(texture: &wgpu::Texture, width: u32) -> u32 {
    let precision = match texture.format() {
        wgpu::TextureFormat::Rgba16Float => Precision::F16,
        _ => Precision::F32,
    };
    width * precision.texel_bytes()
}

impl Device {
    /// Makes a buffer.
    pub(super) fn create_buffer(&self, mut desc: wgpu::BufferDescriptor) -> wgpu::Buffer {
        if self.fault(Call::Buffer) == Some(Fault::Invalid) {
            desc.usage = wgpu::BufferUsages::empty();
        }
        self.handle.create_buffer(&desc)
    }

    /// Writes to a buffer before the next submission.
    pub(super) fn write(&self, buffer: &wgpu::Buffer, mut offset: u64, bytes: &[u8]) {
        if self.fault(Call::Write) == Some(Fault::Invalid) {
            offset = buffer.size();
        }
        let _turn = self.turn();
        self.queue.write_buffer(buffer, offset, bytes);
    }

    /// Creates what holds a tensor. Behind a buffer lie `guard` bytes more.
    pub(super) fn create(&self, storage: Storage, guard: u64) -> Resource {
        match storage {
            Storage::Buffer { bytes } => {
                Resource::Buffer(self.create_buffer(wgpu::BufferDescriptor {
                    label: None,
                    size: bytes.next_multiple_of(4) + guard,
                    usage: wgpu::BufferUsages::STORAGE
                        | wgpu::BufferUsages::INDIRECT
                        | wgpu::BufferUsages::COPY_SRC
                        | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                }))
            }
            Storage::Texture { width, height, precision } => {
                let (mut width, height) = (uneven(width), uneven(height));
                if self.fault(Call::Texture) == Some(Fault::Invalid) {
                    width = 0;
                }
                let texture = self.create_texture(width, height, precision);
                let view = texture.create_view(&Default::default());
                Resource::Texture(texture, view)
            }
        }
    }

    pub(super) fn create_texture(
        &self,
        width: u32,
        height: u32,
        precision: Precision,
    ) -> wgpu::Texture {
        self.handle.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: texture_format(precision),
            usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        })
    }

    /// Fills a texture.
    pub(super) fn write_texture(&self, texture: &wgpu::Texture, bytes: &[u8]) {
        self.write_rows(texture, texture.width(), 0, bytes);
    }

    /// Writes rows of `width` texels to a texture, from row `first` on.
    fn write_rows(&self, texture: &wgpu::Texture, width: u32, first: u32, bytes: &[u8]) {
        let row = row_bytes(texture, width);
        let height = (bytes.len() / row.max(1) as usize) as u32;
        let refused = self.fault(Call::Write) == Some(Fault::Invalid);
        let bytes = if refused { &[] } else { bytes };
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(row),
            rows_per_image: Some(height),
        };
        let to = wgpu::TexelCopyTextureInfo {
            origin: wgpu::Origin3d { x: 0, y: first, z: 0 },
            ..texture.as_image_copy()
        };
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        let _turn = self.turn();
        self.queue.write_texture(to, bytes, layout, size);
    }

    /// Writes a constant to the front of a buffer, a part at a time: what waits to be uploaded takes as
    /// much memory again.
    pub(super) fn upload(&self, buffer: &wgpu::Buffer, bytes: &[u8]) {
        for (index, part) in bytes.chunks(UPLOAD_BYTES).enumerate() {
            self.write(buffer, (index * UPLOAD_BYTES) as u64, part);
            self.pass_uploads_on(part.len());
        }
    }

    /// The same for rows of `width` texels of a texture, some rows at a time.
    pub(super) fn upload_texture(&self, texture: &wgpu::Texture, width: u32, bytes: &[u8]) {
        let row = (row_bytes(texture, width) as usize).max(1);
        let rows = (UPLOAD_BYTES / row).max(1);
        for (index, part) in bytes.chunks(rows * row).enumerate() {
            self.write_rows(texture, width, (index * rows) as u32, part);
            self.pass_uploads_on(part.len());
        }
    }

    /// Counts `bytes` that wait to be uploaded, and passes them on before they are many.
    fn pass_uploads_on(&self, bytes: usize) {
        let mut waiting = lock(&self.uploads);
        *waiting += bytes;
        if *waiting >= UPLOAD_BYTES {
            *waiting = 0;
            // A device that is lost or late says so when the program first runs.
            self.submit(None);
            self.wait();
        }
    }
}
