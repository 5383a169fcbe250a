"""Models on disk: safetensors with JSON metadata. Loading one runs nothing."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ertis_detector.classifier import Classifier
from ertis_detector.detection import NONE, is_landmark, radius_m
from ertis_detector.errors import ModelError, ModelMismatch
from ertis_detector.features import FEATURE_VERSION, NUM_FEATURES
from ertis_detector.networks import Committee
from ertis_detector.readout import NUM_TERMS, Readout
from ertis_detector.trees import MAX_LEAVES, Trees

MODEL_FORMAT = "ertis-model/4"
TRACKING_PROBABILITY = 0.5  # evidence accumulates: a tracker hears of less sure ones, too
FOLLOWING_PROBABILITY = 0.2  # of what it follows already, of even less sure ones
MAX_MODEL_BYTES = 4_000_000  # some sixty sizes; one of four has 0.8 MB
_VANISHED = 1e-30  # of networks' weights: nobody hears of it, whatever it is multiplied by
_COMMITTEE = tuple(one.name for one in fields(Committee))
_TREES = tuple(one.name for one in fields(Trees))
_READOUT = ("mean", "scale", "weights", "variances")
_LAW = ("coupling", "offset")
_SPLITS = ("feature", "threshold", "mask")
_KINDS = {  # all others are float32
    "trees.feature": np.uint8,
    "trees.mask": np.uint32,
    "trees.first": np.int32,
}
_ARRAYS = (
    *(f"committee.{name}" for name in _COMMITTEE),
    *(f"trees.{name}" for name in _TREES),
    *(f"readout.{name}" for name in _READOUT),
    *_LAW,
)


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
    in_sight : float
        Part of pings with a landmark in sight where probabilities come true.
    figures, tracking : mapping
        What scenes left out gave at ``min_probability``, and at ``TRACKING_PROBABILITY``.
    """

    name: str
    chirp: str
    audio_filter: str
    source: str
    data: str
    min_probability: float = 0.5
    in_sight: float = 0.5
    features: str = FEATURE_VERSION
    figures: dict[str, float] = field(default_factory=dict)
    tracking: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A classifier, what reads places off echoes, and their card."""

    classifier: Classifier
    readout: Readout
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
    arrays = {
        **{f"committee.{name}": getattr(classifier.committee, name) for name in _COMMITTEE},
        **{f"trees.{name}": getattr(classifier.trees, name) for name in _TREES},
        **{f"readout.{name}": getattr(model.readout, name) for name in _READOUT},
        **{name: getattr(classifier, name) for name in _LAW},
    }
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    metadata = {
        "format": MODEL_FORMAT,
        "classes": json.dumps(classifier.classes),
        "sizes": json.dumps(model.readout.sizes),
        "card": json.dumps(asdict(model.card), sort_keys=True),
    }
    temporary = path.with_suffix(path.suffix + ".part")
    temporary.write_bytes(_in_order(save(arrays, metadata)))
    temporary.replace(path)


def _in_order(data: bytes) -> bytes:
    """The same file with its header's keys sorted: the library writes them as they come."""
    length = int.from_bytes(data[:8], "little")
    header = json.dumps(json.loads(data[8 : 8 + length]), sort_keys=True, separators=(",", ":"))
    padded = header.encode().ljust(-(-len(header) // 8) * 8)
    return len(padded).to_bytes(8, "little") + padded + data[8 + length :]


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
    _check_arrays(arrays, model, path)
    return model


def _assemble(arrays: dict[str, Any], metadata: dict[str, str]) -> Model:
    classes, sizes = (_names(json.loads(metadata[key])) for key in ("classes", "sizes"))
    committee = Committee(*(_flushed(arrays[f"committee.{name}"]) for name in _COMMITTEE))
    trees = Trees(*(arrays[f"trees.{name}"] for name in _TREES))
    return Model(
        Classifier(classes, committee, trees, arrays["coupling"], arrays["offset"]),
        Readout(sizes, *(arrays[f"readout.{name}"] for name in _READOUT)),
        ModelCard(**json.loads(metadata["card"])),
    )


def _flushed(array: Any) -> Any:
    """Weights that training made vanish become 0: denormal numbers take ten times as long."""
    return np.where(np.abs(array) < _VANISHED, np.float32(0), array)


def _names(value: Any) -> tuple[str, ...]:
    if not (isinstance(value, list) and all(isinstance(name, str) for name in value)):
        raise ValueError("classes are no list of names")
    return tuple(value)


def _check_arrays(arrays: dict[str, Any], model: Model, path: Path) -> None:
    classes, sizes = model.classes, model.readout.sizes
    landmarks = tuple(filter(is_landmark, classes))
    if len(set(classes)) != len(classes) or NONE not in classes or not landmarks:
        raise ModelError(f"model {path}: classes {classes}, expected '{NONE}' and sizes")
    if sizes != landmarks or not all(radius_m(name) for name in sizes):
        raise ModelError(f"model {path}: sizes {sizes}, expected those of its classes {classes}")
    for name, shape in _shapes(arrays, len(classes), len(sizes)).items():
        array, kind = arrays[name], _KINDS.get(name, np.float32)
        if array.shape != shape or array.dtype != kind or not np.isfinite(array).all():
            raise ModelError(
                f"model {path}: {name} is {array.dtype} {array.shape}, expected finite "
                f"{np.dtype(kind)} {shape}: make it again"
            )
    for name in ("committee.scale", "readout.scale"):
        if not (arrays[name] > 0).all():
            raise ModelError(f"model {path}: {name} has a value not above 0: make it again")
    _check_trees(arrays, len(classes), path)


def _check_trees(arrays: dict[str, Any], count: int, path: Path) -> None:
    """Every tree has splits, which ask features that are there and leave a leaf."""
    first, mask = arrays["trees.first"], arrays["trees.mask"]
    sizes = np.diff([*first, mask.size])
    whole = first.size > 0 and first.size % count == 0 and first[0] == 0
    whole = whole and bool(((sizes > 0) & (sizes < MAX_LEAVES)).all())
    # The rightmost leaf is on no split's left: whatever is answered, one leaf is left.
    if not whole or np.bitwise_and.reduceat(mask, first).min() == 0:
        raise ModelError(f"model {path}: its trees lead nowhere: make it again")
    if arrays["trees.feature"].max() >= NUM_FEATURES:
        raise ModelError(f"model {path}: its trees ask features that are not there: make it again")


def _shapes(arrays: dict[str, Any], count: int, sizes: int) -> dict[str, tuple[int, ...]]:
    """What each array must be shaped like; the numbers of networks and of neurons are free."""
    first, last = arrays["committee.first"].shape, arrays["committee.last"].shape
    networks, h1, h2 = first[0] if first else 0, first[-1] if first else 0, last[-2:-1]
    hidden = h2[0] if h2 else 0
    return {
        "committee.mean": (NUM_FEATURES,),
        "committee.scale": (NUM_FEATURES,),
        "committee.first": (networks, NUM_FEATURES, h1),
        "committee.first_bias": (networks, 1, h1),
        "committee.second": (networks, h1, hidden),
        "committee.second_bias": (networks, 1, hidden),
        "committee.last": (networks, hidden, count),
        "committee.last_bias": (networks, 1, count),
        **{f"trees.{name}": arrays["trees.feature"].shape[:1] for name in _SPLITS},
        "trees.first": arrays["trees.first"].shape[:1],
        "trees.leaves": (*arrays["trees.first"].shape[:1], MAX_LEAVES),
        "trees.baseline": (count,),
        "readout.mean": (NUM_FEATURES,),
        "readout.scale": (NUM_FEATURES,),
        "readout.weights": (NUM_FEATURES + 1 + sizes, 2),
        "readout.variances": (3, NUM_TERMS),
        "coupling": (2 * count, count),
        "offset": (count,),
    }


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
