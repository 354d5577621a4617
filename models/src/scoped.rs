//! Values that a thread has while something runs.

use std::cell::RefCell;
use std::thread::LocalKey;

/// Runs `work` while the thread has `value` there. Gives what is there afterwards, and puts back what was there before,
/// also after a panic.
pub(crate) fn with_value<T: 'static, R>(
    key: &'static LocalKey<RefCell<Option<T>>>,
    value: T,
    work: impl FnOnce() -> R,
) -> (R, Option<T>) {
    struct Around<T: 'static>(&'static LocalKey<RefCell<Option<T>>>, Option<T>);
    impl<T> Drop for Around<T> {
        fn drop(&mut self) {
            self.0.set(self.1.take());
        }
    }
    let _around = Around(key, key.replace(Some(value)));
    let done = work();
    (done, key.take())
}

#[cfg(test)]
mod tests {
    use super::*;

    thread_local! {
        static VALUE: RefCell<Option<u32>> = const { RefCell::new(None) };
    }

    #[test]
    fn what_was_there_is_there_again_also_after_a_panic() {
        let inner = || with_value(&VALUE, 2, || VALUE.replace(Some(3)));
        assert_eq!(with_value(&VALUE, 1, inner), ((Some(2), Some(3)), Some(1)));
        assert_eq!(VALUE.take(), None);
        VALUE.set(Some(4));
        let panics = || with_value(&VALUE, 5, || std::panic::resume_unwind(Box::new(())));
        std::panic::catch_unwind(panics).unwrap_err();
        assert_eq!(VALUE.take(), Some(4));
    }
}
