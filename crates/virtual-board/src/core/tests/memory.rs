//! Special loads and stores; modified code.

use super::*;

#[test]
fn changed_code_in_ram_is_executed() {
    // The program writes movs r2, #imm; bx lr to RAM and calls this code, twice.
    let mut machine = Machine::new(&[
        0x4604, // mov r4, r0
        0x6001, // str r1, [r0]
        0x1c43, // adds r3, r0, #1
        0x4798, // blx r3
        0x4615, // mov r5, r2
        0x3101, // adds r1, #1
        0x6021, // str r1, [r4]
        0x4798, // blx r3
        0xbe00, // bkpt
    ])
    .registers(&[(0, LOG), (1, 0x4770_2240)]);
    machine.run_to_breakpoint();
    assert_eq!((machine.r(5), machine.r(2)), (0x40, 0x41));
}

#[test]
fn changed_code_in_flash_is_decoded_again() {
    let mut machine = Machine::new(&[0x2001, 0xbe00, 0xe7fc]);
    machine.run_to_breakpoint();
    assert_eq!(machine.r(0), 1);
    machine.chip.program(CODE, &[0x2002]);
    machine.go_on();
    assert_eq!(machine.r(0), 2);
}

#[test]
fn each_line_of_16_bytes_is_entered_once() {
    // Fifteen nops from the start of a line; the next instruction, 32 bits wide, crosses a line boundary.
    let mut program = vec![0xbf00u16; 15];
    program.extend([0xf04f, 0x0001, 0xbe00]);
    let mut machine = Machine::new(&program);
    machine.run_to_breakpoint();
    assert_eq!(machine.chip.entered, [CODE, CODE + 16, CODE + 32]);
}

#[test]
fn identification_registers_match_the_chip() {
    let mut machine = Machine::new(&[0xbe00]);
    assert_eq!(machine.private(0xe000_ed00), 0x410f_c241);
    assert_eq!(machine.private(0xe000_e004), 2);
    assert_eq!(machine.private(0xe000_ed90), 0x800);
    assert_eq!(machine.private(0xe000_ef40), 0x1011_0021);
}

#[test]
fn priority_registers_allow_byte_access() {
    // strb r1, [r0, #2]; ldrb r2, [r0, #2]; bkpt
    let mut machine = Machine::new(&[0x7081, 0x7882, 0xbe00]).registers(&[(0, IPR0), (1, 0x57)]);
    machine.set_private(IPR0, 0x1122_3344);
    machine.run_to_breakpoint();
    assert_eq!(machine.private(IPR0), 0x1050_3040);
    assert_eq!(machine.r(2), 0x50);
    assert!(machine.chip.notes.is_empty());
}
