"""Code size of a function of a Cortex-M image, including all functions that it calls.

Reads the symbols of the ELF file and the direct branches in the code, without other tools.
"""

import bisect
import struct


class Image:
    """Functions of an image and the branches between them."""

    def __init__(self, path):
        self.data = path.read_bytes()
        if self.data[:7] != b"\x7fELF\x01\x01\x01":
            raise ValueError(f"{path} is no 32-bit little-endian ELF file")
        offset, size, count = (
            struct.unpack_from("<I", self.data, 32)[0],
            *struct.unpack_from("<HH", self.data, 46),
        )
        self.sections = [
            struct.unpack_from("<10I", self.data, offset + i * size) for i in range(count)
        ]
        self.functions, self.marks = {}, []
        for section in self.sections:
            if section[1] == 2:
                self._read_symbols(section)
        self.starts = sorted(self.functions)
        self.marks.sort()

    def _read_symbols(self, table):
        names = self.sections[table[6]][4]
        for at in range(table[4], table[4] + table[5], 16):
            name, value, size, info, _, section = struct.unpack_from("<IIIBBH", self.data, at)
            end = self.data.index(0, names + name)
            text = self.data[names + name : end].decode()
            if info & 15 == 2 and size > 0:
                # The lowest bit marks Thumb code.
                known = self.functions.get(value & ~1, ("", 0))
                self.functions[value & ~1] = max((text, size), known, key=lambda f: f[1])
            elif text[:2] in ("$t", "$d") and 0 < section < 0xFF00:
                self.marks.append((value & ~1, text[1]))

    def _bytes(self, start, size):
        for section in self.sections:
            if section[1] == 1 and section[3] <= start < section[3] + section[5]:
                at = section[4] + start - section[3]
                return self.data[at : at + size]
        raise ValueError(f"nothing at {start:#x}")

    def _is_code(self, address):
        i = bisect.bisect_right(self.marks, (address, "z")) - 1
        return i >= 0 and self.marks[i][1] == "t"

    def _owner(self, address):
        """Start of the function that contains an address, or None."""
        i = bisect.bisect_right(self.starts, address) - 1
        if i >= 0 and address < self.starts[i] + self.functions[self.starts[i]][1]:
            return self.starts[i]
        return None

    def _branches(self, start):
        """Targets of the branches from the function at `start` to other functions."""
        size = self.functions[start][1]
        code, at = self._bytes(start, size), 0
        while at + 2 <= size:
            if not self._is_code(start + at):
                at += 2
                continue
            (first,) = struct.unpack_from("<H", code, at)
            if first >> 11 < 0b11101 or at + 4 > size:
                at += 2
                continue
            (second,) = struct.unpack_from("<H", code, at + 2)
            # BL and B.W: the same fields, 25 bits of distance.
            if first >> 11 == 0b11110 and second & 0x9000 == 0x9000:
                sign = first >> 10 & 1
                ones = [(second >> bit & 1) ^ sign ^ 1 for bit in (13, 11)]
                distance = (
                    -sign << 24
                    | ones[0] << 23
                    | ones[1] << 22
                    | (first & 0x3FF) << 12
                    | (second & 0x7FF) << 1
                )
                target = start + at + 4 + distance
                if not start <= target < start + size:
                    yield target
            at += 4

    def size(self, address, without=()):
        """Bytes of the function at `address` and of all functions that it calls, each once, literals included;
        functions whose name contains a word in `without` are left out."""
        todo, seen = [address & ~1], set()
        while todo:
            start = self._owner(todo.pop())
            if start is None or start in seen:
                continue
            if any(word in self.functions[start][0] for word in without):
                continue
            seen.add(start)
            todo += self._branches(start)
        return sum(self.functions[start][1] for start in seen)
