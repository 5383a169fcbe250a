"""Models on disk: safetensors with JSON metadata. Loading one runs nothing."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ertis_detector.classifier import OneVersusOne
from ertis_detector.detection import NONE
from ertis_detector.errors import ModelError, ModelMismatch
from ertis_detector.features import FEATURE_VERSION, NUM_FEATURES

MODEL_FORMAT = "ertis-model/1"
MAX_MODEL_BYTES = 1_000_000
_ARRAYS = ("mean", "scale", "weights", "bias", "coupling", "offset")


@dataclass(frozen=True, slots=True)
class ModelCard:
    """What a model was made of, and for.

    chirp : str
        ``Chirp.name`` of the emission that it was trained on.
    audio_filter : str
        Version of the decimation filter.
    source : str
        Who made the training recordings: ``live`` or ``sim``.
    data : str
        Name, size and SHA-256 of the training recordings.
    min_probability : float
        From here on a landmark, of whichever size, is reported, unless the user says otherwise.
    figures : mapping
        What its cross-validation gave.
    """

    name: str
    chirp: str
    audio_filter: str
    source: str
    data: str
    min_probability: float = 0.5
    features: str = FEATURE_VERSION
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A classifier and its card."""

    classifier: OneVersusOne
    card: ModelCard

    @property
    def name(self) -> str:
        """What events call it."""
        return self.card.name

    @property
    def classes(self) -> tuple[str, ...]:
        """Labels it tells apart."""
        return self.classifier.classes

    def check(self, *, chirp: str, audio_filter: str) -> None:
        """Refuse a device whose settings the model was not trained for.

        Raises
        ------
        ModelMismatch
        """
        for what, met, expected in (
            ("chirp", chirp, self.card.chirp),
            ("audio filter", audio_filter, self.card.audio_filter),
            ("feature version", FEATURE_VERSION, self.card.features),
        ):
            if met != expected:
                raise ModelMismatch(
                    f"model {self.name} was trained for {what} {expected}, met {met}: "
                    f"use a model for it, or set the device to {expected}"
                )


def save_model(model: Model, path: Path) -> None:
    """Write a model, replacing the file in one step."""
    classifier = model.classifier
    arrays = {name: np.ascontiguousarray(getattr(classifier, name)) for name in _ARRAYS}
    metadata = {
        "format": MODEL_FORMAT,
        "classes": json.dumps(classifier.classes),
        "card": json.dumps(asdict(model.card), sort_keys=True),
    }
    temporary = path.with_suffix(path.suffix + ".part")
    temporary.write_bytes(save(arrays, metadata))
    temporary.replace(path)


def load_model(path: Path) -> Model:
    """Read a model and check all of it.

    Raises
    ------
    ModelError
        If the file is absent, foreign, too large, damaged, or its arrays do not fit together.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ModelError(f"model {path}: {error.strerror}: name an existing file") from error
    if size > MAX_MODEL_BYTES:
        raise ModelError(f"model {path}: {size} bytes, expected at most {MAX_MODEL_BYTES}")
    try:
        with safe_open(str(path), "numpy") as file:
            metadata = file.metadata() or {}
            names = set(file.keys())
            arrays = {name: file.get_tensor(name) for name in _ARRAYS if name in names}
    except (SafetensorError, OSError) as error:
        raise ModelError(
            f"model {path}: not a safetensors file, or damaged ({error}): make it again"
        ) from error
    if metadata.get("format") != MODEL_FORMAT or set(arrays) != set(_ARRAYS):
        raise ModelError(
            f"model {path}: format {metadata.get('format')!r}, expected {MODEL_FORMAT!r}: "
            "make it again with 'ertis train'"
        )
    try:
        model = _assemble(arrays, metadata)
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"model {path}: metadata is damaged ({error}): make it again") from error
    _check_arrays(model.classifier, path)
    return model


def _assemble(arrays: dict[str, Any], metadata: dict[str, str]) -> Model:
    classes = json.loads(metadata["classes"])
    if not (isinstance(classes, list) and all(isinstance(name, str) for name in classes)):
        raise ValueError("classes are no list of names")
    return Model(
        OneVersusOne(
            tuple(classes),
            arrays["mean"],
            arrays["scale"],
            arrays["weights"],
            arrays["bias"],
            arrays["coupling"],
            arrays["offset"],
        ),
        ModelCard(**json.loads(metadata["card"])),
    )


def _check_arrays(classifier: OneVersusOne, path: Path) -> None:
    count = len(classifier.classes)
    pairs = count * (count - 1) // 2
    expected = {
        "mean": (NUM_FEATURES,),
        "scale": (NUM_FEATURES,),
        "weights": (pairs, NUM_FEATURES),
        "bias": (pairs,),
        "coupling": (pairs, count),
        "offset": (count,),
    }
    if count < 2 or len(set(classifier.classes)) != count or NONE not in classifier.classes:
        raise ModelError(
            f"model {path}: classes {classifier.classes}, expected '{NONE}' and others"
        )
    for name, shape in expected.items():
        array = getattr(classifier, name)
        if array.shape != shape or array.dtype != np.float32 or not np.isfinite(array).all():
            raise ModelError(
                f"model {path}: {name} is {array.dtype} {array.shape}, expected finite float32 "
                f"{shape}: make it again"
            )
    if not (classifier.scale > 0).all():
        raise ModelError(f"model {path}: scale has a value not above 0: make it again")


def model_file_name(chirp: str) -> str:
    """The file that a model for a chirp is shipped as."""
    return chirp.replace(":", "_") + ".safetensors"


def shipped_model(chirp: str) -> Path:
    """The model that ships for a chirp.

    Raises
    ------
    ModelMismatch
        If none does.
    """
    folder = Path(str(resources.files("ertis_detector"))) / "models"
    path = folder / model_file_name(chirp)
    if not path.exists():
        known = ", ".join(sorted(p.stem.replace("_", ":") for p in folder.glob("*.safetensors")))
        raise ModelMismatch(
            f"no model ships for chirp {chirp} (there are: {known or 'none'}): train one with "
            "'ertis train', or set one of these chirps"
        )
    return path


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        digest = hashlib.sha256()
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
