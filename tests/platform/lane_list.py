"""The lanes of make test-platform: what each shows, its commands, and what it cannot do without."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path("tests/platform")
WORK = Path(os.environ.get("WORK", "/var/tmp/sagnode-roots"))  # noqa: S108 - told in the scripts; removed by nobody else
MADE = Path("build")


@dataclass(frozen=True)
class Lane:
    """One lane: what it shows, its commands in turn, and the programs that it cannot do without."""

    name: str
    shows: str
    commands: tuple[tuple[str, ...], ...]
    programs: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()
    root: bool = True
    uses: frozenset[str] = field(default=frozenset())
    """Roots; two lanes that use one do not run beside each other."""
    after: tuple[str, ...] = ()
    """Lanes whose results this one uses, when they run too."""
    limit_s: float = 3600.0
    """Ended after this time, whatever it does."""


CONTAINER = ("mmdebstrap", "systemd-nspawn", "dpkg-deb", "git")
EMULATED = (*CONTAINER, "qemu-aarch64-static", "arch-test")
MACHINE = (*CONTAINER, "qemu-system-x86_64", "busybox", "cpio", "mke2fs")
PACKAGES = {
    "systemd-nspawn": "systemd-container",
    "qemu-aarch64-static": "qemu-user-static",
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "mke2fs": "e2fsprogs",
    "dpkg-deb": "dpkg",
    "ansible-playbook": "ansible-core",
    "ssh-keygen": "openssh-client",
}
QUICK_S = 600.0
"""For the lanes of continuous integration: several times what they take."""


def _bare(suite: str, *steps: str) -> tuple[str, ...]:
    return ("bash", f"{HERE}/bare_root.sh", suite, *steps)


def _in_root(
    name: str, shows: str, suite: str, step: str, *, arch: str = "", built: bool = False, quick: bool = False
) -> Lane:
    """A step of bare_root.sh; ``built`` when the package is made for it where no other lane has."""
    suffix = f"-{arch}" if arch else ""
    make: tuple[tuple[str, ...], ...] = ()
    if built and not any(MADE.glob("sagnode_*+deb13_amd64.deb")):
        make = ((sys.executable, "deploy/build_deb.py", "--suite", suite, "--arch", "amd64"),)
    return Lane(
        name,
        shows,
        (*make, _bare(suite, step)),
        EMULATED if arch else CONTAINER,
        (("ARCH", arch),) if arch else (),
        uses=frozenset({suite + suffix}),
        after=() if step == "picamera2" else ("packages",),
        limit_s=QUICK_S if quick else 3600.0,
    )


def lanes() -> tuple[Lane, ...]:
    """All of them, in the order in which they are begun and told."""
    boot = "cold boot to the first reading, hardware watchdog, doctor; a stalled camera; V4L2 on vivid and v4l2loopback"
    lint = "printf '%s\\n' build/sagnode_*.deb | xargs -n 1 -P 2 lintian --fail-on error,warning"
    root = () if (WORK / "trixie-vm").is_dir() else (_bare("trixie", "root"),) * (not (WORK / "trixie").is_dir())
    emulated = "Cortex-A76 emulated"
    return (
        Lane(
            "packages",
            "Debian packages for both systems and both processors, lintian without errors or warnings",
            ((sys.executable, "deploy/build_deb.py"), ("sh", "-c", lint)),
            ("dpkg-deb", "lintian"),
            root=False,
        ),
        Lane(
            "vm",
            boot,
            (
                *root,
                *(() if (WORK / "trixie-vm").is_dir() else (("bash", f"{HERE}/vm.sh", "root"),)),
                ("bash", f"{HERE}/vm.sh", "image"),
                ("bash", f"{HERE}/vm.sh", "run", "vm_boot.sh", "vm_stall.sh", "vm_v4l2.py"),
            ),
            MACHINE,
            uses=frozenset({"vm"} if (WORK / "trixie-vm").is_dir() else {"vm", "trixie"}),
            after=("packages",),
        ),
        *(
            _in_root(
                f"package-{suite}-arm64",
                f"the package on a bare {suite.title()}, {emulated}",
                suite,
                "deb",
                arch="arm64",
            )
            for suite in ("bookworm", "trixie")
        ),
        # Not Trixie: its systemd 257 starts nothing under QEMU 7.2's emulation of single programs.
        _in_root(
            "booted-bookworm-arm64",
            f"Bookworm booted, {emulated}: the package's service comes up, measures, is stopped",
            "bookworm",
            "boot-package",
            arch="arm64",
        ),
        *(
            _in_root(
                f"booted-{suite}",
                f"{suite.title()} booted: the service, its watchdog, updates and the way back",
                suite,
                "boot",
            )
            for suite in ("bookworm", "trixie")
        ),
        *(
            _in_root(f"package-{suite}", f"the package on a bare {suite.title()}", suite, "deb")
            for suite in ("bookworm", "trixie")
        ),
        _in_root(
            "service-trixie",
            "Trixie booted: the package's service measures, is killed, hung, reloaded; and on a read-only root",
            "trixie",
            "boot-package",
            built=True,
            quick=True,
        ),
        _in_root("picamera2", "the real Picamera2 over libcamera's virtual cameras", "trixie", "picamera2", quick=True),
        Lane(
            "fleet",
            "the Ansible role: linted, applied, fed a bad configuration, renewed; cloud-init's check of the first boot",
            ((sys.executable, "-m", "pytest", "tests/deploy/test_ansible.py", "tests/deploy/test_image.py"),),
            ("ansible-playbook", "ansible-lint", "cloud-init", "openssl"),
            (("SAGNODE_ANSIBLE", "1"),),
            root=False,
        ),
        Lane(
            "package-here",
            "the package of this very system unpacked: its size, a reading, its compiled kernels, lintian",
            ((sys.executable, f"{HERE}/package_here.py"),),
            (),
            root=False,
            limit_s=QUICK_S,
        ),
        Lane(
            "sanitized",
            "the compiled kernels with every access to memory and every conversion watched",
            ((sys.executable, "scripts/sanitize.py"),),
            (),
            root=False,
            limit_s=QUICK_S,
        ),
        Lane(
            "image",
            f"the root of the image's recipe, by rpi-image-gen's layers and hooks, {emulated}",
            (("bash", f"{HERE}/image.sh"),),
            (*EMULATED, "bdebstrap", "rsync", "ssh-keygen"),
            uses=frozenset({"image"}),
            after=("packages",),
        ),
    )


def lacking(lane: Lane) -> str:
    """What the lane cannot do without and has not; empty when it can run."""
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    missing = [program for program in lane.programs if shutil.which(program, path=path) is None]
    words = []
    if missing:
        names = " ".join(sorted({PACKAGES.get(program, program) for program in missing}))
        words.append(f"apt install {names}")
    if lane.root and os.geteuid() != 0:
        words.append("root")
    elif lane.root and not _may_make_namespaces():
        words.append("the right to make namespaces (this container has not got it)")
    return "; ".join(words)


def _may_make_namespaces() -> bool:
    """Whether root here is root enough for systemd-nspawn."""
    words = ["unshare", "--mount", "--pid", "--ipc", "--uts", "--fork", "mount", "-t", "tmpfs", "none", "/mnt"]
    try:
        return subprocess.run(words, capture_output=True, check=False, timeout=30).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False
