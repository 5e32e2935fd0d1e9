//! Which of the processor's vector instructions may be used.
use std::sync::OnceLock;

/// In the order of their width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Instructions {
    Portable,
    Avx2,
    Avx512,
}

/// The widest that may be used: all, unless the environment variable `NBV_GYM_INSTRUCTIONS` says `portable` or `avx2`. For
/// tests: so one machine can compute as others do. Read once per process.
pub fn widest() -> Instructions {
    static WIDEST: OnceLock<Instructions> = OnceLock::new();
    *WIDEST.get_or_init(|| match std::env::var("NBV_GYM_INSTRUCTIONS").as_deref() {
        Ok("portable") => Instructions::Portable,
        Ok("avx2") => Instructions::Avx2,
        _ => Instructions::Avx512,
    })
}
