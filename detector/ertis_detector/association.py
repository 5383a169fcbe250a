"""Which detection belongs to which track: the best assignment of all at once."""

from __future__ import annotations

import math

import numpy as np

from ertis_detector.motion import Float


def assign(scores: Float) -> list[tuple[int, int]]:
    """Pairs of row and column with the greatest sum of scores; what does not pay stays alone.

    The Hungarian method with potentials (Kuhn 1955; Munkres 1957), row by row. For the few
    detections of a ping; importing ``scipy.optimize`` for it would take 0.3 s and 240 modules.

    Parameters
    ----------
    scores : float64, shape (num_rows, num_columns)
        Worth of each pair against leaving both alone; of no use at 0 or less, or -inf.

    Returns
    -------
    list of (row, column)
        Only pairs of a positive score, each row and column at most once.
    """
    num_rows, num_columns = scores.shape
    if not scores.size:
        return []
    if num_rows > num_columns:  # work goes with the square of the rows
        return [(row, column) for column, row in assign(scores.T)]
    # A column of its own for each row, where it stays alone at no cost.
    cost = np.zeros((num_rows, num_columns + num_rows))
    cost[:, :num_columns] = -np.maximum(scores, 0.0)
    taken = _rows_of_columns(cost)
    return [
        (row, column)
        for column, row in enumerate(taken[:num_columns])
        if row is not None and scores[row, column] > 0.0
    ]


def _rows_of_columns(cost: Float) -> list[int | None]:
    """The row that each column gets at the least total cost; no fewer columns than rows."""
    num_rows, num_columns = cost.shape
    of_row, of_column = np.zeros(num_rows), np.zeros(num_columns)
    taken: list[int | None] = [None] * num_columns
    for start in range(num_rows):
        reduced = np.full(num_columns, math.inf)
        come_from = np.full(num_columns, -1)
        done = np.zeros(num_columns, bool)
        path = [start]  # rows of the alternating tree
        row, last = start, -1
        while True:
            slack = cost[row] - of_row[row] - of_column
            better = ~done & (slack < reduced)
            reduced[better], come_from[better] = slack[better], last
            column = int(np.where(done, math.inf, reduced).argmin())
            step = reduced[column]
            of_row[path] += step
            of_column[done] -= step
            reduced[~done] -= step
            done[column] = True
            last, owner = column, taken[column]
            if owner is None:
                break
            row = owner
            path.append(row)
        while last >= 0:
            before = int(come_from[last])
            taken[last] = start if before < 0 else taken[before]
            last = before
    return taken
