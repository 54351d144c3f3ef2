//! Convolutions of the network's shapes, on the adapter beside the CPU's f64 reference. The ratio of
//! the two is the figure that carries from machine to machine.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use smr_gpu::engine::gpu::{Gpu, GpuOptions, ProgramOptions, Slot};
use smr_gpu::engine::graph::Graph;
use smr_gpu::engine::ops::case::random;
use smr_gpu::engine::ops::{Conv2d, Op};
use smr_gpu::engine::tensor::Value;

/// Name, channels in, channels out, kernel side, dilation, side of the map.
const SHAPES: [(&str, usize, usize, usize, usize, usize); 3] = [
    ("3x3 in conv2_x", 64, 64, 3, 1, 80),
    ("3x3 dilated in MSFF-Net", 256, 256, 3, 2, 20),
    ("1x1 in RW-Net", 256, 64, 1, 1, 40),
];

fn conv2d(criterion: &mut Criterion) {
    let gpu = pollster::block_on(Gpu::open(GpuOptions::default())).expect("an adapter");
    let mut group = criterion.benchmark_group("conv2d");
    group.sample_size(10);
    for (name, channels_in, channels_out, kernel, dilation, side) in SHAPES {
        let op = Conv2d { padding: dilation * (kernel / 2), dilation, ..Conv2d::default() };
        let inputs = [
            Value::from(random(1, [channels_in, side, side])),
            Value::from(random(2, [channels_out, channels_in, kernel, kernel])),
            Value::from(random(3, [channels_out])),
        ];
        let multiplications = channels_in * channels_out * kernel * kernel * side * side;
        group.throughput(Throughput::Elements(multiplications as u64));
        let mut slot = slot(&gpu, op, &inputs);
        group.bench_function(BenchmarkId::new("shader", name), |b| {
            b.iter(|| slot.run(&[]).expect("a run"));
        });
        let inputs: Vec<&Value> = inputs.iter().collect();
        group.bench_function(BenchmarkId::new("reference", name), |b| {
            b.iter(|| op.reference(&inputs).expect("a result"));
        });
    }
}

/// A slot for `op` alone, with its inputs on the device.
fn slot(gpu: &std::sync::Arc<Gpu>, op: Conv2d, inputs: &[Value]) -> Slot {
    let mut graph = Graph::default();
    let named = inputs.iter().zip(op.inputs());
    let ids: Vec<_> = named.map(|(v, n)| graph.constant(n, v.clone())).collect();
    let output = graph.apply1("conv2d", op, &ids).expect("shapes that fit");
    graph.mark_output(output);
    pollster::block_on(Slot::of(gpu, &graph, &[], ProgramOptions::default())).expect("a slot")
}

criterion_group!(benches, conv2d);
criterion_main!(benches);
