"""deploy/ansible, applied for real to this machine with other directories: configuration and certificate, twice."""

import json
import os
import re
import shutil
import subprocess
import sys

import pytest
from utility import CA, ROOT, ran

ANSIBLE = ROOT / "deploy" / "ansible"
PLAY = shutil.which("ansible-playbook")


WANTED = "SAGNODE_ANSIBLE" in os.environ
pytestmark = pytest.mark.skipif(not WANTED, reason="takes a minute and needs Ansible; SAGNODE_ANSIBLE=1 runs it")


def test_the_role_is_clean():
    lint = shutil.which("ansible-lint")
    if lint is None:
        pytest.skip("ansible-lint is not installed (apt install ansible-lint)")
    result = subprocess.run(
        [lint, "--nocolor", "--offline", "--profile", "production", "site.yml"],
        cwd=ANSIBLE,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.fixture
def play(tmp_path):
    """Runs the playbook on this machine as the user that runs the tests; the package and the service are left out."""
    if PLAY is None or shutil.which("openssl") is None:
        pytest.skip("ansible-playbook or openssl is not installed (apt install ansible-core openssl)")
    ca, units, etc = tmp_path / "ca", tmp_path / "units", tmp_path / "etc"
    ran(CA, ca, "init")
    shutil.copytree(
        ROOT / "src/sagnode/demo/site",
        units / "unit-1",
        ignore=shutil.ignore_patterns("frames", "truth*", "__pycache__"),
    )
    command = tmp_path / "bin" / "sagnode"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m sagnode "$@"\n')
    command.chmod(0o755)
    user, group = (ran("id", flag).stdout.strip() for flag in ("-un", "-gn"))
    values = {
        "ansible_connection": "local", "ansible_python_interpreter": sys.executable, "sagnode_become": False,
        "sagnode_ca": str(ca), "sagnode_files": str(units / "unit-1"), "sagnode_etc": str(etc),
        "sagnode_enrol": str(tmp_path / "bin" / "sagnode-enrol"), "sagnode_owner": user, "sagnode_group": group,
        "sagnode_service": False,
    }  # fmt: skip
    inventory = tmp_path / "inventory.json"
    inventory.write_text(json.dumps({"units": {"hosts": {"unit-1": values}}}))

    def run(*more, fails=False):
        environment = {
            **os.environ,
            "PATH": f"{command.parent}:{os.environ['PATH']}",
            "ANSIBLE_LOCAL_TEMP": str(tmp_path / "ansible"),
            "ANSIBLE_NOCOLOR": "1",
        }
        words = [PLAY, "-i", str(inventory), str(ANSIBLE / "site.yml"), *more]
        result = subprocess.run(words, capture_output=True, text=True, timeout=110, env=environment)
        assert (result.returncode != 0) == fails, result.stdout + result.stderr
        return result.stdout

    run.etc, run.files, run.ca = etc, units / "unit-1", ca
    return run


def changed(said):
    return int(re.search(r"unit-1 .*changed=(\d+)", said)[1])


@pytest.mark.timeout(400)
def test_a_unit_is_configured_and_enrolled_once_and_a_bad_configuration_never_reaches_it(play):
    play("--check")
    assert not play.etc.exists()
    assert changed(play()) > 5
    pem = play.etc / "tls" / "unit.pem"
    named = ran("openssl", "x509", "-in", pem, "-noout", "-subject").stdout
    assert re.search(r"CN ?= ?[\w.-]+/[\w.-]+/[\w.-]+/[\w.-]+$", named.strip())
    assert (play.etc / "node.toml").stat().st_mode & 0o777 == 0o640
    before = pem.read_bytes()
    assert changed(play()) == 0  # a second time there is nothing to do
    assert pem.read_bytes() == before

    node = play.files / "node.toml"
    good = node.read_text()
    node.write_text(good + "\n[nonsense]\n")
    assert "nonsense" in play(fails=True)
    assert (play.etc / "node.toml").read_text() == good
    node.write_text(good)

    assert changed(play("-e", "sagnode_renew_days=10000")) >= 4  # renewal
    assert pem.read_bytes() != before
