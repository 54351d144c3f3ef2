/// The bound of a loop, which with HIDDEN_BOUNDS compilers do not see: they would unroll it. See
/// `src/engine/gpu/quirks.rs`. `zero` is 0, which shows at run time alone.
fn bound(n: u32, zero: u32) -> u32 {
#if HIDDEN_BOUNDS
    return n + zero;
#else
    return n;
#endif
}
