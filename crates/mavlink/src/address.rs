//! Address of an autopilot: a UDP port that it sends to, a UDP port that it listens on, or a serial line.

use std::fmt;
use std::net::SocketAddrV4;
use std::str::FromStr;

/// Rates of a serial line that are known \[baud\].
pub const BAUDS: [u32; 8] = [9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600];

/// Address of an autopilot, as MAVSDK writes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// `udpin://ADDRESS:PORT`: this host listens there, and answers to where the autopilot sends from.
    In(SocketAddrV4),
    /// `udpout://ADDRESS:PORT`: this host sends there, and the autopilot answers.
    Out(SocketAddrV4),
    /// `serial://DEVICE:BAUD`: a serial line.
    Serial {
        /// Path of the device, such as `/dev/ttyACM0`.
        device: String,
        /// Rate of the line \[baud\], one of [`BAUDS`]. A line over USB ignores it.
        baud: u32,
    },
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Address, String> {
        let forms = "write udpin://0.0.0.0:14540, udpout://192.168.1.7:14550 or serial:///dev/ttyACM0:57600";
        let (scheme, rest) = text.split_once("://").ok_or_else(|| format!("it has no scheme; {forms}"))?;
        let socket = || {
            let socket: SocketAddrV4 =
                rest.parse().map_err(|_| format!("'{rest}' is no IPv4 address with a port; {forms}"))?;
            if socket.port() == 0 {
                Err("port 0 is none; autopilots send to 14540 or 14550".to_owned())
            } else {
                Ok(socket)
            }
        };
        match scheme {
            "udpin" => Ok(Address::In(socket()?)),
            "udpout" => {
                let to = socket()?;
                let ip = to.ip();
                if ip.is_unspecified() || ip.is_multicast() || ip.is_broadcast() {
                    return Err(format!("{ip} is not the address of an autopilot; give its own, or use udpin"));
                }
                Ok(Address::Out(to))
            }
            "serial" => {
                let (device, baud) = rest.rsplit_once(':').ok_or_else(|| format!("it has no rate; {forms}"))?;
                let baud = baud.parse().ok().filter(|baud| BAUDS.contains(baud));
                let baud = baud.ok_or_else(|| format!("its rate is none of {BAUDS:?} baud"))?;
                if !device.starts_with('/') {
                    return Err(format!("'{device}' is no path of a device; {forms}"));
                }
                Ok(Address::Serial { device: device.to_owned(), baud })
            }
            _ => Err(format!("scheme '{scheme}' is unknown; {forms}")),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Address::In(at) => write!(f, "udpin://{at}"),
            Address::Out(at) => write!(f, "udpout://{at}"),
            Address::Serial { device, baud } => write!(f, "serial://{device}:{baud}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_read_and_written_back() {
        for text in ["udpin://0.0.0.0:14540", "udpout://192.168.1.7:14550", "serial:///dev/ttyACM0:57600"] {
            let address: Address = text.parse().expect(text);
            assert_eq!(address.to_string(), text);
        }
    }

    #[test]
    fn a_wrong_address_says_what_is_wrong() {
        for (text, part) in [
            ("0.0.0.0:14540", "no scheme"),
            ("tcp://127.0.0.1:5760", "'tcp' is unknown"),
            ("udpin://0.0.0.0", "no IPv4 address"),
            ("udpin://rover:14540", "no IPv4 address"),
            ("udpin://0.0.0.0:0", "port 0"),
            ("udpout://0.0.0.0:14550", "not the address of an autopilot"),
            ("udpout://224.0.0.1:14550", "not the address of an autopilot"),
            ("serial:///dev/ttyACM0", "no rate"),
            ("serial:///dev/ttyACM0:100", "its rate is none of"),
            ("serial://ttyACM0:57600", "no path"),
        ] {
            let error = text.parse::<Address>().expect_err(text);
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
