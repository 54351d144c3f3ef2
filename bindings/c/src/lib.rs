//! The C interface: `include/smr_gpu.h` is generated from this file.
//!
//! Each function checks its pointers, turns errors into a status with a message for the calling thread, and
//! stops panics.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::ptr;
use std::slice;

use smr_gpu_rust::{
    Config, Detection, Detections, Error, Frame, GpuDetector, Origin, PixelFormat, Savings, Sensor,
};

/// Version of this interface: a program made for another one must be compiled anew.
pub const SMR_ABI: u32 = 1;

/// What came of a call.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SmrStatus {
    /// All is well.
    Ok = 0,
    /// An argument cannot be: a null pointer, a format or number out of its range, text that is not UTF-8.
    Argument = 1,
    /// The weights, or the sensor's file, are not there or damaged.
    File = 2,
    /// There is no such device, it cannot be opened, or it was lost.
    Device = 3,
    /// The frame is not what it says, or cannot be the sensor's.
    Frame = 4,
    /// The device did not finish in time.
    Timeout = 5,
    /// A fault of this library.
    Internal = 6,
}

/// How a frame's pixels lie in memory.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SmrFormat {
    /// Red, green, blue; a byte each.
    Rgb8 = 0,
    /// Blue, green, red, as OpenCV has it.
    Bgr8 = 1,
    /// Red, green, blue, and a byte that is ignored.
    Rgba8 = 2,
    /// Blue, green, red, and a byte that is ignored.
    Bgra8 = 3,
    /// Grey.
    Gray8 = 4,
    /// Grey of 16 bits, the low byte first; 65535 is white.
    Gray16 = 5,
    /// Behind a Bayer filter: the first row's first two pixels, then the second row's.
    BayerRggb8 = 6,
    /// The same in another order.
    BayerBggr8 = 7,
    /// The same in another order.
    BayerGrbg8 = 8,
    /// The same in another order.
    BayerGbrg8 = 9,
    /// YUV 4:2:2, also called YUY2.
    Yuyv = 10,
    /// YUV 4:2:0: all luma, then pairs of colour differences.
    Nv12 = 11,
}

const FORMATS: [PixelFormat; 12] = [
    PixelFormat::Rgb8,
    PixelFormat::Bgr8,
    PixelFormat::Rgba8,
    PixelFormat::Bgra8,
    PixelFormat::Gray8,
    PixelFormat::Gray16,
    PixelFormat::BayerRggb8,
    PixelFormat::BayerBggr8,
    PixelFormat::BayerGrbg8,
    PixelFormat::BayerGbrg8,
    PixelFormat::Yuyv,
    PixelFormat::Nv12,
];

/// How the scale is known.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SmrOrigin {
    /// The caller said it.
    Stated = 0,
    /// The sensor says it.
    Sensor = 1,
    /// Nobody says it: 40 mm along the gel's shorter side.
    Assumed = 2,
}

/// Whether something touches the gel.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SmrContact {
    /// Nobody looked.
    Unknown = 0,
    /// Nothing does, and the network did not run.
    None = 1,
    /// Something does.
    Some = 2,
}

/// How to open a detector. Begin with smr_options_default.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct SmrOptions {
    /// SMR_ABI.
    pub abi: u32,
    /// "small", "large", a name, or a weight file. UTF-8.
    pub weights: *const c_char,
    /// "auto", "cpu", "gpu", an adapter's index or part of its name.
    pub device: *const c_char,
    /// "paper", "gelsight-mini", "digit" or a sensor file; null for none.
    pub sensor: *const c_char,
    /// Millimetres of gel for a pixel of the frames; 0 for what the sensor says.
    pub mm_per_pixel: f32,
    /// A detection's score must be above this; 0 to 1.
    pub score: f32,
    /// At most so many detections a frame; 1 to 100.
    pub max_detections: u32,
    /// Leave nothing out, whatever the frame shows.
    pub exact: bool,
}

/// A frame in memory, which need not outlive the call.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct SmrFrame {
    /// Its pixels, row by row from the top.
    pub data: *const u8,
    /// How many bytes there are.
    pub size: usize,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from the start of a row to that of the next; 0 where rows follow one another.
    pub stride: usize,
    /// An SmrFormat.
    pub format: u32,
}

/// A snap. What the weights do not tell is NaN.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmrSnap {
    /// Its class, for smr_class_name.
    pub class_index: u32,
    /// 0 to 1.
    pub score: f32,
    /// Corners x1, y1, x2, y2 in pixels of the frame.
    pub bbox: [f32; 4],
    /// Centre on the gel, from the gel's middle, x right, y down; millimetres.
    pub center_mm: [f32; 2],
    /// Standard deviation of that.
    pub center_std_mm: [f32; 2],
    /// Direction in degrees, 0 to the right, 90 down; NaN for a class without.
    pub yaw_deg: f32,
    /// Standard deviation of that.
    pub yaw_std_deg: f32,
    /// Probability that the frame's edge does not cut it.
    pub whole: f32,
}

/// What a frame shows. Free it by smr_detections_free.
#[repr(C)]
#[derive(Debug)]
pub struct SmrDetections {
    /// The snaps, best first; null where there are none.
    pub snaps: *mut SmrSnap,
    /// How many.
    pub count: usize,
    /// Millimetres of gel for a pixel of the frame.
    pub mm_per_pixel: f32,
    /// How that is known.
    pub scale_from: SmrOrigin,
    /// Whether something touches the gel.
    pub contact: SmrContact,
    /// Time from frame to detections, in milliseconds.
    pub wall_ms: f64,
}

/// A detector.
pub struct SmrDetector {
    detector: GpuDetector,
    classes: Vec<CString>,
    device: CString,
}

/// What a call failed of.
struct Failure(SmrStatus, String);

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::Param { .. } => SmrStatus::Argument,
            Error::Weights { .. } | Error::NoWeights { .. } | Error::File { .. } => SmrStatus::File,
            Error::Sensor { .. } | Error::Scale { .. } | Error::Picture { .. } => SmrStatus::Frame,
            Error::Timeout { .. } => SmrStatus::Timeout,
            Error::NoAdapter { .. }
            | Error::Device { .. }
            | Error::DeviceLost(_)
            | Error::Driver { .. } => SmrStatus::Device,
            _ => SmrStatus::Internal,
        };
        Self(status, error.to_string())
    }
}

impl Failure {
    fn argument(message: impl Into<String>) -> Self {
        Self(SmrStatus::Argument, message.into())
    }
}

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// A C string of this text up to its first NUL.
fn c_string(text: &str) -> CString {
    let end = text.find('\0').unwrap_or(text.len());
    CString::new(&text[..end]).unwrap_or_default()
}

/// Runs what a function does; keeps what went wrong for [`smr_last_error`].
fn guarded(run: impl FnOnce() -> Result<(), Failure>) -> SmrStatus {
    // What a panic leaves half done is either dropped with it or behind the detector's own locks.
    let result = catch_unwind(AssertUnwindSafe(run))
        .unwrap_or_else(|_| Err(Failure(SmrStatus::Internal, "a panic: please report it".into())));
    match result {
        Ok(()) => SmrStatus::Ok,
        Err(Failure(status, message)) => {
            LAST_ERROR.with(|last| *last.borrow_mut() = c_string(&message));
            status
        }
    }
}

/// # Safety
/// `text` is null or a NUL-terminated string.
unsafe fn text<'a>(name: &str, text: *const c_char) -> Result<Option<&'a str>, Failure> {
    if text.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller's promise.
    let text = unsafe { CStr::from_ptr(text) };
    let text = text.to_str();
    text.map(Some).map_err(|_| Failure::argument(format!("{name}: expected UTF-8, got other bytes")))
}

fn null(name: &str) -> Failure {
    Failure::argument(format!("{name}: expected a pointer, got null"))
}

/// Options that are what the program does unasked, but with the small network, which is in the library: any device,
/// no sensor.
#[unsafe(no_mangle)]
pub extern "C" fn smr_options_default() -> SmrOptions {
    SmrOptions {
        abi: SMR_ABI,
        weights: c"small".as_ptr(),
        device: c"auto".as_ptr(),
        sensor: ptr::null(),
        mm_per_pixel: 0.0,
        score: 0.5,
        max_detections: 100,
        exact: false,
    }
}

/// Opens a detector, which takes up to some seconds, and writes it to `detector`; null if it fails.
///
/// # Safety
/// `options` points to options whose texts are null or NUL-terminated; `detector` to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn smr_detector_open(
    options: *const SmrOptions,
    detector: *mut *mut SmrDetector,
) -> SmrStatus {
    guarded(|| {
        // SAFETY: the caller's promise, with null for none.
        let out = unsafe { detector.as_mut() }.ok_or_else(|| null("detector"))?;
        *out = ptr::null_mut();
        // SAFETY: the same.
        let options = unsafe { options.as_ref() }.ok_or_else(|| null("options"))?;
        if options.abi != SMR_ABI {
            let got = options.abi;
            return Err(Failure::argument(format!("options.abi: expected {SMR_ABI}, got {got}")));
        }
        // SAFETY: the caller's promise on the options' texts.
        let [weights, device, sensor] = unsafe {
            [
                text("options.weights", options.weights)?,
                text("options.device", options.device)?,
                text("options.sensor", options.sensor)?,
            ]
        };
        let sensor = match sensor {
            None => None,
            Some(name) => Some(match Sensor::named(name) {
                Some(known) => known,
                None => {
                    Sensor::open(Path::new(name)).map_err(|e| Failure(SmrStatus::File, e.to_string()))?
                }
            }),
        };
        let opened = GpuDetector::new(Config {
            device: device.unwrap_or("auto").parse()?,
            sensor,
            mm_per_pixel: (options.mm_per_pixel != 0.0).then_some(options.mm_per_pixel),
            score: options.score,
            max_detections: options.max_detections as usize,
            savings: if options.exact { Savings::NONE } else { Savings::default() },
            ..Config::find(weights.unwrap_or("small"))?
        })?;
        let classes = opened.model().classes.iter().map(|name| c_string(name)).collect();
        let device = c_string(&opened.adapter());
        *out = Box::into_raw(Box::new(SmrDetector { detector: opened, classes, device }));
        Ok(())
    })
}

/// Frees a detector; null is nothing.
///
/// # Safety
/// `detector` is null or came from smr_detector_open, was not freed, and no thread uses it any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn smr_detector_free(detector: *mut SmrDetector) {
    if !detector.is_null() {
        guarded(|| {
            // SAFETY: the caller's promise.
            drop(unsafe { Box::from_raw(detector) });
            Ok(())
        });
    }
}

/// Finds the snaps in a frame and writes them to `detections`; none if it fails.
///
/// # Safety
/// `detector` came from smr_detector_open; `frame` points to a frame whose `data` has `size` bytes;
/// `detections` to what may be written over.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn smr_detect(
    detector: *const SmrDetector,
    frame: *const SmrFrame,
    detections: *mut SmrDetections,
) -> SmrStatus {
    guarded(|| {
        if detections.is_null() {
            return Err(null("detections"));
        }
        let nothing = SmrDetections {
            snaps: ptr::null_mut(),
            count: 0,
            mm_per_pixel: 0.0,
            scale_from: SmrOrigin::Assumed,
            contact: SmrContact::Unknown,
            wall_ms: 0.0,
        };
        // SAFETY: it is not null, and the caller's promise for the rest; what it holds may be anything.
        unsafe { detections.write(nothing) };
        // SAFETY: the caller's promise, with null for none.
        let detector = unsafe { detector.as_ref() }.ok_or_else(|| null("detector"))?;
        // SAFETY: the same.
        let frame = unsafe { frame.as_ref() }.ok_or_else(|| null("frame"))?;
        if frame.data.is_null() {
            return Err(null("frame.data"));
        }
        let format = FORMATS.get(frame.format as usize).copied().ok_or_else(|| {
            let (last, got) = (FORMATS.len() - 1, frame.format);
            Failure::argument(format!("frame.format: expected 0 to {last}, got {got}"))
        })?;
        if frame.size > isize::MAX as usize {
            return Err(Failure::argument(format!("frame.size: expected at most {}, got {}", isize::MAX, frame.size)));
        }
        // SAFETY: not null, no longer than memory may be, and the caller's promise on its bytes.
        let data = unsafe { slice::from_raw_parts(frame.data, frame.size) };
        let mut picture = Frame::new(data, frame.width, frame.height, format);
        if frame.stride != 0 {
            picture = picture.stride(frame.stride);
        }
        let found = detector.detector.detect(picture).map_err(|error| match Failure::from(error) {
            // Of a frame's numbers.
            Failure(SmrStatus::Argument, message) => Failure(SmrStatus::Frame, message),
            other => other,
        })?;
        // SAFETY: as above.
        unsafe { detections.write(given(&found)) };
        Ok(())
    })
}

fn given(found: &Detections) -> SmrDetections {
    let snaps: Box<[SmrSnap]> = found.iter().map(snap).collect();
    let count = snaps.len();
    let snaps = if count == 0 { ptr::null_mut() } else { Box::into_raw(snaps).cast() };
    SmrDetections {
        snaps,
        count,
        mm_per_pixel: found.scale.mm_per_pixel,
        scale_from: match found.scale.from {
            Origin::Assumed => SmrOrigin::Assumed,
            Origin::Sensor => SmrOrigin::Sensor,
            Origin::Stated | Origin::Label => SmrOrigin::Stated,
        },
        contact: match found.contact {
            None => SmrContact::Unknown,
            Some(false) => SmrContact::None,
            Some(true) => SmrContact::Some,
        },
        wall_ms: found.wall.as_secs_f64() * 1e3,
    }
}

fn snap(found: &Detection) -> SmrSnap {
    SmrSnap {
        class_index: found.class_index as u32,
        score: found.score,
        bbox: found.bbox,
        center_mm: found.center_mm,
        center_std_mm: found.center_std_mm.unwrap_or([f32::NAN; 2]),
        yaw_deg: found.yaw_deg.unwrap_or(f32::NAN),
        yaw_std_deg: found.yaw_std_deg.unwrap_or(f32::NAN),
        whole: found.whole.unwrap_or(f32::NAN),
    }
}

/// Frees what smr_detect wrote, and leaves none there; null is nothing.
///
/// # Safety
/// `detections` is null or points to what smr_detect wrote.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn smr_detections_free(detections: *mut SmrDetections) {
    // SAFETY: the caller's promise, with null for none.
    let Some(detections) = (unsafe { detections.as_mut() }) else { return };
    if !detections.snaps.is_null() {
        let snaps = ptr::slice_from_raw_parts_mut(detections.snaps, detections.count);
        // SAFETY: `given` made it from a box of so many.
        drop(unsafe { Box::from_raw(snaps) });
    }
    detections.snaps = ptr::null_mut();
    detections.count = 0;
}

/// How many classes the weights know; 0 for null.
///
/// # Safety
/// `detector` is null or came from smr_detector_open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn smr_class_count(detector: *const SmrDetector) -> u32 {
    // SAFETY: the caller's promise.
    unsafe { detector.as_ref() }.map_or(0, |detector| detector.classes.len() as u32)
}

/// A class's name, which lives as long as the detector; null if there is none of this index.
///
/// # Safety
/// `detector` is null or came from smr_detector_open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn smr_class_name(
    detector: *const SmrDetector,
    class_index: u32,
) -> *const c_char {
    // SAFETY: the caller's promise.
    let detector = unsafe { detector.as_ref() };
    let name = detector.and_then(|detector| detector.classes.get(class_index as usize));
    name.map_or(ptr::null(), |name| name.as_ptr())
}

/// What the network runs on, which lives as long as the detector; null for null.
///
/// # Safety
/// `detector` is null or came from smr_detector_open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn smr_device_name(detector: *const SmrDetector) -> *const c_char {
    // SAFETY: the caller's promise.
    unsafe { detector.as_ref() }.map_or(ptr::null(), |detector| detector.device.as_ptr())
}

/// What the last call on this thread that failed says; empty if none did.
#[unsafe(no_mangle)]
pub extern "C" fn smr_last_error() -> *const c_char {
    LAST_ERROR.with(|last| last.borrow().as_ptr())
}

/// This library's version.
#[unsafe(no_mangle)]
pub extern "C" fn smr_version() -> *const c_char {
    const VERSION: &CStr = match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
        Ok(version) => version,
        Err(_) => panic!("a version holds no NUL"),
    };
    VERSION.as_ptr()
}
