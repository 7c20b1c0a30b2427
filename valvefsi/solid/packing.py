"""Coefficients of a form, gathered cell by cell once; afterwards only those of the position."""

from __future__ import annotations

import numpy as np

from valvefsi import dolfinx_compat as compat

# isort: split
from dolfinx import fem


class PackedPosition:
    """The coefficients that an assembled form reads, kept between calls.

    ``fem.pack_coefficients`` makes a new array of all coefficients at every call; here the columns of the position
    are filled in place, and those of fields that do not change (fibres) stay as they were.

    Args:
        form: A compiled form of one kind of integral.
        position: The coefficient that changes.
    """

    def __init__(self, form: fem.Form, position: fem.Function) -> None:
        self._values = position.x.array
        kept = self._values.copy()
        self._values[:] = np.arange(len(kept))
        first = {key: np.array(packed) for key, packed in compat.pack_coefficients(form).items()}
        self._values[:] += 0.5
        second = compat.pack_coefficients(form)
        self._values[:] = kept
        self._blocks = []
        self._packed = first
        for key, block in first.items():
            columns = np.flatnonzero(np.any(np.asarray(second[key]) != block, axis=0)) if len(block) else []
            if len(columns) == 0:
                continue
            dofs = block[:, columns].astype(np.intp)
            self._blocks.append((block, slice(columns[0], columns[-1] + 1), dofs, np.empty(dofs.shape)))

    def __call__(self) -> dict[tuple[object, int], np.ndarray]:
        """Return the coefficients at the present position; the next call overwrites them."""
        for block, columns, dofs, gathered in self._blocks:
            np.take(self._values, dofs, out=gathered, mode="clip")
            block[:, columns] = gathered
        return self._packed
