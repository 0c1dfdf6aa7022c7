"""Brings an installation of deploy/install.sh up to date, from where /etc/sagnode/update.toml says.

    sudo python3 -I /opt/sagnode/current/update.py [--check]      --check: say what would be done
    (systemctl enable --now sagnode-update.timer does it once a day)

    from = "https://updates.example.org/sagnode"    # or a directory, not below /home, /root or /tmp
    key = "update.pub"                              # beside this file: who signs releases

There lie packages (make deb), SHA256SUMS of them, and SHA256SUMS.sig, made where the private key is:

    sha256sum sagnode_*.deb > SHA256SUMS
    openssl dgst -sha256 -sign update.key -out SHA256SUMS.sig SHA256SUMS

Only what is signed, for this system, and later than what runs is installed; install.sh goes back by itself when it does
not run, and the same file is then not tried again. An old list that somebody shows again brings nothing old back: a
step back is a person's to take (install.sh --rollback). The system's own Python runs this, with its library alone.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import tomllib
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

CONFIGURATION = Path("/etc/sagnode/update.toml")
CURRENT = Path("/opt/sagnode/current")
STATE = Path("/var/lib/sagnode-update")
SUMS = "SHA256SUMS"
SUMS_MAX_BYTES = 1_000_000
PACKAGE_MAX_BYTES = 400_000_000
PATIENCE_S = 60.0
NAME = re.compile(r"sagnode_([0-9][0-9A-Za-z.~]*)\+deb(\d+)_([a-z0-9]+)\.deb")


class Fault(Exception):
    """Something that a person has to see to; the text names it and the remedy."""


@dataclass(frozen=True)
class Source:
    """Where releases come from, and whose."""

    place: str
    key: Path


@dataclass(frozen=True)
class Release:
    """One package of the list."""

    file: str
    version: str
    sha256: str


def read_source(path: Path) -> Source:
    """The configuration; raises Fault with the key that is wrong."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise Fault(f"{path}: {error.strerror}; it says where releases come from (docs/install.md)") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise Fault(f"{path}: {error}") from None
    if unknown := sorted(set(table) - {"from", "key"}):
        raise Fault(f"{path}: {unknown[0]} is no key here; there are from and key")
    place, key = table.get("from"), table.get("key")
    if not isinstance(place, str) or not place.startswith(("https://", "/")):
        raise Fault(f'{path}: from must be "https://…" or an absolute directory, and is {place!r}')
    if not isinstance(key, str) or not (path.parent / key).is_file():
        raise Fault(f"{path}: key must name the file of a public key (openssl pkey -pubout), and is {key!r}")
    return Source(place.rstrip("/"), path.parent / key)


def _open(source: Source, name: str) -> BinaryIO:
    if source.place.startswith("/"):
        return (Path(source.place) / name).open("rb")
    found: BinaryIO = urllib.request.urlopen(f"{source.place}/{name}", timeout=PATIENCE_S)  # noqa: S310 - https, see above
    return found


def fetch(source: Source, name: str, to: Path, limit: int) -> str:
    """Copy one file of the source; returns its SHA-256."""
    digest, size = hashlib.sha256(), 0
    try:
        with _open(source, name) as stream, to.open("wb") as file:
            while block := stream.read(1 << 20):
                size += len(block)
                if size > limit:
                    raise Fault(f"{source.place}/{name} has more than {limit} bytes")
                digest.update(block)
                file.write(block)
    except (OSError, urllib.error.URLError) as error:
        words = getattr(error, "reason", None) or error.strerror or error
        raise Fault(f"{source.place}/{name}: {words}") from None
    return digest.hexdigest()


def check_signature(sums: Path, signature: Path, key: Path) -> None:
    """Raises Fault where the list is not signed with the key."""
    command = ["openssl", "dgst", "-sha256", "-verify", str(key), "-signature", str(signature), str(sums)]
    try:
        said = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise Fault("no openssl on this machine: apt install openssl") from None
    if said.returncode:
        words = said.stdout.strip() or said.stderr.strip()
        raise Fault(f"{SUMS} is not signed with {key}; nothing is installed ({words})")


def releases(sums: str, number: str, arch: str) -> list[Release]:
    """Those of the list that are for this Debian and processor, as ``sha256sum`` writes them."""
    found = []
    for line in sums.splitlines():
        sha256, _, file = line.partition("  ")
        name = NAME.fullmatch(file.strip())
        if name and re.fullmatch(r"[0-9a-f]{64}", sha256) and name[2] == number and name[3] == arch:
            found.append(Release(file.strip(), name[1], sha256))
    return found


def later(one: str, other: str) -> bool:
    """Whether a version comes after another, by Debian's order."""
    return subprocess.run(["dpkg", "--compare-versions", one, "gt", other], check=False).returncode == 0


def newest(found: list[Release], present: str, refused: frozenset[str]) -> Release | None:
    """The latest that is later than what runs and was not tried in vain."""
    best = None
    for release in found:
        if release.sha256 not in refused and later(release.version, best.version if best else present):
            best = release
    return best


def present_version(current: Path) -> str:
    """Of the release in use, in Debian's words."""
    command = current / "venv" / "bin" / "sagnode"
    try:
        said = subprocess.run([command, "--version"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        raise Fault(f"{command} does not tell its version ({error}); install it anew: deploy/install.sh") from None
    return re.sub(r"\.?(dev|a|b|rc)(\d+)", r"~\1\2", said.split()[-1])


def update(source: Source, current: Path, state: Path, only_look: bool = False) -> str:
    """Look, and install what is newer; returns what came of it in one line."""
    number = platform.freedesktop_os_release().get("VERSION_ID", "")
    arch = subprocess.run(["dpkg", "--print-architecture"], capture_output=True, text=True, check=True).stdout.strip()
    present = present_version(current)
    state.mkdir(mode=0o700, parents=True, exist_ok=True)
    sums, signature, remembered = state / SUMS, state / f"{SUMS}.sig", state / "refused"
    fetch(source, SUMS, sums, SUMS_MAX_BYTES)
    fetch(source, f"{SUMS}.sig", signature, SUMS_MAX_BYTES)
    check_signature(sums, signature, source.key)
    refused = frozenset(remembered.read_text(encoding="utf-8").split() if remembered.exists() else ())
    release = newest(releases(sums.read_text(encoding="utf-8"), number, arch), present, refused)
    if release is None:
        return f"{present} is the latest for Debian {number} {arch}" + (" that ran here" if refused else "")
    if only_look:
        return f"{release.version} would follow {present}"
    package = state / release.file
    try:
        if fetch(source, release.file, package, PACKAGE_MAX_BYTES) != release.sha256:
            raise Fault(f"{release.file} is not the one that {SUMS} tells of; was it copied whole?")
        # The installer of the release in use, which is known to run here.
        ran = subprocess.run(["bash", current / "install.sh", "--from", package], check=False)
    finally:
        package.unlink(missing_ok=True)
    if ran.returncode:
        with remembered.open("a", encoding="utf-8") as file:
            file.write(f"{release.sha256}\n")
        raise Fault(f"{release.version} was not installed (above), {present} goes on; to try again: rm {remembered}")
    return f"{release.version} follows {present}"


def main(words: list[str]) -> int:
    """One run."""
    if words not in ([], ["--check"]):
        print("usage: update.py [--check]", file=sys.stderr)
        return 2
    if os.geteuid() != 0:
        print("sagnode-update: error: needs root: sudo", file=sys.stderr)
        return 1
    if not shutil.which("dpkg"):
        print("sagnode-update: error: this is not Debian or Raspberry Pi OS", file=sys.stderr)
        return 1
    try:
        said = update(read_source(CONFIGURATION), CURRENT, STATE, only_look=bool(words))
    except Fault as fault:
        print(f"sagnode-update: error: {fault}", file=sys.stderr)
        return 1
    print(f"sagnode-update: {said}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
