"""`daest watch`: events of the contract, exit codes, reference, broker."""

import io
import json
import shutil
import socket
import subprocess
import time

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from test_follow import NOISY

from daest.cli.schema import schema_of
from daest.errors import EstimationError
from daest.estimation.streaming import change

STEP = 0.05


def simulated(n, changes_at, seed=0, offset=0.3):
    """Rows of the noisy lag; from `changes_at` on a constant offset drives the state."""
    rng = np.random.default_rng(seed)
    keep, x, rows = np.exp(-STEP / 0.5), 0.0, []
    variance = 0.01 / 0.25 * (1 - keep**2) * 0.25
    u = np.repeat(rng.normal(size=n // 8 + 1), 8)[:n]
    for k in range(n):
        rows.append(f"{STEP * k:.6g},{u[k]:.12g},{x + 0.02 * rng.standard_normal():.12g}\n")
        push = 2.0 * u[k] + (offset if k >= changes_at else 0.0)
        x = keep * x + (1 - keep) * push + np.sqrt(variance) * rng.standard_normal()
    return "time,u,y\n" + "".join(rows)


@pytest.fixture
def watch(folder, daest, monkeypatch):
    """Run `daest watch` on a text as stdin; the calibration is short."""
    monkeypatch.setattr(change, "LEVELS", (4.0, 5.5))
    monkeypatch.setattr(change, "STREAMS", 200)
    monkeypatch.setattr(change, "SAMPLES", 1000)
    (folder / "Noisy.mo").write_text(NOISY)
    validator = Draft202012Validator(schema_of("watch"))

    def call(text, *arguments):
        monkeypatch.setattr("sys.stdin", io.StringIO(text))
        code, out, err = daest("watch", "--model", "Noisy.mo", "--hold", "zoh", *arguments)
        events = []
        if "text" not in arguments:
            events = [json.loads(line) for line in out.splitlines()]
            for event in events:
                validator.validate(event)
        return code, events, out + err

    return call


def test_events_of_a_change(watch):
    code, events, text = watch(simulated(1200, 800), "--fail-on-alarm", "--average-run", "20000")
    assert code == 1, text
    assert [event["event"] for event in events] == ["started", "alarm", "ended"]
    alarm = events[1]
    assert alarm["output"] == "y" and alarm["statistic"] > alarm["threshold"] == events[0]["threshold"]
    assert 40 < alarm["time"] < 50 and abs(alarm["since"] - 40) < 5
    assert events[0]["average_run"] == 20000 and events[2]["n_samples"] == 1200


def test_no_change_no_alarm(watch):
    code, events, _ = watch(simulated(900, 10_000, seed=5), "--fail-on-alarm")
    assert code == 0 and [event["event"] for event in events] == ["started", "ended"]
    code, _, out = watch(simulated(300, 100, offset=1.0), "--format", "text")
    assert code == 0 and "ALARM: the model no longer holds in y since" in out


@pytest.mark.slow
def test_reference_tells_what_is_usual(watch, folder):
    """A model with a wrong offset: always an alarm against white innovations, none against the reference."""
    (folder / "usual.csv").write_text(simulated(1500, 0, seed=1))
    stream = simulated(900, 0, seed=2)
    assert any(event["event"] == "alarm" for event in watch(stream)[1])
    code, events, _ = watch(stream, "--reference", "usual.csv", "--fail-on-alarm")
    assert code == 0 and events[-1]["n_alarms"] == 0


def test_a_diagnosis_that_cannot_be_made_is_told(watch, monkeypatch):
    def refused(*_):
        raise EstimationError("diagnose-unseen", "nothing moves")

    monkeypatch.setattr("daest.diagnosis.changed.diagnose_change", refused)
    code, events, text = watch(simulated(1200, 500), "--diagnose", "--window", "200")
    assert code == 0, text
    found = next(event for event in events if event["event"] == "diagnosis")
    assert (
        found["verdict"] == "cannot tell" and found["effect"] is None and found["message"] == "nothing moves"
    )


@pytest.mark.parametrize(("n_after", "is_enough"), [(60, False), (160, True)])
def test_as_many_samples_as_a_diagnosis_needs_are_enough(watch, monkeypatch, n_after, is_enough):
    """Two hundred had been asked for, where `diagnose` takes a hundred."""

    def refused(*_):
        raise EstimationError("diagnose-unseen", "nothing moves")

    monkeypatch.setattr("daest.diagnosis.changed.diagnose_change", refused)
    _, events, _ = watch(simulated(500 + n_after, 500), "--diagnose")
    message = next(event["message"] for event in events if event["event"] == "diagnosis")
    assert message == "nothing moves" if is_enough else "too few to diagnose it (at least 100)" in message


@pytest.mark.parametrize("address", ["", "localhost", "mqtt://localhost:x/a", "http://localhost/a"])
def test_bad_addresses(watch, address):
    code, _, text = watch(simulated(10, 10), "--mqtt", address)
    assert code == 2 and "error[mqtt-address]" in text


def test_no_broker(watch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound and not listening: nothing answers here
        code, _, text = watch(simulated(10, 10), "--mqtt", f"mqtt://127.0.0.1:{taken.getsockname()[1]}/a")
    assert code == 2 and "error[mqtt-unreachable]" in text


BROKER = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")


@pytest.mark.skipif(BROKER is None, reason="mosquitto is not installed")
def test_events_reach_a_broker(watch, tmp_path):
    client_module = pytest.importorskip("paho.mqtt.client")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (tmp_path / "broker.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    with subprocess.Popen([BROKER, "-c", str(tmp_path / "broker.conf")], stderr=subprocess.DEVNULL) as broker:
        try:
            received = []
            client = client_module.Client(client_module.CallbackAPIVersion.VERSION2)
            client.on_message = lambda *message: received.append(json.loads(message[-1].payload))
            client.on_connect = lambda client, *rest: client.subscribe("machines/lag", qos=1)
            for _ in range(100):
                try:
                    client.connect("127.0.0.1", port)
                    break
                except OSError:
                    time.sleep(0.05)
            client.loop_start()
            time.sleep(0.3)
            _, events, _ = watch(
                simulated(600, 300, offset=1.0), "--mqtt", f"mqtt://127.0.0.1:{port}/machines/lag"
            )
            for _ in range(60):
                if len(received) == len(events):
                    break
                time.sleep(0.05)
            client.loop_stop()
            assert received == events and len(events) >= 3
        finally:
            broker.terminate()
