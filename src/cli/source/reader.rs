//! Reads frames on a thread of its own, while another looks at those before.

use std::io::Read;
use std::panic::resume_unwind;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Instant;

use smr_gpu::files::Shard;
use smr_gpu::picture::{self, Pictures};

use super::frame::{FrameId, Pixels, RawFormat, Shot};
use super::queue::{Item, Queue};
use super::video::Video;
use super::{Source, named};

/// What is read of the sources.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Wanted {
    /// Frames whose index is a multiple of this.
    pub every: u64,
    /// Of those the ones that this run takes; `None` for all.
    pub shard: Option<Shard>,
    /// A frame that waits makes room for the next.
    pub latest: bool,
    /// Stdin brings frames of this format.
    pub raw: Option<RawFormat>,
}

/// What the reading thread has to tell.
pub(in super::super) enum Message {
    /// A frame, or the rest of a source, that could not be read.
    Failed(String),
    Remark(String),
}

/// What comes next.
pub(in super::super) enum Event {
    Frame(Box<Shot>),
    Message(Message),
}

type Frames = Queue<Box<Shot>, Message>;

/// Frames of all sources in their order.
pub(in super::super) struct Reader {
    queue: Arc<Frames>,
    /// The child that is read from.
    video: Arc<Mutex<Option<Video>>>,
    thread: Option<JoinHandle<()>>,
}

/// Ends the reading, from whatever thread.
#[derive(Clone)]
pub(in super::super) struct Stop(Arc<Frames>);

impl Stop {
    pub fn stop(&self) {
        self.0.close();
    }
}

impl Reader {
    /// Begins to read.
    pub fn start(sources: Vec<Source>, wanted: Wanted) -> Self {
        let queue = Arc::new(Queue::new(wanted.latest));
        let video = Arc::default();
        let name = Arc::default();
        let mut feed = Feed { queue: queue.clone(), video, wanted, name, number: 0, files: 0 };
        let video = feed.video.clone();
        let thread = thread::spawn(move || {
            for (source, name) in named(sources) {
                if !feed.queue.has_room() {
                    break;
                }
                feed.name = name.into();
                feed.read(&Arc::new(source));
            }
        });
        Self { queue, video, thread: Some(thread) }
    }

    pub fn stopper(&self) -> Stop {
        Stop(self.queue.clone())
    }

    /// Frames that made room for later ones.
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }
}

impl Iterator for Reader {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        match self.queue.pop() {
            Some(Item::Frame(shot)) => Some(Event::Frame(shot)),
            Some(Item::Message(message)) => Some(Event::Message(message)),
            None => {
                // One that was stopped may wait for its source for ever.
                let ended = self.thread.take_if(|thread| thread.is_finished());
                if let Some(Err(panic)) = ended.map(JoinHandle::join) {
                    resume_unwind(panic);
                }
                None
            }
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.queue.close();
        drop(self.video.lock().unwrap_or_else(PoisonError::into_inner).take());
    }
}

/// The reading thread's end.
struct Feed {
    queue: Arc<Frames>,
    video: Arc<Mutex<Option<Video>>>,
    wanted: Wanted,
    /// What files that are made of the source are called.
    name: Arc<str>,
    /// Frames until now, and picture files among them.
    number: u64,
    files: u64,
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.queue.end();
    }
}

impl Feed {
    fn read(&mut self, source: &Arc<Source>) {
        match (&**source, self.wanted.raw) {
            (Source::File(_), _) => self.file(source),
            (Source::Stdin, None) => {
                self.pictures(source, std::io::stdin());
            }
            (Source::Stdin, Some(raw)) => self.raw(source, raw, std::io::stdin().lock()),
            (Source::Video(_) | Source::Live(_), _) => self.video(source),
        }
    }

    fn failed(&self, what: impl std::fmt::Display, why: impl std::fmt::Display) {
        self.queue.push(Item::Message(Message::Failed(format!("{what}: {why}"))));
    }

    fn id(&self, source: &Arc<Source>, index: u64) -> FrameId {
        let (source, name) = (source.clone(), self.name.clone());
        FrameId { source, name, index, number: self.number, time_s: None }
    }

    /// Counts a frame; passes it on if it is wanted.
    fn frame(
        &mut self,
        id: FrameId,
        begun: Instant,
        pixels: impl FnOnce() -> Result<Pixels, String>,
    ) {
        self.number += 1;
        let Wanted { every, shard, .. } = self.wanted;
        let is_other = |shard: Shard| !shard.takes(id.index / every);
        if !id.index.is_multiple_of(every) || shard.is_some_and(is_other) {
            return;
        }
        match pixels() {
            Ok(pixels) => {
                let shot = Shot { id, pixels, read: begun.elapsed() };
                self.queue.push(Item::Frame(Box::new(shot)));
            }
            Err(why) => self.failed(id, why),
        }
    }

    fn file(&mut self, source: &Arc<Source>) {
        let id = self.id(source, self.files);
        self.files += 1;
        self.frame(id, Instant::now(), || source.picture().map(Pixels::Picture));
    }

    /// Pictures one after the other; returns how many there were.
    fn pictures(&mut self, source: &Arc<Source>, stream: impl Read) -> u64 {
        let (mut pictures, mut index) = (Pictures::new(stream), 0);
        while self.queue.has_room() {
            let begun = Instant::now();
            match pictures.next() {
                None => break,
                // ffmpeg says why there is none.
                Some(Ok(bytes)) if bytes.is_empty() && **source != Source::Stdin => break,
                Some(Err(e)) => self.failed(self.id(source, index), e),
                Some(Ok(bytes)) => {
                    let mut id = self.id(source, index);
                    id.time_s = self.time_s(index);
                    index += 1;
                    let decoded = || picture::decode(&bytes).map_err(|e| e.to_string());
                    self.frame(id, begun, || decoded().map(Pixels::Picture));
                }
            }
        }
        index
    }

    fn time_s(&self, index: u64) -> Option<f64> {
        self.child().as_mut()?.ffmpeg.time_s(index)
    }

    fn raw(&mut self, source: &Arc<Source>, raw: RawFormat, mut stream: impl Read) {
        let expected = raw.bytes();
        let mut index = 0;
        while self.queue.has_room() {
            let begun = Instant::now();
            let id = self.id(source, index);
            let mut bytes = Vec::with_capacity(expected as usize);
            let read = stream.by_ref().take(expected).read_to_end(&mut bytes);
            let got = bytes.len() as u64;
            match read {
                Err(e) => return self.failed(id, e),
                Ok(0) if index > 0 => return,
                Ok(_) if got < expected => {
                    return self.failed(
                        id,
                        format!("expected {expected} bytes of a raw frame, got {got}"),
                    );
                }
                Ok(_) => {}
            }
            index += 1;
            self.frame(id, begun, || Ok(Pixels::Raw(bytes, raw)));
        }
    }

    fn video(&mut self, source: &Arc<Source>) {
        let mut video = match Video::open(source) {
            Ok(video) => video,
            Err(why) => return self.failed(source, why),
        };
        let command = format!("{source}: {}", video.command);
        self.queue.push(Item::Message(Message::Remark(command)));
        let Some(frames) = video.frames.take() else { return };
        *self.child() = Some(video);
        let count = self.pictures(source, frames);
        let Some(video) = self.child().take() else { return };
        if !self.queue.has_room() {
            // Whoever stops it early is not told that it was.
            return;
        }
        let secret = match &**source {
            Source::Live(name) => name.to_str().map(str::to_owned),
            _ => None,
        };
        let shown = |said: String| match &secret {
            Some(secret) => said.replace(secret, &source.to_string()),
            None => said,
        };
        let at = self.id(source, count);
        match video.ffmpeg.finish() {
            Err(why) => {
                self.failed(at, format!("expected a frame or the end, got none: {}", shown(why)))
            }
            Ok(said) if count == 0 => {
                let said = if said.is_empty() {
                    String::new()
                } else {
                    format!("; ffmpeg: {}", said.join("; "))
                };
                self.failed(source, format!("expected frames, got none{}", shown(said)));
            }
            Ok(said) if !said.is_empty() => {
                let remark = format!("{source}: ffmpeg: {}", shown(said.join("; ")));
                self.queue.push(Item::Message(Message::Remark(remark)));
            }
            Ok(_) => {}
        }
    }

    fn child(&self) -> std::sync::MutexGuard<'_, Option<Video>> {
        self.video.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
