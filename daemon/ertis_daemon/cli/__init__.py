"""The ``ertis`` command. Each subcommand is a module, imported only when it is asked for."""

from __future__ import annotations

import importlib
import os
import sys

from ertis_daemon.blas import settle_blas

settle_blas()

OK, FAILED, USAGE, WITH_FINDINGS, INTERRUPTED = 0, 1, 2, 3, 130

# name -> (module, one line of help). A module has add_arguments(parser) and run(args) -> int, and
# imports what is heavy inside run.
COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("ertis_daemon.cli.run", "ping, recognise landmarks and publish them over Zenoh"),
    "check-config": ("ertis_daemon.cli.check_config", "check a configuration, or print an example"),
    "monitor": ("ertis_daemon.cli.monitor", "print landmark events as they are published"),
    "devices": ("ertis_daemon.cli.devices", "list the sonars that are plugged in"),
    "emulate": ("ertis_daemon.cli.emulate", "be an eRTIS on a pseudo-terminal"),
    "probe": ("ertis_daemon.cli.probe", "ping one sonar and say how it is"),
    "record": ("ertis_daemon.cli.record", "record a sonar's pings, as sent, into an MCAP file"),
    "info": ("ertis_daemon.cli.info", "say what a recording holds, and whether it is whole"),
    "recover": ("ertis_daemon.cli.recover", "save all that is whole of a damaged recording"),
    "replay": ("ertis_daemon.cli.replay", "play a recording to a pseudo-terminal or to Zenoh"),
    "convert": ("ertis_daemon.cli.convert", "turn recordings into raw words, WAV or CSV, and back"),
    "detect": ("ertis_daemon.cli.detect", "say which landmarks a recording holds, and draw it"),
    "simulate": ("ertis_daemon.cli.simulate", "record a simulated scene, or many random ones"),
    "dataset": ("ertis_daemon.cli.dataset", "record, check, correct and count labelled pings"),
    "export": ("ertis_daemon.cli.export", "landmarks to print, and files for other programs"),
    "validate": ("ertis_daemon.cli.validate", "hold the simulator against physics and a real ping"),
    "train": ("ertis_daemon.cli.train", "make a model from recordings with truth"),
    "calibrate": ("ertis_daemon.cli.calibrate", "make a model's probabilities come true here"),
    "evaluate": ("ertis_daemon.cli.evaluate", "say how good a detector or a method is on data"),
    "doctor": ("ertis_daemon.cli.doctor", "say what works here, what is missing, and what to do"),
    "completion": ("ertis_daemon.cli.completion", "print what makes a shell complete words"),
    "demo": ("ertis_daemon.cli.demo", "see it all work, on a simulated scene"),
}

# What is reported in one line; an error's module is loaded by the time it is raised.
_REPORTED = (
    ("ertis_driver.errors", "ErtisError"),
    ("ertis_detector.errors", "DetectorError"),
)


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit code.

    0 ok, 1 failed, 2 wrong usage, 3 done, with losses or findings, 130 interrupted by Ctrl-C.
    """
    try:
        args = sys.argv[1:] if argv is None else argv
        code = _dispatch(args)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone; Python's own flush at exit must not complain about it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        if not _is_reported(error):
            raise
        for line in str(error).splitlines() or [type(error).__name__]:
            print(f"ertis: {line}", file=sys.stderr)
        return FAILED
    return code


def _dispatch(argv: list[str]) -> int:
    from ertis_daemon.cli.parser import build_parser

    wanted = next((word for word in argv if not word.startswith("-")), None)
    parser = build_parser(COMMANDS, wanted)
    parser.said = argv
    args = parser.parse_args(argv)
    return int(importlib.import_module(COMMANDS[args.command][0]).run(args))


def _is_reported(error: Exception) -> bool:
    for module_name, class_name in _REPORTED:
        kind = getattr(sys.modules.get(module_name), class_name, None)
        if isinstance(kind, type) and isinstance(error, kind):
            return True
    return False
