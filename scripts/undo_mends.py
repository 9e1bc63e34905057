#!/usr/bin/env python3
"""Undoes what was mended in the firmware, one at a time, and checks that virtual boards show it.

For each mend a copy of the work tree (target/undone/tree) is changed back, the image is built, and
the run that docs/virtual_boards.md names is done twice: with that image it must go wrong, in the words
or beyond the figure given here, and with the image as it is it must be right. Fails if a mend undone
goes unnoticed. The checkout itself is not touched.

With CFMMR_BUILT set, target/release/cfmmr is taken as it is.
"""

import argparse
import dataclasses
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
PLACE = ROOT / "target" / "undone"
TREE, BUILD, IMAGES = PLACE / "tree", PLACE / "build", PLACE / "images"
TARGET = "thumbv7em-none-eabihf"
CFMMR = ROOT / "target" / "release" / "cfmmr"
LIMIT_S = 600

AXLE, BEAM = "axle", "beam"
VCD = "waves.vcd"


class Trouble(Exception):
    """What keeps a mend from being tried."""


@dataclasses.dataclass(frozen=True)
class Edit:
    """Text of a file that stands there once, and what undoes it."""

    file: str
    now: str
    undone: str

    def apply(self):
        path = TREE / self.file
        text = path.read_text()
        if (count := text.count(self.now)) != 1:
            raise Trouble(f"{self.file}: {count} times instead of once: {self.now.strip()!r}")
        path.write_text(text.replace(self.now, self.undone))


class Row:
    """A row of `cfmmr faults --virtual`: one run, or all of them where only some show it."""

    def __init__(self, fault, *extent):
        self.fault = fault
        self.command = ["faults", "--virtual", *(extent or ["--quick"]), "--only", fault]

    def __str__(self):
        return self.fault

    def judge(self, result, said):
        """Whether a run was right, and in words how it ended."""
        rows = [row for row in (result or {}).get("rows", []) if row["fault"] == self.fault]
        if not rows:
            return (False, last_line(said))
        wrong = [run["end"]["wrong"] for run in rows[0]["outcomes"] if run["end"] not in RIGHT]
        if wrong:
            return (False, wrong[0])
        return (True, ", ".join(sorted({run["end"] for run in rows[0]["outcomes"]})))


RIGHT = ("went-on", "stopped")


class Drive:
    """The first seconds of `cfmmr hil --virtual`, and a figure of its boards that has a limit."""

    def __init__(self, column, most, *options, seconds=4):
        self.column, self.most, self.options = column, most, options
        self.command = ["hil", "--virtual", "--stop-after", str(seconds), *options]

    def __str__(self):
        return " ".join(["run", *self.options])

    def judge(self, result, said):
        if not result:
            return (False, last_line(said))
        figure = max(of_board(board, self.column) for board in result["boards"])
        return (figure <= self.most, f"{self.column} {figure:.6g}")


class Told(Drive):
    """The first seconds of `cfmmr hil --virtual`, in which a node must tell of a condition."""

    def __init__(self, condition, *options):
        super().__init__(condition, None, *options)

    def judge(self, result, said):
        if not result:
            return (False, last_line(said))
        notices = {notice for node in result["nodes"] for notice in node["notices"]}
        return (self.column in notices, f"told: {', '.join(sorted(notices))}")


class Edges(Drive):
    """The same, in which no edge of the pulses may lie within the sampling of a current or shortly before."""

    # From the end of the four conversions, which raise the interrupt, back to the end of the second current's
    # sampling, and from there to its first instant at which an edge would disturb; ns.
    BACK, CLEAR = 4_380, 6_000
    BOARD, PULSES, CONVERTED = "front", ("PA8", "PA9"), "ADC"

    def __init__(self):
        super().__init__("currents sampled beside an edge", 0, "--vcd", VCD, seconds=2)

    def judge(self, result, said):
        if not result:
            return (False, last_line(said))
        beside, count = self.count(result[VCD])
        return (count > 0 and beside == 0, f"{beside} of {count} {self.column}")

    def count(self, waves):
        """Of how many samples there were, those beside an edge, and all."""
        scopes, names, levels, edges, now = [], {}, {}, [], 0
        beside = count = 0
        for line in waves:
            match line.split():
                case ["$scope", _, name, _]:
                    scopes.append(name)
                case ["$upscope", _]:
                    scopes.pop()
                case ["$var", _, _, code, name, _] if scopes[0] == self.BOARD:
                    if name in (*self.PULSES, self.CONVERTED):
                        names[code] = name
                case [text] if text[0] == "#":
                    now = int(text[1:])
                case [text] if text[0] in "01" and (name := names.get(text[1:])):
                    changes = levels.get(name) != text[0]
                    levels[name] = text[0]
                    if name in self.PULSES and changes:
                        edges = [*edges[-7:], now]
                    elif changes and text[0] == "1" and edges:
                        count += 1
                        beside += any(0 <= now - self.BACK - edge < self.CLEAR for edge in edges)
        return beside, count


def of_board(board, column):
    """A figure of a board in the result of a run."""
    value = board["can"][column] if column in board["can"] else board[column]
    return len(value) if isinstance(value, list) else value or 0


def last_line(said):
    """The last line of what a program said."""
    lines = said.strip().splitlines()
    return lines[-1] if lines else "nothing was said"


@dataclasses.dataclass(frozen=True)
class Mend:
    """A mend: what undoes it, which images that changes, the runs that show it and their words."""

    name: str
    edits: tuple
    images: tuple
    run: object
    words: str = ""


MENDS = (
    Mend(
        "start with little stack",
        (
            Edit(
                "firmware-axle/src/robot.rs",
                "    NODES.init_with(|| nodes.begin())\n",
                # The start needed 97 kB when copies were made on the way.
                "    core::hint::black_box([0u8; 80 << 10]);\n"
                "    NODES.init_with(|| nodes.begin())\n",
            ),
        ),
        (AXLE,),
        Drive("resets", 0),
    ),
    Mend(
        "the beam's converter stays on",
        (
            Edit(
                "firmware-beam/src/robot/bridges/converter.rs",
                "        run(0);\n",
                # What dropping the HAL's converter does.
                "        run(0);\n"
                "        pac::ADC1.cr2().modify(|w| {\n"
                "            w.set_adon(false);\n"
                "            w.set_dma(false);\n"
                "        });\n"
                "        rcc::disable::<ADC1>();\n",
            ),
        ),
        (BEAM,),
        Drive("resets", 0),
    ),
    Mend(
        "requests to the stream after an overrun",
        (
            Edit(
                "firmware-beam/src/robot/bridges/converter.rs",
                "        w.set_dma(true);\n",
                "        w.set_dma(wait == 0);\n",
            ),
        ),
        (BEAM,),
        Row("converter overrun: the DMA stalls for 1 ms"),
    ),
    Mend(
        "the scan begins anew after an overrun",
        (
            Edit(
                "firmware-beam/src/robot/bridges/converter.rs",
                "    stream.ndtr().write(|w| w.set_ndt(2 * BLOCK as u16));\n",
                "    if wait == 0 {\n"
                "        stream.ndtr().write(|w| w.set_ndt(2 * BLOCK as u16));\n"
                "    }\n",
            ),
            Edit(
                "firmware-beam/src/robot/bridges/converter.rs",
                "    pac::ADC1.cr2().write(|_| {});\n",
                "    pac::ADC1.cr2().modify(|w| w.set_dma(false));\n",
            ),
        ),
        (BEAM,),
        Row("converter overrun: the DMA stalls for 1 ms"),
    ),
    Mend(
        "no frame displaces another",
        (
            Edit(
                "firmware-common/src/can/controller.rs",
                "        } else {\n            break;\n        }\n        let _ = TO_SEND.try_receive();\n",
                """        } else if joined {
            // The least urgent one gives up its place and is written back next.
            let id = |m: usize| CAN1.tx(m).tir().read().stid();
            let mailbox = (0..COUNT).max_by_key(|&m| id(m)).unwrap_or(0);
            CAN1.tsr().write(|w| w.set_abrq(mailbox, true));
            while !CAN1.tsr().read().tme(mailbox) {}
            let sent = CAN1.tsr().read().txok(mailbox);
            CAN1.tsr().write(|w| w.set_rqcp(mailbox, true));
            let registers = CAN1.tx(mailbox);
            let mut data = [0; 8];
            data[..4].copy_from_slice(&registers.tdlr().read().0.to_le_bytes());
            data[4..].copy_from_slice(&registers.tdhr().read().0.to_le_bytes());
            let displaced = bus::Frame {
                id: registers.tir().read().stid(),
                length: registers.tdtr().read().dlc(),
                data,
            };
            let _ = TO_SEND.try_receive();
            if mailboxes.release(mailbox).is_some() && !sent {
                let _ = TO_SEND.try_send((now, displaced));
            }
            mailboxes.fill(
                mailbox,
                Waiting {
                    id: frame.id,
                    since: now,
                },
            );
            request(mailbox, &frame);
            interrupt::CAN1_TX.pend();
            break;
        } else {
            break;
        }
        let _ = TO_SEND.try_receive();
""",
            ),
        ),
        (AXLE, BEAM),
        Row("no acknowledgement from the start"),
    ),
    Mend(
        "arrivals are stamped in the handler",
        (
            Edit(
                "firmware-common/src/can/controller.rs",
                "            let (local, frame) = TO_TAKE.try_receive().ok()?;\n",
                "            let (_, frame) = TO_TAKE.try_receive().ok()?;\n"
                "            let local = Instant::now().as_micros();\n",
            ),
        ),
        (AXLE, BEAM),
        Drive("missed_ticks", 0, seconds=8),
    ),
    Mend(
        "the FIFO is emptied above the tick",
        (
            Edit(
                "firmware-common/src/can/controller.rs",
                "    (Sender(()), Receiver(()))\n",
                "    interrupt::CAN1_RX0.set_priority(Priority::P8);\n"
                "    (Sender(()), Receiver(()))\n",
            ),
        ),
        (AXLE, BEAM),
        Drive("overrun", 0),
    ),
    Mend(
        "prefetch and caches of the flash",
        (Edit("firmware-common/src/board.rs", "        crate::accelerator::enable();\n", ""),),
        (AXLE, BEAM),
        Drive("longest_tick_us", 600),
    ),
    Mend(
        "the lead node's work is spread over ticks",
        (
            Edit(
                "core-algos/src/node/board.rs",
                "                    lead.prepare();\n",
                "                    let _ = lead;\n",
            ),
        ),
        (AXLE,),
        Drive("longest_tick_us", 600),
    ),
    Mend(
        "the log never waits",
        (
            Edit(
                "firmware-common/Cargo.toml",
                'defmt-rtt = { version = "1", features = ["disable-blocking-mode"] }\n',
                'defmt-rtt = "1"\n',
            ),
        ),
        (AXLE,),
        Row("log host stops reading, buffer in blocking mode"),
    ),
    Mend(
        "the stop is TIM1's break",
        (
            Edit(
                "firmware-axle/src/robot/motors/timer.rs",
                "        w.set_bke(0, true);\n",
                "        w.set_bke(0, false);\n",
            ),
        ),
        (AXLE,),
        Row("emergency stop while the current loop hangs"),
    ),
    Mend(
        "the start does not wait for the bus",
        (
            Edit(
                "firmware-common/src/can/controller.rs",
                "    (Sender(()), Receiver(()))\n",
                "    while !is_joined() {\n"
                "        join();\n"
                "    }\n"
                "    (Sender(()), Receiver(()))\n",
            ),
        ),
        (AXLE, BEAM),
        Row("bus held dominant from the start"),
    ),
    Mend(
        "guard below the stack",
        (Edit("firmware-common/src/board.rs", "    stack::guard();\n", ""),),
        (AXLE,),
        Row("stack overflow"),
    ),
    Mend(
        "the stack lies below the variables",
        (
            Edit("firmware-common/src/board.rs", "    stack::guard();\n", ""),
            Edit(
                "memory.x",
                "  STACK : ORIGIN = 0x20000000, LENGTH = 80K\n"
                "  RAM   : ORIGIN = 0x20000000 + 80K, LENGTH = 128K - 80K\n",
                "  STACK : ORIGIN = 0x20000000 + 48K, LENGTH = 80K\n"
                "  RAM   : ORIGIN = 0x20000000, LENGTH = 128K - 80K\n",
            ),
        ),
        (AXLE,),
        Row("stack overflow"),
    ),
    Mend(
        "nFAULT is believed when it lasts",
        (
            Edit(
                "firmware-axle/src/robot/motors.rs",
                "const FAULT_PERIODS: u16 = 4;\n",
                "const FAULT_PERIODS: u16 = 1;\n",
            ),
        ),
        (AXLE,),
        Row("nFAULT low for 30 µs"),
    ),
    Mend(
        "currents are sampled away from edges",
        (
            Edit(
                "firmware-axle/src/robot/motors/timer.rs",
                "        let trigger = SAMPLING.compare(compares);\n",
                "        let trigger = COUNTS_PER_US / 2;\n",
            ),
        ),
        (AXLE,),
        Edges(),
    ),
    Mend(
        "a bus error holds nothing up",
        (
            Edit(
                "firmware-common/src/can/controller.rs",
                "    CAN1.ier().write_value(interrupts(false));\n",
                "    CAN1.ier().write_value(Ier(0));\n",
            ),
        ),
        (AXLE, BEAM),
        Row("bus wrong in 1 bit of 100000"),
    ),
    Mend(
        "tolerance of the bit clock",
        (
            Edit(
                "firmware-common/src/can/bit_timing.rs",
                "const QUANTA: u32 = 14;\n",
                "const QUANTA: u32 = 7;\n",
            ),
            Edit(
                "firmware-common/src/can/bit_timing.rs",
                "const SEGMENT_2: u32 = 3;\n",
                "const SEGMENT_2: u32 = 1;\n",
            ),
        ),
        (AXLE, BEAM),
        Row("beam board 1.2 % fast"),
    ),
    Mend(
        "limits of the supply are parameters",
        (
            Edit(
                "firmware-axle/src/robot/tick.rs",
                "below(drive.supply_warning_v)",
                "below(10.5)",
            ),
        ),
        (AXLE,),
        Told("supply near its limit", "--set", "boards.front.drive.supply_warning_v=12.5"),
    ),
    Mend(
        "filter of the encoder inputs",
        (
            Edit(
                "firmware-axle/src/robot/encoders.rs",
                "FilterValue::FDTS_DIV32_N8",
                "FilterValue::NO_FILTER",
            ),
        ),
        (AXLE,),
        Row("2000 glitches of 200 ns on encoder lines"),
    ),
    Mend(
        "a reset of the inertial sensor is noticed",
        (
            Edit(
                "core-algos/src/acquisition/icm42688.rs",
                "        if status & RESET_DONE != 0 || self.repeats >= STUCK {\n",
                "        if status & RESET_DONE != 0 && self.repeats >= STUCK {\n",
            ),
            Edit(
                "core-algos/src/acquisition/icm42688.rs",
                "        if !right && doubted {\n",
                "        if false {\n",
            ),
        ),
        (AXLE,),
        Row("inertial sensor resets itself"),
    ),
    Mend(
        "caches are emptied after an erase",
        (
            Edit(
                "firmware-common/src/store/chip.rs",
                "        accelerator::flush();\n",
                "",
            ),
            Edit(
                "firmware-common/src/store/chip.rs",
                "use crate::accelerator;\n",
                "",
            ),
        ),
        (BEAM,),
        Row("power cut in an erase"),
    ),
    Mend(
        "the watchdog runs before the clocks",
        (
            Edit(
                "firmware-axle/src/robot.rs",
                "    let watchdog = Watchdog::start();\n    match start(board::start(), watchdog).await {\n",
                "    let peripherals = board::start();\n"
                "    match start(peripherals, Watchdog::start()).await {\n",
            ),
            Edit(
                "firmware-beam/src/robot.rs",
                "    let watchdog = Watchdog::start();\n"
                "    if let Err(error) = start(board::start(), watchdog, spawner) {\n",
                "    let peripherals = board::start();\n"
                "    if let Err(error) = start(peripherals, Watchdog::start(), spawner) {\n",
            ),
        ),
        (AXLE, BEAM),
        Row("crystal dead for the first 2.5 s"),
    ),
    Mend(
        "the crystal is watched",
        (
            Edit(
                "firmware-common/src/board.rs",
                "        RCC.cr().modify(|w| w.set_csson(true));\n",
                "",
            ),
        ),
        (AXLE,),
        Row("crystal of an axle's board fails for good"),
    ),
    Mend(
        "a board that begins anew says so",
        (
            Edit(
                "firmware-axle/src/robot/tick.rs",
                "                state.restarted |= state.driving;\n",
                "",
            ),
        ),
        (AXLE,),
        Row("debugger halts an axle's board for 10 ms", "--seeds", "2"),
    ),
    Mend(
        "a late conversion is left out",
        (
            Edit(
                "firmware-beam/src/robot/bridges/converter.rs",
                "    if BETWEEN.contains(&pac::TIM2.cnt().read()) {\n",
                "    if !BETWEEN.is_empty() {\n",
            ),
        ),
        (BEAM,),
        Row("bus wrong in 1 bit of 100", "--seeds", "2"),
    ),
)


def copy_tree():
    """Brings the copy up to date; what is equal stays untouched, so that little is built anew."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    names = {name for name in names.split("\0") if name and (ROOT / name).is_file()}
    for name in names:
        source, copy = ROOT / name, TREE / name
        if not copy.is_file() or source.read_bytes() != copy.read_bytes():
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, copy)
    for copy in [path for path in TREE.rglob("*") if path.is_file()]:
        if str(copy.relative_to(TREE)) not in names:
            copy.unlink()


def build(boards, folder):
    """Builds the images of these boards from the copy into a folder."""
    command = ["cargo", "build", "--locked", "--quiet", "--release", "--target", TARGET]
    for board in boards:
        command += ["--package", f"firmware-{board}"]
    environment = {**os.environ, "CARGO_TARGET_DIR": str(BUILD), "CARGO_INCREMENTAL": "0"}
    done = subprocess.run(command, cwd=TREE, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        raise Trouble(f"cannot be built:\n{done.stderr.strip()}")
    folder.mkdir(parents=True, exist_ok=True)
    for board in boards:
        shutil.copyfile(BUILD / TARGET / "release" / f"firmware-{board}", folder / board)


def execute(run, images):
    """Does a run with these images; gives its result, if it has one, and what it said."""
    with tempfile.TemporaryDirectory(dir=PLACE) as place:
        out = pathlib.Path(place) / "result.json"
        command = [CFMMR, *run.command, "--json", out]
        command += ["--axle-image", images[AXLE], "--beam-image", images[BEAM]]
        if run.command[0] == "hil":
            command += ["--out", place]
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=LIMIT_S)
        result = json.loads(out.read_text()) if out.is_file() else None
        if result and VCD in run.command:
            with open(pathlib.Path(place) / VCD) as waves:
                result[VCD] = list(waves)
        if done.returncode == 2:
            raise Trouble(last_line(done.stderr))
        return (result, done.stderr)


def undo(mend, as_it_is):
    """Undoes a mend and does its run with and without; gives a row of the table."""
    copy_tree()
    for edit in mend.edits:
        edit.apply()
    folder = IMAGES / "undone"
    try:
        build(mend.images, folder)
        images = as_it_is.images | {board: folder / board for board in mend.images}
        right, now = as_it_is.run(mend.run)
        goes_right, undone = mend.run.judge(*execute(mend.run, images))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return {
        "mend": mend.name,
        "run": str(mend.run),
        "now": now,
        "undone": undone,
        "shown": right and not goes_right and mend.words in undone,
    }


class AsItIs:
    """The images as they are; each run is done once."""

    def __init__(self):
        copy_tree()
        folder = IMAGES / "now"
        build((AXLE, BEAM), folder)
        self.images = {board: folder / board for board in (AXLE, BEAM)}
        self.runs = {}

    def run(self, wanted):
        key = tuple(wanted.command)
        if key not in self.runs:
            self.runs[key] = execute(wanted, self.images)
        return wanted.judge(*self.runs[key])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", metavar="TEXT", help="only mends with this in their name")
    parser.add_argument("--list", action="store_true", help="list the mends")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    wanted = [m for m in MENDS if not options.only or any(text in m.name for text in options.only)]
    if not wanted:
        sys.exit(f"undo_mends.py: no mend has {' or '.join(options.only)} in its name")
    if options.list:
        for mend in wanted:
            print(f"{mend.name}: {mend.run}")
        return
    if "CFMMR_BUILT" not in os.environ:
        command = ["cargo", "build", "--locked", "--quiet", "--release", "--package", "host-sim"]
        subprocess.run(command, cwd=ROOT, check=True)
    try:
        as_it_is = AsItIs()
        print("| mend | run | as it is | undone |\n|---|---|---|---|")
        rows = []
        for mend in wanted:
            try:
                row = undo(mend, as_it_is)
            except Trouble as trouble:
                row = {"mend": mend.name, "run": str(mend.run), "now": "", "undone": str(trouble), "shown": False}
            rows.append(row)
            mark = "" if row["shown"] else " (NOT SHOWN)"
            print(f"| {row['mend']} | {row['run']} | {row['now']} | {row['undone']}{mark} |", flush=True)
    except Trouble as trouble:
        sys.exit(f"undo_mends.py: {trouble}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2, ensure_ascii=False) + "\n")
    if hidden := [row["mend"] for row in rows if not row["shown"]]:
        sys.exit(f"undo_mends.py: not shown: {', '.join(hidden)}")
    print(f"{len(rows)} mends, each shown when it is undone")


if __name__ == "__main__":
    main()
