//! What stands in a browser for the threads of `poller` and `clock`: it tells by itself when a device is done
//! or lost, and has timers.

/// Stands for `poller.rs`.
pub(super) mod poller {
    use std::sync::Mutex;
    use std::time::Duration;

    use crate::engine::gpu::landing::Landing;
    use crate::engine::gpu::loss::Loss;
    use crate::error::Result;

    /// Nothing: the browser polls its devices.
    pub fn poll(_: &wgpu::Device, _: wgpu::PollType, _: &Loss) -> Result<(), wgpu::PollError> {
        Ok(())
    }

    /// Nothing: a page may not wait, and the browser limits the uploads that do.
    pub fn wait(_: &wgpu::Device, _: &wgpu::Queue, _: &Loss, _: &Mutex<()>, _: Duration) {}

    /// Nothing: whoever maps a buffer is told, also where the device is lost.
    #[derive(Debug)]
    pub struct Poller;

    impl Poller {
        pub fn new(_: &wgpu::Device, _: &Loss) -> Result<Self> {
            Ok(Self)
        }

        pub fn follow(&self, _: wgpu::SubmissionIndex, _: Landing) {}
    }
}

/// Stands for `clock.rs`.
pub(super) mod clock {
    use std::task::Waker;

    use wasm_bindgen::prelude::*;
    use web_time::Instant;

    #[wasm_bindgen]
    extern "C" {
        #[wasm_bindgen(js_name = setTimeout)]
        fn set_timeout(handler: &JsValue, milliseconds: f64) -> JsValue;
        #[wasm_bindgen(js_name = clearTimeout)]
        fn clear_timeout(timer: &JsValue);
    }

    /// The browser's timers, of a page as of a worker.
    #[derive(Debug, Default)]
    pub struct Clock;

    /// A time at which somebody is woken, unless this is dropped before.
    #[derive(Debug)]
    pub struct Alarm {
        timer: JsValue,
        /// What the timer calls.
        _handler: Closure<dyn FnMut()>,
    }

    // SAFETY: without the target feature `atomics` there is one thread, which wgpu's feature
    // `fragile-send-sync-non-atomic-wasm` holds this crate to.
    unsafe impl Send for Alarm {}
    // SAFETY: as above.
    unsafe impl Sync for Alarm {}

    impl Clock {
        /// Wakes `waker` at `time`.
        pub fn wake_at(&self, time: Instant, waker: Waker) -> Alarm {
            let handler = Closure::new(move || waker.wake_by_ref());
            // A timer that is early would wake for nothing.
            let left = time.saturating_duration_since(Instant::now()).as_secs_f64() * 1e3;
            let timer = set_timeout(handler.as_ref(), left.ceil());
            Alarm { timer, _handler: handler }
        }
    }

    impl Drop for Alarm {
        fn drop(&mut self) {
            clear_timeout(&self.timer);
        }
    }
}
