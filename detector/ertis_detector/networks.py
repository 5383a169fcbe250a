"""A committee of small neural networks, applied by numpy: the mean of their votes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float32 = npt.NDArray[np.float32]
FEATURE_CAP = 5.0  # standard deviations: nothing further out was ever learnt from


@dataclass(frozen=True, slots=True, eq=False)
class Committee:
    """Networks of two hidden layers of rectifiers, and one of probabilities, side by side.

    mean, scale : float32, shape (num_features,)
        Features are standardised by them, and capped.
    first, second, last : float32
        Shapes (num_networks, num_features, h1), (num_networks, h1, h2), (num_networks, h2,
        num_classes).
    first_bias, second_bias, last_bias : float32
        Shapes (num_networks, 1, h1), (num_networks, 1, h2), (num_networks, 1, num_classes).
    """

    mean: Float32
    scale: Float32
    first: Float32
    first_bias: Float32
    second: Float32
    second_bias: Float32
    last: Float32
    last_bias: Float32

    def votes(self, features: Float32) -> Float32:
        """Mean of the networks' probabilities, shape (n, num_classes), from (n, num_features)."""
        rows = np.clip((features - self.mean) / self.scale, -FEATURE_CAP, FEATURE_CAP)
        hidden = np.maximum(rows @ self.first + self.first_bias, 0)
        hidden = np.maximum(hidden @ self.second + self.second_bias, 0)
        return np.asarray(softmax(hidden @ self.last + self.last_bias).mean(axis=0))


def softmax(values: Float32) -> Float32:
    """Last axis to probabilities."""
    lifted = np.exp(values - values.max(axis=-1, keepdims=True))
    return np.asarray(lifted / lifted.sum(axis=-1, keepdims=True))
