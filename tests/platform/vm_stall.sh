#!/bin/bash
# Runs in the virtual machine (vm.sh run vm_stall.sh): the service on a V4L2 device whose feeder stops and comes back. The
# next good reading is due within two periods, by the same daemon.
set -euo pipefail
PERIOD_S=60
. "$(dirname "$0")/looks.sh"
up() { cut -d' ' -f1 /proc/uptime; }
# heard SINCE PATTERN: the time since boot of the first line of the log after SINCE that has it.
heard() {
	journalctl --no-pager -b -o short-monotonic -u sagnode |
		sed -n "s/^\[ *\([0-9.]*\)\].* $2.*/\1/p" | awk -v since="$1" '$1 > since {print; exit}'
}
# await SECONDS SINCE PATTERN
await() {
	local end=$((SECONDS + $1))
	until [ -n "$(heard "$2" "$3")" ]; do
		[ $SECONDS -lt $end ] || fail "no '$3' within $1 s"
		sleep 1
	done
	heard "$2" "$3"
}
feed() {
	/usr/lib/sagnode/venv/bin/python "$(dirname "$0")/vm_v4l2.py" feed &
	feeder=$!
}

systemctl stop sagnode
modprobe v4l2loopback devices=1 video_nr=9 exclusive_caps=1 max_buffers=2 2>/dev/null || true
sed -i 's/^backend = .*/backend = "v4l2"\nv4l2 = { device = "\/dev\/video9", width = 1456, height = 1088, timeout_s = 5, warmup_frames = 1 }/;
	s/^interval_s = .*/interval_s = '$PERIOD_S'/' /etc/sagnode/node.toml
feed
sleep 3
began=$(up)
systemctl start sagnode
before=$(main_pid)
good=$(await 180 "$began" 'L1 is good')
printf 'ok    the service reads %s; first good reading %.1f s after its start\n' /dev/video9 "$(echo "$good $began" | awk '{print $1 - $2}')"

kill "$feeder"
stopped=$(up)
bad=$(await $((3 * PERIOD_S)) "$stopped" 'L1 is invalid (camera-fault')
printf 'ok    the camera gives nothing: an invalid reading with its reason %.1f s later\n' "$(echo "$bad $stopped" | awk '{print $1 - $2}')"
feed
back=$(up)
good=$(await $((4 * PERIOD_S)) "$back" 'L1 is good')
took=$(echo "$good $back" | awk '{print $1 - $2}')
printf 'ok    the camera is back: next good reading %.1f s later, %.2f periods of %s s\n' "$took" \
	"$(echo "$took $PERIOD_S" | awk '{print $1 / $2}')" "$PERIOD_S"
[ "$(main_pid)" = "$before" ] || fail 'the daemon was started anew'
[ "$(systemctl show --value -p NRestarts sagnode)" = 0 ] || fail 'systemd restarted the daemon'
ok=$(echo "$took $PERIOD_S" | awk '{print ($1 <= 2 * $2)}')
[ "$ok" = 1 ] || fail 'later than two periods'
kill "$feeder"
systemctl stop sagnode
