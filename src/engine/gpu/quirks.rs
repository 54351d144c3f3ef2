//! What is one driver's affair: each quirk with the driver and version that it was seen in.

use std::sync::OnceLock;

use crate::engine::shader::Variant;

/// A variant as the adapter's compiler is to read it. Mesa's software adapter (lavapipe 22.3 and 25.0) unrolls loops
/// of a length that it knows, and compiles such shaders for seconds; 22.3 also writes a uniform that is a bound and
/// nothing else into the code, and compiles anew at each dispatch. So bounds are hidden there. Other compilers see
/// them: an array that an unrolled loop indexes stays in registers.
pub(super) fn variant(info: &wgpu::AdapterInfo, variant: &Variant) -> Variant {
    variant.clone().with("HIDDEN_BOUNDS", is_software(info))
}

/// Whether machine code is made at a pipeline's first dispatch, one pipeline after the other: lavapipe 22.3 and 25.0.
pub(super) fn compiles_late(info: &wgpu::AdapterInfo) -> bool {
    is_software(info)
}

fn is_software(info: &wgpu::AdapterInfo) -> bool {
    info.device_type == wgpu::DeviceType::Cpu
}

/// A side of a texture that is no power of two and holds `texels`: lavapipe 22.3 compiles a shader for textures whose
/// sides are, and once more for others.
pub(super) fn uneven(texels: u32) -> u32 {
    match texels {
        0 => 0,
        1 | 2 => 3,
        more => more + u32::from(more.is_power_of_two()),
    }
}

/// The process's one instance. It is never dropped: with the last one the Vulkan loader unloads the driver, and what
/// lavapipe 22.3 leaves to be called at the process's end is then no longer there, which ended one in twenty
/// programs that stopped soon after their device.
pub(super) fn instance() -> &'static wgpu::Instance {
    static INSTANCE: OnceLock<wgpu::Instance> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        let mut desc = wgpu::InstanceDescriptor::new_without_display_handle();
        desc.backends = wgpu::Backends::PRIMARY;
        // wgpu need not look at every indirect grid once more on the device: `indirect_grid` keeps to
        // the limits whatever the count, and nothing that is dispatched so reads how many workgroups
        // there are. `Program` refuses what does, and a test of `crate::engine::lower` looks at every kernel.
        desc.flags.remove(wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL);
        wgpu::Instance::new(desc)
    })
}
