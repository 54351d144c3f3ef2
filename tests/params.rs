//! Every parameter of every operation is declared with its range, and nothing outside it is taken.

use std::panic::{AssertUnwindSafe, catch_unwind};

use smr_gpu::Error;
use smr_gpu::Precision;
use smr_gpu::engine::graph::Graph;
use smr_gpu::engine::kernels::Caps;
use smr_gpu::engine::lower::{KernelChoice, Request, lower};
use smr_gpu::engine::ops::{Case, Entry, OPS, Op, Params};
use smr_gpu::engine::tensor::Value;

/// What every parameter is given in turn: the ends of u32 and u64, what is no whole number, no
/// number, no finite number, nothing.
const PROBES: [&str; 13] = [
    "0",
    "-0",
    "-1",
    "0.5",
    "1e38",
    "1e39",
    "1e-45",
    "NaN",
    "inf",
    "-inf",
    "4294967295",
    "4294967296",
    "",
];

/// The probes that are legal, by operation and parameter; for a list, of each of its elements.
/// Whoever adds a parameter says here what it takes.
const LEGAL: &[(&str, &str, &[&str])] = &[
    ("box_voting", "iou_threshold", &["0", "-0", "0.5", "1e-45"]),
    ("contact_map", "least", &["0", "-0", "0.5", "1e38", "1e-45", "4294967295", "4294967296"]),
    ("contact_map", "most", &["0", "-0", "0.5", "1e38", "1e-45", "4294967295", "4294967296"]),
    ("contact_map", "clipped", &["0", "-0", "0.5", "1e38", "1e-45", "4294967295", "4294967296"]),
    ("contact_map", "reach", &[]),
    ("contact_map", "factor", &["0", "-0", "0.5", "1e38", "1e-45", "4294967295", "4294967296"]),
    ("conv2d", "stride", &[]),
    ("conv2d", "padding", &["0"]),
    ("conv2d", "dilation", &[]),
    ("conv2d", "relu", &[]),
    ("crop_resize", "width", &[]),
    ("crop_resize", "height", &[]),
    ("crop_resize", "mean", &["0", "-0", "0.5", "1e-45"]),
    ("crop_resize", "std", &["0.5"]),
    ("decode_detections", "width", &[]),
    ("decode_detections", "height", &[]),
    ("decode_detections", "weights", &["0.5"]),
    ("decode_detections", "temperature", &["0.5"]),
    ("decode_detections", "class_mask", &["0", "4294967295"]),
    // All four sides alike are no box.
    ("decode_proposals", "anchors", &[]),
    ("decode_proposals", "stride", &[]),
    ("decode_proposals", "width", &[]),
    ("decode_proposals", "height", &[]),
    ("global_avg_pool", "maps", &[]),
    ("indirect_grid", "capacity", &["4294967295"]),
    // For a capacity of 1000 more than a u32 counts.
    ("indirect_grid", "items_per_count", &[]),
    ("indirect_grid", "workgroup_size", &[]),
    ("indirect_grid", "layers", &[]),
    ("linear", "relu", &[]),
    ("max_pool2d", "kernel", &[]),
    ("max_pool2d", "stride", &[]),
    ("max_pool2d", "padding", &["0"]),
    ("nms", "iou_threshold", &["0", "-0", "0.5", "1e-45"]),
    ("nms", "max_out", &["4294967295"]),
    (
        "nms",
        "min_score",
        &["0", "-0", "-1", "0.5", "1e38", "1e-45", "-inf", "4294967295", "4294967296"],
    ),
    ("nms", "min_size", &["0", "-0", "0.5", "1e38", "1e-45", "4294967295", "4294967296"]),
    ("nms", "sorted", &[]),
    ("roi_align", "spatial_scale", &["0.5"]),
    ("roi_align", "output_size", &[]),
    ("roi_align", "sampling_ratio", &[]),
    ("softmax", "temperature", &["0.5"]),
    ("top_k", "k", &["4294967295"]),
    ("upsample_bilinear", "out_height", &[]),
    ("upsample_bilinear", "out_width", &[]),
    ("not_finite", "values", &[]),
    ("weighted_sum", "maps", &[]),
];

/// `case`'s operation built anew from text, with `text` for the parameter `name`.
fn rebuild(entry: &Entry, case: &Case, name: &str, text: &str) -> Result<Box<dyn Op>, Error> {
    let settings = case.op.settings().into_iter().map(|(n, setting)| {
        let setting = setting.to_string();
        (n.to_owned(), if n == name { text.to_owned() } else { setting })
    });
    let given = |n: &str| entry.params.iter().any(|p| p.name == n && !p.by_tensors);
    let mut params = Params::new(entry.name, settings.filter(|(n, _)| given(n)));
    let op = (entry.build)(&mut params, &case.op.inputs())?;
    params.finish()?;
    Ok(op)
}

/// What the host does with an operation: shapes, dispatches, reference.
fn host(op: Box<dyn Op>, inputs: &[Value]) -> Result<(), Error> {
    let op: std::sync::Arc<dyn Op> = op.into();
    let mut graph = Graph::default();
    let named = op.inputs().into_iter().zip(inputs);
    let ids: Vec<_> = named.map(|(name, value)| graph.constant(name, value.clone())).collect();
    let outputs = graph.apply_shared("op", op.clone(), &ids)?;
    outputs.iter().for_each(|id| graph.mark_output(*id));
    let (caps, kernels) = (Caps::default().with_subgroups([8, 8]), KernelChoice::default());
    lower(
        &graph,
        &Request { keep: &[], batch: 1, precision: Precision::F32, caps: &caps, kernels: &kernels },
    )?;
    op.reference(&inputs.iter().collect::<Vec<_>>()).map(|_| ())
}

#[test]
fn every_parameter_is_declared_and_told() {
    for entry in OPS {
        let declared: Vec<_> = entry.params.iter().map(|p| p.name).collect();
        for case in (entry.cases)() {
            let settings = case.op.settings();
            let told: Vec<_> = settings.iter().map(|(name, _)| *name).collect();
            assert_eq!(told, declared, "{} / {}: settings against params", entry.name, case.name);
            for (param, (_, setting)) in entry.params.iter().zip(&settings) {
                assert!(param.range.admits(setting), "{}: {}={setting}", entry.name, param.name);
            }
            // Each as `name: value` in the operation's own words, so that none is left out: what
            // is not told is whether an optional tensor is there.
            let debug = format!("{:?}", case.op);
            let inner = debug.split_once('{').map_or("", |(_, fields)| fields);
            let fields = inner.split([',', '{']).filter_map(|f| f.split_once(':'));
            for field in fields.map(|(name, _)| name.trim()) {
                let tensor =
                    ["bias", "residual", "order", "count", "classes", "reference"].contains(&field);
                assert!(tensor || told.contains(&field), "{}: `{field}` is not told", entry.name);
            }
        }
    }
}

#[test]
fn every_parameter_refuses_what_is_outside_its_range() {
    let mut failures = Vec::new();
    let mut known = 0;
    for entry in OPS {
        let case = &(entry.cases)()[0];
        for param in entry.params {
            let Some((_, _, legal)) =
                LEGAL.iter().find(|(op, name, _)| (*op, *name) == (entry.name, param.name))
            else {
                failures.push(format!("{}: `{}` is not in the table", entry.name, param.name));
                continue;
            };
            known += 1;
            if param.by_tensors {
                continue;
            }
            let (_, setting) =
                case.op.settings().into_iter().find(|(n, _)| *n == param.name).expect("a setting");
            let length = setting.to_string().split(',').count();
            for probe in PROBES {
                let text = vec![probe; length].join(",");
                let what = format!("{} {}={text:?}", entry.name, param.name);
                let run = || {
                    rebuild(entry, case, param.name, &text).and_then(|op| host(op, &case.inputs))
                };
                match catch_unwind(AssertUnwindSafe(run)) {
                    Err(_) => failures.push(format!("{what}: panicked")),
                    Ok(Ok(())) if legal.contains(&probe) => {}
                    Ok(Ok(())) => failures.push(format!("{what}: taken")),
                    Ok(Err(Error::Param { param: named, .. })) if named == param.name => {
                        if legal.contains(&probe) {
                            failures.push(format!("{what}: refused"));
                        }
                    }
                    Ok(Err(Error::Capacity { .. })) if !legal.contains(&probe) => {}
                    Ok(Err(e)) => failures.push(format!("{what}: {e}")),
                }
            }
        }
    }
    assert_eq!(known, LEGAL.len(), "the table names parameters that do not exist");
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Products of dimensions that no u32 or usize holds, also where a zero hides them.
#[test]
fn sizes_past_a_u32_are_refused() {
    for entry in OPS {
        for case in (entry.cases)() {
            let specs: Vec<_> = case.inputs.iter().map(Value::spec).collect();
            for (i, axis) in specs
                .iter()
                .enumerate()
                .flat_map(|(i, s)| (0..s.shape.rank()).map(move |axis| (i, axis)))
            {
                for (huge, zero) in [(usize::MAX, false), (usize::MAX, true), (1 << 33, false)] {
                    let mut changed = specs.clone();
                    let dims = &mut changed[i].shape.0;
                    let next = (axis + 1) % dims.len();
                    if zero {
                        dims[next] = 0;
                    }
                    dims[axis] = huge;
                    let what = format!("{}: {changed:?}", entry.name);
                    let result = catch_unwind(AssertUnwindSafe(|| case.op.infer(&changed)));
                    let result = result.unwrap_or_else(|_| panic!("{what}: panicked"));
                    let error = result.expect_err(&what);
                    assert!(
                        matches!(error, Error::Capacity { .. } | Error::Tensor { .. }),
                        "{what}: {error}"
                    );
                }
            }
        }
    }
}
