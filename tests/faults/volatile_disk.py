"""A disk that forgets: a file system in user space with one file, whose unsynchronised sectors a power cut may lose.

The file is the backing store of a loop device, and on that lies a real ext4. What the kernel writes is kept apart until
the loop device passes on a flush (FUSE_FSYNC); a cut takes what was flushed and a random part of the sectors that were
not, which is what a card's cache does. The disk can also refuse (EIO) or be slow.

Speaks the kernel's protocol itself (https://docs.kernel.org/filesystems/fuse/fuse.html, include/uapi/linux/fuse.h): no
library is needed, but root, /dev/fuse and loop devices are.
"""

import ctypes
import errno
import os
import shutil
import stat
import struct
import subprocess
import threading
import time
from pathlib import Path

PROGRAMS = ("mkfs.ext4", "fsck.ext4", "losetup", "mount", "umount")
PATH = ":".join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"])
"""An account's own path need not have what administers disks."""
SECTOR = 512
SUPERBLOCK = (2, 3)
"""ext4 counts on it that these are written in one piece: half of them is nothing that it can mount without e2fsck."""
FILE_INODE = 2
NAME = b"disk"
_IN = struct.Struct("<IIQQIIII")
_OUT = struct.Struct("<IiQ")
_LOOKUP, _FORGET, _GETATTR, _SETATTR, _OPEN, _READ, _WRITE, _STATFS = 1, 2, 3, 4, 14, 15, 16, 17
_RELEASE, _FSYNC, _FLUSH, _INIT, _OPENDIR, _READDIR, _RELEASEDIR, _DESTROY = 18, 20, 25, 26, 27, 28, 29, 38
_MS_NODEV_NOSUID = 2 | 4


def available():
    """What is missing here, or None."""
    if os.geteuid() != 0:
        return "a disk in user space needs root"
    for device in ("/dev/fuse", "/dev/loop-control"):
        if not Path(device).exists():
            return f"a disk in user space needs {device}"
    for program in PROGRAMS:
        if shutil.which(program, path=PATH) is None:
            return f"a disk in user space needs {program}"
    return None


class VolatileFile:
    """The one file, with an empty ext4 in it, for a loop device or a virtual machine; a context manager.

    Args:
        directory: for its files and mount points.
        megabytes: size.
        random: source of randomness for cuts.
    """

    def __init__(self, directory, megabytes, random):
        self.directory, self.random = directory, random
        self.size = megabytes * 1_000_000 // 4096 * 4096
        self.durable = bytearray(self.size)
        self.unflushed = {}  # sector number to its new content
        self.failing = False
        self.slow_s = 0.0
        self.flushes = self.refused = 0
        self._lock = threading.Lock()
        self._fuse = self.directory / "fuse"
        self.file = self._fuse / NAME.decode()

    def __enter__(self):
        self._fuse.mkdir(parents=True)
        self._fd = os.open("/dev/fuse", os.O_RDWR | os.O_CLOEXEC)
        options = f"fd={self._fd},rootmode=40000,user_id=0,group_id=0,allow_other".encode()
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mount(b"sagnode-test", bytes(self._fuse), b"fuse", _MS_NODEV_NOSUID, options):
            raise OSError(ctypes.get_errno(), "mount of the file system in user space")
        threading.Thread(target=self._serve, daemon=True).start()
        run("mkfs.ext4", "-q", "-F", "-b", "4096", "-E", "nodiscard", "-O", "^metadata_csum_seed", self.file)
        return self

    def __exit__(self, *_):
        self.failing = False
        subprocess.run(["umount", "-l", str(self._fuse)], check=False, capture_output=True)

    def put(self, image):
        """This is what the disk holds when the power comes back; nobody has the file open."""
        with self._lock:
            self.durable[:] = image
            self.unflushed.clear()

    def cut(self):
        """The disk as it would be found if the power failed now: bytes of the whole image."""
        with self._lock:
            image = bytearray(self.durable)
            superblock = self.random.random() < 0.5
            for sector, content in self.unflushed.items():
                if superblock if sector in SUPERBLOCK else self.random.random() < 0.5:
                    image[sector * SECTOR : (sector + 1) * SECTOR] = content
            return image

    # -- the file system

    def _serve(self):
        buffer = 1 << 20
        while True:
            try:
                request = os.read(self._fd, buffer)
            except OSError as error:
                if error.errno in {errno.ENODEV, errno.EBADF}:
                    return
                continue
            _, opcode, unique, node, *_ = _IN.unpack_from(request)
            answer = self._answer(opcode, node, request[_IN.size :])
            if answer is None:
                continue
            code, body = (answer, b"") if isinstance(answer, int) else (0, answer)
            try:
                os.write(self._fd, _OUT.pack(_OUT.size + len(body), -code, unique) + body)
            except OSError:
                continue

    def _answer(self, opcode, node, body):
        if opcode == _INIT:
            return struct.pack("<IIIIHHIIHHI7I", 7, 31, 1 << 17, 0, 12, 10, 1 << 17, 1, 32, 0, 0, *[0] * 7)
        if opcode in {_FORGET, _DESTROY}:
            return None
        if opcode == _LOOKUP:
            entry = struct.pack("<QQQQII", FILE_INODE, 0, 3600, 3600, 0, 0)
            return entry + self._attributes(FILE_INODE) if body.rstrip(b"\0") == NAME else errno.ENOENT
        if opcode in {_GETATTR, _SETATTR}:
            return struct.pack("<QII", 3600, 0, 0) + self._attributes(node)
        if opcode in {_OPEN, _OPENDIR}:
            return struct.pack("<QII", 0, 0, 0)
        if opcode == _READDIR:
            return b""
        if opcode in {_RELEASE, _RELEASEDIR, _FLUSH}:
            return b""
        if opcode == _STATFS:
            return struct.pack("<QQQQQIIII6I", self.size // 4096, 0, 0, 1, 0, 4096, 255, 4096, 0, *[0] * 6)
        if opcode in {_READ, _WRITE, _FSYNC}:
            return self._data(opcode, body)
        return errno.ENOSYS

    def _data(self, opcode, body):
        if self.slow_s:
            time.sleep(self.slow_s)
        if self.failing:
            self.refused += 1
            return errno.EIO
        with self._lock:
            if opcode == _FSYNC:
                for sector, content in self.unflushed.items():
                    self.durable[sector * SECTOR : (sector + 1) * SECTOR] = content
                self.unflushed.clear()
                self.flushes += 1
                return b""
            _, offset, size = struct.unpack_from("<QQI", body)
            if opcode == _WRITE:
                data = body[40 : 40 + size]
                for at in range(0, size, SECTOR):
                    self.unflushed[(offset + at) // SECTOR] = data[at : at + SECTOR]
                return struct.pack("<II", size, 0)
            end = min(offset + size, self.size)
            found = bytearray(self.durable[offset:end])
            for sector in range(offset // SECTOR, end // SECTOR):
                if sector in self.unflushed:
                    start = sector * SECTOR - offset
                    found[start : start + SECTOR] = self.unflushed[sector]
            return bytes(found)

    def _attributes(self, node):
        kind, size = (stat.S_IFREG | 0o600, self.size) if node == FILE_INODE else (stat.S_IFDIR | 0o700, 4096)
        return struct.pack("<QQQQQQIIIIIIIIII", node, size, size // SECTOR, 0, 0, 0, 0, 0, 0, kind, 1, 0, 0, 0, 4096, 0)


class VolatileDisk(VolatileFile):
    """Mounted while it is open, below its directory at ``place``."""

    def __init__(self, directory, megabytes, random):
        super().__init__(directory, megabytes, random)
        self.place = self.directory / "mounted"
        self.device = None

    def __enter__(self):
        super().__enter__()
        self.place.mkdir(parents=True)
        self.device = run("losetup", "--show", "-f", self.file).strip()
        self.mount()
        return self

    def __exit__(self, *words):
        self.failing = False
        for command in (("umount", "-l", self.place), ("losetup", "-d", self.device)):
            attempted(*command)
        super().__exit__(*words)

    def mount(self):
        """An error of the disk makes the file system read-only, as Debian mounts its root."""
        run("mount", "-o", "errors=remount-ro,commit=1", self.device, self.place)

    def unmount(self):
        run("umount", self.place)

    def repaired(self):
        """Taken out while nobody uses it, looked over, and put in again as another device."""
        run("losetup", "-d", self.device)
        self.device = run("losetup", "--show", "-f", self.file).strip()
        attempted("fsck.ext4", "-y", self.device)
        self.mount()

    def replace(self, image):
        """The power comes back, and this is what the disk holds; whoever used it must have ended."""
        self.unmount()
        run("losetup", "-d", self.device)
        self.put(image)
        self.device = run("losetup", "--show", "-f", self.file).strip()
        self.mount()


def run(*words):
    done = attempted(*words)
    if done.returncode:
        raise OSError(done.returncode, f"{' '.join(map(str, words))}: {done.stderr.strip()}")
    return done.stdout


def attempted(program, *words):
    found = shutil.which(program, path=PATH) or program
    return subprocess.run([found, *map(str, words)], check=False, capture_output=True, text=True)
