//! Many pictures in their order, several in flight.

use std::collections::VecDeque;
use std::future::{Future, poll_fn};
use std::ops::Deref;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};

use crate::detector::{Detections, GpuDetector};
use crate::error::Result;
use crate::sensor::frame::Frame;

type Look<'a> = Pin<Box<dyn Future<Output = Vec<Result<Detections>>> + Send + 'a>>;

/// A batch of pictures that was begun.
enum Begun<'a> {
    Look(Look<'a>),
    Done(Vec<Result<Detections>>),
}

impl Begun<'_> {
    /// Brings it on its way to the device as far as it goes without waiting.
    fn advance(&mut self, context: &mut Context<'_>) {
        if let Self::Look(look) = self
            && let Poll::Ready(results) = look.as_mut().poll(context)
        {
            *self = Self::Done(results);
        }
    }
}

/// The results of many pictures, as they are asked for, by a detector that is borrowed or shared.
pub(crate) struct Many<'a, D, I> {
    detector: D,
    frames: I,
    /// The first first.
    begun: VecDeque<Begun<'a>>,
    /// Results before those of `begun`.
    done: VecDeque<Result<Detections>>,
}

impl<'a, D, I> Many<'a, D, I>
where
    D: Deref<Target = GpuDetector> + Clone + Send + 'a,
    I: Iterator<Item = Frame<'a>>,
{
    pub fn new(detector: D, frames: I) -> Self {
        Self { detector, frames, begun: VecDeque::new(), done: VecDeque::new() }
    }

    /// Begins as many batches as may be in flight.
    fn fill(&mut self) {
        let batch = self.detector.session().batch();
        while self.begun.len() < self.detector.config.in_flight.max(1) {
            let frames: Vec<Frame> = self.frames.by_ref().take(batch).collect();
            if frames.is_empty() {
                break;
            }
            let detector = self.detector.clone();
            let look: Look = Box::pin(async move { detector.detect_batch(&frames).await });
            let mut begun = Begun::Look(look);
            // On its way to the device while the next frames are made.
            begun.advance(&mut Context::from_waker(Waker::noop()));
            self.begun.push_back(begun);
        }
    }

    /// The results of the first batch; the others go on meanwhile.
    fn first(&mut self, context: &mut Context<'_>) -> Poll<Vec<Result<Detections>>> {
        self.begun.iter_mut().for_each(|begun| begun.advance(context));
        match self.begun.pop_front() {
            Some(look @ Begun::Look(_)) => {
                self.begun.push_front(look);
                Poll::Pending
            }
            Some(Begun::Done(results)) => Poll::Ready(results),
            None => Poll::Ready(Vec::new()),
        }
    }
}

impl<'a, D, I> Iterator for Many<'a, D, I>
where
    D: Deref<Target = GpuDetector> + Clone + Send + 'a,
    I: Iterator<Item = Frame<'a>>,
{
    type Item = Result<Detections>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done.is_empty() {
            self.fill();
            self.done = pollster::block_on(poll_fn(|context| self.first(context))).into();
        }
        self.done.pop_front()
    }
}
