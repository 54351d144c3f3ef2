//! The threads that compute a picture together.
//!
//! A picture is a hundred sections of some ten to some hundred microseconds. Waking a thread takes as long as
//! such a section, and where pictures are spaced every section would wake them anew; so threads stay awake
//! between two sections, for [`AWAKE`] at most, and sleep between pictures. A section's work is taken piece by
//! piece by whoever is there, the caller too: a thread that wakes late, or that another program holds up, is
//! waited for with its one piece, never with its share.
//!
//! Of the libraries for this, rayon and paralight let their threads sleep after some microseconds, chili too,
//! forte needs a later compiler, and micropool, which does spin, stands on spin locks, which a
//! thread that is held up keeps, and panics where a thread cannot be had.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError, RwLock, TryLockError};
use std::time::Duration;
use std::{hint, mem, thread};

use web_time::Instant;

use crate::engine::lock::lock;

/// How long a thread without work stays awake: longer than what one thread computes between two sections.
const AWAKE: Duration = Duration::from_micros(500);
/// How long the caller looks for the last thread of a section before it sleeps: long enough for a
/// piece, short enough that a core goes to a thread which another program holds up.
const PATIENCE: Duration = Duration::from_micros(200);

/// A section's work, as each thread does it.
type Job = &'static (dyn Fn() + Sync);

/// Threads beside the caller's, and what they share with it.
struct Cores {
    workers: usize,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    /// Counts the sections: who waits for one looks at it.
    section: AtomicUsize,
    /// The section's work. Threads hold the lock, to read, while they do it.
    job: RwLock<Option<Job>>,
    /// Held by the caller whose section it is.
    owner: Mutex<()>,
    /// What a thread panicked with.
    panic: Mutex<Option<Box<dyn Any + Send>>>,
    /// Threads that sleep, or are about to.
    asleep: AtomicUsize,
    sleep: Mutex<()>,
    wake: Condvar,
    /// Callers that compute a picture.
    callers: AtomicUsize,
}

/// The process's threads.
fn cores() -> &'static Cores {
    static CORES: OnceLock<Cores> = OnceLock::new();
    let named = || thread::Builder::new().name("smr-gpu".to_owned());
    let wanted = || thread::available_parallelism().map_or(1, usize::from);
    CORES.get_or_init(|| Cores::new(wanted(), named))
}

/// Threads that take part in a section, the caller's among them.
#[cfg(feature = "cpu")]
pub(crate) fn threads() -> usize {
    cores().workers + 1
}

/// Says, until it is dropped, that a picture is computed on this thread. Where that is so on as many as there
/// are cores, each computes its own alone, and none waits for another.
#[cfg(feature = "cpu")]
pub(crate) struct Caller(&'static Cores);

#[cfg(feature = "cpu")]
impl Caller {
    pub fn new() -> Self {
        let cores = cores();
        cores.shared.callers.fetch_add(1, Ordering::Relaxed);
        Self(cores)
    }
}

#[cfg(feature = "cpu")]
impl Drop for Caller {
    fn drop(&mut self) {
        self.0.shared.callers.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Does `work` for each of `items`, on all threads. Which of them does what is left to chance, so results
/// must not depend on it.
pub(crate) fn each<T: Send>(items: impl Iterator<Item = T> + Send, work: impl Fn(T) + Sync) {
    cores().each_with(items, || (), |(), item| work(item));
}

/// [`each`] with what each thread makes for itself first.
#[cfg(feature = "cpu")]
pub(crate) fn each_with<T: Send, S>(
    items: impl Iterator<Item = T> + Send,
    make: impl Fn() -> S + Sync,
    work: impl Fn(&mut S, T) + Sync,
) {
    cores().each_with(items, make, work);
}

impl Cores {
    /// As many threads as asked for, the caller's among them, or as can be had.
    fn new(threads: usize, builder: impl Fn() -> thread::Builder) -> Self {
        let shared = Arc::new(Shared::default());
        let spawned = (1..threads).map_while(|_| {
            let shared = shared.clone();
            builder().spawn(move || shared.work()).ok()
        });
        let workers = spawned.count();
        Self { workers, shared }
    }

    fn each_with<T: Send, S>(
        &self,
        items: impl Iterator<Item = T> + Send,
        make: impl Fn() -> S + Sync,
        work: impl Fn(&mut S, T) + Sync,
    ) {
        let short = items.size_hint().1.is_some_and(|most| most < 2);
        let items = Mutex::new(items);
        let job = || {
            let mut own = None;
            loop {
                let Some(item) = lock(&items).next() else { break };
                work(own.get_or_insert_with(&make), item);
            }
        };
        match short {
            true => job(),
            false => self.run(&job),
        }
    }

    /// Runs `job` here and on all other threads, or here alone where those are busy.
    fn run(&self, job: &(dyn Fn() + Sync)) {
        let shared = &*self.shared;
        let alone = self.workers == 0 || shared.callers.load(Ordering::Relaxed) > self.workers;
        let owner = match shared.owner.try_lock() {
            _ if alone => None,
            Ok(owner) => Some(owner),
            Err(TryLockError::Poisoned(owner)) => Some(owner.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        };
        let Some(_owner) = owner else { return job() };
        // SAFETY: only the lifetime is another. The other threads reach the job through `shared.job` alone and
        // hold that lock, to read, as long as they use it. `Section` takes it away, for which it holds the lock
        // to write, when it is dropped: before this function returns or unwinds, and so within the borrow.
        let job: Job = unsafe { mem::transmute::<&(dyn Fn() + Sync), Job>(job) };
        let section = Section::new(shared, job);
        job();
        drop(section);
        if let Some(panic) = lock(&shared.panic).take() {
            resume_unwind(panic);
        }
    }
}

/// A section that threads may enter. When it is dropped, all have left it.
struct Section<'a>(&'a Shared);

impl<'a> Section<'a> {
    fn new(shared: &'a Shared, job: Job) -> Self {
        *lock(&shared.panic) = None;
        *shared.job.write().unwrap_or_else(PoisonError::into_inner) = Some(job);
        let section = Self(shared);
        // Before who sleeps is looked at, as a thread is among those before it looks at this.
        shared.section.fetch_add(1, Ordering::SeqCst);
        if shared.asleep.load(Ordering::SeqCst) > 0 {
            drop(lock(&shared.sleep));
            shared.wake.notify_all();
        }
        section
    }
}

impl Drop for Section<'_> {
    fn drop(&mut self) {
        let start = Instant::now();
        while let Err(TryLockError::WouldBlock) = self.0.job.try_write()
            && start.elapsed() < PATIENCE
        {
            pause();
        }
        *self.0.job.write().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

impl Shared {
    /// What a thread does all its life.
    fn work(&self) {
        let mut seen = 0;
        loop {
            seen = self.next(seen);
            // Who finds it locked to write is too late, or will see another count.
            let job = match self.job.try_read() {
                Ok(job) => job,
                Err(TryLockError::Poisoned(job)) => job.into_inner(),
                Err(TryLockError::WouldBlock) => continue,
            };
            if let Some(job) = *job
                && let Err(panic) = catch_unwind(AssertUnwindSafe(job))
            {
                *lock(&self.panic) = Some(panic);
            }
        }
    }

    /// Waits for a section after number `seen`: awake, then asleep.
    fn next(&self, seen: usize) -> usize {
        let start = Instant::now();
        while start.elapsed() < AWAKE {
            match self.section.load(Ordering::Acquire) {
                section if section != seen => return section,
                _ => pause(),
            }
        }
        let mut sleep = lock(&self.sleep);
        self.asleep.fetch_add(1, Ordering::SeqCst);
        let section = loop {
            match self.section.load(Ordering::SeqCst) {
                section if section != seen => break section,
                _ => sleep = self.wake.wait(sleep).unwrap_or_else(PoisonError::into_inner),
            }
        };
        self.asleep.fetch_sub(1, Ordering::SeqCst);
        section
    }
}

/// Some hundred nanoseconds.
fn pause() {
    (0..8).for_each(|_| hint::spin_loop());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_item_is_done_once() {
        for threads in [1, 2, 5] {
            let cores = Cores::new(threads, thread::Builder::new);
            assert_eq!(cores.workers + 1, threads);
            for items in [0, 1, 2, 3, 100] {
                // Long enough now and then that threads fall asleep.
                if items == 3 {
                    thread::sleep(2 * AWAKE);
                }
                let mut done = vec![0; items];
                cores.each_with(done.iter_mut().enumerate(), || 1, |one, (i, x)| *x += i + *one);
                assert!(done.into_iter().eq(1..=items), "{items} on {threads}");
            }
        }
    }

    /// A stack that no memory holds stands for threads that the system refuses.
    #[test]
    fn without_threads_the_caller_does_all() {
        let cores = Cores::new(4, || thread::Builder::new().stack_size(1 << 60));
        assert_eq!(cores.workers, 0);
        let mut done = [false; 9];
        cores.each_with(done.iter_mut(), || (), |(), done| *done = true);
        assert_eq!(done, [true; 9]);
    }

    #[test]
    fn several_callers_and_sections_in_sections() {
        let cores = Cores::new(3, thread::Builder::new);
        thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..200 {
                        let mut sums = [0; 8];
                        let inner = |sum: &mut usize| {
                            let mut parts = [1; 5];
                            cores.each_with(parts.iter_mut(), || (), |(), part| *part *= 2);
                            *sum = parts.iter().sum();
                        };
                        cores.each_with(sums.iter_mut(), || (), |(), sum| inner(sum));
                        assert_eq!(sums, [10; 8]);
                    }
                });
            }
        });
    }

    #[test]
    fn a_panic_comes_to_the_caller_and_threads_go_on() {
        let cores = Cores::new(3, thread::Builder::new);
        for bad in 0..20 {
            let all = || cores.each_with(0..20, || (), |(), i| assert!(i != bad, "item {i}"));
            let panic = catch_unwind(AssertUnwindSafe(all)).expect_err("a panic");
            assert_eq!(panic.downcast_ref::<String>(), Some(&format!("item {bad}")));
        }
        let done = AtomicUsize::new(0);
        cores.each_with(1..=20, || (), |(), i| _ = done.fetch_add(i, Ordering::Relaxed));
        assert_eq!(done.into_inner(), 210);
    }
}
