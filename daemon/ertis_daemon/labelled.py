"""Which is believed of a data set's ping: its recording's truth, or its line of the table."""

from __future__ import annotations

from typing import Any

from ertis_driver.dataset import NONE, DatasetRow


def recorded_truth(
    row: DatasetRow | None, recorded: dict[str, Any] | None
) -> dict[str, Any] | None:
    """What the recording says stands where; None if its table's line is to be believed instead.

    A simulator knows everything and is believed, unless somebody corrected the label. A person's
    recording knows no more than the label it was made with.

    Parameters
    ----------
    row : DatasetRow or None
        None for a recording of no data set: then it alone is believed.
    recorded : dict or None
        The ping's truth, as its recording has it.
    """
    if recorded is None or "landmarks" not in recorded:
        return None
    if row is None:
        return recorded
    landmarks = recorded["landmarks"]
    label = str(landmarks[0]["label"]) if landmarks else NONE
    return recorded if label == row.label else None
