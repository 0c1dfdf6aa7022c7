"""Install pip into an environment that has none, from PyPI's own wheel, checked against the digest that PyPI states.

For Debian without the package python3-venv and without root; run by the environment's Python.
"""

from __future__ import annotations

import hashlib
import json
import runpy
import sys
import tempfile
import urllib.parse
import urllib.request
from pathlib import Path

INDEX = "https://pypi.org/pypi/pip/json"


def main() -> int:
    """Download, check, install."""
    try:
        with urllib.request.urlopen(INDEX, timeout=60) as answer:
            files = json.load(answer)["urls"]
        wheel = next(file for file in files if file["packagetype"] == "bdist_wheel")
        address = urllib.parse.urljoin(INDEX, wheel["url"])  # mirrors give relative ones
        with urllib.request.urlopen(address, timeout=120) as answer:  # noqa: S310 - an address that the index gave
            data = answer.read()
    except (OSError, ValueError, KeyError, StopIteration) as error:
        print(f"setup: error: pip cannot be had from {INDEX}: {error}", file=sys.stderr)
        return 1
    if hashlib.sha256(data).hexdigest() != wheel["digests"]["sha256"]:
        print(f"setup: error: {address} does not have the digest that PyPI states", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / wheel["filename"]
        path.write_bytes(data)
        sys.path.insert(0, str(path))
        sys.argv = ["pip", "install", "--quiet", "--no-index", "--disable-pip-version-check", str(path)]
        try:
            runpy.run_module("pip", run_name="__main__")
        except SystemExit as ended:
            return int(ended.code or 0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
