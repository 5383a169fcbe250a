"""The daemon: a network session, some sonars, and what the host and its users ask of them."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError  # the builtin one from 3.11 on
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from ertis_daemon.config import Config, SonarConfig
from ertis_daemon.layers import Sources
from ertis_daemon.memory import keep_what_is_loaded
from ertis_daemon.publisher import ZenohPublisher
from ertis_daemon.serving.about import waiting_info
from ertis_daemon.serving.commands import Commands
from ertis_daemon.serving.life import SonarLife
from ertis_daemon.serving.notify import Notifier
from ertis_daemon.serving.outputs import Output
from ertis_daemon.serving.reload import WHOLE, ReloadError, check_folders, check_models, compare
from ertis_daemon.status import Status
from ertis_daemon.turns import Turns
from ertis_daemon.zenoh_session import Network, any_port, session_config
from ertis_driver.errors import ErtisError

if TYPE_CHECKING:
    from ertis_daemon.ros2.node import RosNode

log = logging.getLogger(__name__)

POLL_S = 0.05
LOOK_S = 1.0  # at routers
JOIN_S = 2.5  # all sonars together; with leaving the network, still under 5 s
RELOAD_S = 20.0  # patience of who asked for it


class Daemon:
    """Serves the sonars of a configuration until it is stopped or all of them are over.

    Parameters
    ----------
    config
        Checked.
    stop
        Set it to end ``run``.
    sources
        Where ``reload`` reads the configuration again; None: it cannot.
    """

    def __init__(
        self, config: Config, stop: threading.Event, sources: Sources | None = None
    ) -> None:
        self._reload_wanted = False
        self._config = config
        self._stop = stop
        self._sources = sources
        self._notifier = Notifier()
        self._lives: dict[str, SonarLife] = {}
        self._turns: dict[str, Turns] = {}
        self._asked: list[Future[Sequence[str]]] = []
        self._asked_lock = threading.Lock()
        self._network: Network | None = None
        self._ros2: RosNode | None = None
        self._seen: dict[str, int] = {"routers": 0, "peers": 0}
        self._look_s = 0.0

    def run(self) -> dict[str, Status]:
        """Serve.

        Returns
        -------
        dict of str to Status
            The final counters of each sonar.

        Raises
        ------
        PublisherError
            If the network cannot be reached as configured.
        ErtisError, DetectorError
            What ended the last sonar, if that was an error.
        """
        with ExitStack() as stack:
            self._network = stack.enter_context(Network(self._config.zenoh))
            self._ros2 = self._open_ros2(stack)
            stack.callback(self._end_all)
            self._serve_metrics(stack)
            for sonar in self._config.each_sonar():
                self._begin(sonar)
            self._watch()
            self._notifier.stopping()
        for life in self._lives.values():
            if life.error is not None and not self._stop.is_set():
                raise life.error
        return self.statuses()

    def statuses(self) -> dict[str, Status]:
        """The counters of each sonar, by name."""
        return {name: life.status for name, life in tuple(self._lives.items())}

    def hang_up(self) -> None:
        """Reload soon; safe in a signal handler, as no lock is."""
        self._reload_wanted = True

    def reload(self) -> Sequence[str]:
        """Read the configuration again, and say what came of it; for any thread but the main one.

        Raises
        ------
        ErtisError
            If it is not taken; all goes on as before.
        """
        asked: Future[Sequence[str]] = Future()
        with self._asked_lock:
            self._asked.append(asked)
        try:
            return asked.result(RELOAD_S)
        except FutureTimeoutError as error:
            raise ReloadError(f"not done within {RELOAD_S:g} s: look at the log") from error

    def _watch(self) -> None:
        is_ready = False
        # Not stop.wait: a signal handler that sets it while this thread holds its lock would wait
        # for ever.
        while not self._stop.is_set():
            time.sleep(POLL_S)
            lives = self._lives.values()
            self._reload_if_wanted()
            self._look_around()
            if lives and all(life.is_over for life in lives):
                return
            if not is_ready and all(life.is_settled for life in lives):
                is_ready = True
                self._notifier.ready()
                keep_what_is_loaded()
            self._notifier.status(
                "; ".join(_told(name, life) for name, life in self._lives.items())
            )

    def _begin(self, sonar: SonarConfig) -> None:
        assert self._network is not None
        name = sonar.device.name
        self._lives[name] = life = SonarLife(
            sonar,
            self._outputs(sonar),
            turns=self._turns_of(sonar),
            can_command=self._config.zenoh.commands,
            beat=self._notifier.beat,
            around=self._around,
            subscribe=self._network.subscribe,
        )
        life.start()

    def _outputs(self, sonar: SonarConfig) -> list[Output]:
        assert self._network is not None
        zenoh, name = self._config.zenoh, sonar.device.name
        obey = Commands(lambda: self._lives.get(name), self.reload) if zenoh.commands else None
        info, effective = waiting_info(sonar), sonar.to_json()
        session = self._network.session
        outputs: list[Output] = [
            ZenohPublisher(
                session, name, info=info, effective_config=effective, raw=zenoh.raw, obey=obey
            )
        ]
        if self._ros2 is not None:
            from ertis_daemon.ros2.publisher import Ros2Publisher

            outputs.append(Ros2Publisher(self._ros2, name, info))
        return outputs

    def _open_ros2(self, stack: ExitStack) -> RosNode | None:
        if not self._config.ros2.enabled:
            return None
        from ertis_daemon.ros2.extra import require

        require()
        from ertis_daemon.ros2.node import RosNode

        zenoh = self._config.zenoh
        listen = any_port(zenoh.listen)
        described = session_config(zenoh.mode, zenoh.connect, listen, zenoh.tls)
        return stack.enter_context(RosNode(self._config.ros2, described))

    def _turns_of(self, sonar: SonarConfig) -> Turns | None:
        if not sonar.take_turns:
            return None
        return self._turns.setdefault(sonar.take_turns, Turns())

    def _serve_metrics(self, stack: ExitStack) -> None:
        if self._config.prometheus.listen:
            from ertis_daemon.serving.prometheus import serve_metrics

            listen = self._config.prometheus.listen
            stack.enter_context(serve_metrics(listen, self.statuses))

    def _around(self) -> Mapping[str, Any]:
        return self._seen

    def _look_around(self) -> None:
        assert self._network is not None
        if time.monotonic() < self._look_s:
            return
        self._look_s = time.monotonic() + LOOK_S
        seen = {"routers": self._network.routers(), "peers": self._network.peers()}
        if seen["routers"] != self._seen["routers"]:
            log.info("connected to %d routers", seen["routers"])
        self._seen = seen

    def _reload_if_wanted(self) -> None:
        with self._asked_lock:
            asked, self._asked = self._asked, []
        if not asked and not self._reload_wanted:
            return
        self._reload_wanted = False
        try:
            said = self._reload()
        except ErtisError as error:
            for line in str(error).splitlines():
                log.error("not reloaded: %s", line)
            for future in asked:
                future.set_exception(error)
            return
        for line in said:
            log.info("reloaded: %s", line)
        for future in asked:
            future.set_result(said)

    def _reload(self) -> Sequence[str]:
        if self._sources is None:
            raise ReloadError("this daemon was started without a configuration to read again")
        new = self._sources.load()
        changes = compare(self._config, new)
        check_models((*changes.added, *changes.changed))
        check_folders((*changes.added, *changes.changed))
        for name in changes.removed:
            life = self._lives.pop(name)
            life.stop()
            life.join(JOIN_S)
        for sonar in changes.changed:
            self._lives[sonar.device.name].reconfigure(sonar, self._turns_of(sonar))
        for sonar in changes.added:
            self._begin(sonar)
        # What was not taken stays different, and is said again next time.
        self._config = _with_old(new, self._config)
        return changes.said

    def _end_all(self) -> None:
        for life in self._lives.values():
            life.stop()
        until_s = time.monotonic() + JOIN_S
        for name, life in self._lives.items():
            life.join(max(0.0, until_s - time.monotonic()))
            if life.is_alive():
                log.warning("%s: did not end within %g s, left to the end", name, JOIN_S)


def _with_old(new: Config, old: Config) -> Config:
    import dataclasses

    return dataclasses.replace(new, **{name: getattr(old, name) for name in WHOLE})


def _told(name: str, life: SonarLife) -> str:
    status = life.status
    if status.state == "running":
        return f"{name}: running"
    return f"{name}: {status.state}{', ' if status.reason else ''}{status.reason}"
