//! End of the process after a panic: state after a broken invariant must not drive a robot.

/// Exit status of the process after a panic in an actor: that of any Rust program.
const PANIC_STATUS: i32 = 101;

/// Guard that ends the process when a panic drops it, with the name of the actor or of the part of the program. Without
/// it, an asynchronous runtime would end the task alone and continue without a message.
#[derive(Debug)]
pub struct EndsProcess(pub &'static str);

impl Drop for EndsProcess {
    fn drop(&mut self) {
        end_if_panicking(|| (self.0.to_owned(), String::new()));
    }
}

/// Ends the process if this thread is panicking, and reports it as the fault of `who`, an actor's name or its name and
/// the time. It is for `Drop` of a guard object: without it, the actor library would continue without the actor or its
/// message.
#[inline(always)] // It is asked after every message of every actor.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_in_a_task_ends_the_process() {
        let name = "edge::panic::tests::a_panic_in_a_task_ends_the_process";
        if std::env::var_os("MURMURATE_TEST_PANICS").is_none() {
            let program = std::env::current_exe().expect("a path");
            let mut again = std::process::Command::new(program);
            let output =
                again.args(["--exact", name, "--nocapture"]).env("MURMURATE_TEST_PANICS", "1").output().expect("a run");
            let said = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(PANIC_STATUS), "{said}");
            assert!(said.contains("a made-up fault") && said.contains("a made-up task broke an invariant"), "{said}");
            return;
        }
        let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
        let task = runtime.spawn(async {
            let _guard = EndsProcess("a made-up task");
            panic!("a made-up fault");
        });
        let _ = runtime.block_on(task);
        std::process::exit(0);
    }
}
