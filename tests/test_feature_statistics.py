"""Statistics of episodes against NumPy on all of their values at once."""

from __future__ import annotations

import numpy as np

from f3sr.env.feature_statistics import QUANTILES, PictureStatistics, joined, statistics_of


def test_an_episode_s_statistics_are_numpy_s() -> None:
    rows = np.random.default_rng(0).normal(size=(50, 3))
    found = statistics_of(rows)
    assert np.allclose(found["mean"], rows.mean(0)) and np.allclose(found["std"], rows.std(0))
    assert np.array_equal(found["min"], rows.min(0)) and np.array_equal(found["max"], rows.max(0))
    assert np.allclose(found["q10"], np.quantile(rows, 0.1, axis=0)) and found["count"].tolist() == [50]


def test_pictures_are_counted_exactly() -> None:
    rng = np.random.default_rng(1)
    pictures = rng.integers(0, 256, (4, 10, 12, 3)).astype(np.uint8)
    pictures[..., 2] = 7
    counted = PictureStatistics()
    for picture in pictures:
        counted.add(picture)
    found, values = counted.statistics, pictures.reshape(-1, 3) / 255
    for name, of in (("min", values.min(0)), ("max", values.max(0)), ("mean", values.mean(0)), ("std", values.std(0))):
        assert found[name].shape == (3, 1, 1) and np.allclose(found[name].ravel(), of), name
    for name, q in zip(("q01", "q10", "q50", "q90", "q99"), QUANTILES, strict=True):
        assert np.allclose(found[name].ravel(), np.quantile(values, q, axis=0, method="inverted_cdf")), name
    assert found["count"].tolist() == [4]


def test_episodes_join_to_the_statistics_of_all_frames() -> None:
    rng = np.random.default_rng(2)
    episodes = [rng.normal(k, 1 + k, (10 * (k + 1), 2)) for k in range(3)]
    found, whole = joined([statistics_of(e) for e in episodes]), statistics_of(np.concatenate(episodes))
    for name in ("min", "max", "mean", "std", "count"):
        assert np.allclose(found[name], whole[name]), name
    assert (found["q10"] < found["q50"]).all() and (found["q50"] < found["q90"]).all()
