//! Pictures that Python gives, as frames of the library.

use std::path::PathBuf;
use std::slice;

use pyo3::buffer::PyBuffer;
use pyo3::prelude::*;
use smr_gpu::image::DynamicImage;
use smr_gpu::{Error, Frame, Gel, PixelFormat, Rect, Result, Scale, picture};

use crate::errors::raised;

/// A picture as the Python part hands it over: a file, or an array of uint8 with the name of its pixels' format.
#[derive(FromPyObject)]
pub enum Given<'py> {
    File(PathBuf),
    Array((Bound<'py, PyAny>, String)),
}

/// The part of a picture that is gel: `all`, or x, y, width and height in pixels.
#[derive(FromPyObject)]
pub enum Part {
    Name(String),
    Rect([u32; 4]),
}

/// What is said of pictures besides their pixels.
#[derive(Default, FromPyObject)]
#[pyo3(from_item_all)]
pub struct Said {
    gel: Option<Part>,
    mm_per_pixel: Option<f32>,
    crop: Option<[u32; 4]>,
}

/// A picture with what is said of it.
pub struct Picture {
    pixels: Pixels,
    gel: Option<Gel>,
    scale: Option<Scale>,
    crop: Option<Rect>,
}

enum Pixels {
    File(DynamicImage),
    Array { bytes: Bytes, size: [u32; 2], stride: usize, format: PixelFormat },
}

enum Bytes {
    /// So many of an array, which cannot be freed or resized while this is there.
    Borrowed(PyBuffer<u8>, usize),
    Copied(Vec<u8>),
}

impl Part {
    /// # Errors
    /// As [`Gel::from_str`](std::str::FromStr::from_str).
    pub fn gel(&self) -> Result<Gel> {
        match self {
            Self::Name(name) => name.parse(),
            Self::Rect(part) => Ok(Gel::Part(rect(*part))),
        }
    }
}

impl Picture {
    /// Reads a file, or takes an array's own bytes where its pixels lie as in a picture, else a copy.
    ///
    /// # Errors
    /// The library's, as exceptions.
    pub fn new(py: Python<'_>, given: Given<'_>, said: &Said) -> PyResult<Self> {
        let gel = said.gel.as_ref().map(Part::gel).transpose().map_err(|e| raised(py, e))?;
        let pixels = match given {
            Given::File(path) => {
                let read = py.detach(|| picture::read(&path));
                let about = |e: picture::Error| Error::Picture {
                    file: path.display().to_string(),
                    message: e.to_string(),
                };
                Pixels::File(read.map_err(|e| raised(py, about(e)))?)
            }
            Given::Array((array, format)) => {
                let format = format.parse().map_err(|e| raised(py, e))?;
                of_array(&array, format)?
            }
        };
        let (scale, crop) = (said.mm_per_pixel.map(Scale::stated), said.crop.map(rect));
        Ok(Self { pixels, gel, scale, crop })
    }

    /// The picture as the library takes it.
    pub fn frame(&self) -> Frame<'_> {
        let mut frame = match &self.pixels {
            Pixels::File(picture) => Frame::from(picture),
            Pixels::Array { bytes, size: [width, height], stride, format } => {
                Frame::new(bytes.as_slice(), *width, *height, *format).stride(*stride)
            }
        };
        (frame.gel, frame.scale, frame.crop) = (self.gel, self.scale, self.crop);
        frame
    }
}

impl Bytes {
    fn as_slice(&self) -> &[u8] {
        match self {
            // SAFETY: the buffer's memory stays while it is held, and `of_array` has seen that so many bytes
            // from its start are the array's. Whoever writes to the array meanwhile changes pixels that are
            // read, as with NumPy's own functions that release the interpreter's lock; nothing but pixels is
            // read from them.
            Self::Borrowed(buffer, length) => unsafe {
                slice::from_raw_parts(buffer.buf_ptr().cast(), *length)
            },
            Self::Copied(bytes) => bytes,
        }
    }
}

fn rect([x, y, width, height]: [u32; 4]) -> Rect {
    Rect { x, y, width, height }
}

/// An array of height × width, or height × width × channels.
fn of_array(array: &Bound<'_, PyAny>, format: PixelFormat) -> PyResult<Pixels> {
    let py = array.py();
    let buffer = PyBuffer::<u8>::get(array)?;
    let (&[height, width] | &[height, width, _]) = buffer.shape() else {
        let expected = "an array of 2 or 3 dimensions";
        return Err(raised(py, Error::param("detect", "picture", expected, buffer.dimensions())));
    };
    let too_long = |_| raised(py, Error::param("detect", "picture", "sides of 32 bits", width));
    let size = [width.try_into().map_err(too_long)?, height.try_into().map_err(too_long)?];
    let each = format.bytes_per_pixel();
    let row = width * each;
    let strides = buffer.strides();
    let follow = |axis: usize, bytes: usize, count: usize| {
        count <= 1 || strides.get(axis).is_none_or(|stride| *stride == bytes as isize)
    };
    // The first row's start is that of the memory where rows go downwards.
    let stride = if height > 1 { strides[0] } else { row as isize };
    let lies = follow(1, each, width) && follow(2, 1, each) && stride >= row as isize;
    if lies && buffer.item_count() > 0 {
        let stride = stride as usize;
        let bytes = Bytes::Borrowed(buffer, (height - 1) * stride + row);
        return Ok(Pixels::Array { bytes, size, stride, format });
    }
    let bytes = Bytes::Copied(buffer.to_vec(py)?);
    Ok(Pixels::Array { bytes, size, stride: row, format })
}
