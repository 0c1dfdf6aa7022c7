"""A virtual machine that runs this checkout on a disk of its own, and whose power can fail.

Emulated (no KVM is needed): Debian's kernel, this machine's files as a root that cannot be written, one folder that
can, and one ext4 on a virtio disk, mounted at ``disk`` in that folder. It reaches servers of this machine at ``HOST``.
"""

import os
import shlex
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
WORK = Path(os.environ.get("WORK", "/var/tmp/sagnode-roots"))  # noqa: S108 - told in tests/platform
HOST = "10.0.2.2"
"""This machine, as the virtual one sees it (QEMU's user networking)."""
PROGRAMS = {"qemu-system-x86_64": "qemu-system-x86", "busybox": "busybox-static", "cpio": "cpio"}


def available():
    """What is missing here, or None."""
    missing = [package for program, package in PROGRAMS.items() if shutil.which(program) is None]
    if missing:
        return f"a virtual machine needs: apt install {' '.join(missing)}"
    made = subprocess.run(
        ["bash", str(ROOT / "tests" / "platform" / "guest.sh")], check=False, capture_output=True, text=True
    )
    return f"no kernel for a virtual machine: {made.stderr.strip()[-200:]}" if made.returncode else None


class Guest:
    """One virtual machine, again and again on the same disk.

    Args:
        folder: the one that it may write; what it says on its console goes to ``console`` there.
        disk: file with the ext4.
    """

    def __init__(self, folder, disk):
        self.folder, self.disk = folder, disk
        self.boots = 0
        (folder / "disk").mkdir(exist_ok=True)

    def boot(self, words, environment):
        """Switch it on; its first program runs these words. Returns QEMU's process, which ends by a kill alone."""
        kept = {name: environment[name] for name in ("PYTHONPATH",) if name in environment}
        exports = "".join(f"export {name}={shlex.quote(value)}\n" for name, value in kept.items())
        # Its first program may not end; and whatever it started ends with the power.
        (self.folder / "job").write_text(
            f"export TMPDIR=/run PYTHONDONTWRITEBYTECODE=1\n{exports}cd {shlex.quote(str(self.folder))}\n"
            f"{shlex.join(words)} >>log 2>&1 &\nwhile :; do wait; sleep 1000; done\n"
        )
        self.boots += 1
        with (self.folder / "console").open("ab") as console:
            return subprocess.Popen(
                [
                    "qemu-system-x86_64", "-accel", "tcg,thread=single,tb-size=256", "-cpu", "Nehalem", "-M", "q35",
                    "-m", "512", "-smp", "1", "-nographic", "-no-reboot", "-nodefaults", "-serial", "stdio",
                    "-kernel", str(WORK / "guest" / "kernel"), "-initrd", str(WORK / "guest" / "initrd"),
                    "-append", f"console=ttyS0 quiet panic=-1 mitigations=off share={self.folder}",
                    "-drive", f"file={self.disk},format=raw,if=virtio,cache=writeback",
                    "-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
                    "-virtfs", f"local,path={self.folder},mount_tag=share,security_model=none",
                    "-nic", "user,model=virtio-net-pci",
                ],
                stdin=subprocess.DEVNULL, stdout=console, stderr=console,
            )  # fmt: skip
