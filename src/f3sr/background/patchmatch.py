"""Kernels that complete a picture from its own patches: nearest patches, votes and the membrane between known pixels.

PatchMatch (Barnes et al., 2009) finds a similar patch without a hole for every patch that meets the hole. These patches
vote for the hole's pixels, repeatedly (Wexler et al., "Space-time completion of video", 2007). Patches are compared up
to a small shift of every channel (Darabi et al., "Image melding", 2012). Pictures are logarithms of colour, so the
shift is a change of light. All pictures here are padded by ``RADIUS`` pixels whose weight is 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.runtime.kernels import inline_kernel, inner_kernel, kernel

Picture = NDArray[np.float32]
"""(h, w, 3): logarithms of colour, here of light and twice of its colour, or what is to be spread like them."""

RADIUS = 3
"""Pixels from a patch's middle to its side: 7 x 7 is what most of the literature uses."""
SIDE = 2 * RADIUS + 1
"""Pixels along a patch's side."""
FREE_SHIFT = 0.9
"""Share of a difference of light that costs nothing. The rest decides between equal details for equal light."""
LARGEST_SHIFT = (0.43, 0.06, 0.06)
"""Largest shift of each channel [log], of light, then twice of its colour: a quarter of the light, while lamps and
walls tint it by a few percent. Another material needs more."""
GAMMA = np.uint64(0x9E3779B97F4A7C15)
"""Step of the generator of random numbers (Steele et al., "Fast splittable pseudorandom number generators", 2014)."""


@inline_kernel
def _random(state: Any) -> Any:
    """A number of 64 bits of a counter: the same on every machine and in every order of work."""
    # SplitMix64's mixer: multiplications wrap around at 64 bits, as numba's uint64 do.
    z = state * GAMMA
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@inner_kernel
def _mismatch(picture: Any, weight: Any, ty: Any, tx: Any, sy: Any, sx: Any, bound: Any) -> Any:
    """Weighted mean square difference of the patches at (ty, tx) and (sy, sx) after the best shift of light.

    Once it is above ``bound``, any number above it. Weights are those around the target (ty, tx)."""
    total = np.float32(0)
    for dy in range(-RADIUS, RADIUS + 1):
        for dx in range(-RADIUS, RADIUS + 1):
            total += weight[ty + dy, tx + dx]
    total = max(total, np.float32(1e-12))
    limit = np.float32(bound) * total
    one = np.float32(0)
    a0, a1, a2, b = one, one, one, one
    sofar = np.float32(1e-12)
    for dy in range(-RADIUS, RADIUS + 1):
        for dx in range(-RADIUS, RADIUS + 1):
            w = weight[ty + dy, tx + dx]
            d0 = picture[ty + dy, tx + dx, 0] - picture[sy + dy, sx + dx, 0]
            d1 = picture[ty + dy, tx + dx, 1] - picture[sy + dy, sx + dx, 1]
            d2 = picture[ty + dy, tx + dx, 2] - picture[sy + dy, sx + dx, 2]
            sofar += w
            a0 += w * d0
            a1 += w * d1
            a2 += w * d2
            b += w * (d0 * d0 + d1 * d1 + d2 * d2)
        # What the best shift of these rows alone leaves of them: the whole patch, with one shift, leaves no less.
        if b - (a0 * a0 + a1 * a1 + a2 * a2) / sofar > limit:
            return np.float32(2) * np.float32(bound)
    b -= _explained(a0, total, np.float32(LARGEST_SHIFT[0]))
    b -= _explained(a1, total, np.float32(LARGEST_SHIFT[1]))
    b -= _explained(a2, total, np.float32(LARGEST_SHIFT[2]))
    return max(b, one) / total


@inline_kernel
def _explained(sum: Any, total: Any, largest: Any) -> Any:
    """What the best shift of a channel takes from the sum of squares; ``sum`` is that of the weighted differences."""
    m = sum / total
    s = min(max(np.float32(FREE_SHIFT) * m, -largest), largest)
    # sum w (d - s)^2 = sum w d^2 - 2 s total m + total s^2, with m the mean difference.
    return total * (np.float32(2) * m - s) * s


@kernel
def measure(picture: Any, weight: Any, targets: Any, nearest: Any, cost: Any) -> None:
    """The mismatch (h, w) of every target's present source."""
    for k in range(len(targets)):
        y, x = np.int64(targets[k, 0]), np.int64(targets[k, 1])
        sy, sx = np.int64(nearest[y, x, 0]), np.int64(nearest[y, x, 1])
        cost[y, x] = _mismatch(picture, weight, y, x, sy, sx, np.float32(1e30))


@kernel
def search(
    picture: Any, weight: Any, source: Any, targets: Any, nearest: Any, cost: Any, reach: int, seed: int, backward: bool
) -> None:
    """One pass of PatchMatch over ``targets`` (k, 2), in rows: the neighbours' sources, then random ones around the
    best within ``reach`` pixels, nearer and nearer. ``source`` (h, w): middles of patches that may be copied."""
    h, w = source.shape
    # In rows, the neighbours before a pixel are done already; backward passes bring matches the other way.
    step = -1 if not backward else 1
    for i in range(len(targets)):
        k = len(targets) - 1 - i if backward else i
        y, x = np.int64(targets[k, 0]), np.int64(targets[k, 1])
        by, bx, best = np.int64(nearest[y, x, 0]), np.int64(nearest[y, x, 1]), cost[y, x]
        for side in range(2):
            ny, nx = (y + step, x) if side == 0 else (y, x + step)
            if ny < 0 or nx < 0 or ny >= h or nx >= w or nearest[ny, nx, 0] < 0:
                continue
            # The neighbour's source, shifted as this pixel is: coherent patches move together.
            sy, sx = nearest[ny, nx, 0] + y - ny, nearest[ny, nx, 1] + x - nx
            if sy < 0 or sx < 0 or sy >= h or sx >= w or not source[sy, sx] or (sy == by and sx == bx):
                continue
            d = _mismatch(picture, weight, y, x, sy, sx, best)
            if d < best:
                by, bx, best = sy, sx, d
        radius = reach
        # A stream per pixel and pass, 64 numbers apart: halving a radius of 2^31 takes fewer.
        state = np.uint64(seed) * np.uint64(0x2545F4914F6CDD1D) + np.uint64(y * w + x) * np.uint64(64)
        while radius >= 1:
            state += np.uint64(1)
            r = _random(state)
            # High and low bits give two independent coordinates in [-radius, radius] around the best so far.
            sy = by + int((r >> np.uint64(33)) % np.uint64(2 * radius + 1)) - radius
            sx = bx + int((r & np.uint64(0x7FFFFFFF)) % np.uint64(2 * radius + 1)) - radius
            radius //= 2
            if sy < 0 or sx < 0 or sy >= h or sx >= w or not source[sy, sx]:
                continue
            d = _mismatch(picture, weight, y, x, sy, sx, best)
            if d < best:
                by, bx, best = sy, sx, d
        nearest[y, x, 0], nearest[y, x, 1], cost[y, x] = by, bx, best


@kernel
def vote(
    picture: Any, weight: Any, targets: Any, nearest: Any, cost: Any, spread: float, sums: Any, counts: Any
) -> None:
    """Add every target patch's source, shifted in light, to ``sums`` (h, w, 3) and its say to ``counts`` (h, w)."""
    for k in range(len(targets)):
        y, x = targets[k, 0], targets[k, 1]
        sy, sx = nearest[y, x, 0], nearest[y, x, 1]
        # Wexler's weight: likeness times trust in the patch's middle. The last term keeps a mean where all are bad.
        say = np.exp(-cost[y, x] / spread) * weight[y, x] + 1e-20
        total = 1e-12
        shift = np.zeros(3)
        for dy in range(-RADIUS, RADIUS + 1):
            for dx in range(-RADIUS, RADIUS + 1):
                w = weight[y + dy, x + dx]
                total += w
                for c in range(3):
                    shift[c] += w * (picture[y + dy, x + dx, c] - picture[sy + dy, sx + dx, c])
        for c in range(3):
            shift[c] = min(max(FREE_SHIFT * shift[c] / total, -LARGEST_SHIFT[c]), LARGEST_SHIFT[c])
        for dy in range(-RADIUS, RADIUS + 1):
            for dx in range(-RADIUS, RADIUS + 1):
                counts[y + dy, x + dx] += say
                for c in range(3):
                    sums[y + dy, x + dx, c] += say * (picture[sy + dy, sx + dx, c] + shift[c])


@kernel
def vote_slopes(
    picture: Any, weight: Any, targets: Any, nearest: Any, cost: Any, spread: float, sums: Any, counts: Any
) -> None:
    """Add the gradients of every source patch, down and to the right, to ``sums`` (2, h, w, 3).

    Their weights go to ``counts`` (2, h, w). Gradients do not depend on the patch's shift of light."""
    for k in range(len(targets)):
        y, x = targets[k, 0], targets[k, 1]
        sy, sx = nearest[y, x, 0], nearest[y, x, 1]
        say = np.exp(-cost[y, x] / spread) * weight[y, x] + 1e-20
        for side in range(2):
            down, right = 1 - side, side
            for dy in range(-RADIUS, RADIUS + 1 - down):
                for dx in range(-RADIUS, RADIUS + 1 - right):
                    counts[side, y + dy, x + dx] += say
                    for c in range(3):
                        step = picture[sy + dy + down, sx + dx + right, c] - picture[sy + dy, sx + dx, c]
                        sums[side, y + dy, x + dx, c] += say * step


@kernel
def relax(values: Any, free: Any, bend: Any, hold: float, sweeps: int) -> None:
    """Sweeps of successive over-relaxation of ``laplace(values) - hold values = bend`` over ``free`` pixels [row,
    column] (k, 2) of ``values`` and ``bend`` (h, w, c), mirrored at the border."""
    h, w, channels = values.shape
    # Gauss-Seidel: the equation solved for its middle pixel; over-relaxed by 1.5, in alternating order.
    inverse = np.float32(1 / (4 + hold))
    for sweep in range(sweeps):
        for i in range(len(free)):
            k = i if sweep % 2 == 0 else len(free) - 1 - i
            y, x = free[k, 0], free[k, 1]
            up, down = max(y - 1, 0), min(y + 1, h - 1)
            left, right = max(x - 1, 0), min(x + 1, w - 1)
            for c in range(channels):
                around = values[up, x, c] + values[down, x, c] + values[y, left, c] + values[y, right, c]
                values[y, x, c] += np.float32(1.5) * ((around - bend[y, x, c]) * inverse - values[y, x, c])


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    side = 2 * SIDE
    picture, weight = np.zeros((side, side, 3), np.float32), np.ones((side, side), np.float32)
    source = np.zeros((side, side), np.bool_)
    source[RADIUS, RADIUS] = True
    targets = np.array([[RADIUS, RADIUS]], np.int32)
    nearest, cost = np.full((side, side, 2), RADIUS, np.int32), np.zeros((side, side), np.float32)
    measure(picture, weight, targets, nearest, cost)
    search(picture, weight, source, targets, nearest, cost, 1, 0, False)
    vote(picture, weight, targets, nearest, cost, 1.0, np.zeros((side, side, 3)), np.zeros((side, side)))
    vote_slopes(picture, weight, targets, nearest, cost, 1.0, np.zeros((2, side, side, 3)), np.zeros((2, side, side)))
    relax(picture, targets, picture, 0.0, 1)
