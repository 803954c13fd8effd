//! Data rates of IEEE 802.11, and the airtime of a frame at each rate. Medium access is not part of this file.
//!
//! Numbers of clauses and tables are those of IEEE 802.11-2016.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::time::Span;

/// Signal extension: silence that belongs to the airtime of each OFDM or HT frame at 2.4 GHz (IEEE 802.11-2016,
/// 18.3.2.4, 19.4.3) \[ns\].
const SIGNAL_EXTENSION_NS: u64 = 6_000;
/// Number of bits of an OFDM frame beside its data: 16 of SERVICE before it and 6 of tail after it (IEEE 802.11-2016,
/// 17.3.5.2, 17.3.5.3).
const SERVICE_AND_TAIL_BITS: u64 = 22;

/// Family of modulations of IEEE 802.11, which decides how the airtime of a frame follows from its length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Family {
    /// DSSS or FHSS: the bits follow one another after a preamble and header that take `preamble_ns` \[ns\].
    Serial { preamble_ns: u64 },
    /// OFDM symbols of 4 us at 20 MHz, longer in narrower channels (clause 17).
    Ofdm,
    /// OFDM symbols of 4 us after the longer preamble of the HT-mixed format, one spatial stream (clause 19).
    Ht,
}

/// Entry of the table of data rates: the name, the modulation family, and the data bits in two OFDM symbols; for DSSS
/// and FHSS, in two microseconds. It counts two since 5.5 Mbit/s is no whole number of bits in one microsecond.
struct Coding {
    name: &'static str,
    family: Family,
    bits_in_two: u64,
}

const fn coding(name: &'static str, family: Family, bits_in_two: u64) -> Coding {
    Coding { name, family, bits_in_two }
}

/// Modulation family of the DSSS rates: long preamble of 144 us and header of 48 us before the data (IEEE 802.11-2016,
/// 16.2.2.2, 16.3.4).
const DSSS: Family = Family::Serial { preamble_ns: 192_000 };
/// Modulation family of the FHSS rate: before the data, the PHY header of Bianchi's Table II (JSAC 18(3), 2000), 128
/// bits at 1 Mbit/s.
const FHSS: Family = Family::Serial { preamble_ns: 128_000 };

/// Table of all data rates that this program knows. Sources in IEEE 802.11-2016: 16.3.4 for DSSS and HR/DSSS; Table
/// 17-4 (data bits per symbol) for OFDM; Table 19-27, at 20 MHz, for HT.
const CODINGS: [Coding; 21] = [
    coding("fhss-1", FHSS, 2),
    coding("dsss-1", DSSS, 2),
    coding("dsss-2", DSSS, 4),
    coding("dsss-5.5", DSSS, 11),
    coding("dsss-11", DSSS, 22),
    coding("ofdm-6", Family::Ofdm, 2 * 24),
    coding("ofdm-9", Family::Ofdm, 2 * 36),
    coding("ofdm-12", Family::Ofdm, 2 * 48),
    coding("ofdm-18", Family::Ofdm, 2 * 72),
    coding("ofdm-24", Family::Ofdm, 2 * 96),
    coding("ofdm-36", Family::Ofdm, 2 * 144),
    coding("ofdm-48", Family::Ofdm, 2 * 192),
    coding("ofdm-54", Family::Ofdm, 2 * 216),
    coding("ht-mcs0", Family::Ht, 2 * 26),
    coding("ht-mcs1", Family::Ht, 2 * 52),
    coding("ht-mcs2", Family::Ht, 2 * 78),
    coding("ht-mcs3", Family::Ht, 2 * 104),
    coding("ht-mcs4", Family::Ht, 2 * 156),
    coding("ht-mcs5", Family::Ht, 2 * 208),
    coding("ht-mcs6", Family::Ht, 2 * 234),
    coding("ht-mcs7", Family::Ht, 2 * 260),
];

/// Width of a radio channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum Width {
    /// 5 MHz; only OFDM rates exist at this width.
    Quarter,
    /// 10 MHz; only OFDM rates exist at this width.
    Half,
    /// 20 MHz; all rates exist at this width.
    Full,
    /// 40 MHz; HT (802.11n) frames carry more bits per symbol, and frames at all other rates are as at 20 MHz.
    Double,
}

const WIDTHS: [(Width, u8); 4] = [(Width::Quarter, 5), (Width::Half, 10), (Width::Full, 20), (Width::Double, 40)];

impl TryFrom<u8> for Width {
    type Error = String;
    fn try_from(mhz: u8) -> Result<Width, String> {
        let found = WIDTHS.iter().find(|(_, other)| *other == mhz).map(|(width, _)| *width);
        found.ok_or_else(|| format!("a channel is 5, 10, 20 or 40 MHz wide, not {mhz}"))
    }
}

impl From<Width> for u8 {
    fn from(width: Width) -> u8 {
        WIDTHS.iter().find(|(other, _)| *other == width).map_or(20, |(_, mhz)| *mhz)
    }
}

/// Frequency band of a radio channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Band {
    /// 2.4 GHz; OFDM and HT frames are followed by a signal extension (silence) of 6 us.
    #[serde(rename = "2.4GHz")]
    Low,
    /// 5 GHz; frames have no signal extension.
    #[serde(rename = "5GHz")]
    High,
}

impl Band {
    /// Returns the lowest rate that all stations of the band must know (IEEE 802.11-2016, 16.1.1, 17.1.1).
    pub(super) fn lowest_mandatory(self) -> Rate {
        Rate::named(if self == Band::Low { "dsss-1" } else { "ofdm-6" })
    }
}

/// Data rate of IEEE 802.11. In files it is written as its name: modulation and rate in Mbit/s, such as `ofdm-12`, or
/// the HT scheme, such as `ht-mcs7`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Rate(u8);

/// Returns all data rates that this program knows.
pub fn all() -> impl Iterator<Item = Rate> {
    (0..CODINGS.len()).map(|at| Rate(at as u8))
}

impl Rate {
    /// Returns the rate with a name that the code knows.
    pub(super) fn named(name: &'static str) -> Rate {
        name.parse().expect("a rate of the table")
    }

    /// Returns the name of the rate, as in files.
    pub(super) fn name(self) -> &'static str {
        self.coding().name
    }

    /// Returns true for DSSS and FHSS, whose bits follow one another.
    pub(super) fn is_serial(self) -> bool {
        matches!(self.coding().family, Family::Serial { .. })
    }

    fn coding(self) -> &'static Coding {
        &CODINGS[usize::from(self.0)]
    }

    /// Returns the rate at which a frame at this rate is acknowledged if stations choose their rates: the highest
    /// mandatory one up to it (IEEE 802.11-2016, 10.7.6.5.2), and up to `most`.
    pub(super) fn answer(self, most: Rate) -> Rate {
        let bits = self.coding().bits_in_two.min(most.coding().bits_in_two);
        let serial = self.is_serial();
        let mandatory = |rate: &Rate| match rate.coding().family {
            Family::Serial { .. } => serial && rate.coding().family == DSSS,
            // Bits in two symbols at 6, 12 and 24 Mbit/s.
            Family::Ofdm => !serial && [48, 96, 192].contains(&rate.coding().bits_in_two),
            Family::Ht => false,
        };
        // Four microseconds are a symbol.
        let fits = |rate: &Rate| serial || rate.coding().bits_in_two <= bits;
        let found = all().filter(mandatory).filter(fits).filter(|rate| !serial || rate.0 <= self.0).last();
        found.unwrap_or(most)
    }

    /// Returns the rates among which a station chooses that may send up to this rate, in the order of the table: DSSS
    /// first, and the slowest of a family first.
    pub(super) fn choices(self, band: Band, width: Width) -> impl Iterator<Item = Rate> {
        let family = self.coding().family;
        all().filter(move |rate| {
            let other = rate.coding().family;
            let known = other == family || other == DSSS && family == Family::Ofdm && band == Band::Low;
            known && rate.0 <= self.0 && rate.fits(width)
        })
    }

    /// Returns true if this data rate exists at the channel width `width`.
    pub fn fits(self, width: Width) -> bool {
        matches!(width, Width::Full | Width::Double) || self.coding().family == Family::Ofdm
    }

    /// Returns the time that a frame of `bytes` bytes takes on the air at this rate, in a channel of this width and
    /// band. The bytes include MAC header and frame check sequence. The time is TXTIME of 16.3.4, 17.4.3, 18.5.3.2 and
    /// 19.4.3 in IEEE 802.11-2016.
    pub fn airtime(self, bytes: usize, width: Width, band: Band) -> Span {
        let Coding { family, bits_in_two, .. } = *self.coding();
        let bits = 8 * bytes as u64;
        let extension = if band == Band::Low { SIGNAL_EXTENSION_NS } else { 0 };
        Span::from_nanos(match family {
            Family::Serial { preamble_ns } => preamble_ns + 1_000 * (2 * bits).div_ceil(bits_in_two),
            Family::Ofdm => {
                // Table 17-21: all intervals are longer in a narrow channel.
                let slower = match width {
                    Width::Quarter => 4,
                    Width::Half => 2,
                    Width::Full | Width::Double => 1,
                };
                let symbols = (2 * (SERVICE_AND_TAIL_BITS + bits)).div_ceil(bits_in_two);
                // Training fields of 16 us and SIGNAL of 4 us (17.4.3).
                slower * (20_000 + 4_000 * symbols) + extension
            }
            Family::Ht => {
                // 108 instead of 52 data subcarriers: Table 19-31 beside Table 19-27.
                let (wider, narrower) = if width == Width::Double { (27, 13) } else { (1, 1) };
                let symbols = (2 * narrower * (SERVICE_AND_TAIL_BITS + bits)).div_ceil(wider * bits_in_two);
                // Legacy training fields and SIGNAL 20 us, HT-SIG 8 us, HT-STF 4 us, one HT-LTF of 4 us (Table 19-6,
                // 19.4.3).
                36_000 + 4_000 * symbols + extension
            }
        })
    }
}

fn names() -> String {
    CODINGS.map(|coding| coding.name).join(", ")
}

impl FromStr for Rate {
    type Err = String;
    fn from_str(name: &str) -> Result<Rate, String> {
        let at = CODINGS.iter().position(|coding| coding.name == name);
        let at = at.and_then(|at| u8::try_from(at).ok());
        at.map(Rate).ok_or_else(|| format!("there is no rate '{name}'; there are: {}", names()))
    }
}

impl TryFrom<String> for Rate {
    type Error = String;
    fn try_from(name: String) -> Result<Rate, String> {
        // Errors do not quote the contents of a file.
        name.parse().map_err(|_| format!("there is no such rate; there are: {}", names()))
    }
}

impl From<Rate> for String {
    fn from(rate: Rate) -> String {
        rate.to_string()
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.coding().name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn airtime_ns(rate: &str, bytes: usize, width: Width, band: Band) -> u64 {
        rate.parse::<Rate>().unwrap().airtime(bytes, width, band).as_nanos()
    }

    #[test]
    fn airtimes_match_the_standard() {
        use Band::*;
        use Width::*;
        // 14 bytes of ACK: 192 + 112 us.
        assert_eq!(airtime_ns("dsss-1", 14, Full, Low), 304_000);
        assert_eq!(airtime_ns("dsss-5.5", 14, Full, Low), 213_000, "112 bits at 5.5 Mbit/s, rounded up");
        // 22 + 112 bits are two symbols of 96, six of 24 and three of 48.
        assert_eq!(airtime_ns("ofdm-24", 14, Full, High), 28_000);
        assert_eq!(airtime_ns("ofdm-6", 14, Full, High), 44_000);
        assert_eq!(airtime_ns("ofdm-12", 14, Full, Low), 38_000);
        assert_eq!(airtime_ns("ofdm-54", 1536, Full, High), 248_000, "57 symbols");
        assert_eq!(airtime_ns("ofdm-54", 1536, Quarter, High), 4 * 248_000);
        assert_eq!(airtime_ns("ht-mcs7", 1538, Full, High), 36_000 + 4_000 * 48);
        assert_eq!(airtime_ns("ht-mcs7", 1538, Double, High), 36_000 + 4_000 * 23, "540 bits a symbol");
    }

    #[test]
    fn every_rate_parses_from_its_name() {
        for coding in &CODINGS {
            assert_eq!(coding.name.parse::<Rate>().unwrap().to_string(), coding.name);
        }
        assert!("ofdm-7".parse::<Rate>().unwrap_err().contains("ofdm-6, ofdm-9"));
        assert!(!"dsss-1".parse::<Rate>().unwrap().fits(Width::Half));
    }
}
