#!/bin/bash
# What the scripts that run inside a root or a machine share; bare_root.sh and vm.sh put it beside them.

ok() { printf 'ok    %s\n' "$*"; }
fail() {
	printf 'FAIL  %s\n' "$*"
	if [ -d /run/systemd/system ]; then
		systemctl status --no-pager --full sagnode || true
		journalctl --no-pager -b -u 'sagnode*' -n 60 || true
	fi
	exit 1
}
# until_true SECONDS WHAT COMMAND...
until_true() {
	local end=$((SECONDS + $1)) what=$2
	shift 2
	until "$@" >/dev/null 2>&1; do
		[ $SECONDS -lt $end ] || fail "$what"
		sleep "${PAUSE_S:-0.2}"
	done
	ok "$what"
}

main_pid() { systemctl show --value -p MainPID sagnode; }
worker_pid() { pgrep -P "$(main_pid)" | head -n 1; }
restarts() { systemctl show --value -p NRestarts sagnode; }
is_another() { [ "$(main_pid)" != "$1" ] && [ "$(main_pid)" != 0 ] && systemctl is-active --quiet sagnode; }
other_worker() {
	local pid
	pid=$(worker_pid)
	[ -n "$pid" ] && [ "$pid" != "$1" ]
}
# The number that systemd itself gives to the service as it runs here.
exposure_is_low() {
	local said
	said=$(systemd-analyze security --no-pager --threshold=13 sagnode) || fail "$(printf '%s' "$said" | tail -n 1)"
	printf '%s\n' "$said" | tail -n 1
}
# Stops the service, which must end by itself and leave nothing.
stop_cleanly() {
	local began=$SECONDS
	systemctl stop sagnode
	[ "$(systemctl show --value -p Result sagnode)" = success ] || fail "stopped with $(systemctl show --value -p Result sagnode)"
	! pgrep -u sagnode >/dev/null || fail 'processes are left'
	ok "stopped within $((SECONDS - began)) s, nothing is left"
}

# journal SQL: the first row of the answer of the journal of readings, its fields apart by blanks.
journal() {
	python3 - "$1" <<-'P'
		import sqlite3, sys
		print(*sqlite3.connect("file:/var/lib/sagnode/journal.sqlite?mode=ro", uri=True).execute(sys.argv[1]).fetchone())
	P
}
# good N: whether so many good readings are in it.
good() { [ "$(journal "SELECT count(*) FROM readings WHERE validity = 'good'")" -ge "$1" ]; }
first_good_readings() {
	python3 - <<-'P'
		import json, sqlite3
		rows = sqlite3.connect("file:/var/lib/sagnode/journal.sqlite?mode=ro", uri=True).execute(
		    "SELECT json FROM readings WHERE validity = 'good' ORDER BY sequence LIMIT 3"
		)
		for reading in (json.loads(row[0]) for row in rows):
		    print(f"ok    {reading['conductor']}: sag {reading['sag_m']:.4f} m, u {reading['sag_u']:.4f} m")
	P
}
told_versions() {
	printf 'systemd %s, Python %s, %s\n' "$(systemctl --version | awk 'NR == 1 {print $2}')" \
		"$(python3 -c 'import platform; print(platform.python_version())')" "$(uname -m)"
}
