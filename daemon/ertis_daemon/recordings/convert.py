"""Recordings to other formats and back: raw PDM words, WAV, tables of events."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.chirp import Emission
from ertis_driver.closing import Closing
from ertis_driver.errors import RecordingError
from ertis_driver.frame import DECIMATION, DEFAULT_NUM_WORDS, NUM_MICS
from ertis_driver.recording import RecordedPing, Recording, RecordingWriter, open_recording
from ertis_driver.wav import WavWriter

FORMATS = (".mcap", ".bin", ".wav", ".csv")
_SAID = {"live": "recorded live", "sim": "simulated", "replay": "a replayed recording"}


@dataclasses.dataclass(frozen=True, slots=True)
class Choice:
    """Which pings, and what the output is told.

    start, stop : int
        Pings by place, from 0; ``stop`` None for all.
    chirp : Emission or None
        Of a file that does not say.
    compress
        Frames of an MCAP output.
    """

    start: int = 0
    stop: int | None = None
    chirp: Emission | None = None
    compress: bool = False


def convert(inputs: Sequence[Path], output: Path, choice: Choice) -> int:
    """Write the pings of recordings, one after another, in the format of the output's suffix.

    Returns
    -------
    int
        Pings written.

    Raises
    ------
    RecordingError
        If a file cannot be read or written, or the recordings do not fit together. The output is
        then removed.
    """
    if output.suffix not in FORMATS[:3]:
        raise RecordingError(f"{output}: unknown suffix, expected {', '.join(FORMATS)}")
    recordings = [open_recording(path) for path in inputs]
    _check_alike(recordings)
    if output.exists():
        raise RecordingError(f"{output} exists: name another file, or remove it")
    writers: dict[str, type[_Output]] = {".mcap": _Mcap, ".bin": _Raw, ".wav": _Wav}
    part = output.with_name(output.name + ".part")
    part.unlink(missing_ok=True)
    count = 0
    try:
        with writers[output.suffix](part, recordings[0], choice) as writer:
            for ping in _pings(recordings, choice):
                writer.write(ping)
                count += 1
        if not count:
            raise RecordingError(f"no ping from {choice.start} to {choice.stop} in {inputs[0]}")
        part.replace(output)
    except OSError as error:
        raise RecordingError(f"cannot write {output}: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)
    return count


def _check_alike(recordings: Sequence[Recording]) -> None:
    first = recordings[0].info
    for other in recordings[1:]:
        for name in ("num_words", "pdm_rate_hz", "source", "chirp"):
            met, expected = getattr(other.info, name), getattr(first, name)
            if met != expected:
                raise RecordingError(
                    f"{other.path}: {name} {met}, expected {expected} as in {recordings[0].path}: "
                    "convert them one by one"
                )


def _pings(recordings: Sequence[Recording], choice: Choice) -> Iterator[RecordedPing]:
    """All of them, numbered on if there are several files without numbers of their own."""
    every = (ping for recording in recordings for ping in recording)
    for place, ping in islice(enumerate(every), choice.start, choice.stop):
        if len(recordings) > 1 and recordings[0].info.chirp is None:
            # Headerless files each begin with 0 at the epoch.
            period_ns = 100_000_000
            frame = dataclasses.replace(
                ping.frame, ping_index=place, ping_time_ns=place * period_ns
            )
            yield dataclasses.replace(ping, frame=frame)
        else:
            yield ping


class _Output(Closing):
    def __init__(self, path: Path, like: Recording, choice: Choice) -> None:
        raise NotImplementedError

    def write(self, ping: RecordedPing) -> None:
        raise NotImplementedError


class _Mcap(_Output):
    def __init__(self, path: Path, like: Recording, choice: Choice) -> None:
        info = like.info
        if info.chirp is None and choice.chirp is not None:
            info = dataclasses.replace(info, chirp=choice.chirp)
        self._writer = RecordingWriter(path, info, compress=choice.compress)

    def write(self, ping: RecordedPing) -> None:
        self._writer.write(
            ping.frame,
            ping.truth,
            temperature_c=ping.temperature_c,
            humidity_percent=ping.humidity_percent,
        )

    def close(self) -> None:
        self._writer.close()


class _Raw(_Output):
    """Headerless words, as the incumbent's client writes and reads them."""

    def __init__(self, path: Path, like: Recording, choice: Choice) -> None:
        self._path, self._one = path, like.info.num_words != DEFAULT_NUM_WORDS
        self._count = 0
        self._file = path.open("xb")

    def write(self, ping: RecordedPing) -> None:
        if self._one and self._count:
            raise RecordingError(
                f"several pings of {ping.frame.words.size} words: a headerless file does not say "
                f"how long each is, expected {DEFAULT_NUM_WORDS}; choose one with --pings"
            )
        self._file.write(ping.frame.words.astype("<u4").tobytes())
        self._count += 1

    def close(self) -> None:
        self._file.close()


class _Wav(_Output):
    """Audio of each ping after the other's, at a tenth of the PDM clock."""

    def __init__(self, path: Path, like: Recording, choice: Choice) -> None:
        info = like.info
        chirp = info.chirp or choice.chirp
        self._decoder = PdmDecoder()
        self._writer = WavWriter(
            path,
            NUM_MICS,
            info.pdm_rate_hz // DECIMATION,
            comment=f"eRTIS sonar, {_SAID[info.source]}, chirp {chirp.name if chirp else 'unknown'}"
            f", {info.num_words // DECIMATION} samples a ping, channel = microphone row",
        )

    def write(self, ping: RecordedPing) -> None:
        self._writer.write(self._decoder.decode(whole_samples(ping.frame.words)).audio)

    def close(self) -> None:
        self._writer.close()
