//! Predefined radio channels: those of IEEE 802.11 that `--radio` names, and the system of Bianchi's paper.

use super::rate::{Band, Rate, Width};
use super::{Adaptation, AfterDrop, Counting, OVERHEAD_BYTES, Radio, Recovery, Topology};

/// Names of the predefined radio channels, which `Radio::preset` returns.
pub const PRESETS: [&str; 5] = ["wifi", "wifi-n", "wifi-slow", "wifi-ibss", "paper"];

impl Default for Radio {
    /// Returns the predefined channel `wifi`: IEEE 802.11 at 2.4 GHz with an access point, unicast at 54 Mbit/s and
    /// multicast at 1 Mbit/s.
    fn default() -> Radio {
        Radio {
            channel: Topology::Infrastructure,
            rate: Rate::named("ofdm-54"),
            // The default of access points, which any station can decode.
            basic_rate: Rate::named("dsss-1"),
            // The highest mandatory rate not above that of the data (10.7.6.5.2).
            ack_rate: Rate::named("ofdm-24"),
            width_mhz: Width::Full,
            band: Band::Low,
            // Table 18-5: short slot, SIFS, contention windows of ERP.
            slot_us: 9,
            sifs_us: 10,
            // Best effort of Table 9-137.
            aifsn: 3,
            propagation_us: 0,
            cw_min: 15,
            cw_max: 1023,
            counting: Counting::Edca,
            after_error: Recovery::Eifs,
            retries: 7,
            queue: 64,
            overhead_bytes: OVERHEAD_BYTES,
            range_m: None,
            noise_loss: 0.0,
            background: 0.0,
            sense_m: None,
            powers: None,
            capture: false,
            access_point_m: None,
            after_drop: AfterDrop::Reset,
            adaptation: Adaptation::Fixed,
            beacon_ms: 0.0,
        }
    }
}

impl Radio {
    /// Returns the predefined channel named `name`, with an access point; `None` if no preset has that name. The names
    /// are in `PRESETS`.
    pub fn preset(name: &str) -> Option<Radio> {
        Some(match name {
            "wifi" => Radio::default(),
            // Table 19-25 with Table 17-21: HT at 5 GHz.
            "wifi-n" => Radio {
                rate: Rate::named("ht-mcs7"),
                basic_rate: Rate::named("ofdm-6"),
                band: Band::High,
                slot_us: 9,
                sifs_us: 16,
                ..Radio::default()
            },
            // Table 16-4 (HR/DSSS), without EDCA and its QoS control: all frames at the rate of longest range.
            "wifi-slow" => Radio {
                rate: Rate::named("dsss-1"),
                ack_rate: Rate::named("dsss-1"),
                slot_us: 20,
                aifsn: 2,
                cw_min: 31,
                counting: Counting::Dcf,
                overhead_bytes: OVERHEAD_BYTES - 2,
                ..Radio::default()
            },
            // An ad-hoc network of Linux at 2.4 GHz: long slots whatever its rates (IEEE 802.11-2012, 19.4.5), and a
            // beacon each 100 units of 1024 us.
            "wifi-ibss" => Radio { channel: Topology::AdHoc, slot_us: 20, beacon_ms: 102.4, ..Radio::default() },
            // Fitted to two figures of the paper's network study, with five robots: at 200 messages/s, 44 % arrived
            // within 20 ms by reliable unicast with 7 retries; at 60 messages/s, 84 % arrived by best-effort multicast.
            // The first one was fitted with an emulation of RTPS that sent less than Fast DDS does, which needs less
            // background for it (`docs/evidence/network-fit.md` has both media).
            "paper" => Radio { rate: Rate::named("ofdm-18"), noise_loss: 0.085, background: 0.6, ..Radio::default() },
            _ => return None,
        })
    }

    /// Returns the system of Bianchi's Table II (JSAC 18(3), 2000), an ad-hoc channel to compare with his model. Its
    /// values: FHSS at 1 Mbit/s, MAC header 272 bits, PHY header 128 bits, ACK 112 bits and PHY header. The contention
    /// window is 32 slots, doubled up to `stages` times, and retries are unlimited. The payload in the table, 1023
    /// bytes, is not part of the result.
    pub fn bianchi(stages: u32) -> Radio {
        let fhss = Rate::named("fhss-1");
        Radio {
            channel: Topology::AdHoc,
            rate: fhss,
            basic_rate: fhss,
            ack_rate: fhss,
            slot_us: 50,
            sifs_us: 28,
            aifsn: 2,
            propagation_us: 1,
            cw_min: 31,
            cw_max: 32 * (1 << stages) - 1,
            counting: Counting::Edca,
            after_error: Recovery::Difs,
            retries: u32::MAX,
            overhead_bytes: 34,
            ..Radio::default()
        }
    }
}
