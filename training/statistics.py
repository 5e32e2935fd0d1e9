"""Means with confidence intervals, and curves of equal length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: 97.5 % quantiles of Student's t for 1 to 12 degrees of freedom.
T_TABLE = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179)


@dataclass(frozen=True)
class Estimate:
    """A mean over episodes; `half` is half the width of its 95 % confidence interval, NaN for a single episode."""

    mean: float
    half: float
    count: int

    def text(self, digits: int = 1, scale: float = 1.0) -> str:
        if not math.isfinite(self.mean):
            return "-"
        band = f" ± {self.half * scale:,.{digits}f}" if math.isfinite(self.half) else ""
        return f"{self.mean * scale:,.{digits}f}{band}"


def t_quantile(freedom: int) -> float:
    """The 97.5 % quantile of Student's t; exact to 0.1 % (Cornish-Fisher expansion beyond the table)."""
    if freedom < 1:
        return math.nan
    if freedom <= len(T_TABLE):
        return T_TABLE[freedom - 1]
    z = 1.959964
    return z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)


def estimate(values: Sequence[float] | NDArray[np.floating]) -> Estimate:
    """Mean and 95 % confidence interval (Student t, independent episodes)."""
    data = np.asarray(values, dtype=np.float64)
    n = len(data)
    if n == 0:
        return Estimate(math.nan, math.nan, 0)
    half = t_quantile(n - 1) * float(data.std(ddof=1)) / math.sqrt(n) if n > 1 else math.nan
    return Estimate(float(data.mean()), half, n)


def align(curves: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """Curves as rows (episodes, views); one that ended early keeps its last value."""
    longest = max((len(c) for c in curves), default=0)
    rows = [list(c) + [c[-1]] * (longest - len(c)) for c in curves if len(c)]
    return np.array(rows, dtype=np.float64).reshape(len(rows), longest)


def band(curves: Sequence[Sequence[float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean (views,) and half width of the 95 % interval (views,), 0 for a single curve."""
    rows = align(curves)
    n = len(rows)
    if n < 2:
        return rows.reshape(-1, rows.shape[1])[0] if n else np.empty(0), np.zeros(rows.shape[1])
    return rows.mean(axis=0), t_quantile(n - 1) * rows.std(axis=0, ddof=1) / math.sqrt(n)
