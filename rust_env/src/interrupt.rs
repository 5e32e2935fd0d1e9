//! Ctrl-C during long work: whoever calls the core may say how to ask whether to go on, and loops that can take seconds ask.
use crate::error::{Error, Result};
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Condvar, Mutex, OnceLock};
use std::time::{Duration, Instant};

/// True once the caller wants the work to stop; asked on the calling thread only.
type Ask = fn() -> bool;
static ASK: OnceLock<Ask> = OnceLock::new();
/// Between two questions: they cost microseconds, and a person does not notice a tenth of a second.
const PERIOD: Duration = Duration::from_millis(100);

thread_local! {
    /// When this thread, if it is a caller, asked last.
    static ASKED: Cell<Option<Instant>> = const { Cell::new(None) };
    static STOP: Arc<AtomicBool> = Arc::default();
}

/// How to ask; the first one stays.
pub fn ask_with(ask: Ask) {
    let _ = ASK.set(ask);
}

/// Run work that this thread was called for; [`check`] asks now and then while it runs.
pub fn watched<T>(work: impl FnOnce() -> T) -> T {
    struct Restore(Option<Instant>);
    impl Drop for Restore {
        fn drop(&mut self) {
            ASKED.with(|a| a.set(self.0));
        }
    }
    let _restore = Restore(ASKED.with(|a| a.replace(Some(Instant::now()))));
    STOP.with(|s| s.store(false, Relaxed));
    work()
}

/// [`Error::Interrupted`] if the work is to stop. Silent on a thread that nobody called: see [`Stop`].
pub fn check() -> Result<()> {
    let due = ASKED.with(|a| match a.get() {
        Some(asked) if asked.elapsed() >= PERIOD => {
            a.set(Some(Instant::now()));
            true
        }
        _ => false,
    });
    if due && ASK.get().is_some_and(|ask| ask()) {
        STOP.with(|s| s.store(true, Relaxed));
    }
    STOP.with(|s| Stop::state(s))
}

/// What the calling thread found out, for the threads that work for it.
#[derive(Clone)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    pub fn of_this_thread() -> Self {
        Self(STOP.with(Arc::clone))
    }

    fn state(stop: &AtomicBool) -> Result<()> {
        if stop.load(Relaxed) {
            Err(Error::Interrupted)
        } else {
            Ok(())
        }
    }

    /// On any thread; on a caller's as [`check`].
    pub fn check(&self) -> Result<()> {
        check()?;
        Self::state(&self.0)
    }
}

/// `pool.install(work)`, while this thread goes on asking.
pub fn in_pool<T: Send>(pool: &rayon::ThreadPool, work: impl FnOnce() -> T + Send) -> Option<T> {
    struct Done<'a>(&'a Mutex<bool>, &'a Condvar);
    impl Drop for Done<'_> {
        // Also when the work panics: the scope passes the panic on.
        fn drop(&mut self) {
            *self.0.lock().unwrap_or_else(|e| e.into_inner()) = true;
            self.1.notify_all();
        }
    }
    let (done, changed, mut outcome) = (Mutex::new(false), Condvar::new(), None);
    pool.in_place_scope(|scope| {
        scope.spawn(|_| {
            let _done = Done(&done, &changed);
            outcome = Some(work());
        });
        let mut finished = done.lock().unwrap_or_else(|e| e.into_inner());
        while !*finished {
            finished = match changed.wait_timeout(finished, PERIOD) {
                Ok((guard, _)) => guard,
                Err(poisoned) => poisoned.into_inner().0,
            };
            // What it says reaches the workers through `Stop`.
            let _ = check();
        }
    });
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One test, since there is one way to ask in a process.
    #[test]
    fn long_work_stops_when_asked_to_and_later_work_does_not() {
        static ASKING: AtomicBool = AtomicBool::new(false);
        ask_with(|| ASKING.load(Relaxed));
        let endless = || loop {
            check()?;
        };
        assert!(check().is_ok(), "nobody called this thread");
        ASKING.store(true, Relaxed);
        assert!(matches!(
            watched::<Result<()>>(endless),
            Err(Error::Interrupted)
        ));
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(2)
            .build()
            .unwrap();
        let outcome: Option<Result<()>> = watched(|| {
            let stop = Stop::of_this_thread();
            in_pool(&pool, move || loop {
                stop.check()?;
            })
        });
        assert!(matches!(outcome, Some(Err(Error::Interrupted))));
        ASKING.store(false, Relaxed);
        assert!(watched(check).is_ok());
        assert_eq!(in_pool(&pool, || 7), Some(7));
    }
}
