//! Faults of our own: a panic is caught where it can be confined, and its text goes into the error instead of onto stderr.
use std::cell::{Cell, RefCell};
use std::panic::{catch_unwind, set_hook, take_hook, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    /// How many callers up the stack will catch a panic on this thread.
    static CATCHERS: Cell<usize> = const { Cell::new(0) };
    /// Where the last panic on this thread happened.
    static PLACE: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Panics that somebody catches are not printed; all others are treated as before.
fn quiet() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| {
            // During the end of a thread its storage may be gone already.
            if CATCHERS.try_with(Cell::get).unwrap_or(0) == 0 {
                return before(info);
            }
            let place = info.location().map(|l| format!(" ({l})"));
            let _ = PLACE.try_with(|p| *p.borrow_mut() = place.unwrap_or_default());
        }));
    });
}

/// The result of `work`, or what the panic in it had to say and where it stood.
pub fn caught<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    quiet();
    CATCHERS.with(|c| c.set(c.get() + 1));
    let outcome = catch_unwind(AssertUnwindSafe(work));
    CATCHERS.with(|c| c.set(c.get() - 1));
    outcome.map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        let place = PLACE.with(RefCell::take);
        format!("{}{place}", text.unwrap_or("unknown panic"))
    })
}

/// Say once on a thread whose panics all go to whoever waits for it, as in a pool.
pub fn panics_are_passed_on() {
    quiet();
    CATCHERS.with(|c| c.set(c.get() + 1));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_its_text_and_place() {
        assert_eq!(caught(|| 7), Ok(7));
        let text = caught(|| panic!("a fault")).unwrap_err();
        assert!(
            text.starts_with("a fault (") && text.contains("fault.rs"),
            "{text}"
        );
        let within = caught(|| caught(|| panic!("inner")).unwrap_err()).unwrap();
        assert!(within.starts_with("inner"));
        assert_eq!(CATCHERS.with(Cell::get), 0);
    }
}
