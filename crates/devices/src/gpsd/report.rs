//! Reports of gpsd: decoder of its JSON lines TPV, GST, ATT, SKY, DEVICES and ERROR, with the terms of gpsd_json(5).

use jiff::Timestamp;
use jiff::tz::TimeZone;
use murmurate::localization::fix::Fix;
use serde::Deserialize;

/// Reason for which a line of gpsd could not be decoded, or for which its fix gives no reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Malformed(pub &'static str);

/// Report of gpsd, the daemon that reads satellite receivers. Only the classes and fields in use are decoded.
#[derive(Clone, Debug, PartialEq)]
pub enum GpsdReport {
    /// Report TPV: time, position and velocity of a receiver.
    Tpv(Tpv),
    /// Report GST (statistics of pseudorange errors): expected error of a receiver's position.
    Gst(Gst),
    /// Report ATT: attitude of a receiver with two antennas, or of a compass.
    Att(Att),
    /// Report SKY: the satellites in view of a receiver. Only its arrival is of use.
    Sky,
    /// Report DEVICES: number of the receivers that gpsd reads.
    Devices(usize),
    /// Report ERROR: gpsd refuses a request.
    Error,
    /// Report of gpsd of another class; it is ignored.
    Other,
}

/// Report TPV of gpsd: time, position and velocity of a receiver. A field is `None` if the report does not have it.
#[derive(Clone, Debug, PartialEq)]
pub struct Tpv {
    /// Path of the receiver's device on the machine that runs gpsd; `None` if not reported.
    pub device: Option<String>,
    /// Dimensions of the position fix: 0 or 1 for no fix, 2 or 3.
    pub mode: u8,
    /// Kind of the position fix as a number of gpsd, explained at [`Kind::of`]; `None` if not reported.
    pub status: Option<u8>,
    /// Time of measurement \[ns since 1970, UTC\]; `None` if not known, such as at the start of a receiver.
    pub time_ns: Option<u64>,
    /// Latitude on WGS 84 \[deg\], positive to the north; `None` if not known.
    pub latitude_deg: Option<f64>,
    /// Longitude on WGS 84 \[deg\], positive to the east; `None` if not known.
    pub longitude_deg: Option<f64>,
    /// Height above the WGS 84 ellipsoid \[m\]; `None` if not known.
    pub height_m: Option<f64>,
    /// Course over ground \[deg\], clockwise from true north; `None` if not known, such as at rest.
    pub(crate) track_deg: Option<f64>,
    /// Speed over ground \[m/s\]; `None` if not known.
    pub speed_m_s: Option<f64>,
    /// Estimated error of the horizontal position \[m\] (`eph`), which gpsd means for 95 % of all fixes; `None` if not
    /// known.
    pub(crate) error_95_m: Option<f64>,
}

/// Report ATT of gpsd: attitude of a receiver with two antennas, or of a compass.
#[derive(Clone, Debug, PartialEq)]
pub struct Att {
    /// Path of the receiver's device on the machine that runs gpsd; `None` if not reported.
    pub device: Option<String>,
    /// Direction from the one antenna to the other \[deg\], clockwise from true north; `None` if not known.
    pub(crate) heading_deg: Option<f64>,
}

/// Report GST of gpsd: the expected error of a receiver's position. A field is `None` if the report does not have it.
#[derive(Clone, Debug, PartialEq)]
pub struct Gst {
    /// Path of the receiver's device on the machine that runs gpsd; `None` if not reported.
    pub device: Option<String>,
    /// Time of measurement \[ns since 1970, UTC\]; `None` if not known.
    pub time_ns: Option<u64>,
    /// Standard deviation of the position along north \[m\]; `None` if not known.
    pub(crate) north_m: Option<f64>,
    /// Standard deviation of the position along east \[m\]; `None` if not known.
    pub(crate) east_m: Option<f64>,
}

/// Origin of a position, by the mode and the status of a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Fix in three dimensions from satellites alone, of this quality.
    Satellites(Fix),
    /// Fix in three dimensions from satellites and from wheel or inertial sensors of the receiver. The status does not
    /// tell its quality, so that its stated error has to.
    WithDeadReckoning,
    /// Position from wheel or inertial sensors of the receiver alone, whose error grows.
    DeadReckoning,
    /// Position that is no measurement: surveyed by hand, or simulated.
    NotMeasured,
    /// No fix in three dimensions.
    None,
}

/// Largest standard deviation of a position \[m\] with which a fix of an unknown kind counts as RTK fixed, RTK float
/// and DGPS: accurate to centimetres, to decimetres, and to a metre or two.
const ACCURATE_M: [(f64, Fix); 3] = [(0.05, Fix::RtkFixed), (0.5, Fix::RtkFloat), (2.0, Fix::Dgps)];
/// Latest year of a report's time. A later one is a receiver's error.
const LATEST_YEAR: i16 = 2500;

const SECOND_NS: u64 = 1_000_000_000;

/// Fields in use of the report classes TPV and GST. In GST, `lat` and `lon` are standard deviations \[m\].
#[derive(Deserialize)]
struct Line {
    class: String,
    device: Option<String>,
    mode: Option<u8>,
    status: Option<u8>,
    time: Option<String>,
    lat: Option<f64>,
    lon: Option<f64>,
    #[serde(rename = "altHAE")]
    alt_hae: Option<f64>,
    track: Option<f64>,
    speed: Option<f64>,
    eph: Option<f64>,
    heading: Option<f64>,
    devices: Option<Vec<serde::de::IgnoredAny>>,
}

impl Kind {
    /// Returns the origin of the position in a report.
    ///
    /// Values of the status in gpsd_json(5): 0 unknown, 1 normal, 2 DGPS, 3 RTK fixed, 4 RTK float, 5 dead reckoning, 6
    /// satellites with dead reckoning, 7 time only (surveyed position), 8 simulated, 9 P(Y).
    pub fn of(tpv: &Tpv) -> Kind {
        if tpv.mode < 3 {
            return Kind::None;
        }
        match tpv.status.unwrap_or(0) {
            0 | 1 | 9 => Kind::Satellites(Fix::ThreeD),
            2 => Kind::Satellites(Fix::Dgps),
            4 => Kind::Satellites(Fix::RtkFloat),
            3 => Kind::Satellites(Fix::RtkFixed),
            5 => Kind::DeadReckoning,
            6 => Kind::WithDeadReckoning,
            _ => Kind::NotMeasured,
        }
    }
}

/// Returns the quality of a fix of an unknown kind by the standard deviation of its position \[m\]; the lowest if
/// that is unknown.
pub(crate) fn fix_of_error(deviation_m: Option<f64>) -> Fix {
    let within = |(most_m, _): &&(f64, Fix)| deviation_m.is_some_and(|error_m| error_m <= *most_m);
    ACCURATE_M.iter().find(within).map_or(Fix::ThreeD, |(_, fix)| *fix)
}

/// Decodes one line of JSON from gpsd. Of a report of an unused class, only the class is examined. An error says why
/// the line is malformed.
pub fn decode(line: &[u8]) -> Result<GpsdReport, Malformed> {
    #[derive(Deserialize)]
    struct Class {
        class: String,
    }
    const NO_REPORT: Malformed = Malformed("a line of gpsd is no report");
    let Class { class } = serde_json::from_slice(line).map_err(|_| NO_REPORT)?;
    match class.as_str() {
        "TPV" | "GST" | "ATT" | "DEVICES" => {}
        "SKY" => return Ok(GpsdReport::Sky),
        "ERROR" => return Ok(GpsdReport::Error),
        _ => return Ok(GpsdReport::Other),
    }
    let line: Line = serde_json::from_slice(line).map_err(|_| NO_REPORT)?;
    if line.class == "DEVICES" {
        return Ok(GpsdReport::Devices(line.devices.map_or(0, |devices| devices.len())));
    }
    if line.class == "ATT" {
        return Ok(GpsdReport::Att(Att { device: line.device, heading_deg: line.heading }));
    }
    let time_ns = match line.time.as_deref().map(nanoseconds) {
        Some(None) => return Err(Malformed("the time of a gpsd report is not in ISO 8601")),
        Some(time_ns) => time_ns,
        None => None,
    };
    Ok(if line.class == "GST" {
        GpsdReport::Gst(Gst { device: line.device, time_ns, north_m: line.lat, east_m: line.lon })
    } else {
        GpsdReport::Tpv(Tpv {
            device: line.device,
            mode: line.mode.unwrap_or(0),
            status: line.status,
            time_ns,
            latitude_deg: line.lat,
            longitude_deg: line.lon,
            height_m: line.alt_hae,
            track_deg: line.track,
            speed_m_s: line.speed,
            error_95_m: line.eph,
        })
    })
}

/// Returns whether a time \[ns since 1970, UTC\] is within a second of the end of a month, where leap seconds are. A
/// receiver has the stamps of such a second twice, or with second 60, which counts as the first of the next month.
pub(crate) fn may_leap(time_ns: u64) -> bool {
    // Two seconds before the end of the month's last day to two after it: 60.9 is 0.9 of the next day.
    let Ok(later) = Timestamp::from_nanosecond(i128::from(time_ns) + 2 * i128::from(SECOND_NS)) else { return false };
    let later = TimeZone::UTC.to_datetime(later);
    (later.day(), later.hour(), later.minute()) == (1, 0, 0) && later.second() < 4
}

/// Converts a time such as "2026-11-22T12:00:00.100Z" to nanoseconds since 1970, without leap seconds; `None` if
/// malformed. A second 60 is the first of the next minute.
fn nanoseconds(text: &str) -> Option<u64> {
    let time: Timestamp = text.parse().ok().filter(|_| text.ends_with('Z'))?;
    // The library takes a second 60 for a second 59.
    let leap = if text.as_bytes().get(16..19) == Some(b":60") { SECOND_NS } else { 0 };
    let time_ns = u64::try_from(time.as_nanosecond()).ok()?;
    (TimeZone::UTC.to_datetime(time).year() <= LATEST_YEAR).then_some(time_ns + leap)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_calendar() {
        for (text, seconds) in [
            ("1970-01-01T00:00:00Z", 0),
            ("2000-02-29T23:59:59.000Z", 951_868_799),
            ("2000-03-01T00:00:00.000Z", 951_868_800),
            ("2026-11-22T12:00:00.000Z", 1_795_348_800),
            ("2100-03-01T00:00:00Z", 4_107_542_400),
        ] {
            assert_eq!(nanoseconds(text), Some(seconds * 1_000_000_000), "{text}");
        }
        assert_eq!(nanoseconds("1970-01-01T00:00:00.1Z"), Some(100_000_000));
        assert_eq!(nanoseconds("1970-01-01T00:00:59.000000001Z"), Some(59_000_000_001));
        // A leap second, and the second that has the same stamp.
        assert_eq!(nanoseconds("2016-12-31T23:59:60.900Z"), nanoseconds("2017-01-01T00:00:00.900Z"));
        assert_eq!(nanoseconds("2016-12-31T23:59:60.900Z"), Some(1_483_228_800_900_000_000));
        let wrong = [
            "",
            "Z",
            "T",
            "2026-11-22",
            "2026-13-22T12:00:00Z",
            "2026-11-22T12:00:00.+1Z",
            "2026-11-22T24:00:00Z",
            "2026-02-29T12:00:00Z",
            "2026-11-22T12:00:00+01:00",
            "2026-11-22T12:00:61Z",
            "1969-12-31T23:59:59Z",
            "2501-01-01T00:00:00Z",
            "9999-12-31T23:59:60Z",
        ];
        wrong.iter().for_each(|text| assert_eq!(nanoseconds(text), None, "{text}"));
    }

    #[test]
    fn leap_seconds_are_at_the_ends_of_months() {
        for (text, may) in [
            ("2026-12-31T23:59:57.900Z", false),
            ("2026-12-31T23:59:58.500Z", true),
            ("2026-12-31T23:59:59.900Z", true),
            ("2026-12-31T23:59:60.900Z", true),
            ("2027-01-01T00:00:01.900Z", true),
            ("2027-01-01T00:00:02.000Z", false),
            ("2024-02-29T23:59:59.500Z", true),
            ("2024-02-28T23:59:59.500Z", false),
            ("2026-06-30T23:59:60.000Z", true),
            ("2026-06-29T23:59:59.000Z", false),
        ] {
            assert_eq!(may_leap(nanoseconds(text).unwrap()), may, "{text}");
        }
    }

    #[test]
    fn a_report_is_read_and_its_quality_judged_by_mode_and_status() {
        let line = br#"{"class":"TPV","device":"/dev/pts/1","mode":3,"status":4,"time":"1970-01-01T00:00:01.000Z",
            "lat":52.2053,"lon":0.1218,"altHAE":58.0,"track":45.5,"speed":0.5,"eph":11.4,"unknown":[1,2]}"#;
        let GpsdReport::Tpv(tpv) = decode(line).unwrap() else { panic!("a TPV") };
        assert_eq!((tpv.time_ns, tpv.height_m, tpv.track_deg), (Some(1_000_000_000), Some(58.0), Some(45.5)));
        assert_eq!((Kind::of(&tpv), tpv.error_95_m), (Kind::Satellites(Fix::RtkFloat), Some(11.4)));
        for (mode, status, kind) in [
            (3, Some(3), Kind::Satellites(Fix::RtkFixed)),
            (3, None, Kind::Satellites(Fix::ThreeD)),
            (2, Some(3), Kind::None),
            (3, Some(5), Kind::DeadReckoning),
            (3, Some(6), Kind::WithDeadReckoning),
            (3, Some(7), Kind::NotMeasured),
            (3, Some(8), Kind::NotMeasured),
        ] {
            assert_eq!(Kind::of(&Tpv { mode, status, ..tpv.clone() }), kind);
        }
        let by_error = [Some(0.02), Some(0.3), Some(1.5), Some(9.0), None].map(fix_of_error);
        assert_eq!(by_error, [Fix::RtkFixed, Fix::RtkFloat, Fix::Dgps, Fix::ThreeD, Fix::ThreeD]);
        assert!(Fix::RtkFixed > Fix::RtkFloat && Fix::RtkFloat > Fix::Dgps && Fix::Dgps > Fix::ThreeD);
    }

    #[test]
    fn what_is_no_report_is_refused_at_any_length() {
        let line = br#"{"class":"GST","device":"a","time":"2026-11-22T12:00:00.000Z","lat":0.01,"lon":0.02}"#;
        assert!(matches!(decode(line), Ok(GpsdReport::Gst(Gst { north_m: Some(_), east_m: Some(_), .. }))));
        (0..line.len()).for_each(|length| assert!(decode(&line[..length]).is_err()));
        assert_eq!(decode(br#"{"class":"SKY","lat":"not looked at"}"#), Ok(GpsdReport::Sky));
        assert_eq!(decode(br#"{"class":"VERSION","lat":"not looked at"}"#), Ok(GpsdReport::Other));
        assert_eq!(decode(br#"{"class":"DEVICES","devices":[{"path":"/dev/ttyACM0"}]}"#), Ok(GpsdReport::Devices(1)));
        let att = br#"{"class":"ATT","device":"a","time":"2026-11-22T12:00:00.000Z","heading":181.5,"mag_st":"N"}"#;
        let known = Att { device: Some("a".to_owned()), heading_deg: Some(181.5) };
        assert_eq!(decode(att), Ok(GpsdReport::Att(known)));
        assert_eq!(decode(br#"{"class":"ERROR","message":"Unrecognized request"}"#), Ok(GpsdReport::Error));
        for line in [&b"{}"[..], b"null", br#"{"class":7}"#, br#"{"class":"TPV","time":"now"}"#, &[b'['; 5000]] {
            assert!(decode(line).is_err());
        }
    }
}
