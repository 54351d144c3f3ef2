//! `annotations.json`: the labels of a whole data set as COCO.

use std::path::Path;

use serde::Serialize;

use super::super::Error;
use super::super::conditions::Conditions;
use super::super::snaps::Kind;
use super::json::{read_json, write_rounded};
use super::origin::Origin;
use super::{ANNOTATIONS, Settings, Sidecar, label_path};
use crate::sensor::rect::Rect;

#[derive(Serialize)]
struct Coco {
    info: CocoInfo,
    categories: Vec<CocoCategory>,
    images: Vec<CocoImage>,
    annotations: Vec<CocoAnnotation>,
}

#[derive(Serialize)]
struct CocoInfo {
    description: &'static str,
    #[serde(flatten)]
    origin: Origin,
}

#[derive(Serialize)]
struct CocoCategory {
    id: u32,
    name: String,
    supercategory: &'static str,
}

#[derive(Serialize)]
struct CocoImage {
    id: usize,
    file_name: String,
    width: usize,
    height: usize,
    /// As text: 64 bits do not fit a JSON number everywhere.
    scene_seed: String,
    mm_per_pixel: f64,
    /// Of a given sensor; a housing that was drawn is not told.
    gel: Rect,
    conditions: Conditions,
}

#[derive(Serialize)]
struct CocoAnnotation {
    id: usize,
    image_id: usize,
    category_id: u32,
    /// `x, y, width, height` in pixels.
    bbox: [f64; 4],
    /// The box's area in square pixels.
    area: f64,
    iscrowd: u32,
    kind: String,
    /// Direction in which A's barbed tip points; none for B.
    yaw_deg: Option<f64>,
    depth_mm: f64,
    center_mm: [f64; 2],
    contact_area_px: f64,
    whole: bool,
    visible: f64,
    slots: Option<u32>,
    hole_mm: Option<f64>,
    wall: bool,
    on_side: bool,
}

/// Rounds to a thousandth, which is less than the labels' error.
fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

/// Writes `annotations.json` from the labels; the number of snaps.
pub(super) fn write_annotations(settings: &Settings, labels: &Path) -> Result<usize, Error> {
    let own = &settings.request.own.classes;
    let classes = if own.is_empty() { &[Kind::A, Kind::B][..] } else { own };
    let names: Vec<String> = classes.iter().map(|kind| kind.name().to_owned()).collect();
    let mut coco = Coco {
        info: CocoInfo {
            description: "simulated tactile pictures of snap joints",
            origin: Origin::of(settings),
        },
        categories: (1..)
            .zip(&names)
            .map(|(id, name)| CocoCategory { id, name: name.clone(), supercategory: "snap" })
            .collect(),
        images: Vec::with_capacity(settings.count),
        annotations: Vec::new(),
    };
    for id in 0..settings.count {
        let sidecar: Sidecar = read_json(&label_path(labels, id))?;
        coco.images.push(CocoImage {
            id,
            file_name: format!("{id:06}.png"),
            width: sidecar.frame.width,
            height: sidecar.frame.height,
            scene_seed: sidecar.scene_seed.to_string(),
            mm_per_pixel: sidecar.frame.mm_per_pixel,
            gel: match &settings.request.sensor {
                Some(given) => given.gel(),
                None => {
                    let [width, height] = [sidecar.frame.width, sidecar.frame.height];
                    Rect { x: 0, y: 0, width: width as u32, height: height as u32 }
                }
            },
            conditions: sidecar.conditions,
        });
        for snap in sidecar.snaps {
            let [x0, y0, x1, y1] = snap.pixel_box;
            let at = names.iter().position(|name| *name == snap.kind);
            let at = at.ok_or_else(|| Error::Content {
                path: label_path(labels, id),
                expected: format!("snaps of {}", names.join(", ")),
                found: snap.kind.clone(),
            })?;
            let category_id = at as u32 + 1;
            coco.annotations.push(CocoAnnotation {
                id: coco.annotations.len() + 1,
                image_id: id,
                category_id,
                bbox: [x0, y0, x1 - x0, y1 - y0].map(rounded),
                area: rounded((x1 - x0) * (y1 - y0)),
                iscrowd: 0,
                kind: snap.kind,
                yaw_deg: snap.yaw_deg.map(rounded),
                depth_mm: rounded(snap.depth_mm),
                center_mm: snap.center_mm.map(rounded),
                contact_area_px: rounded(snap.area_px),
                whole: snap.whole,
                visible: rounded(snap.visible),
                slots: snap.slots,
                hole_mm: snap.hole_mm.map(rounded),
                wall: snap.wall,
                on_side: snap.on_side,
            });
        }
    }
    write_rounded(&settings.out.join(ANNOTATIONS), &coco)?;
    Ok(coco.annotations.len())
}
