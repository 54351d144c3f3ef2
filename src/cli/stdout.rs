//! Whether there was a stdout when the program began.
//!
//! Rust's start-up opens `/dev/null` in the place of a closed stdout, where all writing succeeds,
//! and nothing tells it later from a `/dev/null` that somebody asked for. So this looks before.

use std::sync::atomic::{AtomicBool, Ordering};

static WAS_CLOSED: AtomicBool = AtomicBool::new(false);

/// Whether stdout was closed when the program began (`>&-`).
pub(super) fn was_closed() -> bool {
    WAS_CLOSED.load(Ordering::Relaxed)
}

#[cfg(unix)]
extern "C" fn check() {
    let flags = rustix::io::fcntl_getfd(rustix::stdio::stdout());
    WAS_CLOSED.store(flags == Err(rustix::io::Errno::BADF), Ordering::Relaxed);
}

// SAFETY: the linker's list of functions to call before `main` holds pointers to functions of this
// type. The function makes one system call and stores a flag: it allocates nothing, cannot panic
// and uses nothing of Rust's runtime, which does not run yet.
#[cfg(unix)]
#[used]
#[cfg_attr(target_vendor = "apple", unsafe(link_section = "__DATA,__mod_init_func"))]
#[cfg_attr(not(target_vendor = "apple"), unsafe(link_section = ".init_array"))]
static BEFORE_MAIN: extern "C" fn() = check;
