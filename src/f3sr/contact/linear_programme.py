"""Linear programmes that are solved again with other costs or right sides, each from where the last one ended.

The solver is HiGHS (Huangfu and Hall, "Parallelizing the dual revised simplex method", Mathematical Programming
Computation 10, 2018).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from f3sr.core.transforms import Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Optimum:
    """Where a linear programme is least."""

    x: Array
    """(n,)."""
    value: float
    """Its cost."""
    duals: Array
    """(k,) rates at which the cost changes with each row's right side."""


class LinearProgramme:
    """``cost @ x`` is to be least with ``rows @ x = equal`` and ``low <= x <= high``.

    ``rows`` is a sparse matrix (k, n), ``equal`` (k,); ``low`` and ``high`` are numbers or (n,). Equal calls in equal
    order give equal optima.
    """

    def __init__(
        self,
        cost: Array,
        rows: Any,
        equal: Array,
        *,
        low: Array | float = 0.0,
        high: Array | float = np.inf,
    ) -> None:
        import highspy
        from scipy.sparse import csc_array

        matrix: Any = csc_array(rows)
        model = highspy.HighsLp()
        model.num_row_, model.num_col_ = matrix.shape
        model.col_cost_ = cost
        model.col_lower_, model.col_upper_ = (np.broadcast_to(v, cost.shape).astype(float) for v in (low, high))
        model.row_lower_, model.row_upper_ = equal, equal
        model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        model.a_matrix_.start_, model.a_matrix_.index_ = matrix.indptr, matrix.indices
        model.a_matrix_.value_ = matrix.data
        self._solver = _solver_class()()
        # A presolved programme would be solved from scratch each time.
        for option, value in {"output_flag": False, "presolve": "off", "threads": 1}.items():
            self._solver.setOptionValue(option, value)
        self._solver.passModel(model)

    def add(self, rows: Any, at_most: Array) -> None:
        """Ask for ``rows @ x <= at_most`` too, with sparse rows (k, n)."""
        from scipy.sparse import csr_array

        more: Any = csr_array(rows)
        lowest = np.full(len(at_most), -np.inf)
        self._solver.addRows(len(at_most), lowest, at_most, more.nnz, more.indptr[:-1], more.indices, more.data)

    def solve(self, *, cost: Array | None = None, equal: Array | None = None) -> Optimum | None:
        """The optimum, from now on with another ``cost`` (n,) or other right sides ``equal`` (k,). None where no x is
        allowed, where the cost has no bound, or where rounding keeps the solver from an end."""
        import highspy

        if cost is not None:
            self._solver.changeColsCost(len(cost), np.arange(len(cost), dtype=np.int32), cost)
        if equal is not None:
            self._solver.changeRowsBounds(len(equal), np.arange(len(equal), dtype=np.int32), equal, equal)
        self._solver.run()
        if self._solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
            return None
        solution = self._solver.getSolution()
        return Optimum(
            x=np.array(solution.col_value),
            value=float(self._solver.getInfo().objective_function_value),
            duals=np.array(solution.row_dual),
        )


@cache
def _solver_class() -> type[Any]:
    import highspy

    class Silent(highspy.Highs):
        """HiGHS without callbacks: to enable them prints a banner, whatever the options."""

        def enableCallbacks(self) -> None:
            pass

    return Silent
