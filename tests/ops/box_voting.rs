use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::BoxVoting;
use smr_gpu::engine::shape::{Shape, TensorSpec};

#[test]
fn shader_matches_reference_and_hand() {
    check_op("box_voting");
}

#[test]
fn refuses_what_does_not_fit() {
    let (f32s, u32s) = (|s: Shape| TensorSpec::f32(s), |s: Shape| TensorSpec::u32(s));
    let fits = || {
        let one = || u32s([1].into());
        let candidates = [f32s([9, 4].into()), f32s([9].into()), u32s([9].into())];
        [vec![f32s([3, 6].into())], candidates.into(), vec![u32s([5].into()), one(), one()]]
            .concat()
    };
    let op = BoxVoting::default();
    for (place, wrong, tensor, expected) in [
        (0, f32s([3].into()), "rows", "f32 of rank 2"),
        (0, f32s([3, 0].into()), "rows", "f32 [R, M] without a zero"),
        (1, f32s([10, 4].into()), "boxes", "f32 [N, 4] with N a multiple of 3"),
        (1, f32s([9, 5].into()), "boxes", "f32 [N, 4]"),
        (2, f32s([8].into()), "scores", "f32[9]"),
        (3, f32s([9].into()), "classes", "u32[9]"),
        (4, u32s([5, 1].into()), "keep", "u32 of rank 1"),
        (5, u32s([2].into()), "kept", "u32[1]"),
        (6, f32s([1].into()), "count", "u32[1]"),
    ] {
        let mut specs = fits();
        specs[place] = wrong;
        let message = refusal(&op, &specs);
        assert!(
            message.contains(&format!("`{tensor}`")) && message.contains(expected),
            "{message}"
        );
    }
    let message = refusal(&BoxVoting { iou_threshold: 1.0 }, &fits());
    assert!(message.contains("`iou_threshold`: expected 0 to 0.99, got 1"), "{message}");
}
