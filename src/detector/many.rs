//! Many pictures in their order, several in flight.

use std::collections::VecDeque;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, Wake, Waker};

use crate::detector::{Detections, GpuDetector};
use crate::error::Result;
use crate::frame::Frame;

type Look<'a> = Pin<Box<dyn Future<Output = Result<Detections>> + Send + 'a>>;

/// The results of many pictures, as they are asked for.
pub(super) struct Many<'a, I> {
    detector: &'a GpuDetector,
    frames: I,
    /// Pictures that were begun, the first first.
    begun: VecDeque<Look<'a>>,
    waker: Waker,
}

/// Nobody needs waking: the first picture is waited for, and the others are looked at then.
struct Nobody;

impl Wake for Nobody {
    fn wake(self: Arc<Self>) {}
}

impl<'a, I: Iterator<Item = Frame<'a>>> Many<'a, I> {
    pub fn new(detector: &'a GpuDetector, frames: I) -> Self {
        let waker = Waker::from(Arc::new(Nobody));
        Self { detector, frames, begun: VecDeque::new(), waker }
    }
}

impl<'a, I: Iterator<Item = Frame<'a>>> Iterator for Many<'a, I> {
    type Item = Result<Detections>;

    fn next(&mut self) -> Option<Self::Item> {
        // One more than are in flight, so that its pixels are ready when a place is free.
        while self.begun.len() < self.detector.config.in_flight.max(1) {
            let Some(frame) = self.frames.next() else { break };
            let detector = self.detector;
            let mut look: Look = Box::pin(async move { detector.detect_async(&frame).await });
            // Polled once, it is on its way to the device.
            match look.as_mut().poll(&mut Context::from_waker(&self.waker)) {
                Poll::Ready(result) => self.begun.push_back(Box::pin(std::future::ready(result))),
                Poll::Pending => self.begun.push_back(look),
            }
        }
        let first = self.begun.pop_front()?;
        Some(pollster::block_on(first))
    }
}
