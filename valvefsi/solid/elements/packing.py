"""Coefficients of a form, gathered cell by cell once; afterwards only those that change."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
from dolfinx import fem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valvefsi.types import Array


class PackedFunctions:
    """The coefficients that an assembled form reads, kept between calls.

    ``fem.pack_coefficients`` makes a new array of all coefficients at every call; here the columns of the functions
    that change are filled in place, and those of fields that do not (fibres) stay as they were.

    Args:
        form: A compiled form of one kind of integral.
        functions: The coefficients that change.
    """

    def __init__(self, form: fem.Form, *functions: fem.Function) -> None:
        self._packed = {key: np.array(block) for key, block in compat.pack_coefficients(form).items()}
        self._blocks: list[tuple[Array, Array, slice, NDArray[np.intp], Array]] = []
        for function in functions:
            self._find(form, function.x.array)

    def _find(self, form: fem.Form, values: Array) -> None:
        """Find the columns of one function and the degree of freedom behind each of their entries."""
        kept = values.copy()
        values[:] = np.arange(len(kept))
        first = {key: np.array(packed) for key, packed in compat.pack_coefficients(form).items()}
        values[:] += 0.5
        second = compat.pack_coefficients(form)
        values[:] = kept
        for key, block in first.items():
            columns = np.flatnonzero(np.any(np.asarray(second[key]) != block, axis=0))
            if len(block) == 0 or len(columns) == 0:
                continue
            dofs = block[:, columns].astype(np.intp)
            where = slice(columns[0], columns[-1] + 1)
            self._blocks.append((values, self._packed[key], where, dofs, np.empty(dofs.shape)))

    def __call__(self) -> dict[tuple[Any, int], Array]:
        """Return the coefficients with the present values; the next call overwrites them."""
        for values, block, columns, dofs, gathered in self._blocks:
            np.take(values, dofs, out=gathered, mode="clip")
            block[:, columns] = gathered
        return self._packed
