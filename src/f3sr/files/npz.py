"""The one reader of .npz and .npy files, and the writer of those in packages and rollouts.

A file is untrusted. The directory of the archive is checked first, then the header of every requested array. Headers
are matched against their grammar, never evaluated. Memory is allocated only for arrays of accepted kind, shape and
size. Other arrays are not opened.
"""

from __future__ import annotations

import io
import itertools
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from f3sr.errors import InputError
from f3sr.files.limited_file import opened

MAX_ENTRIES = 100_000
"""Most arrays in an .npz file: a cached scene of 500 objects of 100 parts has as many."""
MAX_HEADER = 4096
"""Longest header of an array [bytes]: numpy writes 118."""
MAX_ARRAY_BYTES = 2_000_000_000
"""Bytes of all arrays read from a file: points and normals of the largest photo in half precision."""

KINDS = {"b": "truth values", "i": "whole numbers", "u": "whole numbers", "f": "floats", "U": "text"}
NUMBERS = "fiub"
"""numpy's letters of all kinds of numbers."""
CHUNK = 1 << 20
"""Bytes inflated at a time: no array is held twice."""
_SIZES = {"b": (1,), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (2, 4, 8), "U": range(1, 257)}
"""Sizes of a value that are read, by kind: of numbers in bytes, of text in characters; numpy takes 0 for 1."""
_REFUSED = {"O": "Python objects", "c": "complex numbers", "V": "raw bytes", "M": "dates", "m": "durations"}
_DAMAGED = (EOFError, zipfile.BadZipFile, zlib.error, struct.error, NotImplementedError, RuntimeError, OverflowError)
_DIRECTORY_END, _DIRECTORY_BYTES = b"PK\x05\x06", 22
"""How the record at the end of an archive begins, and its size."""
_ENTRY_BYTES = 46
"""Least size of a file's entry in the directory."""


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """An array that a reader asks for.

    ``shape`` has a length per axis, or a name for any length. Axes with one name have one length within a file.
    """

    kinds: str = NUMBERS
    """numpy's letters of the kinds that will do."""
    dtype: np.dtype[Any] | None = None
    """The exact type, of records, instead of ``kinds``."""
    shape: tuple[int | str, ...] = ()
    most: int = MAX_ARRAY_BYTES
    """Most elements."""
    optional: bool = False
    """Whether a file without it will do."""
    also: tuple[str, ...] = ()
    """Other names that it may have; the first that is there is read."""

    def said(self, name: str, lengths: Mapping[str, int]) -> str:
        """The array in an error message, with the lengths of named axes that are known."""
        axes = [str(lengths.get(axis, axis) if isinstance(axis, str) else axis) for axis in self.shape]
        kind = " or ".join(dict.fromkeys(KINDS[k] for k in self.kinds)) if self.dtype is None else str(self.dtype)
        kind = "numbers" if self.kinds == NUMBERS and self.dtype is None else kind
        return f"{name} ({', '.join(axes)}{',' * (len(axes) == 1)}) of {kind}"


@dataclass(frozen=True, kw_only=True)
class _Header:
    """What an array in a file claims to be."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran: bool

    @property
    def bytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize

    def __str__(self) -> str:
        return f"{self.shape} {self.dtype}"


def dump(**arrays: NDArray[Any]) -> bytes:
    """Arrays as a zip of .npy files, the same bytes for the same values."""
    with io.BytesIO() as file:
        np.savez_compressed(file, **cast(Any, arrays))
        return file.getvalue()


def read(
    file: Path, wanted: Mapping[str, Wanted], *, accepted: str = "", most_bytes: int = MAX_ARRAY_BYTES
) -> dict[str, NDArray[Any]]:
    """The arrays asked for, by name, without the optional ones that are not there.

    Raises InputError: one line with the file, the array, what it is and what is ``accepted`` (default: what was asked
    for).
    """
    accepted = accepted or _listed(wanted)
    with opened(file, accepted=accepted) as stream:
        return _Archive.of(stream, str(file), accepted, most_bytes).arrays(wanted)


def read_all(stream: IO[bytes], where: str, *, most_bytes: int = MAX_ARRAY_BYTES) -> dict[str, NDArray[Any]]:
    """Every array of an archive that f3sr wrote, of any shape. Raises InputError, with ``where`` for its name."""
    return _Archive.of(stream, where, "arrays that f3sr wrote", most_bytes).all()


def read_npy(file: Path, name: str, wanted: Wanted) -> NDArray[Any]:
    """The array of an .npy file, called ``name`` in messages. Raises InputError for any other content."""
    accepted = wanted.said(name, {})
    with opened(file, accepted=accepted) as stream:
        size = file.stat().st_size
        try:
            header = _header(stream)
            _require(header, wanted, {})
            if stream.tell() + header.bytes != size:
                raise ValueError(f"{header} in a file of {size:,} bytes")
            return _values(stream, header)
        except (ValueError, EOFError) as error:
            raise InputError(file, found=f"{name} {error}", accepted=accepted) from error


def _listed(wanted: Mapping[str, Wanted]) -> str:
    return "an npz archive with " + ", ".join(w.said(name, {}) for name, w in wanted.items() if not w.optional)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Archive:
    """An open archive whose directory was checked."""

    file: zipfile.ZipFile
    where: str
    accepted: str
    most_bytes: int

    @classmethod
    def of(cls, stream: IO[bytes], where: str, accepted: str, most_bytes: int) -> _Archive:
        try:
            _require_directory(stream)
            file = zipfile.ZipFile(stream)
            _require_apart(file.infolist())
        except (*_DAMAGED, ValueError) as error:
            found = str(error) if type(error) is ValueError else "no readable npz"
            raise InputError(where, found=found, accepted=accepted) from error
        return cls(file=file, where=where, accepted=accepted, most_bytes=most_bytes)

    def arrays(self, wanted: Mapping[str, Wanted]) -> dict[str, NDArray[Any]]:
        found, lengths, room = dict[str, NDArray[Any]](), dict[str, int](), self.most_bytes
        for name, want in wanted.items():
            there = next((n for n in (name, *want.also) if f"{n}.npy" in self.file.NameToInfo), None)
            if there is None:
                if not want.optional:
                    raise InputError(self.where, found=f"no {name}", accepted=self.accepted)
                continue
            found[name] = self._array(there, want, lengths, room)
            room -= found[name].nbytes
        return found

    def all(self) -> dict[str, NDArray[Any]]:
        found, room = dict[str, NDArray[Any]](), self.most_bytes
        for entry in self.file.infolist():
            name = entry.filename.removesuffix(".npy")
            found[name] = self._array(name, None, {}, room)
            room -= found[name].nbytes
        return found

    def _array(self, name: str, want: Wanted | None, lengths: dict[str, int], room: int) -> NDArray[Any]:
        """Sizes are held against the directory first: what a header claims must be there to the byte."""
        accepted = self.accepted if want is None else want.said(name, lengths)
        try:
            entry = self.file.NameToInfo[f"{name}.npy"]
            with self.file.open(entry) as stream:
                header = _header(stream)
                if want is not None:
                    _require(header, want, lengths)
                if header.bytes > room:
                    accepted = f"at most {self.most_bytes:,} bytes of arrays"
                    raise ValueError(f"{header} of {header.bytes:,} bytes")
                if stream.tell() + header.bytes != entry.file_size:
                    raise ValueError(f"{header} in an entry of {entry.file_size:,} bytes")
                return _values(stream, header)
        except ValueError as error:
            raise InputError(self.where, found=f"{name[:60]} {error}", accepted=accepted) from error
        except (*_DAMAGED, KeyError) as error:
            raise InputError(self.where, found=f"{name[:60]} damaged", accepted=accepted) from error


# --- the archive --------------------------------------------------------------------------------------------------


def _require_directory(stream: IO[bytes]) -> None:
    """A directory of a size that may be read into memory: zipfile takes whatever the archive's end claims."""
    size = stream.seek(0, io.SEEK_END)
    # The end record is followed by a comment of at most 64 KiB.
    stream.seek(max(0, size - _DIRECTORY_BYTES - (1 << 16)))
    tail = stream.read()
    at = tail.rfind(_DIRECTORY_END)
    if at < 0 or len(tail) - at < _DIRECTORY_BYTES:
        raise ValueError("no readable npz")
    # Number of entries, then bytes of the directory; all ones mean that the ZIP64 record holds them.
    entries, length = struct.unpack_from("<HI", tail, at + 10)
    if entries == 0xFFFF or length == 0xFFFFFFFF or tail[max(0, at - 20) : at].startswith(b"PK\x06\x07"):
        _require_large_directory(stream, tail[max(0, at - 20) : at], size)
    elif length > MAX_ENTRIES * 4 * _ENTRY_BYTES:
        raise ValueError(f"a directory of {length:,} bytes")


def _require_large_directory(stream: IO[bytes], locator: bytes, size: int) -> None:
    """The same of an archive of more than 65,534 entries, whose end is written in another record."""
    stream.seek(min(size, struct.unpack_from("<Q", locator, 8)[0]))
    record = stream.read(56)
    if len(record) < 56 or not record.startswith(b"PK\x06\x06"):
        raise ValueError("no readable npz")
    entries, length = struct.unpack_from("<QQ", record, 32)
    if max(entries, length // (4 * _ENTRY_BYTES)) > MAX_ENTRIES:
        raise ValueError(f"a directory of {entries:,} entries, {length:,} bytes")


def _require_apart(entries: Sequence[zipfile.ZipInfo]) -> None:
    """Entries that lie one after another, each once, neither encrypted nor packed in a way that numpy does not use."""
    if len({e.filename for e in entries}) < len(entries):
        raise ValueError("a name twice in the archive")
    for one, after in itertools.pairwise(sorted(entries, key=lambda e: e.header_offset)):
        # A local header has 30 bytes and the name. Entries that share bytes could inflate one block many times (a zip
        # bomb).
        if one.header_offset + 30 + len(one.filename) + one.compress_size > after.header_offset:
            raise ValueError(f"{one.filename[:60]} and {after.filename[:60]} that overlap")
    for entry in entries:
        if entry.flag_bits & 1:
            raise ValueError(f"{entry.filename[:60]} encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{entry.filename[:60]} packed by method {entry.compress_type}")


# --- the header of an array ---------------------------------------------------------------------------------------

_FIELD = re.compile(r"\s*\(\s*'([^'\\]{1,64})'\s*,\s*'([^'\\]{0,64})'\s*\)\s*,?\s*")
_ITEM = re.compile(
    r"""\s*'(?:descr'\s*:\s*(?:'(?P<plain>[^'\\]{0,64})'|\[(?P<records>[^\[\]]*)\])
    |fortran_order'\s*:\s*(?P<order>True|False)
    |shape'\s*:\s*\((?P<shape>[\d,\s]*)\))\s*,?\s*""",
    re.VERBOSE,
)


def _header(stream: IO[bytes]) -> _Header:
    """Its type, shape and order. Raises ValueError for what numpy does not write of plain arrays."""
    magic = stream.read(8)
    if len(magic) < 8 or not magic.startswith(b"\x93NUMPY") or magic[6] not in (1, 2, 3):
        raise ValueError("that is no array")
    # Version 1 has a header length of two bytes, 2 and 3 of four.
    length = stream.read(2 if magic[6] == 1 else 4)
    size = int.from_bytes(length, "little")
    if size > MAX_HEADER:
        raise ValueError(f"with a header of {size:,} bytes")
    text = stream.read(size)
    if len(text) < size:
        raise ValueError("cut off")
    return _parsed(text.decode("latin-1").replace('"', "'").strip())


def _parsed(text: str) -> _Header:
    """The dictionary of a header, an item at a time."""
    damaged = ValueError("with a header that numpy does not write")
    if not (text.startswith("{") and text.endswith("}")):
        raise damaged
    at, items = 1, dict[str, str]()
    while at < len(text) - 1:
        match = _ITEM.match(text, at, len(text) - 1)
        if match is None:
            raise damaged
        items |= {key: value for key, value in match.groupdict().items() if value is not None}
        at = match.end()
    if len(items) != 3 or not {"order", "shape"} < set(items):
        raise damaged
    dtype = np.dtype(_plain(items["plain"])) if "plain" in items else _records(items["records"])
    lengths = [part.strip() for part in items["shape"].split(",")]
    if any(len(n) > 12 for n in lengths) or len(lengths) > 33:
        raise ValueError("of a shape beyond any memory")
    if not all(n.isdecimal() for n in lengths[:-1]) or not (lengths[-1].isdecimal() or lengths[-1] == ""):
        raise damaged
    return _Header(dtype=dtype, shape=tuple(int(n) for n in lengths if n), fortran=items["order"] == "True")


def _records(text: str) -> np.dtype[Any]:
    """numpy's type of records of plain values."""
    names, at = list[tuple[str, str]](), 0
    while at < len(text):
        match = _FIELD.match(text, at)
        if match is None or len(names) > 16:
            raise ValueError("of records that are not plain")
        names.append((match[1], _plain(match[2])))
        at = match.end()
    if len({name for name, _ in names}) < max(1, len(names)):
        raise ValueError("of records that are not plain")
    return np.dtype(names)


def _plain(text: str) -> str:
    """The text itself. Raises ValueError where it names no type that is read."""
    match = re.fullmatch(r"[<>|=]?([a-zA-Z])([0-9]{0,12})", text)
    if match is None or match[1] not in _SIZES or not match[2] or int(match[2]) not in _SIZES[match[1]]:
        raise ValueError(f"of {_REFUSED.get(match[1] if match else '', f'type {text[:30]!r}')}")
    return text


# --- values -------------------------------------------------------------------------------------------------------


def _require(header: _Header, want: Wanted, lengths: dict[str, int]) -> None:
    """Raises ValueError where an array is not what was asked for; notes the lengths of named axes."""
    fits = header.dtype.kind in want.kinds if want.dtype is None else header.dtype == want.dtype
    fits = fits and len(header.shape) == len(want.shape)
    for axis, length in zip(want.shape, header.shape, strict=False):
        fits = fits and length == (lengths.setdefault(axis, length) if isinstance(axis, str) else axis)
    if not fits:
        raise ValueError(str(header))
    if math.prod(header.shape) > want.most:
        raise ValueError(f"{header}, more than {want.most:,} values")


def _values(stream: IO[bytes], header: _Header) -> NDArray[Any]:
    """The array, read in chunks; the checksum of an entry is checked at its last byte."""
    array = np.empty(math.prod(header.shape), header.dtype)
    room = memoryview(cast(Any, array.view(np.uint8) if array.nbytes else np.empty(0, np.uint8)))
    at = 0
    while at < len(room):
        data = stream.read(min(CHUNK, len(room) - at))
        if not data:
            raise EOFError("cut off")
        room[at : at + len(data)] = data
        at += len(data)
    if stream.read(1):
        raise EOFError("longer than its header says")
    if header.dtype.kind == "U" and (array.view(header.dtype.byteorder + "u4") > 0x10FFFF).any():
        raise ValueError("with characters that do not exist")
    if header.dtype.kind == "b":
        array = array.view(np.uint8) != 0  # what else a byte may hold has no meaning to numpy
    # Fortran order is C order of the transposed array.
    return array.reshape(header.shape[::-1]).T if header.fortran else array.reshape(header.shape)
