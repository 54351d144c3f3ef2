use crate::support::{check_op, gpu, refusal};
use smr_gpu::engine::ops::{CropResize, Op, Params, find};
use smr_gpu::engine::pixel_order::PixelOrder;
use smr_gpu::engine::reference::Crop;
use smr_gpu::engine::shape::TensorSpec;
use smr_gpu::engine::tensor::Tensor;
use smr_gpu::verify::check::run_op;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("crop_resize");
}

const OP: CropResize = CropResize { width: 32, height: 32, mean: [0.5; 3], std: [0.2; 3] };

#[test]
fn refuses_what_does_not_fit() {
    let specs = [TensorSpec::u32([100]), TensorSpec::u32([11])];
    let message = refusal(&CropResize { height: 0, ..OP }, &specs);
    assert!(message.contains("`height`: expected 1 to 16384, got 0"), "{message}");
    let message = refusal(&CropResize { mean: [0.5, f32::NAN, 0.5], ..OP }, &specs);
    assert!(message.contains("`mean`: expected numbers from 0 to 1, got 0.5,NaN,0.5"), "{message}");
    let message = refusal(&CropResize { std: [0.2, 0.0, 0.2], ..OP }, &specs);
    assert!(
        message.contains("`std`: expected numbers from 0.001 to 1000, got 0.2,0,0.2"),
        "{message}"
    );
    let message = refusal(&OP, &[TensorSpec::f32([100]), TensorSpec::u32([11])]);
    assert!(message.contains("`picture`: expected u32 of rank 1"), "{message}");
    let message = refusal(&OP, &[TensorSpec::u32([100]), TensorSpec::u32([4])]);
    assert!(message.contains("`crop`: expected u32[11], got u32[4]"), "{message}");
}

#[test]
fn refuses_crops_outside_the_picture() {
    let good = Crop {
        width: 10,
        height: 8,
        x: 3,
        y: 1,
        columns: 7,
        rows: 6,
        resized: [5, 4],
        window: [1, 2],
        order: PixelOrder::Rgba8,
    };
    let words = [10, 8, 3, 1, 7, 6, 5, 4, 1, 2, 2];
    assert_eq!(good.to_tensor(80).expect("a crop").data(), words);
    let bad = [
        Crop { columns: 0, ..good },
        Crop { rows: 0, ..good },
        Crop { columns: 8, ..good },
        Crop { x: 4, ..good },
        Crop { y: 3, ..good },
        Crop { x: usize::MAX, ..good },
    ];
    for crop in bad {
        let message = crop.to_tensor(80).expect_err("an error").to_string();
        assert!(message.contains("`crop`") && message.contains("inside 10×8"), "{message}");
    }
    let bad = [
        Crop { resized: [0, 4], ..good },
        Crop { resized: [5, 16_385], ..good },
        Crop { window: [5, 2], ..good },
        Crop { window: [1, usize::MAX], ..good },
    ];
    for crop in bad {
        let message = crop.to_tensor(80).expect_err("an error").to_string();
        assert!(message.contains("begins in 1 to 16384 resized pixels"), "{message}");
    }
    let message = good.to_tensor(79).expect_err("an error").to_string();
    assert!(message.contains("10×8 picture: needs 80, but only 79"), "{message}");
    // Three bytes a pixel are less, one that is begun counts as a word.
    let rgb = Crop { order: PixelOrder::Rgb8, width: 9, columns: 6, ..good };
    assert!(rgb.to_tensor(54).is_ok());
    let message = rgb.to_tensor(53).expect_err("an error").to_string();
    assert!(message.contains("9×8 picture: needs 54, but only 53"), "{message}");
    // The crop's words are held to the same, by the reference as on the device.
    let picture = Tensor::<u32>::zeros([80]).into();
    let crop = Tensor::from_fn([11], |i| [10, 8, 4, 1, 7, 6, 5, 4, 1, 2, 2][i]).into();
    let by_reference = OP.reference(&[&picture, &crop]).expect_err("an error").to_string();
    assert!(by_reference.contains("7×6 at (4, 1)"), "{by_reference}");
    let on_device: std::sync::Arc<dyn Op> = std::sync::Arc::new(OP);
    let on_device =
        run_op(gpu(), &on_device, &[picture.clone(), crop]).expect_err("an error").to_string();
    assert_eq!(on_device, by_reference);
    let crop = Tensor::from_fn([11], |i| [10, 8, 3, 1, 7, 6, 5, 4, 1, 2, 5][i]).into();
    let message = OP.reference(&[&picture, &crop]).expect_err("an error").to_string();
    assert!(message.contains("expected a pixel format from 0 to 4, got 5"), "{message}");
}

#[test]
fn central_crop_is_the_largest_square() {
    let part = |width, height| {
        let Crop { x, y, columns, rows, resized, window, .. } = Crop::central(width, height, 32);
        assert_eq!((resized, window), ([32; 2], [0; 2]));
        [x, y, columns, rows]
    };
    assert_eq!(part(1920, 1200), [360, 0, 1200, 1200]);
    assert_eq!(part(1, 8192), [0, 4095, 1, 1]);
}

#[test]
fn builds_from_text() {
    let build = |mean: &str, std: &str| {
        let named = [("width", "32"), ("height", "16"), ("mean", mean), ("std", std)];
        let named = named.map(|(name, value)| (name.to_owned(), value.to_owned()));
        let entry = find("crop_resize").expect("a registered operation");
        (entry.build)(&mut Params::new("crop_resize", named), &["picture", "crop"])
    };
    let op = build("0.5, 0.25,0", "1,2,3").expect("an operation");
    let text = format!("{op:?}");
    assert_eq!(
        text,
        "CropResize { width: 32, height: 16, mean: [0.5, 0.25, 0.0], std: [1.0, 2.0, 3.0] }"
    );
    let message = build("0.5,0.5", "1,1,1").expect_err("an error").to_string();
    assert!(message.contains("`mean`: expected 3 numbers") && message.ends_with("got 2"));
}
