"""A real mosquitto, certificates for it, and a real subscriber."""

import json
import os
import shutil
import signal
import socket
import subprocess
import threading
import time

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Mosquitto:
    def __init__(self, directory, *lines, port=None, anonymous=True):
        self.port = port or free_port()
        self.config = directory / f"mosquitto-{self.port}.conf"
        user = ["user root"] if os.geteuid() == 0 else []
        text = [f"listener {self.port} 127.0.0.1", f"allow_anonymous {str(anonymous).lower()}", *user, *lines]
        self.config.write_text("\n".join(text) + "\n")
        self.process = None

    def start(self):
        self.process = subprocess.Popen(
            [MOSQUITTO, "-c", str(self.config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        until = time.monotonic() + 10
        while time.monotonic() < until:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
            except OSError:
                time.sleep(0.02)
            else:
                return self
        raise AssertionError("mosquitto does not listen")

    def signal(self, number):
        self.process.send_signal(number)

    def kill(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None

    def __enter__(self):
        return self.start()

    def __exit__(self, *_):
        if self.process is not None:
            self.signal(signal.SIGCONT)
        self.kill()


class Subscriber:
    """Keeps every message; reconnects by itself."""

    def __init__(self, port, topic="t/#", prepare=lambda client: None, host="127.0.0.1"):
        self.messages = []
        self.subscribed = threading.Event()
        self.client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        prepare(self.client)
        self.client.reconnect_delay_set(1, 1)
        self.client.on_connect = lambda client, *_: client.subscribe(topic, qos=1)
        self.client.on_subscribe = lambda *_: self.subscribed.set()
        self.client.on_disconnect = lambda *_: self.subscribed.clear()
        self.client.on_message = lambda _c, _u, message: self.messages.append(message)
        self.client.connect_async(host, port, keepalive=5)
        self.client.loop_start()

    def __enter__(self):
        assert self.subscribed.wait(10)
        return self

    def __exit__(self, *_):
        self.client.disconnect()
        self.client.loop_stop()

    def of(self, part):
        return [m for m in list(self.messages) if f"/{part}" in m.topic]

    def readings(self):
        return [json.loads(m.payload) for m in self.of("measurement")]

    def wait_for(self, condition, seconds=10.0):
        until = time.monotonic() + seconds
        while not condition(self):
            assert time.monotonic() < until, f"nothing of it in {seconds} s; {len(self.messages)} messages"
            time.sleep(0.01)


def make_certificates(directory, *, key_usage=True):
    """A CA, a server certificate for localhost, a client certificate, and another CA's client certificate."""

    def run(*words):
        subprocess.run(["openssl", *words], cwd=directory, check=True, capture_output=True)

    for ca in ("ca", "other"):
        run("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
            *(["-addext", "keyUsage=critical,keyCertSign,cRLSign"] if key_usage else []),
            "-subj", f"/CN={ca}", "-keyout", f"{ca}.key", "-out", f"{ca}.crt")  # fmt: skip
    # Python 3.13 verifies strictly (RFC 5280): a CA without key usage, or a key without its issuer's mark, is refused
    identifiers = "subjectKeyIdentifier=hash\nauthorityKeyIdentifier=keyid\n"
    (directory / "client.ext").write_text(identifiers)
    (directory / "server.ext").write_text(f"{identifiers}subjectAltName=DNS:localhost\n")
    for name, ca in (("server", "ca"), ("client", "ca"), ("stranger", "other")):
        run("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj", f"/CN={name}",
            "-keyout", f"{name}.key", "-out", f"{name}.csr")  # fmt: skip
        extension = ["-extfile", "server.ext" if name == "server" else "client.ext"]
        run("x509", "-req", "-in", f"{name}.csr", "-CA", f"{ca}.crt", "-CAkey", f"{ca}.key", "-CAcreateserial",
            "-days", "2", "-out", f"{name}.crt", *extension)  # fmt: skip
