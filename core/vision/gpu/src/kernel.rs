//! A compute shader and its call.

use wgpu::{
    BindGroupDescriptor, BindGroupEntry, Buffer, CommandEncoder, ComputePassDescriptor, ComputePipeline,
    ComputePipelineDescriptor, PipelineCompilationOptions, ShaderModuleDescriptor, ShaderSource,
};

use crate::device::{Gpu, GpuError};

/// Columns and rows of threads in a workgroup of all shaders.
pub const GROUP: [u32; 2] = [32, 4];

/// A shader with one entry point, `main`. Its bindings are buffers, numbered from 0 on.
#[derive(Debug)]
pub struct Kernel {
    pipeline: ComputePipeline,
}

impl Kernel {
    /// Compiles a shader from its parts.
    pub fn new(gpu: &Gpu, label: &str, parts: &[&str]) -> Result<Self, GpuError> {
        let source = ShaderSource::Wgsl(parts.concat().into());
        let module = gpu.device.create_shader_module(ShaderModuleDescriptor { label: Some(label), source });
        let pipeline = gpu.device.create_compute_pipeline(&ComputePipelineDescriptor {
            label: Some(label),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            // Shaders write memory of their workgroup before they read it; clearing 16 KiB can take as long as the work.
            compilation_options: PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..PipelineCompilationOptions::default()
            },
            cache: None,
        });
        gpu.check()?;
        Ok(Self { pipeline })
    }

    /// Encodes a call with at least `threads` threads, columns and rows.
    pub fn encode(&self, gpu: &Gpu, encoder: &mut CommandEncoder, buffers: &[&Buffer], threads: [usize; 2]) {
        let entries: Vec<BindGroupEntry<'_>> = buffers
            .iter()
            .enumerate()
            .map(|(binding, buffer)| BindGroupEntry { binding: binding as u32, resource: buffer.as_entire_binding() })
            .collect();
        let layout = self.pipeline.get_bind_group_layout(0);
        let group =
            gpu.device.create_bind_group(&BindGroupDescriptor { label: None, layout: &layout, entries: &entries });
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        let groups = [0, 1].map(|k| (threads[k] as u32).div_ceil(GROUP[k]));
        pass.dispatch_workgroups(groups[0], groups[1], 1);
    }
}
