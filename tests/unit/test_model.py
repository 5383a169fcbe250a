import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import save

from ertis_detector.classifier import Classifier
from ertis_detector.errors import ModelError, ModelMismatch
from ertis_detector.features import NUM_FEATURES
from ertis_detector.model import (
    MAX_MODEL_BYTES,
    Model,
    ModelCard,
    file_sha256,
    load_model,
    model_file_name,
    save_model,
    shipped_model,
)
from ertis_detector.networks import Committee
from ertis_detector.readout import NUM_TERMS, Readout
from ertis_detector.trees import Trees
from ertis_driver.audio_filter import FILTER_VERSION
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP

CLASSES = ("none", "r35", "r48")
CARD = ModelCard("hall-1", DEFAULT_CHIRP.name, FILTER_VERSION, "sim", "3 recordings")


def arrays():
    """By name as in the file: two networks of three and two neurons, two trees a class."""
    rng = np.random.default_rng(1)

    def some(*shape):
        return rng.normal(size=shape).astype(np.float32)

    return {
        "committee.mean": some(NUM_FEATURES),
        "committee.scale": np.abs(some(NUM_FEATURES)) + 0.5,
        "committee.first": some(2, NUM_FEATURES, 3),
        "committee.first_bias": some(2, 1, 3),
        "committee.second": some(2, 3, 2),
        "committee.second_bias": some(2, 1, 2),
        "committee.last": some(2, 2, 3),
        "committee.last_bias": some(2, 1, 3),
        "trees.feature": np.tile(np.array([5, 7], np.uint8), 6),
        "trees.threshold": some(12),
        "trees.mask": np.tile(np.array([0xFFFFFFFC, 0xFFFFFFFE], np.uint32), 6),
        "trees.first": np.arange(0, 12, 2, dtype=np.int32),
        "trees.leaves": some(6, 32),
        "trees.baseline": some(3),
        "readout.mean": some(NUM_FEATURES),
        "readout.scale": np.abs(some(NUM_FEATURES)) + 0.5,
        "readout.weights": some(NUM_FEATURES + 3, 2),
        "readout.variances": np.abs(some(3, NUM_TERMS)),
        "coupling": some(6, 3),
        "offset": some(3),
    }


def made(**changes):
    """A model; changes by the arrays' names, a point written as two underscores."""
    given = {"classes": CLASSES, "sizes": CLASSES[1:], **arrays()}
    given |= {name.replace("__", "."): value for name, value in changes.items()}

    def part(prefix):
        return {k.removeprefix(prefix): v for k, v in given.items() if k.startswith(prefix)}

    classifier = Classifier(
        given["classes"],
        Committee(**part("committee.")),
        Trees(**part("trees.")),
        given["coupling"],
        given["offset"],
    )
    readout = Readout(given["sizes"], **part("readout."))
    return Model(classifier, readout, replace(CARD, figures={"accuracy": 0.9}))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "hall.safetensors"


@pytest.fixture
def saved(path):
    save_model(made(), path)
    return path


def refusal(path):
    """The one line that says why a model is refused; it names the file."""
    with pytest.raises(ModelError) as caught:
        load_model(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def test_a_model_reads_back_as_it_was_written(saved):
    model, original = load_model(saved), made()
    assert model.card == original.card
    assert model.classes == CLASSES
    assert model.name == "hall-1"
    features = np.random.default_rng(2).normal(size=(50, NUM_FEATURES)).astype(np.float32)
    np.testing.assert_array_equal(
        model.classifier.probabilities(features), original.classifier.probabilities(features)
    )


def test_trees_of_eighteen_sizes_are_not_too_many(path):
    trees = 20 * 150  # as training makes them, none and unknown included
    splits = trees * 31
    many = made(
        trees__feature=np.zeros(splits, np.uint8),
        trees__threshold=np.ones(splits, np.float32),
        trees__mask=np.full(splits, 0xFFFFFFFE, np.uint32),
        trees__first=np.arange(0, splits, 31, dtype=np.int32),
        trees__leaves=np.ones((trees, 32), np.float32),
    )
    save_model(many, path)
    assert load_model(path).classifier.trees.first.size == trees


def test_saving_replaces_the_file_and_leaves_nothing_beside_it(saved):
    save_model(made(offset=np.full(3, 2.0, np.float32)), saved)
    assert np.all(load_model(saved).classifier.offset == 2.0)
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_an_absent_file_is_refused(path):
    assert "No such file" in refusal(path)


def test_a_folder_is_refused(tmp_path):
    refusal(tmp_path)


@pytest.mark.parametrize("content", [b"", b"\0", b"PK\3\4 something else", b"\xff" * 4000])
def test_a_foreign_file_is_refused(path, content):
    path.write_bytes(content)
    assert "not a safetensors file" in refusal(path)


def test_a_pickle_is_refused_and_not_run(path, tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    path.write_bytes(pickle.dumps(Trap()))
    assert "not a safetensors file" in refusal(path)
    assert not (tmp_path / "ran").exists()


def test_safetensors_of_somebody_else_are_refused(path):
    path.write_bytes(save({"mean": np.zeros(3, np.float32)}, {"format": "pt"}))
    assert "'pt'" in refusal(path)
    path.write_bytes(save({"mean": np.zeros(3, np.float32)}))
    assert "expected 'ertis-model/4'" in refusal(path)


@pytest.mark.parametrize("part", [0.01, 0.1, 0.5, 0.9, 0.999])
def test_a_file_cut_anywhere_is_refused(saved, part):
    data = saved.read_bytes()
    saved.write_bytes(data[: int(len(data) * part)])
    refusal(saved)


def test_a_file_with_something_after_its_end_is_refused(saved):
    saved.write_bytes(saved.read_bytes() + b"more")
    refusal(saved)


def test_a_turned_bit_is_refused_or_leaves_a_model_that_can_be_used(saved):
    data = saved.read_bytes()
    rng = np.random.default_rng(3)
    features = rng.normal(size=(4, NUM_FEATURES)).astype(np.float32)
    refused = 0
    for _ in range(400):
        place, bit = int(rng.integers(len(data))), int(rng.integers(8))
        damaged = bytearray(data)
        damaged[place] ^= 1 << bit
        saved.write_bytes(damaged)
        try:
            model = load_model(saved)
        except ModelError as error:
            assert "\n" not in str(error)  # noqa: PT017
            refused += 1
            continue
        with np.errstate(all="ignore"):
            assert model.classifier.probabilities(features).shape == (4, len(model.classes))
    assert refused > 20


def test_a_file_too_large_is_refused_unread(path):
    path.write_bytes(b"\0" * (MAX_MODEL_BYTES + 1))
    assert f"at most {MAX_MODEL_BYTES}" in refusal(path)


def one_less(array):
    return np.ascontiguousarray(array[:-1])


@pytest.mark.parametrize(
    ("name", "wrong", "told"),
    [
        ("committee.first", lambda a: a * np.float32(np.nan), "committee.first"),
        ("committee.first", lambda a: np.ascontiguousarray(a[:, :-1]), "committee.first"),
        ("committee.first", lambda a: a[0], "committee.first"),
        ("committee.second", one_less, "committee.second"),
        ("committee.last_bias", lambda a: a + np.float32(np.inf), "committee.last_bias"),
        ("committee.scale", lambda a: 0 * a, "not above 0"),
        ("trees.leaves", one_less, "trees.leaves"),
        ("trees.threshold", one_less, "trees.threshold"),
        ("trees.feature", lambda a: a.astype(np.int32), "int32"),
        ("trees.feature", lambda a: a + np.uint8(200), "not there"),
        ("trees.mask", lambda a: 0 * a, "lead nowhere"),
        ("trees.first", lambda a: a[::-1].copy(), "lead nowhere"),
        ("trees.first", lambda a: a + np.int32(1), "lead nowhere"),
        ("trees.first", lambda a: 0 * a, "lead nowhere"),
        ("readout.weights", one_less, "readout.weights"),
        ("readout.scale", lambda a: 0 * a, "not above 0"),
        ("readout.mean", lambda a: a.astype(np.float64), "float64"),
        ("coupling", one_less, "coupling"),
        ("offset", lambda a: a * np.float32(np.nan), "offset"),
    ],
)
def test_arrays_that_make_no_model_are_refused(path, name, wrong, told):
    save_model(made(**{name.replace(".", "__"): wrong(arrays()[name])}), path)
    assert told in refusal(path)


def test_a_tree_of_more_splits_than_its_leaves_allow_is_refused(path):
    splits = {
        "trees__feature": np.zeros(40, np.uint8),
        "trees__threshold": np.zeros(40, np.float32),
        "trees__mask": np.full(40, 0xFFFFFFFE, np.uint32),
    }
    save_model(made(**splits, trees__first=np.array([0, 31, 32, 33, 34, 35], np.int32)), path)
    load_model(path)
    save_model(made(**splits, trees__first=np.array([0, 32, 33, 34, 35, 36], np.int32)), path)
    assert "lead nowhere" in refusal(path)


def test_weights_that_training_made_vanish_are_loaded_as_nothing(path):
    first = arrays()["committee.first"]
    tiny = first.copy()
    tiny[:, ::2] *= np.float32(1e-38)
    save_model(made(committee__first=tiny), path)
    loaded = load_model(path).classifier.committee.first
    assert not loaded[:, ::2].any()
    np.testing.assert_array_equal(loaded[:, 1::2], first[:, 1::2])


@pytest.mark.parametrize(
    ("classes", "sizes"),
    [
        (("none",), ()),
        (("r35", "r48", "r58"), ("r35", "r48", "r58")),
        (("none", "r35", "r35"), ("r35", "r35")),
        (("none", "r35", "r48"), ("r48", "r35")),
        (("none", "r35", "bowl"), ("r35", "bowl")),
    ],
)
def test_classes_that_are_no_landmarks_are_refused(path, classes, sizes):
    save_model(made(classes=classes, sizes=sizes), path)
    assert "expected" in refusal(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"classes": "not json"},
        {"classes": "3"},
        {"classes": "[1, 2, 3]"},
        {"sizes": "{}"},
        {"card": "{}"},
        {"card": "[]"},
        {"card": json.dumps({"name": "x", "surprise": 1})},
        {"card": "7"},
    ],
)
def test_damaged_metadata_are_refused(path, changes):
    card = {"name": "x", "chirp": "c", "audio_filter": "f", "source": "sim", "data": "d"}
    metadata = {
        "format": "ertis-model/4",
        "classes": json.dumps(CLASSES),
        "sizes": json.dumps(CLASSES[1:]),
        "card": json.dumps(card),
    }
    path.write_bytes(save(arrays(), metadata))
    assert load_model(path).name == "x"
    path.write_bytes(save(arrays(), {**metadata, **changes}))
    assert "metadata is damaged" in refusal(path)


@pytest.mark.parametrize("key", ["classes", "sizes", "card"])
def test_absent_metadata_are_refused(path, key):
    whole = {"classes": "[]", "sizes": "[]", "card": "{}"}
    metadata = {k: v for k, v in whole.items() if k != key}
    path.write_bytes(save(arrays(), {"format": "ertis-model/4", **metadata}))
    assert key in refusal(path)


def test_a_model_takes_the_device_it_was_trained_for():
    made().check(chirp=DEFAULT_CHIRP.name, audio_filter=FILTER_VERSION)


@pytest.mark.parametrize(
    ("met", "expected"),
    [
        ({"chirp": INCUMBENT_CHIRP.name}, DEFAULT_CHIRP.name),
        ({"audio_filter": "butter6"}, FILTER_VERSION),
    ],
)
def test_a_model_of_another_device_names_both(met, expected):
    fits = {"chirp": DEFAULT_CHIRP.name, "audio_filter": FILTER_VERSION}
    with pytest.raises(ModelMismatch) as caught:
        made().check(**{**fits, **met})
    assert expected in str(caught.value)
    assert next(iter(met.values())) in str(caught.value)


def test_features_of_another_version_do_not_fit():
    old = replace(made(), card=replace(CARD, features="paper20-db-pairs-1"))
    with pytest.raises(ModelMismatch, match="paper20-db-pairs-1"):
        old.check(chirp=DEFAULT_CHIRP.name, audio_filter=FILTER_VERSION)


def test_a_chirp_without_a_shipped_model_is_named_with_what_to_do():
    with pytest.raises(ModelMismatch, match=r"linear:90000:30000:0\.001.*ertis train"):
        shipped_model("linear:90000:30000:0.001")


def test_the_default_chirps_shipped_model_loads_and_fits():
    model = load_model(shipped_model(DEFAULT_CHIRP.name))
    model.check(chirp=DEFAULT_CHIRP.name, audio_filter=FILTER_VERSION)
    assert {"none", "r35", "r48", "r58", "r70"} <= set(model.classes)


def test_file_names_hold_no_colon():
    assert ":" not in model_file_name(DEFAULT_CHIRP.name)


def test_the_sha256_is_that_of_the_content(path):
    path.write_bytes(b"abc")
    assert file_sha256(path).startswith("ba7816bf8f01cfea")
