#!/bin/bash
# Runs in the machine of booted.sh, twice (bare_root.sh ... boot): "ask" leaves the service with a camera that is not there
# until it asks for a restart of the machine, which ends this script with the machine; "after" looks at what then came up.
set -euo pipefail
. "$(dirname "$0")/looks.sh"
recovery() { python3 -c 'import json, sys; print(json.load(open("/var/lib/sagnode/recovery.json"))[sys.argv[1]])' "$1"; }

case $1 in
ask)
	systemctl stop sagnode 2>/dev/null || true
	rm -f /var/lib/sagnode/recovery.json
	# The last restart of the machine may not be far away, and a second one must wait for twice as long: uptime here is
	# that of the machine below.
	wait_h=$(awk '{print $1 * 0.7 / 3600}' /proc/uptime)
	sed -i '/^nonsense/d; /^\[recovery\]/,$d; /^\[camera\]/,/^\[schedule\]/c [camera]\nbackend = "v4l2"\nv4l2 = { device = "/dev/video99", width = 1456, height = 1088 }\n[schedule]' \
		/etc/sagnode/node.toml
	printf '[recovery]\nrestart_after_s = 3\nrestarts_before_reboot = 1\nreboot_wait_h = %s\n' "$wait_h" >>/etc/sagnode/node.toml
	sagnode config check --config /etc/sagnode || fail 'the configuration is refused'
	[ "$(systemctl show --value -p ActiveState sagnode-reboot.path)" = inactive ] || systemctl stop sagnode-reboot.path
	systemctl reset-failed sagnode
	systemctl start sagnode || fail 'the service does not start'
	[ "$(systemctl is-active sagnode-reboot.path)" = active ] || fail 'nobody waits for the request'
	sync
	sleep 120
	fail 'the machine was not restarted within two minutes'
	;;
after)
	[ "$(systemctl is-enabled sagnode)" = enabled ] || fail 'the service is not enabled'
	until_true 240 'no camera: the service was started anew, then the machine; the service is up again by itself' \
		systemctl is-active --quiet sagnode
	[ "$(recovery reboots)" = 1 ] || fail "restarts of the machine that are remembered: $(recovery reboots)"
	[ ! -e /run/sagnode/reboot-wanted ] || fail 'the request is still there'
	# Long enough for more faults than the first restart took. A container has the boot id of the machine below, so that the
	# ladder goes on where it stood: at the next restart of the machine, which is not due yet.
	sleep 25
	systemctl is-active --quiet sagnode || fail 'the service gave up'
	[ "$(recovery reboots)" = 1 ] || fail "$(cat /var/lib/sagnode/recovery.json)"
	ok 'it goes on without a camera; the next restart of the machine waits for twice as long'
	echo 'REBOOT FINE'
	;;
esac
