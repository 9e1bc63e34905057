//! The register map, as far as it is modelled.

pub(super) struct Register {
    pub bank: u8,
    pub address: u8,
    /// Name in the data sheet.
    pub name: &'static str,
    /// Value after a reset.
    pub reset: u8,
    /// Bits that a write can change.
    pub writable: u8,
    /// Writable bits that are modelled, or that have no visible effect here.
    pub modelled: u8,
}

const fn r(bank: u8, address: u8, name: &'static str, bits: [u8; 3]) -> Register {
    let [reset, writable, modelled] = bits;
    Register {
        bank,
        address,
        name,
        reset,
        writable,
        modelled,
    }
}

pub(super) const DEVICE_CONFIG: u8 = 0x11;
pub(super) const ACCEL_DATA_X1: u8 = 0x1f;
pub(super) const GYRO_DATA_Z0: u8 = 0x2a;
pub(super) const INT_STATUS: u8 = 0x2d;
pub(super) const INTF_CONFIG0: u8 = 0x4c;
pub(super) const INTF_CONFIG1: u8 = 0x4d;
pub(super) const PWR_MGMT0: u8 = 0x4e;
pub(super) const GYRO_CONFIG0: u8 = 0x4f;
pub(super) const ACCEL_CONFIG0: u8 = 0x50;
pub(super) const GYRO_CONFIG1: u8 = 0x51;
pub(super) const GYRO_ACCEL_CONFIG0: u8 = 0x52;
pub(super) const ACCEL_CONFIG1: u8 = 0x53;
pub(super) const REG_BANK_SEL: u8 = 0x76;
/// Bank 1: bit 1 disables the gyroscope's anti-alias filter.
pub(super) const GYRO_CONFIG_STATIC2: u8 = 0x0b;
/// Bank 1: first of three registers of the anti-alias filter.
pub(super) const GYRO_CONFIG_STATIC3: u8 = 0x0c;
/// Bank 2: first of three registers of the accelerometer's anti-alias filter; bit 0 disables the filter.
pub(super) const ACCEL_CONFIG_STATIC2: u8 = 0x03;

/// Bits of INTF_CONFIG1 for the adaptive full-scale range, and their value for off.
pub(super) const ADAPTIVE_RANGE_BITS: u8 = 0xc0;
pub(super) const ADAPTIVE_RANGE_OFF: u8 = 0x40;

/// Registers except the data registers: reset value, writable bits, modelled bits.
pub(super) const REGISTERS: &[Register] = &[
    r(0, DEVICE_CONFIG, "DEVICE_CONFIG", [0x00, 0x11, 0x01]),
    // Slew rates have no effect here.
    r(0, 0x13, "DRIVE_CONFIG", [0x05, 0x3f, 0x3f]),
    r(0, 0x2b, "TMST_FSYNCH", [0x00, 0, 0]),
    r(0, 0x2c, "TMST_FSYNCL", [0x00, 0, 0]),
    r(0, INT_STATUS, "INT_STATUS", [0x10, 0, 0]),
    r(0, INTF_CONFIG0, "INTF_CONFIG0", [0x30, 0xf3, 0x03]),
    r(0, INTF_CONFIG1, "INTF_CONFIG1", [0x91, 0xcf, 0xc0]),
    r(0, PWR_MGMT0, "PWR_MGMT0", [0x00, 0x3f, 0x3f]),
    r(0, GYRO_CONFIG0, "GYRO_CONFIG0", [0x06, 0xef, 0xef]),
    r(0, ACCEL_CONFIG0, "ACCEL_CONFIG0", [0x06, 0xef, 0xef]),
    r(0, GYRO_CONFIG1, "GYRO_CONFIG1", [0x16, 0xef, 0x0c]),
    r(0, 0x52, "GYRO_ACCEL_CONFIG0", [0x11, 0xff, 0xff]),
    r(0, ACCEL_CONFIG1, "ACCEL_CONFIG1", [0x0d, 0x1e, 0x18]),
    r(0, 0x75, "WHO_AM_I", [0x47, 0, 0]),
    // The notch filter is not modelled, so disabling it is supported.
    r(1, 0x0b, "GYRO_CONFIG_STATIC2", [0xa0, 0x03, 0x03]),
    r(1, 0x0c, "GYRO_CONFIG_STATIC3", [0x0d, 0x3f, 0x3f]),
    r(1, 0x0d, "GYRO_CONFIG_STATIC4", [0xaa, 0xff, 0xff]),
    r(1, 0x0e, "GYRO_CONFIG_STATIC5", [0x80, 0xff, 0xff]),
    r(2, 0x03, "ACCEL_CONFIG_STATIC2", [0x30, 0x7f, 0x7f]),
    r(2, 0x04, "ACCEL_CONFIG_STATIC3", [0x40, 0xff, 0xff]),
    r(2, 0x05, "ACCEL_CONFIG_STATIC4", [0x62, 0xff, 0xff]),
];

/// Register at an address of a bank; `None` if not modelled. REG_BANK_SEL is in every bank.
pub(super) fn register(bank: u8, address: u8) -> Option<&'static Register> {
    const SELECT: Register = r(0, REG_BANK_SEL, "REG_BANK_SEL", [0x00, 0x07, 0x07]);
    if address == REG_BANK_SEL {
        return Some(&SELECT);
    }
    REGISTERS
        .iter()
        .find(|r| r.bank == bank && r.address == address)
}

/// Output data rate for GYRO_ODR or ACCEL_ODR in low-noise mode, Hz; `None` for a reserved code.
pub(super) fn rate_hz(code: u8) -> Option<f64> {
    Some(match code & 15 {
        1 => 32_000.0,
        2 => 16_000.0,
        3 => 8000.0,
        4 => 4000.0,
        5 => 2000.0,
        6 => 1000.0,
        7 => 200.0,
        8 => 100.0,
        9 => 50.0,
        10 => 25.0,
        11 => 12.5,
        15 => 500.0,
        _ => return None,
    })
}

/// Bandwidth of the user-interface filter for GYRO_UI_FILT_BW or ACCEL_UI_FILT_BW, Hz; `None` for other codes.
pub(super) fn bandwidth_hz(code: u8, rate_hz: f64) -> Option<f64> {
    let divisor = match code & 15 {
        0 => return Some(rate_hz / 2.0),
        1 => 4.0,
        2 => 5.0,
        3 => 8.0,
        4 => 10.0,
        5 => 16.0,
        6 => 20.0,
        7 => 40.0,
        _ => return None,
    };
    Some(rate_hz.max(400.0) / divisor)
}

/// Bandwidth of the anti-alias filter for AAF_DELT from 1 on, Hz (data sheet 5.3).
const ANTI_ALIAS_HZ: [u16; 63] = [
    42, 84, 126, 170, 213, 258, 303, 348, 394, 441, 488, 536, 585, 634, 684, 734, 785, 837, 890,
    943, 997, 1051, 1107, 1163, 1220, 1277, 1336, 1395, 1454, 1515, 1577, 1639, 1702, 1766, 1830,
    1896, 1962, 2029, 2097, 2166, 2235, 2306, 2377, 2449, 2522, 2596, 2671, 2746, 2823, 2900, 2978,
    3057, 3137, 3217, 3299, 3381, 3464, 3548, 3633, 3718, 3805, 3892, 3979,
];
/// Smallest AAF_DELT for each AAF_BITSHIFT from 15 down to 3.
const FIRST_OF_SHIFT: [u8; 13] = [1, 2, 2, 3, 4, 5, 7, 10, 14, 19, 27, 37, 54];

/// Bandwidth for AAF_DELT, AAF_DELTSQR and AAF_BITSHIFT together, Hz; `None` if the three values are inconsistent.
pub(super) fn anti_alias_hz(delt: u8, square: u16, shift: u8) -> Option<f64> {
    let hz = ANTI_ALIAS_HZ.get(usize::from(delt).checked_sub(1)?)?;
    // The table rounds the square to steps that grow with its value.
    let exact = i32::from(delt) * i32::from(delt);
    let square_fits = (exact - i32::from(square)).abs() <= exact / 32 + 1;
    // At the boundary of two shifts, editions of the table differ by one line.
    let first = FIRST_OF_SHIFT.get(usize::from(15u8.checked_sub(shift)?))?;
    let last = match shift {
        0..=3 => 63,
        _ => FIRST_OF_SHIFT[usize::from(16 - shift)],
    };
    (square_fits && delt + 1 >= *first && delt <= last).then(|| f64::from(*hz))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anti_alias_settings_of_the_data_sheet_are_accepted_and_others_not() {
        for (hz, delt, square, shift) in [
            (42.0, 1, 1, 15),
            (84.0, 2, 4, 13),
            (126.0, 3, 9, 12),
            (170.0, 4, 16, 11),
            (258.0, 6, 36, 10),
            (536.0, 12, 144, 8),
            (585.0, 13, 170, 8),
            (734.0, 16, 256, 7),
            (997.0, 21, 440, 6),
            (1163.0, 24, 576, 6),
            (1962.0, 37, 1376, 4),
            (3057.0, 52, 2720, 4),
            (3979.0, 63, 3968, 3),
        ] {
            assert_eq!(anti_alias_hz(delt, square, shift), Some(hz), "{hz}");
        }
        for (delt, square, shift) in [(0, 0, 15), (12, 200, 8), (12, 144, 6), (64, 4096, 3)] {
            assert_eq!(anti_alias_hz(delt, square, shift), None, "{delt}");
        }
    }

    #[test]
    fn filter_reset_values_are_in_the_table() {
        let at = |bank, address| register(bank, address).map_or(0, |r| r.reset);
        let square = u16::from(at(1, 13)) | u16::from(at(1, 14) & 15) << 8;
        assert_eq!(
            anti_alias_hz(at(1, 12), square, at(1, 14) >> 4),
            Some(585.0)
        );
        let square = u16::from(at(2, 4)) | u16::from(at(2, 5) & 15) << 8;
        assert_eq!(
            anti_alias_hz(at(2, 3) >> 1, square, at(2, 5) >> 4),
            Some(1163.0)
        );
    }

    #[test]
    fn modelled_bits_are_writable_and_addresses_are_unique() {
        for (i, r) in REGISTERS.iter().enumerate() {
            assert_eq!(r.modelled & !r.writable, 0, "{}", r.name);
            let again = REGISTERS[..i]
                .iter()
                .any(|q| (q.bank, q.address) == (r.bank, r.address));
            assert!(!again, "{}", r.name);
        }
    }
}
