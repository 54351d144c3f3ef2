//! What a frame shows: which part is gel, at which scale, and what the network sees of it
//! ([`Scale`] has the order in which this is found).

use crate::error::{Error, Result};
use crate::sensor::rect::Rect;
use crate::sensor::scale::PAPER_MM;
use crate::sensor::scale::{Gel, Origin, Scale};
use crate::sensor::{FIELD_MM, Lens, Sensed, Sensor};

/// A frame of the paper's shape whose stated scale is further than this share from that of the paper's
/// is another sensor's, and which part of it is gel is not known from its shape.
const SAME_SCALE: f32 = 0.25;

/// What one frame shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct View {
    /// Width and height of the frame.
    pub frame: [u32; 2],
    /// The part that shows the gel; millimetres begin in its middle.
    pub gel: Rect,
    /// Whether that is assumed.
    pub gel_assumed: bool,
    /// The part that the network sees: the gel, or what a crop shows of it.
    pub part: Rect,
    pub scale: Scale,
    pub lens: Lens,
}

impl View {
    /// Place on the gel, in millimetres from its middle, that is seen at this place of the frame.
    pub fn place_mm(&self, place: [f32; 2]) -> [f32; 2] {
        let Lens { axis, half_diagonal, distortion } = self.lens;
        let straight = |[x, y]: [f32; 2]| {
            let (x, y) = (x - axis[0], y - axis[1]);
            let r = x.hypot(y) / half_diagonal;
            let stretch = 1.0 + distortion * r * r;
            [x * stretch, y * stretch]
        };
        let ([x, y], [x0, y0]) = (straight(place), straight(self.gel.middle()));
        [(x - x0) * self.scale.mm_per_pixel, (y - y0) * self.scale.mm_per_pixel]
    }
}

/// What is known of a frame beside its size.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Known<'a> {
    pub sensor: Option<&'a Sensor>,
    pub scale: Option<Scale>,
    pub gel: Option<Gel>,
    pub crop: Option<Rect>,
    /// Whether an assumed scale is refused.
    pub strict: bool,
}

/// What a frame of this width and height shows: see the module.
///
/// # Errors
/// [`Error::Sensor`] for a frame that cannot be the sensor's; [`Error::Param`] for a crop that the frame
/// cannot have; [`Error::Scale`] for such a scale or gel, for a field outside [`FIELD_MM`], and for an assumed
/// scale where none may be.
pub(crate) fn view(frame: [u32; 2], known: Known) -> Result<View> {
    let [width, height] = frame;
    let all = Rect { x: 0, y: 0, width, height };
    let fail = |message: String| Error::Scale { width, height, message };
    if let Some(scale) = known.scale {
        scale.check().map_err(|e| match e {
            Error::Param { expected, got, .. } => {
                fail(format!("scale: expected {expected}, got {got}"))
            }
            other => other,
        })?;
    }
    let sensed = match known.sensor {
        Some(sensor) => match (sensor.sense(frame), known.scale, known.gel) {
            // All that the sensor would say is stated.
            (Err(_), Some(_), Some(_)) => None,
            (sensed, ..) => Some(sensed?),
        },
        None => papers(frame, &known),
    };
    let gel = match known.gel {
        None => sensed.map_or(all, |sensed| sensed.gel),
        Some(Gel::All) => all,
        Some(Gel::Part(part)) if part.is_in(width, height) => part,
        Some(Gel::Part(part)) => {
            return Err(fail(format!("gel: expected a part of the frame, got {part}")));
        }
    };
    let shorter = gel.width.min(gel.height) as f32;
    let assumed = Scale { mm_per_pixel: PAPER_MM / shorter, from: Origin::Assumed };
    let scale = known.scale.or(sensed.and_then(|sensed| sensed.scale)).unwrap_or(assumed);
    let lens = sensed.map_or(Lens::of([0.0; 2], frame.map(f64::from), 0.0), |sensed| sensed.lens);
    let mm = scale.mm_per_pixel;
    if known.strict && scale.from == Origin::Assumed {
        let expected = "expected its scale from a sensor or in millimetres a pixel";
        return Err(fail(format!("{expected}, got none ({mm:.5} would be assumed)")));
    }
    let part = match known.crop {
        // Of a field that nobody stated, what the weights know in size.
        None if scale.from == Origin::Assumed => gel.central(FIELD_MM[1] / PAPER_MM),
        None => gel,
        Some(crop) if !crop.is_in(width, height) => {
            let expected = format!("a part of {width} × {height} pixels");
            return Err(Error::param("frame", "crop", expected, crop));
        }
        Some(crop) => crop.within(&gel).ok_or_else(|| {
            Error::param("frame", "crop", format!("some of the gel, which is {gel}"), crop)
        })?,
    };
    let longer = |rect: Rect| rect.width.max(rect.height);
    let [least, most] = FIELD_MM;
    // Rounded to whole pixels, a field at the end of the range may lie a hair past it.
    let small = longer(gel) as f32 * mm < least * 0.999;
    if small || longer(part) as f32 * mm > most * 1.001 {
        let pixels = longer(if small { gel } else { part });
        return Err(fail(format!(
            "expected a field of {least} to {most} mm along the gel's longer side, got {:.3} mm: \
             {pixels} pixels of {mm:.5} mm",
            pixels as f32 * mm
        )));
    }
    let gel_assumed = known.gel.is_none() && known.sensor.is_none();
    Ok(View { frame, gel, gel_assumed, part, scale, lens })
}

/// What a frame shows if it is the paper's sensor's, of which nobody said so: it has that shape, and not
/// another scale or gel.
fn papers(frame: [u32; 2], known: &Known) -> Option<Sensed> {
    let sensed = Sensor::paper().sense(frame).ok().filter(|_| known.gel.is_none())?;
    let own = sensed.scale?.mm_per_pixel;
    let off = known.scale.map_or(0.0, |scale| (scale.mm_per_pixel / own - 1.0).abs());
    (off <= SAME_SCALE).then_some(Sensed { scale: None, ..sensed })
}

/// What is assumed of a frame, in a line; `None` where nothing is.
pub(crate) fn assumption(
    [width, height]: [u32; 2],
    gel: Option<Rect>,
    scale: Scale,
) -> Option<String> {
    let all = Rect { x: 0, y: 0, width, height };
    let part = gel.filter(|gel| *gel != all);
    if scale.from != Origin::Assumed && part.is_none() {
        return None;
    }
    let mut said = Vec::new();
    if let Some(part) = part {
        said.push(format!("gel in {part}, as in the paper's frames"));
    }
    if scale.from == Origin::Assumed {
        said.push(format!("{:.4} mm a pixel", scale.mm_per_pixel));
    }
    let takes =
        |name: &&str| Sensor::named(name).is_some_and(|sensor| sensor.takes([width, height]));
    let named: Vec<_> = Sensor::NAMES.into_iter().filter(takes).collect();
    let known = match &named[..] {
        [] => String::new(),
        names => format!(" (the size of frames of {})", names.join(", ")),
    };
    Some(format!("{width} × {height}{known}: assumed {}", said.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER_RAW: [u32; 2] = [1920, 1200];

    fn rect(x: u32, y: u32, width: u32, height: u32) -> Rect {
        Rect { x, y, width, height }
    }

    fn stated(mm: f32) -> Known<'static> {
        Known { scale: Some(Scale::stated(mm)), ..Known::default() }
    }

    fn seen(frame: [u32; 2], known: Known) -> View {
        view(frame, known).expect("a view")
    }

    /// What the network sees, the millimetres a pixel, and the line that says what was assumed.
    fn assumed(frame: [u32; 2], known: Known) -> (Rect, f32, Option<String>) {
        let View { part, gel, gel_assumed, scale, .. } = seen(frame, known);
        let said = assumption(frame, gel_assumed.then_some(gel), scale);
        (part, scale.mm_per_pixel, said)
    }

    #[test]
    fn what_nobody_states_is_assumed_and_said() {
        let line = |text: &str| Some(text.to_owned());
        let nobody = Known::default();
        for (frame, part, mm, said) in [
            (
                PAPER_RAW,
                rect(460, 100, 1000, 1000),
                0.04,
                "1920 × 1200 (the size of frames of paper): assumed gel in 1000 × 1000 at (460, 100), as in \
                 the paper's frames, 0.0400 mm a pixel",
            ),
            (
                [1280, 800],
                rect(307, 67, 666, 666),
                40.0 / 666.0,
                "1280 × 800: assumed gel in 666 × 666 at (307, 67), as in the paper's frames, 0.0601 mm a \
                 pixel",
            ),
            (
                [400, 400],
                rect(0, 0, 400, 400),
                40.0 / 400.0,
                "400 × 400: assumed 0.1000 mm a pixel",
            ),
            (
                [320, 240],
                rect(0, 0, 320, 240),
                40.0 / 240.0,
                "320 × 240 (the size of frames of gelsight-mini, digit): assumed 0.1667 mm a pixel",
            ),
            // 60 mm at most: three halves of the shorter side.
            (
                [200, 801],
                rect(0, 250, 200, 300),
                40.0 / 200.0,
                "200 × 801: assumed 0.2000 mm a pixel",
            ),
            // A line of pixels has a middle too.
            ([1, 8192], rect(0, 4095, 1, 1), 40.0, "1 × 8192: assumed 40.0000 mm a pixel"),
        ] {
            assert_eq!(assumed(frame, nobody), (part, mm, line(said)), "{frame:?}");
            assert_eq!(seen(frame, nobody).scale.from, Origin::Assumed);
            let strict = view(frame, Known { strict: true, ..nobody }).expect_err("an error");
            assert!(strict.to_string().contains("expected its scale"), "{strict}");
        }
    }

    /// A stated scale says nothing of which part is gel, unless the frame cannot be the paper's for it.
    #[test]
    fn a_stated_scale_keeps_the_gel() {
        let said = "1920 × 1200 (the size of frames of paper): assumed gel in 1000 × 1000 at (460, 100), as \
                    in the paper's frames";
        let window = rect(460, 100, 1000, 1000);
        assert_eq!(assumed(PAPER_RAW, stated(0.04)), (window, 0.04, Some(said.into())));
        assert_eq!(assumed(PAPER_RAW, stated(0.045)).0, window);
        assert_eq!(assumed([960, 600], stated(0.08)).0, rect(230, 50, 500, 500));
        // 51.2 × 32 mm: another sensor's, of which all may be gel.
        assert_eq!(assumed([1280, 800], stated(0.04)), (rect(0, 0, 1280, 800), 0.04, None));
        assert_eq!(assumed([400, 400], stated(0.04)), (rect(0, 0, 400, 400), 0.04, None));
        let strict = Known { strict: true, ..stated(0.04) };
        assert_eq!(seen([400, 400], strict).scale, Scale::stated(0.04));
        // A sensor's gel is its own, at whatever scale.
        let paper = Sensor::paper();
        let known = Known { sensor: Some(&paper), ..stated(0.05) };
        assert_eq!(assumed(PAPER_RAW, known), (window, 0.05, None));
        assert_eq!(assumed([250, 250], Known { sensor: Some(&paper), ..stated(0.1) }).1, 0.1);
    }

    #[test]
    fn a_stated_gel_keeps_the_scale() {
        let mini = Sensor::gelsight_mini();
        let part = Some(Gel::Part(rect(10, 20, 200, 180)));
        let known = Known { sensor: Some(&mini), gel: part, ..Known::default() };
        assert_eq!(assumed([320, 240], known), (rect(10, 20, 200, 180), 0.0634, None));
        let all = Known { gel: Some(Gel::All), ..stated(0.03) };
        assert_eq!(assumed(PAPER_RAW, all), (rect(0, 0, 1920, 1200), 0.03, None));
        // Of a gel alone 40 mm are assumed along its shorter side.
        let (.., mm, said) = assumed(PAPER_RAW, Known { gel: part, ..Known::default() });
        assert_eq!(mm, 40.0 / 180.0);
        assert!(said.expect("a line").ends_with("assumed 0.2222 mm a pixel"));
        let outside = Known { gel: Some(Gel::Part(rect(0, 0, 401, 1))), ..stated(0.04) };
        let message = view([400, 400], outside).expect_err("an error").to_string();
        let want = "400 × 400 pixels: gel: expected a part of the frame, got 401 × 1 at (0, 0)";
        assert_eq!(message, want);
        // Where both are stated, a frame may have another shape than the sensor's.
        let both = Known { sensor: Some(&mini), gel: Some(Gel::All), ..stated(0.04) };
        assert_eq!(assumed([400, 400], both).0, rect(0, 0, 400, 400));
        assert!(view([400, 400], Known { sensor: Some(&mini), ..stated(0.04) }).is_err());
    }

    /// A crop cuts: scale and origin are the whole frame's.
    #[test]
    fn a_crop_cuts_and_no_more() {
        let paper = Sensor::paper();
        let lens = Sensor { distortion: -0.1, ..Sensor::paper() };
        let crop = Some(rect(400, 600, 560, 500));
        for known in [
            Known::default(),
            stated(0.04),
            Known { sensor: Some(&paper), ..Known::default() },
            Known { sensor: Some(&lens), ..Known::default() },
        ] {
            let (whole, cut) = (seen(PAPER_RAW, known), seen(PAPER_RAW, Known { crop, ..known }));
            assert_eq!((cut.scale, cut.gel, cut.lens), (whole.scale, whole.gel, whole.lens));
            // What is beside the gel is not seen.
            assert_eq!(cut.part, rect(460, 600, 500, 500));
            let place = [700.0, 900.0];
            assert_eq!(cut.place_mm(place), whole.place_mm(place));
        }
        let message = |crop| {
            let known = Known { crop: Some(crop), ..Known::default() };
            view(PAPER_RAW, known).expect_err("an error").to_string()
        };
        let beside = message(rect(0, 0, 460, 1200));
        assert!(beside.contains("some of the gel, which is 1000 × 1000 at (460, 100)"), "{beside}");
        assert!(message(rect(0, 0, 1921, 1)).contains("a part of 1920 × 1200 pixels"));
        // A part of a field that is too large as a whole, and one smaller than any.
        let large = [4000, 4000];
        assert!(view(large, stated(0.04)).is_err());
        for side in [1000, 100] {
            let crop = Some(rect(3000, 0, side, side));
            assert_eq!(seen(large, Known { crop, ..stated(0.04) }).part.width, side);
        }
    }

    #[test]
    fn fields_that_no_sensor_has_are_refused() {
        let message = |frame, mm| view(frame, stated(mm)).expect_err("an error").to_string();
        let want = "2000 × 10 pixels: expected a field of 10 to 60 mm along the gel's longer side, got \
                    100.000 mm: 2000 pixels of 0.05000 mm";
        assert_eq!(message([2000, 10], 0.05), want);
        assert!(message([100, 100], 0.05).contains("got 5.000 mm"));
        for mm in [0.0, -0.04, f32::NAN, f32::INFINITY] {
            assert!(
                message([100, 100], mm).contains("pixels: scale: expected 0.0005 to 1 mm"),
                "{mm}"
            );
        }
    }

    /// 12.5 columns right of the middle and 25 rows above it.
    #[test]
    fn millimetres_are_from_the_middle_of_the_gel() {
        let view = seen(PAPER_RAW, Known::default());
        assert_eq!(view.place_mm([972.5, 575.0]), [0.5, -1.0]);
    }

    /// κ = −0.1 at half of the half diagonal, 250 of 500 px: 250 (1 − 0.1 / 4) = 243.75 px.
    #[test]
    fn a_lens_bends_places_but_not_the_middle() {
        let text =
            r#"{ "name": "lens", "frame": [800, 600], "mm_per_pixel": 0.05, "distortion": -0.1 }"#;
        let sensor = Sensor::parse(text).expect("a sensor");
        let view = seen([800, 600], Known { sensor: Some(&sensor), ..Known::default() });
        assert_eq!(view.place_mm([400.0, 300.0]), [0.0, 0.0]);
        let [x, y] = view.place_mm([600.0, 450.0]);
        assert!((x - 0.8 * 243.75 * 0.05).abs() < 1e-5 && (y - 0.6 * 243.75 * 0.05).abs() < 1e-5);
    }

    /// A picture of the gel alone, at half the size, shows what the whole frame shows there.
    #[test]
    fn a_lens_bends_the_gel_alone_as_in_the_whole_frame() {
        let text = r#"{ "name": "lens", "frame": [800, 600], "mm_per_pixel": 0.05, "distortion": -0.1,
            "gel": { "x": 300, "y": 100, "width": 400, "height": 400 } }"#;
        let sensor = Sensor::parse(&format!("\u{feff}{text}")).expect("a sensor after a mark");
        let known = Known { sensor: Some(&sensor), ..Known::default() };
        let (whole, alone) = (seen([800, 600], known), seen([200, 200], known));
        let (in_frame, in_gel) = (whole.place_mm([680.0, 140.0]), alone.place_mm([190.0, 20.0]));
        for (a, b) in in_frame.into_iter().zip(in_gel) {
            assert!((a - b).abs() < 1e-4, "{in_frame:?} {in_gel:?}");
        }
    }
}
