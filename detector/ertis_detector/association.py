"""Which detection belongs to which track: the best assignment of all at once."""

from __future__ import annotations

import math

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
    cost = [[-max(score, 0.0) for score in row] + [0.0] * num_rows for row in scores.tolist()]
    taken = _rows_of_columns(cost)
    return [
        (row, column)
        for column, row in enumerate(taken[:num_columns])
        if row is not None and scores[row, column] > 0.0
    ]


def _rows_of_columns(cost: list[list[float]]) -> list[int | None]:
    """The row that each column gets at the least total cost; no fewer columns than rows.

    In plain numbers: for so few of them arrays would take longer.
    """
    num_rows, num_columns = len(cost), len(cost[0])
    of_row, of_column = [0.0] * num_rows, [0.0] * num_columns
    taken: list[int | None] = [None] * num_columns
    for start in range(num_rows):
        reduced, come_from = [math.inf] * num_columns, [-1] * num_columns
        left = list(range(num_columns))  # columns that the tree has not reached
        reached: list[int] = []
        path = [start]  # rows of the alternating tree
        row, last = start, -1
        while True:
            costs, level = cost[row], of_row[row]
            for column in left:
                slack = costs[column] - level - of_column[column]
                if slack < reduced[column]:
                    reduced[column], come_from[column] = slack, last
            nearest = min(left, key=reduced.__getitem__)
            step = reduced[nearest]
            for one in path:
                of_row[one] += step
            for column in reached:
                of_column[column] -= step
            for column in left:
                reduced[column] -= step
            left.remove(nearest)
            reached.append(nearest)
            last, owner = nearest, taken[nearest]
            if owner is None:
                break
            row = owner
            path.append(row)
        while last >= 0:
            before = come_from[last]
            taken[last] = start if before < 0 else taken[before]
            last = before
    return taken
