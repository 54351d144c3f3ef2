use crate::support::{check_op, refusal};
use smr_gpu::Precision;
use smr_gpu::engine::kernels::{Caps, Work};
use smr_gpu::engine::lower::KernelChoice;
use smr_gpu::engine::ops::{MaxPool2d, Op};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("max_pool2d");
}

#[test]
fn refuses_what_does_not_fit() {
    let with = |kernel, stride, padding| {
        let op = MaxPool2d { kernel, stride, padding };
        refusal(&op, &[TensorSpec::f32([1, 4, 9])])
    };
    let message = with(0, 1, 0);
    assert!(message.contains("`kernel`: expected 1 to 4096, got 0"), "{message}");
    let message = with(2, 0, 0);
    assert!(message.contains("`stride`: expected 1 to 4096, got 0"), "{message}");
    // Such a window could lie in the padding alone.
    let message = with(3, 2, 2);
    assert!(message.contains("`padding`: expected at most half the kernel (1)"), "{message}");
    let message = with(5, 1, 0);
    assert!(message.contains("`input`: expected at least the kernel (5)"), "{message}");
}

/// One channel takes four times as much in quads: 144 MB, which no default buffer holds.
#[test]
fn a_map_whose_quads_fit_no_buffer_is_pooled_planar() {
    let op = MaxPool2d { kernel: 3, stride: 2, padding: 1 };
    for (edge, kernel) in [(3000, "max_pool2d/planar"), (2800, "max_pool2d/quads")] {
        let inputs = [TensorSpec::f32([1, edge, edge])];
        let work = Work {
            node: 0,
            op: &op,
            inputs: &inputs,
            known: &[false],
            outputs: &op.infer(&inputs).expect("a map"),
            batch: 1,
            precision: Precision::F32,
            caps: &Caps::default(),
        };
        assert_eq!(KernelChoice::default().kernel(&work).expect("a kernel").id(), kernel, "{edge}");
    }
}
