"""A ping's tracks as the event that tells of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast, get_args

from ertis_daemon.config import SonarConfig
from ertis_daemon.events import SCHEMA, Covariance, LandmarkEvent, LandmarkReport, TrackState
from ertis_daemon.pipeline import TrackLike
from ertis_driver.frame import PdmFrame, Source


def event_of(
    frame: PdmFrame,
    tracks: Sequence[TrackLike],
    config: SonarConfig,
    *,
    source: Source,
    model: str,
) -> LandmarkEvent:
    """The event of one ping.

    Raises
    ------
    ValueError
        If a track is in no known state.
    """
    return LandmarkEvent(
        schema=SCHEMA,
        device=config.device.name,
        ping_index=frame.ping_index,
        ping_time_ns=frame.ping_time_ns,
        time_uncertainty_ns=frame.time_uncertainty_ns,
        frame_id=config.device.frame_id,
        source=source,
        model=model,
        landmarks=tuple(report(track) for track in tracks),
        speed_of_sound_m_s=config.air.speed_of_sound_m_s,
        temperature_c=config.temperature_c,
    )


def report(track: TrackLike) -> LandmarkReport:
    """A track as events report it.

    Raises
    ------
    ValueError
        If it is in no known state.
    """
    if track.state not in get_args(TrackState):
        raise ValueError(f"track state {track.state!r}, expected new, update or lost")
    heard = track.detection
    return LandmarkReport(
        track_id=track.track_id,
        state=cast("TrackState", track.state),
        label=heard.label,
        probabilities=dict(heard.probabilities),
        range_m=heard.range_m,
        azimuth_rad=heard.azimuth_rad,
        elevation_rad=heard.elevation_rad,
        covariance=cast("Covariance", heard.covariance),
        snr_db=heard.snr_db,
        radius_m=heard.radius_m,
        tilt_rad=heard.tilt_rad,
    )
