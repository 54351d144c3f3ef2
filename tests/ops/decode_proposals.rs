use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::{self, DecodeProposals, Op, Params};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("decode_proposals");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = |anchors| DecodeProposals { anchors, stride: 8, width: 64, height: 64 };
    let specs = |channels: usize, k: usize| {
        let deltas = TensorSpec::f32([channels, 3, 5]);
        [deltas, TensorSpec::f32([7]), TensorSpec::u32([k]), TensorSpec::u32([1])]
    };
    let one = op(vec![[-4.0, -4.0, 4.0, 4.0]]);
    let message = one.infer(&specs(8, 7)).expect_err("channels").to_string();
    assert!(message.contains("`deltas`") && message.contains("[4, H, W]"), "{message}");
    let message = one.infer(&specs(4, 6)).expect_err("indices").to_string();
    assert!(message.contains("`indices`") && message.contains("u32[7]"), "{message}");
    let none = [TensorSpec::f32([4, 3, 5]), TensorSpec::f32([0]), TensorSpec::u32([0])];
    let none = [none.as_slice(), &[TensorSpec::u32([1])]].concat();
    let message = refusal(&one, &none);
    assert!(message.contains("`scores`: expected f32 [K] without a zero"), "{message}");
    let message = op(vec![]).infer(&specs(0, 7)).expect_err("no anchors").to_string();
    assert!(message.contains("`anchors`") && message.contains("at least one"), "{message}");
}

#[test]
fn anchors_are_a_flat_list_of_four_each() {
    let entry = ops::find("decode_proposals").expect("a registered operation");
    let build = |anchors: &str| {
        let pairs = [("anchors", anchors), ("stride", "8"), ("width", "9"), ("height", "9")];
        let pairs = pairs.map(|(k, v)| (k.to_owned(), v.to_owned()));
        (entry.build)(&mut Params::new("decode_proposals", pairs), &[])
    };
    let op = format!("{:?}", build("-1,-2,1,2, -3,-3,3,3").expect("two anchors"));
    assert!(op.contains("[[-1.0, -2.0, 1.0, 2.0], [-3.0, -3.0, 3.0, 3.0]]"), "{op}");
    let message = build("-1,-2,1").expect_err("three numbers").to_string();
    assert!(message.contains("x1,y1,x2,y2") && message.contains("3 numbers"), "{message}");
}
