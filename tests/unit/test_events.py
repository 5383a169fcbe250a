import dataclasses
import json
import math
import time
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from ertis_daemon.events import LandmarkEvent, LandmarkReport, json_schema
from ertis_daemon.status import Status

CONTRACT = Path(__file__).parents[2] / "daemon/EVENTS.md"

REPORT = LandmarkReport(
    track_id=3,
    state="new",
    label="r48",
    probabilities={"r48": 0.9, "none": 0.05, "unknown": 0.05},
    range_m=1.5,
    azimuth_rad=0.1,
    elevation_rad=-0.1,
    covariance=((1e-4, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3)),
    snr_db=21.0,
    radius_m=0.048,
)
EVENT = LandmarkEvent(
    schema="ertis.landmarks/1",
    device="ertis",
    ping_index=7,
    ping_time_ns=1_700_000_000_000_000_000,
    time_uncertainty_ns=1000,
    frame_id="sonar",
    source="sim",
    model="m",
    landmarks=(REPORT,),
    speed_of_sound_m_s=343.2,
    temperature_c=20.0,
)


def validate(event):
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(event, schema)


def test_an_event_fits_its_own_schema_and_keeps_its_values():
    event = json.loads(EVENT.to_json())
    validate(event)
    assert event["ping_time_ns"] == 1_700_000_000_000_000_000
    assert event["landmarks"][0]["class"] == "r48"
    assert "label" not in event["landmarks"][0]
    assert event["landmarks"][0]["covariance"][0] == [1e-4, 0, 0]


def test_nan_and_infinity_become_null_and_still_fit():
    rows = ((math.nan,) * 3,) * 3
    report = dataclasses.replace(
        REPORT, range_m=math.inf, snr_db=np.float64("nan"), covariance=rows, radius_m=None
    )
    data = dataclasses.replace(EVENT, landmarks=(report,), temperature_c=math.nan).to_json()
    event = json.loads(data, parse_constant=pytest.fail)
    validate(event)
    assert event["landmarks"][0]["range_m"] is None
    assert event["landmarks"][0]["covariance"][2] == [None] * 3


@pytest.mark.parametrize(
    "change",
    [
        {"schema": "ertis.landmarks/2"},
        {"extra": 1},
        {"landmarks": []},
        {"source": "mock"},
        {"ping_index": 2**32},
        {"ping_time_ns": 1.5},
        {"device": ""},
    ],
)
def test_the_schema_refuses_what_the_contract_excludes(change):
    event = {**json.loads(EVENT.to_json()), **change}
    with pytest.raises(jsonschema.ValidationError):
        validate(event)


@pytest.mark.parametrize(
    "change",
    [
        {"state": "gone"},
        {"range_m": -1},
        {"azimuth_rad": 4},
        {"covariance": [[1, 0], [0, 1]]},
        {"probabilities": {"r48": 1.1}},
        {"label": "r48"},
    ],
)
def test_the_schema_refuses_such_landmarks(change):
    event = json.loads(EVENT.to_json())
    event["landmarks"][0].update(change)
    with pytest.raises(jsonschema.ValidationError):
        validate(event)


def test_the_contract_names_every_field():
    contract = CONTRACT.read_text()
    schema = json_schema()
    named = [*schema["properties"], *schema["properties"]["landmarks"]["items"]["properties"]]
    for name in [*named, *Status().to_json()]:
        assert f"`{name}`" in contract, name
    assert "one event for each ping that has landmarks or lost tracks" in contract


def test_every_field_has_a_description():
    schema = json_schema()
    items = schema["properties"]["landmarks"]["items"]["properties"]
    assert all(p["description"] for p in [*schema["properties"].values(), *items.values()])


def test_the_ping_rate_is_that_of_the_last_seconds():
    status, now_s = Status(), time.monotonic()
    assert status.ping_rate_hz() == 0.0
    status.heard_s.extend(now_s - 60.0 + 0.01 * n for n in range(20))  # long ago, and faster
    status.heard_s.extend(now_s - 2.0 + 0.25 * n for n in range(9))
    assert status.ping_rate_hz() == 4.0


def test_percentiles_are_those_of_the_last_latencies():
    status = Status()
    assert status.to_json()["latency_median_ms"] is None
    status.latencies_ms.extend(float(n) for n in range(1, 357))
    values = status.to_json()
    assert (values["latency_median_ms"], values["latency_p99_ms"]) == (228.5, 354.0)
