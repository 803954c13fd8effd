//! Handling of Ctrl-C and SIGTERM for commands that drive robots and have to stop them first.

use std::io::Read;
use std::os::unix::net::UnixStream;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize};

use anyhow::{Context, Result};
use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1};

use murmurate::runtime::real::Readers;

/// Starts listening for the signal USR1, by which a user requests to keep the last seconds of a record. Returns a flag
/// that the signal sets.
pub fn keep_request() -> Result<Arc<AtomicBool>> {
    let asked = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGUSR1, Arc::clone(&asked)).context("cannot listen for signals")?;
    Ok(asked)
}

/// Starts listening for Ctrl-C and SIGTERM. Returns a cell with the number of the signal that was received (0 before),
/// and a socket that a signal makes readable.
pub fn listen() -> Result<(Arc<AtomicUsize>, Rc<UnixStream>)> {
    let (signal, (reader, writer)) = (Arc::new(AtomicUsize::new(0)), UnixStream::pair().context("cannot make a pipe")?);
    reader.set_nonblocking(true).context("cannot make a pipe")?;
    for number in [SIGINT, SIGTERM] {
        // The number is set before the byte that wakes the thread is written.
        signal_hook::flag::register_usize(number, Arc::clone(&signal), number as usize)
            .and_then(|_| signal_hook::low_level::pipe::register(number, writer.try_clone()?))
            .context("cannot listen for signals")?;
    }
    Ok((signal, Rc::new(reader)))
}

/// Makes the event loop of `readers` turn when a signal arrives, by the socket of [`listen`].
pub fn watch(readers: &mut Readers, wake: Rc<UnixStream>) {
    let source = Rc::clone(&wake);
    readers.watch(wake, move || {
        let _ = (&*source).read(&mut [0; 16]);
    });
}
