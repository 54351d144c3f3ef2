//! COCO annotations, and the COCO evaluation held to pycocotools.

use std::path::Path;

use serde_json::{Value, json};
use smr_gpu::evaluation::coco::{self, Dataset};
use smr_gpu::evaluation::metrics::{
    Areas, PictureBoxes, ScoredBox, average_precision, average_precision_50_95, coco_overlaps,
};
use smr_gpu::{Frame, Gel, PixelFormat, Rect, Scale};

fn fixture() -> Value {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/coco.json");
    let text = std::fs::read(file).expect("the fixture");
    serde_json::from_slice(&text).expect("JSON")
}

fn parse(value: &Value) -> Result<Dataset, String> {
    coco::parse(value.to_string().as_bytes()).map_err(|e| e.to_string())
}

/// Each category's boxes by picture.
fn boxes(data: &Dataset, ids: &[u64], found: &Value) -> Vec<Vec<PictureBoxes>> {
    let found = found.as_array().expect("a list");
    let of = |category: usize, picture: &coco::Picture| {
        let labels = picture.labels.iter().filter(|l| l.category == category);
        let here = found.iter().filter(|f| f[0] == picture.id && f[1] == ids[category]);
        let found = here.map(|f| {
            let [x, y, w, h] = [0, 1, 2, 3].map(|i| f[2][i].as_f64().expect("a number"));
            ScoredBox { bbox: [x, y, x + w, y + h], score: f[3].as_f64().expect("a score") }
        });
        PictureBoxes { truths: labels.map(|l| l.truth).collect(), found: found.collect() }
    };
    (0..ids.len()).map(|c| data.pictures.iter().map(|p| of(c, p)).collect()).collect()
}

/// pycocotools on 200 random sets with ties, crowds, areas and empty classes; made by
/// tests/fixtures/coco.py.
#[test]
fn figures_are_those_of_pycocotools() {
    let fixture = fixture();
    for (ours, theirs) in coco_overlaps().iter().zip(fixture["overlaps"].as_array().expect("ten")) {
        assert_eq!(*ours, theirs.as_str().expect("text").parse::<f64>().expect("a number"));
    }
    let areas = [
        ("all", Areas::ALL),
        ("small", Areas::SMALL),
        ("medium", Areas::MEDIUM),
        ("large", Areas::LARGE),
    ];
    let (mut figures, mut empty, mut crowds, mut between) = (0, 0, 0, 0);
    let sets = fixture["sets"].as_array().expect("sets");
    assert_eq!(sets.len(), 200);
    for (number, set) in sets.iter().enumerate() {
        let data = parse(&set["annotations"]).expect("annotations");
        let categories = set["annotations"]["categories"].as_array().expect("a list");
        let ids: Vec<u64> = categories.iter().map(|c| c["id"].as_u64().expect("an id")).collect();
        crowds += data.pictures.iter().flat_map(|p| &p.labels).filter(|l| l.truth.crowd).count();
        for (c, boxes) in boxes(&data, &ids, &set["found"]).iter().enumerate() {
            for (name, areas) in areas {
                let ours = average_precision(boxes, coco_overlaps()[0], areas)
                    .zip(average_precision_50_95(boxes, areas));
                let theirs = &set["expected"][name][c];
                let Some((ap50, ap)) = ours else {
                    assert!(theirs.is_null(), "set {number}, {name}, class {c}: {theirs}");
                    empty += 1;
                    continue;
                };
                for (ours, theirs) in [ap50, ap].into_iter().zip([&theirs[0], &theirs[1]]) {
                    let theirs = theirs.as_f64().unwrap_or(f64::NAN);
                    let error = (ours - theirs).abs();
                    let what = format!("set {number}, {name}, class {c}: {ours} and {theirs}");
                    assert!(error <= 1e-12, "{what}");
                    figures += 1;
                    between += usize::from(theirs > 0.0 && theirs < 1.0);
                }
            }
        }
    }
    println!(
        "{figures} figures, {between} of them between 0 and 1; {empty} empty; {crowds} crowds"
    );
    assert!(figures > 1000 && between > 500 && empty > 200 && crowds > 100);
}

/// Annotations of one picture, after `change`.
fn changed(change: impl FnOnce(&mut Value)) -> Value {
    let mut value = json!({
        "images": [
            {"id": 7, "file_name": "images/a.png", "width": 80, "height": 60},
            {"id": 3, "file_name": "b.png"}
        ],
        "categories": [{"id": 1, "name": "A"}, {"id": 2, "name": "B"}],
        "annotations": [
            {"id": 1, "image_id": 7, "category_id": 2, "bbox": [10, 20, 30, 40]},
            {"id": 2, "image_id": 3, "category_id": 1, "bbox": [0.5, 0, 4, 5], "area": 9, "iscrowd": 1}
        ]
    });
    change(&mut value);
    value
}

#[test]
fn annotations_are_read() {
    let data = parse(&changed(|_| ())).expect("annotations");
    assert_eq!(data.categories, ["A", "B"]);
    let [b, a] = &data.pictures[..] else { panic!("two pictures: {data:?}") };
    assert_eq!((a.id, a.file.as_path(), a.size), (7, Path::new("images/a.png"), Some((80, 60))));
    assert_eq!((b.id, b.size), (3, None));
    let truth = a.labels[0].truth;
    assert_eq!((a.labels[0].category, truth.bbox), (1, [10.0, 20.0, 40.0, 60.0]));
    assert_eq!((truth.area, truth.crowd), (1200.0, false));
    let truth = b.labels[0].truth;
    assert_eq!((truth.bbox, truth.area, truth.crowd), ([0.5, 0.0, 4.5, 5.0], 9.0, true));
    let message = a.check_size(60, 80).expect_err("turned").to_string();
    assert_eq!(message, "image 7: expected 80 × 60 pixels as labelled, got 60 × 80");
    b.check_size(4, 4).expect("a pixel is the margin");
    let message = b.check_size(3, 5).expect_err("too narrow").to_string();
    assert!(message.starts_with("annotation 2: expected a bbox inside its 3 × 5 pixels"));
    // Some tools write no ids, a crowd as true or false, and corners that are rounded.
    let rounded = changed(|v| {
        let annotation = &mut v["annotations"][0];
        annotation.as_object_mut().expect("an object").remove("id");
        annotation["iscrowd"] = json!(false);
        annotation["bbox"] = json!([-0.5, -1, 81.5, 62]);
    });
    assert!(!parse(&rounded).expect("annotations").pictures[1].labels[0].truth.crowd);
}

#[test]
fn a_frame_has_what_its_label_states() {
    let gel = json!({ "x": 3, "y": 2, "width": 70, "height": 50 });
    let stated = changed(|v| {
        v["images"][0]["gel"] = gel;
        v["images"][0]["mm_per_pixel"] = json!(0.07);
    });
    let data = parse(&stated).expect("annotations");
    let frame = || Frame::new(vec![0; 80 * 60], 80, 60, PixelFormat::Gray8);
    let [bare, stated] = [0, 1].map(|i| data.pictures[i].state(frame()));
    let part = Gel::Part(Rect { x: 3, y: 2, width: 70, height: 50 });
    assert_eq!((stated.gel, stated.scale), (Some(part), Some(Scale::label(0.07))));
    assert_eq!((bare.gel, bare.scale), (None, None));
}

#[test]
fn what_would_enter_the_figures_unseen_is_refused_by_name() {
    let bbox = |bbox: Value| changed(move |v| v["annotations"][0]["bbox"] = bbox);
    let file = |name: &str| changed(|v| v["images"][0]["file_name"] = json!(name));
    let cases = [
        (bbox(json!([10, 20, -3, 4])), "annotation 1: expected a bbox of finite numbers"),
        (bbox(json!([10, 20, 0, 4])), "annotation 1: expected a bbox of finite numbers"),
        (bbox(json!([10, 20, 3, 1e-300])), "annotation 1: expected a bbox of finite numbers"),
        (bbox(json!([1e308, 20, 1.7e308, 4])), "annotation 1: expected a bbox of finite numbers"),
        (bbox(json!([10, 20, 72, 4])), "annotation 1: expected a bbox inside its 80 × 60 pixels"),
        (bbox(json!([-2, 20, 7, 4])), "annotation 1: expected a bbox inside its 80 × 60 pixels"),
        (bbox(json!([1, 2, 3])), "annotation 1: bbox: expected COCO's JSON"),
        (bbox(json!([1, 2, 3, null])), "annotation 1: bbox: expected COCO's JSON"),
        (
            changed(|v| v["annotations"][1]["bbox"] = json!([-9, 0, 4, 5])),
            "annotation 2: expected a bbox inside its picture",
        ),
        (changed(|v| v["annotations"][1]["area"] = json!(-1)), "annotation 2: expected an area"),
        (changed(|v| v["annotations"][1]["iscrowd"] = json!(2)), "an iscrowd of 0 or 1, got 2"),
        (changed(|v| v["annotations"][1]["id"] = json!(1)), "annotation 1: expected each id once"),
        (changed(|v| v["annotations"][1]["image_id"] = json!(8)), "image_id of an image, got 8"),
        (changed(|v| v["annotations"][1]["category_id"] = json!(8)), "category, got 8"),
        (changed(|v| v["categories"][1]["id"] = json!(1)), "category 1: expected each id once"),
        (changed(|v| v["categories"][1]["name"] = json!("a")), "category 2: expected each name"),
        (changed(|v| v["images"][1]["id"] = json!(7)), "image 7: expected each id once"),
        (changed(|v| v["images"][0]["width"] = json!(0)), "33554432 pixels, got 0 × 60"),
        (changed(|v| v["images"][0]["width"] = json!(u32::MAX)), "got 4294967295 × 60"),
        (changed(|v| v["images"] = json!([])), "images: expected at least one, got none"),
        (file("b.png"), "`b.png`, which is image 7's"),
        (file("./b.png"), "a file_name of its own"),
        (file("../b.png"), "image 7: expected a file_name inside the folder, got `../b.png`"),
        (file("x/../../b.png"), "inside the folder"),
        (file("/etc/passwd"), "inside the folder"),
        (file("."), "inside the folder"),
        (file(""), "inside the folder"),
    ];
    for (value, phrase) in cases {
        let message = parse(&value).expect_err(phrase);
        assert!(message.contains(phrase), "no `{phrase}` in: {message}");
    }
    // What Python writes, and what is no JSON.
    for text in ["NaN", "Infinity", "1e999", "{}", "", "\u{0}", "[[[["] {
        let whole = changed(|_| ()).to_string().replacen("[10,20,30,40]", text, 1);
        for text in [whole.as_str(), text] {
            let message = coco::parse(text.as_bytes()).expect_err(text).to_string();
            assert!(message.contains("expected COCO's JSON, got an error: "), "{message}");
        }
    }
    let deep = "[".repeat(1 << 20);
    assert!(coco::parse(deep.as_bytes()).is_err());
}

/// Where a value is of another kind, the line and column alone help nobody.
#[test]
fn a_value_of_another_kind_is_named_by_entry_and_field() {
    let set = |list: &'static str, at: usize, key: &'static str, value: Value| {
        changed(move |v| v[list][at][key] = value)
    };
    let whole = "expected a whole number from 0";
    let cases = [
        (set("annotations", 1, "id", json!("2")), "annotation \"2\": id: ", whole),
        (set("annotations", 1, "id", json!(-2)), "annotation -2: id: ", whole),
        (set("annotations", 1, "id", json!(2.5)), "annotation 2.5: id: ", whole),
        (set("annotations", 1, "id", json!(1e300)), "annotation 1e+300: id: ", whole),
        (set("annotations", 1, "image_id", json!("3")), "annotation 2: image_id: ", whole),
        (set("annotations", 1, "category_id", json!(-1)), "annotation 2: category_id: ", whole),
        (set("annotations", 1, "category_id", json!(null)), "annotation 2: category_id: ", whole),
        (set("annotations", 1, "area", json!("9")), "annotation 2: area: ", "expected f64"),
        (set("images", 1, "id", json!([3])), "image [3]: id: ", whole),
        (set("images", 0, "width", json!("80")), "image 7: width: ", whole),
        (set("images", 0, "height", json!(59.5)), "image 7: height: ", whole),
        (set("images", 0, "mm_per_pixel", json!("x")), "image 7: mm_per_pixel: ", "expected f32"),
        (set("images", 0, "file_name", json!(7)), "image 7: file_name: ", "expected a string"),
        (set("categories", 1, "id", json!("B")), "category \"B\": id: ", whole),
        (set("categories", 1, "name", json!(2)), "category 2: name: ", "expected a string"),
    ];
    for (value, place, expected) in cases {
        let message = parse(&value).expect_err(place);
        let start = format!("{place}expected COCO's JSON, got an error: ");
        assert!(message.starts_with(&start) && message.contains(expected), "{message}");
    }
    let without = changed(|v| drop(v["images"][1].as_object_mut().expect("one").remove("id")));
    let message = parse(&without).expect_err("no id");
    assert!(message.starts_with("image at position 1: expected") && message.contains("`id`"));
    // The same number, as tools write it that know doubles alone.
    let floats = changed(|v| {
        v["images"][0]["id"] = json!(7.0);
        v["images"][0]["width"] = json!(80.0);
        v["annotations"][0] = json!(
            {"id": 1.0, "image_id": 7.0, "category_id": 2.0, "bbox": [10, 20, 30, 40], "iscrowd": 0.0}
        );
    });
    assert_eq!(parse(&floats), parse(&changed(|_| ())));
}

#[test]
fn a_byte_order_mark_is_passed_over_and_utf_16_named() {
    let text = changed(|_| ()).to_string();
    let marked = coco::parse(format!("\u{feff}{text}").as_bytes());
    assert_eq!(marked, coco::parse(text.as_bytes()));
    assert!(marked.is_ok());
    let wide: Vec<u8> =
        format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    let message = coco::parse(&wide).expect_err("UTF-16").to_string();
    assert!(message.ends_with("expected text in UTF-8, got UTF-16"), "{message}");
}

#[test]
fn categories_become_a_networks_classes() {
    let classes = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let data = parse(&changed(|v| {
        let list = v["categories"].as_array_mut().expect("a list");
        list.push(json!({"id": 9, "name": "unused"}));
    }));
    let data = data.expect("annotations");
    let turned = data.clone().of_classes(&classes(&["b", "a"])).expect("known categories");
    assert_eq!(turned.categories, ["b", "a"]);
    let categories = |data: &Dataset| -> Vec<usize> {
        data.pictures.iter().map(|picture| picture.labels[0].category).collect()
    };
    assert_eq!((categories(&data), categories(&turned)), (vec![0, 1], vec![1, 0]));
    let message = data.of_classes(&classes(&["B", "C"])).expect_err("no class").to_string();
    assert_eq!(message, "category: expected one of the weights' B, C, got `A`");
}

#[test]
fn a_picture_is_found_in_its_folder_or_in_images_there() {
    let value = changed(|v| v["images"][0]["file_name"] = json!("x\\a.png"));
    let picture = &parse(&value).expect("annotations").pictures[1];
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    assert_eq!(picture.find_in(folder.path()), at("images").join("x\\a.png"));
    for name in ["images/x/a.png", "x/a.png"] {
        std::fs::create_dir_all(at(name).parent().expect("a folder")).expect("made");
        std::fs::write(at(name), "").expect("written");
        assert_eq!(picture.find_in(folder.path()), at(name));
    }
}

#[test]
fn backslashes_are_separators_of_windows_and_lead_nowhere_else() {
    let windows = |name: &str| {
        let value = changed(|v| v["images"][0]["file_name"] = json!(name));
        parse(&value).expect("annotations").pictures[1].file_of_windows()
    };
    assert_eq!(windows("images\\x\\a.png").as_deref(), Some(Path::new("images/x/a.png")));
    assert_eq!(windows(".\\a.png").as_deref(), Some(Path::new("a.png")));
    for name in ["a.png", "images/a.png", "..\\a.png", "x\\..\\..\\a.png", "\\a.png", "\\\\host\\a"]
    {
        assert_eq!(windows(name), None, "{name}");
    }
}

/// What `smr-gpu simulate` writes beside boxes; from other tools the same names may hold anything.
#[test]
fn attributes_are_read_and_those_of_other_tools_passed_over() {
    let stated = changed(|v| {
        v["images"][0]["conditions"] = json!({"markers_mm": 2, "housing": true, "optics": "lamps", "jpeg": null, "window": [0]});
        v["images"][1]["conditions"] = json!("rain");
        let label = v["annotations"][0].as_object_mut().expect("an object");
        let more = json!({"whole": false, "depth_mm": 0.5, "slots": 4, "yaw_deg": null, "wall": [1],
            "keypoints": [1, 2]});
        label.extend(more.as_object().expect("an object").clone());
    });
    let data = parse(&stated).expect("annotations");
    let [b, a] = &data.pictures[..] else { panic!("two pictures: {data:?}") };
    let names = |attributes: &coco::Attributes| attributes.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&a.conditions), ["housing", "markers_mm", "optics"]);
    assert_eq!(a.conditions["markers_mm"], coco::Attribute::Number(2.0));
    assert_eq!(a.conditions["optics"], coco::Attribute::Text("lamps".into()));
    assert_eq!(names(&a.labels[0].attributes), ["depth_mm", "slots", "whole"]);
    assert_eq!(a.labels[0].attributes["whole"], coco::Attribute::Flag(false));
    assert!(b.conditions.is_empty() && b.labels[0].attributes.is_empty());
}
