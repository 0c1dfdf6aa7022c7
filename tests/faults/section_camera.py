"""A camera that stalls, goes black, gives half or old frames, vanishes and returns, before the real worker.

Every reading with a number is compared with the truth that the demonstration's frames bring.
"""

import shutil
import sys
from datetime import datetime

from nodes import SITE
from rig import HERE, Rig
from table import Line

from sagnode.demo.results import read_truth

KINDS = ("black", "half-black", "half-old", "stale", "timeout", "vanish", "burnt-out", "upper-half-old", "torn",
         "noise", "bands", "stall")  # fmt: skip
COUNT = 48
BEYOND = 5.0
"""A number so many standard uncertainties from the truth is a false one."""


def run(campaign):
    wanted = campaign.count(COUNT)
    directory = campaign.fresh("camera")
    frames = directory / "frames"
    frames.mkdir()
    for hour in range(9, 16):  # daylight without rain, where the frames are well
        for file in (SITE / "frames").glob(f"*T{hour:02d}*"):
            shutil.copy(file, frames)
    truth = {(*place_in_the_round(at), conductor): value for (at, conductor), value in read_truth(frames).items()}
    worker = [sys.executable, str(HERE / "faulty_camera.py"), str(directory / "ledger"), ",".join(KINDS), "{config}",
              "{requests}", "{replies}", "{parent}"]  # fmt: skip
    camera = 'backend = "replay"\n[camera.replay]\npath = "frames"\nat_end = "loop"'
    with Rig(directory, worker=worker, camera=camera, interval_s=1800, deadline_s=20.0) as rig:
        rig.is_true = lambda reading: near_the_truth(reading, truth)
        rig.start()
        rig.wait_for(lambda: sum(what == "F" for _, what, _ in rig.entries()) >= wanted, 120 + 20 * wanted, 0.2)
        rig.wait_good(1, 120)
        rig.last_run()
        books = rig.books(coded=False)
        valid = sum(1 for r, _ in rig.rows().values() if r["quality"]["validity"] != "invalid")
        yield Line.of("camera", f"camera: {', '.join(KINDS)}", wanted, books, recovery=rig.recoveries(), limit_s=60.0,
                      remark=f"{valid} of {books.made} readings carry numbers")  # fmt: skip


def near_the_truth(reading, truth):
    """A reading without numbers, or with one that the truth bears out."""
    value = reading["sag_m"]
    if reading["quality"]["validity"] == "invalid":
        return value is None
    at = datetime.fromisoformat(reading["acquired_at"])
    known = truth[*place_in_the_round(at), reading["conductor"]]
    return abs(value - known.sag) <= BEYOND * reading["sag_u"]


def place_in_the_round(at):
    """The frames of seven hours are shown again and again, and their times go on."""
    return (at.toordinal() * 24 + at.hour) % 7, at.minute
