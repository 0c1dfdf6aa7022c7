#!/bin/bash
# Runs in a booted machine of another processor than this one's (bare_root.sh ... boot-package): the package's service comes
# up by itself, measures the demonstration's noon, has its worker killed, is reloaded and stopped. Prints BOOTED FINE.
#
# The emulator of programs (qemu-aarch64) is no kernel: it has no user and IPC namespaces to give, which emulated.conf takes
# out of the unit, and takes filters of system calls without applying them. It is some ten times slower than the machine.
set -euo pipefail
ok() { printf 'ok    %s\n' "$*"; }
fail() {
	printf 'FAIL  %s\n' "$*"
	systemctl status --no-pager --full sagnode || true
	journalctl --no-pager -u sagnode -n 60 || true
	exit 1
}
# until_true SECONDS WHAT COMMAND...
until_true() {
	local end=$((SECONDS + $1)) what=$2
	shift 2
	until "$@" >/dev/null 2>&1; do
		[ $SECONDS -lt $end ] || fail "$what"
		sleep 2
	done
	ok "$what"
}
main_pid() { systemctl show --value -p MainPID sagnode; }
good() {
	python3 - "$1" <<-'P'
		import sqlite3, sys
		rows = sqlite3.connect("file:/var/lib/sagnode/journal.sqlite?mode=ro", uri=True).execute(
		    "SELECT count(*) FROM readings WHERE validity = 'good'"
		).fetchone()[0]
		sys.exit(rows < int(sys.argv[1]))
	P
}

printf 'systemd %s, Python %s, %s\n' "$(systemctl --version | awk 'NR == 1 {print $2}')" \
	"$(python3 -c 'import platform; print(platform.python_version())')" "$(uname -m)"
began=$SECONDS
until_true 400 'the service of the package came up by itself and said that it is ready' systemctl is-active --quiet sagnode
[ "$(ps -o user= -p "$(main_pid)")" = sagnode ] || fail 'the daemon does not run as sagnode'
until_true 400 'three good readings are in the journal' good 3
python3 - <<'P'
import json, sqlite3
rows = sqlite3.connect("file:/var/lib/sagnode/journal.sqlite?mode=ro", uri=True).execute(
    "SELECT json FROM readings WHERE validity = 'good' ORDER BY sequence LIMIT 3"
)
for reading in (json.loads(row[0]) for row in rows):
    print(f"ok    {reading['conductor']}: sag {reading['sag_m']:.4f} m, u {reading['sag_u']:.4f} m")
P
ok "$((SECONDS - began)) s after the look began"
before=$(main_pid)
kill -9 "$(pgrep -P "$before" | head -n 1)"
until_true 600 'a killed worker is replaced, and readings come again' good 6
[ "$(main_pid)" = "$before" ] || fail 'the daemon ended with its worker'
systemctl reload sagnode || fail 'reload'
sleep 5
[ "$(main_pid)" = "$before" ] && systemctl is-active --quiet sagnode || fail 'a reload restarted the daemon'
[ "$(systemctl show --value -p NRestarts sagnode)" = 0 ] || fail 'systemd restarted the daemon'
ok 'a reload keeps the daemon; systemd and its watchdog never had to start it anew'
systemctl stop sagnode
[ "$(systemctl show --value -p Result sagnode)" = success ] || fail "stopped with $(systemctl show --value -p Result sagnode)"
! pgrep -u sagnode >/dev/null || fail 'processes are left'
ok 'stopped, nothing is left'
echo 'BOOTED FINE'
