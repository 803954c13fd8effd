//! Reading of frames among noise and other frames: which share is read at which ratio of powers.
//!
//! A receiver adds the powers of other frames to its noise. The success of a whole frame is the product of those of its
//! parts, each with the ratio that it had.

use super::rate::Rate;

/// Bits of a frame to which the table refers: 236 bytes of data and a MAC header of 24.
const REFERENCE_BITS: f64 = 8.0 * 260.0;

/// Ratio of the powers at which half of the frames of `REFERENCE_BITS` are read \[dB\], by rate.
///
/// At 1, 6, 12, 24 and 54 Mbit/s these are fits to two frames that overlap, and to a sender at growing distance, in
/// ns-3 3.44, whose curves are simulations of the link (AWGN, IEEE 802.11-14/0571r12). Those between follow from the
/// steps between rates of coding: 2.5 dB from 1/2 to 3/4 of BPSK and QPSK, 3.4 dB of 16-QAM, 1.2 dB from 2/3 to 3/4 and
/// 1.4 dB to 5/6 of 64-QAM. CCK and differential QPSK need 7 to 8 dB of Eb/N0.
fn half_db(rate: Rate) -> f64 {
    match rate.name() {
        "fhss-1" | "dsss-1" => -4.8,
        "dsss-2" => -1.1,
        "dsss-5.5" => 1.5,
        "dsss-11" => 4.5,
        "ofdm-6" | "ht-mcs0" => -0.37,
        "ofdm-9" => 2.2,
        "ofdm-12" | "ht-mcs1" => 2.75,
        "ofdm-18" | "ht-mcs2" => 5.3,
        "ofdm-24" | "ht-mcs3" => 8.28,
        "ofdm-36" | "ht-mcs4" => 11.7,
        "ofdm-48" | "ht-mcs5" => 15.65,
        "ofdm-54" | "ht-mcs6" => 16.85,
        _ => 18.25,
    }
}

/// Growth of the rate of errors with a falling ratio \[1/dB\], of DSSS and of OFDM: fits to the same runs.
const GROWTH_PER_DB: [f64; 2] = [1.8, 2.35];

/// Returns the logarithm of the probability that `bits` bits of a frame at `rate` are read, at a ratio `snr_db` of its
/// power to noise and others \[dB\]. Errors of bits are rare and independent, and their number grows exponentially as
/// the ratio falls.
pub(super) fn ln_read(rate: Rate, snr_db: f64, bits: f64) -> f64 {
    let [serial, ofdm] = GROWTH_PER_DB;
    let growth = if rate.is_serial() { serial } else { ofdm };
    -std::f64::consts::LN_2 * bits / REFERENCE_BITS * libm::exp(growth * (half_db(rate) - snr_db))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(rate: &'static str, snr_db: f64, bytes: f64) -> f64 {
        libm::exp(ln_read(Rate::named(rate), snr_db, 8.0 * bytes))
    }

    #[test]
    fn half_of_the_frames_are_read_where_ns_3_reads_half() {
        let half = [("dsss-1", -4.7), ("ofdm-6", -0.3), ("ofdm-12", 2.75), ("ofdm-24", 8.3), ("ofdm-54", 16.9)];
        for (rate, snr_db) in half {
            let share = read(rate, snr_db, 260.0);
            assert!((0.35..0.65).contains(&share), "{rate}: {share}");
            assert!(read(rate, snr_db + 2.5, 260.0) > 0.98 && read(rate, snr_db - 2.5, 260.0) < 0.02, "{rate}");
        }
    }

    #[test]
    fn shorter_frames_are_read_more_often_and_faster_ones_less() {
        assert!(read("ofdm-6", 0.0, 100.0) > read("ofdm-6", 0.0, 1500.0));
        let rates = ["ofdm-6", "ofdm-9", "ofdm-12", "ofdm-18", "ofdm-24", "ofdm-36", "ofdm-48", "ofdm-54", "ht-mcs7"];
        let all: Vec<f64> = rates.iter().map(|rate| ln_read(Rate::named(rate), 5.0, 2080.0)).collect();
        assert!(all.windows(2).all(|pair| pair[0] > pair[1]), "{all:?}");
    }
}
