"""``kill -9`` of daemon and worker at random moments, also while they start."""

import os
import signal
import time
from functools import partial

from rig import Rig
from table import Line

from sagnode.daemon.sequence import BLOCK

DAEMON_KILLS = 160
WORKER_KILLS = 440


def run(campaign):
    """Three nodes whose daemon is killed beside two whose worker is."""
    daemons = [partial(of_the_daemon, kills=n) for n in campaign.divided(DAEMON_KILLS, 3)]
    workers = [partial(of_the_worker, wanted=n) for n in campaign.divided(WORKER_KILLS, 2)]
    return campaign.side_by_side(*daemons, *workers, at_once=5)


def of_the_daemon(campaign, kills):
    recovery = []
    with Rig(campaign.fresh("kill")) as rig:
        rig.start()
        rig.wait_good(1)
        while rig.kills < kills:
            # four of five while it works, the fifth while it starts
            time.sleep(campaign.random.uniform(0, 0.5))
            rig.kill()
            killed = time.monotonic()
            rig.start()
            if campaign.random.random() < 0.8:
                rig.wait_for(lambda at=killed: any(t > at and what == "G" for t, what, _ in rig.entries(tail=2000)), 60)
                recovery.append(time.monotonic() - killed)
            else:
                time.sleep(campaign.random.uniform(0, 1.0))
        rig.wait_good(1)
        left = rig.worker_pids()
        rig.last_run()
        # A kill between the two writes of the log's last frame leaves what damage would leave: it counts on above.
        skipped = rig.log().count("sequence numbers leave a gap")
        books = rig.books(allowed_gaps=skipped > 0)
        broken = [f"{len(left)} workers at once"] if len(left) > 1 else []
        if books.gaps > skipped * BLOCK:
            broken.append(f"{books.gaps} numbers were skipped, in {skipped} gaps")
        if books.in_flight > rig.kills:
            broken.append(
                f"{books.in_flight} answers were never committed, and the daemon was killed {rig.kills} times"
            )
        # at each kill some readings had arrived whose PUBACK was not in the journal yet
        return Line.of("kill", "daemon killed (SIGKILL)", rig.kills, books, recovery=recovery, limit_s=60.0,
                       allowed_repeats=rig.kills * 70, broken=broken)  # fmt: skip


def of_the_worker(campaign, wanted):
    recovery, kills = [], 0
    with Rig(campaign.fresh("kill")) as rig:
        rig.start()
        rig.wait_good(1)
        while kills < wanted:
            time.sleep(campaign.random.uniform(0, 0.1))
            for pid in rig.worker_pids():
                try:
                    os.kill(pid, signal.SIGKILL)
                except ProcessLookupError:
                    continue
                kills += 1
                killed = time.monotonic()
                rig.wait_for(lambda at=killed: any(t > at and what == "G" for t, what, _ in rig.entries(tail=2000)), 60)
                recovery.append(time.monotonic() - killed)
        rig.last_run()
        books = rig.books()
        broken = [f"{books.in_flight} answers lost"] if books.in_flight > kills else []
        return Line.of("kill", "worker killed (SIGKILL)", kills, books, recovery=recovery, limit_s=10.0, broken=broken)
