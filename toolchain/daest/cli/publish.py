"""Events to an MQTT broker, by paho-mqtt where it is installed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from daest.cli.output import note
from daest.errors import ConfigError

PATIENCE = 5.0  # seconds for the connection, and for the last messages at the end
PORT = 1883
LAST = 100  # messages that are asked at the end whether they have arrived


@contextmanager
def publisher(address: str | None) -> Iterator[Callable[[str], None]]:
    """A function that publishes a text, at least once, under the topic of `mqtt://[USER:PASSWORD@]HOST[:PORT]/TOPIC`;
    without an address it does nothing.

    Raises ConfigError `mqtt-address`, `needs-package`, `mqtt-unreachable`.
    """
    if address is None:
        yield lambda text: None
        return
    parts = urlsplit(address if "//" in address else f"mqtt://{address}")
    topic = parts.path.strip("/")
    try:
        host, port = parts.hostname, parts.port or PORT
    except ValueError:
        host, port = None, PORT
    if parts.scheme != "mqtt" or not host or not topic:
        raise ConfigError(
            "mqtt-address",
            f"'{address}' is no address of a broker with a topic",
            remedy="for example --mqtt mqtt://localhost:1883/machines/servo3",
        )
    from daest.model.shown import package

    client_module = package("paho.mqtt.client", "mqtt")
    client = client_module.Client(client_module.CallbackAPIVersion.VERSION2)
    if parts.username:
        client.username_pw_set(parts.username, parts.password)
    client.connect_timeout = PATIENCE
    try:
        client.connect(host, port)
    except OSError as problem:
        raise ConfigError(
            "mqtt-unreachable",
            f"no broker answers at {host}:{port}: {problem.strerror or problem}",
            remedy="check the address, or leave --mqtt out",
        ) from problem
    client.loop_start()
    sent: deque[Any] = deque(maxlen=LAST)

    def publish(text: str) -> None:
        sent.append(client.publish(topic, text, qos=1))

    try:
        yield publish
    finally:
        for message in sent:
            try:
                message.wait_for_publish(PATIENCE)
            except (RuntimeError, ValueError):
                break
        late = sum(not message.is_published() for message in sent)
        if late:
            note(f"{late} of {len(sent)} messages were not taken by the broker")
        client.disconnect()
        client.loop_stop()
