//! Numbers that a policy keeps from one step to the next: its state, and its last message.

/// Numbers that a policy keeps from one step to the next; zeros at the start.
#[derive(Clone)]
pub(crate) struct Memory {
    /// Message of the last step, in a policy whose one graph makes it.
    pub message: Vec<f32>,
    pub state: Vec<f32>,
    /// Whether the message is that of the last step: there is one, and it has not failed.
    pub is_new: bool,
}

impl Memory {
    /// Returns the memory at the start, of so many floats of message and state.
    pub fn new(message: usize, state: usize) -> Memory {
        Memory { message: vec![0.0; message], state: vec![0.0; state], is_new: false }
    }

    /// Takes over the numbers of `other`, a memory of the same policy.
    pub fn copy(&mut self, other: &Memory) {
        self.message.copy_from_slice(&other.message);
        self.state.copy_from_slice(&other.state);
        self.is_new = other.is_new;
    }
}
