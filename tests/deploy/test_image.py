"""deploy/image and deploy/cloud-init, as far as they can be checked without Raspberry Pi's archive and without a Pi."""

import os
import shutil
import subprocess

import pytest
import yaml
from utility import ROOT, ran

IMAGE = ROOT / "deploy" / "image"
USER_DATA = ROOT / "deploy" / "cloud-init" / "user-data"


@pytest.fixture
def hooked(tmp_path):
    """An empty root on which the layer's hooks have run."""
    layer = yaml.safe_load((IMAGE / "layer" / "sagnode.yaml").read_text())
    root = tmp_path / "root"
    root.mkdir()
    for hook in layer["mmdebstrap"]["customize-hooks"]:
        subprocess.run(["sh", "-euc", hook, "hook", str(root)], cwd=IMAGE, check=True)
    return root


def test_the_hooks_do_what_they_say(hooked):
    assert "Storage=volatile" in (hooked / "etc/systemd/journald.conf.d/sagnode.conf").read_text().splitlines()
    watchdog = (hooked / "etc/systemd/system.conf.d/sagnode.conf").read_text().splitlines()
    assert watchdog[:2] == ["[Manager]", "RuntimeWatchdogSec=15s"]  # the processor's longest


def test_neither_image_nor_first_boot_holds_a_secret(hooked):
    for file in [*IMAGE.rglob("*"), USER_DATA, *hooked.rglob("*")]:
        if file.is_file():
            assert "PRIVATE KEY" not in file.read_text(errors="replace"), file
            assert "passwd:" not in file.read_text(errors="replace").replace("lock_passwd:", "")
    assert yaml.safe_load((IMAGE / "config" / "sagnode.yaml").read_text())["ssh"]["pubkey_only"] == "y"


def test_image_and_first_boot_set_the_same(hooked):
    written = {part["path"]: part["content"] for part in yaml.safe_load(USER_DATA.read_text())["write_files"]}
    for path, content in written.items():
        assert (hooked / path.lstrip("/")).read_text() == content


def test_the_first_boot_is_understood_by_cloud_init():
    assert USER_DATA.read_text().startswith("#cloud-config\n")
    if shutil.which("cloud-init") is None:
        pytest.skip("cloud-init is not installed (apt install cloud-init)")
    assert "Valid" in ran("cloud-init", "schema", "--config-file", USER_DATA).stdout


def test_the_layer_is_understood_by_rpi_image_gen(tmp_path):
    """RPI_IMAGE_GEN=<its checkout>; needs python3-debian and python3-yaml of the system."""
    place = os.environ.get("RPI_IMAGE_GEN")
    if place is None:
        pytest.skip("RPI_IMAGE_GEN does not name a checkout of rpi-image-gen")
    tool = [f"{place}/rpi-image-gen"]
    system = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "PYTHONPATH": ""}
    layer = IMAGE / "layer" / "sagnode.yaml"
    assert ran(*tool, "metadata", "--lint", layer, **system).stdout.strip() == "OK"
    path = f"own={IMAGE}/layer:" + ":".join(f"{part}={place}/{part}" for part in ("layer", "device", "image"))
    described = ran(*tool, "layer", "--path", path, "--describe", "sagnode", **system).stdout
    assert "openssh-server: " in described and "not found" not in described.lower()
    resolved = tmp_path / "resolved"
    search = f"{IMAGE}/config:{place}/config"
    ran(*tool, "config", "--path", search, "-S", IMAGE, "--write-to", resolved, "sagnode.yaml", **system)
    assert {'IGconf_layer_app="sagnode"', 'IGconf_ssh_pubkey_only="y"'} <= set(resolved.read_text().splitlines())
