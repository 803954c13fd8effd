//! Schemas of the messages that are JSON.

/// JSON schema of messages about an episode: its next phase, or its result.
pub const EPISODE: &str = r#"{"title":"murmurate.Episode","type":"object","properties":{
"repeat":{"type":"integer"},"episode":{"type":"integer","description":"from 0"},
"phase":{"type":"string","description":"phase that begins; absent in a result"},
"verdict":{"type":"string","description":"only in a result"},
"makespan_s":{"type":["number","null"],"description":"from start to the last arrival, of a success"},
"cost":{"type":"number","description":"mean of the steps, in a scenario without goals"},
"reset_s":{"type":"number"},"min_separation_m":{"type":["number","null"]},
"judged":{"type":"string"}},"required":["repeat","episode"]}"#;

/// JSON schema of messages about the links between a host and each other host, as this host measures them: age of the
/// newest datagram received from the other host, delay, and loss in both directions. On a mesh, `hops` has the
/// neighbour by which the newest soft state of each other host has come; of links that choose, `sends` has the
/// decision.
pub const LINKS: &str = r#"{"title":"murmurate.Links","type":"object","properties":{
"host":{"type":"string","description":"who measures"},
"peers":{"type":"array","items":{"type":"object","properties":{
"link":{"type":"integer"},"host":{"type":"integer"},"epoch":{"type":"integer"},"proven":{"type":"boolean"},
"age_s":{"type":["number","null"]},"spacing_s":{"type":"number"},"jitter_s":{"type":"number"},
"loss":{"type":"number"},"passed":{"type":"integer"},"missing":{"type":"integer"},"told_loss":{"type":"number"},
"uncertainty_s":{"type":["number","null"]},"round_trip_s":{"type":["number","null"]},
"twins":{"type":"integer"},"former":{"type":"boolean"},"withholds":{"type":"boolean"},
"sends":{"type":"string","description":"decision of a link that chooses, with its figures"}}}},
"hops":{"type":"array","description":"absent without a mesh","items":{"type":"object","properties":{
"host":{"type":"integer"},"by":{"type":"integer","description":"neighbour that said it first; host itself if direct"},
"age_s":{"type":"number"}},"required":["host","by","age_s"]}},
"overheard":{"type":"array","description":"of an operator: whom its neighbours hear","items":{"type":"object",
"properties":{"at":{"type":"integer"},"host":{"type":"integer"},"loss":{"type":"number"},
"age_s":{"type":"number"}}}},
"sends":{"type":"array","description":"decisions of the links that choose","items":{"type":"object","properties":{
"link":{"type":"integer"},"way":{"type":"string","description":"multicast or unicast"},
"copies":{"type":"number","description":"transmissions of a state"},"states_hz":{"type":"number"},
"sent_hz":{"type":"number"},"hosts":{"type":"integer"},"loss":{"type":"number"},"load":{"type":"number"},
"multicast_s":{"type":["number","null"]},"unicast_s":{"type":["number","null"]},"congested":{"type":"boolean"},
"slot":{"type":["object","null"],"properties":{"place":{"type":"integer"},"of":{"type":"integer"},
"wait_s":{"type":"number"}}},"age_s":{"type":["number","null"]},"why":{"type":"string"}}}}},
"required":["host","peers"]}"#;

/// JSON schema of messages with the numbers of stops and reduced velocities by a robot's guard, by cause, since its
/// Controller was started.
pub const GUARD: &str = r#"{"title":"murmurate.Guard","type":"object","properties":{
"robot":{"type":"integer"},"stop":{"type":"integer"},"silence":{"type":"integer"},"output":{"type":"integer"},
"late_tick":{"type":"integer"},"own_state":{"type":"integer"},"hardware":{"type":"integer"},
"outside":{"type":"integer"},"fence":{"type":"integer"},"distance":{"type":"integer"},
"walls":{"type":"integer"},"jump":{"type":"integer"},"claim":{"type":"integer"}},"required":["robot"]}"#;

/// JSON schema of messages about what a robot's policy remembers after a step.
pub const MEMORY: &str = r#"{"title":"murmurate.Memory","type":"object","properties":{
"robot":{"type":"integer"},"digest":{"type":"string","description":"16 hexadecimal digits"}},
"required":["robot","digest"]}"#;

/// JSON schema of messages with the numbers of datagrams on a host's links, and of events that the record lacks.
pub const COUNTS: &str = r#"{"title":"murmurate.Counts","type":"object","properties":{
"host":{"type":"string"},"links":{"type":"object","description":"datagrams, by what became of them"},
"recording_dropped":{"type":"integer","description":"events before this one that the record lacks"}},
"required":["host"]}"#;

/// JSON schema of messages about a Wi-Fi card of a host, as the kernel tells it: mode, channel and its load, and the
/// stations that it hears.
pub const WIFI: &str = r#"{"title":"murmurate.Wifi","type":"object","properties":{
"interface":{"type":"string"},"mode":{"type":"string","description":"as iw names it"},
"frequency_mhz":{"type":["integer","null"]},"power_save":{"type":["boolean","null"]},
"active_ms":{"type":["integer","null"],"description":"time on the channel"},
"busy_ms":{"type":["integer","null"],"description":"time of it in which the channel was busy"},
"peers":{"type":"array","items":{"type":"object","properties":{"address":{"type":"string"},
"signal_dbm":{"type":["integer","null"]},"sent":{"type":"integer","description":"frames to it"},
"retries":{"type":"integer"},"failed":{"type":"integer"},"rate_mbit_s":{"type":["number","null"]},
"silent_ms":{"type":["integer","null"]}},"required":["address"]}}},"required":["interface","mode","peers"]}"#;

/// JSON schema of messages about the condition of a real robot's hardware.
pub const HARDWARE: &str = r#"{"title":"murmurate.Hardware","type":"object","properties":{
"robot":{"type":"integer"},"health":{"type":"string","description":"ready, faulty or silent"},
"battery":{"type":["integer","null"],"description":"charge in percent"},
"temperature_c":{"type":["integer","null"]},"reason":{"type":["string","null"],"description":"of a fault"}},
"required":["robot","health"]}"#;

/// JSON schema of messages about what one robot has sent to another, in imported records.
pub const RECEIPT: &str = r#"{"title":"murmurate.Receipt","type":"object","properties":{
"from":{"type":"integer","description":"robot that sent it"},"to":{"type":"integer"},
"sent_ns":{"type":"integer"},"received_ns":{"type":["integer","null"],"description":"null if it was lost"}},
"required":["from","to","sent_ns"]}"#;
