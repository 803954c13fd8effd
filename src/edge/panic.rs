//! End of the process after a panic: state after a broken invariant must not drive a robot.

/// Exit status of the process after a panic in an actor: that of any Rust program.
const PANIC_STATUS: i32 = 101;

/// Ends the process if this thread is panicking, and reports it as the fault of `who`, an actor's name or its name and
/// the time. It is for `Drop` of a guard object: without it, the actor library would continue without the actor or its
/// message.
pub(crate) fn end_if_panicking(who: impl FnOnce() -> (String, String)) {
    if std::thread::panicking() {
        let (name, when) = who();
        end(&name, &when);
    }
}

#[cold]
#[allow(clippy::print_stderr)] // Without a log, stderr is the only way to report it.
fn end(name: &str, when: &str) -> ! {
    let why = format!(
        "{name} broke an invariant{when} (see the panic above); the process ends so that motors stop. Please report it \
         with the command that you ran."
    );
    // A log may have a writer that does not block; stderr blocks until it is read.
    if tracing::dispatcher::has_been_set() {
        tracing::error!("{why}");
    } else {
        eprintln!("murmurate: {why}");
    }
    std::process::exit(PANIC_STATUS);
}
