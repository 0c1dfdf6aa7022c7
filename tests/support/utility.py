"""The utility's side as it is shipped: authority, broker configuration and ACL, run for real."""

import os
import re
import socket
import ssl
import subprocess
import threading
import time
from pathlib import Path

import paho.mqtt.client as mqtt
from brokers import Mosquitto
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

ROOT = Path(__file__).parents[2]
CA = ROOT / "deploy" / "certificates" / "sagnode-ca"
ENROL = ROOT / "deploy" / "certificates" / "sagnode-enrol"


def ran(*words, fails=False, **environment):
    result = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, timeout=60, env={**os.environ, **environment}
    )
    assert (result.returncode != 0) == fails, result.stderr + result.stdout
    return result


def enrol(ca, unit_dir, name, *, by_hand=False, **environment):
    """The whole way of a unit's certificate: request on the unit, signature at the authority, installation.

    ``by_hand`` puts into place what sagnode-enrol would refuse.
    """
    options = ("--tls", unit_dir, "--name", name)
    csr = unit_dir.with_name(unit_dir.name + ".csr")
    csr.write_text(ran(ENROL, *options, "request").stdout)
    crt = ran(CA, ca, "sign", name, csr, **environment).stdout.strip()
    if by_hand:
        (unit_dir / "unit.pem").write_text((unit_dir / "pending.key").read_text() + Path(crt).read_text())
    else:
        ran(ENROL, *options, "install", crt, ca / "ca.crt")
    return unit_dir / "unit.pem"


class UtilityBroker(Mosquitto):
    """deploy/broker beside Debian's own mosquitto.conf; only directories, port and user are those of the test."""

    def __init__(self, directory, ca, *lines):
        super().__init__(directory)
        self.etc = directory / "etc-mosquitto"
        (self.etc / "conf.d").mkdir(parents=True)
        (self.etc / "certs").mkdir()
        for name in ("broker.crt", "broker.key"):
            (self.etc / "certs" / name).write_bytes((ca / "keys" / name).read_bytes())
        (self.etc / "certs" / "ca.crt").write_bytes((ca / "ca.crt").read_bytes())
        self.take_crl(ca)
        (self.etc / "sagnode.acl").write_text((ROOT / "deploy/broker/sagnode.acl").read_text())
        shipped = (ROOT / "deploy/broker/sagnode.conf").read_text()
        here = re.sub(r"^listener 8883$", f"listener {self.port} 127.0.0.1", shipped, flags=re.M)
        here = here.replace("/etc/mosquitto/", f"{self.etc}/")
        (self.etc / "conf.d" / "sagnode.conf").write_text("\n".join([here, *lines]) + "\n")
        self.store = directory / "store"
        self.store.mkdir()
        self.log = directory / "broker.log"
        main = ["persistence true", f"persistence_location {self.store}/", f"log_dest file {self.log}"]
        if os.geteuid() == 0:
            main.append("user root")
        self.config.write_text("\n".join([*main, f"include_dir {self.etc}/conf.d"]) + "\n")

    def take_crl(self, ca):
        (self.etc / "certs" / "crl.pem").write_bytes((ca / "crl.pem").read_bytes())

    def stored(self, payload):
        """Wait until the store on the disk holds these bytes."""
        until = time.monotonic() + 10
        while not (self.store / "mosquitto.db").exists() or payload not in (self.store / "mosquitto.db").read_bytes():
            assert time.monotonic() < until, "not stored"
            time.sleep(0.02)


def refusal(port, ca, pem=None, *, key=None, context=None):
    """How the broker ends a TLS connection before anything of MQTT is said."""
    if context is None:
        context = ssl.create_default_context(cafile=ca / "ca.crt")
    if pem is not None:
        context.load_cert_chain(pem, key or pem)
    with socket.create_connection(("localhost", port), 5) as raw:
        try:
            with context.wrap_socket(raw, server_hostname="localhost") as secured:
                secured.settimeout(1.0)  # one who is let in hears nothing until it has said CONNECT
                said = secured.recv(1)
        except ssl.SSLError as error:
            return str(error).lower()
    raise AssertionError(f"let in: {said!r}")


class Party:
    """A client with a certificate, or without; MQTT 5."""

    def __init__(self, port, ca, pem=None, *, key=None, topic=None, session_s=None, client_id="its own"):
        self.messages = []
        self.answers = {}
        self.connected = threading.Event()
        self.subscribed = threading.Event()
        self.gone = threading.Event()
        self.client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=mqtt.MQTTv5)
        self.client.tls_set(ca_certs=str(ca / "ca.crt"), certfile=pem and str(pem), keyfile=pem and str(key or pem))
        self.client.on_connect = lambda _c, _u, _f, reason, _p: reason.is_failure or self.connected.set()
        self.client.on_subscribe = lambda *_: self.subscribed.set()
        self.client.on_disconnect = lambda *_: self.gone.set()
        self.client.on_publish = lambda _c, _u, mid, reason, _p: self.answers.__setitem__(mid, reason)
        self.client.on_message = lambda _c, _u, message: self.messages.append(message)
        self._port = port
        self._topic = topic
        self._session_s = session_s

    def __enter__(self):
        properties = Properties(PacketTypes.CONNECT)
        if self._session_s:
            properties.SessionExpiryInterval = self._session_s
        self.client.connect("localhost", self._port, clean_start=not self._session_s, properties=properties)
        self.client.loop_start()
        assert self.connected.wait(5), "not let in"
        return self.subscribe(self._topic) if self._topic else self

    def __exit__(self, *_):
        self.client.disconnect()
        self.client.loop_stop()

    def subscribe(self, topic):
        self.subscribed.clear()
        self.client.subscribe(topic, qos=1)
        assert self.subscribed.wait(5)
        return self

    def publish(self, topic, payload=b"x", *, retain=False):
        """The broker's answer: True when it took the message."""
        mid = self.client.publish(topic, payload, qos=1, retain=retain).mid
        until = time.monotonic() + 5
        while mid not in self.answers:
            assert time.monotonic() < until, "no answer"
            time.sleep(0.005)
        return not self.answers[mid].is_failure

    def topics(self):
        return [message.topic for message in self.messages]

    def wait_for(self, condition, seconds=5.0):
        until = time.monotonic() + seconds
        while not condition(self):
            assert time.monotonic() < until, self.topics()
            time.sleep(0.01)
