"""``ertis run``: the daemon."""

from __future__ import annotations

import argparse
import logging
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ertis_daemon.cli.signals import stop_on_signals

if TYPE_CHECKING:
    from ertis_daemon.config import Config
    from ertis_daemon.pipeline import Pipeline
    from ertis_driver.device import Settings, Sonar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags; everything else is in the configuration."""
    parser.add_argument("--config", type=Path, metavar="FILE", help="YAML; see check-config")
    parser.add_argument("--address", metavar="A", help="sonar, instead of the configured one")
    parser.add_argument("--device", metavar="NAME", help="name in the Zenoh keys, likewise")
    parser.add_argument("--max-pings", type=int, metavar="N", help="end after N pings heard")
    parser.add_argument("--json", action="store_true", help="print the final counters as JSON")
    parser.add_argument("-v", "--verbose", action="store_true", help="log every event")


def run(args: argparse.Namespace) -> int:
    """Serve until stopped by a signal, the end of a recording or ``--max-pings``."""
    level = logging.DEBUG if args.verbose else logging.INFO
    logging.basicConfig(
        level=level, stream=sys.stderr, format="%(levelname).1s %(name)s: %(message)s"
    )
    from ertis_daemon.events import dump_json
    from ertis_daemon.memory import keep_freed_memory
    from ertis_daemon.odometry import POSES_WAITING, Odometry
    from ertis_daemon.pipeline import build_pipeline
    from ertis_daemon.publisher import ZenohPublisher
    from ertis_daemon.service import Service
    from ertis_driver.open import open_device

    keep_freed_memory()
    config = _config(args)
    with ExitStack() as stack:
        sonar = stack.enter_context(open_device(config.device.address, reconnect=True))
        sonar.configure(config.settings())
        settings = sonar.settings or config.settings()  # a recording keeps its own
        odometry = Odometry(config.odometry) if config.odometry.key else None
        pipeline = build_pipeline(config, settings, odometry)
        publisher = stack.enter_context(
            ZenohPublisher(
                config.device.name,
                config.zenoh,
                info=_info(config, settings, sonar, pipeline),
                effective_config=config.to_json(),
            )
        )
        if odometry is not None:
            odometry.listen(publisher.subscribe(config.odometry.key, POSES_WAITING))
        flag = stack.enter_context(stop_on_signals())
        status = Service(sonar, pipeline, publisher, config, flag.event).run()
    counters = status.to_json()
    if args.json:
        print(dump_json(counters).decode())
    else:
        print(
            f"ertis: heard {status.pings_heard} pings, {status.events} events, "
            f"{status.queue_drops} dropped, {status.pings_lost} lost",
            file=sys.stderr,
        )
    return 130 if flag.interrupted else 0


def _config(args: argparse.Namespace) -> Config:
    """Return the configuration with the flags in it, checked as if they stood in the file."""
    import dataclasses

    from ertis_daemon.config import Config, example_yaml, load_config, parse_config

    config = load_config(args.config) if args.config else Config()
    device = config.device
    if args.address is not None:
        device = dataclasses.replace(device, address=args.address)
    if args.device is not None:
        device = dataclasses.replace(device, name=args.device)
    config = dataclasses.replace(config, device=device)
    if args.max_pings is not None:
        config = dataclasses.replace(config, max_pings=args.max_pings)
    return parse_config(example_yaml(config).encode(), "command line")


def _info(config: Config, settings: Settings, sonar: Sonar, pipeline: Pipeline) -> dict[str, Any]:
    from ertis_daemon.about import version

    return {
        "version": version(),
        "device": config.device.name,
        "address": sonar.info.address,
        "firmware": sonar.info.firmware,
        "source": sonar.info.source,
        "chirp": settings.chirp.name,
        "model": pipeline.model_name,
        "classes": list(pipeline.classes),
    }
