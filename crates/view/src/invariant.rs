//! What becomes of a panic on the thread of the live page's server.

/// Guard that ends the process when a panic drops it. Without it, the asynchronous runtime would end the task alone and
/// continue without a message, and a team would run on behind a page that has lost a part.
pub(super) struct EndsProcess;

/// Exit status of a process that a panic has ended, as of any other program in Rust.
const PANIC_STATUS: i32 = 101;

impl Drop for EndsProcess {
    fn drop(&mut self) {
        if std::thread::panicking() {
            end();
        }
    }
}

#[cold]
#[allow(clippy::print_stderr)] // The last words of the process.
fn end() {
    eprintln!(
        "murmurate: the page's server broke an invariant (see the panic above); the process ends so that motors stop. \
         Please report it with the command that you ran."
    );
    std::process::exit(PANIC_STATUS);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_in_a_task_ends_the_process() {
        let name = "invariant::tests::a_panic_in_a_task_ends_the_process";
        if std::env::var_os("PAGE_PANICS").is_none() {
            let program = std::env::current_exe().expect("a path");
            let mut again = std::process::Command::new(program);
            let output = again.args(["--exact", name, "--nocapture"]).env("PAGE_PANICS", "1").output().expect("a run");
            let said = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(PANIC_STATUS), "{said}");
            assert!(said.contains("a made-up fault") && said.contains("broke an invariant"), "{said}");
            return;
        }
        let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
        let task = runtime.spawn(async {
            let _guard = EndsProcess;
            panic!("a made-up fault");
        });
        let _ = runtime.block_on(task);
        std::process::exit(0);
    }
}
