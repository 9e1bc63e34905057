#!/usr/bin/env python3
"""Compares the crate's CAN frames, bit for bit, with those of other implementations.

    cargo run -q --release -p virtual-board --example can_frames | can_bits.py [--sigrok DECODERS]

Reads lines of the example can_frames. Three checks of each frame share no code with the crate or with
each other:

- python-can's Message validates the fields. The frame of the CAN specification 2.0 is assembled from these
  fields, with the checksum of crccheck (CRC-15/CAN, a dependency of cantools) and stuff bits. All bits
  must be equal.
- The lengths must lie within the bounds of Davis, Burns, Bril and Lukkien (2007). Neither python-can nor
  cantools computes a stuffed length.
- With --sigrok, or if Debian's package libsigrokdecode4 is installed, the CAN decoder of sigrok decodes the
  bits. Fields and data must be equal, without a warning. The decoder does not support remote frames with a
  length code or length codes above 8; these frames skip this check.

Needs: pip install python-can cantools. Exits 1 at the first difference.
"""

import argparse
import importlib.util
import pathlib
import sys
import types

import can
from crccheck.crc import Crc15Can

SIGROK = pathlib.Path("/usr/share/libsigrokdecode/decoders")


def binary(value, width):
    return format(value, f"0{width}b")


def checksum(bits):
    """CRC-15/CAN of a bit string. The initial value is 0, so leading zeros that fill the first byte change nothing."""
    padded = bits.zfill((len(bits) + 7) // 8 * 8)
    data = int(padded, 2).to_bytes(len(padded) // 8, "big")
    return binary(Crc15Can.calc(data), 15)


def stuffed(bits):
    """Bits with a stuff bit of the opposite level after each five equal bits; stuff bits count, too."""
    out = ""
    for bit in bits:
        out += bit
        if len(out) - len(out.rstrip(bit)) == 5:
            out += "10"[int(bit)]
    return out


def expected(message, code):
    remote = "1" if message.is_remote_frame else "0"
    if message.is_extended_id:
        identifier = binary(message.arbitration_id, 29)
        head = "0" + identifier[:11] + "11" + identifier[11:] + remote + "00"
    else:
        head = "0" + binary(message.arbitration_id, 11) + remote + "00"
    body = head + binary(code, 4) + "".join(binary(byte, 8) for byte in message.data)
    return stuffed(body + checksum(body)) + "1" + "1" + "1" + "1" * 7


def bounds(message):
    """Smallest and largest number of bits of a frame with the intermission."""
    bits = 8 * len(message.data)
    fixed, exposed = (67, 54) if message.is_extended_id else (47, 34)
    return bits + fixed, bits + fixed + (exposed + bits - 1) // 4


def sigrok_decoder(folder):
    """sigrok's CAN decoder. A stub replaces the module sigrokdecode that the decoder imports."""
    stand_in = types.ModuleType("sigrokdecode")
    stand_in.Decoder = object
    stand_in.OUTPUT_ANN, stand_in.SRD_CONF_SAMPLERATE = 0, 0
    sys.modules["sigrokdecode"] = stand_in
    place = folder / "can" / "pd.py"
    spec = importlib.util.spec_from_file_location("can_decoder", place)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    class Decoder(module.Decoder):
        samplenum = 0
        bit_width, sample_point = 1.0, 0.5
        dom_edge_snum = dom_edge_bcount = 0

        def put(self, start, end, output, data):
            self.emitted.append((data[0], data[1][0]))

        def decode_bits(self, bits):
            self.emitted = []
            self.out_ann = 0
            for bit in bits:
                self.handle_bit(int(bit))
            return self.emitted

    return Decoder()


def decoded(decoder, bits):
    """Identifier, length code, data, true if the frame is complete, and warnings, all reported by the decoder."""
    emitted = decoder.decode_bits(bits)
    after = lambda text: int(text.split("0x")[1].rstrip(")"), 16)
    text = lambda kind: [words if isinstance(words, str) else words[0] for k, words in emitted if k == kind]
    identifiers = text(5) or text(3)
    code = [int(words.split(": ")[1]) for words in text(10)]
    data = [after(words) for words in text(0)]
    ended = bool(text(2))
    # The decoder warns of identifiers from 0x7f0 on, which CAN 2.0 allows.
    warnings = [words for words in text(16) if "Identifier bits" not in words]
    return after(identifiers[0]), code[0], data, ended, warnings


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sigrok", type=pathlib.Path, default=SIGROK, metavar="DECODERS")
    arguments = parser.parse_args()
    decoder = sigrok_decoder(arguments.sigrok) if (arguments.sigrok / "can").is_dir() else None
    count = taken_apart = 0
    for line in sys.stdin:
        kind_of_id, identifier, kind, code, data, bits = line.split()
        code = int(code)
        message = can.Message(
            arbitration_id=int(identifier, 16),
            is_extended_id=kind_of_id == "extended",
            is_remote_frame=kind == "remote",
            dlc=min(code, 8),
            data=None if kind == "remote" else bytes.fromhex(data.replace("-", "")),
            check=True,
        )
        wanted = expected(message, code)
        least, most = bounds(message)
        if bits != wanted or not least <= len(bits) + 3 <= most:
            sys.exit(f"can_bits.py: {line}expected\n{wanted}\n{least} to {most} bits")
        if decoder and code <= 8 and (kind == "data" or code == 0):
            found = decoded(decoder, bits)
            if found != (message.arbitration_id, code, list(message.data), True, []):
                sys.exit(f"can_bits.py: {line}sigrok: {found}")
            taken_apart += 1
        count += 1
    if count == 0:
        sys.exit("can_bits.py: no frames")
    print(f"{count} frames equal, bit for bit; {taken_apart} taken apart by sigrok's decoder")


if __name__ == "__main__":
    main()
