//! What the system tells a running program.

/// Says why, and ends with exit code 1, where the system stops the program because a mapped file has
/// become shorter (SIGBUS); without that it would end without a word.
#[cfg(target_os = "linux")]
pub fn say_when_a_file_is_cut() {
    extern "C" fn cut(_: libc::c_int) {
        const TEXT: &[u8] =
            b"error: a file that was being read was cut short by another program, or \
            its disk failed; run again when it is complete\n";
        // SAFETY: both calls are among those that a signal handler may make; the text is a constant.
        unsafe {
            libc::write(libc::STDERR_FILENO, TEXT.as_ptr().cast(), TEXT.len());
            libc::_exit(1);
        }
    }
    // SAFETY: the handler allocates nothing, takes no lock and does not return.
    unsafe { libc::signal(libc::SIGBUS, cut as *const () as libc::sighandler_t) };
}

/// Elsewhere the system says it.
#[cfg(not(target_os = "linux"))]
pub fn say_when_a_file_is_cut() {}
