use crate::support::{self, check_op};
use smr_gpu::engine::gpu::{ProgramOptions, Slot};
use smr_gpu::engine::graph::Graph;
use smr_gpu::engine::ops::{IndirectGrid, Linear, Op, Softmax};
use smr_gpu::engine::shape::{Extent, TensorSpec};
use smr_gpu::engine::tensor::{Tensor, Value};

#[test]
fn shader_matches_reference_and_hand() {
    check_op("indirect_grid");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = IndirectGrid { capacity: 9, items_per_count: 1, workgroup_size: 64, layers: 1 };
    let message = op.infer(&[TensorSpec::f32([1])]).expect_err("f32").to_string();
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
    let zero = IndirectGrid { workgroup_size: 0, ..op };
    let message = zero.infer(&[TensorSpec::u32([1])]).expect_err("zero").to_string();
    assert!(message.contains("`workgroup_size`: expected 1 to 256, got 0"), "{message}");

    let op = IndirectGrid { capacity: 65_536, items_per_count: 65_536, ..op };
    let message = op.infer(&[TensorSpec::u32([1])]).expect_err("past a u32").to_string();
    assert!(message.contains("needs 4294967296, but only 4294967295"), "{message}");
}

/// A layer and two softmaxes over the rows that a count says: one table has their grids.
#[test]
fn dispatches_of_one_count_cover_its_rows() {
    let (rows, columns, outputs) = (70, 9, 130);
    let mut graph = Graph::default();
    let count = graph.input("count", TensorSpec::u32([1]), Extent::Exact);
    let input = graph.input("input", TensorSpec::f32([rows, columns]), Extent::Exact);
    let weight = Tensor::from_fn([outputs, columns], |i| (i % 7) as f32 / 8.0 - 0.375);
    let weight = graph.constant("weight", weight);
    let bias = graph.constant("bias", Tensor::<f32>::zeros([outputs]));
    let layer = Linear { relu: false, count: true };
    let layer = graph.apply1("layer", layer, &[input, weight, bias, count]).expect("rows");
    let softmax = Softmax { temperature: 1.0, count: true };
    let probabilities = [("of the layer", layer), ("of the input", input)].map(|(name, of)| {
        let id = graph.apply1(name, softmax, &[of, count]).expect("rows");
        graph.mark_output(id);
        id
    });
    // Rows that nobody computes hold NaN.
    let options = ProgramOptions { guard: true, ..ProgramOptions::default() };
    let slot = Slot::of(support::gpu(), &graph, &[], options);
    let mut slot = pollster::block_on(slot).expect("a slot");
    let values = Value::from(Tensor::from_fn([rows, columns], |i| (i % 11) as f32 / 4.0 - 1.0));
    for n in [0, 1, 15, 16, 17, 64, 70] {
        let counted = Value::from(Tensor::from_fn([1], |_| n as u32));
        let inputs = [(count, &counted), (input, &values)];
        let found = slot.run(&inputs).expect("a run").first();
        let (expected, _) = graph.reference(&inputs, &[]).expect("a reference");
        for (id, width) in probabilities.into_iter().zip([outputs, columns]) {
            let [found, expected] = [&found, &expected].map(|v| v[&id].f32().expect("f32").data());
            let mut pairs = found.iter().zip(expected).take(n * width);
            let near = pairs.all(|(a, b)| (a - b).abs() < 1e-6);
            assert!(near, "{}: {n} rows", graph.name(id));
        }
    }
}
