"""Laws of the one reader of arrays: what was written comes back, what is hostile is one line and costs nothing."""

from __future__ import annotations

import io
import resource
import sys
import time
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

from f3sr.errors import InputError
from f3sr.files import npz
from hostile_npz import HOSTILE, entry, npy

RECORD = np.dtype([("time", np.float64), ("id", np.int64)])
ARRAYS = {
    "plain": np.arange(6.0).reshape(2, 3),
    "other end first": np.arange(6).reshape(2, 3).astype(">i4"),
    "columns first": np.asfortranarray(np.arange(24, dtype=np.float32).reshape(2, 3, 4)),
    "half": np.arange(3, dtype=np.float16),
    "truth": np.array([True, False]),
    "text": np.array("opencv"),
    "records": np.array([(1.5, 2), (2.5, -3)], RECORD),
    "empty": np.zeros((0, 4)),
    "one": np.array(7),
    "large": np.random.default_rng(0).integers(0, 256, 3 * npz.CHUNK + 5, np.uint8),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_what_numpy_writes_comes_back(save, tmp_path: Path) -> None:
    save(tmp_path / "a.npz", **ARRAYS)
    with (tmp_path / "a.npz").open("rb") as stream:
        found = npz.read_all(stream, "a.npz")
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array), name
        assert found[name].flags.f_contiguous == array.flags.f_contiguous and found[name].flags.writeable


@pytest.mark.slow
def test_seventy_thousand_arrays_come_back(tmp_path: Path) -> None:
    """More than a zip's first directory counts: scenes of hundreds of objects have as many in the cache."""
    np.save(tmp_path / "0.npy", np.array(0))
    head = (tmp_path / "0.npy").read_bytes()[:-8]
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:  # numpy's own writer takes four times as long
        for k in range(70_000):
            archive.writestr(f"vertices/{k}.npy", head + k.to_bytes(8, sys.byteorder))
    with (tmp_path / "a.npz").open("rb") as stream:
        found = npz.read_all(stream, "a.npz")
    assert len(found) == 70_000 and int(found["vertices/69999"]) == 69_999


def test_axes_of_one_name_have_one_length(tmp_path: Path) -> None:
    wanted = {"a": npz.Wanted(shape=("n", 3)), "b": npz.Wanted(shape=("n",)), "c": npz.Wanted(optional=True)}
    np.savez(tmp_path / "a.npz", a=np.zeros((4, 3)), b=np.zeros(4), other=np.array([{}], object))
    assert npz.read(tmp_path / "a.npz", wanted).keys() == {"a", "b"}, "what nobody asked for is not opened"
    np.savez(tmp_path / "a.npz", a=np.zeros((4, 3)), b=np.zeros(5))
    with pytest.raises(InputError, match=r"a\.npz: found b \(5,\) float64; accepted: b \(4,\) of numbers"):
        npz.read(tmp_path / "a.npz", wanted)


def test_all_arrays_together_have_a_limit(tmp_path: Path) -> None:
    wanted = {name: npz.Wanted(shape=("n",)) for name in "ab"}
    np.savez(tmp_path / "a.npz", a=np.zeros(60), b=np.zeros(60))
    assert npz.read(tmp_path / "a.npz", wanted, most_bytes=960)
    with pytest.raises(InputError, match=r"found b .* of 480 bytes; accepted: at most 959 bytes of arrays"):
        npz.read(tmp_path / "a.npz", wanted, most_bytes=959)


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_archive_is_one_line_and_costs_nothing(case: str, tmp_path: Path) -> None:
    file, (spoil, found) = tmp_path / "a.npz", HOSTILE[case]
    np.savez_compressed(file, first=np.arange(9.0), x=np.arange(3.0), last=np.arange(9.0))
    spoil(file, "x")
    before, start = peak(), time.process_time()
    with warnings.catch_warnings(), pytest.raises(InputError) as caught:
        warnings.simplefilter("error")
        npz.read(file, {"x": npz.Wanted(kinds="f", shape=("n",), most=1000)})
    assert time.process_time() - start < 1 and peak() - before < 50e6
    message = str(caught.value)
    assert message.startswith(f"{file}: found ") and found in caught.value.found and len(message) < 700
    assert "x (n,) of floats" in caught.value.accepted


def peak() -> float:
    """Bytes of memory that this process has had at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def test_text_holds_characters_that_exist(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", x=np.array("a"))
    entry(npy("'<U1'", "()", b"\xff\xff\xff\xff"))(tmp_path / "a.npz", "x")
    with pytest.raises(InputError, match="characters that do not exist"):
        npz.read(tmp_path / "a.npz", {"x": npz.Wanted(kinds="U")})


def test_truth_values_are_true_or_false(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", x=np.zeros(3, bool))
    entry(npy("'|b1'", "(3,)", b"\x00\x01\x07"))(tmp_path / "a.npz", "x")
    mask = npz.read(tmp_path / "a.npz", {"x": npz.Wanted(shape=("n",))})["x"]
    assert mask.view(np.uint8).tolist() == [0, 1, 1]


def test_an_array_by_itself_is_read_alike(tmp_path: Path) -> None:
    file, wanted = tmp_path / "d.npy", npz.Wanted(kinds="fiu", shape=("h", "w"), most=1000)
    np.save(file, np.arange(6).reshape(2, 3))
    assert npz.read_npy(file, "depth", wanted).tolist() == [[0, 1, 2], [3, 4, 5]]
    spoiled = {
        npy("'<f8'", f"({10**11}, 3)"): "more than 1,000 values",
        npy("'<U0'", f"({10**12}, 3)"): "type '<U0'",
        npy("", "", header="(" * 9000): "header of 9,000 bytes",
        npy("'<f8'", "(2, 3)", bytes(40)): "in a file of",
        npy("'<f8'", "(2, 3)", bytes(56)): "in a file of",
        npy("'<f8'", "(6,)", bytes(48)): r"depth \(6,\) float64",
        b"": "no array",
    }
    for data, found in spoiled.items():
        file.write_bytes(data)
        with pytest.raises(InputError, match=found):
            npz.read_npy(file, "depth", wanted)


def test_the_same_values_are_the_same_bytes() -> None:
    data = npz.dump(**ARRAYS)
    assert data == npz.dump(**ARRAYS)
    assert np.array_equal(npz.read_all(io.BytesIO(data), "a")["plain"], ARRAYS["plain"])
