"""film.mp4: frames as H.264 in an MP4 file that every player shows in the right colours, the same bytes every time."""

from __future__ import annotations

import io
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from f3sr.errors import InputError, OutputError

Picture = NDArray[np.uint8]
"""(h, w, 3) sRGB."""

CRF = 18
"""x264's constant rate factor: errors that are not seen, at 250 to 450 kB a second of 960x720."""
PRESET = "veryfast"
KEY_SECONDS = 4.0
"""Film time between key frames [s].

A player decodes from the key frame before the wanted one, so short is quick. At each key frame still grain changes by
a level, so short pulses."""
SMALLEST, LARGEST = 16, 8192
"""Sides of a frame [px]; players decode no larger ones."""
FASTEST = 240
"""Most frames a second of a film."""
TICKS = 90_000
"""Least time units a second in which the file tells times."""

SHIFT = 16
"""Binary places of the integer weights below: errors below 2^-7 of a level, and sums of four pixels fit 32 bits."""
STUDIO = np.array([219, 224, 224]) / 255
"""Steps of limited range, for Y, U and V, over full range."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Matrix:
    """How luma and chroma are made of red, green and blue."""

    name: str
    """x264's."""
    number: int
    """Of H.273, which files tell."""
    luma: tuple[float, float, float]
    """Weights of red, green and blue."""

    @cached_property
    def yuv(self) -> NDArray[np.int32]:
        """(3, 3): Y, U and V of RGB, in limited range, times 2^SHIFT."""
        y = np.array(self.luma)
        rows = np.array([y, ([0, 0, 1] - y) / (2 - 2 * y[2]), ([1, 0, 0] - y) / (2 - 2 * y[0])])
        return np.rint(rows * STUDIO[:, None] * (1 << SHIFT)).astype(np.int32)


BT709 = Matrix(name="bt709", number=1, luma=(0.2126, 0.7152, 0.0722))
"""Of films, which players show."""
BT601 = Matrix(name="smpte170m", number=6, luma=(0.299, 0.587, 0.114))
"""Of pictures that programs read: some readers take every small film to be of this one, whatever it tells."""

OPTIONS = {
    "preset": PRESET,
    "crf": str(CRF),
    "bf": "0",  # frames are shown in the order of decoding: times begin at 0 without an edit list, which players ignore
    "flags": "+bitexact",
    # mbtree saves a quarter of the bytes, but in its vector code one film of some hundreds comes out different
    "x264-params": "colorprim=bt709:transfer=bt709:colormatrix={}:range=tv:chromaloc=1:scenecut=0:mbtree=0",
}


@dataclass(frozen=True, kw_only=True)
class Video:
    """An MP4 file: frame k is shown from k / ``fps`` to (k + 1) / ``fps`` seconds."""

    data: bytes
    width: int
    height: int
    """Of the film [px], both even: a frame of odd size has its last column or row twice."""
    frames: int
    fps: Fraction

    @property
    def seconds(self) -> Fraction:
        """Duration of the film [s]."""
        return self.frames / self.fps


def encode(frames: Iterable[Picture], fps: Fraction | float) -> Video:
    """Frames (h, w, 3) uint8 sRGB of one size, taken one at a time, as a film of ``fps`` frames a second.

    Raises InputError for what is no film: no frame, frames of several sizes, too large or too many a second;
    OutputError where the encoder fails.
    """
    with Encoder(fps) as encoder:
        for frame in frames:
            encoder.add(frame)
        return encoder.finish()


class Encoder:
    """A film that frames are added to, one at a time; raises as ``encode`` does.

    ``key_seconds``: film time between key frames [s]. It holds its bytes in memory and nothing else.
    """

    def __init__(self, fps: Fraction | float, *, key_seconds: float = KEY_SECONDS, matrix: Matrix = BT709) -> None:
        self._rate = _rate(fps)
        self._key_seconds, self._matrix = key_seconds, matrix
        self._count, self._shape = 0, (0, 0, 3)
        self._bytes = io.BytesIO()
        self._file: Any = None
        self._stream: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, rgb: Picture) -> None:
        """The next frame (h, w, 3) uint8 sRGB, of the first one's size."""
        self._check(rgb)
        with _told():
            if self._file is None:
                self._open(rgb)
            frame = _av().VideoFrame.from_ndarray(yuv420(even(rgb), self._matrix), format="yuv420p")
            frame.pts, frame.duration, frame.time_base = self._count, 1, 1 / self._rate
            self._count += 1
            self._mux(self._stream.encode(frame))

    def finish(self) -> Video:
        """The whole film."""
        if self._file is None:
            raise InputError("film", found="no frame", accepted="at least one")
        with _told():
            self._mux(self._stream.encode())
            self.close()
        height, width = (n + n % 2 for n in self._shape[:2])
        return Video(data=self._bytes.getvalue(), width=width, height=height, frames=self._count, fps=self._rate)

    def close(self) -> None:
        """Give the encoder back; a film that is not finished is lost."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _open(self, first: Picture) -> None:
        rate, self._shape = self._rate, first.shape
        # A multiple of the rate's numerator, so that every frame begins at a whole tick.
        scale = -(-TICKS // rate.numerator) * rate.numerator
        options = {"movflags": "+faststart", "fflags": "+bitexact", "use_editlist": "0", "movie_timescale": str(scale)}

        def again(*_: object) -> io.BytesIO:
            """What was written, to be read while the index is put before it."""
            return io.BytesIO(self._bytes.getvalue())

        options["video_track_timescale"] = str(scale)
        self._file = _av().open(self._bytes, "w", format="mp4", options=options, io_open=again)
        told = {"x264-params": OPTIONS["x264-params"].format(self._matrix.name)}
        self._stream = self._file.add_stream("libx264", rate=rate, options=OPTIONS | told)
        context = self._stream.codec_context
        context.thread_count = 1
        context.time_base = self._stream.time_base = 1 / rate
        context.height, context.width = (n + n % 2 for n in first.shape[:2])
        context.pix_fmt = "yuv420p"
        context.gop_size = max(1, round(self._key_seconds * rate))
        context.color_range, context.color_primaries, context.color_trc = 1, 1, 1  # limited, BT.709
        context.colorspace = self._matrix.number

    def _mux(self, packets: Iterable[Any]) -> None:
        for packet in packets:
            self._file.mux(packet)

    def _check(self, frame: Picture) -> None:
        name = f"film: frame {self._count}"
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            found = f"{frame.dtype} of shape {frame.shape}"
            raise InputError(name, found=found, accepted="uint8 of shape (h, w, 3)")
        height, width = frame.shape[:2]
        found = f"{width}x{height} pixels"
        if self._count and frame.shape != self._shape:
            raise InputError(name, found=found, accepted=f"the first's {self._shape[1]}x{self._shape[0]}")
        if not SMALLEST <= min(height, width) <= max(height, width) <= LARGEST:
            raise InputError(name, found=found, accepted=f"sides of {SMALLEST} to {LARGEST}")


@contextmanager
def _told() -> Generator[None]:
    """Errors of the encoder as OutputError."""
    try:
        yield
    except _av().FFmpegError as error:
        raise OutputError(f"film: the encoder failed ({error.strerror})") from error


def even(rgb: Picture) -> Picture:
    """The picture (h, w, 3) with its last row and column twice where their number is odd: 4:2:0 needs even sides."""
    height, width = rgb.shape[:2]
    return np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge") if height % 2 or width % 2 else rgb


def yuv420(rgb: Picture, matrix: Matrix) -> NDArray[np.uint8]:
    """(3 h / 2, w): Y, then U and V at half the size, of an even-sized picture; in limited range.

    Values are rounded; swscale truncates, which darkens a film by one level. A chroma sample is the mean of its four
    pixels. In integers: the same bytes on every machine."""
    # Sums of four pixels; the two bits more of the shift divide by 4.
    rows = rgb[0::2].astype(np.int32) + rgb[1::2]
    fours = rows[:, 0::2] + rows[:, 1::2]
    yuv = matrix.yuv
    planes = [_weighted(rgb, yuv[0], SHIFT, 16), _weighted(fours, yuv[1], SHIFT + 2, 128)]
    planes.append(_weighted(fours, yuv[2], SHIFT + 2, 128))
    return np.concatenate([plane.ravel() for plane in planes]).reshape(-1, rgb.shape[1])


def _weighted(rgb: NDArray[Any], weights: NDArray[np.int32], shift: int, offset: int) -> NDArray[np.uint8]:
    value = rgb[..., 0] * weights[0]
    for channel in (1, 2):
        value += rgb[..., channel] * weights[channel]
    # Half a step before the shift rounds to the nearest.
    value += (offset << shift) + (1 << shift - 1)
    value >>= shift
    return value.astype(np.uint8)


def _rate(fps: Fraction | float) -> Fraction:
    accepted = f"more than 0, at most {FASTEST}, frames a second"
    try:
        rate = Fraction(fps).limit_denominator(1001)
    except (ValueError, OverflowError):  # nan, infinity
        raise InputError("film", found=f"{fps} frames a second", accepted=accepted) from None
    if not 0 < rate <= FASTEST:
        raise InputError("film", found=f"{fps} frames a second", accepted=accepted)
    return rate


def _av() -> Any:
    import av

    return av
