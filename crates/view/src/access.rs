//! Access control of the live page: the token, and the `Host` and `Origin` headers that a request may have. Pure.

use std::net::{IpAddr, SocketAddr};

use constant_time_eq::constant_time_eq;
use data_encoding::HEXLOWER;

use crate::command::{Command, Right};

/// Length of a token that the program draws for its live page \[bytes\]: 128 bits.
pub const TOKEN_BYTES: usize = 16;
/// Prefix of the WebSocket subprotocol that carries the token.
const TOKEN_PROTOCOL: &str = "token.";

/// Set of commands that the process with the live page accepts from browsers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Only the emergency stop of the team.
    StopOnly,
    /// Emergency stop, re-arm, resume and pause of the team.
    Team,
    /// Emergency stop, re-arm, resume and pause of an emulated team, and faults of its actors and links.
    Emulation,
    /// Playback of a record: run, halt, jump and speed. There is no team to command.
    Playback,
}

/// Token of the live page: a secret, random for each run or read from a file, as hexadecimal digits. A browser has to
/// send it for every command except the emergency stop, and for that as well if it is on another machine.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Returns the token with these random bytes.
    pub fn new(bytes: &[u8]) -> Token {
        Token(HEXLOWER.encode(bytes))
    }

    /// Returns the hexadecimal digits of the token, which are a part of the page's address. They must not be logged.
    pub fn digits(&self) -> &str {
        &self.0
    }

    /// Returns whether `shown` is this token, in a time that does not depend on where they differ.
    fn is(&self, shown: &str) -> bool {
        constant_time_eq(shown.as_bytes(), self.0.as_bytes())
    }

    /// Returns whether a request's header `Authorization` carries this token as a bearer token (RFC 6750).
    pub fn is_borne_by(&self, authorization: &str) -> bool {
        let token = authorization.split_once(' ').filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"));
        token.is_some_and(|(_, token)| self.is(token.trim()))
    }

    /// Returns whether the query of an address has this token as `token`.
    pub fn is_asked_with(&self, query: &str) -> bool {
        query.split('&').filter_map(|one| one.strip_prefix("token=")).any(|shown| self.is(shown))
    }

    /// Returns whether the token is in a list of WebSocket subprotocols that a browser offers, separated by commas. The
    /// comparison takes constant time.
    pub fn is_among(&self, protocols: &str) -> bool {
        let offered = protocols.split(',').filter_map(|one| one.trim().strip_prefix(TOKEN_PROTOCOL));
        offered.fold(false, |found, token| found | self.is(token))
    }
}

/// Permission of a browser to give commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// It has sent the token.
    Holder,
    /// It has sent no token or a wrong one, and it runs on this machine or the server is not guarded. It may stop the
    /// team.
    Near,
    /// It has sent no token or a wrong one, and it runs on another machine. It may see and do nothing.
    Stranger,
}

impl Standing {
    /// Whether the browser has sent the token.
    pub fn is_holder(self) -> bool {
        self == Standing::Holder
    }
}

/// The two ends of a connection to the live page's server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ends {
    /// Address of the server.
    pub local: SocketAddr,
    /// Address of the browser's machine.
    pub peer: IpAddr,
}

/// WebSocket of the live page that a browser asks for, by its path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Snapshots of the team.
    View,
    /// Goals, status and commands.
    Control,
}

/// Kind of a WebSocket connection of the live page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Socket {
    /// Snapshots of the team in binary form, from the server to the browser.
    View {
        /// Whether the browser has sent the page's token.
        holder: bool,
    },
    /// Goals and status from the server, and commands from the browser. It is separate from the snapshots, so that a
    /// command never waits behind them.
    Control(Standing),
}

impl Socket {
    /// Whether the browser has sent the page's token.
    pub fn is_holder(self) -> bool {
        match self {
            Socket::View { holder } => holder,
            Socket::Control(standing) => standing.is_holder(),
        }
    }
}

/// Access rules of the live page's server: which commands it accepts, and from which browsers.
#[derive(Clone)]
pub struct Access {
    /// Token that a browser has to send for every command, but on this machine not for the emergency stop.
    pub token: Token,
    /// Commands that the process accepts from browsers.
    pub control: Control,
    /// Whether a browser needs the token also to see the team (snapshots, goals, status and metrics), because other
    /// machines can reach the server.
    pub guarded: bool,
    /// Whether Foxglove may connect, with the token; only with the feature `foxglove`.
    pub foxglove: bool,
    /// Whether the server has the live page. A server without it has the metrics only.
    pub page: bool,
}

impl Access {
    /// Returns the standing of a browser at the address `peer`; `token` says whether it has sent the token.
    pub fn standing(&self, peer: IpAddr, token: bool) -> Standing {
        match token {
            true => Standing::Holder,
            false if self.guarded && !canonical(peer).is_loopback() => Standing::Stranger,
            false => Standing::Near,
        }
    }

    /// Returns the reason why a command is refused, as text for the user; `None` if it is allowed.
    pub fn refuses(&self, command: &Command, standing: Standing) -> Option<&'static str> {
        let holder = standing.is_holder();
        match (command.right(), self.control) {
            _ if standing == Standing::Stranger => Some("no token: open the address that the program printed"),
            (Right::Playback, Control::Playback) if holder => None,
            (Right::Playback, Control::Playback) => Some("no token: open the address that the program printed"),
            (_, Control::Playback) => Some("this is a record: there is no team to command"),
            (Right::Playback, _) => Some("this is a team that runs, and no record"),
            (Right::Anyone, _) => None,
            (_, Control::StopOnly) => Some("this page only watches; start the program with --control"),
            (_, _) if !holder => Some("no token: open the address that the program printed"),
            (Right::Emulation, Control::Team) => Some("faults are for emulated teams"),
            (Right::Control | Right::Emulation, _) => None,
        }
    }
}

/// Returns whether a request to the server at `local` may have `host` in its header `Host`: the server's own address,
/// or a loopback name if `local` is a loopback address. This prevents DNS rebinding, because pages of other sites
/// cannot set that header.
pub fn is_host(host: &str, local: SocketAddr) -> bool {
    let port = local.port();
    let own = SocketAddr::new(canonical(local.ip()), port).to_string();
    let loopback = [format!("127.0.0.1:{port}"), format!("localhost:{port}"), format!("[::1]:{port}")];
    let named = host == own || canonical(local.ip()).is_loopback() && loopback.iter().any(|name| name == host);
    // Browsers leave out port 80, the default of HTTP.
    named || port == 80 && !host.contains(":80") && is_host(&format!("{host}:80"), local)
}

/// Returns whether a WebSocket request to `host` may have `origin` in its header `Origin`: only if it comes from a page
/// of this server.
pub fn is_origin(origin: &str, host: &str) -> bool {
    origin.strip_prefix("http://").is_some_and(|from| from == host)
}

fn canonical(ip: IpAddr) -> IpAddr {
    ip.to_canonical()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_are_the_address_itself_or_a_loopback_name() {
        let local: SocketAddr = "127.0.0.1:8137".parse().unwrap();
        for fine in ["127.0.0.1:8137", "localhost:8137", "[::1]:8137"] {
            assert!(is_host(fine, local), "{fine}");
        }
        for wrong in ["", "127.0.0.1", "127.0.0.1:80", "evil.example:8137", "localhost.evil.example:8137", "localhost"]
        {
            assert!(!is_host(wrong, local), "{wrong}");
        }
        let far: SocketAddr = "192.168.1.5:8137".parse().unwrap();
        assert!(is_host("192.168.1.5:8137", far) && !is_host("localhost:8137", far) && !is_host("robot:8137", far));
        let web: SocketAddr = "127.0.0.1:80".parse().unwrap();
        assert!(is_host("localhost", web) && is_host("localhost:80", web) && !is_host("evil.example", web));
    }

    #[test]
    fn origins_are_this_server_alone() {
        assert!(is_origin("http://localhost:81", "localhost:81"));
        for wrong in
            ["", "null", "https://localhost:81", "http://localhost", "http://evil.example", "http://localhost:812"]
        {
            assert!(!is_origin(wrong, "localhost:81"), "{wrong}");
        }
    }

    #[test]
    fn only_the_whole_token_counts() {
        let token = Token::new(&[0xab; TOKEN_BYTES]);
        let digits = "ab".repeat(16);
        assert!(token.is_among(&format!("murmurate, token.{digits}")));
        for wrong in
            ["", "murmurate", "token.", &digits, &format!("token.{}", &digits[1..]), &format!("token.{digits}0")]
        {
            assert!(!token.is_among(wrong), "{wrong}");
        }
    }

    #[test]
    fn a_stop_needs_nothing_and_faults_need_an_emulated_team() {
        let access = |control| Access { token: Token::new(&[1]), control, guarded: false, foxglove: false, page: true };
        let standing = |holder: bool| if holder { Standing::Holder } else { Standing::Near };
        let link = Command::Link { link: "air".to_owned(), cut: true, delay_ms: 0.0, loss: 0.0 };
        assert_eq!(access(Control::StopOnly).refuses(&Command::Stop, standing(false)), None);
        assert!(access(Control::StopOnly).refuses(&Command::Rearm, standing(true)).is_some());
        assert!(access(Control::Team).refuses(&Command::Rearm, standing(false)).is_some());
        assert_eq!(access(Control::Team).refuses(&Command::Rearm, standing(true)), None);
        assert!(access(Control::Team).refuses(&link, standing(true)).is_some());
        assert_eq!(access(Control::Emulation).refuses(&link, standing(true)), None);
        let seek = Command::Seek { at_s: 1.0 };
        assert_eq!(access(Control::Playback).refuses(&seek, standing(true)), None);
        assert!(access(Control::Playback).refuses(&seek, standing(false)).is_some());
        assert!(
            access(Control::Playback).refuses(&Command::Stop, standing(true)).is_some(),
            "nothing would be stopped"
        );
        assert!(access(Control::Emulation).refuses(&seek, standing(true)).is_some());
    }

    #[test]
    fn a_stop_from_another_machine_needs_the_token_where_others_reach_the_server() {
        let access =
            |guarded| Access { token: Token::new(&[1]), control: Control::Team, guarded, foxglove: false, page: true };
        let [far, here]: [IpAddr; 2] = ["192.168.1.7", "127.0.0.1"].map(|ip| ip.parse().unwrap());
        let mapped: IpAddr = "::ffff:127.0.0.1".parse().unwrap();
        let refused = |guarded, peer, token| {
            let access = access(guarded);
            access.refuses(&Command::Stop, access.standing(peer, token)).is_some()
        };
        assert!(refused(true, far, false) && !refused(true, far, true));
        assert!(!refused(true, here, false) && !refused(true, mapped, false), "as without a token file");
        assert!(!refused(false, here, false));
    }
}
