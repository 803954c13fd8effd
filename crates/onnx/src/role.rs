//! Parts of a step of a policy, each of which a graph computes.

/// Part of a step that a graph of a policy computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// A whole step: action, message and next state, from the observation, what was heard, and the state.
    Step,
    /// The message, from the observation and the state.
    Encode,
    /// The message for one hop more, from the observation, the own message, what was heard of the hop before, and the
    /// state.
    Relay,
    /// The action and the next state, from the observation, the own message, what was heard, and the state.
    Act,
}

impl Role {
    /// Returns the name of the contract's field for the file of such a graph.
    pub fn field(self) -> &'static str {
        match self {
            Role::Step => "graph",
            Role::Encode => "encode",
            Role::Relay => "relay",
            Role::Act => "act",
        }
    }
}
