"""The power of a whole machine fails: kernel, page cache and daemon are gone, the disk keeps what was flushed.

A virtual machine with Debian's kernel runs the node on an ext4 of its own; broker, witness and books stay outside. The
emulator is stopped and killed at a random moment, the same disk put into the next boot. What the daemon knows of a
power cut, another boot's id, it knows from a real one here.
"""

import subprocess
import time

import guest
from campaign import Skip
from rig import Rig
from section_power import examine, stand_still
from table import Line
from volatile_disk import VolatileFile
from volatile_disk import available as no_disk
from volatile_disk import run as command

CUTS = 12
LOOKS = 5
"""So often a boot's disk is looked at as if the power failed then, before it does."""
BOOT_S = 240.0
"""The emulator is slow, and the machine beneath it has other work."""
MEGABYTES = 16


def run(campaign):
    missing = no_disk() or guest.available()
    if missing:
        raise Skip(missing)
    directory = campaign.fresh("vm")
    node = directory / "node"
    broken, recovery, looked = [], [], 0
    with VolatileFile(directory / "volatile", MEGABYTES, campaign.random) as disk:
        with Rig(node, state_dir=node / "disk" / "state", virtual=False, interval_s=0.3) as rig:
            machine = guest.Guest(node, disk.file)
            rig.launch = machine.boot
            # The network between the two is memory of this machine.
            rig.configure(host=guest.HOST, mqtt="insecure_plaintext = true")
            wanted = campaign.count(CUTS)
            for number in range(wanted):
                began = time.monotonic()
                rig.start()
                if number % 3 == 2:  # again before it is up, or just then
                    time.sleep(campaign.random.uniform(0.3, 1.1) * recovery[-1])
                else:
                    rig.wait_good(2, BOOT_S)
                    recovery.append(time.monotonic() - began)
                for _ in range(LOOKS):
                    time.sleep(campaign.random.uniform(0.0, 0.6))
                    known = set(rig.witness.sent)
                    broken += [f"boot {number}: {text}" for text in examine(directory, disk.cut(), known)]
                    looked += 1
                stand_still(rig.daemon)  # the whole machine: what it did after this moment never happened
                known, image = set(rig.witness.sent), disk.cut()
                rig.kill()
                disk.put(image)
                broken += [f"cut {number}: {text}" for text in examine(directory, image, known)]
            line = settled(rig, disk)
    line.times, line.recovery, line.limit_s = wanted + looked, recovery, BOOT_S
    line.allowed_repeats = wanted * 70
    line.broken += broken
    line.remark = (
        f"{wanted} machines lost their power and came back on the same disk, {looked} more looks at a disk;"
        f" quick_check clean after {line.times - len(broken)}; {disk.flushes} flushes; recovery: an emulated boot"
    )
    return [line]


def settled(rig, disk):
    """What is still owed goes out from here, on the disk as the last cut left it."""
    place = rig.directory / "disk"
    command("mount", "-o", "loop", disk.file, place)
    try:
        rig.launch = rig._launch
        rig.last_run()
        books = rig.books(allowed_gaps=True)
        if books.in_flight > rig.kills:
            books.remarks.append(f"{books.in_flight} answers were never recorded, in {rig.kills} cuts")
        return Line.of("vm", "power cut of a virtual machine (the same, with its kernel and memory)", 0, books)
    finally:
        subprocess.run(["umount", "-l", str(place)], check=False, capture_output=True)
