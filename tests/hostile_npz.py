"""Archives of arrays that were written to do harm: headers that lie, entries that overlap, sizes beyond any disk."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

Spoil = Callable[[Path, str], None]
"""Makes one array of an archive hostile."""
HUGE = 10**12


def npy(descr: str, shape: str, data: bytes = b"", *, header: str = "") -> bytes:
    """An array whose header says whatever it is told to."""
    text = header or f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(text)) + text.encode("latin-1") + data


def entries(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as archive:
        return {i.filename: archive.read(i) for i in archive.infolist()}


def entry(data: bytes, *, packed: int = zipfile.ZIP_DEFLATED) -> Spoil:
    """Other bytes in the place of an array."""

    def spoil(file: Path, name: str) -> None:
        others = entries(file)
        with zipfile.ZipFile(file, "w", packed) as archive:
            for key, value in (others | {f"{name}.npy": data}).items():
                archive.writestr(key, value)

    return spoil


def array(values: np.ndarray) -> Spoil:
    file = io.BytesIO()
    np.save(file, values, allow_pickle=True)
    return entry(file.getvalue())


def patched(change: Callable[[bytearray, int], object]) -> Spoil:
    """The directory's entry of an array changed, which begins at a place in the archive."""

    def spoil(file: Path, name: str) -> None:
        data = bytearray(file.read_bytes())
        key = f"{name}.npy".encode()
        at = data.rindex(b"PK\x01\x02", 0, data.rindex(key))
        change(data, at)
        file.write_bytes(data)

    return spoil


def number(offset: int, value: int, kind: str = "<I") -> Callable[[bytearray, int], None]:
    return lambda data, at: struct.pack_into(kind, data, at + offset, value)


def _end(offset: int, value: int, kind: str = "<I") -> Spoil:
    """The record at the end of the archive changed."""

    def spoil(file: Path, name: str) -> None:
        data = bytearray(file.read_bytes())
        struct.pack_into(kind, data, data.rindex(b"PK\x05\x06") + offset, value)
        file.write_bytes(data)

    return spoil


def _twice(file: Path, name: str) -> None:
    others = entries(file)
    data = bytearray(file.read_bytes())
    with zipfile.ZipFile(file, "w") as archive:
        for key, value in others.items():
            archive.writestr(key, value)
        archive.writestr(f"{name}.npX", others[f"{name}.npy"])
    data = file.read_bytes().replace(f"{name}.npX".encode(), f"{name}.npy".encode())
    file.write_bytes(data)


def _endless(file: Path, name: str) -> None:
    """More entries than zipfile could hold in memory, all of the same few bytes."""
    one = struct.pack("<IHHHHHHIIIHHHHHII", 0x02014B50, 20, 20, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0) + b"a"
    data = b"PK\x03\x04" + bytes(27) + one * 600_000
    end = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 1, 1, len(one) * 600_000, 31, 0)
    file.write_bytes(data + end)


def _cut(file: Path, name: str) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])


HOSTILE: dict[str, tuple[Spoil, str]] = {
    "U0 of 10^12 elements": (entry(npy("'<U0'", f"({HUGE},)")), "type '<U0'"),
    "V0 of 10^12 elements": (entry(npy("'|V0'", f"({HUGE},)")), "raw bytes"),
    "records of no fields, 10^12 of them": (entry(npy("[]", f"({HUGE},)")), "records"),
    "records of records": (entry(npy("[('a', [('b', '<f8')])]", "(1,)")), "header"),
    "records of fields of arrays": (entry(npy("[('a', '<f8', (1000000,))]", "(1,)")), "records"),
    "U of 10^12 characters": (entry(npy(f"'<U{HUGE}'", "()")), "type"),
    "floats of 10^11 elements": (entry(npy("'<f8'", f"({10**11},)")), "more than 1,000 values"),
    "floats of 10^12 elements": (entry(npy("'<f8'", f"({HUGE},)")), "shape beyond"),
    "a shape of 10^400": (entry(npy("'<f8'", f"({10**400},)")), "shape beyond"),
    "a shape below zero": (entry(npy("'<f8'", "(-1,)")), "header"),
    "a shape of a thousand axes": (entry(npy("'<f8'", "(" + "1, " * 1000 + ")")), "shape beyond"),
    "9,000 brackets": (entry(npy("", "", header="(" * 9000)), "header of 9,000 bytes"),
    "3,000 brackets": (entry(npy("", "", header="(" * 3000)), "header"),
    "9,000 minus signs": (entry(npy("", "", header="-" * 9000 + "1")), "header of 9,001 bytes"),
    "3,000 minus signs": (entry(npy("'<f8'", "(" + "-" * 3000 + "1,)")), "header"),
    "a header that is code": (entry(npy("__import__('os').abort()", "(1,)")), "header"),
    "a header without a shape": (entry(npy("", "", header="{'descr': '<f8', 'fortran_order': False, }")), "header"),
    "a header of 4 GB": (entry(b"\x93NUMPY\x02\x00\xff\xff\xff\xff"), "header of 4,294,967,295 bytes"),
    "a header of version 9": (entry(b"\x93NUMPY\x09\x00\x00\x00"), "no array"),
    "a header cut off": (entry(npy("'<f8'", "(3,)")[:30]), "cut off"),
    "no array": (entry(b"no array at all"), "no array"),
    "nothing": (entry(b""), "no array"),
    "fewer bytes than it claims": (entry(npy("'<f8'", "(3,)", bytes(16))), "in an entry of"),
    "more bytes than it claims": (entry(npy("'<f8'", "(3,)", bytes(32))), "in an entry of"),
    "Python objects": (array(np.array([{}], object)), "Python objects"),
    "complex numbers": (array(np.arange(3.0) + 1j), "complex numbers"),
    "dates": (array(np.array(["2020-01-01"], "M8[D]")), "type"),
    "text": (array(np.array(["a", "b", "c"])), "<U1"),
    "whole numbers": (array(np.arange(3)), "int64"),
    "two axes": (array(np.zeros((3, 3))), "(3, 3)"),
    "a value alone": (array(np.array(1.0)), "()"),
    "more values than fit": (array(np.zeros(2000)), "more than 1,000 values"),
    "a bomb": (patched(number(24, 4_000_000_000)), "in an entry of 4,000,000,000 bytes"),
    "a wrong checksum": (patched(number(16, 1)), "damaged"),
    "an encrypted entry": (patched(number(8, 1, "<H")), "encrypted"),
    "an unknown packing": (patched(number(10, 99, "<H")), "packed by method 99"),
    "bzip2": (entry(npy("'<f8'", "(3,)", bytes(24)), packed=zipfile.ZIP_BZIP2), "packed by method 12"),
    "an entry that begins in another": (patched(number(42, 1)), ""),
    "entries that overlap": (patched(number(20, 0xFFFFFF)), "overlap"),
    "a name twice": (_twice, "twice"),
    "600,000 entries": (_endless, "directory of"),
    "a directory beyond the file": (_end(12, 0xFFFFFF), ""),
    "a directory of 4 GB": (_end(12, 0xFFFFFFFE), "directory of"),
    "a larger end that is not there": (_end(10, 0xFFFF, "<H"), "no readable npz"),
    "half of it": (_cut, "no readable npz"),
    "no bytes": (lambda file, _: file.write_bytes(b"") and None, "no readable npz"),
}
"""What is hostile: how it comes about, and what the reader says it found."""
