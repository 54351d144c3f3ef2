//! A run's commands, in passes, and their bindings.

use std::ops::Range;

use super::Slot;
use crate::engine::gpu::faults::{Call, Fault};
use crate::engine::gpu::memory::Resource;
use crate::engine::gpu::program::{Profile, Step, StepGrid};
use crate::engine::kernels::Storage;

impl Slot {
    /// Makes the bind groups that are missing.
    pub(super) fn bind(&mut self) {
        let program = self.program.clone();
        for (index, step) in program.steps.iter().enumerate() {
            let Step::Dispatch { pipeline, bound, uniform, picture, .. } = step else { continue };
            if self.groups[index].is_some() {
                continue;
            }
            let resources: Vec<Option<Resource>> =
                bound.iter().map(|b| self.resource(b.place, picture.unwrap_or(0))).collect();
            let mut entries = Vec::with_capacity(bound.len() + 1);
            for (bound, resource) in bound.iter().zip(&resources) {
                let resource = match resource {
                    Some(Resource::Buffer(buffer)) => {
                        let (offset, size) = match bound.part {
                            Some((offset, bytes)) => (offset, std::num::NonZeroU64::new(bytes)),
                            None => (0, None),
                        };
                        let buffer = wgpu::BufferBinding { buffer, offset, size };
                        wgpu::BindingResource::Buffer(buffer)
                    }
                    Some(Resource::Texture(_, view)) => wgpu::BindingResource::TextureView(view),
                    None => continue,
                };
                entries.push(wgpu::BindGroupEntry { binding: bound.binding, resource });
            }
            if let Some((binding, offset, bytes)) = uniform {
                entries.push(wgpu::BindGroupEntry {
                    binding: *binding,
                    resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                        buffer: &program.uniforms,
                        offset: *offset,
                        size: std::num::NonZeroU64::new(*bytes),
                    }),
                });
            }
            if program.gpu.device.fault(Call::BindGroup) == Some(Fault::Invalid) {
                entries.clear();
            }
            let group = program.gpu.device.handle.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(&pipeline.label),
                layout: &pipeline.layout,
                entries: &entries,
            });
            self.groups[index] = Some(group);
        }
    }

    /// The commands of a run, and the copies of what it gives back into `staging`.
    pub(super) fn encode(&self, staging: &wgpu::Buffer) -> wgpu::CommandBuffer {
        let program = &self.program;
        let mut encoder = program.gpu.device.handle.create_command_encoder(&Default::default());
        let all = program.steps.len();
        match program.options.profile {
            Profile::Stages if self.timestamps.is_some() => {
                for (index, (_, steps)) in program.stages.iter().enumerate() {
                    self.encode_timed(&mut encoder, index as u32, steps.clone());
                }
            }
            Profile::Commands if self.timestamps.is_some() => {
                for at in 0..all {
                    self.encode_timed(&mut encoder, at as u32, at..at + 1);
                }
            }
            _ => self.encode_timed(&mut encoder, 0, 0..all),
        }
        self.read_back(&mut encoder, staging);
        encoder.finish()
    }

    /// Steps that are timed together, in passes that end at copies.
    fn encode_timed(&self, encoder: &mut wgpu::CommandEncoder, index: u32, steps: Range<usize>) {
        let program = &self.program;
        let is_copy = |at: &usize| matches!(program.steps[*at], Step::Copy { .. });
        let copies: Vec<usize> = steps.clone().filter(is_copy).collect();
        let starts = [steps.start].into_iter().chain(copies.iter().map(|copy| copy + 1));
        let ends = copies.iter().copied().chain([steps.end]);
        // Not every adapter has timestamps between passes: at a copy they are those of an empty one.
        let last = copies.len();
        for (part, (start, end)) in starts.zip(ends).enumerate() {
            let begin = (part == 0).then_some(index * 2);
            let finish = (part == last).then_some(index * 2 + 1);
            if start < end || self.timestamps.is_some() && (begin.is_some() || finish.is_some()) {
                let mut pass = self.begin_pass(encoder, begin, finish);
                (start..end).for_each(|at| self.dispatch(&mut pass, at));
            }
            if part < last {
                self.copy(encoder, end);
            }
        }
    }

    /// Begins a pass that writes these timestamps.
    fn begin_pass<'a>(
        &self,
        encoder: &'a mut wgpu::CommandEncoder,
        first: Option<u32>,
        last: Option<u32>,
    ) -> wgpu::ComputePass<'a> {
        let timed = self.timestamps.as_ref().filter(|_| first.is_some() || last.is_some());
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: None,
            timestamp_writes: timed.map(|t| wgpu::ComputePassTimestampWrites {
                query_set: &t.set,
                beginning_of_pass_write_index: first,
                end_of_pass_write_index: last,
            }),
        })
    }

    fn dispatch(&self, pass: &mut wgpu::ComputePass, at: usize) {
        let Step::Dispatch { pipeline, grid, .. } = &self.program.steps[at] else { return };
        pass.set_pipeline(&pipeline.pipeline);
        pass.set_bind_group(0, self.groups[at].as_ref(), &[]);
        match grid {
            StepGrid::Direct([x, y, z]) => pass.dispatch_workgroups(*x, *y, *z),
            StepGrid::Indirect(place, offset) => {
                if let Some(Resource::Buffer(buffer)) = self.resource(*place, 0) {
                    pass.dispatch_workgroups_indirect(&buffer, *offset);
                }
            }
        }
    }

    fn copy(&self, encoder: &mut wgpu::CommandEncoder, at: usize) {
        let Step::Copy { from, to, width, height, row_bytes } = self.program.steps[at] else {
            return;
        };
        let (from, to) = (self.resource(from, 0), self.resource(to, 0));
        let (Some(Resource::Buffer(from)), Some(Resource::Texture(to, _))) = (from, to) else {
            return;
        };
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(row_bytes),
            rows_per_image: Some(height),
        };
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        let from = wgpu::TexelCopyBufferInfo { buffer: &from, layout };
        encoder.copy_buffer_to_texture(from, to.as_image_copy(), size);
    }

    fn read_back(&self, encoder: &mut wgpu::CommandEncoder, staging: &wgpu::Buffer) {
        let program = &self.program;
        let guard = program.guard();
        for output in &program.outputs {
            let Storage::Buffer { bytes } = program.tensors[output.tensor.0].storage else {
                continue;
            };
            let Some(Resource::Buffer(buffer)) = self.resource(output.place, 0) else { continue };
            encoder.copy_buffer_to_buffer(&buffer, 0, staging, output.offset, bytes + guard);
        }
        if let Some(t) = &self.timestamps {
            encoder.resolve_query_set(&t.set, 0..(t.resolve.size() / 8) as u32, &t.resolve, 0);
            encoder.copy_buffer_to_buffer(&t.resolve, 0, staging, t.offset, t.resolve.size());
        }
    }
}
