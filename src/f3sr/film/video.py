"""film.mp4: frames as H.264 in an MP4 file that every player shows in the right colours, the same bytes every time."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

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

LUMA = np.array([0.2126, 0.7152, 0.0722])
"""BT.709's weights of red, green and blue."""
SHIFT = 16
"""Binary places of the integer weights below: errors below 2^-7 of a level, and sums of four pixels fit 32 bits."""
STUDIO = np.array([219, 224, 224]) / 255
"""Steps of limited range, for Y, U and V, over full range."""
YUV = np.rint(
    np.array([LUMA, ([0, 0, 1] - LUMA) / (2 - 2 * LUMA[2]), ([1, 0, 0] - LUMA) / (2 - 2 * LUMA[0])])
    * STUDIO[:, None]
    * (1 << SHIFT)
).astype(np.int32)
"""(3, 3): Y, U and V of RGB."""

OPTIONS = {
    "preset": PRESET,
    "crf": str(CRF),
    "bf": "0",  # frames are shown in the order of decoding: times begin at 0 without an edit list, which players ignore
    "flags": "+bitexact",
    # mbtree saves a quarter of the bytes, but in its vector code one film of some hundreds comes out different
    "x264-params": "colorprim=bt709:transfer=bt709:colormatrix=bt709:range=tv:chromaloc=1:scenecut=0:mbtree=0",
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
    rate = _rate(fps)
    shown = _checked(frames)
    first = next(shown, None)
    if first is None:
        raise InputError("film", found="no frame", accepted="at least one")
    file = io.BytesIO()
    try:
        with _Encoder(file, first, rate) as encoder:
            encoder.add(first)
            for frame in shown:
                encoder.add(frame)
    except _av().FFmpegError as error:
        raise OutputError(f"film: the encoder failed ({error.strerror})") from error
    return Video(data=file.getvalue(), width=encoder.width, height=encoder.height, frames=encoder.count, fps=rate)


class _Encoder:
    """An open file that frames are added to."""

    def __init__(self, file: io.BytesIO, first: Picture, rate: Fraction) -> None:
        av = _av()
        self.count, self.tick = 0, 1 / rate
        self.height, self.width = (n + n % 2 for n in first.shape[:2])
        # A multiple of the rate's numerator, so that every frame begins at a whole tick.
        scale = -(-TICKS // rate.numerator) * rate.numerator
        options = {"movflags": "+faststart", "fflags": "+bitexact", "use_editlist": "0", "movie_timescale": str(scale)}

        def again(*_: object) -> io.BytesIO:
            """What was written, to be read while the index is put before it."""
            return io.BytesIO(file.getvalue())

        options["video_track_timescale"] = str(scale)
        self._file: Any = av.open(file, "w", format="mp4", options=options, io_open=again)
        self._stream: Any = self._file.add_stream("libx264", rate=rate, options=OPTIONS)
        context = self._stream.codec_context
        context.thread_count = 1
        context.time_base = self._stream.time_base = self.tick
        context.width, context.height, context.pix_fmt = self.width, self.height, "yuv420p"
        context.gop_size = max(1, round(KEY_SECONDS * rate))
        context.color_range, context.colorspace, context.color_primaries, context.color_trc = 1, 1, 1, 1  # BT.709

    def __enter__(self) -> _Encoder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._mux(self._stream.encode())
        finally:
            self._file.close()

    def add(self, rgb: Picture) -> None:
        frame = _av().VideoFrame.from_ndarray(yuv420(even(rgb)), format="yuv420p")
        frame.pts, frame.duration, frame.time_base = self.count, 1, self.tick
        self.count += 1
        self._mux(self._stream.encode(frame))

    def _mux(self, packets: Iterable[Any]) -> None:
        for packet in packets:
            self._file.mux(packet)


def even(rgb: Picture) -> Picture:
    """The picture (h, w, 3) with its last row and column twice where their number is odd: 4:2:0 needs even sides."""
    height, width = rgb.shape[:2]
    return np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge") if height % 2 or width % 2 else rgb


def yuv420(rgb: Picture) -> NDArray[np.uint8]:
    """(3 h / 2, w): Y, then U and V at half the size, of an even-sized picture; BT.709 in limited range.

    Values are rounded; swscale truncates, which darkens a film by one level. A chroma sample is the mean of its four
    pixels. In integers: the same bytes on every machine."""
    # Sums of four pixels; the two bits more of the shift divide by 4.
    rows = rgb[0::2].astype(np.int32) + rgb[1::2]
    fours = rows[:, 0::2] + rows[:, 1::2]
    planes = [_weighted(rgb, YUV[0], SHIFT, 16), _weighted(fours, YUV[1], SHIFT + 2, 128)]
    planes.append(_weighted(fours, YUV[2], SHIFT + 2, 128))
    return np.concatenate([plane.ravel() for plane in planes]).reshape(-1, rgb.shape[1])


def _weighted(rgb: NDArray[Any], weights: NDArray[np.int32], shift: int, offset: int) -> NDArray[np.uint8]:
    value = rgb[..., 0] * weights[0]
    for channel in (1, 2):
        value += rgb[..., channel] * weights[channel]
    # Half a step before the shift rounds to the nearest.
    value += (offset << shift) + (1 << shift - 1)
    value >>= shift
    return value.astype(np.uint8)


def _checked(frames: Iterable[Picture]) -> Any:
    size = None
    for k, frame in enumerate(frames):
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            found = f"{frame.dtype} of shape {frame.shape}"
            raise InputError(f"film: frame {k}", found=found, accepted="uint8 of shape (h, w, 3)")
        size = size or frame.shape
        if not SMALLEST <= min(frame.shape[:2]) <= max(frame.shape[:2]) <= LARGEST or frame.shape != size:
            found = f"{frame.shape[1]}x{frame.shape[0]} pixels"
            accepted = (
                f"sides of {SMALLEST} to {LARGEST}" if frame.shape == size else f"the first's {size[1]}x{size[0]}"
            )
            raise InputError(f"film: frame {k}", found=found, accepted=accepted)
        yield frame


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
