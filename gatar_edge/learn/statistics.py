"""Means with 95 % bootstrap intervals; comparisons are paired by mission."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

RESAMPLES = 4000
_EDGES = (2.5, 97.5)

Values = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean and its 95 % interval."""

    mean: float
    lo: float
    hi: float

    def to_json(self) -> dict[str, float]:
        """For machines, rounded to what the interval can carry."""
        return {"mean": round(self.mean, 4), "lo": round(self.lo, 4), "hi": round(self.hi, 4)}


def mean_interval(values: Values) -> Interval:
    """Of the mean of `values` [n], n >= 1."""
    low, high = np.percentile(_resampled(values), _EDGES)
    return Interval(float(values.mean()), float(low), float(high))


def ratio_interval(values: Values, reference: Values) -> Interval:
    """Of mean(values) / mean(reference), both [n], pairs resampled together; 1 where both are 0 throughout."""
    over, under = _resampled(values), _resampled(reference)
    ratios = np.divide(over, under, out=np.ones_like(over), where=under > 0)
    low, high = np.percentile(ratios, _EDGES)
    mean = float(values.mean() / reference.mean()) if reference.any() else 1.0
    return Interval(mean, float(low), float(high))


def _resampled(values: Values) -> Values:
    """Means of `RESAMPLES` draws with replacement: the same draws for every array of one length."""
    count = len(values)
    drawn = np.random.default_rng(0).integers(count, size=(RESAMPLES, count))
    means: Values = values[drawn].mean(axis=1)
    return means
