"""The secured mode as docs/security.md describes it: our router file, our certificates, our daemon.

The router is a Zenoh session in router mode, which reads the same file as ``zenohd``.
"""

import contextlib
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import zenoh
from patience import wait_for
from ros2_rig import free_port, landmark_event
from zenoh import ext

from ertis_daemon.config import ZenohConfig
from ertis_daemon.publisher import ZenohPublisher
from ertis_daemon.tls import TlsError, tls_values
from ertis_daemon.zenoh_session import Network, PublisherError

SECURITY = Path(__file__).parents[2] / "daemon" / "security"
MAKER = SECURITY / "make-certificates.sh"
DEADLINE_S = 10.0
REFUSAL_S = 3.0
DECLARED_S = 0.5  # a declaration travels

needs_openssl = pytest.mark.skipif(
    shutil.which("openssl") is None, reason="no openssl: apt install openssl"
)


def make_certificates(folder, *names):
    subprocess.run(["sh", str(MAKER), str(folder), *names], check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    everybody = ("router", "daemon", "reader", "commander", "stranger")
    return make_certificates(tmp_path_factory.mktemp("tls"), *everybody)


@pytest.fixture(scope="module")
def forged(tmp_path_factory):
    """The same names, by an authority of somebody else's."""
    return make_certificates(tmp_path_factory.mktemp("forged"), "router", "daemon")


@pytest.fixture(scope="module")
def router(certificates):
    """Port of a router with our configuration; only places differ."""
    port = free_port()
    config = zenoh.Config.from_file(str(SECURITY / "router.json5"))
    own = certificates / "router"
    for key, value in {
        "listen/endpoints": [f"tls/127.0.0.1:{port}"],
        "transport/link/tls/root_ca_certificate": str(own / "ca.pem"),
        "transport/link/tls/listen_certificate": str(own / "cert.pem"),
        "transport/link/tls/listen_private_key": str(own / "key.pem"),
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield port


def open_client(locator, values=None):
    config = zenoh.Config()
    for key, value in {
        "mode": "client",
        "connect/endpoints": [locator],
        "connect/timeout_ms": int(1000 * REFUSAL_S),
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,
        **({"transport/link/tls": values} if values else {}),
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def identity(folder):
    return tls_values(str(folder), "client", [])


@pytest.fixture
def client(router, certificates):
    """Opens sessions with a certificate of ours."""
    with contextlib.ExitStack() as stack:

        def open_as(name):
            locator = f"tls/localhost:{router}"
            return stack.enter_context(open_client(locator, identity(certificates / name)))

        yield open_as


@pytest.fixture
def daemon(router, certificates):
    """Our own publisher, with a certificate; what the session was told beside."""
    config = ZenohConfig(
        mode="client", connect=(f"tls/localhost:{router}",), tls=str(certificates / "daemon")
    )
    with (
        Network(config) as network,
        ZenohPublisher(network.session, "t", info={"a": 1}, effective_config={}) as publisher,
    ):
        heard = network.session.declare_subscriber("ertis/**", zenoh.handlers.FifoChannel(100))
        command = network.session.declare_queryable(
            "ertis/t/cmd/ping", zenoh.handlers.FifoChannel(10)
        )
        yield publisher, heard, command


def listen(session):
    """As ``ertis monitor`` does."""
    return ext.declare_advanced_subscriber(
        session,
        "ertis/*/landmarks",
        zenoh.handlers.FifoChannel(100),
        history=ext.HistoryConfig(detect_late_publishers=True),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )


def drain(handler):
    got = []
    while (one := handler.try_recv()) is not None:
        got.append(one)
    return got


def ask(session, key, seconds=1.0):
    return [reply.ok for reply in session.get(key, timeout=seconds) if reply.ok]


def everything_it_hears(session, publisher):
    """All ways to learn something, tried while events are published."""
    subscribers = [listen(session), session.declare_subscriber("**", zenoh.handlers.FifoChannel(9))]
    time.sleep(DECLARED_S)
    publisher.publish(landmark_event())
    publisher.publish_status({"pings_heard": 1})
    time.sleep(DECLARED_S)
    heard = [sample for subscriber in subscribers for sample in drain(subscriber)]
    heard += ask(session, "ertis/**")
    heard += [r.ok for r in session.liveliness().get("**", timeout=1.0) if r.ok]
    return heard


def shout(session):
    """All ways to say something: events, commands, that one is a sonar."""
    session.put("ertis/t/landmarks", "forged")
    session.put("ertis/t/cmd/ping", "forged")
    session.delete("ertis/t/status")
    session.declare_queryable("ertis/t/last", zenoh.handlers.FifoChannel(1))
    token = session.liveliness().declare_token("ertis/forged/alive")
    time.sleep(DECLARED_S)
    return token


@needs_openssl
def test_a_reader_gets_events_their_history_and_answers(daemon, client):
    publisher, _, _ = daemon
    for _ in range(3):
        publisher.publish(landmark_event())
    reader = client("reader")
    subscriber = listen(reader)
    got = []
    wait_for(lambda: got.extend(drain(subscriber)) or len(got) == 3)
    publisher.publish(landmark_event())
    wait_for(lambda: got.extend(drain(subscriber)) or len(got) == 4)
    for name in ("last", "schema", "info", "config"):
        assert ask(reader, f"ertis/t/{name}"), name
    alive = [r.ok for r in reader.liveliness().get("ertis/*/alive", timeout=1.0) if r.ok]
    assert len(alive) == 1


@needs_openssl
def test_the_monitor_reads_with_a_readers_certificate(daemon, router, certificates):
    publisher, _, _ = daemon
    publisher.publish(landmark_event())
    network = ["--mode", "client", "--connect", f"tls/localhost:{router}"]
    tls = ["--tls", str(certificates / "reader")]
    command = [sys.executable, "-m", "ertis_daemon.cli", "monitor", "--json", "--count", "1"]
    done = subprocess.run(
        [*command, *network, *tls], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["device"] == "t"


@needs_openssl
def test_a_reader_says_nothing_and_commands_nothing(daemon, client):
    _, heard, command = daemon
    reader = client("reader")
    token = shout(reader)
    assert ask(reader, "ertis/t/cmd/ping") == []
    assert drain(heard) == []
    assert drain(command) == []
    another = client("reader")  # a session knows its own tokens, allowed or not
    found = another.liveliness().get("ertis/*/alive", timeout=1.0)
    assert [str(reply.ok.key_expr) for reply in found if reply.ok] == ["ertis/t/alive"]
    token.undeclare()


@needs_openssl
def test_a_commander_commands_and_hears_nothing_else(daemon, client):
    publisher, heard, command = daemon
    commander = client("commander")
    replies = commander.get("ertis/t/cmd/ping", zenoh.handlers.FifoChannel(1), timeout=5.0)
    with wait_for(command.try_recv) as query:
        query.reply("ertis/t/cmd/ping", b"done")
    assert wait_for(replies.try_recv).ok.payload.to_bytes() == b"done"
    drain(heard)
    shout(commander)
    assert drain(heard) == []
    assert everything_it_hears(commander, publisher) == []


@needs_openssl
def test_a_certificate_without_a_policy_sees_nothing_and_says_nothing(daemon, client):
    publisher, heard, command = daemon
    stranger = client("stranger")
    shout(stranger)
    assert ask(stranger, "ertis/t/cmd/ping") == []
    assert drain(heard) == []
    assert drain(command) == []
    assert everything_it_hears(stranger, publisher) == []


@needs_openssl
@pytest.mark.parametrize("who", ["forged", "nobody", "plain", "wrong router"])
def test_others_do_not_get_in(router, certificates, forged, who):
    own, theirs = certificates / "daemon", forged / "daemon"
    locator = f"tls/localhost:{router}"
    trusting = {**identity(theirs), "root_ca_certificate": str(own / "ca.pem")}
    ways = {
        "forged": (locator, trusting),  # the right name, signed by another authority
        "nobody": (locator, {"root_ca_certificate": str(own / "ca.pem")}),  # no certificate
        "plain": (f"tcp/localhost:{router}", None),
        "wrong router": (locator, identity(theirs)),  # the client is as choosy
    }
    with pytest.raises(zenoh.ZError), open_client(*ways[who]) as session:
        session.info.routers_zid()


@needs_openssl
def test_no_certificate_but_the_routers_makes_a_router(certificates):
    port = free_port()
    own = certificates / "reader"
    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "listen/endpoints": [f"tls/127.0.0.1:{port}"],
        "scouting/multicast/enabled": False,
        "transport/link/tls": {
            "root_ca_certificate": str(own / "ca.pem"),
            "listen_certificate": str(own / "cert.pem"),
            "listen_private_key": str(own / "key.pem"),
        },
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config), pytest.raises(zenoh.ZError):
        open_client(f"tls/localhost:{port}", identity(certificates / "daemon"))


LISTENING = """
import os, pathlib, socket
from ertis_daemon.config import Config
from ertis_daemon.zenoh_session import Network
def address(text):
    words = bytes.fromhex(text)
    data = b"".join(words[i:i + 4][::-1] for i in range(0, len(words), 4))
    return socket.inet_ntop(socket.AF_INET if len(data) == 4 else socket.AF_INET6, data)
with Network(Config().zenoh):
    links = (os.readlink(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd")
             if os.path.islink(f"/proc/self/fd/{fd}"))
    mine = {link[8:-1] for link in links if link.startswith("socket:")}
    for family in ("tcp", "tcp6", "udp", "udp6"):
        for line in pathlib.Path(f"/proc/self/net/{family}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in mine and (fields[3] == "0A" or family.startswith("udp")):
                print(address(fields[1].partition(":")[0]))
"""


def test_without_certificates_the_default_listens_on_this_machine_only():
    done = subprocess.run(
        [sys.executable, "-c", LISTENING], capture_output=True, text=True, timeout=60, check=True
    )
    found = set(done.stdout.split())
    assert found
    assert found <= {"127.0.0.1", "::1"}


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (ZenohConfig(tls="/none"), "zenoh.mode is peer: peers talk to each other past"),
        (ZenohConfig(mode="client", tls="/none"), "tcp/localhost:7447 is not encrypted"),
        (
            ZenohConfig(mode="client", connect=("tls/localhost:1",), tls="/none"),
            "/none/ca.pem: No such file",
        ),
    ],
)
def test_a_certificate_that_would_not_protect_is_refused_in_one_line(config, words):
    with pytest.raises(TlsError, match=words):
        Network(config)


def test_a_file_that_is_no_certificate_is_refused_in_one_line(tmp_path):
    for name in ("ca.pem", "cert.pem", "key.pem"):
        (tmp_path / name).write_text("no certificate")
    config = ZenohConfig(mode="client", connect=("tls/localhost:1",), tls=str(tmp_path))
    with pytest.raises(PublisherError) as caught:
        Network(config)
    assert "\n" not in str(caught.value)


@needs_openssl
def test_private_keys_are_for_their_owner_and_wrong_names_make_no_folder(tmp_path):
    folder = make_certificates(tmp_path / "tls", "daemon")
    for key in (folder / "ca-key.pem", folder / "daemon" / "key.pem"):
        assert key.stat().st_mode & 0o077 == 0
    before = (folder / "ca.pem").read_bytes()
    make_certificates(folder, "reader")
    assert (folder / "ca.pem").read_bytes() == before, "names are added to the same authority"
    for names in ([], ["../evil"]):
        command = ["sh", str(MAKER), *([str(folder)] if names else []), *names]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2
    assert not (tmp_path / "evil").exists()
