"""Instructions in the code of an ELF file; mapping symbols separate code from data."""

import struct


def sections(data):
    """Name, type, address, offset, size, link of each section."""
    header, size, count, names = *struct.unpack_from("<I", data, 32), *struct.unpack_from(
        "<HHH", data, 46
    )
    rows = [struct.unpack_from("<10I", data, header + size * k) for k in range(count)]
    strings = rows[names][4]
    for row in rows:
        begin = strings + row[0]
        name = data[begin : data.index(b"\0", begin)].decode()
        yield name, row[1], row[3], row[4], row[5], row[6]


def instructions(path):
    """Address and bytes of each instruction."""
    data = path.read_bytes()
    table = list(sections(data))
    marks = []
    for _, kind, _, offset, size, link in table:
        if kind != 2:
            continue
        strings = table[link][3]
        for entry in range(offset, offset + size, 16):
            name, value = struct.unpack_from("<II", data, entry)
            begin = strings + name
            text = data[begin : data.index(b"\0", begin)]
            if text[:2] in (b"$t", b"$d", b"$a"):
                marks.append((value, text[:2] == b"$t"))
    marks.sort()
    for name, kind, address, offset, size, _ in table:
        if kind != 1 or name not in (".text", ".init"):
            continue
        inside = [mark for mark in marks if address <= mark[0] < address + size]
        ends = [mark[0] for mark in inside[1:]] + [address + size]
        for (begin, is_code), end in zip(inside, ends):
            place = begin
            while is_code and place + 2 <= end:
                at = offset + place - address
                (half,) = struct.unpack_from("<H", data, at)
                length = 4 if half >> 11 >= 0b11101 else 2
                yield place, data[at : at + length]
                place += length


def encodings(path):
    """The set of different instructions of an ELF file, each as its bytes."""
    return {code for _, code in instructions(path)}
