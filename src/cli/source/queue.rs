//! The way from the thread that reads frames to the one that looks at them: one frame waits at most.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Most messages that wait.
const MESSAGES: usize = 64;

/// One frame, and messages before and behind it.
pub(super) enum Item<F, M> {
    Frame(F),
    Message(M),
}

pub(super) struct Queue<F, M> {
    state: Mutex<State<F, M>>,
    changed: Condvar,
    /// A new frame takes the place of one that waits.
    latest: bool,
}

struct State<F, M> {
    items: VecDeque<Item<F, M>>,
    dropped: u64,
    /// Nothing more comes.
    has_ended: bool,
    /// Nothing more is wanted.
    is_closed: bool,
}

impl<F, M> State<F, M> {
    fn waiting_frame(&self) -> Option<usize> {
        self.items.iter().position(|item| matches!(item, Item::Frame(_)))
    }
}

impl<F, M> Queue<F, M> {
    pub fn new(latest: bool) -> Self {
        let items = VecDeque::new();
        let state = State { items, dropped: 0, has_ended: false, is_closed: false };
        Self { state: Mutex::new(state), changed: Condvar::new(), latest }
    }

    fn lock(&self) -> MutexGuard<'_, State<F, M>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait_while(
        &self,
        condition: impl FnMut(&mut State<F, M>) -> bool,
    ) -> MutexGuard<'_, State<F, M>> {
        let waited = self.changed.wait_while(self.lock(), condition);
        waited.unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until the next frame may be read; whether it is wanted.
    pub fn has_room(&self) -> bool {
        let state = self.wait_while(|state| {
            let is_full = !self.latest && state.waiting_frame().is_some();
            !state.is_closed && (is_full || state.items.len() >= MESSAGES)
        });
        !state.is_closed
    }

    /// Adds what was read.
    pub fn push(&self, item: Item<F, M>) {
        let mut state = self.lock();
        if self.latest
            && let (Item::Frame(_), Some(at)) = (&item, state.waiting_frame())
        {
            state.items.remove(at);
            state.dropped += 1;
        }
        state.items.push_back(item);
        self.changed.notify_all();
    }

    /// The next that was read; `None` at the end, or if nothing more is wanted.
    pub fn pop(&self) -> Option<Item<F, M>> {
        let mut state = self.wait_while(|s| s.items.is_empty() && !s.has_ended && !s.is_closed);
        let item = if state.is_closed { None } else { state.items.pop_front() };
        self.changed.notify_all();
        item
    }

    /// Nothing more comes.
    pub fn end(&self) {
        self.lock().has_ended = true;
        self.changed.notify_all();
    }

    /// Nothing more is wanted.
    pub fn close(&self) {
        self.lock().is_closed = true;
        self.changed.notify_all();
    }

    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn popped(queue: &Queue<u32, char>) -> Vec<String> {
        let items = std::iter::from_fn(|| queue.pop());
        items
            .map(|item| match item {
                Item::Frame(frame) => frame.to_string(),
                Item::Message(message) => message.to_string(),
            })
            .collect()
    }

    #[test]
    fn frames_that_wait_are_dropped_but_no_message() {
        let queue = Queue::new(true);
        for frame in 0..4 {
            assert!(queue.has_room());
            queue.push(Item::Frame(frame));
            queue.push(Item::Message(char::from(b'a' + frame as u8)));
        }
        queue.end();
        assert_eq!((popped(&queue).join(" "), queue.dropped()), ("a b c 3 d".into(), 3));
    }

    #[test]
    fn one_frame_waits_and_none_is_lost() {
        let queue = Queue::<u32, char>::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for frame in 0..100 {
                    assert!(queue.has_room());
                    queue.push(Item::Frame(frame));
                    assert!(queue.lock().items.len() <= 1);
                }
                queue.end();
            });
            let want: Vec<String> = (0..100).map(|frame| frame.to_string()).collect();
            assert_eq!(popped(&queue), want);
        });
        assert_eq!(queue.dropped(), 0);
        // What is closed takes and gives nothing, whoever waits.
        let queue = Queue::<u32, char>::new(false);
        queue.push(Item::Frame(1));
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| queue.has_room());
            queue.close();
            assert!(!waiting.join().expect("no panic"));
        });
        assert!(queue.pop().is_none());
    }
}
