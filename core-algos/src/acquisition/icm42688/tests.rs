use super::*;

/// Model of the sensor after its data sheet: banks of registers, and noisy samples once the sensor is powered up.
struct Part {
    banks: [[u8; 128]; 3],
    bank: usize,
    /// Bytes transferred in the latest step.
    bytes: usize,
    noise: u32,
    yaw_counts: i16,
    silent: bool,
    frozen: bool,
}

impl Part {
    fn new() -> Self {
        let mut part = Self {
            banks: [[0; 128]; 3],
            bank: 0,
            bytes: 0,
            noise: 1,
            yaw_counts: 0,
            silent: false,
            frozen: false,
        };
        part.reset();
        part
    }

    /// Sets every register to its reset value of the register map.
    fn reset(&mut self) {
        self.banks = [[0; 128]; 3];
        self.bank = 0;
        let values = [
            (0, 0x2d, 0x10),
            (0, 0x4c, 0x30),
            (0, 0x4d, 0x91),
            (0, 0x4f, 0x06),
            (0, 0x50, 0x06),
            (0, 0x51, 0x16),
            (0, 0x52, 0x11),
            (0, 0x53, 0x0d),
            (0, 0x75, 0x47),
            (1, 0x0c, 0x0d),
            (1, 0x0d, 0xaa),
            (1, 0x0e, 0x80),
            (2, 0x03, 0x30),
            (2, 0x04, 0x40),
            (2, 0x05, 0x62),
        ];
        for (bank, address, value) in values {
            self.banks[bank][address] = value;
        }
    }

    fn sample(&mut self) {
        let on = self.banks[0][0x4e] == 0x0f;
        for axis in 0..6 {
            let next = self.noise.wrapping_mul(1_664_525);
            self.noise = next.wrapping_add(1_013_904_223);
            let noise = (self.noise >> 29) as i16 - 4;
            let value = match (on, axis) {
                (false, _) => i16::MIN,
                (true, 5) => self.yaw_counts + noise,
                (true, 2) => 16_384 + noise,
                (true, _) => noise,
            };
            let [high, low] = value.to_be_bytes();
            self.banks[0][0x1f + 2 * axis] = high;
            self.banks[0][0x20 + 2 * axis] = low;
        }
    }

    fn transfer(&mut self, bytes: &mut [u8]) -> bool {
        self.bytes += bytes.len();
        if !self.frozen {
            self.sample();
        }
        let first = usize::from(bytes[0] & 0x7f);
        let read = bytes[0] & 0x80 != 0;
        for (address, byte) in (first..).zip(&mut bytes[1..]) {
            let bank = if address == 0x76 { 0 } else { self.bank };
            let cell = &mut self.banks[bank][address];
            match (read, self.silent) {
                (true, true) => *byte = 0xff,
                (true, false) => {
                    *byte = *cell;
                    if (bank, address) == (0, 0x2d) {
                        *cell = 0;
                    }
                }
                (false, true) => {}
                (false, false) if address == 0x76 => self.bank = usize::from(*byte),
                (false, false) if (bank, address) == (0, 0x11) => {
                    if *byte == 1 {
                        self.reset();
                    }
                }
                (false, false) => *cell = *byte,
            }
        }
        true
    }
}

/// Registers 0x4e to 0x53: ±250 °/s and ±2 g at 8 kHz, UI filters of second order at a twentieth of the rate.
const SET_UP: [u8; 6] = [0x0f, 0x63, 0x63, 0x16, 0x66, 0x0d];

fn step(sensor: &mut Icm42688, part: &mut Part, still: bool) -> Reading {
    part.bytes = 0;
    let reading = sensor.step(still, |bytes| part.transfer(bytes));
    // At 10.5 MHz, 18 bytes take 14 µs.
    assert!(part.bytes <= 18, "{}", part.bytes);
    reading
}

/// Runs the driver for `ms` milliseconds with the motors off.
fn rest(sensor: &mut Icm42688, part: &mut Part, ms: usize) {
    for _ in 0..ms {
        step(sensor, part, true);
    }
}

/// Driver and sensor after `ms` milliseconds with the motors off.
fn after(ms: usize) -> (Icm42688, Part) {
    let (mut sensor, mut part) = (Icm42688::new(1.0, 1.0).unwrap(), Part::new());
    rest(&mut sensor, &mut part, ms);
    (sensor, part)
}

/// Number of steps, motors on, until the sensor is lost.
fn until_lost(sensor: &mut Icm42688, mut transfer: impl FnMut(&mut [u8]) -> bool) -> usize {
    let lost = (1..10_000).find(|_| {
        sensor.step(false, &mut transfer);
        sensor.is_lost()
    });
    lost.unwrap()
}

#[test]
fn registers_are_those_of_the_data_sheet() {
    let (sensor, part) = after(100);
    assert!(sensor.is_set_up() && !sensor.is_lost());
    assert_eq!(part.bank, 0);
    assert_eq!(part.banks[0][0x4e..0x54], SET_UP);
    // The reset values are 0x30 and 0x91. The set-up writes 11 to bits 1 and 0 of the first register, 01 to bits 7 and
    // 6 of the second, and keeps the other bits.
    assert_eq!(part.banks[0][0x4c..0x4e], [0x33, 0x51]);
    // 536 Hz: delta 12, its square 144, shift 8. The accelerometer's delta shares its register with a disable bit.
    assert_eq!(part.banks[1][0x0c..0x0f], [0x0c, 0x90, 0x80]);
    assert_eq!(part.banks[2][0x03..0x06], [0x18, 0x90, 0x80]);
}

#[test]
fn set_up_succeeds_from_any_selected_bank() {
    let (mut sensor, mut part) = (Icm42688::new(1.0, 1.0).unwrap(), Part::new());
    part.bank = 2;
    rest(&mut sensor, &mut part, 100);
    assert!(sensor.is_set_up() && !sensor.is_lost());
    assert_eq!(part.banks[0][0x52], 0x66);
}

#[test]
fn yaw_rate_is_read_once_the_bias_is_known() {
    let (mut sensor, mut part) = after(1200);
    part.yaw_counts = 1310;
    let reading = step(&mut sensor, &mut part, false);
    // 131 counts per °/s; the noise of the part is ±4 counts.
    let yaw = reading.gyro_rad_s.unwrap();
    assert!((yaw - 10f32.to_radians()).abs() < 6e-4, "{yaw}");
    assert!(reading.acceleration_m_s2.unwrap().abs() < 6e-3);
    for gain in [0.0, f32::NAN] {
        assert!(Icm42688::new(gain, 1.0).is_err());
    }
}

/// The sensor is lost at once and set up again; readings return only after 1 s of standstill.
#[test]
fn reset_is_detected_at_once_and_the_bias_is_estimated_again() {
    let (mut sensor, mut part) = after(1200);
    part.reset();
    assert_eq!(step(&mut sensor, &mut part, false), Reading::default());
    assert!(sensor.is_lost());
    for _ in 0..5000 {
        assert_eq!(step(&mut sensor, &mut part, false), Reading::default());
    }
    assert!(sensor.is_lost() && sensor.is_set_up());
    assert_eq!(part.banks[0][0x4e..0x54], SET_UP);
    rest(&mut sensor, &mut part, 1000);
    assert!(!sensor.is_lost());
    assert!(step(&mut sensor, &mut part, false).gyro_rad_s.is_some());
}

#[test]
fn a_changed_register_is_found_and_a_disturbed_transfer_is_not_a_loss() {
    for (address, bit) in [
        (0x4c, 0x01),
        (0x4c, 0x10),
        (0x4d, 0x01),
        (0x4d, 0x40),
        (0x4d, 0x80),
        (0x4e, 0x01),
        (0x4f, 0x01),
        (0x50, 0x01),
        (0x51, 0x01),
        (0x52, 0x01),
        (0x53, 0x01),
    ] {
        let (mut sensor, mut part) = after(1200);
        part.banks[0][address] ^= bit;
        let steps = until_lost(&mut sensor, |bytes| part.transfer(bytes));
        // Nine registers, one every 17 ms.
        assert!(steps <= 9 * 17 + 2, "{address:#x}: {steps}");
    }
    let (mut sensor, mut part) = after(1200);
    let mut requests = 0;
    for _ in 0..3000 {
        sensor.step(false, |bytes| {
            let done = part.transfer(bytes);
            if bytes.len() == 2 {
                requests += 1;
                bytes[1] ^= if requests % 2 == 0 { 0x80 } else { 0 };
            }
            done
        });
    }
    assert!(requests > 100);
    assert!(!sensor.is_lost());
}

#[test]
fn stuck_line_or_frozen_sample_loses_the_sensor() {
    let low = |bytes: &mut [u8]| {
        bytes.fill(0);
        true
    };
    let fails = |_: &mut [u8]| false;
    // If the data line is held low, a register reads back wrong. Failed transfers count like repeated samples.
    type Transfer = fn(&mut [u8]) -> bool;
    let broken: [(Transfer, usize); 2] = [(low, 18), (fails, 51)];
    for (transfer, within) in broken {
        let (mut sensor, _) = after(1200);
        let steps = until_lost(&mut sensor, transfer);
        assert!(steps <= within, "{steps}");
    }
    // If the data line is held high, the interrupt status reports a reset.
    let (mut sensor, mut part) = after(1200);
    part.silent = true;
    step(&mut sensor, &mut part, false);
    assert!(sensor.is_lost());
    // The set-up is repeated until the sensor answers.
    for _ in 0..1000 {
        assert_eq!(step(&mut sensor, &mut part, true), Reading::default());
    }
    part.silent = false;
    rest(&mut sensor, &mut part, 1300);
    assert!(!sensor.is_lost());

    let (mut sensor, mut part) = after(1200);
    part.frozen = true;
    let steps = until_lost(&mut sensor, |bytes| part.transfer(bytes));
    assert!(steps <= 51, "{steps}");
}

/// Each of the first transfers fails once; the set-up still ends with the required registers.
#[test]
fn a_failed_transfer_in_the_set_up_leaves_no_wrong_register() {
    for failing in 0..40 {
        let (mut sensor, mut part) = (Icm42688::new(1.0, 1.0).unwrap(), Part::new());
        let mut transfers = 0;
        for _ in 0..3000 {
            sensor.step(true, |bytes| {
                transfers += 1;
                transfers != failing + 1 && part.transfer(bytes)
            });
        }
        assert!(!sensor.is_lost(), "{failing}");
        assert_eq!(part.banks[0][0x4c..0x4e], [0x33, 0x51], "{failing}");
        assert_eq!(part.banks[0][0x4e..0x54], SET_UP, "{failing}");
    }
}

#[test]
fn absent_sensor_is_lost() {
    let (mut sensor, mut part) = (Icm42688::new(1.0, 1.0).unwrap(), Part::new());
    part.silent = true;
    rest(&mut sensor, &mut part, 10);
    assert!(sensor.is_lost() && !sensor.is_set_up());
}
