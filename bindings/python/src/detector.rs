//! The detector, streams and cameras. What computes does so without the interpreter's lock.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyIterator};
use smr_gpu::{CachingDetector, Detections, Frame, GpuDetector, Result};

use crate::errors::raised;
use crate::found::fields;
use crate::options::Options;
use crate::picture::{Given, Picture, Said};
use crate::process::{self, Owned};

/// The library's `GpuDetector`.
#[pyclass(frozen, module = "smr_gpu._native")]
pub struct Detector {
    detector: Owned<Arc<GpuDetector>>,
}

#[pymethods]
impl Detector {
    #[new]
    fn new(py: Python<'_>, options: Options<'_>) -> PyResult<Self> {
        process::check(py)?;
        let config = options.config(py)?;
        let built = py.detach(|| GpuDetector::new(config)).map_err(|e| raised(py, e))?;
        Ok(Self { detector: Owned::new(Arc::new(built)) })
    }

    fn __repr__(&self) -> String {
        format!("{:?}", **self.detector)
    }

    #[getter]
    fn classes(&self) -> Vec<String> {
        self.detector.model().classes.clone()
    }

    #[getter]
    fn adapter(&self, py: Python<'_>) -> PyResult<String> {
        process::check(py)?;
        Ok(py.detach(|| self.detector.adapter()))
    }

    #[getter]
    fn remarks(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        process::check(py)?;
        Ok(py.detach(|| self.detector.remarks()))
    }

    /// One picture.
    fn detect<'py>(
        &self,
        py: Python<'py>,
        given: Given<'py>,
        said: Said,
    ) -> PyResult<Bound<'py, PyDict>> {
        process::check(py)?;
        let picture = Picture::new(py, given, &said)?;
        let frame = picture.frame();
        let found = py.detach(|| self.detector.detect(frame));
        self.fields(py, found)
    }

    /// Several pictures that are there, together.
    fn detect_many<'py>(
        &self,
        py: Python<'py>,
        given: Vec<Given<'py>>,
        said: Said,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        process::check(py)?;
        let pictures = given.into_iter().map(|given| Picture::new(py, given, &said));
        let pictures: Vec<Picture> = pictures.collect::<PyResult<_>>()?;
        let frames: Vec<Frame> = pictures.iter().map(Picture::frame).collect();
        let found: Vec<_> = py.detach(|| self.detector.detect_many(frames).collect());
        found.into_iter().map(|found| self.fields(py, found)).collect()
    }

    /// Frames as they come, several in flight.
    fn stream(&self, py: Python<'_>, frames: Py<PyIterator>, said: Said) -> PyResult<Stream> {
        process::check(py)?;
        let failed = Arc::default();
        let frames = Frames { frames, said, failed: Arc::clone(&failed) };
        let detector = Arc::clone(&self.detector);
        let results: Results = Box::new(detector.clone().into_many(frames));
        Ok(Stream {
            detector: Owned::new(detector),
            results: Owned::new(Mutex::new(Some(results))),
            failed,
        })
    }

    /// Frames of one camera, of which few change.
    fn camera(&self, py: Python<'_>) -> PyResult<Camera> {
        process::check(py)?;
        let camera = CachingDetector::new(Arc::clone(&self.detector));
        Ok(Camera { camera: Owned::new(Mutex::new(camera)) })
    }
}

impl Detector {
    fn fields<'py>(
        &self,
        py: Python<'py>,
        found: Result<Detections>,
    ) -> PyResult<Bound<'py, PyDict>> {
        fields(py, &found.map_err(|e| raised(py, e))?, &self.detector)
    }
}

type Results = Box<dyn Iterator<Item = Result<Detections>> + Send>;
/// What an iterable of frames raised.
type Failed = Arc<Mutex<Option<PyErr>>>;

/// Frames of a Python iterator: they end where it raises.
struct Frames {
    frames: Py<PyIterator>,
    said: Said,
    failed: Failed,
}

impl Iterator for Frames {
    type Item = Frame<'static>;

    fn next(&mut self) -> Option<Frame<'static>> {
        Python::attach(|py| {
            let given = self.frames.bind(py).clone().next()?;
            let frame = given.and_then(|given| Picture::new(py, given.extract()?, &self.said));
            match frame {
                Ok(frame) => Some(frame.frame().into_owned()),
                Err(e) => {
                    *lock(&self.failed) = Some(e);
                    None
                }
            }
        })
    }
}

/// What is found in frames, in their order. An error ends it, behind the results of the frames before.
#[pyclass(frozen, module = "smr_gpu._native")]
pub struct Stream {
    detector: Owned<Arc<GpuDetector>>,
    /// `None` once it has ended.
    results: Owned<Mutex<Option<Results>>>,
    failed: Failed,
}

#[pymethods]
impl Stream {
    fn __iter__(this: Py<Self>) -> Py<Self> {
        this
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        process::check(py)?;
        // Another thread may hold the lock while its frames need the interpreter's.
        let found = py.detach(|| {
            let mut results = lock(&self.results);
            let found = results.as_mut().and_then(Iterator::next);
            if !matches!(found, Some(Ok(_))) {
                *results = None;
            }
            found
        });
        match found {
            Some(Ok(found)) => fields(py, &found, &self.detector).map(Some),
            Some(Err(e)) => Err(raised(py, e)),
            None => lock(&self.failed).take().map_or(Ok(None), Err),
        }
    }
}

/// The library's `CachingDetector`.
#[pyclass(frozen, module = "smr_gpu._native")]
pub struct Camera {
    camera: Owned<Mutex<CachingDetector>>,
}

#[pymethods]
impl Camera {
    /// The next frame.
    fn detect<'py>(
        &self,
        py: Python<'py>,
        given: Given<'py>,
        said: Said,
    ) -> PyResult<Bound<'py, PyDict>> {
        process::check(py)?;
        let picture = Picture::new(py, given, &said)?;
        let frame = picture.frame();
        let (found, detector) = py.detach(|| {
            let mut camera = lock(&self.camera);
            (camera.detect(frame), camera.detector().clone())
        });
        fields(py, &found.map_err(|e| raised(py, e))?, &detector)
    }
}

/// Who panicked while holding it left the value whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
